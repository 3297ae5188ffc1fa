"""What a drive shows of withheld physics, its equivalents, its day's simulation: on simulated drives of known truth."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from cars import CAR
from concealed import concealing

from bcid.aliases import Floats
from bcid.diagnosis.diagnose import BaseFit, fit_base_model
from bcid.diagnosis.judge.fitted_models import model_from_reference
from bcid.diagnosis.reference_model import ReferenceModel
from bcid.effects.harmonics import plan_angles
from bcid.effects.remainder_table import COLUMNS
from bcid.estimate.run import estimate_motion
from bcid.estimate.types import Estimate
from bcid.evaluation.closed_loop import position_errors
from bcid.likelihood.hypothesis import Hypothesis
from bcid.likelihood.limits import LIKELIHOOD_LIMITS
from bcid.likelihood.refit import Fit, refit
from bcid.likelihood.scales import Scales
from bcid.likelihood.take import Take
from bcid.likelihood.tracking_functions import TRACKING_COLUMNS
from bcid.likelihood.unnamed_functions import NO_UNNAMED, UnnamedFunctions
from bcid.proof.blind.regressors import fit_boosted_trees, fit_perceptron
from bcid.proof.real import day_model, edited, oracle
from bcid.proof.real.day_model import calibrate_simulation, shared_effects
from bcid.proof.real.misfit import error_ratios, prediction_rmse, whole_misfit
from bcid.proof.real.oracle import find_equivalents, fit_true_structure
from bcid.proof.real.question_files import QuestionInputs, reference_as_row, reference_from_row
from bcid.proof.real.questions import EditedQuestion
from bcid.proof.real.replication import compare_sizes
from bcid.proof.real.residual_model import fit_residual_model
from bcid.proof.real.scoring import given_names
from bcid.proof.real.variations import PARTS, STARTS, cut_recording, move_start
from bcid.recording.types import Recording
from bcid.simulation.car import Plant, Sensor
from bcid.simulation.drive import simulate_drive
from bcid.virtual_lab import TUNING, record_drive, simulated_vehicle

FRICTION_N = 30.0
TRUSTED = ReferenceModel(CAR, {}, relative_sd=0.02)


@cache
def drive_of(seconds: float, seed: int, steady: bool = False, **plant: float) -> tuple[Recording, Estimate]:
    """A simulated drive, at one speed and in one circle if `steady`, with its estimated motion."""
    vehicle = simulated_vehicle()
    given = np.tile([0.4, 1.2], (round(20 * seconds), 1)) if steady else None
    drive = simulate_drive(Plant(**plant), Sensor(), seconds, seed, given_commands=given)
    recording = record_drive(drive, 60.0, vehicle)
    return recording, estimate_motion(recording, vehicle, TUNING)


def trusted_fit(recording: Recording, estimate: Estimate, reference: ReferenceModel = TRUSTED) -> BaseFit:
    """The car without effects, as the simulation has it to 2 %, refitted to a drive."""
    return fit_base_model([recording], [estimate], simulated_vehicle(), reference)


def test_what_a_drive_shows_is_worth_more_than_chance_and_of_its_size() -> None:
    without, take = concealing(120.0, steering_drag=60.0)
    true = fit_true_structure(without, without.hypothesis, take, ["steering_drag"], {"steering_drag__k": 60.0})
    assert true.nats > 10.0 * LIKELIHOOD_LIMITS.usual_gate_nats
    value, se = true.fit.effect_estimates()["steering_drag__k"]
    assert abs(value - 60.0) < 4.0 * se


def test_what_is_not_there_is_worth_less_than_chance_though_it_is_published() -> None:
    """So the question is a control: the price of its parameter, and what the refit gains by noise."""
    without, take = concealing(120.0)
    true = fit_true_structure(without, without.hypothesis, take, ["yaw_scrub"], {"yaw_scrub__c": 14.0})
    assert -4.0 < true.nats < LIKELIHOOD_LIMITS.usual_gate_nats


def test_a_base_fit_that_went_astray_makes_nothing_worth_more() -> None:
    """Without what is withheld the drive is refitted from the true structure's car as well."""
    without, take = concealing(120.0, steering_drag=60.0)
    astray = replace(without, log_likelihood=without.log_likelihood - 500.0)
    true = fit_true_structure(astray, without.hypothesis, take, ["steering_drag"], {"steering_drag__k": 60.0})
    assert true.without.penalised_log_likelihood > astray.penalised_log_likelihood + 400.0


@pytest.mark.parametrize(("made", "shows"), [(60.0, True), (0.02, False)])
def test_an_edit_is_worth_more_than_the_gate_where_a_drive_shows_it(made: float, shows: bool) -> None:
    """The simulated car has the effect by as much as an edit would have added to its drive."""
    without, take = concealing(120.0, steering_drag=made)
    question = EditedQuestion("take.csv", "steering_drag", made)
    diagnosis: Any = SimpleNamespace(naming=SimpleNamespace(base=without), take=take)
    worth = edited._worth(question, {"k": (0.0, 0.1)}, diagnosis)["worth"]
    assert (worth > LIKELIHOOD_LIMITS.usual_gate_nats) is shows


def test_the_simulation_s_own_car_is_a_start_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """The fit without what is withheld is of a car that this has pulled away."""
    known, (base, take) = concealing(60.0)[0], concealing(60.0, steering_drag=60.0)
    without, begun = replace(base, hypothesis=replace(base.hypothesis, nominal=known.car())), list[float]()

    def record(take: Take, hypothesis: Hypothesis, phi: Floats, start: Floats, scales: Scales) -> Fit:
        begun.append(hypothesis.car(phi).C_r)
        return refit(take, hypothesis, phi, start, scales)

    monkeypatch.setattr(oracle, "refit", record)
    fit_true_structure(without, without.hypothesis, take, ["steering_drag"], {"steering_drag__k": 60.0})
    assert begun[2] == pytest.approx(known.car().C_r)
    assert begun[2] != pytest.approx(without.car().C_r)


@pytest.mark.parametrize(("steady", "alike"), [(True, True), (False, False)])
def test_a_friction_is_a_viscous_one_at_one_speed_and_only_there(steady: bool, alike: bool) -> None:
    recording, estimate = drive_of(60.0 if steady else 120.0, 8, steady, rear_rolling_coulomb=FRICTION_N)
    base = trusted_fit(recording, estimate)
    effects, sizes = ["rear_rolling_coulomb"], {"rear_rolling_coulomb__c": FRICTION_N}
    true = fit_true_structure(base.fit, base.fit.hypothesis, base.take, effects, sizes)
    assert true.nats > LIKELIHOOD_LIMITS.usual_gate_nats
    answered = {"rear_rolling_viscous": {"rear_rolling_viscous__b": FRICTION_N}, "steering_offset": {}}
    found = find_equivalents(true, base.take, effects, answered, LIKELIHOOD_LIMITS.usual_gate_nats)
    assert ("rear_rolling_viscous" in found) is alike
    assert "steering_offset" not in found
    assert not set(found) & set(effects)


def test_what_is_there_besides_is_not_what_is_withheld_though_it_makes_a_drive_likelier() -> None:
    without, take = concealing(120.0, steering_drag=60.0, steering_offset=0.02)
    true = fit_true_structure(without, without.hypothesis, take, ["steering_drag"], {"steering_drag__k": 60.0})
    answered = {"steering_offset": {"steering_offset__o": 0.02}}
    more = without.hypothesis.with_effects("steering_offset")
    besides = refit(take, more, more.phi_of(without.car(), [0.02]), without.start, without.scales)
    assert besides.penalised_log_likelihood > true.fit.penalised_log_likelihood
    found = find_equivalents(true, take, ["steering_drag"], answered, LIKELIHOOD_LIMITS.usual_gate_nats)
    assert "steering_offset" not in found


@pytest.fixture
def day(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> QuestionInputs:
    """Questions to two drives of a car whose motor pulls a fifth less than published, and whose wheel drags."""
    drives = {f"{seed}.csv": drive_of(60.0, seed, motor_gain=0.8 * CAR.K_t, steering_drag=60.0) for seed in (21, 22)}
    inputs = QuestionInputs(simulated_vehicle(), {}, tmp_path / "simulation.toml", tmp_path)
    published = ReferenceModel(CAR, {}, relative_sd=0.2)
    monkeypatch.setattr(QuestionInputs, "estimate_recording", lambda _, name, *__: (*drives[name], TUNING))
    monkeypatch.setattr(QuestionInputs, "published_model", lambda *_: published)
    return inputs


def test_a_day_s_simulation_has_the_figures_and_the_effects_that_the_day_s_other_drives_show(
    day: QuestionInputs,
) -> None:
    drag = {"effect": "steering_drag", "twins": [], "values": {"k": [50.0, 2.0]}}
    row = calibrate_simulation("21.csv", ["22.csv"], day, {"findings": [drag]})
    found = reference_from_row(row["simulation"])
    assert found is not None
    assert found.car.K_t == pytest.approx(0.8 * CAR.K_t, rel=0.05)
    assert found.effects["steering_drag__k"] == pytest.approx(60.0, rel=0.1)
    assert (found.relative_sd, row["fellows"], row["added"]) == (0.2, ["22.csv"], ["steering_drag"])


def test_a_drive_without_fellows_is_compared_with_what_is_published(day: QuestionInputs) -> None:
    row = calibrate_simulation("21.csv", [], day)
    assert row == {"simulation": reference_as_row(ReferenceModel(CAR, {}, 0.2)), "fellows": [], "added": []}


def test_an_effect_that_half_of_a_day_s_drives_show_is_the_day_s() -> None:
    def shows(*findings: tuple[str, ...]) -> dict[str, list[dict[str, object]]]:
        symbols = {"steering_drag": "k", "rear_rolling_coulomb": "c", "rear_rolling_viscous": "b", "motor_sag": "s"}
        return {
            "findings": [
                {"effect": e, "twins": twins, "values": {symbols[e]: [float(len(e)), 1.0]}} for e, *twins in findings
            ]
        }

    drag, dry, viscous = ("steering_drag",), ("rear_rolling_coulomb",), ("rear_rolling_viscous",)
    assert shared_effects([shows(drag), shows()]) == {"steering_drag": [13.0]}
    assert shared_effects([shows(drag), shows(), shows()]) == {}
    assert shared_effects([]) == {}
    # what cannot be told apart on one drive is what the other one names, and is there once
    assert shared_effects([shows((*dry, *viscous)), shows(viscous)]) == {"rear_rolling_viscous": [20.0]}
    # a motor that sags in the course of a drive
    assert shared_effects([shows(("motor_sag",)), shows(("motor_sag",))]) == {}


def test_a_reference_model_is_kept_whole_in_a_row() -> None:
    body = np.arange(2.0 * COLUMNS).reshape(2, COLUMNS)
    steady = np.zeros((1, COLUMNS))
    seen = np.ones((1, TRACKING_COLUMNS))
    waves, constant, none = (UnnamedFunctions(b, seen, plan_angles(b)) for b in (body, steady, steady[:0]))
    for known in (NO_UNNAMED, waves, constant, none, UnnamedFunctions(tracking=seen)):
        model = ReferenceModel(CAR, {"motor_lag__tau": 0.1}, 0.02, {"K_t": 0.3}, known=known)
        again = reference_from_row(json.loads(json.dumps(reference_as_row(model))))
        assert again is not None
        assert again._replace(known=known) == model
        np.testing.assert_array_equal(again.known.on_body, known.on_body)
        np.testing.assert_array_equal(again.known.tracking, known.tracking)
        assert (again.known.plan is None) == (known.plan is None)
        for was, read in zip(known.plan or (), again.known.plan or (), strict=True):
            np.testing.assert_array_equal(read, was)
            assert (read.dtype, read.shape) == (was.dtype, was.shape)
        assert waves.join(again.known).size == waves.size + known.size
    assert reference_from_row(reference_as_row(None)) is None


def test_a_simulation_s_misfit_is_told_beside_a_freely_fitted_model() -> None:
    recording, estimate = drive_of(60.0, 21, motor_gain=0.8 * CAR.K_t, steering_drag=60.0)
    vehicle, wrong = simulated_vehicle(), ReferenceModel(CAR._replace(K_t=0.5 * CAR.K_t), {}, relative_sd=0.02)
    right = ReferenceModel(CAR._replace(K_t=0.8 * CAR.K_t), {"steering_drag__k": 60.0}, relative_sd=0.02)
    told = [
        whole_misfit(m, base.fit, vehicle, recording, estimate)
        for m, base in ((m, trusted_fit(recording, estimate, m)) for m in (right, wrong))
    ]
    assert told[0]["nats"] > 0.0  # it has the drag, which no free base model has
    assert told[1]["nats"] < 0.0  # it may not leave its motor
    assert told[0]["rmse"]["v_x"] < told[1]["rmse"]["v_x"]
    ratios = error_ratios(told[1]["rmse"], told[0]["rmse"])
    assert ratios["v_x"] == pytest.approx(told[1]["rmse"]["v_x"] / told[0]["rmse"]["v_x"], abs=2e-3)
    assert error_ratios({"v_x": None, "yaw_rate": 0.2}, {"v_x": 0.1, "yaw_rate": 0.1}) == {"v_x": None, "yaw_rate": 2.0}
    spun = prediction_rmse(ReferenceModel(CAR._replace(C_r=1.0, I_z=1e-4), {}), vehicle, recording, estimate)
    assert None in spun.values() or spun["yaw_rate"] > told[1]["rmse"]["yaw_rate"]


@pytest.mark.parametrize("fit", [fit_perceptron, fit_boosted_trees])
def test_a_regression_of_what_a_car_lacks_predicts_another_drive_better_than_the_car(fit: object) -> None:
    """A published car without the friction that is there; what it is given are the drive's own commands alone."""
    trained, other = (drive_of(120.0, seed, rear_rolling_coulomb=3.0 * FRICTION_N)[1] for seed in (8, 9))
    base = model_from_reference(TRUSTED, simulated_vehicle(), 120.0, trained.period_s)
    residual = fit_residual_model(base, trained, fit, "residual")  # type: ignore[arg-type]
    errors = [float(np.median(position_errors(m, other, 2.0))) for m in (base, residual)]  # type: ignore[arg-type]
    assert errors[1] < 0.6 * errors[0]


def test_a_residual_model_of_nothing_is_its_car_and_rolls_out_one_as_many() -> None:
    _, estimate = drive_of(60.0, 21, motor_gain=0.8 * CAR.K_t, steering_drag=60.0)
    base = model_from_reference(TRUSTED, simulated_vehicle(), 60.0, estimate.period_s)

    def nothing(inputs: Floats, targets: Floats) -> object:
        return lambda unseen: np.zeros((len(unseen), 3))

    idle = fit_residual_model(base, estimate, nothing, "idle")  # type: ignore[arg-type]
    still = replace(idle, accelerations=idle.accelerations._replace(mean=np.zeros(3)))
    from bcid.models.interface import history_at, rollout

    past, commands = history_at(estimate, 40, base.lags), estimate.parts[40:60]
    np.testing.assert_allclose(rollout(still, past, commands), rollout(base, past, commands), atol=1e-12)
    # with a constant push of the mean
    many = idle.scan_many(np.stack(2 * [idle.init(past)]), np.stack(2 * [commands]))[1]
    np.testing.assert_allclose(many[1], rollout(idle, past, commands)[1:], atol=1e-12)
    assert np.abs(many[1] - rollout(base, past, commands)[1:]).max() > 1e-4


def test_sizes_of_two_drives_are_compared_within_their_errors() -> None:
    first = [
        {"effect": "motor_lag", "values": {"tau": (0.10, 0.01)}}, {"effect": "rear_toe", "values": {"epsilon": (1, 1)}}
    ]  # fmt: skip
    (same,) = compare_sizes(first, [{"effect": "motor_lag", "values": {"tau": (0.128, 0.01)}}])
    assert (same["symbol"], same["same"]) == ("tau", True)  # 1.98 standard errors
    (other,) = compare_sizes(first, [{"effect": "motor_lag", "values": {"tau": (0.129, 0.01)}}])
    assert not other["same"]


def test_three_quarters_of_a_drive_begin_with_the_command_that_holds() -> None:
    recording, _ = drive_of(60.0, 21, motor_gain=0.8 * CAR.K_t, steering_drag=60.0)
    first, last = (cut_recording(replace(recording, breaks_s=(10.0, 50.0)), *part.part) for part in PARTS)
    assert (first.duration_s, last.duration_s) == pytest.approx((45.0, 45.0), abs=0.05)
    assert (first.breaks_s, last.breaks_s) == ((10.0,), (50.0,))
    t_0 = float(last.poses.time_s[0])
    assert last.commands.time_s[0] <= t_0 < last.commands.time_s[1]
    later = np.linspace(t_0, t_0 + 40.0, 300)
    np.testing.assert_array_equal(last.commands.held_at(later), recording.commands.held_at(later))
    assert cut_recording(recording, 0.0, 1.0) is recording


def test_a_cut_drive_is_the_same_drive(day: QuestionInputs) -> None:
    """Segments of it are predicted as those of the whole, so that the base model is the same within its errors."""
    recording, _ = drive_of(60.0, 21, motor_gain=0.8 * CAR.K_t, steering_drag=60.0)
    part = cut_recording(recording, *PARTS[1].part)
    free = fit_base_model([part], [estimate_motion(part, simulated_vehicle(), TUNING)], simulated_vehicle()).fit
    assert free.car().K_t == pytest.approx(0.8 * CAR.K_t, rel=0.1)


def test_another_start_is_the_same_simulation_from_another_car() -> None:
    recording, estimate = drive_of(60.0, 21, motor_gain=0.8 * CAR.K_t, steering_drag=60.0)
    vehicle = simulated_vehicle()
    known = ReferenceModel(CAR, {"motor_lag__tau": 0.1}, 0.02)
    tyres, motor = (move_start(known, start, [estimate], vehicle) for start in STARTS)
    assert tyres is not None
    assert motor is not None
    assert tyres._replace(begin={}) == motor._replace(begin={}) == known._replace(begin={})
    assert (tyres.begin["C_f"], tyres.begin["R_1"], motor.begin["K_t"]) == (1.5, 1.5, 1.0 / 1.3)
    assert move_start(None, PARTS[0], [estimate], vehicle) is None
    free = move_start(None, STARTS[1], [estimate], vehicle)
    assert free is not None
    assert (free.relative_sd, free.begin) == (None, motor.begin)
    # the fit ends where it does from the simulation itself, by the same prior
    fits = [fit_base_model([recording], [estimate], vehicle, r).fit for r in (known, tyres, motor)]
    first = fits[0].hypothesis.trusted_simulation
    for fit, begin in zip(fits[1:], (tyres.begin, motor.begin), strict=True):
        assert fit.hypothesis.trusted_simulation == first
        assert fit.hypothesis.nominal.C_f == pytest.approx(begin.get("C_f", 1.0) * CAR.C_f)
        assert fit.penalised_log_likelihood == pytest.approx(fits[0].penalised_log_likelihood, abs=2.0)


def test_an_answer_is_its_names_or_its_verdict() -> None:
    named = {"verdict": "ambiguous", "findings": [{"effect": "motor_lag"}]}
    assert given_names(named) == ("named", {"motor_lag"})
    assert given_names({"verdict": "unknown", "findings": []}) == ("unknown", frozenset())


def test_a_drive_is_diagnosed_against_what_is_published_or_freely(
    day: QuestionInputs, monkeypatch: pytest.MonkeyPatch
) -> None:
    given = list[ReferenceModel | None]()

    def diagnosed(recordings: object, estimates: object, vehicle: object, reference: ReferenceModel | None) -> object:
        given.append(reference)
        raise ArithmeticError

    monkeypatch.setattr(day_model, "diagnose_recordings", diagnosed)
    for freely in (True, False):
        with pytest.raises(ArithmeticError):
            day_model.diagnose_drive("21.csv", freely, day)
    assert given == [None, ReferenceModel(CAR, {}, 0.2)]
