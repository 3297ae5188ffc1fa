"""Reference models from a saved model, a file of parameters, a simulator's recording, or a user's function.

A recording or a function is identified first, as if it were a car of its own: what it has is then part of the base
model, and the diagnosis says what the real car has beyond.
"""

import importlib
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from bcid.aliases import Floats
from bcid.diagnosis.diagnose import diagnose_recordings
from bcid.diagnosis.reference_model import ReferenceModel
from bcid.effects.corrections import RAW_COMMANDS
from bcid.effects.table import ENTRIES
from bcid.errors import InputRefused, UsageError
from bcid.estimate.command_parts import mean_commands
from bcid.estimate.types import Estimate
from bcid.evaluation.closed_loop import integrate_poses
from bcid.files.toml import Settings, read_toml
from bcid.likelihood.hypothesis import DRAG, MOTOR_LAWS, TYRES
from bcid.likelihood.limits import LIKELIHOOD_LIMITS
from bcid.likelihood.prepare import base_hypothesis
from bcid.models.interface import History, history_at, rollout
from bcid.models.newton_euler.augmented import AugmentedNewtonEuler
from bcid.models.newton_euler.initial_guess import guess_car
from bcid.models.newton_euler.model import NewtonEuler
from bcid.models.newton_euler.with_remainder import NewtonEulerWithRemainder
from bcid.models.saving import load_model
from bcid.recording.types import Recording, Stream
from bcid.vehicle import Vehicle

# a user's function drives this long before it is set to the estimate again
USER_MODEL_RESTART_S = 20.0

Share = Annotated[float, Field(gt=0.0, le=1.0)]


def reference_from_model(folder: Path) -> ReferenceModel:
    """The reference model (a car and its effects) in the folder of a saved Newton-Euler model, plain or with effects.

    Raises:
        InputRefused: the folder holds no such model.
    """
    model = load_model(folder)
    if isinstance(model, AugmentedNewtonEuler):
        return ReferenceModel(model.car, dict(model.effects))
    if isinstance(model, NewtonEuler):
        return ReferenceModel(model.car, {})
    has = "which has free functions" if isinstance(model, NewtonEulerWithRemainder) else "which has no forces"
    raise InputRefused(folder, "model.json", f"holds {model.name}, {has}", "name a newton-euler model")


class ParameterFile(Settings):
    """A TOML file of a car's parameters, measured or published, in SI units."""

    relative_sd: Share | None = None  # how well all of it is known
    relative_sd_of: dict[str, Share] = Field(default_factory=dict)  # of parameters and effects that are known otherwise
    parameters: dict[str, float]
    effects: dict[str, dict[str, float]] = Field(default_factory=dict)


def read_parameter_file(path: Path) -> ParameterFile:
    """Read a car's parameters and effects from a TOML file; a file of other content is refused (InputRefused)."""
    return read_toml(path, ParameterFile, "simulation file", "pipelines/dart/simulation.toml is one")


def reference_from_parameters(path: Path, estimates: Sequence[Estimate], vehicle: Vehicle) -> ReferenceModel:
    """The reference model whose Newton-Euler parameters and effects a TOML file gives.

    With `relative_sd` in the file every parameter has a prior of heavy tails (`bcid.likelihood.prior`), whose scale is
    that share of its value (or the share in `relative_sd_of`).  Without, the refit only starts from the values.
    `estimates` give the servo's time constant and rate limit where both files omit them.

    Raises:
        InputRefused: a parameter or effect that is missing, unknown, out of bounds, or in the vehicle file too.
    """
    file = read_parameter_file(path)
    steering = vehicle.steering
    optional = {"T_s": steering.time_constant_s, "d": steering.max_rate_radps}
    _check_parameters(path, file, vehicle, optional)
    for name, values in file.effects.items():
        if name not in ENTRIES or set(values) != {p.symbol for p in ENTRIES[name].parameters}:
            raise InputRefused(path, f"effects.{name}", "no such effect, or not its parameters", "see bcid effects")
    gains = RAW_COMMANDS if vehicle.has_raw_steering else ()
    unknown = sorted(set(file.relative_sd_of) - {*file.parameters, *file.effects, *gains})
    if unknown or (file.relative_sd_of and file.relative_sd is None):
        cause = f"names {', '.join(unknown)}, which the file does not give" if unknown else "stands without relative_sd"
        raise InputRefused(path, "relative_sd_of", cause, "give relative_sd, and here what is known otherwise")
    car = guess_car(estimates, vehicle, *estimates[0].steering_constants())
    car = car._replace(u_0=0.0)._replace(**file.parameters)
    entries, fields = base_hypothesis(vehicle, car, estimates).entries, dict[str, float]()
    for name, values in file.effects.items():
        if name not in entries:
            raise InputRefused(path, f"effects.{name}", "this vehicle cannot have it", "leave it out")
        for field, p in zip(entries[name].fields, entries[name].parameters, strict=True):
            if not p.low <= values[p.symbol] <= p.high:
                bounds = f"{p.symbol} = {values[p.symbol]:g} lies outside {p.low:g} to {p.high:g} {p.unit}"
                raise InputRefused(path, f"effects.{name}", bounds, "check its unit; see bcid effects")
            fields[field] = values[p.symbol]
    # the take's own servo, which nobody has published
    unpublished = {s: LIKELIHOOD_LIMITS.base_prior_sd for s in optional if s not in file.parameters}
    return ReferenceModel(car, fields, file.relative_sd, {**unpublished, **file.relative_sd_of})


def _check_parameters(path: Path, file: ParameterFile, vehicle: Vehicle, optional: Mapping[str, float | None]) -> None:
    """Refuse (InputRefused) base parameters in `file` that are missing, unknown, not positive, or given twice.

    `optional` holds the vehicle file's value of each servo constant that the file may give instead; None where it has
    none.
    """
    required = {*MOTOR_LAWS[vehicle.motor.law], *TYRES, *DRAG}
    given = file.parameters
    wrong = {
        "lacks": sorted(required - set(given)),
        "has unknown": sorted(set(given) - required - set(optional)),
        "has in the vehicle file already": sorted(s for s, v in optional.items() if s in given and v is not None),
        "needs above zero": sorted(s for s, v in given.items() if s not in DRAG and not v > 0.0),
    }
    causes = [f"{words} {', '.join(symbols)}" for words, symbols in wrong.items() if symbols]
    if causes:
        next_step = f"give {', '.join(sorted(required))}, in SI units"
        raise InputRefused(path, "parameters", " and ".join(causes), next_step)


def identify_reference(
    recordings: Sequence[Recording], estimates: Sequence[Estimate], vehicle: Vehicle
) -> ReferenceModel:
    """Identify a reference model from recordings, such as a simulator's: diagnose them and take the fit.

    It is the fitted car with the effects that the diagnosis names and the corrections that it makes to the base model.
    """
    return ReferenceModel.from_fit(diagnose_recordings(recordings, estimates, vehicle).fit)


@dataclass(frozen=True)
class UserModel:
    """A user's object with `init`, `step` and `period_s`, as a model that can be rolled out."""

    model: Any
    name: str
    period_s: float  # by which a step advances
    lags: int  # rows of history that the model wants before its start

    def init(self, history: History) -> Any:
        """The carry that the model starts from after a history (`bcid.models.interface.Model.init`)."""
        return self.model.init(history)

    def scan(self, carry: Any, commands: Floats) -> tuple[Any, Floats]:
        """The carry after the commands (K, 2), or the means of parts (K, W, 4), and the twist (K, 3) after each."""
        twists = np.empty((len(commands), 3))
        for k, command in enumerate(commands if commands.ndim == 2 else mean_commands(commands)):
            carry, twists[k] = self.model.step(carry, command)
        return carry, twists


def load_user_model(name: str) -> UserModel:
    """The vehicle model returned by a user's function, which is imported by its name `module:function` and called.

    The model follows `bcid.models.interface.Model`.

    Raises:
        UsageError: there is no such function, it fails, or what it returns has no `init`, `step` or `period_s`.
    """
    module, _, function = name.partition(":")
    next_step = "name module:function, importable from here, or a file or folder that exists"
    if not (function.isidentifier() and all(part.isidentifier() for part in module.split("."))):
        raise UsageError(f"--simulation {name}: neither a file or folder nor module:function\n  next: {next_step}")
    sys.path.insert(0, str(Path.cwd()))
    try:
        made: Any = getattr(importlib.import_module(module), function)()
    # whatever the user's own code raises is the user's to read
    except Exception as error:
        raise UsageError(f"--simulation {name}: {type(error).__name__}: {error}\n  next: {next_step}") from error
    finally:
        sys.path.pop(0)
    missing = [m for m in ("init", "step", "period_s") if not hasattr(made, m)]
    if missing:
        raise UsageError(
            f"--simulation {name}: what it returns has no {', '.join(missing)}\n  next: see bcid.models.interface.Model"
        )
    return UserModel(made, name, float(made.period_s), int(getattr(made, "lags", 0)))


def simulate_with_model(model: UserModel, recording: Recording, estimate: Estimate) -> Recording:
    """The recording with its poses replaced by those that a user's model predicts from the estimate's commands.

    Predictions restart from the estimated motion every USER_MODEL_RESTART_S and after each gap.

    Raises:
        UsageError: the model steps by another period than the estimate.
    """
    if abs(model.period_s - estimate.period_s) > 1e-9:
        step, grid = f"{model.period_s:g} s", f"{estimate.period_s:g} s"
        raise UsageError(
            f"{model.name} steps by {step}, the grid by {grid}\n  next: set period_s in [estimate], or its step"
        )
    size = max(2, round(USER_MODEL_RESTART_S / estimate.period_s))
    times, poses, breaks = [], [], []
    for stretch in estimate.segments():
        for k in range(stretch.start, stretch.stop, size):
            stop = min(k + size, stretch.stop)
            twist = rollout(model, history_at(estimate, k, model.lags), estimate.parts[k : stop - 1])
            poses.append(integrate_poses(estimate.pose[k], twist, estimate.period_s))
            times.append(estimate.time_s[k:stop])
            breaks.append(float(estimate.time_s[k]))
    return replace(
        recording, poses=Stream(np.concatenate(times), np.concatenate(poses)), breaks_s=tuple(breaks[1:]),
        rate_hz=1.0 / estimate.period_s, channels={},
    )  # fmt: skip
