"""What a recording of TwoFlags tells beside what is seen: its task, its actions, its true labels."""

from dpmacro.worlds.base import Recording
from dpmacro.worlds.two_flags.env import ACTIONS, FPS

__all__ = ["recording"]


def recording(world: str) -> Recording:
    """What recordings of TwoFlags say."""
    return Recording(
        task="reach the blue flag, then the red flag",
        truth={"phase": ("before blue", "after blue")},
        actions=ACTIONS,
        fps=FPS,
        symmetric=True,
        observations={"observation.images.avatar": "pixels"},
    )
