"""The filter that adapts a car: an extended Kalman filter over its states and the adapted quantities, compiled.

Between two poses, a period T apart,

    z^- = f(z, u),   P^- = F P F' + Q,   Q = T diag(q^2) on the twist (what the model lacks pushes it),
                                         Q = (1 - exp(-2 T/tau_d)) diag(sd_d^2) on what lasts of that,

and before that the quantities forget, with the time tau, what was learnt of them: with a = 1 - exp(-T/tau) and P_0
their variance at first,

    P_qq <- (1 - a) P_qq + a P_0,   P_xq <- (1 - a)^1/2 P_xq,

so that the variance of one that a drive does not show returns to P_0 and never grows beyond it.  Over a gap without
poses, after which the state x begins anew, they forget by the same rule, with the gap's length in place of T.  Where
the state x that a pose gives depends on the quantities, as where the tracked point is, they vary together from the
start: with G = dx/dq and P_0x what is not known of the pose, twist and steering angle,

    P_xx = P_0x + G P_qq G',   P_xq = G P_qq.

At a pose y the three numbers enter one after the other: e = y - h(z), s = H P H' + r^2, K = P H'/s, z + K e,
P - s K K'.  An innovation of more than `OUTLIER` standard deviations counts as one of so many: s is then
e^2 / OUTLIER^2, and a wrong pose moves the state by a bounded amount.  After it the variance of where the car is is
e^2 / OUTLIER^2 / `JUMP_POSES` more: a single wrong pose changes nothing, as the next one says where the car is; after
some that agree, as where the origin of the tracking system was moved, the car is where they say.  A quantity that
leaves its bounds is set to the bound, and all others go with it by their covariance (Simon 2010, Kalman filtering with
state constraints, IET Control Theory & Applications 4, section 2.4).  `filter_run` computes all this.

While the car stands, with v_x^2 + v_y^2 + (L yaw rate)^2 below the square of `least_mps`, L the wheelbase, a pose moves
the state x alone: K is 0 for the quantities, and P_qq stays (Schmidt 1966, Application of state-space methods to
navigation problems, Advances in Control Systems 3).  A car that stands is not pushed as one that drives, so that it
would seem to lose speed faster than the model says, and thus to be lighter.  So it is after a start at which nobody
knew twist or steering angle, for as many poses as come in `SETTLING_S`: formulas bend too much for P to hold there, and
what the start gets wrong would be learnt.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from bcid.adaptation.formulas import LASTING, LASTS_S, PUSHED, AdaptiveFormulas
from bcid.aliases import Floats, Ints
from bcid.compiled.njit import njit
from bcid.export.augmented_formulas import TIME
from bcid.export.formulas import COMMANDS, START
from bcid.export.graph import Node
from bcid.export.tape import Tape, record_tape, run_tape
from bcid.recording.limits import HEALTH

PLACE = ("p_x", "p_y", "theta")
STEERING = ("delta", "delta_lagged", "delta_behind")
"""States of the steering: a car has some of them."""

SETTLING_S = 1.0
"""Time (s) in which poses show twist and steering angle, and a wheel comes to where it is commanded: tenths of a second
are enough for both."""


class FilterNoise(NamedTuple):
    """What the filter assumes: pushes on the twist, the poses' noise, what is known at first, and how it forgets."""

    q: Floats  # (3,) on v_x, v_y (m/s/sqrt(s)) and yaw rate (rad/s/sqrt(s))
    pose_sd: Floats  # (3,) m, m, rad
    twist_sd: Floats  # (3,) of the first twist, where it was measured: m/s, m/s, rad/s
    steering_sd: float  # of the first steering angle, where it was, rad
    unknown_twist_sd: Floats  # (3,) of a first twist of which nothing is known
    unknown_steering_sd: float
    forget_s: float  # tau
    lasting_sd: tuple[float, float, float] = (0.0, 0.0, 0.0)  # sd_d of what lasts: m/s^2, m/s^2, rad/s^2


class Knowledge(NamedTuple):
    """What is known of k quantities from the stretch of a drive before, and when the next one begins."""

    values: Floats  # (k,)
    covariance: Floats  # (k, k)
    gap_s: float  # from the end of that stretch to the beginning of the next
    time_s: float = 0.0  # of the recording at that beginning


class CompiledFilter(NamedTuple):
    """The formulas on tapes, and the numbers of the filter, for a state z (N,) of n states and k quantities."""

    step: Tape  # f, then the elements of F that vary
    pose: Tape  # h, then the elements of H that vary
    F: Floats  # (n, N) the elements of F that are constant
    H: Floats  # (3, N)
    F_places: Ints  # (., 2) row and column of each element that varies
    H_places: Ints
    Q: Floats  # (N,) variances added in a period
    r2: Floats  # (3,) variances of a pose
    P_0: Floats  # (k,) variances of the quantities at first
    forgotten: float  # a
    place: Ints  # (3,) places of p_x, p_y and theta in z
    twist: Ints  # (3,) places of v_x, v_y and the yaw rate in z
    wheelbase_m: float
    least_mps: float  # speed of a car that moves
    low: Floats  # (k,) bounds of the quantities
    high: Floats


def compile_filter(formulas: AdaptiveFormulas) -> CompiledFilter:
    """The filter of `formulas`, to which `assume_noise` gives what it assumes."""
    inputs = [*_names(formulas), *(c.name for c in COMMANDS)]
    step, F, F_places = _record(formulas.next_states, formulas.slopes, inputs)
    pose, H, H_places = _record(formulas.pose, formulas.pose_slopes, inputs)
    bounds = np.array([[q.low, q.high] for q in formulas.quantities])
    P_0 = np.array([q.sd**2 for q in formulas.quantities])
    place, twist = (np.array([_names(formulas).index(name) for name in names]) for names in (PLACE, PUSHED))
    return CompiledFilter(
        step, pose, F, H, F_places, H_places, np.zeros(F.shape[1]), np.zeros(3), P_0, 0.0,
        place, twist, formulas.wheelbase_m,
        HEALTH.min_moving_speed * formulas.wheelbase_m, *bounds.T.copy(),
    )  # fmt: skip


def assume_noise(f: CompiledFilter, formulas: AdaptiveFormulas, noise: FilterNoise) -> CompiledFilter:
    """The filter `f` of `formulas` with what `noise` assumes."""
    T = formulas.period_s
    pushes = dict(zip(PUSHED, T * noise.q**2, strict=True))
    pushes |= {d.name: -math.expm1(-2.0 * T / LASTS_S) * sd**2 for d, sd in zip(LASTING, noise.lasting_sd, strict=True)}
    Q = np.array([pushes.get(name, 0.0) for name in _names(formulas)])
    return f._replace(Q=Q, r2=noise.pose_sd**2, forgotten=share_forgotten(T, noise))


def settling_poses(formulas: AdaptiveFormulas) -> int:
    """The poses from which nothing is learnt of the quantities after a start at which twist or angle is unknown."""
    return round(SETTLING_S / formulas.period_s)


def share_forgotten(seconds: float, noise: FilterNoise) -> float:
    """The share a of what was learnt of the quantities that is forgotten in some `seconds`."""
    return -math.expm1(-seconds / noise.forget_s)


def _names(formulas: AdaptiveFormulas) -> list[str]:
    """The names of the numbers of z."""
    return [*(s.name for s in formulas.states), *(q.symbol for q in formulas.quantities)]


def start_filter(
    formulas: AdaptiveFormulas, noise: FilterNoise, pose: Floats, twist: Floats | None, delta: float | None,
    known: Knowledge | None = None,
) -> tuple[Floats, Floats]:  # fmt: skip
    """State z (N,) and covariance P (N, N) at a pose (3,), a twist (3,) and a steering angle `delta` (rad).

    Twist and angle are None where nobody knows them: then they are zero, and as uncertain as they can be.  Of the past
    nothing is known: the car coasts, its wheel held.  Where something is `known` of the quantities from before a gap,
    they go on from there, less what is forgotten over the gap; else the recording begins.
    """
    names, n = [s.name for s in formulas.states], len(formulas.states)
    inputs = [*(s.name for s in START), *(q.symbol for q in formulas.quantities)]
    tape, G, places = _record(formulas.first_states, formulas.first_slopes, inputs)
    values = np.array([q.start for q in formulas.quantities]) if known is None else known.values
    start = [*pose, *(np.zeros(3) if twist is None else twist), 0.0 if delta is None else delta]
    found = np.empty(n + len(places))
    run_tape(tape, np.array([*start, *values]), tape.start.copy(), found)
    x = found[:n]
    if TIME.name in names:
        x[names.index(TIME.name)] = 0.0 if known is None else known.time_s
    P = np.diag(first_variances(formulas, noise, twist is not None, delta is not None))
    if known is not None:
        P_0 = np.diag(P)[n:].copy()
        P[n:, n:] = known.covariance
        forget(P, P_0, share_forgotten(known.gap_s, noise))
    G[tuple(places.T)] = found[n:]
    P[:n, n:] = G @ P[n:, n:]
    P[n:, :n] = P[:n, n:].T
    P[:n, :n] += P[:n, n:] @ G.T
    return np.r_[x, values], P


def first_variances(
    formulas: AdaptiveFormulas, noise: FilterNoise, twist_known: bool = True, wheel_known: bool = True
) -> Floats:
    """The variances (N,) of the numbers of z at first where these do not depend on each other.

    States of which nothing is said are known.
    """
    twist_sd = noise.twist_sd if twist_known else noise.unknown_twist_sd
    steering_sd = noise.steering_sd if wheel_known else noise.unknown_steering_sd
    sd = dict(zip((*PLACE, *PUSHED), (*noise.pose_sd, *twist_sd), strict=True)) | dict.fromkeys(STEERING, steering_sd)
    sd |= {d.name: lasting for d, lasting in zip(LASTING, noise.lasting_sd, strict=True)}
    return np.array([sd.get(s.name, 0.0) ** 2 for s in formulas.states] + [q.sd**2 for q in formulas.quantities])


def _record(
    values: tuple[Node, ...], slopes: tuple[tuple[Node, ...], ...], inputs: list[str]
) -> tuple[Tape, Floats, Ints]:
    """A tape of `values` and of the slopes that vary; the slopes that are constant, and the places of those that do."""
    constant, places = split_slopes(slopes)
    return record_tape([*values, *(slopes[i][j] for i, j in places.tolist())], inputs), constant, places


def split_slopes(slopes: tuple[tuple[Node, ...], ...]) -> tuple[Floats, Ints]:
    """The slopes that are constant, zero where they vary, and the places (., 2) of those that do, row by row."""
    constant = np.array([[float(s.value or 0.0) if s.value is not None else 0.0 for s in row] for row in slopes])
    varying = [(i, j) for i, row in enumerate(slopes) for j, s in enumerate(row) if s.value is None]
    return constant, np.array(varying, np.int64).reshape(-1, 2)


@njit
def forget(P: Floats, P_0: Floats, share: float) -> None:
    """Let the k quantities, the last of z, forget a `share` of what was learnt; at first their variances were `P_0`."""
    n, kept = len(P) - len(P_0), math.sqrt(1.0 - share)
    for i in range(n, len(P)):
        for j in range(len(P)):
            P[i, j] *= kept
            P[j, i] *= kept
    for i in range(n, len(P)):
        P[i, i] += share * P_0[i - n]
