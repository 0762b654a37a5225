"""What strong learners minimise: a loss for every kind of action."""
