"""LeRobot's dataset format: reading, decoding, writing."""
