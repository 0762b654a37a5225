"""What LeRobot finds by itself where `lerobot_policy_dpmacro` is installed."""

import shutil
import subprocess
import sys
from pathlib import Path

PLUGIN = Path(__file__).parents[3] / "plugins/lerobot_policy_dpmacro"
ASK = """
import sys
from setuptools import build_meta
from lerobot.configs.policies import PreTrainedConfig
from lerobot.envs.configs import EnvConfig
from lerobot.utils.import_utils import register_third_party_plugins

build_meta.prepare_metadata_for_build_wheel(".")  # what pip installs beside the package
sys.path.insert(0, ".")
assert "dpmacro" not in PreTrainedConfig.get_known_choices()
register_third_party_plugins()
assert "dpmacro" in PreTrainedConfig.get_known_choices() and "two_flags" in EnvConfig.get_known_choices()
"""


def test_an_installed_plugin_is_found(tmp_path):
    shutil.copytree(PLUGIN, tmp_path / "installed")
    done = subprocess.run(
        [sys.executable, "-c", ASK],
        cwd=tmp_path / "installed",
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr


def test_dpmacro_itself_imports_no_lerobot():
    """It takes seconds, and only its programs need it."""
    ask = "import sys, dpmacro, dpmacro.policy.policy, dpmacro.policy.files; print('lerobot' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", ask], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.strip() == "False"
