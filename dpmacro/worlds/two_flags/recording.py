"""What a recording of the world TwoFlags tells beside images and actions: its task and its true labels."""

__all__ = ["PHASES", "TASK"]

TASK = "reach the blue flag, then the red flag"
PHASES = {"phase": ("before blue", "after blue")}  # column of true labels, and the names of the labels 0, 1
