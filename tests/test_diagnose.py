"""From a recording to a verdict, its JSON, its page and its model; each verdict on a small log."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from cars import CAR
from typer.testing import CliRunner
from viewed import miss_m, read_view

from bcid.cli.app import app
from bcid.diagnosis import diagnose
from bcid.diagnosis.diagnose import BaseFit, Diagnosis, diagnose_recordings
from bcid.diagnosis.judge.fitted_models import model_from_reference
from bcid.diagnosis.judge.not_excited import Excitation
from bcid.diagnosis.limits import JUDGE_LIMITS
from bcid.diagnosis.reference_model import ReferenceModel
from bcid.diagnosis.remainder.chance import Chance
from bcid.diagnosis.summary import KNOT_UNITS, knot_columns, summarise_diagnosis
from bcid.documents.diagnosis import DiagnosisDocument
from bcid.documents.model_card import ModelCard
from bcid.effects.constants import Constants
from bcid.effects.remainder_table import COLUMNS
from bcid.effects.table import EFFECTS
from bcid.errors import InputRefused, PredictionDiverged, UsageError
from bcid.estimate.run import estimate_motion
from bcid.estimate.tuning import Tuning
from bcid.estimate.types import Estimate
from bcid.evaluation.seen_takes import load_seen_takes
from bcid.evaluation.validity import load_validity
from bcid.likelihood.hypothesis import Hypothesis
from bcid.likelihood.take import KNOTS, cut_segments, drop_contacts
from bcid.likelihood.unnamed_functions import UnnamedFunctions
from bcid.models.newton_euler.with_remainder import NewtonEulerWithRemainder
from bcid.models.saving import load_model
from bcid.pipeline.named_models import WITH_REMAINDER
from bcid.recording.checks.contacts import find_contacts
from bcid.recording.read import read_recording
from bcid.recording.types import Recording, Stream
from bcid.simulation.car import Plant, Sensor
from bcid.simulation.samples import SampleTake as Order
from bcid.simulation.samples import write_sample_take
from bcid.store.artifact import file_sha256
from bcid.vehicle import Vehicle
from bcid.view.tables import diagnosis_tables

ROUGH = {"rough_force": 3.0, "rough_moment": 1.5}
SECONDS = 120.0


def taken(
    folder: Path, vehicle: Vehicle, tuning: Tuning, plant: Plant, seed: int, sensor: Sensor | None = None
) -> tuple[Recording, Estimate]:
    path = write_sample_take(folder, Order(f"take{seed}", "mcap", SECONDS), plant, sensor or Sensor(), seed)
    recording = read_recording(path, vehicle)
    return recording, estimate_motion(recording, vehicle, tuning)


def verdict_on(
    folder: Path, vehicle: Vehicle, tuning: Tuning, plant: Plant, left_out: tuple[str, ...] = ()
) -> Diagnosis:
    recording, estimate = taken(folder, vehicle, tuning, plant, 5)
    return diagnose_recordings([recording], [estimate], vehicle, excluded=left_out)


def diagnosis(
    remainder: float = 0.0, place: float = 1.0, window: float = 1.0, corrected: tuple[int, float] = (0, 0.0),
    chance: Chance | None = None, gains: Sequence[str] = (),
) -> Diagnosis:  # fmt: skip
    """A diagnosis of which only the evidence against nothing missing is known; `corrected`: parameters, and nats."""
    base: Any = SimpleNamespace(hypothesis=SimpleNamespace(effect_parameters=()), log_likelihood=100.0)
    free, nats = corrected
    better: Any = SimpleNamespace(
        hypothesis=SimpleNamespace(effect_parameters=(None,) * free), log_likelihood=100.0 + nats
    )
    naming: Any = SimpleNamespace(
        base=base,
        corrected=better,
        before=SimpleNamespace(nats=remainder, spread={"fx": 0.1, "mz": 0.0}),
        chance=chance,
        gains=gains,
    )
    location: Any = SimpleNamespace(place_p_value=place, window_p_value=window)
    nothing: Any = None
    return Diagnosis(nothing, (), naming, nothing, location, nothing, nothing, nothing, Excitation((), {}))


@pytest.mark.parametrize(
    ("known", "p"),
    [
        ({}, 1.0),
        # by chance in one take of e^8 at most, for each of fifteen spreads of one channel, and one of four looks
        ({"remainder": 8.0}, 4.0 * 15.0 * np.exp(-8.0)),
        ({"remainder": -5.0}, 1.0),
        # an exponential law of chance, of which so many nats are nothing rare; beside names it was not drawn for them
        ({"remainder": 20.0, "chance": Chance(5.0, 5.0)}, 4.0 * np.exp(-4.0)),
        ({"remainder": 20.0, "chance": Chance(5.0, 5.0), "gains": ("rear_toe",)}, 4.0 * JUDGE_LIMITS.min_p_value),
        ({"place": 0.002}, 0.008),
        ({"window": 0.01, "place": 0.5, "remainder": 1.0}, 0.04),
        ({"corrected": (2, 6.0)}, 4.0 * np.exp(-6.0)),  # a chi-square of two degrees of freedom
        ({"corrected": (0, 0.0), "place": 0.9}, 1.0),
        ({"remainder": 500.0}, 4.0 * JUDGE_LIMITS.min_p_value),
    ],
)
def test_the_p_value_of_nothing_missing_is_the_least_of_four(known: dict[str, Any], p: float) -> None:
    assert diagnosis(**known).p_value == pytest.approx(p)


@pytest.mark.parametrize("kind", ["none", "trusted", "given", "diverges"])
def test_a_reference_is_evaluated_as_given(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """With its own parameters and effects, and nothing refitted."""
    h = Hypothesis((), CAR, 2.012, Constants(), assumed=("motor_lag", "steering_scale"), raw_commands=True)
    h = h.with_effects()
    asked = list[np.ndarray]()

    def held(take: Any, hypothesis: Hypothesis, phi: np.ndarray, scales: Any) -> str:
        asked.append(phi)
        if kind == "diverges":
            raise PredictionDiverged
        return "held"

    monkeypatch.setattr(diagnose, "evaluate_fixed", held)
    car = CAR._replace(K_t=1.1 * CAR.K_t)
    reference = ReferenceModel(car, {"motor_lag__tau": 0.06}, 0.02 if kind == "trusted" else None)
    fit: Any = SimpleNamespace(hypothesis=h, scales=None)
    nothing: Any = None
    of = BaseFit(nothing, (), fit, nothing, None if kind == "none" else reference)
    assert of.evaluate_reference() == ("held" if kind in ("given", "trusted") else None)
    if kind in ("given", "trusted"):
        assert h.car(asked[0]).K_t == pytest.approx(1.1 * CAR.K_t)
        assert h.effect_values(asked[0]) == pytest.approx({"motor_lag__tau": 0.06, "steering_scale__g": 0.0})
    else:
        assert len(asked) == (kind == "diverges")


def test_a_base_model_has_the_functions_of_its_simulation(
    vehicle: Vehicle, estimates: list[Estimate], monkeypatch: pytest.MonkeyPatch
) -> None:
    """And is no model that can be saved with them."""
    known = UnnamedFunctions(np.ones((2, COLUMNS)))
    fitted = list[Hypothesis]()

    def fit(recordings: Any, estimates: Any, hypothesis: Hypothesis, values: Any) -> Any:
        fitted.append(hypothesis)
        raise PredictionDiverged

    monkeypatch.setattr(diagnose.prepare, "prepare_and_fit_base", fit)
    reference = ReferenceModel(CAR, {"motor_lag__tau": 0.06}, 0.02, known=known)
    with pytest.raises(InputRefused):
        diagnose.fit_base_model([], estimates[:1], vehicle, reference)
    assert [h.known for h in fitted] == [known]
    with pytest.raises(UsageError, match="functions without a name"):
        model_from_reference(reference, vehicle, 60.0, 0.1)


@pytest.mark.slow
def test_nothing_is_found_where_nothing_is_missing(tmp_path: Path, vehicle: Vehicle, tuning: Tuning) -> None:
    found = verdict_on(tmp_path, vehicle, tuning, Plant(**ROUGH))
    assert found.judgement.verdict == "nothing-found"
    assert found.judgement.findings == ()
    assert found.p_value > 0.01
    told = summarise_diagnosis(found)
    assert (told.unknown, told.findings, told.rivals) == (None, (), ())
    assert told.unexplained is not None
    assert told.unexplained.gain_nats == 0.0
    assert not told.mismatch.detected
    columns = knot_columns(found)
    assert columns.shape == (KNOTS * found.take.segments, len(KNOT_UNITS))
    np.testing.assert_array_equal(columns[:, -3:], columns[:, -6:-3])  # nothing named: before is after


@pytest.mark.slow
def test_an_effect_is_named_with_its_value(tmp_path: Path, vehicle: Vehicle, tuning: Tuning) -> None:
    found = verdict_on(tmp_path, vehicle, tuning, Plant(**ROUGH, yaw_scrub=14.0))
    assert found.judgement.verdict == "named"
    (finding,) = found.judgement.findings
    assert finding.effect == "yaw_scrub"
    value, se = finding.values["c"]
    assert value == pytest.approx(14.0, abs=4.0 * se)
    assert finding.held_out.ci95[0] > 0.0
    assert finding.probability > 0.9
    assert found.location.channel == "mz"
    assert found.location.depends_on == ("yaw_rate",)
    assert found.p_value == pytest.approx(4.0 * JUDGE_LIMITS.min_p_value)


@pytest.mark.slow
def test_what_is_not_in_the_vocabulary_is_unknown_with_its_channel(
    tmp_path: Path, vehicle: Vehicle, tuning: Tuning
) -> None:
    along = tuple(n for n, e in EFFECTS.items() if e.channel in ("fx", "any", "motor"))
    found = verdict_on(tmp_path, vehicle, tuning, Plant(**ROUGH, rear_rolling_viscous=25.0), along)
    assert found.judgement.verdict == "unknown"
    assert found.judgement.findings == ()
    assert found.judgement.unknown is not None
    assert found.judgement.unknown.ci95[0] > 0.0
    told = summarise_diagnosis(found)
    assert told.unknown is not None
    assert told.unknown.channel == "fx"
    assert "v_x" in told.unknown.depends_on
    assert told.unknown.gain_nats == pytest.approx(found.naming.unknown_nats)
    assert told.unexplained is not None
    assert next(iter(told.unexplained.channel_nats)) == "fx"
    assert told.where.channel == "fx"
    assert told.located is not None
    assert told.located.channel == "fx"


@pytest.mark.slow
def test_a_late_pose_has_the_pair_of_delays_as_its_twin(tmp_path: Path, vehicle: Vehicle, tuning: Tuning) -> None:
    recording, estimate = taken(tmp_path, vehicle, tuning, Plant(**ROUGH), 6, Sensor(pose_latency=0.015))
    found = diagnose_recordings([recording], [estimate], vehicle)
    assert found.judgement.verdict == "ambiguous"
    (finding,) = found.judgement.findings
    assert finding.effect == "pose_latency"
    assert "steering_delay+motor_delay" in finding.twins
    assert EFFECTS[finding.effect].kind == "measurement"


def test_a_car_that_stands_after_a_blow_has_crashed(tmp_path: Path, vehicle: Vehicle, tuning: Tuning) -> None:
    recording, estimate = taken(tmp_path, vehicle, tuning, Plant(**ROUGH), 7)
    fastest = estimate.time_s[int(np.argmax(np.abs(estimate.kinematic[:, 0])))]
    time, values = recording.poses.time_s, recording.poses.values.copy()
    hit = int(np.searchsorted(time, fastest))
    values[hit:] = values[hit] + np.random.default_rng(0).normal(0.0, 5e-4, values[hit:].shape)
    (crash,) = find_contacts(replace(recording, poses=Stream(time, values)))
    assert crash.kind == "crash"
    assert crash.begin_s == pytest.approx(time[hit] - time[0], abs=0.2)


@pytest.mark.parametrize(("every", "bump"), [(1, 1.2), (2, 1.2), (6, 2.0)])
def test_contacts_are_found_excluded_and_nothing_else_is(
    every: int, bump: float, tmp_path: Path, vehicle: Vehicle, tuning: Tuning
) -> None:
    """At 60, 30 and 10 poses a second, where a blow has to be harder to be told from driving."""
    recording, estimate = taken(tmp_path, vehicle, tuning, Plant(**ROUGH), 7)
    poses = Stream(recording.poses.time_s[::every], recording.poses.values[::every])
    recording = replace(recording, poses=poses, rate_hz=recording.rate_hz / every)
    assert find_contacts(recording) == []
    time, values = recording.poses.time_s, recording.poses.values.copy()
    hit = int(np.searchsorted(time, 60.0))
    values[hit:, 0] += bump * (time[hit:] - time[hit])  # a bumper changes the speed at once
    bumped = replace(recording, poses=Stream(time, values))
    (contact,) = find_contacts(bumped)
    assert contact.kind == "contact"
    assert contact.begin_s <= 60.0 <= contact.end_s
    whole = cut_segments(bumped, estimate)
    rest = drop_contacts(whole, [contact])
    assert 1 <= whole.segments - rest.segments <= 3
    assert not np.any((rest.begin_s < 60.0) & (rest.begin_s + 1.5 > 60.0))


@pytest.mark.slow
def test_the_command_writes_json_page_and_a_model_that_others_take(tmp_path: Path, vehicle_file: Path) -> None:
    write_sample_take(tmp_path, Order("drag", "mcap", SECONDS), Plant(**ROUGH, rear_rolling_coulomb=25.0), Sensor(), 8)
    out = tmp_path / "out"
    words = ["diagnose", str(tmp_path / "drag.mcap"), "--vehicle", str(vehicle_file), "--out", str(out)]
    result = CliRunner().invoke(app, [*words, "--format", "json"])
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    assert found == json.loads((out / "diagnosis.json").read_text())
    assert found["schema"] == "bcid.diagnosis/2"
    assert found["verdict"] == "named"
    assert [f["effect"] for f in found["findings"]] == ["rear_rolling_coulomb"]
    (parameter,) = found["findings"][0]["parameters"].values()
    assert parameter["value"] == pytest.approx(25.0, abs=4.0 * parameter["se"])
    assert found["mismatch"]["where"]["channel"] == "fx"
    assert found["fit"]["nmse_after"] < found["fit"]["nmse_before"]
    assert found["fit"]["ratio_ci95"][1] < 1.0
    assert [h["horizon_s"] for h in found["horizons"]] == [0.5, 2.0, 10.0]
    budget = found["error_budget"]
    assert sum(p["share"] for p in budget["parts"]) == pytest.approx(1.0)
    # the same predictions as those of the table of errors
    assert budget["nmse"] == pytest.approx(found["fit"]["nmse_before"])
    rest = sum(p["share"] for p in budget["parts"] if p["cause"] not in ("effect", "corrections"))
    assert rest == pytest.approx(found["fit"]["nmse_after"] / found["fit"]["nmse_before"])
    assert budget["parts"][0]["effects"] == ["rear_rolling_coulomb"]
    assert budget["parts"][0]["ci95"][0] > 0.3
    page = (out / "diagnosis.html").read_text()
    assert "rear rolling coulomb" in page
    assert "The rear wheels brake with" in page
    card = ModelCard.read(out / "model_card.json")
    assert [f.name for f in card.data] == ["drag.mcap"]
    assert card.data[0].sha256 == file_sha256(tmp_path / "drag.mcap")
    assert card.data[0].sha256[:16] in page
    assert str(tmp_path) not in page
    assert "rear_rolling_coulomb" in load_model(out / "model").describe()
    viewed = CliRunner().invoke(app, ["view", str(out), "--out", str(tmp_path / "view.mcap")])
    assert viewed.exit_code == 0, viewed.output
    shown = read_view(tmp_path / "view.mcap")
    told = [
        read.message["message"] for read in shown["/bcid/findings"] if read.message["name"] == "rear_rolling_coulomb"
    ]
    assert "rear rolling coulomb" in told[0]
    miss = {name: miss_m(shown, name) for name in ("before", "after")}
    assert miss["after"] < 0.5 * miss["before"]
    validity = load_validity(out / "model")
    assert validity is not None
    assert validity.noise is not None
    assert validity.noise.pose_factor is not None


def test_a_plan_is_written_as_commands(tmp_path: Path, vehicle_file: Path) -> None:
    out = tmp_path / "plan.commands.csv"
    words = ["plan", "yaw_scrub", "--vehicle", str(vehicle_file), "--out", str(out), "--format", "json"]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    assert found["parts"]
    assert "yaw_scrub" in found["smallest"]
    assert out.read_text().startswith("time_s,steering_rad,throttle_mps")


@pytest.mark.slow
def test_what_has_no_name_is_saved_for_predictions_and_told_with_its_held_out_error(
    tmp_path: Path, vehicle_file: Path
) -> None:
    """A servo whose acceleration turns the car: no effect of the vocabulary does.  Once it has a name it goes."""
    write_sample_take(tmp_path, Order("servo", "mcap", SECONDS), Plant(**ROUGH, steering_reaction=25.0), Sensor(), 5)
    out = tmp_path / "out"
    words = ["diagnose", str(tmp_path / "servo.mcap"), "--vehicle", str(vehicle_file), "--out", str(out)]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0, done.output
    assert "with free functions" in done.stdout
    assert f"{out / WITH_REMAINDER} adds free functions" in done.stderr
    found = json.loads((out / "diagnosis.json").read_text())
    assert found["verdict"] == "unknown"
    assert all(h["nmse_remainder"] < 0.8 * h["nmse_after"] and h["remainder_lost"] == 0.0 for h in found["horizons"])
    assert "with free functions" in (out / "diagnosis.html").read_text()
    model = load_model(out / WITH_REMAINDER)
    assert isinstance(model, NewtonEulerWithRemainder)
    assert model.named.car == load_model(out / "model").car
    told = load_validity(out / WITH_REMAINDER)
    assert told is not None
    assert told.noise is None
    assert load_seen_takes(out / WITH_REMAINDER) == load_seen_takes(out / "model")
    tables = {t.name: t for t in diagnosis_tables(DiagnosisDocument.read(out / "diagnosis.json"))}
    assert "with free functions" in tables["horizons"].columns
    assert all(len(row) == len(tables["horizons"].columns) for row in tables["horizons"].rows)
