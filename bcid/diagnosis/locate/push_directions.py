"""In which directions pushes lie: along or across a wheel, along the body, over the floor, as the steered wheel turns.

What is missing at one place of a car pushes it in the directions of that place, whatever it depends on, even on
something that nobody recorded; trees (`regression`) and basis functions (`channel_gains`) are blind to that.  A rough
floor pushes a car alike along and across and turns it at random.  So the pushes p_s (9,) that the poses of a segment
show, with covariance C_s, are

    p_s ~ t_nu(0, C_s + blockdiag_k(sum_j a_j^2 d_jk d_jk^T)),

d_jk being direction j at knot k, and a_j the size of the pushes along it, which is found by maximum likelihood.
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

# Logarithms of a_j over the median push: bounds to both sides, and where a search starts for one of two directions,
# of which the other may have nearly all there is.
LOG_AMPLITUDE_RANGE, FAINT_LOG_AMPLITUDE = 6.0, -3.0


class PushDirection(NamedTuple):
    """Directions at every knot in which physics that is missing at one place of the car pushes."""

    channel: str
    description: str
    vectors: tuple[Floats, ...]  # (K, 3) each, in N, N and N m for a push of its own unit


class DirectionGain(NamedTuple):
    """Gain of log-likelihood when pushes lie in one direction rather than being those of a rough floor alone."""

    channel: str
    description: str
    gain_nats: float  # of BIC


def direction_gains(disturbances: Disturbances, car: Car) -> tuple[DirectionGain, ...]:
    """Log-likelihood gain (nats, BIC) of a preferred direction of the disturbances: the best of each channel.

    Two models of the disturbances at 0.5 s knots are compared, both with Student's t: random along, across and about
    the body alone, and the same with an additional random part along one direction.  Standard deviations are fitted
    by maximum likelihood; ln(segments) / 2 is deducted for each additional one.  Sorted by gain, largest first; empty
    if no segment shows disturbances.
    """
    seen = _SegmentPushes.from_disturbances(disturbances, car)
    if not len(seen.segment):
        return ()
    length, best = 0.5 * (car.l_f + car.l_r), dict[str, DirectionGain]()
    per_knot = (len(seen.segment), KNOTS, 3, 3)
    rough = [np.broadcast_to(np.diag(f), per_knot) for f in ([1.0, 1.0, 0.0], [0.0, 0.0, length**2])]
    rough_alone = seen.max_log_likelihood(rough, 0)
    for direction in list_push_directions(disturbances, car):
        along = [seen.outer_products(vectors) for vectors in direction.vectors]
        price = 0.5 * len(along) * float(np.log(len(seen.push)))
        nats = seen.max_log_likelihood([*along, *rough], len(along)) - rough_alone - price
        gain = DirectionGain(direction.channel, direction.description, nats)
        best[gain.channel] = max(best.get(gain.channel, gain), gain, key=lambda g: g.gain_nats)
    return tuple(sorted(best.values(), key=lambda g: -g.gain_nats))


def list_push_directions(disturbances: Disturbances, car: Car) -> list[PushDirection]:
    """The 15 directions in which missing physics could act on the body, such as along the front wheel.

    Each has its channel and vectors (K, 3), F_x, F_y (N), M_z (N m) in the body frame, one for each 0.5 s knot of the
    disturbances; some are proportional to a force or a speed at the knot.
    """
    m = disturbances.states
    sin_d, cos_d, sin_t, cos_t = np.sin(m["delta"]), np.cos(m["delta"]), np.sin(m["theta"]), np.cos(m["theta"])
    one, none = np.ones_like(sin_d), np.zeros_like(sin_d)
    F_af = np.clip(-car.C_f * m["alpha_f"], -car.F_f_max, car.F_f_max)
    F_ar = np.clip(-car.C_r * m["alpha_r"], -car.F_r_max, car.F_r_max)
    wheel = np.column_stack([cos_d, sin_d, car.l_f * sin_d])
    front = np.column_stack([-sin_d, cos_d, car.l_f * cos_d])
    rear, body = np.column_stack([none, one, -car.l_r * one]), np.column_stack([one, none, none])
    drive, about = car.front_share * wheel + (1.0 - car.front_share) * body, np.column_stack([none, none, one])
    holds = np.where(np.abs(F_af) < car.F_f_max, car.C_f, 0.0)
    turned = _scale_rows(car.front_share * m["F_m"] + holds, front) - _scale_rows(F_af, wheel)
    driving = np.where(m["u_m"] > 0.0, 1.0, 0.0)
    rows: tuple[tuple[str, str, tuple[Floats, ...]], ...] = (
        ("fx", "along the body", (body,)),
        ("fx", "along the body, the more the faster it goes", (_scale_rows(m["v_x"], body),)),
        ("fx", "along the front wheel", (wheel,)),
        ("fx", "along the front wheel, the more the faster it goes", (_scale_rows(m["v_x"], wheel),)),
        ("fx", "along the floor's x", (np.column_stack([cos_t, -sin_t, none]),)),
        ("fx", "along the floor's y", (np.column_stack([sin_t, cos_t, none]),)),
        ("motor", "along the driven wheels, the more the harder they drive", (_scale_rows(m["F_m"], drive),)),
        ("motor", "along the driven wheels while they drive", (_scale_rows(driving, drive),)),
        ("fy", "across the front wheel", (front,)),
        ("fy", "across the front wheel, the more the larger its side force", (_scale_rows(F_af, front),)),
        ("fy", "across the rear wheels", (rear,)),
        ("fy", "across the rear wheels, the more the larger their side force", (_scale_rows(F_ar, rear),)),
        ("fy", "across all wheels", (front, rear)),
        ("mz", "about the yaw axis, the more the faster it turns", (_scale_rows(m["omega"], about),)),
        ("steering", "as if the front wheel turned", (turned,)),
    )
    return [PushDirection(*row) for row in rows]


def _scale_rows(size: Floats, direction: Floats) -> Floats:
    """Multiply row k of `direction` (K, 3) by the factor `size[k]`."""
    return np.asarray(size)[:, None] * direction


class _SegmentPushes(NamedTuple):
    """Pushes as the poses alone show them, of the n segments that show any."""

    push: Floats  # (n, 3 KNOTS) N, N and N m
    covariance: Floats  # (n, 3 KNOTS, 3 KNOTS) their covariance
    segment: Ints  # (n,) the segments

    @classmethod
    def from_disturbances(cls, disturbances: Disturbances, car: Car) -> _SegmentPushes:
        """Pushes as forces, from accelerations and the car's inertia; segments without finite pushes are left out."""
        inertia = np.tile([car.m, car.m, car.I_z], KNOTS)
        push, covariance = disturbances.poses_only, disturbances.poses_only_covariance
        shown = np.flatnonzero(np.isfinite(push).all(axis=1) & np.isfinite(covariance).all(axis=(1, 2)))
        return cls((push * inertia)[shown], (covariance * np.outer(inertia, inertia))[shown], shown)

    def outer_products(self, vectors: Floats) -> Floats:
        """Outer products d d^T of directions (K, 3) over their mean square, by segment and knot: (n, KNOTS, 3, 3)."""
        here = vectors.reshape(-1, KNOTS, 3)[self.segment]
        size = max(float(np.mean(np.sum(here**2, axis=2))), 1e-12)
        return np.asarray(np.einsum("ska,skb->skab", here, here) / size)

    def max_log_likelihood(self, squares: Sequence[Floats], along: int) -> float:
        """Largest log-likelihood of the pushes, less a constant, over the sizes a_j of the covariances `squares`.

        The search starts once with the first `along` of them large and the others faint, and once the other way round.
        """
        from scipy.optimize import minimize

        usual = float(np.log(np.median(np.abs(self.push)) + 1e-9))
        first, rest = np.zeros(len(squares)), np.zeros(len(squares))
        first[along:], rest[:along] = FAINT_LOG_AMPLITUDE, FAINT_LOG_AMPLITUDE
        bounds = [(usual - LOG_AMPLITUDE_RANGE, usual + LOG_AMPLITUDE_RANGE)] * len(squares)
        objective, starts = self._negative_log_likelihood, (usual + first, usual + rest)
        fits = [minimize(objective, start, (squares,), "L-BFGS-B", jac=True, bounds=bounds) for start in starts]
        return max(-float(fit.fun) for fit in fits)

    def _negative_log_likelihood(self, log_a: Floats, squares: Sequence[Floats]) -> tuple[float, Floats]:
        """Minus the log-likelihood of the pushes, less a constant, and its gradient by the logarithms of the a_j."""
        cov, knots = self.covariance.copy(), [slice(3 * k, 3 * k + 3) for k in range(KNOTS)]
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
