"""What pushed the body beside the model: posterior pushes of every knot, with all that they might depend on."""

from __future__ import annotations

from typing import Any, NamedTuple

import numba
import numpy as np

from bcid.aliases import Floats, Ints
from bcid.compiled.njit import njit_parallel
from bcid.effects.car import Body, Drive, wrench
from bcid.effects.constants import Constants
from bcid.effects.motion import Chain, body_step, settled
from bcid.likelihood.lane_rollout import Layout, layout, since
from bcid.likelihood.marginal import eliminate, moments, rescaled
from bcid.likelihood.nuisance import deviations
from bcid.likelihood.predict import pushes_of
from bcid.likelihood.refit import Fit
from bcid.likelihood.take import KNOTS, N_START, Take
from bcid.physics.car import Car

STATES = ("p_x", "p_y", "theta", "v_x", "v_y", "omega", "delta", "delta_rate", "u_m", "alpha_f", "alpha_r", "F_m")
CHANNELS = ("fx", "fy", "mz")
CLIP_SD = 12.0  # beyond which one knot counts no more
BOUNDLESS = 100.0  # m/s^2 and rad/s^2: what is expected of pushes of which nothing is to be expected


class Disturbances(NamedTuple):
    """Pushes as accelerations of K knots, and the fit's means there."""

    time_s: Floats  # (K,) middle of the knot
    segment: Ints  # (K,)
    push: Floats  # (K, 3) m/s^2, m/s^2, rad/s^2: posterior means
    strength: Floats  # (K, 3) in standard deviations of what the fit expects of them
    mean: dict[str, Floats]  # by STATES (K,)
    share: Floats  # (K, 3) of a push that its posterior mean shows: the rest is lost to noise
    seen: Floats  # (S, 3 KNOTS) m/s^2, m/s^2, rad/s^2: what the poses alone say of a segment's pushes,
    doubt: Floats  # (S, 3 KNOTS, 3 KNOTS) and the covariance of that


@njit_parallel
def _knot_means(of: Layout, start: Floats, chain: Chain, p: Car, e: Any, c: Constants) -> Floats:
    """Means of STATES over the knots (S, KNOTS, 12), from the steps' beginnings."""
    S = len(of.step)
    out = np.zeros((S, KNOTS, 12))
    per_knot = of.steps // KNOTS
    for s in numba.prange(S):
        b = Body(start[s, 0], start[s, 1], start[s, 2], start[s, 3], start[s, 4], start[s, 5])
        own, T, pushes = since(chain, of.zero[s]), of.length[s], pushes_of(start[s], p)
        lagged = settled(b, of.step[s], own, T, p, e[0], c)
        for i in range(per_knot * KNOTS):
            k = of.step[s] + i
            t, u_m = own.t_0 + k * own.h, chain.u_m[k]
            drive = Drive(t, T, chain.delta[2 * k], u_m, chain.u_next[k], chain.late[k])
            w = wrench(b, drive, lagged, p, e[0], c)
            v_ry = b.v_y - p.l_r * b.omega
            F_m = p.front_share * w.steady.F_mf + (1.0 - p.front_share) * w.steady.F_mr
            row = (
                b.p_x, b.p_y, b.theta, b.v_x, b.v_y, b.omega, drive.delta,
                (chain.delta[2 * k + 2] - chain.delta[2 * k]) / chain.h, drive.u_m, w.steady.alpha_f,
                np.arctan(v_ry / max(abs(b.v_x), p.v_0)), F_m,
            )  # fmt: skip
            for j in range(12):
                out[s, i // per_knot, j] += row[j] / per_knot
            b, lagged = body_step(b, lagged, k, own, T, pushes[i // per_knot], p, e[0], c)
    return out


def relieved(less: Disturbances, more: Disturbances) -> dict[str, float]:
    """Where an explanation `more` needs less pushing than `less` does, along the car and across or about it: shares.

    Squares in the scales that `more` leaves; a steered wheel pushes across and about a car at once.
    """
    scale = np.maximum(1.4826 * np.median(np.abs(more.push), axis=0), 1e-12)
    before, after = (np.minimum(np.abs(d.push) / scale, CLIP_SD) ** 2 for d in (less, more))
    saved = np.maximum((before - after).sum(axis=0), 0.0)
    whole = max(float(saved.sum()), 1e-12)
    return {"along": float(saved[0]) / whole, "across": float(saved[1:].sum()) / whole}


def disturbances(fit: Fit, take: Take) -> Disturbances:
    """The pushes that explain a fit's residuals best."""
    setting = fit.hypothesis.setting(fit.phi, take)
    r = deviations(take, setting, fit.start, fit.tangent.A)
    products = moments(r, fit.tangent.A, take.first)
    _, e = rescaled(products, fit.scales, 0)
    alone = eliminate(products, fit.scales.r, np.r_[np.zeros(N_START), np.full(3 * KNOTS, BOUNDLESS**-2)])
    means = _knot_means(layout(take), fit.start, *setting.acting)
    push = e.z[:, N_START:].reshape(-1, 3)
    spread = np.einsum("skk->sk", e.V)[:, N_START:].reshape(-1, 3)
    expected = np.sqrt(np.maximum(fit.scales.q**2 - spread, 1e-3 * fit.scales.q**2))
    knots = take.begin_s[:, None] + (np.arange(KNOTS) + 0.5) * take.steps * setting.chain.h / KNOTS
    columns = means.reshape(-1, len(STATES)).T
    return Disturbances(
        knots.ravel(), np.repeat(np.arange(take.segments), KNOTS), push, push / expected,
        dict(zip(STATES, columns, strict=True)), (expected / fit.scales.q) ** 2,
        alone.z[:, N_START:], alone.V[:, N_START:, N_START:],
    )  # fmt: skip
