"""How the search and the switch functions of DPBoost learn, by its recipe."""

from collections.abc import Mapping
from typing import Any

from dpmacro.discovery.settings import SearchSettings, paper_switches
from dpmacro.switching.settings import SwitchSettings

__all__ = ["search_of", "shrinkage_of", "switches_of"]


def search_of(options: Mapping[str, Any]) -> SearchSettings:
    """Settings of the search, from DPBoost's options by name."""
    if options["recipe"] == "paper":
        return SearchSettings.paper()
    return SearchSettings(switch_weight=float(options["switch_weight"]))


def switches_of(options: Mapping[str, Any]) -> SwitchSettings:
    """Settings of the switch functions of the final fit, from DPBoost's options by name."""
    rounds, window = int(options["switch_rounds"]), int(options["switch_window"])
    if options["recipe"] == "paper":
        return paper_switches(rounds, window)
    return SwitchSettings(rounds, window, early_stopping=bool(options["early_stopping"]))


def shrinkage_of(options: Mapping[str, Any]) -> float:
    """Factor on every weak hypothesis, from DPBoost's options by name."""
    return 1.0 if options["recipe"] == "paper" else float(options["shrinkage"])
