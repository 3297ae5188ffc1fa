"""Which drive of the catalogue tells two rival explanations apart."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats
from bcid.effects.table import ENTRIES
from bcid.experiment.manoeuvres import ARENA, Arena, Drive, catalogue, inside, usual_throttle
from bcid.experiment.simulate import STILL, simulated_take, states, undriven
from bcid.likelihood.hypothesis import PRIOR_SD, Hypothesis, Setting
from bcid.likelihood.marginal import Scales, eliminated, moments, products
from bcid.likelihood.newton import jacobian
from bcid.likelihood.nuisance import residuals, sensitivities
from bcid.likelihood.predict import wrapped
from bcid.likelihood.refit import Fit
from bcid.likelihood.score_test import GATE
from bcid.likelihood.take import Take

POSE_HZ = 20.0  # of the simulated takes: one pose per group
MOST_REPEATS = 50


@dataclass(frozen=True)
class Manoeuvre(Drive):
    """The drive that tells two rivals apart."""

    why: str
    score: float  # expected log-likelihood difference of one drive, nats
    repeats: int  # drives until it reaches GATE


def driven(
    drive: Drive, hypothesis: Hypothesis, phi: Floats, scales: Scales = STILL, seed: int = 0, rate_hz: float = POSE_HZ
) -> tuple[Take, Setting]:
    """The take that the car at `phi` gives of the drive, and its setting."""
    setting = hypothesis.setting(phi, undriven(drive.command_s, drive.command, drive.seconds, hypothesis.step_s))
    start = np.r_[drive.start, 0.0, 0.0, 0.0]
    return simulated_take(
        setting, drive.command_s, drive.command, drive.seconds, scales, rate_hz, seed, start
    ), setting  # fmt: skip


def information(take: Take, setting: Setting, scales: Scales, columns: Floats) -> Floats:
    """Every segment's information columns^T P columns (S, n, n) about changes of the prediction (N, 3, n).

    Initial states and pushes are eliminated.

    Raises:
        FloatingPointError: where they are lost in rounding.
    """
    A, still = sensitivities(take, setting, take.start), np.zeros_like(take.pose)
    V = eliminated(moments(still, A, take.first), scales).V
    return np.asarray(products(still, A, columns, take.first, scales.r, V)[1])


Explanation = Fit | tuple[Hypothesis, Floats]
"""A fit, or a hypothesis at some phi, of which then nothing but the prior is known."""


def _known(of: Explanation) -> tuple[Hypothesis, Floats, Floats]:
    """Hypothesis, phi, and what is known of those of phi that a refit would move: all, or the base parameters."""
    if isinstance(of, Fit):
        return of.hypothesis, of.phi, np.asarray(np.linalg.pinv(of.covariance), dtype=float)
    return *of, np.eye(of[0].base_size) / PRIOR_SD**2


class Separation(NamedTuple):
    """How far one drive tells two explanations apart: products of their difference and the refitted parameters."""

    square: float  # d^T P d
    slope: Floats  # (n,) J^T P d
    curvature: Floats  # (n, n) J^T P J
    known: Floats  # (n, n) information of the parameters before the drive

    def score(self, repeats: int = 1) -> float:
        """Expected difference of the log-likelihoods (nats) after so many drives, the parameters refitted."""
        total = repeats * self.curvature + self.known
        taken = np.linalg.lstsq(total, repeats * self.slope, rcond=None)[0]
        return 0.5 * repeats * float(self.square - self.slope @ taken)


def separation(drive: Drive, one: Explanation, other: Explanation, scales: Scales) -> Separation:
    """What `drive` shows of the difference when `one` is true, from the same simulated states."""
    hypothesis, phi, known = _known(one)
    rival, its_phi, _ = _known(other)
    take, setting = driven(drive, hypothesis, phi)
    r = residuals(take, setting, take.start)
    d = wrapped(residuals(take, rival.setting(its_phi, take), take.start) - r)
    J = jacobian(take, hypothesis, phi, take.start, r, range(len(known)))
    G = information(take, setting, scales, np.concatenate([J, d[:, :, None]], axis=2)).sum(axis=0)
    return Separation(float(G[-1, -1]), G[:-1, -1], G[:-1, :-1], known)


def best_manoeuvre(
    one: Explanation, other: Explanation, scales: Scales, arena: Arena = ARENA, top: float | None = None
) -> Manoeuvre | None:
    """The drive of the catalogue that tells two rival explanations apart best; None if none does.

    The score is the expected log-likelihood difference: half of sum d^T P d over the segments, d the difference of
    the two predictions from the same states, with initial states and pushes eliminated and what `one` refits
    projected out.  `top` is the largest throttle that may be commanded.
    """
    hypothesis, phi, _ = _known(one)
    if top is None:
        top = usual_throttle(hypothesis.car(phi), hypothesis.units)
    walls, found = arena._replace(margin=0.0), list[tuple[Drive, Separation]]()
    for drive in catalogue(hypothesis.car(phi), hypothesis.angle_limit, top, arena):
        with suppress(FloatingPointError, np.linalg.LinAlgError):  # what a take allows may not last a whole drive
            if inside(driven(drive, hypothesis, phi)[0].pose, walls):  # with the effects that `one` holds
                found.append((drive, separation(drive, one, other, scales)))
    if not found:
        return None
    drive, best = max(found, key=lambda pair: pair[1].score())
    repeats = next((n for n in range(1, MOST_REPEATS + 1) if best.score(n) >= GATE), None)
    if repeats is None:
        return None
    why = _why(hypothesis, _known(other)[0], drive, phi)
    return Manoeuvre(drive.name, drive.purpose, drive.command_s, drive.command, drive.start, why, best.score(), repeats)


def _why(one: Hypothesis, other: Hypothesis, drive: Drive, phi: Floats) -> str:
    """One sentence: what the two depend on, and how far the drive takes it."""
    ranges = _ranges(drive, one, phi)
    names = [n for n in (*one.effects, *other.effects) if (n in one.effects) != (n in other.effects)]
    told = [f"{n} depends on {' and '.join(ENTRIES[n].depends_on)}" for n in names]
    words = list(dict.fromkeys(w for n in names for w in ENTRIES[n].depends_on)) or ["v_x", "steering"]
    spans = [ranges[w] for w in words]
    return f"{'; '.join(told) or 'they differ in the base parameters'}: this drive has {', '.join(spans)}."


def _ranges(drive: Drive, hypothesis: Hypothesis, phi: Floats) -> dict[str, str]:
    """How far each quantity that an effect may depend on goes in the drive, in words."""
    setting = hypothesis.setting(phi, undriven(drive.command_s, drive.command, drive.seconds, hypothesis.step_s))
    path = states(setting, drive.seconds, STILL, 0, np.r_[drive.start, 0.0, 0.0, 0.0])
    p, delta, u = setting.car, setting.chain.delta[::2], drive.command[:, 1]
    v_x, v_y, omega = path[:, 3:].T
    hub, rear = v_y + p.l_f * omega, v_y - p.l_r * omega
    along, across = np.cos(delta) * v_x + np.sin(delta) * hub, np.cos(delta) * hub - np.sin(delta) * v_x
    wide = np.ptp(path[:, :2], axis=0)

    def span(word: str, values: Floats, unit: str) -> str:
        low, high = np.quantile(values, [0.01, 0.99])
        return f"{word} from {low:.2f} to {high:.2f} {unit}".rstrip()

    return {
        "v_x": span("v_x", v_x, "m/s"),
        "v_y": span("v_y", v_y, "m/s"),
        "speed": span("speed", np.hypot(v_x, v_y), "m/s"),
        "yaw_rate": span("yaw rate", omega, "rad/s"),
        "steering": span("steering", delta, "rad"),
        "steering_rate": span("steering rate", np.gradient(delta, setting.chain.h), "rad/s"),
        "throttle": span("throttle", np.maximum(u, 0.0), ""),
        "braking": span("braking", np.maximum(-u, 0.0), ""),
        "alpha_f": span("front slip", np.arctan(across / np.maximum(np.abs(along), p.v_0)), "rad"),
        "alpha_r": span("rear slip", np.arctan(rear / np.maximum(np.abs(v_x), p.v_0)), "rad"),
        "place": f"{wide[0]:.1f} by {wide[1]:.1f} m of floor",
        "heading": span("heading", path[:, 2], "rad"),
        "time": f"{drive.seconds:.0f} s",
    }
