"""By what exports are checked: every constant acts in it, at the bounds of the effects, from rest, and at the start."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from exported_models import (
    CAR,
    MODELS,
    PERIOD_S,
    SEVERAL,
    all_effects_but,
    augmented_car,
    evaluate,
    evaluator,
    make_export,
    typical,
    written,
)

from bcid.effects.table import ENTRIES
from bcid.errors import InputRefused
from bcid.export import reference_steps
from bcid.export.augmented_formulas import COMPLIANCE_STEPS, trace_augmented
from bcid.export.check import check_c, find_compiler
from bcid.export.check_programs import write_c_test, write_python_test
from bcid.export.exported import Exported, export_model
from bcid.export.formulas import START, StepFormulas
from bcid.export.model_formulas import TRACED
from bcid.export.reference_drive import EXACT_STEP, drive_for_reference, history_of_start
from bcid.export.reference_steps import ReferenceSteps, carry_of, single_steps, state_of
from bcid.models.interface import history_at_rest
from bcid.models.newton_euler.augmented import max_command_delay
from bcid.models.newton_euler.model import NewtonEuler

every_model = pytest.mark.parametrize("name", list(MODELS))
needs_compiler = pytest.mark.skipif(find_compiler() is None, reason="no C compiler")

LAWS: dict[str, dict[str, float]] = {
    "speed": {}, "reverse": {"reverses": 1.0, "front_share": 0.5},
    "force": {"sets_force": 1.0, "u_0": 0.1, "K_v": 50.0, "front_share": 0.0},
    "measured speed": {"follows_wheel": 1.0, "K_t": 2000.0},
}  # fmt: skip
IDLE = {
    "speed": {"u_0", "K_v"}, "reverse": {"K_b", "u_0", "K_v"}, "force": set[str](),
    "measured speed": {"K_b", "u_0", "K_v"},
}  # fmt: skip
"""Constants that a motor's law does not have: a car that reverses has no brake in its throttle."""
FLAGS = {"front_share", "sets_force", "reverses", "follows_wheel"}


def single_errors(formulas: StepFormulas, s: ReferenceSteps) -> np.ndarray:
    """The largest error of formulas without networks in each single period, relative for numbers beyond 1."""
    names, step = [q.name for q in formulas.states], evaluator(formulas.results)
    rows = [
        step(dict(zip([*names, "u_s", "u_m"], [*state, *command], strict=True)))
        for state, command in zip(s.states, s.commands, strict=True)
    ]
    wanted = np.hstack([s.next_states, s.twists])
    return np.asarray((np.abs(np.array(rows, float) - wanted) / np.maximum(1.0, np.abs(wanted))).max(axis=1))


def first_state(formulas: StepFormulas, pose: Any, twist: Any, delta: float) -> list[float]:
    given = dict(zip([q.name for q in START], [*pose, *twist, delta], strict=True))
    return evaluate(formulas.first_states, given)


@pytest.mark.parametrize("law", LAWS)
def test_a_constant_that_is_off_by_a_millionth_is_seen(law: str) -> None:
    car = CAR._replace(**LAWS[law])
    model = NewtonEuler(car, PERIOD_S, {})
    right = TRACED["newton-euler"](model)
    s = drive_for_reference(model, right, None).steps
    assert single_errors(right, s).max() < EXACT_STEP
    for symbol in set(car._fields) - FLAGS - IDLE[law]:
        value = getattr(car, symbol)
        other = NewtonEuler(car._replace(**{symbol: value * (1.0 + 1e-6)}), PERIOD_S, {})
        assert single_errors(TRACED["newton-euler"](other), s).max() > EXACT_STEP, symbol


@pytest.mark.parametrize("effect", [e for e in ENTRIES if e != "clock_drift"])
def test_an_effect_that_is_off_by_a_thousandth_is_seen(effect: str) -> None:
    """One that acts at a place or a time does so in few periods, and its place moves it least."""
    values = typical(ENTRIES[effect])
    model = augmented_car(values)
    right = trace_augmented(model)
    s = drive_for_reference(model, right, None).steps
    assert single_errors(right, s).max() < EXACT_STEP
    off = augmented_car({field: x * 1.001 for field, x in values.items()})
    formulas = trace_augmented(off)
    assert [q.name for q in formulas.states] == [q.name for q in right.states]
    assert single_errors(formulas, s).max() > EXACT_STEP


@needs_compiler
@pytest.mark.parametrize("symbol", ["K_b", "d", "F_m_max", "F_f_max", "F_r_max", "R_2", "v_0"])
def test_programs_refuse_a_constant_that_a_gentle_drive_does_not_know(symbol: str, tmp_path: Path) -> None:
    e = make_export("newton-euler")
    other = NewtonEuler(CAR._replace(**{symbol: getattr(CAR, symbol) * (1.0 + 1e-6)}), PERIOD_S, {})
    wrong = replace(e, formulas=TRACED["newton-euler"](other))
    for format in ("c", "python"):  # noqa: A001
        with pytest.raises(InputRefused, match="single periods: off by"):
            written(wrong, [format], tmp_path / format)


@needs_compiler
@every_model
def test_programs_refuse_first_states_and_poses_that_are_off(name: str, tmp_path: Path) -> None:
    e = make_export(name)
    last = e.vectors.starts[1]
    moved = last._replace(state=last.state + 1e-9)
    for wrong, said in (
        (e.vectors._replace(starts=(e.vectors.starts[0], moved)), "first states: off by"),
        (e.vectors._replace(end_pose=e.vectors.end_pose + 1e-7), "pose after the drive: off by"),
    ):
        for format in ("c", "python"):  # noqa: A001
            with pytest.raises(InputRefused, match=said):
                written(replace(e, vectors=wrong), [format], tmp_path / format)


@needs_compiler
def test_a_number_that_is_none_is_an_error_wherever_it_comes(tmp_path: Path) -> None:
    """A comparison with it is never true: an error after it must not take its place."""
    made = make_export("newton-euler")
    e = replace(made, vectors=made.vectors._replace(twists=made.vectors.twists.copy()))
    e.vectors.twists[3, 0] = np.nan
    text = write_c_test(e.name, e.vectors).replace("nan", "NAN")
    for file, content in {**files_of(e, "c"), f"{e.name}_test.c": text}.items():
        (tmp_path / file).write_text(content, encoding="utf-8")
    with pytest.raises(InputRefused, match="twists of the drive: off by inf"):
        check_c(tmp_path, e.name)
    assert 'float("inf") for error in errors' in write_python_test(e.name, e.vectors)


def files_of(e: Exported, format: str) -> dict[str, str]:  # noqa: A002
    from bcid.export.formats import FORMATS

    return {name: str(content) for name, content in FORMATS[format].write(e).items()}


BENT = {"tyre_fall__f": 0.8, "friction_circle__kappa": 1.0, "tyre_soft_saturation__s": 0.3}


@pytest.mark.parametrize("effects", [{}, BENT], ids=["alone", "with bent tyre forces"])
@pytest.mark.parametrize("k", [3e-4, 5e-4])
def test_a_compliance_at_its_bounds_is_solved(
    effects: dict[str, float], k: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert k <= ENTRIES["steering_compliance"].parameters[0].high
    assert COMPLIANCE_STEPS < 40  # of the model, which stops where nothing moves
    monkeypatch.setattr(reference_steps, "UNKNOWN_REACH", reference_steps.UNKNOWN_REACH | {"u_s": 1.2, "u_m": 5.0})
    model = augmented_car({"steering_compliance__k": k, **effects})
    formulas = trace_augmented(model)
    s = single_steps(model, formulas, None, None, np.random.default_rng(5))
    assert single_errors(formulas, s).max() < EXACT_STEP


@every_model
def test_a_vehicle_that_starts_at_rest_is_as_the_model_at_rest(name: str) -> None:
    model = MODELS[name]
    start = history_of_start(model, np.zeros(3), np.zeros(3), 0.0)
    at_rest = history_at_rest(model.lags)
    np.testing.assert_array_equal(start.kinematic, at_rest.kinematic)
    np.testing.assert_array_equal(start.command, at_rest.command)
    e = make_export(name)
    state = state_of(model, [q.name for q in e.formulas.states], model.init(at_rest))
    np.testing.assert_array_equal(first_state(e.formulas, np.zeros(3), np.zeros(3), 0.0), state)
    carry, _ = model.step(model.init(start), np.array([0.1, 0.5]))
    at_rest_too, _ = model.step(model.init(at_rest), np.array([0.1, 0.5]))
    motion = [q.name for q in e.formulas.states]
    np.testing.assert_array_equal(state_of(model, motion, carry), state_of(model, motion, at_rest_too))


@every_model
def test_first_states_are_those_of_the_model(name: str) -> None:
    e = make_export(name)
    assert len(e.vectors.starts) == 3
    for start in e.vectors.starts:
        made = first_state(e.formulas, start.pose, start.twist, start.delta)
        np.testing.assert_allclose(made, start.state, rtol=1e-12, atol=1e-12)


def test_a_wheel_that_is_turned_was_held_there() -> None:
    e = make_export("narx-mlp")
    x = dict(zip([q.name for q in e.formulas.states], e.vectors.starts[1].state, strict=True))
    assert (x["u_s_ago_1"], x["u_m_ago_1"], x["u_s_ago_2"], x["u_m_ago_2"]) == (0.15, 0.0, 0.15, 0.0)
    assert (x["v_x_ago_2"], x["yaw_rate"]) == (0.8, -0.2)


def test_slip_angles_of_slow_wheels_start_at_zero_and_others_where_they_are() -> None:
    formulas = TRACED["k-sindy"](MODELS["k-sindy"])
    v_f, alpha_f, alpha_r, delta = first_state(formulas, np.zeros(3), [0.03, 0.02, 0.1], 0.3)
    assert (alpha_f, alpha_r, delta) == (0.0, 0.0, 0.3)
    assert v_f == pytest.approx(np.hypot(0.03, 0.02 + 0.6 * 0.1))
    v_f, alpha_f, alpha_r, delta = first_state(formulas, np.zeros(3), [0.0, 0.0, 2.0], 0.0)
    assert (v_f, alpha_f, alpha_r) == pytest.approx((1.2, np.pi / 2, 0.0))
    assert first_state(formulas, np.zeros(3), [0.8, 0.1, -0.2], 0.15)[2] == pytest.approx(np.arctan(0.2 / 0.8))


@pytest.mark.parametrize("effects", [SEVERAL, all_effects_but("clock_drift")], ids=["several", "all"])
def test_an_exported_state_is_a_carry_of_the_model_and_back(effects: dict[str, float]) -> None:
    model = augmented_car(effects)
    names = [q.name for q in trace_augmented(model).states]
    state = np.random.default_rng(8).normal(size=len(names))
    np.testing.assert_array_equal(state_of(model, names, carry_of(model, names, state, None)), state)


def test_single_periods_are_drawn_where_a_drive_does_not_come() -> None:
    e = make_export("newton-euler")
    s = e.vectors.steps
    assert 90 <= len(s.states) <= 110
    places = {q.name: i for i, q in enumerate(e.formulas.states)}
    v_x, delta = s.states[:, places["v_x"]], s.states[:, places["delta"]]
    assert (v_x < -0.5).sum() > 5  # reverse
    assert (s.commands[:, 1] < -0.5).sum() > 5  # brake
    assert (np.abs(s.states) == 0.0).all(axis=1).sum() >= 5  # rest
    slip = np.abs(s.states[:, places["v_y"]]) / np.maximum(np.abs(v_x), 0.5)
    assert (slip > CAR.F_f_max / CAR.C_f).sum() > 5  # skidding
    assert (np.abs(s.commands[:, 0] - delta) / CAR.T_s > CAR.d).sum() > 5  # at the servo's rate


@pytest.mark.parametrize("tau", [0.035, -0.03])
def test_a_throttle_that_is_logged_at_another_time_may_be_so_by_more_than_a_period(tau: float) -> None:
    model = augmented_car({"throttle_timing__tau": tau, "motor_delay__tau": 0.01}, CAR._replace(follows_wheel=1.0))
    assert max_command_delay(model.setup.switches, 600.0) == pytest.approx(0.01 + max(tau, 0.0))
    formulas = trace_augmented(model)
    assert ("u_m_ago_3" in [q.name for q in formulas.states]) == (tau > 0.03)
    s = drive_for_reference(model, formulas, None).steps
    assert single_errors(formulas, s).max() < EXACT_STEP


def test_effects_of_time_stand_in_single_periods_too() -> None:
    model = augmented_car(
        {"motor_sag__s": 0.4, "motor_lag__tau": 0.1, "clock_drift__rho": 5e-4, "steering_delay__tau": 0.03}
    )
    e = export_model(model, "0" * 64, None, time_s=300.0)
    assert single_errors(e.formulas, e.vectors.steps).max() < EXACT_STEP
    for start in e.vectors.starts:
        made = first_state(e.formulas, start.pose, start.twist, start.delta)
        np.testing.assert_allclose(made, start.state, rtol=1e-12, atol=1e-12)
