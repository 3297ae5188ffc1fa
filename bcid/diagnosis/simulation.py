"""The simulation that a recording is compared with: a saved model, another simulator's recording, a user's function.

A recording or a function is identified first, as if it were a car of its own: what it has is then part of the
base model, and the diagnosis says what the real car has beyond.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from bcid.diagnosis.diagnose import Compared, diagnosed
from bcid.errors import InputRefused, UsageError
from bcid.estimate.types import Estimate
from bcid.evaluation.closed_loop import integrate
from bcid.models.augmented import AugmentedNewtonEuler
from bcid.models.interface import Model, history_at, rollout
from bcid.models.newton_euler import NewtonEuler
from bcid.models.saving import load_model
from bcid.recording.types import Recording, Stream
from bcid.vehicle import Vehicle

RESTART_S = 20.0  # a user's function drives this long before it is set to the estimate again


def of_model(folder: Path) -> Compared:
    """What a saved Newton-Euler model, plain or augmented, has.

    Raises:
        InputRefused: no such model there.
    """
    model = load_model(folder)
    if isinstance(model, AugmentedNewtonEuler):
        return Compared(model.car, dict(model.effects))
    if isinstance(model, NewtonEuler):
        return Compared(model.car, {})
    raise InputRefused(folder, "model.json", f"holds {model.name}, which has no forces", "name a newton-euler model")


def of_recordings(recordings: Sequence[Recording], estimates: Sequence[Estimate], vehicle: Vehicle) -> Compared:
    """What the car of other recordings, a simulator's, has."""
    fit = diagnosed(recordings, estimates, vehicle).judgement.fit
    return Compared(fit.car(), fit.hypothesis.values(fit.phi))


def user_model(name: str) -> Model:
    """What `module:function` returns: an object with `init`, `step`, `scan` and `period_s` (`bcid.models.interface`).

    Raises:
        UsageError: no such function, or it returns something else.
    """
    module, _, function = name.partition(":")
    next_step = "name module:function, importable from here, or a file or folder that exists"
    if not (function.isidentifier() and all(part.isidentifier() for part in module.split("."))):
        raise UsageError(f"--simulation {name}: neither a file or folder nor module:function\n  next: {next_step}")
    sys.path.insert(0, str(Path.cwd()))
    try:
        made: Any = getattr(importlib.import_module(module), function)()
    except Exception as error:  # the user's own code: whatever it raises is the user's to read
        raise UsageError(f"--simulation {name}: {type(error).__name__}: {error}\n  next: {next_step}") from error
    finally:
        sys.path.pop(0)
    missing = [m for m in ("init", "step", "scan", "period_s", "lags", "name") if not hasattr(made, m)]
    if missing:
        raise UsageError(
            f"--simulation {name}: what it returns has no {', '.join(missing)}\n  next: see bcid.models.interface.Model"
        )
    return made  # type: ignore[no-any-return]


def driven_by(model: Model, recording: Recording, estimate: Estimate) -> Recording:
    """The recording as the model would have driven it, started anew at RESTART_S and at each stretch's beginning."""
    size = max(2, round(RESTART_S / estimate.period_s))
    times, poses, breaks = [], [], []
    for stretch in estimate.segments():
        for k in range(stretch.start, stretch.stop, size):
            stop = min(k + size, stretch.stop)
            twist = rollout(model, history_at(estimate, k, model.lags), estimate.command[k : stop - 1])
            poses.append(integrate(estimate.pose[k], twist, estimate.period_s))
            times.append(estimate.time_s[k:stop])
            breaks.append(float(estimate.time_s[k]))
    return replace(
        recording, poses=Stream(np.concatenate(times), np.concatenate(poses)), breaks_s=tuple(breaks[1:]),
        rate_hz=1.0 / estimate.period_s, channels={},
    )  # fmt: skip
