"""A prediction that leaves the finite numbers: what raises it, and what goes on without it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from bcid.errors import BcidError, InputRefused, PredictionDiverged
from bcid.likelihood.divergence import map_converged, none_if_diverged, refuse_divergence, require_finite


def root(x: float) -> float:
    if x < 0.0:
        raise PredictionDiverged(f"lost at {x}")
    return x**0.5


def test_a_divergence_is_no_message_for_users_and_no_error_of_numpy() -> None:
    assert issubclass(PredictionDiverged, ArithmeticError)
    assert not issubclass(PredictionDiverged, (BcidError, FloatingPointError))


def test_only_a_divergence_is_passed_over() -> None:
    assert none_if_diverged(root, 4.0) == 2.0
    assert none_if_diverged(root, x=-4.0) is None
    with pytest.raises(TypeError):
        none_if_diverged(root, "four")  # type: ignore[arg-type]


def test_what_converges_of_several_is_found_in_their_order_and_no_sooner_than_it_is_asked_for() -> None:
    asked = []

    def ask(x: float) -> float:
        asked.append(x)
        return root(x)

    found = map_converged(ask, [(-1.0,), (4.0,), (9.0,)], required=True)
    assert next(found) == 2.0
    assert asked == [-1.0, 4.0]
    assert list(found) == [3.0]
    assert list(map_converged(root, [(-1.0,), (-2.0,)])) == list(map_converged(root, [], required=True)) == []
    with pytest.raises(PredictionDiverged, match=r"lost at -2\.0"):
        list(map_converged(root, [(-1.0,), (-2.0,)], required=True))
    assert list(map_converged(root, [(4.0,), (-2.0,)], required=True)) == [2.0]


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_no_array_with_other_than_finite_numbers_passes(value: float) -> None:
    require_finite("a prediction", np.zeros(2), np.zeros((0, 3)))
    with pytest.raises(PredictionDiverged, match="a prediction left the finite numbers"):
        require_finite("a prediction", np.zeros(2), np.array([[0.0, value]]))


@pytest.mark.parametrize("error", [PredictionDiverged("the noise left"), np.linalg.LinAlgError("singular")])
def test_recordings_that_no_model_can_follow_are_refused(error: Exception) -> None:
    recordings: Any = [SimpleNamespace(sources=[SimpleNamespace(path="take.csv")])]
    with pytest.raises(InputRefused, match=rf"take\.csv.*cannot follow them: {error}"), refuse_divergence(recordings):
        raise error
    with pytest.raises(ValueError, match="another"), refuse_divergence(recordings):
        raise ValueError("another")
