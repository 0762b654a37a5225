"""What LeRobot imports where this is installed: it registers dpmacro's policy and its worlds."""

from dpmacro.policy.lerobot import DpmacroConfig

__all__ = ["DpmacroConfig"]
