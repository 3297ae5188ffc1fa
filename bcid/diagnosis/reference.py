"""The simulation that a recording is compared with: a model or its parameters, a simulator's recording, a function.

A recording or a function is identified first, as if it were a car of its own: what it has is then part of the
base model, and the diagnosis says what the real car has beyond.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from bcid.aliases import Floats
from bcid.diagnosis.compared import Compared
from bcid.diagnosis.diagnose import diagnosed
from bcid.effects.corrections import RAW_COMMANDS
from bcid.effects.table import ENTRIES
from bcid.errors import InputRefused, UsageError
from bcid.estimate.types import Estimate
from bcid.evaluation.closed_loop import integrate
from bcid.files.toml import Settings, read_toml
from bcid.likelihood.hypothesis import DRAG, FORCE_LAW, PRIOR_SD, SPEED_LAW, TYRES
from bcid.likelihood.prepare import base_of
from bcid.models.interface import History, history_at, rollout
from bcid.models.newton_euler.augmented import AugmentedNewtonEuler
from bcid.models.newton_euler.initial_guess import started_car
from bcid.models.newton_euler.model import NewtonEuler
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


_Share = Annotated[float, Field(gt=0.0, le=1.0)]


class Parameters(Settings):
    """A file of parameters, measured or published."""

    relative_sd: _Share | None = None
    relative_sd_of: dict[str, _Share] = Field(default_factory=dict)  # by parameter or effect: what is known otherwise
    parameters: dict[str, float]
    effects: dict[str, dict[str, float]] = Field(default_factory=dict)


def read_parameters(path: Path) -> Parameters:
    """The file at `path`.

    Raises:
        InputRefused: it is no such file.
    """
    return read_toml(path, Parameters, "simulation file", "pipelines/dart/simulation.toml is one")


def of_parameters(path: Path, estimates: Sequence[Estimate], vehicle: Vehicle) -> Compared:
    """The simulation whose parameters a TOML file gives: Newton-Euler's, and those of the effects that it has.

    With `relative_sd` the parameters stay about that near to what they are, or as near as `relative_sd_of` says of one,
    and never go beyond three times that; without, they are where the refit starts.

    Raises:
        InputRefused: a parameter or effect that is missing, unknown, out of bounds, or in the vehicle file too.
    """
    file = read_parameters(path)
    law = FORCE_LAW if vehicle.motor.law == "force" else SPEED_LAW
    steering = vehicle.steering
    wanted, may = {*law, *TYRES, *DRAG}, {"T_s": steering.time_constant_s, "d": steering.max_rate_radps}
    lacking, strange = sorted(wanted - set(file.parameters)), sorted(set(file.parameters) - wanted - set(may))
    given = sorted(s for s in may if s in file.parameters and may[s] is not None)
    negative = sorted(s for s, v in file.parameters.items() if s not in DRAG and not v > 0.0)
    told = [
        f"{words} {', '.join(symbols)}"
        for words, symbols in (
            ("lacks", lacking), ("has unknown", strange), ("has in the vehicle file already", given),
            ("needs above zero", negative),
        )
        if symbols
    ]  # fmt: skip
    if told:
        raise InputRefused(path, "parameters", " and ".join(told), f"give {', '.join(sorted(wanted))}, in SI units")
    for name, values in file.effects.items():
        if name not in ENTRIES or set(values) != {p.symbol for p in ENTRIES[name].parameters}:
            raise InputRefused(path, f"effects.{name}", "no such effect, or not its parameters", "see bcid effects")
    gains = RAW_COMMANDS if vehicle.raw_steering else ()
    unknown = sorted(set(file.relative_sd_of) - {*file.parameters, *file.effects, *gains})
    if unknown or (file.relative_sd_of and file.relative_sd is None):
        cause = f"names {', '.join(unknown)}, which the file does not give" if unknown else "stands without relative_sd"
        raise InputRefused(path, "relative_sd_of", cause, "give relative_sd, and here what is known otherwise")
    facts = estimates[0].facts
    car = started_car(estimates, vehicle, facts["T_s"], facts["d"])._replace(u_0=0.0)._replace(**file.parameters)
    entries, fields = base_of(vehicle, car, estimates).entries, dict[str, float]()
    for name, values in file.effects.items():
        if name not in entries:
            raise InputRefused(path, f"effects.{name}", "this vehicle cannot have it", "leave it out")
        for field, p in zip(entries[name].fields, entries[name].parameters, strict=True):
            if not p.low <= values[p.symbol] <= p.high:
                bounds = f"{p.symbol} = {values[p.symbol]:g} lies outside {p.low:g} to {p.high:g} {p.unit}"
                raise InputRefused(path, f"effects.{name}", bounds, "check its unit; see bcid effects")
            fields[field] = values[p.symbol]
    unsaid = {s: PRIOR_SD for s in may if s not in file.parameters}  # the take's own, which nobody has published
    return Compared(car, fields, file.relative_sd, {**unsaid, **file.relative_sd_of})


def of_recordings(recordings: Sequence[Recording], estimates: Sequence[Estimate], vehicle: Vehicle) -> Compared:
    """What the car of other recordings, a simulator's, has."""
    fit = diagnosed(recordings, estimates, vehicle).judgement.fit
    return Compared.of(fit)


@dataclass(frozen=True)
class Stepped:
    """A user's model as far as it is used: how it begins and steps; it may look back by so many `lags`."""

    model: Any
    name: str

    @property
    def period_s(self) -> float:
        """The time a step advances (s)."""
        return float(self.model.period_s)

    @property
    def lags(self) -> int:
        """Rows of history before the start that it wants."""
        return int(getattr(self.model, "lags", 0))

    def init(self, history: History) -> Any:
        """See `Model.init`."""
        return self.model.init(history)

    def scan(self, carry: Any, commands: Floats) -> tuple[Any, Floats]:
        """See `Model.scan`."""
        twists = np.empty((len(commands), 3))
        for k, command in enumerate(commands):
            carry, twists[k] = self.model.step(carry, command)
        return carry, twists


def user_model(name: str) -> Stepped:
    """What `module:function` returns: an object with `init`, `step` and `period_s` (`bcid.models.interface`).

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
    missing = [m for m in ("init", "step", "period_s") if not hasattr(made, m)]
    if missing:
        raise UsageError(
            f"--simulation {name}: what it returns has no {', '.join(missing)}\n  next: see bcid.models.interface.Model"
        )
    return Stepped(made, name)


def driven_by(model: Stepped, recording: Recording, estimate: Estimate) -> Recording:
    """The recording as the model would have driven it, started anew at RESTART_S and at each stretch's beginning."""
    if abs(model.period_s - estimate.period_s) > 1e-9:
        step, grid = f"{model.period_s:g} s", f"{estimate.period_s:g} s"
        raise UsageError(
            f"{model.name} steps by {step}, the grid by {grid}\n  next: set period_s in [estimate], or its step"
        )
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
