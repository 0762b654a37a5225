"""Names of the numbers in a vector feature, in any of the ways that datasets store them."""

from typing import Any

__all__ = ["entry_names"]


def entry_names(feature: dict[str, Any], count: int) -> tuple[str, ...]:
    """The names of a feature's `count` numbers: a list, lists within, {"motors": list} or {name: place}.

    Their places as text where there are none, or not as many.
    """
    names = _flat(feature.get("names"))
    return tuple(names) if len(names) == count else tuple(map(str, range(count)))


def _flat(names: Any) -> list[str]:
    if isinstance(names, dict):
        if names and all(isinstance(place, int) for place in names.values()):
            return [str(name) for name in sorted(names, key=names.__getitem__)]
        return [name for within in names.values() for name in _flat(within)]
    if isinstance(names, list):
        return [name for within in names for name in _flat(within)]
    return [] if names is None else [str(names)]
