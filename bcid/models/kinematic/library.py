"""The candidate terms of K-SINDy: products of powers of ten factors of the state and the command.

The paper prints some of the terms; errata 11 completes them by the paper's own rules.  Each term is
a row of exponents over FACTORS, so the same table prints, fits and runs.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from bcid.aliases import Floats
from bcid.compiled.njit import njit, njit_inline
from bcid.models.kinematic.frame import Frame, State
from bcid.physics.steering import steering_rate

FACTORS = ("v", "α_f", "α_r", "δ", "δ̇", "|α_f|", "|δ|", "|δ̇|", "max(0,u_m−v)", "min(0,u_m)")
V, AF, AR, DELTA, RATE, ABS_AF, ABS_DELTA, ABS_RATE, THROTTLE, BRAKE = range(len(FACTORS))
ONE = len(FACTORS)  # the place of a constant one behind the factors


@njit_inline
def fill_factors(q: Floats, state: State, u_s: float, u_m: float, c: Frame) -> None:
    """The ten factors, and one, into q (11,); the rate is errata 17's."""
    v, alpha_f, alpha_r, delta = state
    rate = steering_rate(u_s, delta, c.T_s, c.d)
    q[0], q[1], q[2], q[3], q[4] = v, alpha_f, alpha_r, delta, rate
    q[5], q[6], q[7] = abs(alpha_f), abs(delta), abs(rate)
    # one convention for the throttle (errata 8): a reference speed above zero, a brake share below
    q[8] = max(0.0, u_m - c.follow * v)
    q[9] = min(0.0, u_m)
    q[ONE] = 1.0


@njit
def theta_table(x: Floats, exponents: npt.NDArray[np.int64], c: Frame) -> Floats:
    """Candidate terms (N, n) of many samples x (N, 6); `exponents` (n, 10)."""
    out, q = np.ones((len(x), len(exponents))), np.empty(ONE + 1)
    for k in range(len(x)):
        fill_factors(q, (x[k, 0], x[k, 1], x[k, 2], x[k, 3]), x[k, 4], x[k, 5], c)
        for i in range(len(exponents)):
            for j in range(exponents.shape[1]):
                for _ in range(exponents[i, j]):
                    out[k, i] *= q[j]
    return out


def _terms(*products: tuple[int, ...]) -> npt.NDArray[np.int64]:
    return np.array([[p.count(j) for j in range(len(FACTORS))] for p in products], dtype=np.int64)


_SPEED = (
    (THROTTLE,), (THROTTLE, V), (BRAKE, V), (BRAKE, V, V), (V,), (V, V), (V, V, V),
    (V, ABS_DELTA), (V, ABS_AF), (V, AF, AF), (V, V, ABS_AF), (V, ABS_RATE), (V, RATE, RATE),
    (V, V, ABS_RATE), (V, ABS_DELTA, ABS_AF), (V, ABS_RATE, ABS_AF),
)  # fmt: skip
_SLIP = (
    (AF,), (AR,), (V, DELTA), (V, DELTA, ABS_DELTA), (V, V, DELTA), (V, RATE), (V, RATE, ABS_RATE), (V, V, RATE),
    (V, DELTA, ABS_RATE), (V, RATE, ABS_DELTA), (V, RATE, DELTA, DELTA),
)  # fmt: skip

SPEED = _terms(*_SPEED)
"""Candidates of v_f: all but the throttle term vanish with v_f (errata 9, 11)."""

SPEED_PUBLISHED = _terms(*((AF, AF) if t == (V, AF, AF) else t for t in _SPEED))
"""The same with the published alpha_f^2 in place of v alpha_f^2 (errata 9)."""

SLIP = _terms(*_SLIP)
"""Candidates of both slip angles (errata 11)."""


def is_speed(terms: npt.NDArray[np.int64]) -> Floats:
    """1 at the term v alone."""
    return np.asarray((terms == _terms((V,))[0]).all(axis=1), dtype=float)


def name_of(exponents: npt.NDArray[np.int64]) -> str:
    """A term in print, such as `v² |δ̇|`."""
    power = {1: "", 2: "²", 3: "³"}
    return " ".join(f + power.get(int(n), f"^{n}") for f, n in zip(FACTORS, exponents, strict=True) if n)


def equation(left: str, coefficients: Floats, exponents: npt.NDArray[np.int64]) -> str:
    """`left = sum of the terms whose coefficient is not zero`."""
    kept = [(c, name_of(e)) for c, e in zip(coefficients, exponents, strict=True) if c != 0.0]
    text = " ".join(f"{'−' if math.copysign(1, c) < 0 else '+'} {abs(c):.4g} {n}" for c, n in kept)
    return f"{left} = {text.removeprefix('+ ') or '0'}"
