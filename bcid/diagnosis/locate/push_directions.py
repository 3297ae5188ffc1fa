"""Where pushes lie: along a wheel, across a tyre, along the body, over the floor, as a turn of the steered wheel.

What is missing at one place of a car pushes it in the directions of that place, whatever it depends on, were it on
something that nobody saw; trees and free functions (`remainder`, `channels`) are blind for that.  A rough floor pushes
alike along and across a car and turns it as it likes.  So the pushes p_s (9,) that the poses of a segment show, give or
take their covariance C_s, are

    p_s ~ t_nu(0, C_s + blockdiag_k(sum_j a_j^2 d_jk d_jk^T)),

d_jk being direction j at knot k, and a_j how far pushes go along it: all that is to be found.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats, Ints
from bcid.diagnosis.locate.pushes import Disturbances
from bcid.likelihood.marginal import NU
from bcid.likelihood.take import KNOTS
from bcid.physics.car import Car

WIDE = 6.0  # logarithm of a_j against what a median push asks for, at the most and at the least
FAINT = -3.0  # the same, from which a search begins: one direction may have nearly all there is


class Way(NamedTuple):
    """Directions in which physics that is missing at one place pushes."""

    channel: str
    words: str
    d: tuple[Floats, ...]  # (K, 3) each, in N, N and N m for a push of its own unit


class Lying(NamedTuple):
    """How much likelier pushes are where they lie one way than as a rough floor's alone."""

    channel: str
    words: str
    nats: float  # of BIC


def lying(of: Disturbances, car: Car) -> tuple[Lying, ...]:
    """The best way of each channel that pushes, the likeliest first; none where no segment shows any push."""
    seen = _Seen.by(of, car)
    if not len(seen.of):
        return ()
    length, found = 0.5 * (car.l_f + car.l_r), dict[str, Lying]()
    rough = [seen.every(np.diag(f)) for f in ([1.0, 1.0, 0.0], [0.0, 0.0, length**2])]
    nothing = seen.best(rough, 0)
    for way in ways(of, car):
        along = [seen.along(d) for d in way.d]
        charged = 0.5 * len(along) * float(np.log(len(seen.push)))
        here = Lying(way.channel, way.words, seen.best([*along, *rough], len(along)) - nothing - charged)
        found[way.channel] = max(found.get(way.channel, here), here, key=lambda x: x.nats)
    return tuple(sorted(found.values(), key=lambda x: -x.nats))


def ways(of: Disturbances, car: Car) -> list[Way]:
    """Every way that is tried, at the knots' mean states; some in proportion to a force or speed that may rule them."""
    m = of.mean
    sin_d, cos_d, sin_t, cos_t = np.sin(m["delta"]), np.cos(m["delta"]), np.sin(m["theta"]), np.cos(m["theta"])
    one, none = np.ones_like(sin_d), np.zeros_like(sin_d)
    F_af = np.clip(-car.C_f * m["alpha_f"], -car.F_f_max, car.F_f_max)
    F_ar = np.clip(-car.C_r * m["alpha_r"], -car.F_r_max, car.F_r_max)
    wheel = np.column_stack([cos_d, sin_d, car.l_f * sin_d])
    front = np.column_stack([-sin_d, cos_d, car.l_f * cos_d])
    rear, body = np.column_stack([none, one, -car.l_r * one]), np.column_stack([one, none, none])
    drive, about = car.front_share * wheel + (1.0 - car.front_share) * body, np.column_stack([none, none, one])
    holds = np.where(np.abs(F_af) < car.F_f_max, car.C_f, 0.0)
    turned = _times(car.front_share * m["F_m"] + holds, front) - _times(F_af, wheel)
    return [
        Way("fx", "along the body", (body,)),
        Way("fx", "along the body, the more the faster it goes", (_times(m["v_x"], body),)),
        Way("fx", "along the front wheel", (wheel,)),
        Way("fx", "along the front wheel, the more the faster it goes", (_times(m["v_x"], wheel),)),
        Way("fx", "along the floor's x", (np.column_stack([cos_t, -sin_t, none]),)),
        Way("fx", "along the floor's y", (np.column_stack([sin_t, cos_t, none]),)),
        Way("motor", "along the driven wheels, the more the harder they drive", (_times(m["F_m"], drive),)),
        Way("motor", "along the driven wheels while they drive", (_times(np.where(m["u_m"] > 0.0, 1.0, 0.0), drive),)),
        Way("fy", "across the front wheel", (front,)),
        Way("fy", "across the front wheel, the more the larger its side force", (_times(F_af, front),)),
        Way("fy", "across the rear wheels", (rear,)),
        Way("fy", "across the rear wheels, the more the larger their side force", (_times(F_ar, rear),)),
        Way("fy", "across all wheels", (front, rear)),
        Way("mz", "about the yaw axis, the more the faster it turns", (_times(m["omega"], about),)),
        Way("steering", "as if the front wheel turned", (turned,)),
    ]


def _times(size: Floats, direction: Floats) -> Floats:
    return np.asarray(size)[:, None] * direction


class _Seen(NamedTuple):
    """Pushes as the poses show them, of n segments that show any."""

    push: Floats  # (n, 3 KNOTS) N, N and N m
    doubt: Floats  # (n, 3 KNOTS, 3 KNOTS) their covariance
    of: Ints  # (n,) the segments

    @classmethod
    def by(cls, of: Disturbances, car: Car) -> _Seen:
        """In units of force."""
        inertia = np.tile([car.m, car.m, car.I_z], KNOTS)
        shown = np.flatnonzero(np.isfinite(of.seen).all(axis=1) & np.isfinite(of.doubt).all(axis=(1, 2)))
        return cls((of.seen * inertia)[shown], (of.doubt * np.outer(inertia, inertia))[shown], shown)

    def every(self, square: Floats) -> Floats:
        """The same (3, 3) at every knot: (n, KNOTS, 3, 3)."""
        return np.broadcast_to(square, (len(self.of), KNOTS, 3, 3))

    def along(self, d: Floats) -> Floats:
        """The squares of directions (K, 3), of which the mean is 1: (n, KNOTS, 3, 3)."""
        here = d.reshape(-1, KNOTS, 3)[self.of]
        size = max(float(np.mean(np.sum(here**2, axis=2))), 1e-12)
        return np.asarray(np.einsum("ska,skb->skab", here, here) / size)

    def best(self, squares: Sequence[Floats], along: int) -> float:
        """The largest log-likelihood over all a_j of `squares`, of which the first `along` are a way's."""
        from scipy.optimize import minimize

        usual = float(np.log(np.median(np.abs(self.push)) + 1e-9))
        first, rest = np.zeros(len(squares)), np.zeros(len(squares))
        first[along:], rest[:along] = FAINT, FAINT
        bounds = [(usual - WIDE, usual + WIDE)] * len(squares)
        return max(
            -float(minimize(self._slope, usual + start, (squares,), "L-BFGS-B", jac=True, bounds=bounds).fun)
            for start in (first, rest)
        )

    def _slope(self, log_a: Floats, squares: Sequence[Floats]) -> tuple[float, Floats]:
        """Minus the log-likelihood, less a constant, and its slope by log a_j."""
        cov, knots = self.doubt.copy(), [slice(3 * k, 3 * k + 3) for k in range(KNOTS)]
        for a, square in zip(np.exp(2.0 * log_a), squares, strict=True):
            for k, at in enumerate(knots):
                cov[:, at, at] += a * square[:, k]
        P = np.linalg.inv(cov)
        y = np.einsum("sij,sj->si", P, self.push)
        chi2, n = np.einsum("si,si->s", y, self.push), self.push.shape[1]
        value = 0.5 * np.linalg.slogdet(cov)[1] + 0.5 * (NU + n) * np.log1p(chi2 / NU)
        weight, slope = (NU + n) / (NU + chi2), np.zeros(len(squares))
        for k, at in enumerate(knots):
            there = 0.5 * (P[:, at, at] - np.einsum("s,sa,sb->sab", weight, y[:, at], y[:, at]))
            slope += [float(np.sum(there * square[:, k])) for square in squares]
        return float(value.sum()), slope * 2.0 * np.exp(2.0 * log_a)
