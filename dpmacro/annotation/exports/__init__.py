"""Stages in files that other tools read: a new LeRobot dataset, and the formats that go with it."""
