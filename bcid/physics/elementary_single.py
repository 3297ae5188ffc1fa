"""Sine, cosine and arc tangent for single precision: those of `elementary`, with no more terms than its digits ask for.

They are put under an equation by `bcid.compiled.rebuild`, which also takes their numbers in single precision.
"""

import math

import numpy as np

from bcid.compiled.lanes import floor, multiply_add, where
from bcid.compiled.njit import njit_inline
from bcid.physics.elementary import cosine_series, near_zero, sine_series

_PER_PI, _HALF_PI, _QUARTER_PI, _TAN_EIGHTH = 1.0 / math.pi, 0.5 * math.pi, 0.25 * math.pi, math.sqrt(2.0) - 1.0
# pi in two parts; a whole number below 2^12 times the first is exact in single precision
_PI_1 = math.ldexp(math.floor(math.ldexp(math.pi, 10)), -10)
_PI_2 = math.pi - _PI_1
_S3, _S5, _S7, _S9 = near_zero(sine_series, 3, _HALF_PI**2)
_C4, _C6, _C8, _C10 = near_zero(cosine_series, 3, _HALF_PI**2)
_A0, _A1, _A2, _A3, _A4 = near_zero(lambda z: np.arctan(np.sqrt(z)) / np.sqrt(z), 4, _TAN_EIGHTH**2)


@njit_inline
def sincos_single(x: float) -> tuple[float, float]:
    """sin(x) and cos(x) for |x| < 1e3 (rad) to the digits of single precision, without branches."""
    turns = floor(multiply_add(x, _PER_PI, 0.5))
    y = multiply_add(turns, -_PI_2, multiply_add(turns, -_PI_1, x))
    z = y * y
    zz = z * z
    s = multiply_add(y * z, multiply_add(zz, multiply_add(z, _S9, _S7), multiply_add(z, _S5, _S3)), y)
    series_c = multiply_add(zz, multiply_add(z, _C10, _C8), multiply_add(z, _C6, _C4))
    c = multiply_add(zz, series_c, multiply_add(z, -0.5, 1.0))
    half = 0.5 * turns
    reversed_ = half != floor(half)
    return where(reversed_, -s, s), where(reversed_, -c, c)


@njit_inline
def arctan_ratio_single(y: float, x: float) -> float:
    """The angle (rad) in [-pi/2, pi/2] whose tangent is y/x, for x > 0, to the digits of single precision.

    It is `bcid.physics.elementary.arctan_ratio` with a shorter polynomial.
    """
    size, signed_x = abs(y), math.copysign(x, y)
    flat, steep = size <= _TAN_EIGHTH * x, x <= _TAN_EIGHTH * size
    over = where(flat, y, where(steep, -signed_x, y - signed_x))
    w = over / where(flat, x, where(steep, size, x + size))
    z = w * w
    odd = multiply_add(z * z, multiply_add(z, _A4, _A3), multiply_add(z, _A2, _A1))
    offset = math.copysign(where(flat, 0.0, where(steep, _HALF_PI, _QUARTER_PI)), y)
    return multiply_add(w, multiply_add(z, odd, _A0), offset)
