"""What a recording among flags tells beside what is seen: its task, its actions, its true labels."""

from dpmacro.worlds.base import Recording
from dpmacro.worlds.two_flags.env import ACTIONS, FPS
from dpmacro.worlds.two_flags.scene import FLAGS

__all__ = ["recording"]


_COUNTS = {"FourFlags-v0": 4, "SixFlags-v0": 6}


def recording(world: str) -> Recording:
    """What recordings of the world of this id say; of TwoFlags unless it has more flags."""
    flags = FLAGS[: _COUNTS.get(world, 2)]
    return Recording(
        task="reach " + ", then ".join(f"the {flag} flag" for flag in flags),
        truth={"phase": (f"before {flags[0]}", *(f"after {flag}" for flag in flags[:-1]))},
        actions=ACTIONS,
        fps=FPS,
        symmetric=True,
        observations={"observation.images.avatar": "pixels"},
    )
