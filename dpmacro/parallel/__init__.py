"""Several processes, on one machine or more, that train one policy together."""

from dpmacro.parallel.ranks import ALONE, Ranks, joined
from dpmacro.parallel.shares import Shares

__all__ = ["ALONE", "Ranks", "Shares", "joined"]
