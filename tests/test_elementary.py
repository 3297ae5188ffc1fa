"""The branch-free functions against the C library's, and that they leave NaN as it is."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcid.physics.elementary import arctan, clip, sincos

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
