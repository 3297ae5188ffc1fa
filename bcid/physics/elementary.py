"""Sine, cosine, arc tangent and clipping without branches or calls.

A loop over samples or vehicles whose body is nothing but arithmetic and selections is turned into vector
instructions by the compiler; a call of the C library in it, or a jump, keeps it scalar.  All are within a few units
in the last place of the C library's.
"""

import math

import numpy as np
from numpy.polynomial import Chebyshev, Polynomial

from bcid.compiled.lanes import floor, where
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
    s = y + y * z * (_S3 + z * (_S5 + z * (_S7 + z * (_S9 + z * (_S11 + z * (_S13 + z * _S15))))))
    c = 1.0 - 0.5 * z + z * z * (_C4 + z * (_C6 + z * (_C8 + z * (_C10 + z * (_C12 + z * (_C14 + z * _C16))))))
    turned = quarters - 4.0 * floor(0.25 * quarters)  # 0, 1, 2, 3
    swapped = (turned == 1.0) | (turned == 3.0)  # `in` is a call
    sin_x, cos_x = where(swapped, c, s), where(swapped, s, c)
    return where(turned >= 2.0, -sin_x, sin_x), where((turned == 1.0) | (turned == 2.0), -cos_x, cos_x)


_TAN_EIGHTH = math.sqrt(2.0) - 1.0  # tan(pi/8)
# arctan(w)/w in powers of z = w^2, for |w| < tan(pi/8)
_A0, _A1, _A2, _A3, _A4, _A5, _A6, _A7, _A8, _A9 = (
    Chebyshev.interpolate(lambda z: np.arctan(np.sqrt(z)) / np.sqrt(z), 9, domain=[0.0, _TAN_EIGHTH**2])
    .convert(kind=Polynomial)
    .coef.tolist()
)


@njit_inline
def arctan(x: float) -> float:
    """The angle (rad) in (-pi/2, pi/2) whose tangent is `x`, by a polynomial without branches.

    Reduced to |w| < tan(pi/8) by arctan(x) = pi/2 - arctan(1/x) and arctan(x) = pi/4 + arctan((x-1)/(x+1)).
    """
    size = abs(x)
    steep = size > 1.0
    t = where(steep, 1.0 / where(steep, size, 1.0), size)
    middle = t > _TAN_EIGHTH
    w = where(middle, (t - 1.0) / (t + 1.0), t)
    z = w * w
    even = _A0 + z * (_A1 + z * (_A2 + z * (_A3 + z * (_A4 + z * (_A5 + z * (_A6 + z * (_A7 + z * (_A8 + z * _A9))))))))
    angle = w * even + where(middle, 0.25 * math.pi, 0.0)
    return math.copysign(where(steep, 0.5 * math.pi - angle, angle), x)


@njit_inline
def clip(x: float, low: float, high: float) -> float:
    """`x` within [low, high]; NaN stays NaN."""
    above = where(x < low, low, x)
    return where(above > high, high, above)
