"""The candidate terms of K-SINDy: products of powers of ten factors of the state and the command.

The paper prints some of the terms; errata 11 completes them by the paper's own rules.  Each term is
a row of exponents over FACTORS, so the same table prints, fits and runs.
"""

import math

import numpy as np

from bcid.aliases import Floats, Ints
from bcid.compiled.njit import njit, njit_inline
from bcid.models.kinematic.state import KinematicCar, KinematicState
from bcid.physics.steering import steering_rate

FACTORS = ("v", "α_f", "α_r", "δ", "δ̇", "|α_f|", "|δ|", "|δ̇|", "max(0,u_m−v)", "min(0,u_m)")
V, AF, AR, DELTA, RATE, ABS_AF, ABS_DELTA, ABS_RATE, THROTTLE, BRAKE = range(len(FACTORS))
ONE = len(FACTORS)  # the place of a constant one behind the factors


@njit_inline
def fill_factors(q: Floats, state: KinematicState, u_s: float, u_m: float, c: KinematicCar) -> None:
    """Fill q (11,) with the ten `FACTORS` of K-SINDy's terms, then 1, at a state under the command u_s (rad), u_m.

    They are v_f, the slip angles, delta, its rate sat((u_s - delta)/T_s), absolute values, throttle max(0, u_m - v_f)
    and brake min(0, u_m) (docs/errata.md rows 8, 17).
    """
    v, alpha_f, alpha_r, delta = state
    rate = steering_rate(u_s, delta, c.T_s, c.d)
    q[0], q[1], q[2], q[3], q[4] = v, alpha_f, alpha_r, delta, rate
    q[5], q[6], q[7] = abs(alpha_f), abs(delta), abs(rate)
    # One convention for the throttle (errata 8): a reference speed above zero, a brake share below
    q[8] = max(0.0, u_m - c.follow * v)
    q[9] = min(0.0, u_m)
    q[ONE] = 1.0


@njit
def theta_matrix(x: Floats, exponents: Ints, c: KinematicCar) -> Floats:
    """Theta (N, n): values of n K-SINDy terms at x = [v_f, alpha_f, alpha_r, delta, u_s, u_m] (N, 6).

    A term is a product of powers of the ten `FACTORS`; row i of `exponents` (n, 10) holds the powers of term i.
    """
    out, q = np.ones((len(x), len(exponents))), np.empty(ONE + 1)
    for k in range(len(x)):
        fill_factors(q, (x[k, 0], x[k, 1], x[k, 2], x[k, 3]), x[k, 4], x[k, 5], c)
        for i in range(len(exponents)):
            for j in range(exponents.shape[1]):
                for _ in range(exponents[i, j]):
                    out[k, i] *= q[j]
    return out


def _exponent_table(*products: tuple[int, ...]) -> Ints:
    """Exponents (n, 10) over K-SINDy's ten `FACTORS` of n terms, given as tuples of factors: (V, V, RATE) is v² δ̇."""
    return np.array([[p.count(j) for j in range(len(FACTORS))] for p in products], dtype=np.int64)


_SPEED_PRODUCTS = (
    (THROTTLE,), (THROTTLE, V), (BRAKE, V), (BRAKE, V, V), (V,), (V, V), (V, V, V),
    (V, ABS_DELTA), (V, ABS_AF), (V, AF, AF), (V, V, ABS_AF), (V, ABS_RATE), (V, RATE, RATE),
    (V, V, ABS_RATE), (V, ABS_DELTA, ABS_AF), (V, ABS_RATE, ABS_AF),
)  # fmt: skip

SPEED_TERMS = _exponent_table(*_SPEED_PRODUCTS)
"""Candidates of v_f: all but the throttle term vanish with v_f (errata 9, 11)."""

SPEED_TERMS_PUBLISHED = _exponent_table(*((AF, AF) if t == (V, AF, AF) else t for t in _SPEED_PRODUCTS))
"""Candidates of v_f with the published alpha_f^2 in place of v alpha_f^2 (errata 9)."""

SPEED_ALONE = _exponent_table((V,))
"""Exponents (1, 10) of the term v_f: the whole of v_f(k+1) = v_f(k)."""

SLIP_TERMS = _exponent_table(
    (AF,), (AR,), (V, DELTA), (V, DELTA, ABS_DELTA), (V, V, DELTA), (V, RATE), (V, RATE, ABS_RATE), (V, V, RATE),
    (V, DELTA, ABS_RATE), (V, RATE, ABS_DELTA), (V, RATE, DELTA, DELTA),
)  # fmt: skip
"""Candidates of both slip angles (errata 11)."""


def term_name(exponents: Ints) -> str:
    """A K-SINDy term in print, such as `v² |δ̇|`, from its `exponents` (10,) over the ten `FACTORS`."""
    power = {1: "", 2: "²", 3: "³"}
    return " ".join(f + power.get(int(n), f"^{n}") for f, n in zip(FACTORS, exponents, strict=True) if n)


def format_equation(left: str, coefficients: Floats, exponents: Ints) -> str:
    """A K-SINDy equation in print, `left = sum of coefficient times term`, without terms whose coefficient is zero.

    `coefficients` is (n,); row i of `exponents` (n, 10) holds the powers of the ten `FACTORS` in term i.
    """
    kept = [(c, term_name(e)) for c, e in zip(coefficients, exponents, strict=True) if c != 0.0]
    text = " ".join(f"{'−' if math.copysign(1, c) < 0 else '+'} {abs(c):.4g} {n}" for c, n in kept)
    return f"{left} = {text.removeprefix('+ ') or '0'}"
