"""Sine, cosine, arc tangent and clipping without branches or calls.

A loop over samples or vehicles whose body is nothing but arithmetic and selections is turned into vector
instructions by the compiler; a call of the C library in it, or a jump, keeps it scalar.  All are within a few units
in the last place of the C library's.  Polynomials are summed in pairs and by even and odd powers, each product fused
with a sum: a processor then waits for the longest of several short chains, not for one long one (Estrin's scheme).
"""

import math

import numpy as np
from numpy.polynomial import Chebyshev, Polynomial

from bcid.compiled.lanes import floor, multiply_add, where
from bcid.compiled.njit import njit_inline

_TWO_OVER_PI = 2.0 / math.pi
# pi/2 in three parts; the first two are short enough that a whole number below 2^20 times them is exact
_HALF_PI_1 = math.ldexp(math.floor(math.ldexp(0.5 * math.pi, 32)), -32)
_HALF_PI_2 = math.ldexp(math.floor(math.ldexp(0.5 * math.pi - _HALF_PI_1, 64)), -64)
_HALF_PI_3 = 0.5 * math.pi - _HALF_PI_1 - _HALF_PI_2 + 6.123233995736766e-17  # what a double of pi/2 lacks

_S3, _S5, _S7, _S9, _S11, _S13, _S15 = ((-1.0) ** k / math.factorial(2 * k + 1) for k in range(1, 8))
_C4, _C6, _C8, _C10, _C12, _C14, _C16 = ((-1.0) ** k / math.factorial(2 * k) for k in range(2, 9))


@njit_inline
def sincos(x: float) -> tuple[float, float]:
    """sin(x) and cos(x) for |x| < 1e6 (rad), without branches: Taylor's series about the nearest multiple of pi/2."""
    quarters = floor(x * _TWO_OVER_PI + 0.5)
    y = ((x - quarters * _HALF_PI_1) - quarters * _HALF_PI_2) - quarters * _HALF_PI_3
    z = y * y
    zz = z * z
    odd_s = multiply_add(zz, multiply_add(zz, _S13, _S9), _S5)
    even_s = multiply_add(zz, multiply_add(zz, multiply_add(zz, _S15, _S11), _S7), _S3)
    s = multiply_add(y * z, multiply_add(z, odd_s, even_s), y)
    odd_c = multiply_add(zz, multiply_add(zz, _C14, _C10), _C6)
    even_c = multiply_add(zz, multiply_add(zz, multiply_add(zz, _C16, _C12), _C8), _C4)
    c = multiply_add(zz, multiply_add(z, odd_c, even_c), multiply_add(z, -0.5, 1.0))
    turned = quarters - 4.0 * floor(0.25 * quarters)  # 0, 1, 2, 3
    swapped = (turned == 1.0) | (turned == 3.0)  # `in` is a call
    sin_x, cos_x = where(swapped, c, s), where(swapped, s, c)
    return where(turned >= 2.0, -sin_x, sin_x), where((turned == 1.0) | (turned == 2.0), -cos_x, cos_x)


_HALF_PI, _QUARTER_PI = 0.5 * math.pi, 0.25 * math.pi
_TAN_EIGHTH = math.sqrt(2.0) - 1.0  # tan(pi/8)
# arctan(w)/w in powers of z = w^2, for |w| < tan(pi/8)
_A0, _A1, _A2, _A3, _A4, _A5, _A6, _A7, _A8, _A9 = (
    Chebyshev.interpolate(lambda z: np.arctan(np.sqrt(z)) / np.sqrt(z), 9, domain=[0.0, _TAN_EIGHTH**2])
    .convert(kind=Polynomial)
    .coef.tolist()
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

    Reduced to |w| < tan(pi/8) by arctan(t) = pi/2 - arctan(1/t) and arctan(t) = pi/4 + arctan((t-1)/(t+1)), both put
    into the one division of y by x.
    """
    size = abs(y)
    steep = size > x
    low, high = where(steep, x, size), where(steep, size, x)
    middle = low > _TAN_EIGHTH * high
    w = where(middle, low - high, low) / where(middle, low + high, high)
    angle = multiply_add(w, _near_arctan(w), where(middle, _QUARTER_PI, 0.0))
    return math.copysign(where(steep, _HALF_PI - angle, angle), y)


@njit_inline
def arctan_ratio_by_jumps(y: float, x: float) -> float:
    """What `arctan_ratio` is, to the last bit, for a loop over time, whose next step waits for the result.

    Jumps are foreseen by the processor where angles change little from step to step, selections waited for.
    """
    size = abs(y)
    if size <= x:
        low, high = size, x
    else:
        low, high = x, size
    if low > _TAN_EIGHTH * high:
        w = (low - high) / (low + high)
        angle = multiply_add(w, _near_arctan(w), _QUARTER_PI)
    else:
        w = low / high
        angle = w * _near_arctan(w)
    return math.copysign(angle if size <= x else _HALF_PI - angle, y)


@njit_inline
def arctan(x: float) -> float:
    """The angle (rad) in [-pi/2, pi/2] whose tangent is `x`, by a polynomial without branches."""
    return arctan_ratio(x, 1.0)


@njit_inline
def clip(x: float, low: float, high: float) -> float:
    """`x` within [low, high]; NaN stays NaN."""
    above = where(x < low, low, x)
    return where(above > high, high, above)
