"""Where the mismatch is, before any hypothesis: channel, dependence, regime, place and time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bcid.diagnosis.channels import entered, explained_by
from bcid.diagnosis.disturbance import CHANNELS, Disturbances
from bcid.diagnosis.refit import Fit
from bcid.diagnosis.remainder import Remainder
from bcid.diagnosis.scan import Circle, Window, circles, windows
from bcid.diagnosis.take import Floats, Take

SIGNIFICANT = 0.01
TIMES = 1.5  # energy in a regime over that elsewhere, from which it is mentioned
FEWEST = 20  # knots of a regime


@dataclass(frozen=True)
class Location:
    """Where the pushes that a model needs are larger than it expects, or predictable."""

    channel: str  # where it enters
    entering: dict[str, float]  # nats that free functions in each channel would gain, most first
    depends_on: tuple[str, ...]
    regime: str
    place: Circle | None
    place_p: float
    window: Window | None
    window_p: float
    whole: Remainder  # what of the disturbances is predictable


def located(fit: Fit, take: Take, of: Disturbances, whole: Remainder) -> Location:
    """Where the disturbances `of` a fit stand out; `whole` is what of them is predictable."""
    found, place_p = circles(of, 1)
    place = found[0] if place_p < SIGNIFICANT else None
    window, window_p = windows(of)
    entering = explained_by(fit, take, place)
    i = CHANNELS.index(whole.channel)
    return Location(
        entered(entering, whole), entering, whole.depends_on, regime(of, of.strength[:, i] ** 2), place, place_p,
        window if window_p < SIGNIFICANT else None, window_p, whole,
    )  # fmt: skip


def regime(of: Disturbances, energies: Floats) -> str:
    """What the car does where the disturbances are largest, in words."""
    m = of.mean
    v, delta, rate, u = m["v_x"], np.abs(m["delta"]), np.abs(m["delta_rate"]), m["u_m"]
    fast = np.quantile(np.hypot(v, m["v_y"]), 0.75)
    choices = {
        f"fast, above {fast:.1f} m/s": np.hypot(v, m["v_y"]) > fast,
        "reversing": v < -0.05,
        "braking": u < 0.0,
        "throttle": u > 0.0,
        "steering beyond 0.8 rad": delta > 0.8,
        "steering to the left": m["delta"] > 0.15,
        "steering to the right": m["delta"] < -0.15,
        "nearly straight": delta < 0.15,
        "steering moving": rate > 0.3,
        "front tyre near its grip": np.abs(m["alpha_f"]) > 0.15,
        "turning left": m["omega"] > 0.2,
        "turning right": m["omega"] < -0.2,
    }
    ratios = {
        words: float(energies[inside].mean() / max(energies[~inside].mean(), 1e-9))
        for words, inside in choices.items()
        if inside.sum() >= FEWEST and (~inside).sum() >= FEWEST
    }
    far = sorted((w for w in ratios if ratios[w] > TIMES), key=lambda w: -ratios[w])[:2]
    return " and ".join(far) if far else "throughout"
