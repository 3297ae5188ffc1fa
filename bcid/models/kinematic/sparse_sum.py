"""The sparse sum of K-SINDy, compiled: its active terms, one period, and its rollouts."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from bcid.aliases import Floats, Ints
from bcid.compiled.lanes import multiply_add
from bcid.compiled.njit import njit, njit_inline
from bcid.models.interface import build_scan_kernels, mean_command
from bcid.models.kinematic.library import ONE, fill_factors
from bcid.models.kinematic.state import KinematicCar, KinematicState, kinematic_twist, next_state

Places = npt.NDArray[np.uint64]


class SparseEquations(NamedTuple):
    """Coefficients and exponents of the equations of v_f, alpha_f and alpha_r."""

    xi_v: Floats  # (n,) coefficients of v_f
    xi_f: Floats  # (m,) of alpha_f
    xi_r: Floats  # (m,) of alpha_r
    speed: Ints  # (n, 10) exponents of the terms of v_f
    slip: Ints  # (m, 10) of both slip angles


# Factors multiplied at once in each term; a term of fewer has ones in place of the others.
AT_ONCE = 4


class ActiveTerms(NamedTuple):
    """The terms whose coefficient is not zero, laid out for a rollout: all of v_f, then alpha_f's, then alpha_r's."""

    xi: Floats  # (T,)
    ends: Ints  # (3,) place behind the last term of each equation
    # Places of the factors whose product a term is.  Unsigned, so that the compiler need not ask whether one counts
    # from the end.
    first: Places  # (T, AT_ONCE)
    later: Places  # (T, most - AT_ONCE)
    # What a step works on: the values of the factors, (11,), and of the three sums, (3,).
    q: Floats
    after: Floats


@njit
def active_terms(s: SparseEquations) -> ActiveTerms:
    """List the terms of K-SINDy's three equations whose coefficient is not zero, as flat arrays for fast rollouts."""
    most, count = AT_ONCE, 0
    equations = ((s.xi_v, s.speed), (s.xi_f, s.slip), (s.xi_r, s.slip))
    for xi, exponents in equations:
        for i in range(len(xi)):
            if xi[i] != 0.0:
                count += 1
                most = max(most, exponents[i].sum())
    factors = np.full((count, most), ONE, np.uint64)
    values, ends, n = np.empty(count), np.empty(3, np.int64), 0
    for e in range(3):
        xi, exponents = equations[e]
        for i in range(len(xi)):
            if xi[i] != 0.0:
                values[n], at = xi[i], 0
                for j in range(exponents.shape[1]):
                    for _ in range(exponents[i, j]):
                        factors[n, at] = j
                        at += 1
                n += 1
        ends[e] = n
    first, later = factors[:, :AT_ONCE].copy(), factors[:, AT_ONCE:].copy()
    return ActiveTerms(values, ends, first, later, np.empty(ONE + 1), np.empty(3))


@njit_inline
def f_sindy(state: KinematicState, u_s: float, u_m: float, t: ActiveTerms, c: KinematicCar) -> None:
    """Fill `t.after` (3,) with K-SINDy's [v_f, alpha_f, alpha_r] one period after `state` under [u_s (rad), u_m].

    Each is the sum of coefficient times term over its active terms (paper, f_SINDy).
    """
    fill_factors(t.q, state, u_s, u_m, c)
    q, begin = t.q, 0
    for n in range(3):
        total = 0.0
        for i in range(begin, t.ends[n]):
            product = (q[t.first[i, 0]] * q[t.first[i, 1]]) * (q[t.first[i, 2]] * q[t.first[i, 3]])
            for j in range(t.later.shape[1]):
                product *= q[t.later[i, j]]
            total = multiply_add(t.xi[i], product, total)
        t.after[n], begin = total, t.ends[n]


@njit
def scan_k_sindy(carry: Floats, parts: Floats, s: SparseEquations, c: KinematicCar) -> Floats:
    """Twists (N, 3) of one K-SINDy (sparse equations `s`) in N periods of commands `parts` (N, W, 4).

    `carry` (4,) is the state [v_f (m/s), alpha_f, alpha_r, delta (rad)]: the first on entry, the last on return.
    Parts are [duration (s), u_s (rad), u_m, brake share]; `c` holds lever arms, steering constants and period.
    """
    twists, terms = np.empty((len(parts), 3)), active_terms(s)
    state = (carry[0], carry[1], carry[2], carry[3])
    for k in range(len(parts)):
        u_s, u_m = mean_command(parts, k)
        f_sindy(state, u_s, u_m, terms, c)
        state = next_state(terms.after, state[3], parts, k, c)
        twists[k, 0], twists[k, 1], twists[k, 2] = kinematic_twist(state, c)
    carry[0], carry[1], carry[2], carry[3] = state
    return twists


K_SINDY_KERNELS = build_scan_kernels(scan_k_sindy)
