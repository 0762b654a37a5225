"""Weak learners: stumps, tiny convolutional networks, and both in turn."""
