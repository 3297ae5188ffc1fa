"""Questions to recordings with a known omission: edits, files of parameters, trust in a simulation, and the answers."""

from __future__ import annotations

import json
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from cars import CAR

from bcid.cli.app import main
from bcid.diagnosis.judge.held_out import block_length_s
from bcid.diagnosis.limits import JUDGE_LIMITS
from bcid.diagnosis.reference import reference_from_parameters
from bcid.diagnosis.reference_model import ReferenceModel
from bcid.effects.constants import Constants
from bcid.effects.corrections import RAW_COMMANDS
from bcid.effects.measurement import tracked_pose
from bcid.effects.table import ENTRIES, effect_switches
from bcid.errors import InputRefused, PredictionDiverged
from bcid.estimate.types import Estimate
from bcid.likelihood.hypothesis import Hypothesis
from bcid.likelihood.limits import LIKELIHOOD_LIMITS
from bcid.proof.real import edited, run_questions, scoring, withheld
from bcid.proof.real.edits import EDITS
from bcid.proof.real.limits import LIMITS
from bcid.proof.real.question_files import QuestionInputs
from bcid.proof.real.questions import ANY_VEHICLE_EFFECT as VEHICLE_PHYSICS
from bcid.proof.real.questions import NOT_ASKED, EditedQuestion, WithheldQuestion, read_questions
from bcid.proof.real.run_questions import run_real_questions
from bcid.proof.real.scoring import real_outcome, score_answer
from bcid.proof.rows import read_rows
from bcid.recording.types import Recording, SourceFile, Stream
from bcid.simulation.car import Plant, Sensor
from bcid.simulation.samples import VEHICLE, write_sample_take
from bcid.simulation.samples import SampleTake as Order
from bcid.vehicle import Vehicle, read_vehicle

OF_THE_CAR = {s: getattr(CAR, s) for s in (
    "F_m_max", "K_t", "K_b", "I_z", "C_f", "C_r", "F_f_max", "F_r_max", "R_1", "R_2",
)}  # fmt: skip


def parameters(**more: str) -> str:
    lines = [*(f"{k} = {v}" for k, v in OF_THE_CAR.items())]
    tables = [f"[effects.{k}]\n{v}" for k, v in more.items()]
    return "\n".join(["relative_sd = 0.02", "[parameters]", *lines, *tables])


@pytest.fixture
def drive() -> Recording:
    rng = np.random.default_rng(3)
    t, at = np.arange(0.0, 20.0, 1.0 / 60.0), np.arange(0.0, 20.0, 0.1)
    commands = np.column_stack([np.repeat(rng.normal(0.0, 0.5, 40), 5), np.repeat(rng.uniform(0.0, 2.0, 20), 10)])
    source = (SourceFile("drive", "", "mcap"),)
    return Recording("drive", source, Stream(t, rng.normal(0.0, 1.0, (len(t), 3))), Stream(at, commands), 60.0, 0.3)


@pytest.mark.parametrize("effect", ["pose_latency", "marker_offset", "body_yaw_misalignment", "steering_offset"])
def test_an_edit_is_undone_by_its_opposite(effect: str, drive: Recording) -> None:
    there = EDITS[effect](drive, 0.05)
    streams = [np.concatenate([s.time_s, s.values.ravel()]) for of in (there, drive) for s in (of.poses, of.commands)]
    assert not np.allclose(np.concatenate(streams[:2]), np.concatenate(streams[2:]))
    back = EDITS[effect](there, -0.05)
    for one, other in ((back.poses, drive.poses), (back.commands, drive.commands)):
        np.testing.assert_allclose(one.time_s, other.time_s, atol=1e-12)
        np.testing.assert_allclose(one.values, other.values, atol=1e-12)


def test_edits_of_the_pose_have_the_vocabulary_s_signs(drive: Recording) -> None:
    """A tracked point ahead of the CoG, a body turned to the left, poses stamped late."""
    x, y, yaw = drive.poses.values[7]
    there = tracked_pose(x, y, yaw, effect_switches({"marker_offset__d_x": 0.05}))
    np.testing.assert_allclose(EDITS["marker_offset"](drive, 0.05).poses.values[7], there[:3])
    turned = tracked_pose(x, y, yaw, effect_switches({"body_yaw_misalignment__psi": 0.05}))
    np.testing.assert_allclose(EDITS["body_yaw_misalignment"](drive, 0.05).poses.values[7], turned[:3])
    np.testing.assert_allclose(EDITS["pose_latency"](drive, 0.05).poses.time_s, drive.poses.time_s + 0.05)
    fast = EDITS["clock_drift"](replace(drive, breaks_s=(10.0,)), 0.002)
    np.testing.assert_allclose(fast.poses.time_s, 1.002 * drive.poses.time_s)
    assert fast.breaks_s == pytest.approx([10.02])


def test_edits_of_size_and_side_are_what_the_vocabulary_calls_them(drive: Recording) -> None:
    logged = EDITS["steering_side_gain"](drive, 0.1).commands.values[:, 0]
    np.testing.assert_allclose(logged * (1.0 + 0.1 * np.sign(logged)), drive.commands.values[:, 0])
    seen = EDITS["pose_scale"](drive, 0.08).poses.values
    np.testing.assert_allclose(seen, drive.poses.values * [1.08, 1.08, 1.0])


@pytest.mark.parametrize(("effect", "which"), [("steering_delay", 0), ("motor_delay", 1)])
def test_a_delayed_command_acts_as_much_later_and_the_other_does_not(effect: str, which: int, drive: Recording) -> None:
    edited = EDITS[effect](drive, 0.06).commands

    def acting(of: Stream, t: Any) -> Any:
        return of.values[np.searchsorted(of.time_s, t, side="right") - 1]

    t = np.random.default_rng(0).uniform(0.5, 19.0, 500)
    now, was = acting(edited, t - 0.06)[:, which], acting(drive.commands, t)[:, which]
    np.testing.assert_array_equal(now, was)  # logged 60 ms before the car shows it
    np.testing.assert_array_equal(acting(edited, t)[:, 1 - which], acting(drive.commands, t)[:, 1 - which])


def test_two_delays_that_cannot_be_told_from_a_late_pose_are_accepted_together() -> None:
    """And either of them alone is the vehicle's, where nothing of it may be named."""
    named = {"pose_latency", "steering_delay+motor_delay"}
    assert scoring._is_any_accepted(named, ["pose_latency"])
    assert scoring._is_any_accepted(named, ["motor_delay", "steering_delay"])
    assert not scoring._is_any_accepted(named, ["steering_delay"])
    parts = {"pose_latency", "steering_delay", "motor_delay"}
    assert scoring._split_joint_names(named) == parts
    assert scoring._add_vehicle_kind(parts) == {*parts, VEHICLE_PHYSICS}
    assert scoring._add_vehicle_kind({"pose_latency", "unknown in fy"}) == {"pose_latency", "unknown in fy"}
    assert scoring._unknown_label({"verdict": "unknown", "remainder": {"channel": "fy"}}) == {"unknown in fy"}


@pytest.mark.parametrize(("spun", "error"), [(0, 0.5), (3, np.inf)])
def test_a_simulation_that_leaves_the_finite_numbers_is_endlessly_wrong(
    spun: int, error: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    twist = np.tile([1.0, 0.0, 0.2], (50, 1))
    predicted = twist + np.array([0.5, 0.0, 0.5])
    predicted[20 : 20 + spun] = np.nan
    estimate: Any = SimpleNamespace(twist=twist, time_s=np.arange(50) * 0.1, period_s=0.1)
    monkeypatch.setattr(withheld, "model_from_reference", lambda *_: None)
    monkeypatch.setattr(withheld, "predict_with_restarts", lambda *_: SimpleNamespace(twist=predicted))
    simulation: Any = SimpleNamespace()
    errors = withheld.prediction_rmse(simulation, None, None, estimate)  # type: ignore[arg-type]
    np.testing.assert_allclose(errors, [error, error])


def test_what_makes_no_difference_does_not_count() -> None:
    rows = [
        {"tier": tier, "recording": "r", "case": "c", "right": right, "verdict": said, "first": first, "beside": more,
         "findings": [{}] * names}
        for tier, right, said, first, more, names in (
            ("withheld", True, "named", True, ["rear_toe"], 2), ("withheld", True, "named", False, [], 1),
            ("withheld", True, "unknown", True, [], 0),
            ("withheld", False, "unknown", False, [], 0), ("withheld", True, NOT_ASKED, False, [], 0),
            ("control", True, "complete", True, [], 0), ("edited", False, "named", False, [], 1),
        )
    ]  # fmt: skip
    told = real_outcome(rows, "c0de")["tiers"]
    assert told == {
        "withheld": {"right": 3, "n": 4, "named": 2, "first": 1, "alone": 1, "names": 3, "accepted": 2},
        "control": {"right": 1, "n": 1}, "edited": {"right": 0, "n": 1},
    }  # fmt: skip


@pytest.mark.parametrize(
    ("findings", "right", "first", "beside"),
    [
        ([("motor_lag", []), ("rear_toe", [])], True, True, ["rear_toe"]),
        ([("rear_toe", []), ("pose_scale", ["motor_lag"])], True, False, ["rear_toe"]),
        ([("pose_latency", ["steering_delay+motor_lag"])], False, False, ["pose_latency"]),
        ([], True, True, []),  # unknown in fx is accepted as well
        ([("rear_toe", ["motor_lag", "yaw_scrub", "pose_scale"])], True, True, []),
        ([("rear_toe", ["motor_lag", "yaw_scrub", "pose_scale", "motor_sag"])], False, False, ["rear_toe"]),  # too long
    ],
)
def test_what_is_withheld_is_right_by_any_name_and_told_apart_from_first(
    findings: list[tuple[str, list[str]]], right: bool, first: bool, beside: list[str]
) -> None:
    case = WithheldQuestion(recording="take.csv", name="lag", accepted=["motor_lag", "unknown in fx"])
    row = score_answer(case, said_of(findings))
    assert (row["right"], row["first"], row["beside"]) == (right, first, beside)


def said_of(findings: list[tuple[str, list[str]]]) -> dict[str, Any]:
    """What a diagnosis says that names these effects, or that fx is unknown."""
    told = [{"effect": effect, "twins": twins} for effect, twins in findings]
    return {"verdict": "named" if told else "unknown", "findings": told, "remainder": {"channel": "fx"}}


@pytest.mark.parametrize(("ratio", "control", "asked"), [(2.0, False, True), (1.2, False, False), (1.0, True, True)])
def test_what_matters_is_asked_and_a_control_is_anyway(
    ratio: float, control: bool, asked: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "vehicle.toml").write_text(VEHICLE, encoding="utf-8")
    vehicle = QuestionInputs(read_vehicle(tmp_path / "vehicle.toml"), {}, None, tmp_path)
    monkeypatch.setattr(QuestionInputs, "estimate_recording", lambda *_: (None, None, None))
    monkeypatch.setattr(withheld, "diagnose_recordings", lambda *_: None)
    monkeypatch.setattr(withheld, "_complete_model_rmse", lambda *_: np.ones(2))
    monkeypatch.setattr(withheld, "prediction_rmse", lambda *_: np.full(2, ratio))
    monkeypatch.setattr(withheld, "diagnosis_row", lambda _: said_of([("motor_lag", [])]))
    lag = {"steering": {"time_constant_s": 0.05}}
    case = WithheldQuestion(recording="take.csv", name="lag", vehicle=lag, accepted=["motor_lag"], control=control)
    row = withheld.answer_withheld_question(case, vehicle)
    assert (row["ratio"], row["verdict"]) == (ratio, "named" if asked else NOT_ASKED)
    assert score_answer(case, row)["right"] is not control  # a control may not be named


def test_blocks_are_short_in_a_short_take_and_never_long() -> None:
    lengths = [block_length_s(SimpleNamespace(T=T)) for T in (60.0, 120.0, 600.0, 3600.0)]  # type: ignore[arg-type]
    assert lengths == [5.0, 10.0, JUDGE_LIMITS.max_block_s, JUDGE_LIMITS.max_block_s]


def test_a_published_motor_may_fade(estimates: list[Estimate]) -> None:
    """A simulation file may have what no vocabulary names: here, of a throttle that sets a force."""
    vehicle = read_vehicle(Path("pipelines/dart/vehicle.toml"))
    given = reference_from_parameters(Path("pipelines/dart/simulation.toml"), estimates, vehicle)
    assert given.effects["motor_fade__k"] == 4.815
    assert given.car.K_t == 25.358
    assert given.relative_sd_of["steering_scale"] == 0.04


def test_the_published_dart_is_known_as_well_as_another_day_leaves_it(estimates: list[Estimate]) -> None:
    """Grip, friction and lags to a third, the motor to a tenth, a moment of inertia to half; what is none is held."""
    vehicle = read_vehicle(Path("pipelines/dart/vehicle.toml"))
    given = reference_from_parameters(Path("pipelines/dart/simulation.toml"), estimates, vehicle)
    names = ["C_f", "C_r", "F_f_max", "F_r_max", "R_1", "R_2", "I_z", "K_t", "K_v", "K_b"]
    names += [field.partition("__")[0] for field in given.effects]
    assert given.relative_sd is not None
    trust = {name: given.relative_sd_of.get(name, given.relative_sd) for name in names}
    assert {name for name, sd in trust.items() if sd == 0.3} == {
        "C_f", "C_r", "F_f_max", "F_r_max", "R_1", "R_2", "motor_lag", "motor_dead_zone", "rear_rolling_coulomb",
        "steering_friction", "steering_drag", "tyre_soft_saturation",
    }  # fmt: skip
    assert {name: sd for name, sd in trust.items() if sd != 0.3} == {
        "I_z": 0.5, "K_t": 0.1, "motor_fade": 0.1, "K_v": 0.02, "K_b": 0.02,
    }  # fmt: skip


def test_a_trusted_simulation_pulls_towards_its_own_parameters() -> None:
    free = Hypothesis((), CAR, 2.012, Constants(), assumed=("motor_lag", *RAW_COMMANDS), raw_commands=True)
    values = [0.06, *(0.0 for name in RAW_COMMANDS for _ in ENTRIES[name].fields)]
    start = free.with_effects().phi_of(CAR._replace(K_t=300.0), values)
    centre, stiffness = free.with_effects().prior(start)
    np.testing.assert_array_equal(centre, start)  # weak, about where the refit starts
    assert set(stiffness) == {0.0, LIKELIHOOD_LIMITS.base_prior_sd**-2}
    trusting = free.trust_simulation(values, 0.02).with_effects("yaw_scrub")
    more = trusting.phi_of(CAR._replace(K_t=300.0), [*values, 13.0])
    centre, stiffness = trusting.prior(more)
    logs, base = len(trusting.log_parameters), trusting.base_size
    np.testing.assert_allclose(np.exp(centre[:logs]), [getattr(CAR, s) for s in trusting.log_parameters])
    np.testing.assert_allclose(stiffness[:logs], 0.02**-2)
    lag = base  # in units of its size, as well known relative to itself
    assert stiffness[lag] == pytest.approx((0.02 * max(centre[lag], 1.0)) ** -2)
    otherwise = (
        free.trust_simulation(values, 0.02, {"K_t": 0.1, "motor_lag": 0.5}).with_effects("yaw_scrub").prior(more)[1]
    )
    changed = np.flatnonzero(otherwise != stiffness)
    np.testing.assert_array_equal(changed, [trusting.log_parameters.index("K_t"), lag])
    assert otherwise[changed] == pytest.approx([0.1**-2, (0.5 * max(centre[lag], 1.0)) ** -2])
    # a gain of raw commands belongs to no simulation
    assert stiffness[lag + 1] == pytest.approx(LIKELIHOOD_LIMITS.base_prior_sd**-2)
    assert stiffness[-1] == 0.0  # nor does what may be missing
    measured = free.trust_simulation(values, 0.02, {"steering_scale": 0.04}).with_effects(
        "yaw_scrub"
    )  # unless it was measured
    unit = free.entries["steering_scale"].parameters[0].size
    assert measured.prior(more)[1][lag + 1] == pytest.approx((0.04 / unit) ** -2)
    assert measured.trusted_simulation is not None
    assert measured.trusted_simulation.free == ()


def test_no_parameter_goes_farther_than_it_is_trusted() -> None:
    """Three standard deviations, of a share of a take as well; what nothing assumes has its own bounds."""
    free = Hypothesis((), CAR, 2.012, Constants(), assumed=("motor_lag",))
    trusting = free.trust_simulation([0.06], 0.02, {"K_t": 0.05}).with_effects("yaw_scrub")
    for of in (trusting, trusting.scale_simulation_prior(0.1)):
        low, high = of.bounds()
        K_t, lag = of.log_parameters.index("K_t"), of.base_size
        np.testing.assert_allclose(np.exp([low[K_t], high[K_t]]) / CAR.K_t, np.exp([-0.15, 0.15]))
        unit = of.entries["motor_lag"].parameters[0].size
        np.testing.assert_allclose(high[lag] * unit, 0.06 + 0.06 * max(0.06, unit))
        np.testing.assert_allclose(low[lag] * unit, 0.06 - 0.06 * max(0.06, unit))
        np.testing.assert_array_equal([low[-1], high[-1]], [b[-1] for b in free.with_effects("yaw_scrub").bounds()])
    assert free.bounds()[1][free.log_parameters.index("K_t")] == np.inf
    raw = Hypothesis((), CAR, 2.012, Constants(), assumed=RAW_COMMANDS, raw_commands=True)
    of_a_gain = [
        raw.trust_simulation([0.0], 0.02, known).with_effects().bounds()[1][-1]
        for known in ({}, {"steering_scale": 0.04})
    ]
    unit = raw.entries["steering_scale"].parameters[0].size
    assert of_a_gain == pytest.approx([raw.entries["steering_scale"].parameters[0].high / unit, 0.12 / unit])


@pytest.mark.parametrize(
    ("text", "place"),
    [
        (parameters().replace("K_t", "K_tt"), "lacks K_t and has unknown K_tt"),
        (parameters(no_such="a = 1.0"), "effects.no_such"),
        (parameters(motor_lag="sigma = 1.0"), "effects.motor_lag"),
        ("relative_sd = -1.0\n[parameters]", "relative_sd"),
        (parameters() + "\n[relative_sd_of]\nK_tt = 0.1", "names K_tt"),
        (parameters() + "\n[relative_sd_of]\nsteering_scale = 0.1", "names steering_scale"),  # commands are angles
        (parameters() + "\n[relative_sd_of]\nK_t = 2.0", "relative_sd_of.K_t"),
        (parameters().partition("\n")[2] + "\n[relative_sd_of]\nK_t = 0.1", "stands without"),
        ("parameters = 3", "parameters"),
        ("[parameters", "not valid TOML"),
    ],
)
def test_a_bad_file_of_parameters_is_refused(text: str, place: str, tmp_path: Path, vehicle: Vehicle) -> None:
    path = tmp_path / "simulation.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputRefused, match=place):
        reference_from_parameters(path, [], vehicle)


@pytest.fixture(scope="module")
def asked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A file of cases about a simulated take with drag of the steered wheel, and all that it names."""
    folder = tmp_path_factory.mktemp("asked")
    write_sample_take(folder, Order("take", "motive", 60.0), Plant(steering_drag=60.0), Sensor(), 5)
    (folder / "vehicle.toml").write_text(VEHICLE, encoding="utf-8")
    (folder / "simulation.toml").write_text(parameters(steering_drag="k = 60.0"), encoding="utf-8")
    (folder / "cases.toml").write_text(
        """vehicle = "vehicle.toml"
simulation = "simulation.toml"
[[withheld]]
recording = "take.csv"
name = "drag of the steered wheel"
effect = "steering_drag"
accepted = ["steering_drag"]
[[withheld]]
recording = "take.csv"
name = "nothing"
accepted = ["motor_lag"]
control = true
[[edited]]
recording = "take.csv"
effect = "steering_offset"
value = 0.02
""",
        encoding="utf-8",
    )
    return folder


@pytest.mark.proof
def test_what_a_simulation_is_denied_is_named_and_an_edit_too(asked: Path, tmp_path: Path) -> None:
    rows = [row for row, _ in run_real_questions(asked / "cases.toml", asked, tmp_path)]
    drag, nothing, offset = rows
    assert all(row["right"] for row in rows)
    assert offset["beside"] == []
    assert drag["ratio"] > 1.3
    assert [f["effect"] for f in drag["findings"]] == ["steering_drag"]
    assert drag["findings"][0]["values"]["k"][0] == pytest.approx(60.0, rel=0.1)
    assert nothing["findings"] == []
    assert nothing["ratio"] == 1.0
    assert [f["effect"] for f in offset["findings"]] == ["steering_offset"]
    assert offset["value"] == pytest.approx(0.02, rel=0.1)
    kept = {p: p.stat().st_mtime_ns for p in tmp_path.iterdir()}
    assert [row for row, _ in run_real_questions(asked / "cases.toml", asked, tmp_path)] == rows
    assert {p: p.stat().st_mtime_ns for p in tmp_path.iterdir()} == kept


def test_a_recording_s_own_calibration_lies_under_what_is_withheld(tmp_path: Path) -> None:
    (tmp_path / "vehicle.toml").write_text(VEHICLE, encoding="utf-8")
    usual = read_vehicle(tmp_path / "vehicle.toml")
    own = {"take.csv": {"body": {"mass_kg": 20.0}, "steering": {"time_constant_s": 0.3}}}
    asked = QuestionInputs(usual, own, None, tmp_path)
    assert asked.vehicle_for("another.csv") == usual
    assert asked.vehicle_for("take.csv").body.mass_kg == 20.0
    less = asked.vehicle_for("take.csv", {"steering": {"time_constant_s": 0.05}})
    assert (less.body.mass_kg, less.steering.time_constant_s) == (20.0, 0.05)
    assert less.body.cog_to_front_m == usual.body.cog_to_front_m


def test_the_whole_and_what_is_withheld_of_it_are_that_day_s_car(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "vehicle.toml").write_text(VEHICLE, encoding="utf-8")
    own = {"take.csv": {"body": {"mass_kg": 20.0}, "steering": {"time_constant_s": 0.3}}}
    asked, seen = QuestionInputs(read_vehicle(tmp_path / "vehicle.toml"), own, None, tmp_path), list[Vehicle]()

    def moved(_: Any, name: str, vehicle: Vehicle) -> tuple[None, None, None]:
        seen.append(vehicle)
        return None, None, None

    monkeypatch.setattr(QuestionInputs, "estimate_recording", moved)
    monkeypatch.setattr(withheld, "prediction_rmse", lambda *_: np.ones(2))
    less = {"steering": {"time_constant_s": 0.05}}
    case = WithheldQuestion(recording="take.csv", name="lag", vehicle=less, accepted=["steering_lag"])
    assert withheld.answer_withheld_question(case, asked)["verdict"] == NOT_ASKED
    assert [(v.body.mass_kg, v.steering.time_constant_s) for v in seen] == [(20.0, 0.05), (20.0, 0.3)]


@pytest.mark.parametrize(
    ("named", "right"),
    [
        (["steering_backlash", "pose_latency"], True),
        (["steering_backlash", "mass_change"], False),
        (["pose_latency"], True),
        (["rear_toe"], False),
    ],
)
def test_what_other_drives_of_a_car_show_as_well_is_no_ghost(named: list[str], right: bool) -> None:
    case = WithheldQuestion(
        recording="take.csv", name="ghost", accepted=[VEHICLE_PHYSICS], control=True, known=["steering_backlash"]
    )
    assert score_answer(case, said_of([(name, []) for name in named]))["right"] is right


@pytest.mark.parametrize(
    ("value", "se", "before", "unsure", "right"),
    [
        (0.05, 0.001, -0.01, 0.001, True),
        (0.05, 0.001, 0.01, 0.001, False),  # a third less than the edit
        (0.06, 0.001, 0.0, 0.001, True),
        (0.043, 0.006, 0.0, 0.001, True),  # within what it is sure of
        (0.02, 0.1, 0.0, 0.1, False),  # which may not be anything
        (0.02, 0.1, 0.02, 0.1, False),  # nothing more than there was before
        (None, 0.0, 0.0, 0.0, False),
    ],
)
def test_an_edit_is_what_a_drive_shows_beyond_what_it_showed_before(
    value: float | None, se: float, before: float, unsure: float, right: bool
) -> None:
    """A pose that comes 0.06 s late, where it came `before` already."""
    found = [{"effect": "pose_latency", "values": {"tau": [value, se]}}] if value is not None else []
    said = {"verdict": "named", "before": {"tau": [before, unsure]}, "findings": found}
    row = score_answer(EditedQuestion(recording="take.csv", effect="pose_latency", value=0.06), said)
    assert (row["right"], row["value"]) == (right, value)


@pytest.mark.parametrize(
    ("d_y", "more", "right"),
    [(-0.007, (), True), (0.015, (), False), (-0.007, ("rear_toe",), False)],
)
def test_an_edit_is_nothing_else(d_y: float, more: tuple[str, ...], right: bool) -> None:
    """The tracked point is moved ahead, not to the side, and nothing else is edited."""
    found = [{"effect": "marker_offset", "values": {"d_x": [0.033, 0.001], "d_y": [d_y, 0.001]}}]
    found += [{"effect": name, "values": {}} for name in more]
    said = {"verdict": "named", "before": {"d_x": [0.002, 0.001], "d_y": [-0.006, 0.001]}, "findings": found}
    row = score_answer(EditedQuestion(recording="take.csv", effect="marker_offset", value=0.03), said)
    assert (row["right"], row["beside"]) == (right, list(more))


def test_what_is_said_of_an_edited_drive_is_kept_with_what_it_showed_before(
    drive: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The effect that is edited is taken from what the drive is known to show, and looked for anew."""
    (tmp_path / "vehicle.toml").write_text(VEHICLE, encoding="utf-8")
    asked, given = QuestionInputs(read_vehicle(tmp_path / "vehicle.toml"), {}, None, tmp_path), list[ReferenceModel]()
    monkeypatch.setattr(QuestionInputs, "estimate_recording", lambda *_: (drive, None, None))
    monkeypatch.setattr(edited, "estimate_motion", lambda *_: None)
    monkeypatch.setattr(edited, "diagnose_recordings", lambda *of: given.append(of[3]))
    monkeypatch.setattr(edited, "diagnosis_row", lambda _: said_of([]))
    known = ReferenceModel(CAR, {"pose_latency__tau": 0.01, "yaw_scrub__c": 3.0}, LIMITS.unedited_relative_sd)
    before = edited.UneditedDrive(known, {"pose_latency": {"tau": (0.01, 0.001)}})
    row = edited.answer_edited_question(
        EditedQuestion(recording="take.csv", effect="pose_latency", value=0.06), before, asked
    )
    assert (row["truth"], row["before"]) == (0.06, {"tau": (0.01, 0.001)})
    assert [c.effects for c in given] == [{"yaw_scrub__c": 3.0}]


def test_what_a_drive_shows_of_an_effect_before_it_is_edited(monkeypatch: pytest.MonkeyPatch) -> None:
    """Beside all else that it shows, which is known as well as when the edit is looked for; itself it is free."""
    found = Hypothesis((), CAR, 2.012, Constants()).with_effects("steering_backlash", "yaw_scrub")
    phi = found.phi_of(CAR._replace(K_t=300.0), [0.02, 3.0])
    best = SimpleNamespace(hypothesis=found, phi=phi, start=None, scales=None, car=lambda: found.car(phi))
    unedited: Any = SimpleNamespace(fit=best, take=None)
    asked = list[tuple[Hypothesis, np.ndarray]]()

    def refit(take: Any, more: Hypothesis, start: np.ndarray, *_: Any) -> Any:
        asked.append((more, start))
        values = {"pose_latency__tau": (-0.01, 0.002), "steering_backlash__b": (0.019, 0.001)}
        return SimpleNamespace(effect_estimates=lambda: values)

    monkeypatch.setattr(edited, "refit", refit)
    assert edited._unedited_values("steering_backlash", unedited) == {"b": (0.019, 0.001)}
    assert edited._unedited_values("pose_latency", unedited) == {"tau": (-0.01, 0.002)}
    for (more, start), effects, own in zip(
        asked, (("yaw_scrub", "steering_backlash"), ("steering_backlash", "yaw_scrub", "pose_latency")), (0.02, 0.0),
        strict=True,
    ):  # fmt: skip
        assert more.effects == effects
        values = list(more.effect_values(start).values())
        assert values[-1] == pytest.approx(own)
        assert values[-2] == pytest.approx(3.0)
        centre, stiffness = more.prior(start)
        np.testing.assert_allclose(centre, start)
        assert stiffness[more.log_parameters.index("K_t")] == pytest.approx(LIMITS.unedited_relative_sd**-2)
        assert stiffness[-2] > 0.0  # the scrub is known
        assert stiffness[-1] == 0.0  # the effect itself is not


def test_a_drive_is_asked_freely_and_then_as_an_edited_one(
    drive: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What the second asking adds is known as well; an effect that cannot be fitted there takes no other with it."""
    (tmp_path / "vehicle.toml").write_text(VEHICLE, encoding="utf-8")
    asked = QuestionInputs(read_vehicle(tmp_path / "vehicle.toml"), {}, None, tmp_path)
    of, simulations = Hypothesis((), CAR, 2.012, Constants()), list[Any]()

    def diagnosed(recordings: Any, estimates: Any, vehicle: Any, simulation: ReferenceModel | None) -> Any:
        simulations.append(simulation)
        holding = of.with_effects("steering_backlash", *(["yaw_scrub"] if simulation else []))
        phi = holding.phi_of(CAR, [0.02, 3.0][: len(holding.effects)])
        best = SimpleNamespace(hypothesis=holding, phi=phi, car=lambda: CAR)
        return SimpleNamespace(fit=best)

    def before(effect: str, _: Any) -> dict[str, tuple[float, float]]:
        if effect == "pose_scale":
            raise PredictionDiverged
        return {"tau": (0.0, 0.1)}

    monkeypatch.setattr(QuestionInputs, "estimate_recording", lambda *_: (drive, None, None))
    monkeypatch.setattr(edited, "diagnose_recordings", diagnosed)
    monkeypatch.setattr(edited, "_unedited_values", before)
    found = edited.diagnose_unedited_drive("take.csv", ("pose_latency", "pose_scale"), asked)
    assert simulations[0] is None
    assert simulations[1].relative_sd == found.simulation.relative_sd == LIMITS.unedited_relative_sd
    assert simulations[1].effects == pytest.approx({"steering_backlash__b": 0.02})
    assert found.simulation.effects == pytest.approx({"steering_backlash__b": 0.02, "yaw_scrub__c": 3.0})
    assert found.effect_values == {"pose_latency": {"tau": (0.0, 0.1)}}
    assert edited.UneditedDrive.from_row(json.loads(json.dumps(found.as_row()))).simulation == found.simulation
    with pytest.raises(PredictionDiverged, match="pose_scale"):
        edited.answer_edited_question(
            EditedQuestion(recording="take.csv", effect="pose_scale", value=0.08), found, asked
        )


def test_other_commands_are_another_question(asked: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A Motive take's lie beside it."""
    for file in (f for f in asked.iterdir() if f.is_file()):
        (tmp_path / file.name).write_bytes(file.read_bytes())
    done = list[str]()
    monkeypatch.setattr(
        run_questions, "_run_and_store_job", lambda job, *_: done.append(job.key) or {"error": "none is wanted"}
    )
    commands = tmp_path / "take.commands.csv"
    for times, text in ((4, commands.read_text()), (8, commands.read_text().replace("0.1", "0.2"))):
        commands.write_text(text)
        list(run_real_questions(tmp_path / "cases.toml", tmp_path, tmp_path / "out"))
        assert len(done) == times


def test_another_calibration_is_another_question(asked: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(withheld, "answer_withheld_question", lambda *_: said_of([]))
    for name in ("vehicle.toml", "simulation.toml"):
        (tmp_path / name).write_bytes((asked / name).read_bytes())
    text = (asked / "cases.toml").read_text(encoding="utf-8").partition("[[edited]]")[0]
    for own in ("", "[calibrated.'take.csv'.body]\nmass_kg = 20.0\n", ""):
        (tmp_path / "cases.toml").write_text(text + own, encoding="utf-8")
        assert len(list(run_real_questions(tmp_path / "cases.toml", asked, tmp_path / "out"))) == 2
    assert len(read_rows(tmp_path / "out")) == 4  # two questions, of either calibration


def test_what_makes_no_difference_where_it_is_withheld_is_not_asked(asked: Path, tmp_path: Path) -> None:
    """The wheel's servo settles in 0.15 s; a vehicle file that says 0.149 s withholds nothing that is seen."""
    for name in ("vehicle.toml", "simulation.toml"):
        (tmp_path / name).write_bytes((asked / name).read_bytes())
    told = read_vehicle(asked / "vehicle.toml").steering.time_constant_s
    assert told
    (tmp_path / "cases.toml").write_text(
        f"""vehicle = "vehicle.toml"
simulation = "simulation.toml"
[[withheld]]
recording = "take.csv"
name = "a hundredth of the servo's lag"
vehicle = {{ steering = {{ time_constant_s = {0.99 * told} }} }}
accepted = ["steering_lag"]
""",
        encoding="utf-8",
    )
    ((row, share),) = run_real_questions(tmp_path / "cases.toml", asked, tmp_path / "out")
    assert share == 1.0
    assert row["ratio"] == pytest.approx(1.0, abs=0.05)
    assert row["verdict"].startswith("not asked")
    assert real_outcome([row], "c0de")["tiers"] == {
        "withheld": {"right": 0, "n": 0, "named": 0, "first": 0, "alone": 0, "names": 0, "accepted": 0}
    }


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (('effect = "steering_drag"', 'effect = "steering_dragg"'), "no 'steering_dragg'"),
        (('accepted = ["motor_lag"]', 'accepted = ["motor_lagg"]'), "motor_lagg"),
        (('accepted = ["motor_lag"]', "accepted = []"), "accepts nothing"),
        (('effect = "steering_offset"', 'effect = "no_such_edit"'), "no such edit"),
        (("control = true", 'known = ["motor_lag"]'), "no control"),
        (("control = true", 'control = true\nknown = ["motor_lagg"]'), "motor_lagg"),
        (("control = true", "parameters.F_fmax = 9.0"), "changes parameters F_fmax"),
        (("control = true", "parameters.F_f_max = -9.0"), "changes parameters F_f_max"),
        (('accepted = ["motor_lag"]', 'accepted = ["unknown in Fy"]'), "unknown in Fy"),
        (('"simulation.toml"', '"not_there.toml"'), "not_there.toml"),
        (('"simulation.toml"', '"simulation.toml"\ncalibrated.other.body.mass_kg = 1.0'), "nothing is asked of other"),
        (('"simulation.toml"', '"simulation.toml"\ncalibrated."take.csv".body.mass = 1.0'), "unknown key body.mass"),
    ],
)
def test_a_question_that_asks_nothing_is_refused(
    change: tuple[str, str], says: str, asked: Path, tmp_path: Path
) -> None:
    for name in ("vehicle.toml", "simulation.toml"):
        (tmp_path / name).write_bytes((asked / name).read_bytes())
    text = (asked / "cases.toml").read_text(encoding="utf-8")
    assert change[0] in text
    (tmp_path / "cases.toml").write_text(text.replace(*change), encoding="utf-8")
    with pytest.raises(InputRefused, match=says):
        next(run_real_questions(tmp_path / "cases.toml", asked, tmp_path / "out"))


@pytest.mark.parametrize("text", ["effects = 3", "[parameters", "parameters = {}\nno_such = 1"])
def test_questions_beside_a_simulation_that_is_none_are_refused(text: str, asked: Path, tmp_path: Path) -> None:
    for name in ("vehicle.toml", "cases.toml"):
        (tmp_path / name).write_bytes((asked / name).read_bytes())
    (tmp_path / "simulation.toml").write_text(text, encoding="utf-8")
    with pytest.raises(InputRefused, match=r"simulation\.toml"):
        next(run_real_questions(tmp_path / "cases.toml", asked, tmp_path / "out"))


@pytest.mark.parametrize("workers", [1, 2])
def test_edits_of_a_drive_are_held_against_what_it_showed_once(
    workers: int, asked: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is asked first, for all of them, and kept like the answers; an edit that is asked later uses what was kept."""
    for name in ("vehicle.toml", "simulation.toml"):
        (tmp_path / name).write_bytes((asked / name).read_bytes())
    before, told = {"steering_offset": {"o": (0.01, 0.002)}}, list[Any]()

    def as_it_was(name: str, effects: tuple[str, ...], _: QuestionInputs) -> edited.UneditedDrive:
        told.append((name, effects))
        return edited.UneditedDrive(ReferenceModel(CAR, {"yaw_scrub__c": 3.0}, LIMITS.unedited_relative_sd), before)

    def answered(case: EditedQuestion, known: edited.UneditedDrive, _: QuestionInputs) -> dict[str, Any]:
        assert known.simulation == ReferenceModel(CAR, {"yaw_scrub__c": 3.0}, LIMITS.unedited_relative_sd)
        assert known.effect_values["steering_offset"]["o"][0] == 0.01
        told.append(case.value)
        if case.value == 0.03 and told.count(0.03) == 1:
            raise PredictionDiverged("left the numbers")
        return {**said_of([]), "before": known.effect_values["steering_offset"]}

    monkeypatch.setattr("bcid.proof.workers.process_pool", ThreadPoolExecutor)  # shares what stands in for a diagnosis
    monkeypatch.setattr(edited, "diagnose_unedited_drive", as_it_was)
    monkeypatch.setattr(edited, "answer_edited_question", answered)
    edits = "".join(
        f'[[edited]]\nrecording = "take.csv"\neffect = "steering_offset"\nvalue = {value}\n' for value in (0.02, 0.03)
    )
    (tmp_path / "cases.toml").write_text(
        f'vehicle = "vehicle.toml"\nsimulation = "simulation.toml"\n{edits}', encoding="utf-8"
    )
    for _ in range(2):
        rows = list(run_real_questions(tmp_path / "cases.toml", asked, tmp_path / "out", workers))
        assert [share for _, share in rows] == [0.5, 1.0]
    assert told[0] == ("take.csv", ("steering_offset",))
    assert sorted(told[1:]) == [0.02, 0.03, 0.03]


def test_a_question_that_ends_in_an_error_is_told_and_asked_again(
    asked: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And takes no other with it: each takes a quarter of an hour."""
    answers = list[str]()

    def answered(case: WithheldQuestion, _: Any) -> dict[str, Any]:
        answers.append(case.name)
        if not case.control:
            raise PredictionDiverged("left the numbers")
        return said_of([])

    def shown(*_: Any) -> None:
        raise InputRefused("take.csv", "poses", "cannot be followed", "look at it")

    monkeypatch.setattr("bcid.proof.workers.process_pool", ThreadPoolExecutor)
    monkeypatch.setattr(withheld, "answer_withheld_question", answered)
    monkeypatch.setattr(edited, "diagnose_unedited_drive", shown)
    for workers in (1, 3):
        rows = [row for row, _ in run_real_questions(asked / "cases.toml", asked, tmp_path, workers)]
        assert real_outcome(rows, "c0de")["tiers"] == {
            "withheld": {"right": 0, "n": 1, "named": 0, "first": 0, "alone": 0, "names": 0, "accepted": 0},
            "control": {"right": 1, "n": 1}, "edited": {"right": 0, "n": 1},
        }  # fmt: skip
        told = {row["tier"]: row.get("error", "") for row in rows}
        assert "left the numbers" in told["withheld"]
        assert "cannot be followed" in told["edited"]
    assert sorted(answers) == ["drag of the steered wheel"] * 2 + ["nothing"]


def test_prove_counts_real_recordings_and_ends_with_5_where_one_is_wrong(
    asked: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(withheld, "answer_withheld_question", lambda *_: {"ratio": 2.0, **said_of([])})
    monkeypatch.setattr(edited, "diagnose_unedited_drive", lambda *_: edited.UneditedDrive(ReferenceModel(CAR, {}), {}))
    offset = [{"effect": "steering_offset", "twins": [], "values": {"o": [0.021, 0.001]}}]
    before = {"o": [0.0, 0.001]}
    monkeypatch.setattr(
        edited, "answer_edited_question", lambda *_: {**said_of([]), "before": before, "findings": offset}
    )
    words = ["bcid", "prove", "--out", str(tmp_path), "--workers", "1"]
    words += ["--real", str(asked / "cases.toml"), "--recordings", str(asked)]
    monkeypatch.setattr("sys.argv", words)
    with pytest.raises(SystemExit) as ended:
        main()
    told = capsys.readouterr()
    assert ended.value.code == 5
    assert (
        "withheld: 0 of 1 (0 by name, 0 first, 0 alone), 0 of 0 names accepted; control: 1 of 1; edited: 1 of 1"
        in " ".join(told.out.split())
    )
    assert "drag of the steered wheel" in told.err
    assert json.loads((tmp_path / "real.json").read_text())["tiers"]["edited"] == {"right": 1, "n": 1}


def test_the_questions_that_the_project_asks_are_questions() -> None:
    files = [file for file in Path("pipelines").glob("*/*.toml") if "[[withheld]]" in file.read_text(encoding="utf-8")]
    assert len(files) >= 3
    for file in files:
        cases = read_questions(file)
        usual = read_vehicle(cases.vehicle)
        QuestionInputs(usual, cases.calibrated, cases.simulation, Path()).check_vehicles(cases, file)
        assert cases.withheld


@pytest.mark.proof
def test_a_real_dead_zone_is_told(recordings_folder: Path, tmp_path: Path) -> None:
    """The published model of the DART car without its motor's dead zone (0.164 of the throttle)."""
    cases = Path(__file__).parents[1] / "pipelines" / "dart"
    text = (cases / "cases.toml").read_text(encoding="utf-8")
    dead_zone = next(part for part in text.split("\n[[")[1:] if 'effect = "motor_dead_zone"' in part)
    for name in ("vehicle.toml", "simulation.toml"):
        (tmp_path / name).write_bytes((cases / name).read_bytes())
    head = text.partition("[calibrated")[0]  # of other drives
    (tmp_path / "cases.toml").write_text(f"{head}\n[[{dead_zone}", encoding="utf-8")
    ((row, _),) = run_real_questions(tmp_path / "cases.toml", recordings_folder, tmp_path / "out")
    assert row["ratio"] > 1.3
    found = {f["effect"]: f for f in row["findings"]}
    assert found["motor_dead_zone"]["values"]["width"][0] == pytest.approx(0.164, abs=0.02)
