"""dpmacro: macro-actions found in demonstrations, and policies that run them.

The names below are the public face; everything else is reached by its module. They are imported when they
are first asked for, so that `import dpmacro` costs next to nothing.
"""

import importlib as _importlib
import typing as _typing

if _typing.TYPE_CHECKING:
    from dpmacro.annotation.annotate import Annotation, annotate
    from dpmacro.annotation.exports.dataset import write_labels
    from dpmacro.annotation.stages import Stages
    from dpmacro.data.demonstrations import Demonstrations
    from dpmacro.estimator.dpboost import DPBoost
    from dpmacro.estimator.result import DPBoostResult
    from dpmacro.policy.policy import MacroPolicy
    from dpmacro.segmentation.recursion import Segmentation, segment

__all__ = [
    "Annotation",
    "DPBoost",
    "DPBoostResult",
    "Demonstrations",
    "MacroPolicy",
    "Segmentation",
    "Stages",
    "annotate",
    "segment",
    "write_labels",
]

_MODULE_OF = {
    "Annotation": "dpmacro.annotation.annotate",
    "DPBoost": "dpmacro.estimator.dpboost",
    "DPBoostResult": "dpmacro.estimator.result",
    "Demonstrations": "dpmacro.data.demonstrations",
    "MacroPolicy": "dpmacro.policy.policy",
    "Segmentation": "dpmacro.segmentation.recursion",
    "Stages": "dpmacro.annotation.stages",
    "annotate": "dpmacro.annotation.annotate",
    "segment": "dpmacro.segmentation.recursion",
    "write_labels": "dpmacro.annotation.exports.dataset",
}


def __getattr__(name: str) -> _typing.Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module 'dpmacro' has no attribute {name!r}: it offers {', '.join(__all__)}")
    found = getattr(_importlib.import_module(_MODULE_OF[name]), name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
