"""The car with what has no name: where it was driven it has that, where it was not it is the car with its names."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from concealed import USUAL, concealing
from test_augmented import augmented

from bcid.adaptation.adapt import as_adaptable
from bcid.diagnosis.judge.prediction_error import add_remainder, compare_predictions, model_from_fit
from bcid.diagnosis.reference import reference_from_model
from bcid.diagnosis.remainder.beside_names import unnamed_part_beside
from bcid.effects.remainder_table import COEFFICIENT, COLUMNS, DIRECTION, DIRECTIONS, INPUTS, OF_THE_CAR, PHASE, WAVE
from bcid.errors import InputRefused, UsageError
from bcid.estimate.run import estimate_motion
from bcid.estimate.types import Estimate
from bcid.evaluation.closed_loop import position_errors
from bcid.export.exported import export_model
from bcid.models.interface import FitTask, history_at, history_at_rest, rollout
from bcid.models.newton_euler.augmented import AugmentedNewtonEuler
from bcid.models.newton_euler.augmented_step import unpack_carry
from bcid.models.newton_euler.remainder_step import advance_with_remainder, driven_share
from bcid.models.newton_euler.unnamed_part import UnnamedPart
from bcid.models.newton_euler.with_remainder import NewtonEulerWithRemainder
from bcid.models.saving import load_model, save_model
from bcid.prediction.constants import vary_constants
from bcid.simulation.car import Plant
from bcid.simulation.drive import simulate_drive
from bcid.vehicle import Vehicle
from bcid.virtual_lab import TUNING, record_drive, simulated_vehicle

ANYWHERE = np.tile([-1e3, 1e3], (OF_THE_CAR, 1))
DECELERATION = -0.5  # m/s^2


def slowed(driven: np.ndarray = ANYWHERE, facts: dict[str, Any] | None = None, **effects: float) -> Any:
    """A car with a constant deceleration that has no name, where its state is `driven`."""
    functions = np.zeros((1, COLUMNS))
    functions[0, COEFFICIENT], functions[0, DIRECTION] = DECELERATION, DIRECTIONS.index("body_x")
    return NewtonEulerWithRemainder(
        augmented(facts, **effects), UnnamedPart(functions, np.zeros((len(INPUTS), 2)), driven)
    )


def slower(model: Any, v: float = 1.5) -> float:
    """By how much (m/s) a car that coasts ahead at `v` (m/s) is slower after a period than with its names alone."""
    history = history_at_rest(10)
    history = replace(history, twist=np.tile([v, 0.0, 0.0], (11, 1)))
    one, other = (m.step(m.init(history), np.array([0.0, 0.0]))[1] for m in (model, model.named))
    return float(one[0] - other[0])


def within(*names: str, low: float, high: float) -> np.ndarray:
    ranges = ANYWHERE.copy()
    ranges[[INPUTS.index(name) for name in names]] = low, high
    return ranges


def test_what_has_no_name_acts_in_full_where_the_car_was_driven() -> None:
    assert slower(slowed()) == pytest.approx(0.1 * DECELERATION, rel=0.1)  # drag makes up for a part


@pytest.mark.parametrize(
    ("ranges", "share"),
    [
        (within("v_x", low=0.0, high=2.0), 1.0),
        (within("v_x", low=0.5, high=1.0), np.exp(-2.0)),  # half a metre a second beyond a range of as much
        (within("v_fx", low=2.5, high=4.5), np.exp(-1.0)),
        (within("v_x", "v_fx", low=0.5, high=1.0), np.exp(-4.0)),
        (within("delta", low=0.2, high=0.2002), 0.0),
    ],
)
def test_it_fades_beyond_by_the_distance_over_half_of_the_range(ranges: np.ndarray, share: float) -> None:
    assert slower(slowed(ranges)) == pytest.approx(share * slower(slowed()), rel=1e-9, abs=1e-12)


def test_the_compiled_steps_are_the_plain_ones(estimates: list[Estimate]) -> None:
    model = slowed(within("omega", low=-0.1, high=0.1), motor_delay__tau=0.1, steering_offset__o=0.05)
    history, parts = history_at(estimates[0], 40, 10), np.array([[0.03, 0.1, 1.2, 0.3], [0.07, 0.4, 1.5, 0.0]])
    state = unpack_carry(model.named.init(history))
    assert 0.0 < driven_share(state, parts, model.setup) < 1.0
    for kernel in (driven_share, advance_with_remainder):
        plain, compiled = kernel.py_func(state, parts, model.setup), kernel(state, parts, model.setup)
        plain, compiled = (getattr(x, "body", x) for x in (plain, compiled))
        np.testing.assert_allclose(np.array(plain), np.array(compiled), atol=1e-12)


def test_steps_are_the_rollout_of_one_car_and_of_many(estimates: list[Estimate]) -> None:
    model, take = slowed(within("v_x", low=0.0, high=1.0)), estimates[0]
    history = history_at(take, 50, model.lags)
    carry, twists = model.init(history), [history.twist[-1]]
    for command in take.command[50:80]:
        carry, twist = model.step(carry, command)
        twists.append(twist)
    np.testing.assert_allclose(rollout(model, history, take.command[50:80]), twists, rtol=0.0, atol=1e-12)
    carries, many = model.scan_many(np.tile(model.init(history), (2, 1)), np.tile(take.command[50:80], (2, 1, 1)))
    np.testing.assert_allclose(many, np.tile(twists[1:], (2, 1, 1)), rtol=0.0, atol=1e-12)
    np.testing.assert_array_equal(carries[0], carries[1])


# --- what can be done with it -----------------------------------------------------------------------------------------


def test_saving_and_loading_gives_the_identical_model(tmp_path: Path) -> None:
    model = slowed(within("v_x", low=0.0, high=1.0), {"fitted": ("K_t",), "se": {"K_t": 2.5}}, motor_delay__tau=0.1)
    save_model(model, tmp_path)
    again = load_model(tmp_path)
    assert isinstance(again, NewtonEulerWithRemainder)
    assert again == model
    assert again.describe() == model.describe()
    assert "0 <= v_x        <= 1" in model.describe()
    assert again.parameter_count == 3
    np.testing.assert_equal(again.unnamed._asdict(), model.unnamed._asdict())
    assert again.with_period(0.05).period_s == 0.05


@pytest.mark.parametrize(
    ("name", "place", "value", "told"),
    [
        ("functions", (0, WAVE + INPUTS.index("p_x")), 1.0, "place or the time"),
        ("functions", (0, DIRECTION), 3.5, "acts in no direction"),
        ("functions", (0, DIRECTION), 99.0, "acts in no direction"),
        ("functions", (0, PHASE), np.nan, "not finite"),
        ("driven", (2, 0), 2e3, "ends before it begins"),
    ],
)
def test_arrays_that_are_no_such_model_s_are_refused(name: str, place: Any, value: float, told: str) -> None:
    data, arrays = slowed().to_saved()
    arrays = {key: array.copy() for key, array in arrays.items()}
    arrays[name][place] = value
    with pytest.raises(ValueError, match=told):
        NewtonEulerWithRemainder.from_saved(data, arrays)
    with pytest.raises(ValueError, match="is missing"):
        NewtonEulerWithRemainder.from_saved(data, {})
    many = np.tile(slowed().unnamed.functions, (1000, 1))
    with pytest.raises(ValueError, match="at most"):
        NewtonEulerWithRemainder.from_saved(data, {**slowed().to_saved()[1], "functions": many})


def test_it_is_for_predictions_alone(tmp_path: Path, vehicle: Vehicle, estimates: list[Estimate]) -> None:
    model = slowed()
    with pytest.raises(UsageError, match="bcid diagnose"):
        NewtonEulerWithRemainder.fit(FitTask(estimates, vehicle, {}, 1))
    with pytest.raises(UsageError, match="no export writes"):
        export_model(model, "0" * 64, None)
    with pytest.raises(UsageError, match="no constants of a car"):
        as_adaptable(model, vehicle, estimates[0])
    save_model(model, tmp_path)
    with pytest.raises(InputRefused, match="forces all have a name"):
        reference_from_model(tmp_path)


def test_errors_of_constants_are_those_of_the_names_beside_what_has_none() -> None:
    model = slowed(facts={"fitted": ("K_t",), "se": {"K_t": 2.5}})
    (varied,) = vary_constants(model).variations
    for car, sign in ((varied.raised, 1.0), (varied.lowered, -1.0)):
        assert isinstance(car, NewtonEulerWithRemainder)
        assert car.unnamed is model.unnamed
        assert car.named.car.K_t == pytest.approx(model.named.car.K_t + sign * 2.5)


# --- how it is found --------------------------------------------------------------------------------------------------

LACKING: dict[str, float] = {"steering_drag": 60.0}


def test_beside_a_car_that_lacks_something_it_predicts_another_drive_better() -> None:
    """Half of the error at least, and no place, no time and no change of the car in it."""
    fit, take = concealing(120.0, **LACKING)
    unnamed = unnamed_part_beside(fit, take)
    assert unnamed is not None
    assert not unnamed.functions[:, WAVE + OF_THE_CAR :].any()
    vehicle = simulated_vehicle()
    other = estimate_motion(
        record_drive(simulate_drive(Plant(**LACKING), USUAL, 60.0, 9), 60.0, vehicle), vehicle, TUNING
    )
    named = model_from_fit(fit, 60.0, other.period_s)
    whole = add_remainder(fit, take, 60.0, other.period_s)
    assert isinstance(named, AugmentedNewtonEuler)
    assert isinstance(whole, NewtonEulerWithRemainder)
    assert whole.named.car == named.car
    alone, beside = (np.median(position_errors(m, other, 2.0)) for m in (named, whole))
    assert beside < 0.5 * alone


def test_nothing_is_found_beside_a_car_that_lacks_nothing() -> None:
    fit, take = concealing(120.0)
    model = add_remainder(fit, take, 120.0, 0.1)
    alone = model_from_fit(fit, 120.0, 0.1)
    assert (model == alone) or slower(model) == pytest.approx(0.0, abs=2e-3)


def test_held_out_errors_with_it_are_told() -> None:
    fit, take = concealing(120.0, **LACKING)
    vehicle = simulated_vehicle()
    recording = record_drive(simulate_drive(Plant(**LACKING), USUAL, 120.0, 4), 60.0, vehicle)
    estimate = estimate_motion(recording, vehicle, TUNING)
    rows, _ = compare_predictions(fit, fit, take, recording, estimate, vehicle, TUNING, with_remainder=True)
    two = next(row for row in rows if row.horizon_s == 2.0)
    assert two.nmse_remainder is not None
    assert two.nmse_after is not None
    assert two.nmse_remainder < 0.5 * two.nmse_after
    assert two.remainder_lost == 0.0
    without, _ = compare_predictions(fit, fit, take, recording, estimate, vehicle, TUNING)
    assert all(row.nmse_remainder is None for row in without)
