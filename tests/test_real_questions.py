"""Files of questions to real recordings, the jobs that they make, and runs of them that are interrupted or fail."""

from __future__ import annotations

import json
import os
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from cars import CAR
from making import ThreadPool

from bcid.cli.app import main
from bcid.diagnosis.reference_model import ReferenceModel
from bcid.errors import InputRefused, PredictionDiverged, UsageError
from bcid.proof.real import day_model, edited, replication, transfer, withheld
from bcid.proof.real.edited import UneditedDrive
from bcid.proof.real.jobs import Job, list_jobs
from bcid.proof.real.question_files import QuestionInputs, reference_as_row
from bcid.proof.real.questions import RecordedDrive, WithheldQuestion, Withholding, read_questions
from bcid.proof.real.run_questions import run_real_questions
from bcid.proof.real.variations import AS_ASKED, PARTS, STARTS
from bcid.proof.rows import read_rows
from bcid.simulation.car import Plant, Sensor
from bcid.simulation.samples import VEHICLE, write_sample_take
from bcid.simulation.samples import SampleTake as Order
from bcid.vehicle import read_vehicle

SYMBOLS = ("F_m_max", "K_t", "K_b", "I_z", "C_f", "C_r", "F_f_max", "F_r_max", "R_1", "R_2")
PARAMETERS = "\n".join(f"{s} = {getattr(CAR, s)}" for s in SYMBOLS)
SIMULATION = f"relative_sd = 0.02\n[parameters]\n{PARAMETERS}\n[effects.steering_drag]\nk = 60.0"
DRIVES = """vehicle = "vehicle.toml"
simulation = "simulation.toml"
[[drives]]
recording = "one.csv"
day = "monday"
edited = true
[[drives]]
recording = "two.csv"
day = "monday"
[withheld]
"drag of the steered wheel" = { effects = ["steering_drag"] }
[edits]
steering_offset = 0.02
[[pairs]]
fit = "one.csv"
test = "two.csv"
"""
REFERENCE = reference_as_row(ReferenceModel(CAR, {}, 0.02))


@pytest.fixture(scope="module")
def asked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A file of questions about two simulated takes with drag of the steered wheel, and all that it names."""
    folder = tmp_path_factory.mktemp("asked")
    for seed, name in ((5, "one"), (6, "two")):
        write_sample_take(folder, Order(name, "motive", 60.0), Plant(steering_drag=60.0), Sensor(), seed)
    for name, text in {"vehicle": VEHICLE, "simulation": SIMULATION, "cases": DRIVES}.items():
        (folder / f"{name}.toml").write_text(text, encoding="utf-8")
    return folder


@pytest.fixture
def copied(asked: Path, tmp_path: Path) -> Path:
    """A copy of those files that a test may change."""
    for file in (f for f in asked.iterdir() if f.is_file()):
        (tmp_path / file.name).write_bytes(file.read_bytes())
    return tmp_path


def said(*names: str, **more: Any) -> dict[str, Any]:
    """The row of a diagnosis that names these effects."""
    findings = [{"effect": e, "kind": "vehicle", "twins": [], "values": {}} for e in names]
    row = {"verdict": "named" if names else "nothing-found", "findings": findings, "corrections": [], "gate": 14.0}
    return {**row, "worth": 100.0, "equivalents": {}, "ratios": {"v_x": 2.0, "yaw_rate": 1.0}, **more}


@pytest.fixture
def answers(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Stand-ins for all that fits; what they were asked, in order.  Names of drives and questions are true answers."""
    done = list[str]()

    def answering(kind: str, row: Any) -> Any:
        def answer(*given: Any) -> dict[str, Any]:
            done.append(kind)
            return row(*given) if callable(row) else row

        return answer

    unedited = UneditedDrive(ReferenceModel(CAR, {}, 0.02), {"steering_offset": {"o": (0.0, 0.001)}}).as_row()
    offset = {"effect": "steering_offset", "kind": "vehicle", "twins": [], "values": {"o": [0.02, 0.001]}}
    errors = {"augmented": {"median_m": 0.1}, "base": {"median_m": 0.2}}
    for module, name, row in (
        (day_model, "diagnose_drive", said(model=REFERENCE, base=REFERENCE)),
        (day_model, "calibrate_simulation", {"simulation": REFERENCE, "fellows": [], "added": []}),
        (withheld, "answer_whole_question", said()),
        (withheld, "answer_withheld_question", lambda question, *_: said(*question.withholding.effects)),
        (edited, "diagnose_unedited_drive", unedited),
        (edited, "answer_edited_question", {**said(), "findings": [offset], "before": {"o": [0.0, 0.001]}}),
        (transfer, "predict_other_drive", {"findings": [], "errors": errors}),
        (
            replication,
            "compare_drives",
            {"findings": [], "named": [0, 0], "only": {"first": [], "second": []}, "sizes": []},
        ),
    ):
        monkeypatch.setattr(module, name, answering(name, row))
    monkeypatch.setattr("bcid.execution.jobs.make_pool", ThreadPool)  # shares the stand-ins
    return done


EACH = {
    "calibrate_simulation": 2, "answer_whole_question": 2, "answer_withheld_question": 10, "answer_edited_question": 3,
    "diagnose_unedited_drive": 3, "predict_other_drive": 1, "compare_drives": 1, "diagnose_drive": 4,
}  # fmt: skip
"""How often each is asked for two drives of a day: each published and freely; as asked, two starts, two parts."""


@pytest.mark.parametrize("workers", [1, 3])
def test_all_questions_are_answered_once_and_kept(
    workers: int, asked: Path, tmp_path: Path, answers: list[str]
) -> None:
    files, told = [asked / "cases.toml"], list[tuple[str, float]]()
    rows = run_real_questions(files, asked, tmp_path, workers, announce=lambda *done: told.append(done))
    assert Counter(answers) == EACH
    assert Counter(row["tier"] for row in rows) == {
        "withheld": 2, "control": 2, "edited": 1, "replication": 1, "transfer": 1, "start": 4, "part": 6,
    }  # fmt: skip
    assert all(row["right"] for row in rows)
    assert [share for _, share in told][-1] == 1.0
    again = run_real_questions(files, asked, tmp_path, workers)
    assert again == json.loads(json.dumps(rows))
    assert Counter(answers) == EACH


def test_some_are_asked_with_what_they_need_and_the_rest_later(asked: Path, tmp_path: Path, answers: list[str]) -> None:
    files, only = [asked / "cases.toml"], ["WithheldQuestion/one.csv/drag of the steered wheel/as asked"]
    rows = run_real_questions(files, asked, tmp_path, only=only)
    assert [(row["tier"], row["recording"]) for row in rows] == [("withheld", "one.csv"), ("control", "one.csv")]
    # the other drive of that day, on which the simulation is calibrated
    assert Counter(answers) == {
        "diagnose_drive": 1, "calibrate_simulation": 1, "answer_whole_question": 1, "answer_withheld_question": 1,
    }  # fmt: skip
    run_real_questions(files, asked, tmp_path)
    assert Counter(answers) == EACH
    with pytest.raises(UsageError, match="no question has that"):
        run_real_questions(files, asked, tmp_path, only=["tuesday"])


@pytest.mark.parametrize("workers", [1, 3])
def test_a_question_without_an_answer_is_not_asked_in_other_ways(
    workers: int, asked: Path, tmp_path: Path, answers: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    # the gate of these answers is 14 nats
    monkeypatch.setattr(withheld, "answer_withheld_question", lambda *_: said(worth=13.0))
    rows = run_real_questions([asked / "cases.toml"], asked, tmp_path, workers)
    assert Counter(row["tier"] for row in rows) == {
        "control": 4, "edited": 1, "replication": 1, "transfer": 1, "part": 2,
    }  # fmt: skip


def test_a_question_that_ends_in_an_error_is_told_and_asked_again(
    asked: Path, tmp_path: Path, answers: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """And takes no other with it, but those that are made of it: each takes minutes."""

    def failing(*_: Any) -> dict[str, Any]:
        raise PredictionDiverged("left the numbers")

    with monkeypatch.context() as patched:
        patched.setattr(edited, "diagnose_unedited_drive", failing)
        patched.setattr(withheld, "answer_whole_question", failing)
        rows = run_real_questions([asked / "cases.toml"], asked, tmp_path, 3)
    wrong = {row["tier"] for row in rows if not row["right"]}
    assert wrong == {"control", "edited", "part"}
    assert all("left the numbers" in row["error"] for row in rows if row["tier"] in ("control", "edited"))
    assert all(row["right"] for row in rows if row["tier"] in ("withheld", "transfer", "start"))
    rows = run_real_questions([asked / "cases.toml"], asked, tmp_path, 3)
    assert all(row["right"] for row in rows)
    assert Counter(answers) == EACH


@pytest.mark.parametrize(
    ("file", "change", "asked_anew"),
    [
        ("cases.toml", ("edited = true\n", "edited = true\nvehicle.body.mass_kg = 320.0\n"), "all of one.csv"),
        ("cases.toml", ("drag of the steered wheel", "drag"), "nothing"),
        ("cases.toml", ("steering_offset = 0.02", "steering_offset = 0.03"), "edits"),
        ("vehicle.toml", ("max_angle_rad = 2.012", "max_angle_rad = 2.0"), "all"),
        ("simulation.toml", ("k = 60.0", "k = 50.0"), "all"),
        ("two.commands.csv", ("0.1", "0.2"), "all that two.csv is part of"),
    ],
)
def test_an_answer_is_kept_as_long_as_nothing_that_it_depends_on_changes(
    file: str, change: tuple[str, str], asked_anew: str, copied: Path
) -> None:
    before = {job.key: job for job in list_jobs(copied / "cases.toml", copied)}
    text = (copied / file).read_text(encoding="utf-8")
    assert change[0] in text
    (copied / file).write_text(text.replace(*change), encoding="utf-8")
    new = [job for job in list_jobs(copied / "cases.toml", copied) if job.key not in before]

    def needs_all(job: Job) -> bool:
        return job.case not in ("unedited", "freely", "published")

    if asked_anew == "nothing":
        assert new == []
    elif asked_anew == "all":
        assert len(new) == len(before)
    elif asked_anew == "edits":
        # what the unedited drive shows of an effect does not depend on the edit's size
        assert {job.case for job in new} == {"steering_offset 0.03"}
    elif asked_anew == "all of one.csv":
        # the day's simulation of two.csv comes of one.csv
        assert not any(job.case in ("freely", "published") and job.recording == "two.csv" for job in new)
        assert len([j for j in new if needs_all(j)]) == len([j for j in before.values() if needs_all(j)])
    else:
        assert not any(job.case in ("unedited", "steering_offset 0.02") for job in new)
        assert any(job.case == "drag of the steered wheel" and job.recording == "one.csv" for job in new)


def test_each_job_comes_after_those_that_it_needs(asked: Path) -> None:
    listed = set[str]()
    jobs = list_jobs(asked / "cases.toml", asked)
    for job in jobs:
        assert {*job.priors, *job.beside} <= listed, job.label
        assert job.key not in listed
        listed.add(job.key)
    assert {job.variation for job in jobs if isinstance(job.question, WithheldQuestion)} == {AS_ASKED, *STARTS, *PARTS}


def test_a_drive_whose_tracking_fails_is_asked_for_nothing_else_and_shows_no_day(copied: Path) -> None:
    text = DRIVES.replace('recording = "two.csv"\n', 'recording = "two.csv"\ntracking_fails = true\n')
    (copied / "cases.toml").write_text(text.partition("[[pairs]]")[0], encoding="utf-8")
    jobs = list_jobs(copied / "cases.toml", copied)
    assert [j.case for j in jobs if j.recording == "two.csv"] == ["day", "nothing withheld"]
    assert not any(j.case == "replication" or (j.case, j.recording) == ("published", "two.csv") for j in jobs)
    # but its own simulation is the day's
    assert any((j.case, j.recording) == ("published", "one.csv") for j in jobs)
    text = text.replace("tracking_fails", "predicted_only")
    (copied / "cases.toml").write_text(text, encoding="utf-8")
    jobs = list_jobs(copied / "cases.toml", copied)
    assert [j.case for j in jobs if "two.csv" in j.recording] == ["transfer"]


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (('effects = ["steering_drag"]', 'effects = ["steering_dragg"]'), "no effect steering_dragg"),
        (('effects = ["steering_drag"]', 'effects = ["motor_lag"]'), "the simulation has no 'motor_lag'"),
        (('effects = ["steering_drag"]', "effects = []"), "at least 1"),
        (('["steering_drag"] }', '["steering_drag"], parameters = { F_fmax = 9.0 } }'), "changes parameters F_fmax"),
        (('["steering_drag"] }', '["steering_drag"], parameters = { K_t = -9.0 } }'), "changes parameters K_t"),
        (('["steering_drag"] }', '["steering_drag"], vehicle = { body = { mass = 1.0 } } }'), "unknown key body.mass"),
        (('["steering_drag"] }', '["steering_drag"], sizes = { motor_lag = { tau = 1.0 } } }'), "effect motor_lag"),
        (("steering_offset = 0.02", "yaw_scrub = 0.02"), "no such edit"),
        (("edited = true", 'known = ["motor_lag"]'), "only where the tracking fails"),
        (("edited = true", 'tracking_fails = true\nknown = ["motor_lagg"]'), "no effect motor_lagg"),
        (("edited = true", "vehicle.body.mass = 1.0"), "unknown key body.mass"),
        (('recording = "two.csv"', 'recording = "one.csv"'), "stands there twice"),
        (('test = "two.csv"', 'test = "three.csv"'), "not two of the drives"),
        (('test = "two.csv"', 'test = "one.csv"'), "not two of the drives"),
        (('"simulation.toml"', '"not_there.toml"'), "not_there.toml"),
    ],
)  # fmt: skip
def test_a_question_that_asks_nothing_is_refused(change: tuple[str, str], says: str, copied: Path) -> None:
    assert change[0] in DRIVES
    (copied / "cases.toml").write_text(DRIVES.replace(*change), encoding="utf-8")
    with pytest.raises(InputRefused, match=says):
        list_jobs(copied / "cases.toml", copied)


@pytest.mark.parametrize("text", ["effects = 3", "[parameters", "parameters = {}\nno_such = 1"])
def test_questions_beside_a_simulation_that_is_none_are_refused(text: str, copied: Path) -> None:
    (copied / "simulation.toml").write_text(text, encoding="utf-8")
    with pytest.raises(InputRefused, match=r"simulation\.toml"):
        list_jobs(copied / "cases.toml", copied)


def test_a_recording_s_own_tables_lie_under_what_is_withheld(copied: Path) -> None:
    usual = read_vehicle(copied / "vehicle.toml")
    own = RecordedDrive(recording="one.csv", vehicle={"body": {"mass_kg": 20.0}, "steering": {"time_constant_s": 0.3}})
    inputs = QuestionInputs(usual, {"one.csv": own}, None, copied)
    assert inputs.vehicle_for("another.csv") == usual
    assert inputs.vehicle_for("one.csv").body.mass_kg == 20.0
    less = inputs.vehicle_for("one.csv", {"steering": {"time_constant_s": 0.05}})
    assert (less.body.mass_kg, less.steering.time_constant_s) == (20.0, 0.05)
    assert less.body.cog_to_front_m == usual.body.cog_to_front_m


def test_what_is_withheld_goes_from_the_day_s_simulation_and_its_servo_is_the_vehicle_file_s(
    copied: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The diagnosis sees the day's figures, without the effects, with the lag that the question's tables say."""
    seen = list[ReferenceModel]()

    def diagnosed(recordings: Any, estimates: Any, vehicle: Any, reference: ReferenceModel) -> Any:
        seen.append(reference)
        raise PredictionDiverged

    monkeypatch.setattr(withheld, "diagnose_recordings", diagnosed)
    day = ReferenceModel(CAR._replace(K_t=200.0), {"steering_drag__k": 50.0, "motor_lag__tau": 0.1}, 0.02)
    inputs = QuestionInputs(read_vehicle(copied / "vehicle.toml"), {}, copied / "simulation.toml", copied)
    lag = Withholding(
        effects=["steering_lag", "steering_drag"], parameters={"C_f": 9e3},
        vehicle={"steering": {"time_constant_s": 0.1}}, sizes={"steering_lag": {"tau": 0.05}},
    )  # fmt: skip
    for variation in (AS_ASKED, STARTS[1]):
        with pytest.raises(PredictionDiverged):
            withheld.answer_withheld_question(
                WithheldQuestion("one.csv", "lag", lag), variation, inputs, {"simulation": reference_as_row(day)}
            )  # fmt: skip
    asked, varied = seen
    assert (asked.car.K_t, asked.car.T_s, asked.car.C_f) == (200.0, 0.1, 9e3)
    assert asked.effects == {"motor_lag__tau": 0.1}
    assert (varied.car, varied.begin["K_t"]) == (asked.car, 1.0 / 1.3)


def test_the_command_writes_the_figures_and_ends_with_5_where_a_goal_is_missed(
    asked: Path, tmp_path: Path, answers: list[str], monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    words = ["bcid", "prove", "--out", str(tmp_path), "--workers", "1"]
    words += ["--real", str(asked / "cases.toml"), "--recordings", str(asked), "--only", "one.csv"]
    monkeypatch.setattr("sys.argv", words)
    with pytest.raises(SystemExit) as ended:
        main()
    told = capsys.readouterr()
    assert ended.value.code == 5
    assert "withheld: questions with an answer" in told.err  # one, of twenty that are wanted
    assert "withheld: right" not in told.err
    document = json.loads((tmp_path / "real.json").read_text(encoding="utf-8"))
    assert document["schema"] == "bcid.prove-real/2"
    figures = {f["figure"]: (f["hits"], f["n"]) for f in document["figures"]}
    assert figures["withheld: right"] == (1, 1)
    assert figures["another start: other answer"] == (0, 2)
    assert "drag of the steered wheel" in " ".join(told.out.split())
    assert len(read_rows(tmp_path)) == len(set(read_rows(tmp_path)))


def test_only_goes_with_questions_to_real_recordings(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.argv", ["bcid", "prove", "--out", str(tmp_path), "--quick", "--only", "drag"])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    assert "--only goes with --real" in capsys.readouterr().err


PIPELINES = Path(__file__).parents[1] / "pipelines"


def test_the_questions_that_the_project_asks_are_questions() -> None:
    files = [f for f in sorted(PIPELINES.glob("*/*.toml")) if "[[drives]]" in f.read_text(encoding="utf-8")]
    assert len(files) >= 3
    asked, edited_vehicles, edited_drives = 0, set[str](), 0
    for file in files:
        cases = read_questions(file)
        drives = {drive.recording: drive for drive in cases.drives}
        QuestionInputs(read_vehicle(cases.vehicle), drives, cases.simulation, Path()).check_vehicles(cases, file)
        asked += sum(drive.shows_the_car for drive in cases.drives) * len(cases.withheld)
        edited_drives += sum(drive.edited for drive in cases.drives)
        edited_vehicles |= {file.parent.name for drive in cases.drives if drive.edited}
    # some of which have no answer
    assert asked >= 40
    assert edited_drives >= 3
    assert len(edited_vehicles) >= 2


def test_the_drives_that_the_project_asks_are_there(recordings_folder: Path) -> None:
    named = {
        d.recording
        for f in PIPELINES.glob("*/*.toml")
        if "[[drives]]" in f.read_text()
        for d in read_questions(f).drives
    }
    assert all((recordings_folder / name).is_file() for name in named)


@pytest.mark.proof
def test_what_a_day_s_simulation_is_denied_is_named_and_nothing_else(asked: Path, tmp_path: Path) -> None:
    only = ["one.csv/drag of the steered wheel/as asked", "one.csv/steering_offset 0.02/as asked", "→"]
    rows = run_real_questions([asked / "cases.toml"], asked, tmp_path, os.cpu_count() or 1, only)
    told = {row["tier"]: row for row in rows}
    assert all(told[tier]["right"] for tier in ("withheld", "control", "edited", "transfer"))
    assert told["withheld"]["worth"] > told["withheld"]["gate"]
    assert told["withheld"]["true"]["steering_drag__k"][0] == pytest.approx(60.0, rel=0.1)
    assert [f["effect"] for f in told["withheld"]["findings"]] == ["steering_drag"]
    assert told["edited"]["value"] == pytest.approx(0.02, rel=0.1)
    assert told["transfer"]["errors"]["augmented"]["median_m"] < told["transfer"]["errors"]["base"]["median_m"]


@pytest.mark.proof
def test_a_real_dead_zone_is_told(recordings_folder: Path, tmp_path: Path) -> None:
    """The DART's simulation, as the other drive of that day shows it, without its motor's dead zone (0.164)."""
    only = ["10_01_01.csv/motor dead zone/as asked"]
    rows = run_real_questions([PIPELINES / "dart" / "cases.toml"], recordings_folder, tmp_path, only=only)
    (row,) = (row for row in rows if row["case"] == "motor dead zone")
    assert row["tier"] == "withheld"
    assert row["ratio"] > 1.3
    found = {f["effect"]: f for f in row["findings"]}
    assert found["motor_dead_zone"]["values"]["width"][0] == pytest.approx(0.164, abs=0.02)
