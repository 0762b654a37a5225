"""Demonstrations: LeRobot datasets in and out, actions, images, and generators of ground truth."""
