"""What a recording of the world TwoFlags tells beside images and actions: its task and its true labels."""

from dpmacro.worlds.base import Recording

__all__ = ["RECORDING"]

RECORDING = Recording(
    task="reach the blue flag, then the red flag",
    truth={"phase": ("before blue", "after blue")},
    symmetric=True,
)
