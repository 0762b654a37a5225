"""What LeRobot imports where this is installed: it registers dpmacro's policy and its world TwoFlags."""

from dpmacro.policy.lerobot import DpmacroConfig, TwoFlagsEnvConfig

__all__ = ["DpmacroConfig", "TwoFlagsEnvConfig"]
