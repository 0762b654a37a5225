"""dpmacro's policies, and TwoFlags, in LeRobot's programs; importing this registers both.

    lerobot-eval --env.discover_packages_path=dpmacro.policy.lerobot --env.type=two_flags --policy.path=...

Nothing else in dpmacro imports this package, since LeRobot takes seconds to import.
"""

from dpmacro.policy.lerobot.configuration_dpmacro import DpmacroConfig
from dpmacro.policy.lerobot.env_two_flags import TwoFlagsEnvConfig

__all__ = ["DpmacroConfig", "TwoFlagsEnvConfig"]
