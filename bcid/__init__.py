"""bcid: from motion-capture logs of small ground vehicles to fitted planar models.

Data flows one way: recording -> estimate -> models -> evaluation -> report.  The equations live in
`bcid.physics` and `bcid.models`; everything that reads, writes or draws knows them, never the reverse.

What a program needs stands in `bcid.api`, and is found here under the same names: `bcid.fit`, `bcid.load`, …
(docs/python.md).  It is imported when it is first used, so that `import bcid` takes no time; `__init__.pyi` says what
there is to whoever checks types.
"""

from importlib import import_module
from typing import Any

__version__ = "0.1.0"

_HOMES = {
    "bcid.api": (
        "Comparison", "DiagnosedRecordings", "adapt", "compare", "diagnose", "estimate_motion",
        "export_code", "fit", "load", "own_effects", "predict", "read",
    ),
    "bcid.adaptation.on_line": ("AdaptedCar", "CarUnderWay"),
    "bcid.prediction.fitted_model": ("FittedModel",),
    "bcid.prediction.motion": ("Motion",),
    "bcid.prediction.prediction": ("BeyondData", "Prediction"),
    "bcid.prediction.start": ("Moment", "State"),
    "bcid.vehicle": ("Vehicle", "read_vehicle"),
    "bcid.errors": ("BcidError", "InputRefused", "UsageError"),
}  # fmt: skip
_HOME = {name: home for home, names in _HOMES.items() for name in names}

__all__ = sorted(_HOME)  # noqa: PLE0605  # the names stand above, once


def __getattr__(name: str) -> Any:
    """The word `name` of the interface in Python; `AttributeError` is raised for what is none."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    """The words of the interface in Python, beside what has been imported."""
    return sorted({*(name for name in globals() if name not in ("Any", "import_module")), *_HOME})
