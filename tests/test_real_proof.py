"""Edits of real recordings, files of parameters and trust in a simulation."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from cars import CAR

from bcid.diagnosis.judge.held_out import block_length_s
from bcid.diagnosis.limits import JUDGE_LIMITS
from bcid.diagnosis.reference import reference_from_parameters
from bcid.diagnosis.reference_model import ReferenceModel
from bcid.effects.constants import Constants
from bcid.effects.corrections import RAW_COMMANDS
from bcid.effects.measurement import tracked_pose
from bcid.effects.remainder_table import COEFFICIENT, COLUMNS
from bcid.effects.table import ENTRIES, effect_switches
from bcid.errors import InputRefused, PredictionDiverged
from bcid.estimate.types import Estimate
from bcid.likelihood.hypothesis import Hypothesis
from bcid.likelihood.limits import LIKELIHOOD_LIMITS
from bcid.likelihood.prior import TRUST_NU
from bcid.likelihood.tracking_functions import AMOUNT, TRACKING_COLUMNS
from bcid.likelihood.unnamed_functions import RemainderFunctions
from bcid.proof.real import edited
from bcid.proof.real.edits import EDITS
from bcid.proof.real.limits import LIMITS
from bcid.proof.real.question_files import QuestionInputs
from bcid.proof.real.questions import EditedQuestion
from bcid.proof.real.variations import AS_ASKED, PARTS
from bcid.recording.types import Recording, SourceFile, Stream
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


@pytest.fixture
def inputs(vehicle: Vehicle, tmp_path: Path) -> QuestionInputs:
    return QuestionInputs(vehicle, {}, None, tmp_path)


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
    centre, stiffness, *_ = free.with_effects().prior(start)
    np.testing.assert_array_equal(centre, start)  # weak, about where the refit starts
    assert set(stiffness) == {0.0, LIKELIHOOD_LIMITS.base_prior_sd**-2}
    trusting = free.trust_simulation(values, 0.02).with_effects("yaw_scrub")
    more = trusting.phi_of(CAR._replace(K_t=300.0), [*values, 13.0])
    centre, stiffness, nu, _ = trusting.prior(more)
    logs, base = len(trusting.log_parameters), trusting.base_size
    np.testing.assert_allclose(np.exp(centre[:logs]), [getattr(CAR, s) for s in trusting.log_parameters])
    np.testing.assert_allclose(stiffness[:logs], 0.02**-2)
    np.testing.assert_array_equal(nu == TRUST_NU, np.arange(len(nu)) < len(nu) - 1)
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


def test_trust_has_no_end() -> None:
    """What is trusted has the bounds of any car; a share of a take pulls by that share."""
    free = Hypothesis((), CAR, 2.012, Constants(), assumed=("motor_lag",))
    trusting = free.trust_simulation([0.06], 0.02, {"K_t": 0.05}).with_effects("yaw_scrub")
    for one, other in zip(trusting.bounds(), free.with_effects("yaw_scrub").bounds(), strict=True):
        np.testing.assert_array_equal(one, other)
    phi = trusting.phi_of(CAR._replace(K_t=2.0 * CAR.K_t), [0.1, 13.0])
    whole, tenth = trusting.prior(phi), trusting.scale_simulation_prior(0.1).prior(phi)
    assert tenth.log_density(phi) == pytest.approx(0.1 * whole.log_density(phi))
    np.testing.assert_allclose(tenth.slope(phi), 0.1 * whole.slope(phi))


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


def said_of(names: list[str]) -> dict[str, Any]:
    """What a diagnosis says that names these effects, each alone, or that fx is unknown."""
    told = [{"effect": effect, "kind": "vehicle", "twins": [], "values": {}} for effect in names]
    return {"verdict": "named" if told else "unknown", "findings": told, "remainder": {"channel": "fx"}}


def test_what_is_said_of_an_edited_drive_is_kept_with_what_it_showed_before(
    drive: Recording, inputs: QuestionInputs, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The effect that is edited is taken from what the drive is known to show, and looked for anew.

    It is worth what the drive gains by it, sought from what the drive showed and the edit together.
    """
    given, weighed = list[ReferenceModel](), list[dict[str, float]]()
    made = SimpleNamespace(
        naming=SimpleNamespace(base=SimpleNamespace(hypothesis=None), gate_of=lambda effect: 23.04), take=None
    )

    def diagnose(recordings: Any, estimates: Any, vehicle: Any, reference: ReferenceModel) -> Any:
        given.append(reference)
        return made

    def weigh(without: Any, structure: Any, take: Any, effects: Any, sizes: dict[str, float]) -> Any:
        weighed.append(sizes)
        return SimpleNamespace(nats=60.04)

    monkeypatch.setattr(QuestionInputs, "estimate_recording", lambda *_: (drive, None, None))
    monkeypatch.setattr(edited, "estimate_motion", lambda *_: None)
    monkeypatch.setattr(edited, "diagnose_recordings", diagnose)
    monkeypatch.setattr(edited, "fit_true_structure", weigh)
    monkeypatch.setattr(edited, "diagnosis_row", lambda _: said_of([]))
    known = ReferenceModel(CAR, {"pose_latency__tau": 0.01, "yaw_scrub__c": 3.0}, LIMITS.unedited_relative_sd)
    before = edited.UneditedDrive(known, {"pose_latency": {"tau": (0.01, 0.001)}}).as_row()
    question = EditedQuestion("take.csv", "pose_latency", 0.06)
    row = edited.answer_edited_question(question, AS_ASKED, inputs, json.loads(json.dumps(before)))
    assert (row["truth"], row["before"], row["worth"]) == (0.06, {"tau": [0.01, 0.001]}, 60.0)
    assert [c.effects for c in given] == [{"yaw_scrub__c": 3.0}]
    assert (row["has"], row["gate"]) == (["yaw_scrub"], 23.0)
    assert weighed == [{"pose_latency__tau": pytest.approx(0.07)}]
    again = edited.answer_edited_question(question, PARTS[0], inputs, json.loads(json.dumps(before)))
    assert "worth" not in again
    assert len(weighed) == 1  # of the question as it is asked


def test_what_a_drive_shows_of_an_effect_before_it_is_edited(monkeypatch: pytest.MonkeyPatch) -> None:
    """Beside all else that it shows, which is known as well as when the edit is looked for; itself it is free."""
    found = Hypothesis((), CAR, 2.012, Constants(), remainder=RemainderFunctions(
        np.zeros((1, COLUMNS)), np.zeros((1, TRACKING_COLUMNS)), ("fx", "pose"), np.array([0.5, 0.1])
    )).with_effects("steering_backlash", "yaw_scrub")  # fmt: skip
    phi = found.phi_of(CAR._replace(K_t=300.0), [0.02, 3.0])
    phi[-2:] = 2.0, 3.0  # over their prior's standard deviations
    best = SimpleNamespace(hypothesis=found, phi=phi, start=None, scales=None, car=lambda: found.car(phi))
    unedited: Any = SimpleNamespace(whole_fit=best, take=None)
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
        assert more.known.on_body[:, COEFFICIENT].tolist() == [1.0]
        assert more.known.tracking[:, AMOUNT] == pytest.approx([0.3])
        assert more.size == more.named_size  # it has no remainder of its own
        values = list(more.effect_values(start).values())
        assert values[-1] == pytest.approx(own)
        assert values[-2] == pytest.approx(3.0)
        centre, precision, *_ = more.prior(start)
        np.testing.assert_allclose(centre, start)
        assert precision[more.log_parameters.index("K_t")] == pytest.approx(LIMITS.unedited_relative_sd**-2)
        assert precision[-2] > 0.0  # the scrub is known
        assert precision[-1] == 0.0  # the effect itself is not


@pytest.mark.parametrize("published", [None, ReferenceModel(CAR, {}, 0.3)])
def test_a_drive_is_asked_beside_what_is_published_and_then_as_an_edited_one(
    drive: Recording, inputs: QuestionInputs, published: ReferenceModel | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What the second asking adds is known as well; an effect that cannot be fitted there takes no other with it."""
    of, simulations = Hypothesis((), CAR, 2.012, Constants()), list[Any]()

    def diagnosed(recordings: Any, estimates: Any, vehicle: Any, simulation: ReferenceModel | None) -> Any:
        simulations.append(simulation)
        holding = of.with_effects("steering_backlash", *(["yaw_scrub"] if simulations[1:] else []))
        phi = holding.phi_of(CAR, [0.02, 3.0][: len(holding.effects)])
        best = SimpleNamespace(hypothesis=holding, phi=phi, car=lambda: CAR)
        return SimpleNamespace(whole_fit=best)

    def before(effect: str, _: Any) -> dict[str, tuple[float, float]]:
        if effect == "pose_scale":
            raise PredictionDiverged
        return {"tau": (0.0, 0.1)}

    monkeypatch.setattr(QuestionInputs, "estimate_recording", lambda *_: (drive, None, None))
    monkeypatch.setattr(QuestionInputs, "published_model", lambda *_: published)
    monkeypatch.setattr(edited, "diagnose_recordings", diagnosed)
    monkeypatch.setattr(edited, "_unedited_values", before)
    row = edited.diagnose_unedited_drive("take.csv", ("pose_latency", "pose_scale"), AS_ASKED, inputs)
    found = edited.UneditedDrive.from_row(json.loads(json.dumps(row)))
    assert simulations[0] is published
    assert simulations[1].relative_sd == found.simulation.relative_sd == LIMITS.unedited_relative_sd
    assert simulations[1].effects == pytest.approx({"steering_backlash__b": 0.02})
    assert found.simulation.effects == pytest.approx({"steering_backlash__b": 0.02, "yaw_scrub__c": 3.0})
    assert found.effect_values == {"pose_latency": {"tau": [0.0, 0.1]}}
    with pytest.raises(PredictionDiverged, match="pose_scale"):
        edited.answer_edited_question(EditedQuestion("take.csv", "pose_scale", 0.08), AS_ASKED, inputs, row)
