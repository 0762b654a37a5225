"""Weak learners: stumps and tiny convolutional networks."""
