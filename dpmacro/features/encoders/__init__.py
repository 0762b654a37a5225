"""What turns observations into feature columns: images, states and tasks, side by side."""
