"""The sparse sum of K-SINDy: its terms, compiled, and its rollouts."""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np
import numpy.typing as npt

from bcid.aliases import Floats
from bcid.compiled.njit import njit, njit_parallel
from bcid.models.kinematic.frame import Frame, State, moved, twist_of
from bcid.models.kinematic.library import ONE, fill_factors


class Sparse(NamedTuple):
    """Coefficients and exponents of the three equations."""

    xi_v: Floats  # (n,)
    xi_f: Floats  # (m,)
    xi_r: Floats  # (m,)
    speed: npt.NDArray[np.int64]  # (n, 10)
    slip: npt.NDArray[np.int64]  # (m, 10)


class Terms(NamedTuple):
    """The terms whose coefficient is not zero, as a rollout takes them."""

    xi: Floats  # (T,)
    equation: npt.NDArray[np.int64]  # (T,) 0, 1, 2: of v_f, alpha_f, alpha_r
    factors: npt.NDArray[np.int64]  # (T, most) whose product a term is, filled up with ones
    q: Floats  # (11,) to work on: the values of the factors
    after: Floats  # (3,) and of the sums


@njit
def terms_of(s: Sparse) -> Terms:
    """The terms of the three equations."""
    most, count = 1, 0
    equations = ((s.xi_v, s.speed), (s.xi_f, s.slip), (s.xi_r, s.slip))
    for xi, exponents in equations:
        for i in range(len(xi)):
            if xi[i] != 0.0:
                count += 1
                most = max(most, exponents[i].sum())
    out = Terms(np.empty(count), np.empty(count, np.int64), np.full((count, most), ONE), np.empty(ONE + 1), np.empty(3))
    n = 0
    for e in range(3):
        xi, exponents = equations[e]
        for i in range(len(xi)):
            if xi[i] != 0.0:
                out.xi[n], out.equation[n], at = xi[i], e, 0
                for j in range(exponents.shape[1]):
                    for _ in range(exponents[i, j]):
                        out.factors[n, at] = j
                        at += 1
                n += 1
    return out


@njit
def f_sindy(state: State, u_s: float, u_m: float, t: Terms, c: Frame) -> None:
    """Fills `t.after` with [v_f, alpha_f, alpha_r] one period later."""
    fill_factors(t.q, state, u_s, u_m, c)
    for n in range(len(t.after)):
        t.after[n] = 0.0
    for i in range(len(t.xi)):
        product = t.xi[i]
        for j in range(t.factors.shape[1]):
            product *= t.q[t.factors[i, j]]
        t.after[t.equation[i]] += product


@njit
def advance(state: State, u_s: float, u_m: float, t: Terms, c: Frame) -> State:
    """[v_f, alpha_f, alpha_r, delta] one period later."""
    f_sindy(state, u_s, u_m, t, c)
    return moved(t.after, state[3], u_s, c)


@njit
def _scan(carry: Floats, commands: Floats, s: Sparse, c: Frame) -> Floats:
    twists, terms = np.empty((len(commands), 3)), terms_of(s)
    state = (carry[0], carry[1], carry[2], carry[3])
    for k in range(len(commands)):
        state = advance(state, commands[k, 0], commands[k, 1], terms, c)
        twists[k, 0], twists[k, 1], twists[k, 2] = twist_of(*state, c)
    carry[0], carry[1], carry[2], carry[3] = state
    return twists


@njit_parallel
def scan_many(carries: Floats, commands: Floats, s: Sparse, c: Frame) -> Floats:
    """See `Model.scan_many`."""
    twists = np.empty((len(carries), commands.shape[1], 3))
    for b in numba.prange(len(carries)):
        twists[b] = _scan(carries[b], commands[b], s, c)
    return twists
