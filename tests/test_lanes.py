"""Vectors of numbers compute what numbers do, one by one."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numba
import numpy as np
import pytest
from numba.core.errors import TypingError

from bcid.compiled.lane_access import gather_lanes, load_lanes, store_lanes
from bcid.compiled.lanes import LANES, any_lane, floor, multiply_add, where
from bcid.physics.elementary import arctan, clip, sincos

X = np.array([1.5, -2.0, 0.0, 1e3, 0.7, -1e-9, 12.0, -3.5])
Y = np.array([-0.5, -2.0, 3.0, 0.25, -7.0, 1e-9, 2.0, 0.1])


def _grown(x: Any, y: Any) -> Any:
    x += y
    x *= 3.0
    x -= 1.0
    return x


FUNCTIONS: dict[str, Callable[[Any, Any], Any]] = {
    "sums": lambda x, y: x + y - 2.0 * x,
    "quotients": lambda x, y: -x / y,
    "grown": _grown,
    "size": lambda x, y: abs(x) + math.sqrt(abs(y)),
    "sign": lambda x, y: math.copysign(2.0, x) + math.copysign(x, y),
    "least": lambda x, y: min(x, y) + 2.0 * min(x, 0.5),
    "largest": lambda x, y: max(x, y) + 2.0 * max(0.5, y),
    "floor": lambda x, y: floor(x * y),
    "chosen": lambda x, y: where((x > y) | (x == 0.0), x, 2.0 * y),
    "among": lambda x, y: where((x >= 0.0) & (y != 3.0), 1.0, where(x < y, 2.0, where(x <= y, 3.0, 4.0))),
    "called": lambda x, y: math.tanh(x) + math.exp(y) + math.hypot(x, y),
    "turned": lambda x, y: sincos(x)[0] + sincos(y)[1],
    "slip": lambda x, y: arctan(x / y) + clip(x, -1.0, 1.0),
    "fused": lambda x, y: multiply_add(x, y, 2.0) + multiply_add(0.5, x, y) + multiply_add(2.0, 0.5, x),
    "none": lambda x, y: x if any_lane(x > 1e6) else y,
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_each_lane_is_a_number_of_its_own(name: str) -> None:
    function = numba.njit(FUNCTIONS[name])

    @numba.njit
    def all_at_once(x: Any, y: Any) -> Any:
        out = np.empty(LANES)
        store_lanes(function(load_lanes(x, 0), load_lanes(y, 0)), out, 0)
        return out

    each = [function(x, y) for x, y in zip(X, Y, strict=True)]
    np.testing.assert_allclose(all_at_once(X, Y), each, rtol=1e-15)


@pytest.mark.parametrize("above", [-3.0, 0.7, 2.0, 1e4])
def test_some_is_any_of_them(above: float) -> None:
    @numba.njit
    def any_above(x: Any, y: float) -> bool:
        return any_lane(load_lanes(x, 0) > y)

    assert any_above(X, above) == (above < X).any()


@pytest.mark.parametrize("x", [math.nan, 1.0])
def test_the_lesser_of_what_is_none_is_as_for_one_number(x: float) -> None:
    @numba.njit
    def both(x: Any, y: Any) -> Any:
        return min(x, y), max(x, y)

    @numba.njit
    def abreast(x: Any, y: Any) -> Any:
        low, high = both(load_lanes(x, 0), load_lanes(y, 0))
        out = np.empty((2, LANES))
        store_lanes(low, out[0], 0)
        store_lanes(high, out[1], 0)
        return out

    for y in (2.0, math.nan):
        np.testing.assert_array_equal(abreast(np.full(LANES, x), np.full(LANES, y))[:, 1], both(x, y))


def test_what_is_computed_in_plain_python_is_the_same() -> None:
    assert [floor(x) for x in (-0.5, 2.0)] == [-1.0, 2.0]
    assert (where(True, 1.0, 2.0), where(False, 1.0, 2.0), any_lane(False)) == (1.0, 2.0, False)
    plain: Any = arctan
    assert [plain.py_func(x) for x in (0.0, 2.0)] == pytest.approx([0.0, math.atan(2.0)], abs=1e-15)


@pytest.mark.parametrize("x", [math.nan, -math.nan])
def test_no_number_stays_none(x: float) -> None:
    """It is neither above nor below anything, and unequal to it; a clipped one stays, as for one number."""

    @numba.njit
    def compared(x: Any) -> Any:
        v, out = load_lanes(x, 0), np.empty((3, LANES))
        store_lanes(where(v > 0.0, 1.0, where(v <= 0.0, 2.0, 3.0)), out.reshape(out.size), 0)
        store_lanes(where(v != 0.0, 1.0, 0.0), out.reshape(out.size), LANES)
        store_lanes(clip(v, -1.0, 1.0), out.reshape(out.size), 2 * LANES)
        return out

    told = compared(np.full(LANES, x))
    np.testing.assert_array_equal(told[0], 3.0)
    np.testing.assert_array_equal(told[1], 1.0)
    assert np.isnan(told[2]).all()


def test_numbers_are_picked_from_anywhere() -> None:
    @numba.njit
    def every(numbers: Any, places: Any) -> Any:
        out = np.empty(LANES)
        store_lanes(gather_lanes(numbers, places, 2), out, 0)
        return out

    assert every(np.arange(20.0), np.array([3, 0, 17, 3, 1, 2, 9, 5])).tolist() == [
        5.0, 2.0, 19.0, 5.0, 3.0, 4.0, 11.0, 7.0,
    ]  # fmt: skip


def test_only_contiguous_doubles_are_taken_abreast() -> None:
    @numba.njit
    def first(numbers: Any) -> Any:
        store_lanes(load_lanes(numbers, 0), np.empty(LANES), 0)

    for numbers in (np.arange(20.0)[::2], np.arange(20, dtype=np.float32)):
        with pytest.raises(TypingError, match="contiguous arrays of doubles"):
            first(numbers)
