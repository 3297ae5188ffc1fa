"""Where a fit's mismatch is, before any hypothesis: channels, dependence, regime, place and time.

Channels and dependence are those of the remainder, the free functions that make the take likelier
(`bcid.diagnosis.remainder`); regime, place and time those at which disturbances are large.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from bcid.aliases import Floats
from bcid.diagnosis.limits import LOCATE_LIMITS
from bcid.diagnosis.locate.pushes import Disturbances
from bcid.diagnosis.locate.scan_statistic import FloorCircle, TimeWindow, scan_circles, scan_windows
from bcid.effects.entry import VehicleScale

PUSHED_BY = {"fx": (0,), "motor": (0,), "fy": (1, 2), "steering": (1, 2), "mz": (2,)}
"""Components of a push that what acts in a channel changes; those of the others may be any."""


@dataclass(frozen=True)
class Location:
    """Where the pushes that a model needs are larger than it expects, and what free functions explain."""

    channel: str | None  # in which free functions explain most; None where they explain nothing
    channel_nats: Mapping[str, float]  # that those of each channel add beside the others', most first
    depends_on: tuple[str, ...]
    regime: str
    place: FloorCircle | None
    place_p_value: float
    window: TimeWindow | None
    window_p_value: float


def locate_mismatch(
    channel_nats: Mapping[str, float], depends_on: Callable[[str], tuple[str, ...]], disturbances: Disturbances,
    units: VehicleScale,
) -> Location:  # fmt: skip
    """Describe where the residuals of a fit come from: channels, dependence, driving regime, place and time.

    `channel_nats` are what free functions of each channel explain beside the fit, most first, and `depends_on` says of
    a channel on which quantities that depends.  `disturbances` are the accelerations of the body that the fit does not
    explain, constant over 0.25 s; `units` are the vehicle's.  Place and time come from a scan statistic with a
    permutation test, and are None where its p-value is not below `LOCATE_LIMITS.significant_p_value`.
    """
    channel = next(iter(channel_nats), None)
    circles, place_p = scan_circles(disturbances, units, 1)
    place = circles[0] if place_p < LOCATE_LIMITS.significant_p_value else None
    window, window_p = scan_windows(disturbances)
    shown = window if window_p < LOCATE_LIMITS.significant_p_value else None
    energies = (disturbances.strength**2)[:, list(PUSHED_BY.get(channel or "", (0, 1, 2)))].sum(axis=1)
    regime = describe_regime(disturbances, energies)
    quantities = depends_on(channel) if channel else ()
    return Location(channel, channel_nats, quantities, regime, place, place_p, shown, window_p)


def describe_regime(disturbances: Disturbances, energies: Floats) -> str:
    """Name in words the driving regimes, such as "braking and turning left", in which the `energies` (K,) are largest.

    The energies are squared disturbances at K knots of 0.25 s.  A regime is named if its mean energy is more than
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
