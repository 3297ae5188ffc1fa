"""What the EKF needs beside the vehicle file: noise, and the steering's constants where they are absent."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

from bcid.estimate import noise as noises
from bcid.estimate import steering
from bcid.estimate.events import timeline
from bcid.estimate.kernel import Events, run_filter, run_smoother
from bcid.estimate.noise import Noise
from bcid.estimate.outputs import twists
from bcid.estimate.process import BETAF, VF, Chassis
from bcid.recording.types import Recording
from bcid.vehicle import Vehicle

DEFAULT_TIME_CONSTANT_S = 0.15  # a small servo; used until the fit has found it
DEFAULT_RATE_RADPS = 3.0


@dataclass(frozen=True)
class Tuning:
    """The estimator's constants and how they came about."""

    noise: Noise
    T_s: float
    d: float
    facts: Mapping[str, Any] = field(default_factory=dict)

    def chassis(self, vehicle: Vehicle) -> Chassis:
        """The process model's constants."""
        body = vehicle.body
        return Chassis(body.cog_to_front_m, body.cog_to_rear_m, self.T_s, self.d, vehicle.front_share >= 0.5)

    def as_json(self) -> dict[str, Any]:
        """For the artifact."""
        return asdict(self)

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Tuning:
        """The inverse of `as_json`."""
        return cls(Noise(**data["noise"]), data["T_s"], data["d"], data["facts"])


def tune(
    recordings: Sequence[Recording], vehicle: Vehicle, period_s: float, max_gap_s: float, given: Mapping[str, float]
) -> Tuning:
    """Noise by likelihood (except what is `given`); steering constants where the vehicle file omits them.

    The filter first runs with documented defaults, then again with what was identified.
    """
    events = [timeline(r, vehicle, period_s, max_gap_s).events for r in recordings]
    known = vehicle.steering
    tuning = Tuning(
        Noise(**given), known.time_constant_s or DEFAULT_TIME_CONSTANT_S, known.max_rate_radps or DEFAULT_RATE_RADPS
    )
    tuning = _with_noise(tuning, events, vehicle, given)
    if known.time_constant_s is None or known.max_rate_radps is None:
        wheels = [_wheel(e, tuning, vehicle) for e in events]
        T_s, d, facts = steering.identify(wheels, known.time_constant_s, known.max_rate_radps)
        tuning = _with_noise(Tuning(tuning.noise, T_s, d, facts), events, vehicle, given)
    return tuning


def _with_noise(tuning: Tuning, events: Sequence[Events], vehicle: Vehicle, given: Mapping[str, float]) -> Tuning:
    noise = noises.identify(events, tuning.chassis(vehicle), tuning.noise, list(given))
    return Tuning(noise, tuning.T_s, tuning.d, tuning.facts)


def _wheel(events: Events, tuning: Tuning, vehicle: Vehicle) -> steering.Wheel:
    chassis = tuning.chassis(vehicle)
    filtered = run_filter(events, chassis, tuning.noise.Q(), tuning.noise.R())
    x, _ = run_smoother(filtered, events.restart)
    return steering.Wheel(events.time_s, events.u_s, x[:, BETAF], x[:, VF], twists(x, chassis)[:, 2])
