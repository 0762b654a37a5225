"""dpmacro's policies, and its worlds, in LeRobot's programs; importing this registers all of them.

    lerobot-eval --env.discover_packages_path=dpmacro.policy.lerobot --env.type=... --policy.path=...

Nothing else in dpmacro imports this package, since LeRobot takes seconds to import.
"""

from importlib import import_module

from dpmacro.policy.lerobot.configuration_dpmacro import DpmacroConfig
from dpmacro.worlds import LEROBOT_ENVS

__all__ = ["DpmacroConfig"]

for _module in LEROBOT_ENVS.values():
    import_module(_module)
