"""The car with what has no name: where it was driven it has that, where it was not it is the car with its names."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from concealed import USUAL, concealing
from test_augmented import LIMIT, augmented

from bcid.adaptation.adapt import as_adaptable
from bcid.diagnosis.judge import fitted_models, free_functions
from bcid.diagnosis.judge.fitted_models import model_from_fit
from bcid.diagnosis.judge.free_functions import (
    add_free_functions,
    best_share,
    held_out_share,
    trained_on_first_half,
)
from bcid.diagnosis.judge.held_out import split_halves
from bcid.diagnosis.judge.prediction_error import compare_predictions
from bcid.diagnosis.reference import reference_from_model
from bcid.diagnosis.reference_model import ReferenceModel
from bcid.diagnosis.remainder.beside_names import fit_beside_held_names
from bcid.effects.harmonics import INVERSE_POWERS, POWERS, plan_angles
from bcid.effects.remainder_table import COEFFICIENT, COLUMNS, DIRECTION, DIRECTIONS, INPUTS, OF_THE_CAR, PHASE, WAVE
from bcid.errors import InputRefused, PredictionDiverged, UsageError
from bcid.estimate.run import estimate_motion
from bcid.estimate.types import Estimate
from bcid.evaluation.closed_loop import position_errors
from bcid.export.exported import export_model
from bcid.models.interface import FitTask, history_at, history_at_rest, rollout
from bcid.models.newton_euler.augmented import AugmentedNewtonEuler
from bcid.models.newton_euler.augmented_step import actuate_period, unpack_carry
from bcid.models.newton_euler.remainder_step import advance_with_remainder, driven_share
from bcid.models.newton_euler.unnamed_part import UnnamedPart
from bcid.models.newton_euler.with_remainder import NewtonEulerWithRemainder
from bcid.models.saving import load_model, save_model
from bcid.prediction.constants import vary_constants
from bcid.proof.real import transfer
from bcid.proof.real.question_files import reference_as_row
from bcid.recording.types import Recording
from bcid.simulation.car import Plant
from bcid.simulation.drive import simulate_drive
from bcid.vehicle import Vehicle
from bcid.virtual_lab import TUNING, record_drive, simulated_vehicle

ANYWHERE = np.tile([-1e3, 1e3], (OF_THE_CAR, 1))
DECELERATION = -0.5  # m/s^2


def slowed_car(driven: np.ndarray = ANYWHERE, facts: dict[str, Any] | None = None, **effects: float) -> Any:
    """A car with a constant deceleration that has no name, where its state is `driven`."""
    functions = np.zeros((1, COLUMNS))
    functions[0, COEFFICIENT], functions[0, DIRECTION] = DECELERATION, DIRECTIONS.index("body_x")
    return NewtonEulerWithRemainder(
        augmented(facts, **effects), UnnamedPart(functions, np.zeros((len(INPUTS), 2)), driven)
    )


def slowed_by(model: Any, v: float = 1.5) -> float:
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
    assert slowed_by(slowed_car()) == pytest.approx(0.1 * DECELERATION, rel=0.1)  # drag makes up for a part


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
    assert slowed_by(slowed_car(ranges)) == pytest.approx(share * slowed_by(slowed_car()), rel=1e-9, abs=1e-12)


def test_the_compiled_steps_are_the_plain_ones(estimates: list[Estimate]) -> None:
    model = slowed_car(within("omega", low=-0.1, high=0.1), motor_delay__tau=0.1, steering_offset__o=0.05)
    parts = np.array([[0.03, 0.1, 1.2, 0.3], [0.07, 0.4, 1.5, 0.0]])
    state = unpack_carry(model.named.init(history_at(estimates[0], 40, 10)))
    act = actuate_period(state, parts, model.setup.named)
    shares = [share(state, act, model.setup) for share in (driven_share.py_func, driven_share)]  # type: ignore[attr-defined]
    assert 0.0 < shares[0] < 1.0
    assert shares[0] == pytest.approx(shares[1], abs=1e-12)
    plain, compiled = (
        f(state, parts, model.setup)
        for f in (advance_with_remainder.py_func, advance_with_remainder)  # type: ignore[attr-defined]
    )
    np.testing.assert_allclose(np.array(plain.body), np.array(compiled.body), atol=1e-12)


def share_after(model: Any, command: tuple[float, float], periods: int) -> float:
    """The share with which functions act after so many periods under a constant command, from rest."""
    carry = model.init(history_at_rest(10))
    for _ in range(periods):
        carry, _ = model.step(carry, np.array(command))
    state = unpack_carry(carry)
    parts = np.array([[0.1, *command, 0.0]])
    return float(driven_share(state, actuate_period(state, parts, model.setup.named), model.setup))


def test_the_share_is_of_what_the_actuators_do_not_of_what_is_asked_for() -> None:
    """A wheel at its lock stands still whatever is asked for; one that waits for a late command does so, too."""
    slow = within("delta_rate", low=-0.2, high=0.2)
    assert share_after(slowed_car(slow), (LIMIT + 0.3, 0.0), 60) == pytest.approx(1.0, abs=1e-3)
    assert share_after(slowed_car(slow), (0.5, 0.0), 0) < 0.1
    assert share_after(slowed_car(slow, steering_delay__tau=0.3), (0.5, 0.0), 1) == 1.0
    throttle = within("u_m", low=-0.1, high=0.1)
    assert share_after(slowed_car(throttle), (0.0, 0.3), 0) == pytest.approx(np.exp(-2.0))
    assert share_after(slowed_car(throttle, motor_delay__tau=0.3), (0.0, 0.3), 1) == 1.0


def test_steps_are_the_rollout_of_one_car_and_of_many(estimates: list[Estimate]) -> None:
    model, take = slowed_car(within("v_x", low=0.0, high=1.0)), estimates[0]
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
    model = slowed_car(within("v_x", low=0.0, high=1.0), {"fitted": ("K_t",), "se": {"K_t": 2.5}}, motor_delay__tau=0.1)
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
        ("functions", (0, WAVE), 1e9, "not within"),
        ("driven", (2, 0), 2e3, "ends before it begins"),
    ],
)
def test_arrays_that_are_no_such_model_s_are_refused(name: str, place: Any, value: float, told: str) -> None:
    data, arrays = slowed_car().to_saved()
    arrays = {key: array.copy() for key, array in arrays.items()}
    arrays[name][place] = value
    with pytest.raises(ValueError, match=told):
        NewtonEulerWithRemainder.from_saved(data, arrays)
    with pytest.raises(ValueError, match="is missing"):
        NewtonEulerWithRemainder.from_saved(data, {})
    many = np.tile(slowed_car().unnamed.functions, (1000, 1))
    with pytest.raises(ValueError, match="at most"):
        NewtonEulerWithRemainder.from_saved(data, {**slowed_car().to_saved()[1], "functions": many})


def test_no_ratio_of_waves_leads_out_of_the_table_of_powers() -> None:
    """A multiple of -2^63 has no absolute value among whole numbers; of an endless one there is none either."""
    for wave, half_wave in ((-(2.0**25), 2.0**-38), (1.0, 1e-300), (9.0, 1.0)):
        functions, half_waves = slowed_car().unnamed.functions.copy(), np.zeros((len(INPUTS), 2))
        functions[0, WAVE], half_waves[0, 1] = wave, half_wave
        plan = plan_angles(functions, half_waves)
        assert plan.factors[0].tolist() == [1, 0, 0, 0]
        assert plan.angles[:, [POWERS, INVERSE_POWERS]].tolist() == [[1.0, 0.0]]


def test_it_is_for_predictions_alone(tmp_path: Path, vehicle: Vehicle, estimates: list[Estimate]) -> None:
    model = slowed_car()
    with pytest.raises(UsageError, match="bcid diagnose"):
        NewtonEulerWithRemainder.fit(FitTask(estimates, vehicle, {}, 1))
    for of_vehicle in (False, True):
        with pytest.raises(UsageError, match="no export writes"):
            export_model(model, "0" * 64, None, of_vehicle=of_vehicle)
    with pytest.raises(UsageError, match="free functions"):
        as_adaptable(model, vehicle, estimates[0])
    save_model(model, tmp_path)
    with pytest.raises(InputRefused, match="free functions"):
        reference_from_model(tmp_path)


def test_errors_of_constants_are_those_of_the_names_beside_what_has_none() -> None:
    model = slowed_car(facts={"fitted": ("K_t",), "se": {"K_t": 2.5}})
    (varied,) = vary_constants(model).variations
    for car, sign in ((varied.raised, 1.0), (varied.lowered, -1.0)):
        assert isinstance(car, NewtonEulerWithRemainder)
        assert car.unnamed is model.unnamed
        assert car.named.car.K_t == pytest.approx(model.named.car.K_t + sign * 2.5)


# --- how it is found --------------------------------------------------------------------------------------------------

LACKING: dict[str, float] = {"steering_drag": 60.0}


def drive(seconds: float, seed: int) -> tuple[Recording, Estimate]:
    """A drive of the car that lacks something, and its motion."""
    vehicle = simulated_vehicle()
    recording = record_drive(simulate_drive(Plant(**LACKING), USUAL, seconds, seed), 60.0, vehicle)
    return recording, estimate_motion(recording, vehicle, TUNING)


def test_beside_a_car_that_lacks_something_it_predicts_another_drive_better() -> None:
    """Half of the error at most, and no function of the place or of the time."""
    fit, take = concealing(120.0, **LACKING)
    _, other = drive(60.0, 9)
    named, whole = model_from_fit(fit, 60.0, other.period_s), add_free_functions(fit, take, 60.0, other.period_s)
    assert isinstance(whole, NewtonEulerWithRemainder)
    assert not whole.unnamed.functions[:, WAVE + OF_THE_CAR :].any()
    alone, beside = (np.median(position_errors(m, other, 2.0)) for m in (named, whole))
    assert beside < 0.5 * alone


def test_the_car_stays_where_it_is_while_functions_are_found() -> None:
    """Though other parameters would be likelier beside them."""
    fit, take = concealing(120.0, steering_drag=120.0, rear_bearing=40.0)
    held = fit_beside_held_names(fit, take)
    assert len(held.on)
    for symbol in fit.hypothesis.log_parameters:
        assert getattr(held.fit.car(), symbol) == pytest.approx(getattr(fit.car(), symbol), rel=0.005)


def test_on_the_drive_that_it_was_found_from_it_acts_in_full_nearly_always() -> None:
    """The servo of this car turns faster than it does in any mean over a quarter of a second."""
    fit, take = concealing(120.0, **LACKING)
    _, estimate = drive(120.0, 4)
    whole = add_free_functions(fit, take, 120.0, estimate.period_s)
    assert isinstance(whole, NewtonEulerWithRemainder)
    shares = []
    for k in range(20, len(estimate) - 1, 7):
        state = unpack_carry(whole.init(history_at(estimate, k, whole.lags)))
        act = actuate_period(state, estimate.parts[k], whole.setup.named)
        shares.append(float(driven_share(state, act, whole.setup)))
    assert np.mean(np.array(shares) > 0.9) > 0.9


def test_nothing_is_found_beside_a_car_that_lacks_nothing() -> None:
    fit, take = concealing(120.0)
    model = add_free_functions(fit, take, 120.0, 0.1)
    assert isinstance(model, AugmentedNewtonEuler) or slowed_by(model) == pytest.approx(0.0, abs=2e-3)


@pytest.mark.parametrize(("times", "share"), [(1.0, 1.0), (2.0, 0.5), (4.0, 0.25), (-1.0, 0.0)])
def test_functions_are_taken_at_the_share_of_their_size_that_does_most_good(times: float, share: float) -> None:
    """Those that are twice as large as they should be at half of it; those that do harm not at all."""
    fit, take = concealing(120.0, **LACKING)
    _, other = drive(60.0, 9)
    whole = add_free_functions(fit, take, 60.0, other.period_s)
    assert isinstance(whole, NewtonEulerWithRemainder)
    halves = [whole.scale_functions(times)] * 2
    assert best_share(halves, other, trained_on_first_half(other, take, 0.0)) == share
    named = [whole.named] * 2
    assert best_share(named, other, trained_on_first_half(other, take, 0.0)) == 0.0


def test_held_out_errors_with_it_are_told() -> None:
    fit, take = concealing(120.0, **LACKING)
    recording, estimate = drive(120.0, 4)
    vehicle = simulated_vehicle()
    rows, _, share = compare_predictions(fit, fit, take, recording, estimate, vehicle, TUNING, with_remainder=True)
    assert share == held_out_share(fit, take, estimate, recording.poses.time_s[0]) > 0.5
    two = next(row for row in rows if row.horizon_s == 2.0)
    assert two.nmse_remainder is not None
    assert two.nmse_after is not None
    assert two.nmse_remainder < 0.5 * two.nmse_after
    assert two.remainder_ratio_ci95 is not None
    assert two.remainder_ratio_ci95[1] < 1.0
    assert two.remainder_lost == 0.0
    without = compare_predictions(fit, fit, take, recording, estimate, vehicle, TUNING)
    assert all(row.nmse_remainder is row.remainder_lost is None for row in without.horizons)


@pytest.mark.parametrize("diverges", [False, True])
def test_functions_are_found_from_the_half_that_the_car_was_fitted_to(
    diverges: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where that fit diverges, too, and the whole one stands in for it."""
    fit, take = concealing(120.0, **LACKING)
    recording, estimate = drive(120.0, 4)
    asked = list[Any]()

    def find(own: Any, part: Any) -> None:
        assert len(own.start) == part.segments
        asked.append(part.begin_s)

    def refuse(*_: Any) -> Any:
        raise PredictionDiverged("")

    monkeypatch.setattr(free_functions, "unnamed_part_beside", find)
    if diverges:
        monkeypatch.setattr(fitted_models, "refit_on_half", refuse)
    found = compare_predictions(
        fit, fit, take, recording, estimate, simulated_vehicle(), TUNING, with_remainder=True
    )  # fmt: skip
    for begin_s, half in zip(asked, split_halves(take), strict=True):
        np.testing.assert_array_equal(begin_s, take.begin_s[half])
    assert all(row.nmse_remainder is None for row in found.horizons)  # nothing was found
    assert found.function_share == 0.0


@pytest.mark.parametrize("something", [True, False])
def test_it_is_what_a_transfer_predicts_with(something: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """By way of a row as JSON; where a drive left nothing it is the names alone."""
    model, (_, other) = slowed_car(within("v_x", low=0.0, high=1.0)), drive(30.0, 9)
    arrays = {name: array.tolist() for name, array in model.unnamed._asdict().items()}
    car = reference_as_row(ReferenceModel(model.named.car, {}))
    row = json.loads(json.dumps({"base": car, "model": car, "findings": [], "unnamed": arrays if something else None}))
    monkeypatch.setattr(transfer, "_read", lambda name, inputs: (simulated_vehicle(), other))
    monkeypatch.setattr(transfer, "REGRESSIONS", {})
    monkeypatch.setattr(transfer, "_fit_sparse_model", lambda vehicle, estimate: model.named)
    pair, inputs = SimpleNamespace(fit="a", test="b"), SimpleNamespace(published_model=lambda *_: None)
    errors = transfer.predict_other_drive(pair, inputs, row)["errors"]  # type: ignore[arg-type]
    assert (errors["augmented"] == errors["base"]) == (not something)
    assert errors.get("names alone") == (errors["base"] if something else None)
    expected = np.median(position_errors(model if something else model.named, other, 2.0))
    assert errors["augmented"]["median_m"] == pytest.approx(expected, abs=2e-4)
