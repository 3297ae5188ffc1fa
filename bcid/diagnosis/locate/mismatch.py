"""Where a fit's mismatch is, before any hypothesis: what is left by channels, dependence, regime, place and time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats
from bcid.diagnosis.limits import LOCATE_LIMITS
from bcid.diagnosis.locate.channel_gains import channel_gains
from bcid.diagnosis.locate.push_directions import DirectionGain, direction_gains
from bcid.diagnosis.locate.pushes import WRENCH_CHANNELS, Disturbances, estimate_disturbances
from bcid.diagnosis.locate.regression import DisturbanceRegression, regress_disturbances
from bcid.diagnosis.locate.scan_statistic import FloorCircle, TimeWindow, scan_circles, scan_windows
from bcid.likelihood.refit import Fit
from bcid.likelihood.take import Take

MEASUREMENT_CHANNELS = ("pose", "time")


class RemainingMismatch(NamedTuple):
    """What a fit leaves unexplained in three views: trees, basis functions at every place of a car, push directions."""

    regression: DisturbanceRegression
    channel_gains: Mapping[str, float]  # nats that basis functions in each channel would gain, most first
    direction_gains: tuple[DirectionGain, ...]  # of the best direction in each channel, the likeliest first

    @classmethod
    def beside(cls, fit: Fit, take: Take, place: FloorCircle | None = None) -> RemainingMismatch:
        """What a fit leaves unexplained of a take; `place` is a circle that stands out on the floor."""
        disturbances, car = estimate_disturbances(fit, take), fit.car()
        regression = regress_disturbances(disturbances, car)
        return cls(regression, channel_gains(fit, take, place), direction_gains(disturbances, car))

    @property
    def channel(self) -> str:
        """The channel in which the remaining mismatch enters.

        It is the one whose basis functions gain most, or the one in whose direction pushes lie if that gains more.  A
        wrong measurement seems to push in any direction: where its functions gain most, no direction counts.  Where
        neither explains much of what trees predict, it is the channel in which they predict most.
        """
        least = max(LOCATE_LIMITS.min_gain_nats, LOCATE_LIMITS.min_predicted_share * self._regression_nats)
        first = next(iter(self.channel_gains))
        direction = next(iter(self.direction_gains), None)
        nats = direction.gain_nats if direction else 0.0
        if self.channel_gains[first] > least and (first in MEASUREMENT_CHANNELS or self.channel_gains[first] > nats):
            return first
        return direction.channel if direction and nats > least else self.regression.channel

    @property
    def _regression_nats(self) -> float:
        """Nats that trees predict of the disturbances, 0 where that may be chance."""
        return self.regression.gain_nats if self.regression.predictable else 0.0

    def significant_direction(self, gate: float) -> DirectionGain | None:
        """Direction in which the remaining channel's pushes lie, if it gains more than `gate` nats."""
        first = next(iter(self.direction_gains), None)
        return first if first and first.gain_nats > gate and first.channel == self.channel else None

    def gain_nats(self, gate: float) -> float:
        """Nats that explaining the remaining mismatch would gain: the largest of the three views.

        Gains of basis functions and directions count beyond the `gate`, which chance does not reach.
        """
        views = (max(self.channel_gains.values()), max((d.gain_nats for d in self.direction_gains), default=0.0))
        return max(self._regression_nats, *(nats if nats > gate else 0.0 for nats in views))


@dataclass(frozen=True)
class Location:
    """Where the pushes that a model needs are larger than it expects, or predictable."""

    remaining: RemainingMismatch
    depends_on: tuple[str, ...]
    regime: str
    place: FloorCircle | None
    place_p_value: float
    window: TimeWindow | None
    window_p_value: float


def locate_mismatch(fit: Fit, take: Take, disturbances: Disturbances, regression: DisturbanceRegression) -> Location:
    """Describe where the residuals of a fit come from: channel, dependence, driving regime, place and time.

    `disturbances` are the accelerations of the body that the fit does not explain, constant over 0.5 s; `regression`
    is their prediction from the car's state by regression trees.  Channels are compared by the log-likelihood gain of
    simple functions of the state.  Place and time come from a scan statistic with a permutation test, and are None
    where its p-value is not below `LOCATE_LIMITS.significant_p_value`.
    """
    circles, place_p = scan_circles(disturbances, fit.hypothesis.units, 1)
    place = circles[0] if place_p < LOCATE_LIMITS.significant_p_value else None
    window, window_p = scan_windows(disturbances)
    energies = disturbances.strength[:, WRENCH_CHANNELS.index(regression.channel)] ** 2
    remaining = RemainingMismatch(regression, channel_gains(fit, take, place), direction_gains(disturbances, fit.car()))
    regime = describe_regime(disturbances, energies)
    shown = window if window_p < LOCATE_LIMITS.significant_p_value else None
    return Location(remaining, regression.depends_on, regime, place, place_p, shown, window_p)


def describe_regime(disturbances: Disturbances, energies: Floats) -> str:
    """Name in words the driving regimes, such as "braking and turning left", in which the `energies` (K,) are largest.

    The energies are squared disturbances at K knots of 0.5 s.  A regime is named if its mean energy is more than
    `LOCATE_LIMITS.min_regime_energy_ratio` times the mean outside it, at most the `max_regimes` with the largest ratio;
    "throughout" if there is none.
    """
    m = disturbances.states
    v, speed, u = m["v_x"], np.hypot(m["v_x"], m["v_y"]), m["u_m"]
    delta, rate, omega, alpha = (np.abs(m[n]) for n in ("delta", "delta_rate", "omega", "alpha_f"))
    q = LOCATE_LIMITS.regime_quantile
    fast, much, moving, sliding = (float(np.quantile(x, q)) for x in (speed, delta, rate, alpha))
    straight, turning = (float(np.quantile(x, 1.0 - q)) for x in (delta, omega))
    choices = {
        f"fast, above {fast:.2g} m/s": speed > fast,
        "reversing": v < -LOCATE_LIMITS.min_reversing_share * fast,
        "braking": u < 0.0,
        "throttle": u > 0.0,
        f"steering beyond {much:.2g} rad": delta > much,
        "steering to the left": m["delta"] > straight,
        "steering to the right": m["delta"] < -straight,
        "nearly straight": delta < straight,
        "steering moving": rate > moving,
        f"front slip beyond {sliding:.2g} rad": alpha > sliding,
        "turning left": m["omega"] > turning,
        "turning right": m["omega"] < -turning,
    }
    ratios = {
        words: float(energies[inside].mean() / max(energies[~inside].mean(), 1e-9))
        for words, inside in choices.items()
        if min(inside.sum(), (~inside).sum()) >= LOCATE_LIMITS.min_regime_knots
    }
    high = [words for words, ratio in ratios.items() if ratio > LOCATE_LIMITS.min_regime_energy_ratio]
    strongest = sorted(high, key=lambda words: -ratios[words])[: LOCATE_LIMITS.max_regimes]
    return " and ".join(strongest) or "throughout"
