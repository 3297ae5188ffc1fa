"""What has no name: functions without a name in the car, and their derivatives."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from test_variational import BASE, estimate, part, shove  # noqa: F401  # fixtures

from bcid.effects.remainder import COEFFICIENT, COLUMNS, DIRECTION, DIRECTIONS, INPUTS, PHASE, WAVE
from bcid.effects.table import effect_switches
from bcid.likelihood.lane_rollout import segment_layout
from bcid.likelihood.predict import linearise_poses, predict_poses
from bcid.likelihood.prediction_inputs import PredictionInputs
from bcid.likelihood.take import N_NUISANCE, Take

LENGTHS = np.array([1.0, 1.0, 1.0, 0.3, 0.3, 0.8, 1.0, 1.0, 2.0, 2.0, 40.0])


def draw_functions(rng: np.random.Generator, each: int, size: float) -> np.ndarray:
    """So many functions in each direction, of random waves and phases, with coefficients of about `size`."""
    table = np.zeros((each * len(DIRECTIONS), COLUMNS))
    table[:, COEFFICIENT] = size * rng.standard_normal(len(table))
    table[:, DIRECTION] = np.repeat(np.arange(len(DIRECTIONS)), each)
    table[:, PHASE] = rng.uniform(0.0, 2.0 * np.pi, len(table))
    table[:, WAVE:] = rng.standard_normal((len(table), len(INPUTS))) / LENGTHS
    return table


def with_functions(take: Take, functions: np.ndarray, on: dict[str, float]) -> PredictionInputs:
    known = BASE.prediction_inputs(BASE.phi_of(BASE.nominal), take)
    return known._replace(switches=effect_switches(on, functions))


@pytest.mark.parametrize(
    "on",
    [
        {},
        {"motor_lag__tau": 0.2, "rear_rolling_viscous__b": 20.0},
        {"tether_pull__k": 3.0, "tyre_relaxation__sigma": 0.2},
    ],
    ids=["base", "lag", "place"],
)
def test_derivatives_of_functions_without_a_name(part: Take, on: dict[str, float]) -> None:  # noqa: F811
    """By each coefficient, and with them on by initial states and pushes, as central differences of predictions."""
    rng = np.random.default_rng(3)
    table, start, layout = draw_functions(rng, 2, 0.05), shove(part), segment_layout(part)
    inputs = with_functions(part, table, on)
    chain, car, e, c = inputs.kernel_arguments
    poses, derivatives = linearise_poses(layout, start, chain, np.array([car]), np.zeros(0), e, c)
    assert derivatives.shape[2] == N_NUISANCE + len(table)
    np.testing.assert_allclose(poses, predict_poses(layout, start, *inputs.kernel_arguments), atol=1e-12)
    columns, h = [], 1e-5
    for j in range(N_NUISANCE + len(table)):
        ends = []
        for sign in (1.0, -1.0):
            functions, states = table.copy(), start.copy()
            if j < N_NUISANCE:
                states[:, j] += sign * h
            else:
                functions[j - N_NUISANCE, COEFFICIENT] += sign * h
            ends.append(predict_poses(layout, states, *with_functions(part, functions, on).kernel_arguments))
        columns.append((ends[0] - ends[1]) / (2.0 * h))
    expected = np.stack(columns, axis=2)
    size = np.abs(expected).max(axis=(0, 1))
    assert (size > 1e-4).all()
    error = np.abs(derivatives - expected) / size
    # a kink within a difference is none of these; how lags follow a turn of the wheel by place is left out
    assert np.quantile(error, 0.95) < (5e-3 if on else 1e-4)
    assert np.median(error.max(axis=(0, 1))) < (5e-2 if on else 1e-2)


def test_functions_with_no_coefficient_change_nothing(part: Take) -> None:  # noqa: F811
    start, layout = shove(part), segment_layout(part)
    known = BASE.prediction_inputs(BASE.phi_of(BASE.nominal), part)
    none = with_functions(part, draw_functions(np.random.default_rng(5), 3, 0.0), {})
    before, after = (predict_poses(layout, start, *i.kernel_arguments) for i in (known, none))
    np.testing.assert_allclose(before, after, atol=1e-12)


def test_a_constant_force_is_a_push(part: Take) -> None:  # noqa: F811
    """A function of wave zero along the body, over the mass, is an acceleration of the pushes."""
    layout, start = segment_layout(part), part.start.copy()
    table = np.zeros((1, COLUMNS))
    table[0, COEFFICIENT] = 0.2
    by_function = predict_poses(layout, start, *with_functions(part, table, {}).kernel_arguments)
    start[:, 6::3] += 0.2
    known: Any = BASE.prediction_inputs(BASE.phi_of(BASE.nominal), part)
    np.testing.assert_allclose(by_function, predict_poses(layout, start, *known.kernel_arguments), atol=1e-12)
