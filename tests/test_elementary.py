"""The branch-free functions against the C library's, and that they leave NaN as it is."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcid.compiled.rebuild import rebuild
from bcid.physics.elementary import arctan, arctan_ratio, arctan_ratio_by_jumps, clip, sincos
from bcid.physics.elementary_single import arctan_ratio_single, sincos_single

ULP = np.finfo(float).eps


@given(st.floats(-1e6, 1e6))
def test_sine_and_cosine_are_the_library_s(x: float) -> None:
    """Also in plain Python, and at the ends of quadrants."""
    for function in (sincos, sincos.py_func):  # type: ignore[attr-defined]
        s, c = function(x)
        assert s == pytest.approx(math.sin(x), abs=2.0 * ULP)
        assert c == pytest.approx(math.cos(x), abs=2.0 * ULP)


@pytest.mark.parametrize("quarter", range(-9, 10))
def test_quadrants_join(quarter: int) -> None:
    edge = 0.25 * math.pi + 0.5 * math.pi * quarter
    for x in (np.nextafter(edge, -np.inf), edge, np.nextafter(edge, np.inf), 0.5 * math.pi * quarter):
        np.testing.assert_allclose(sincos(x), (math.sin(x), math.cos(x)), rtol=0.0, atol=2.0 * ULP)


@given(st.floats(allow_nan=False))
def test_the_arc_tangent_is_the_library_s(x: float) -> None:
    assert arctan(x) == pytest.approx(math.atan(x), abs=4.0 * ULP)
    assert arctan(-x) == -arctan(x)


@given(st.floats(-1e6, 1e6), st.floats(1e-6, 1e6))
def test_the_angle_of_a_ratio_is_the_library_s_and_by_jumps_the_same(y: float, x: float) -> None:
    angle = arctan_ratio(y, x)
    assert angle == pytest.approx(math.atan2(y, x), abs=4.0 * ULP)
    assert arctan_ratio_by_jumps(y, x) == angle
    assert arctan_ratio(-y, x) == -angle


SINGLE_SINCOS, SINGLE_ANGLE = (
    rebuild(f, {}, "bcid.physics.elementary_single", single=True) for f in (sincos_single, arctan_ratio_single)
)


@given(st.floats(-500.0, 500.0, width=32), st.floats(0.0625, 64.0, width=32))
def test_single_precision_has_its_digits(y: float, x: float) -> None:
    y_single, x_single = np.float32(y), np.float32(x)
    s, c = SINGLE_SINCOS(y_single)
    angle = SINGLE_ANGLE(y_single, x_single)
    assert {type(s), type(c), type(angle)} <= {float, np.float32}
    assert SINGLE_SINCOS.nopython_signatures[0].return_type.dtype.bitwidth == 32
    assert (s, c) == (pytest.approx(math.sin(y), abs=4e-7), pytest.approx(math.cos(y), abs=4e-7))
    assert angle == pytest.approx(math.atan2(y, x), abs=4e-7)


def test_small_angles_are_themselves() -> None:
    for x in (1e-3, 1e-8, 1e-300, 0.0):
        assert arctan(x) == pytest.approx(math.atan(x), rel=4.0 * ULP, abs=0.0)
        assert sincos(x)[0] == pytest.approx(math.sin(x), rel=2.0 * ULP, abs=0.0)


@given(st.floats(), st.floats(-5.0, 0.0), st.floats(0.0, 5.0))
def test_clip_is_numpy_s(x: float, low: float, high: float) -> None:
    np.testing.assert_equal(clip(x, low, high), float(np.clip(x, low, high)))


def test_what_is_no_number_stays_none() -> None:
    assert np.isnan(sincos(math.nan)).all()
    assert math.isnan(arctan(math.nan))
