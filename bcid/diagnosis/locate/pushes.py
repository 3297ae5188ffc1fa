"""Disturbances of a fit: the posterior pushes on the body at every knot, with all that they might depend on."""

from typing import NamedTuple

import numba
import numpy as np

from bcid.aliases import Floats, Ints, Switches
from bcid.compiled.njit import njit_inline, njit_parallel
from bcid.effects.actuators import ActuatorChain, actuation_at
from bcid.effects.car import LagState, unpack_body, unpack_lags, wrench_with_effects
from bcid.effects.constants import Constants
from bcid.effects.linkage import angle_at_rest
from bcid.effects.motion import integrate_body
from bcid.likelihood.lane_rollout import SegmentLayout, push_wrenches, segment_layout, shift_chain_time
from bcid.likelihood.lane_start import first_lags_of_one, steps_of_recording
from bcid.likelihood.marginal import segment_moments
from bcid.likelihood.refit import Fit
from bcid.likelihood.scale_estimate import estimate_scales
from bcid.likelihood.take import KNOTS, N_START, Take
from bcid.physics.car import Car

STATE_NAMES = ("p_x", "p_y", "theta", "v_x", "v_y", "omega", "delta", "delta_rate", "u_m", "alpha_f", "alpha_r", "F_m")
WRENCH_CHANNELS = ("fx", "fy", "mz")


class Disturbances(NamedTuple):
    """Pushes, as accelerations, at the K knots of S segments, and the fitted car's mean states there."""

    time_s: Floats  # (K,) middle of the knot
    segment: Ints  # (K,)
    push: Floats  # (K, 3) m/s^2, m/s^2, rad/s^2: posterior means
    strength: Floats  # (K, 3) in standard deviations of what the fit expects of them
    states: dict[str, Floats]  # (K,) each, by STATE_NAMES: means over the knots


@njit_inline
def driving_force(steady: LagState, p: Car) -> float:
    """Total motor force F_m (N) along the driven wheels: front_share F_mf + (1 - front_share) F_mr.

    F_mf and F_mr are the motor's forces by the wheel speeds in front and rear, without lag (`steady`).
    """
    return p.front_share * steady.F_mf + (1.0 - p.front_share) * steady.F_mr


@njit_parallel
def _mean_states(
    parts: int, layout: SegmentLayout, start: Floats, chain: ActuatorChain, p: Car, e: Switches, c: Constants
) -> Floats:
    """Mean predicted state over each of `parts` parts of all S segments: (S, parts, 12), columns as in STATE_NAMES.

    They are p_x, p_y (m), theta (rad, world), v_x, v_y (m/s), omega (rad/s, body), delta of the wheel (rad) and its
    rate at the servo (rad/s), throttle u_m, slip angles alpha_f and alpha_r (rad), and the motor's force F_m (N).
    Predictions start from `start` (S, N_NUISANCE), each segment's initial state and disturbances.
    """
    S = len(layout.step)
    out = np.zeros((S, parts, 12))
    per_knot, per_part = layout.steps // KNOTS, layout.steps // parts
    for s in numba.prange(S):
        own, T, pushes = shift_chain_time(chain, layout.zero_s[s]), layout.length_s[s], push_wrenches(start[s], p)
        first, n, b = layout.step[s], min(per_part * parts, per_knot * KNOTS), unpack_body(start[s])
        lags = first_lags_of_one(b, first, steps_of_recording(first, own), own, T, p, e[0], c)
        path = integrate_body(b, lags, first, n, own, T, pushes, per_knot, p, e[0], c)
        for i in range(n):
            k, b = first + i, unpack_body(path[i])
            act = actuation_at(k, own, T)
            w = wrench_with_effects(b, act, unpack_lags(path[i]), p, e[0], c)
            v_ry = b.v_y - p.l_r * b.omega
            row = (
                b.p_x, b.p_y, b.theta, b.v_x, b.v_y, b.omega, angle_at_rest(act.delta, e[0]),
                (chain.delta[2 * k + 2] - chain.delta[2 * k]) / chain.h, act.u_m, w.steady.alpha_f,
                np.arctan(v_ry / max(abs(b.v_x), p.v_0)), driving_force(w.steady, p),
            )  # fmt: skip
            for j in range(12):
                out[s, i // per_part, j] += row[j] / per_part
    return out


def estimate_disturbances(fit: Fit, take: Take) -> Disturbances:
    """Estimate the accelerations of the body, constant over 0.25 s, that explain the pose residuals of a fit.

    They are posterior means of a linear Gaussian model with the fitted standard deviations of noise and disturbances.
    With them come the car's mean states over the same intervals.
    """
    inputs = fit.hypothesis.prediction_inputs(fit.phi, take)
    _, e = estimate_scales(segment_moments(fit.residuals(take, fit.phi), fit.tangent.A, take.first), fit.scales, 0)
    push = e.z[:, N_START:].reshape(-1, 3)
    spread = np.einsum("skk->sk", e.V)[:, N_START:].reshape(-1, 3)
    expected = np.sqrt(np.maximum(fit.scales.q**2 - spread, 1e-3 * fit.scales.q**2))
    knots = take.begin_s[:, None] + (np.arange(KNOTS) + 0.5) * take.steps * inputs.chain.h / KNOTS
    segment = np.repeat(np.arange(take.segments), KNOTS)
    return Disturbances(knots.ravel(), segment, push, push / expected, mean_states(fit, take, KNOTS))


def mean_states(fit: Fit, take: Take, parts: int) -> dict[str, Floats]:
    """The fitted car's mean states (S parts,) by STATE_NAMES, over each of `parts` parts of the S segments."""
    inputs = fit.hypothesis.prediction_inputs(fit.phi, take)
    means = _mean_states(parts, segment_layout(take), fit.start, *inputs.kernel_arguments)
    return dict(zip(STATE_NAMES, means.reshape(-1, len(STATE_NAMES)).T, strict=True))
