"""Sine, cosine, arc tangent and clipping without branches or calls.

A loop over samples or vehicles whose body is nothing but arithmetic and selections is turned into vector
instructions by the compiler; a call of the C library in it, or a jump, keeps it scalar.  All are within a few units
in the last place of the C library's.  Polynomials are summed in pairs and by even and odd powers, each product fused
with a sum: a processor then waits for the longest of several short chains, not for one long one (Estrin's scheme).
"""

import math
from collections.abc import Callable

import numpy as np
from numpy.polynomial import Chebyshev, Polynomial

from bcid.aliases import Floats
from bcid.compiled.lanes import floor, multiply_add, where
from bcid.compiled.njit import njit_inline

_PER_PI = 1.0 / math.pi
# pi in three parts; the first two are short enough that a whole number below 2^20 times them is exact
_PI_1 = math.ldexp(math.floor(math.ldexp(math.pi, 31)), -31)
_PI_2 = math.ldexp(math.floor(math.ldexp(math.pi - _PI_1, 63)), -63)
_PI_3 = math.pi - _PI_1 - _PI_2 + 1.2246467991473532e-16  # what a double of pi lacks


def near_zero(function: Callable[[Floats], Floats], degree: int, largest: float) -> list[float]:
    """Coefficients, lowest first, of the polynomial of `degree` that is nearly `function` between 0 and `largest`.

    It interpolates the function, which takes and returns arrays, at Chebyshev's points.
    """
    polynomial = Chebyshev.interpolate(function, degree, domain=[0.0, largest]).convert(kind=Polynomial)
    return [float(c) for c in polynomial.coef]


def sine_series(z: Floats) -> Floats:
    """(sin(y)/y - 1)/z (n,) at z = y^2 (n,), by Taylor's series: the difference would cancel."""
    return np.asarray(np.sum([(-1.0) ** (k + 1) * z**k / math.factorial(2 * k + 3) for k in range(12)], axis=0))


def cosine_series(z: Floats) -> Floats:
    """(cos(y) - 1 + z/2)/z^2 (n,) at z = y^2 (n,), by Taylor's series."""
    return np.asarray(np.sum([(-1.0) ** k * z**k / math.factorial(2 * k + 4) for k in range(12)], axis=0))


_S3, _S5, _S7, _S9, _S11, _S13, _S15, _S17 = near_zero(sine_series, 7, (0.5 * math.pi) ** 2)
_C4, _C6, _C8, _C10, _C12, _C14, _C16, _C18 = near_zero(cosine_series, 7, (0.5 * math.pi) ** 2)


@njit_inline
def sincos(x: float) -> tuple[float, float]:
    """sin(x) and cos(x) for |x| < 1e6 (rad), without branches: by polynomials about the nearest multiple of pi."""
    turns = floor(multiply_add(x, _PER_PI, 0.5))
    y = multiply_add(turns, -_PI_3, multiply_add(turns, -_PI_2, multiply_add(turns, -_PI_1, x)))
    z = y * y
    zz = z * z
    even_s = multiply_add(zz, multiply_add(zz, multiply_add(zz, _S15, _S11), _S7), _S3)
    odd_s = multiply_add(zz, multiply_add(zz, multiply_add(zz, _S17, _S13), _S9), _S5)
    s = multiply_add(y * z, multiply_add(z, odd_s, even_s), y)
    even_c = multiply_add(zz, multiply_add(zz, multiply_add(zz, _C16, _C12), _C8), _C4)
    odd_c = multiply_add(zz, multiply_add(zz, multiply_add(zz, _C18, _C14), _C10), _C6)
    c = multiply_add(zz, multiply_add(z, odd_c, even_c), multiply_add(z, -0.5, 1.0))
    half = 0.5 * turns
    reversed_ = half != floor(half)
    return where(reversed_, -s, s), where(reversed_, -c, c)


_HALF_PI, _QUARTER_PI = 0.5 * math.pi, 0.25 * math.pi
_TAN_EIGHTH = math.sqrt(2.0) - 1.0  # tan(pi/8)
# arctan(w)/w in powers of z = w^2, for |w| < tan(pi/8)
_A0, _A1, _A2, _A3, _A4, _A5, _A6, _A7, _A8, _A9 = near_zero(
    lambda z: np.arctan(np.sqrt(z)) / np.sqrt(z), 9, _TAN_EIGHTH**2
)


@njit_inline
def _near_arctan(w: float) -> float:
    """arctan(w)/w for |w| <= tan(pi/8), by its polynomial in w^2."""
    z = w * w
    zz = z * z
    low = multiply_add(zz, multiply_add(z, _A3, _A2), multiply_add(z, _A1, _A0))
    middle = multiply_add(zz, multiply_add(z, _A7, _A6), multiply_add(z, _A5, _A4))
    return multiply_add(zz * zz, multiply_add(zz * zz, multiply_add(z, _A9, _A8), middle), low)


@njit_inline
def arctan_ratio(y: float, x: float) -> float:
    """The angle (rad) in [-pi/2, pi/2] whose tangent is y/x, for x > 0, by a polynomial without branches.

    A tangent t beyond tan(pi/8) is brought below it by arctan(t) = pi/4 + arctan((t-1)/(t+1)), one beyond 1/tan(pi/8)
    by arctan(t) = pi/2 - arctan(1/t); all of it is put into the one division of y by x.
    """
    size, signed_x = abs(y), math.copysign(x, y)
    flat, steep = size <= _TAN_EIGHTH * x, x <= _TAN_EIGHTH * size
    over = where(flat, y, where(steep, -signed_x, y - signed_x))
    under = where(flat, x, where(steep, size, x + size))
    w = over / under
    return multiply_add(w, _near_arctan(w), math.copysign(where(flat, 0.0, where(steep, _HALF_PI, _QUARTER_PI)), y))


@njit_inline
def arctan_ratio_by_jumps(y: float, x: float) -> float:
    """What `arctan_ratio` is, to the last bit, for a loop over time, whose next step waits for the result.

    Jumps are foreseen by the processor where angles change little from step to step, selections waited for.
    """
    size, signed_x = abs(y), math.copysign(x, y)
    if size <= _TAN_EIGHTH * x:
        w = y / x
        return w * _near_arctan(w)
    if x <= _TAN_EIGHTH * size:
        w = -signed_x / size
        return multiply_add(w, _near_arctan(w), math.copysign(_HALF_PI, y))
    w = (y - signed_x) / (x + size)
    return multiply_add(w, _near_arctan(w), math.copysign(_QUARTER_PI, y))


@njit_inline
def arctan(x: float) -> float:
    """The angle (rad) in [-pi/2, pi/2] whose tangent is `x`, by a polynomial without branches."""
    return arctan_ratio(x, 1.0)


@njit_inline
def clip(x: float, low: float, high: float) -> float:
    """`x` within [low, high]; NaN stays NaN."""
    above = where(x < low, low, x)
    return where(above > high, high, above)
