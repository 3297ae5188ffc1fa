"""Takes cut by time, wherever a recording is named, and what was read as tables for other programs."""

from __future__ import annotations

import csv
import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from making import circling_take
from typer.testing import CliRunner

from bcid.cli.app import app
from bcid.errors import InputRefused, UsageError
from bcid.pipeline.config import PipelineConfig
from bcid.pipeline.origin import trace_origin
from bcid.pipeline.run import Pipeline
from bcid.pipeline.take_stages import TakeStages
from bcid.pipeline.takes import name_takes
from bcid.recording.cuts import COMMAND_MARGIN_S, cut_raw_take, read_cut_recording, split_cut
from bcid.recording.formats import csv_plain, mcap_contents
from bcid.recording.formats.detect import find_commands_file
from bcid.recording.formats.raw import TimeCut
from bcid.recording.read import read_raw_take, read_recording
from bcid.recording.saving import load_recording
from bcid.recording.types import Recording
from bcid.vehicle import Vehicle, read_vehicle


def test_a_cut_stands_behind_the_name_of_a_file(tmp_path: Path) -> None:
    cuts = {
        "[12:40]": (12.0, 40.0), "[12.5:40.25]": (12.5, 40.25), "[:40]": (0.0, 40.0), "[12:]": (12.0, math.inf),
        "[:]": (0.0, math.inf), "[.5:1.]": (0.5, 1.0),
    }  # fmt: skip
    for text, (begin, end) in cuts.items():
        assert split_cut(tmp_path / f"t.csv{text}") == (tmp_path / "t.csv", TimeCut(begin, end))
    assert split_cut(tmp_path / "t.csv") == (tmp_path / "t.csv", None)
    # a file that is really called so is not cut
    (tmp_path / "t.csv[1:2]").write_text("", encoding="utf-8")
    assert split_cut(tmp_path / "t.csv[1:2]") == (tmp_path / "t.csv[1:2]", None)


@pytest.mark.parametrize("text", ["[12-40]", "[40:12]", "[5:5]", "[a:b]", "[-1:4]", "[1:2:3]", "[nan:1]", "[1e400:]"])
def test_what_is_no_cut_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "t.csv").write_text("", encoding="utf-8")
    with pytest.raises(InputRefused, match=r"\[BEGIN:END\]"):
        split_cut(tmp_path / f"t.csv{text}")


def test_of_a_file_that_is_not_there_whoever_opens_it_says_so(tmp_path: Path) -> None:
    for name in ("u.csv[12-40]", "u.csv[a:b]"):
        assert split_cut(tmp_path / name) == (tmp_path / name, None)
    assert split_cut(tmp_path / "u.csv[1:2]") == (tmp_path / "u.csv", TimeCut(1.0, 2.0))


def test_parts_of_one_take_have_names_of_their_own() -> None:
    named = ["a/drive.csv[0:60]", "a/drive.csv[60:]", "b/drive.csv[0:60]", "bag[1.5:2]", "other.csv[2:3.5]"]
    names = [n.replace("\\", "/") for n in name_takes([Path(n) for n in named]).values()]
    assert names == ["a/drive[0:60]", "drive[60:]", "b/drive[0:60]", "bag[1.5:2]", "other[2:3.5]"]


@pytest.mark.parametrize("kind", ["motive", "mcap"])
def test_a_cut_holds_the_samples_of_the_whole_take_in_it(
    takes: dict[str, Path], vehicle: Vehicle, recording: Recording, kind: str
) -> None:
    path = takes[kind]
    whole = read_recording(path, vehicle)
    zero = float(read_raw_take(path, vehicle, find_commands_file(path, None)).pose_time_s[0])
    part = read_cut_recording(path, vehicle, find_commands_file(path, None), False, TimeCut(12.0, 40.0))
    times = whole.poses.time_s - zero
    inside = (times >= 12.0) & (times <= 40.0)
    assert np.array_equal(part.poses.time_s, whole.poses.time_s[inside])
    assert part.poses.values[:, :2] == pytest.approx(whole.poses.values[inside, :2], abs=1e-12)
    # the command that holds when the cut begins is there
    at = np.array([part.poses.time_s[0]])
    assert np.array_equal(part.commands.held_at(at), whole.commands.held_at(at))
    assert part.commands.time_s[-1] <= zero + 40.0 + COMMAND_MARGIN_S
    assert recording.name == "drive"


def test_faults_outside_a_cut_do_not_matter(tmp_path: Path, vehicle_file: Path) -> None:
    """Of a take whose poses turn into nonsense after 40 s, the first 30 s are read as those of a sound one."""
    path, car = circling_take(tmp_path, "half", 60.0), read_vehicle(vehicle_file)
    sound = read_cut_recording(path, car, find_commands_file(path, None), False, TimeCut(0.0, 30.0))
    lines = path.read_text(encoding="utf-8").splitlines()
    rows = next(i for i, line in enumerate(lines) if line.startswith("Frame")) + 1
    spoiled = [
        line if i < rows + 40 * 60 else ",".join([*line.split(",")[:2], *["1e9"] * (len(line.split(",")) - 2)])
        for i, line in enumerate(lines)
    ]
    path.write_text("\n".join([*spoiled, ""]), encoding="utf-8")
    commands = find_commands_file(path, None)
    whole = read_cut_recording(path, car, commands, False, None)
    part = read_cut_recording(path, car, commands, False, TimeCut(0.0, 30.0))
    # nothing of it is noted, not even by the reader
    kinds = [{odd.kind for odd in recording.irregularities} for recording in (whole, part)]
    assert kinds[0] - kinds[1] == {"lost pose", "marker error", "pose dropout", "pose end"}
    assert np.array_equal(part.poses.values, sound.poses.values)
    assert part.duration_s == pytest.approx(30.0, abs=0.1)


def test_of_a_motive_export_a_cut_reads_only_its_part(takes: dict[str, Path], vehicle: Vehicle) -> None:
    path, cut = takes["motive"], TimeCut(12.0, 40.0)
    commands = find_commands_file(path, None)
    whole, part = (read_raw_take(path, vehicle, commands, cut=c) for c in (None, cut))
    assert part.first_pose_s == whole.pose_time_s[0]
    assert len(part.pose_time_s) < 0.6 * len(whole.pose_time_s)
    assert part.pose_time_s[0] == pytest.approx(whole.pose_time_s[0] + 11.0, abs=0.1)
    one, other = (cut_raw_take(take, cut) for take in (whole, part))
    assert one.pose_time_s.tobytes() == other.pose_time_s.tobytes()
    assert one.pose.tobytes() == other.pose.tobytes()
    assert one.command.tobytes() == other.command.tobytes()


def test_a_motive_export_with_too_many_rows_is_read_in_parts(
    takes: dict[str, Path], vehicle: Vehicle, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, cut = takes["motive"], TimeCut(12.0, 40.0)
    commands = find_commands_file(path, None)
    whole = cut_raw_take(read_raw_take(path, vehicle, commands), cut)
    monkeypatch.setattr(csv_plain, "LIMITS", replace(csv_plain.LIMITS, max_rows=2500))
    with pytest.raises(InputRefused, match=r"more rows than 2500.*\n.*\[0:3600\]"):
        read_raw_take(path, vehicle, commands)
    part = cut_raw_take(read_raw_take(path, vehicle, commands, cut=cut), cut)
    assert part.pose.tobytes() == whole.pose.tobytes()


def test_an_mcap_file_with_too_many_messages_is_read_in_parts(
    takes: dict[str, Path], vehicle: Vehicle, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, cut = takes["mcap"], TimeCut(12.0, 20.0)
    whole = cut_raw_take(read_raw_take(path, vehicle), cut)
    monkeypatch.setattr(mcap_contents, "MCAP", replace(mcap_contents.MCAP, max_messages=2000))
    with pytest.raises(InputRefused, match=r"more than 2000 messages.*\n.*\[0:3600\]"):
        read_raw_take(path, vehicle)
    read = read_raw_take(path, vehicle, cut=cut)
    assert len(read.pose_time_s) < 2000
    part = cut_raw_take(read, cut)
    assert part.pose_time_s.tobytes() == whole.pose_time_s.tobytes()
    assert part.pose.tobytes() == whole.pose.tobytes()
    at = np.arange(cut.begin_s, cut.end_s, 0.01) + whole.pose_time_s[0] - cut.begin_s
    held = [t.command[np.searchsorted(t.command_time_s, at, side="right") - 1] for t in (whole, part)]
    assert held[0].tobytes() == held[1].tobytes()
    with pytest.raises(InputRefused, match=r"between 900 and 950 s: the take lasts (60\.0|59\.\d) s"):
        read_raw_take(path, vehicle, cut=TimeCut(900.0, 950.0))


def test_a_cut_beyond_the_take_is_refused(takes: dict[str, Path], vehicle: Vehicle) -> None:
    raw = read_raw_take(takes["mcap"], vehicle)
    with pytest.raises(InputRefused, match=r"between 90 and 95 s: the take lasts (60\.0|59\.\d) s"):
        cut_raw_take(raw, TimeCut(90.0, 95.0))


def test_two_parts_of_a_take_train_and_validate_but_not_if_they_overlap(
    takes: dict[str, Path], vehicle_file: Path, tmp_path: Path
) -> None:
    def work(training: str, validation: str) -> Pipeline:
        paths = [Path(f"{takes['motive']}{cut}") for cut in (training, validation)]
        config = PipelineConfig(source="x", vehicle=vehicle_file, training=paths[:1], validation=paths[1])
        config = config.model_copy(update={"workspace": tmp_path / "w", "truth": takes["motive"].parent / "truth"})
        return Pipeline(config)

    apart = work("[:40]", "[40:]")
    score = apart.score(apart.fit_for_comparison("newton-euler-linear"))
    assert score.nmse is not None
    assert score.nmse > 0.0
    lengths = [load_recording(apart.ingest(p).folder).duration_s for p in apart.config.recordings()]
    assert lengths == pytest.approx([40.0, 20.0], abs=0.1)
    assert apart.validation_name() == "drive[40:]"
    # the truth of the whole take is that of its parts
    assert all(apart.check(p) for p in apart.config.recordings())
    overlapping = work("[:40]", "[20:]")
    with pytest.raises(InputRefused, match="the same drive"):
        overlapping.score(overlapping.fit_for_comparison("newton-euler-linear"))


def test_commands_take_parts_of_takes(takes: dict[str, Path], vehicle_file: Path, tmp_path: Path) -> None:
    where = ["--vehicle", str(vehicle_file), "--out", str(tmp_path / "w")]
    for words in (["ingest"], ["estimate"], ["fit", "--model", "newton-euler-linear"]):
        done = CliRunner().invoke(app, [*words, f"{takes['motive']}[10:50]", *where], catch_exceptions=False)
        assert done.exit_code == 0, done.stderr
    checked = CliRunner().invoke(
        app, ["ingest", "--check", f"{takes['mcap']}[10:50]", "--vehicle", str(vehicle_file)], catch_exceptions=False
    )
    assert "go: " in checked.stdout


def test_a_part_of_a_take_was_recorded_when_the_take_was(takes: dict[str, Path], vehicle_file: Path) -> None:
    asked = SimpleNamespace(
        runner=SimpleNamespace(
            config=SimpleNamespace(vehicle=vehicle_file, command="bcid"), vehicle=SimpleNamespace(name="car")
        ),
        ingest=lambda path: SimpleNamespace(folder=path), title=lambda path: path.name,
    )  # fmt: skip
    whole = takes["motive"]
    origin = trace_origin(cast(TakeStages, asked), [Path(f"{whole}[1:5]"), whole])
    assert origin.recordings[0].recorded == origin.recordings[1].recorded is not None


def test_what_was_read_is_written_as_tables(takes: dict[str, Path], vehicle_file: Path, tmp_path: Path) -> None:
    import pyarrow.parquet as pq

    named = [str(takes["motive"]), f"{takes['mcap']}[5:20]"]
    where = ["--vehicle", str(vehicle_file), "--out", str(tmp_path / "w")]
    for ending, words in ((".csv", named), (".parquet", named[:1])):
        line = ["ingest", *words, *where, "--table", str(tmp_path / f"t{ending}")]
        assert CliRunner().invoke(app, line, catch_exceptions=False).exit_code == 0
        with pytest.raises(InputRefused, match="exists already"):
            CliRunner().invoke(app, line, catch_exceptions=False)
    vehicle = read_vehicle(vehicle_file)
    read = read_recording(takes["motive"], vehicle)
    poses, commands = (pq.read_table(tmp_path / name) for name in ("t.parquet", "t.commands.parquet"))
    assert poses.column_names == ["time_s", "x_m", "y_m", "yaw_rad"]
    assert commands.column_names == ["time_s", "steering_rad", "throttle_mps"]
    assert np.array_equal(np.column_stack([poses[c] for c in poses.column_names[1:]]), read.poses.values)
    assert np.array_equal(commands["throttle_mps"].to_numpy(), read.commands.values[:, 1])
    with (tmp_path / "t.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [r["take"] for r in rows[:: len(rows) - 1]] == ["drive", "drive_m[5:20]"]
    of_first = [[float(r[c]) for c in ("time_s", "x_m", "y_m", "yaw_rad")] for r in rows if r["take"] == "drive"]
    # every digit
    assert np.array_equal(np.array(of_first), np.column_stack([read.poses.time_s, read.poses.values]))


def test_a_table_of_no_known_kind_is_refused_before_anything_is_read(tmp_path: Path) -> None:
    words = ["ingest", "none.csv", "--vehicle", "none.toml", "--out", str(tmp_path)]
    with pytest.raises(UsageError, match=r"a \.csv, a \.parquet or a folder"):
        CliRunner().invoke(app, [*words, "--table", "t.xlsx"], catch_exceptions=False)
    with pytest.raises(UsageError, match="--check writes nothing"):
        CliRunner().invoke(app, [*words[:-2], "--check", "--table", "t.csv"], catch_exceptions=False)
