"""Where the mismatch is, before any hypothesis: channel, dependence, regime, place and time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bcid.aliases import Floats
from bcid.diagnosis.locate.pushes import CHANNELS, Disturbances
from bcid.diagnosis.locate.regression import Remainder
from bcid.diagnosis.locate.scan_statistic import Circle, Window, circles, windows
from bcid.diagnosis.locate.unexplained import Left
from bcid.likelihood.refit import Fit
from bcid.likelihood.take import Take

SIGNIFICANT = 0.01
TIMES = 1.5  # energy in a regime over that elsewhere, from which it is mentioned
FEWEST = 20  # knots of a regime


@dataclass(frozen=True)
class Location:
    """Where the pushes that a model needs are larger than it expects, or predictable."""

    left: Left  # beside the fit, all of it
    depends_on: tuple[str, ...]
    regime: str
    place: Circle | None
    place_p: float
    window: Window | None
    window_p: float

    @property
    def channel(self) -> str:
        """Where it enters."""
        return self.left.channel


def located(fit: Fit, take: Take, of: Disturbances, whole: Remainder) -> Location:
    """Where the disturbances `of` a fit stand out; `whole` is what of them is predictable."""
    found, place_p = circles(of, fit.hypothesis.units, 1)
    place = found[0] if place_p < SIGNIFICANT else None
    window, window_p = windows(of)
    i = CHANNELS.index(whole.channel)
    return Location(
        Left.by(of, whole, fit, take, place), whole.depends_on, regime(of, of.strength[:, i] ** 2), place, place_p,
        window if window_p < SIGNIFICANT else None, window_p,
    )  # fmt: skip


def regime(of: Disturbances, energies: Floats) -> str:
    """What the car does where the disturbances are largest, in words."""
    m = of.mean
    v, speed, u = m["v_x"], np.hypot(m["v_x"], m["v_y"]), m["u_m"]
    delta, rate, omega, alpha = (np.abs(m[n]) for n in ("delta", "delta_rate", "omega", "alpha_f"))
    fast, much, moving, sliding = (float(np.quantile(x, 0.75)) for x in (speed, delta, rate, alpha))
    straight, turning = float(np.quantile(delta, 0.25)), float(np.quantile(omega, 0.25))
    choices = {
        f"fast, above {fast:.2g} m/s": speed > fast,
        "reversing": v < -0.05 * fast,
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
        if inside.sum() >= FEWEST and (~inside).sum() >= FEWEST
    }
    far = sorted((w for w in ratios if ratios[w] > TIMES), key=lambda w: -ratios[w])[:2]
    return " and ".join(far) if far else "throughout"
