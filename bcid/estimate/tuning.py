"""What the EKF needs beside the vehicle file: noise, and the steering's constants where they are absent."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

from bcid.estimate import noise as noises
from bcid.estimate import steering
from bcid.estimate.events import timeline
from bcid.estimate.noise import Noise
from bcid.estimate.process import Chassis
from bcid.recording.types import Recording
from bcid.vehicle import Vehicle


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
    """Noise by likelihood (except what is `given`); steering constants first where the vehicle file omits them."""
    T_s, d, facts = steering.identify(recordings, vehicle)
    tuning = Tuning(Noise(**given), T_s, d, facts)
    events = [timeline(r, vehicle, period_s, max_gap_s, T_s, d).events for r in recordings]
    noise, edge = noises.identify(events, tuning.chassis(vehicle), tuning.noise, list(given))
    return Tuning(noise, T_s, d, {**facts, "noise_at_bound": edge})
