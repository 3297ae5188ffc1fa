"""A view is read back as it was meant: by mcap's reader with checksums, by its own schemas, and by bcid itself."""

from __future__ import annotations

import itertools
import json
import shutil
from dataclasses import replace
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from making import circling_take
from mcap.reader import make_reader
from mcap.stream_reader import CRCValidationError, StreamReader
from typer.testing import CliRunner
from viewed import WORST_S, made_workspace, read_view, stamp_ns
from zstandard import ZstdError

from bcid.cli.app import app
from bcid.errors import InputRefused
from bcid.estimate.types import Estimate
from bcid.evaluation.closed_loop import RestartedPrediction
from bcid.files.outputs import refuse_to_overwrite
from bcid.likelihood.take import KNOT_S
from bcid.recording.read import read_recording
from bcid.recording.types import Recording, Stream
from bcid.vehicle import Vehicle, read_vehicle
from bcid.view.content import ViewContent, earliest_zero_ns
from bcid.view.from_take import view_of_take
from bcid.view.from_workspace import find_diagnosis, view_of_workspace
from bcid.view.messages import PRIMITIVES
from bcid.view.schemas import SCHEMAS
from bcid.view.write_view import view_files, write_view


@pytest.fixture(scope="module")
def content(recording: Recording, estimates: list[Estimate], vehicle: Vehicle) -> ViewContent:
    """A take and its motion, with a prediction that diverges in its second window."""
    e = estimates[0]
    start = np.arange(len(e)) % 20 == 0
    pose, twist = e.pose.copy(), e.twist.copy()
    pose[21:40], twist[21:40] = np.nan, np.nan
    return ViewContent(recording, e, vehicle, predictions={"predicted": RestartedPrediction(pose, twist, start)})


@pytest.fixture(scope="module")
def view(content: ViewContent, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("view") / "drive.mcap"
    write_view(content, path, lambda there: False)
    return path


@pytest.fixture(scope="module")
def workspace(
    recording: Recording, estimates: list[Estimate], vehicle: Vehicle, takes: dict[str, Path],
    tmp_path_factory: pytest.TempPathFactory,
) -> Path:  # fmt: skip
    other = read_recording(takes["other"], vehicle)
    return made_workspace(tmp_path_factory.mktemp("workspace"), [recording, other], estimates, vehicle)


def bcid(*words: str | Path, code: int = 0) -> str:
    """What a command prints, which must end with `code`."""
    result = CliRunner().invoke(app, list(map(str, words)), standalone_mode=False)
    refusal = result.exception
    assert (getattr(refusal, "exit_code", 1) if refusal else result.exit_code) == code, result.output
    return f"{result.output}{refusal or ''}"


def test_every_message_is_what_the_schema_in_the_file_says(view: Path) -> None:
    with view.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary
    schemas = {s.name: json.loads(s.data) for s in summary.schemas.values()}
    assert set(schemas) <= set(SCHEMAS)
    checks = {name: jsonschema.Draft202012Validator(schema) for name, schema in schemas.items()}
    for name, schema in SCHEMAS.items():
        jsonschema.Draft202012Validator.check_schema(schema)
        assert schema["title"] == name
    for topic, messages in read_view(view).items():
        # the first messages and the last: a topic's are made alike
        for read in [*messages[:20], *messages[-20:]]:
            checks[read.schema].validate(read.message)
            assert read.log_ns == read.publish_ns == stamp_ns(read.message) if "timestamp" in read.message else topic


def test_a_message_that_lacks_or_adds_a_field_is_none_of_its_schema(view: Path) -> None:
    pose = read_view(view)["/bcid/measured/pose"][0].message
    check = jsonschema.Draft202012Validator(SCHEMAS["foxglove.PoseInFrame"])
    assert not list(check.iter_errors(pose))
    assert list(check.iter_errors({**pose, "wings": 2}))
    assert list(check.iter_errors({k: v for k, v in pose.items() if k != "frame_id"}))


def test_entities_have_all_nine_lists_that_viewers_ask_for(view: Path) -> None:
    topics = read_view(view)
    entities = [e for read in topics["/bcid/cars"] + topics["/bcid/floor"] for e in read.message["entities"]]
    assert [e["id"] for e in entities] == ["measured", "predicted", "floor"]
    for entity in entities:
        assert all(isinstance(entity[name], list) for name in (*PRIMITIVES, "metadata"))


def test_the_file_has_indexes_checksums_statistics_metadata_and_attachments(view: Path, content: ViewContent) -> None:
    with view.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        metadata = {m.name: m.metadata for m in reader.iter_metadata()}
        attachments = {a.name: a.data for a in reader.iter_attachments()}
        times = [message.log_time for _, _, message in reader.iter_messages()]
    assert summary
    assert summary.statistics
    assert summary.statistics.message_count == len(times) == sum(map(len, read_view(view).values()))
    assert summary.chunk_indexes
    assert times == sorted(times)
    assert metadata["bcid"]["source 1 sha256"] == content.recording.sources[0].sha256
    assert attachments["view.vehicle.toml"] == view_files(view)[2].read_bytes()


def test_a_flipped_bit_is_noticed(view: Path, tmp_path: Path) -> None:
    def read_every_record(path: Path) -> int:
        with path.open("rb") as file:
            return sum(1 for _ in StreamReader(file, validate_crcs=True).records)

    assert read_every_record(view) > 1000
    with view.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary
    chunk = summary.chunk_indexes[0]
    index = chunk.chunk_start_offset + chunk.chunk_length + 20
    for place in (chunk.chunk_start_offset + chunk.chunk_length // 2, index):
        data = bytearray(view.read_bytes())
        data[place] ^= 1
        (tmp_path / "flipped.mcap").write_bytes(data)
        # within a chunk the decompression may notice it before the checksum does
        with pytest.raises((CRCValidationError, ZstdError)):
            read_every_record(tmp_path / "flipped.mcap")


def test_the_same_take_gives_the_same_bytes(view: Path, content: ViewContent, tmp_path: Path) -> None:
    write_view(content, tmp_path / view.name, lambda there: False)
    for made, again in zip(view_files(view), view_files(tmp_path / view.name), strict=True):
        assert made.read_bytes() == again.read_bytes()


def test_bcid_reads_the_same_take_from_its_view(view: Path, content: ViewContent) -> None:
    vehicle = read_vehicle(view_files(view)[2])
    assert "go" in bcid("ingest", "--check", view, "--vehicle", view_files(view)[2])
    again, first = read_recording(view, vehicle), content.recording
    assert np.allclose(again.poses.time_s, first.poses.time_s - first.poses.time_s[0], atol=1e-9)
    assert np.allclose(again.poses.values[:, :2], first.poses.values[:, :2], atol=1e-6)
    assert np.allclose(np.exp(1j * again.poses.values[:, 2]), np.exp(1j * first.poses.values[:, 2]), atol=1e-6)
    assert np.allclose(again.commands.time_s, first.commands.time_s - first.poses.time_s[0], atol=1e-9)
    assert np.allclose(again.commands.values, first.commands.values, atol=1e-9)


def test_stamps_are_those_of_the_recorded_file(takes: dict[str, Path], vehicle_file: Path, tmp_path: Path) -> None:
    content = view_of_take(takes["mcap"], vehicle_file)
    write_view(content, tmp_path / "view.mcap", lambda there: False)
    recorded, shown = read_view(takes["mcap"]), read_view(tmp_path / "view.mcap")
    poses = {stamp_ns(read.message): read.message for read in recorded["/mocap/bumper_car/pose"]}
    kept = [read for read in shown["/bcid/measured/pose"] if read.log_ns in poses]
    # the few that are not there were put aside by the checks
    assert len(kept) == len(shown["/bcid/measured/pose"]) > 0.99 * len(poses)
    for read in kept[::100]:
        assert read.message["pose"]["position"]["x"] == pytest.approx(
            poses[read.log_ns]["pose"]["position"]["x"], abs=0.5
        )
    commands = {stamp_ns(read.message) for read in recorded["/bumper_car/command"]}
    assert {read.log_ns for read in shown["/bcid/command"]} == commands
    attached = [a for a in content.attachments if a.name == vehicle_file.name]
    assert attached[0].data == vehicle_file.read_bytes()


def test_times_without_a_date_begin_at_zero_or_above(vehicle_file: Path, vehicle: Vehicle, tmp_path: Path) -> None:
    content = view_of_take(circling_take(tmp_path), vehicle_file)
    assert content.zero_ns == 0
    early = replace(
        content.recording, commands=Stream(content.recording.commands.time_s - 2.3, content.recording.commands.values)
    )
    zero = earliest_zero_ns(early)
    assert zero == 3_000_000_000
    write_view(replace(content, recording=early, zero_ns=zero), tmp_path / "early.mcap", lambda there: False)
    assert read_view(tmp_path / "early.mcap")["/bcid/command"][0].log_ns == 700_000_000


def test_what_diverges_is_left_out(view: Path, content: ViewContent) -> None:
    topics = read_view(view)
    n = len(content.estimate)
    assert len(topics["/bcid/measured/twist"]) == n
    assert len(topics["/bcid/predicted/pose"]) == len(topics["/bcid/predicted/twist"]) == n - 19
    paths = topics["/bcid/predicted/path"]
    assert [len(read.message["poses"]) for read in paths[:3]] == [20, 1, 20]
    frames = {read.message["child_frame_id"] for read in topics["/tf"]}
    assert frames == {"car", "car_predicted"}


def test_the_state_is_told_when_it_changes_and_at_the_end(view: Path, content: ViewContent) -> None:
    states = read_view(view)["/bcid/state"]
    told = [{k: v for k, v in read.message.items() if k != "timestamp"} for read in states]
    assert all(a != b for a, b in itertools.pairwise(told[:-1]))
    assert states[-1].log_ns == content.stamp_ns(float(content.estimate.time_s[-1]))
    assert {state["motion"] for state in told} <= {"forward", "backward", "standing"}


def test_a_diagnosis_is_shown_where_and_when_it_matters(workspace: Path, tmp_path: Path) -> None:
    content = view_of_workspace(workspace)
    assert content.diagnosed
    write_view(content, tmp_path / "view.mcap", lambda there: False)
    topics = read_view(tmp_path / "view.mcap")
    told = {read.message["name"]: read for read in topics["/bcid/findings"]}
    assert told["rough_patch"].log_ns == content.stamp_ns(WORST_S)
    assert "b = 30.4 ± 0.2 N s/m" in told["rough_patch"].message["message"]
    assert told["verdict"].log_ns == content.stamp_ns(float(content.recording.poses.time_s[0]))
    (place,) = topics["/bcid/places"][0].message["entities"]
    assert place["cylinders"][0]["size"]["x"] == pytest.approx(2.4)
    assert len(topics["/bcid/before/pose"]) == len(topics["/bcid/after/pose"]) == len(content.estimate)
    inside = {read.message["place"] for read in topics["/bcid/state"]}
    assert inside == {"rough_patch", "elsewhere"}


def test_a_push_is_an_arrow_along_it_from_the_car(workspace: Path, tmp_path: Path) -> None:
    content = view_of_workspace(workspace)
    write_view(content, tmp_path / "view.mcap", lambda there: False)
    pushes = {read.log_ns: read.message for read in read_view(tmp_path / "view.mcap")["/bcid/pushes"]}
    before, after = pushes[content.stamp_ns(WORST_S - 0.5 * KNOT_S)]["entities"]
    assert before["lifetime"] == {"sec": 0, "nsec": round(KNOT_S * 1e9)}
    along, upward = before["arrows"]
    e = content.estimate
    x, y, yaw = (float(np.interp(WORST_S, e.time_s, e.pose[:, c])) for c in range(3))
    assert along["pose"]["position"]["x"] == pytest.approx(x, abs=1e-5)
    assert along["pose"]["position"]["y"] == pytest.approx(y, abs=1e-5)
    lengths = [a["shaft_length"] + a["head_length"] for a in (*before["arrows"], *after["arrows"])]
    # one push stands out by far: it is five times as long as usual ones, and no longer
    assert max(lengths) == pytest.approx(5.0 * 1.5 * content.vehicle.body.wheelbase_m, rel=1e-3)
    turned = 2.0 * np.arctan2(along["pose"]["orientation"]["z"], along["pose"]["orientation"]["w"])
    # a push of -2 m/s² along the car points backward
    assert np.cos(turned - yaw) == pytest.approx(-1.0, abs=1e-6)
    assert upward["pose"]["orientation"]["y"] == pytest.approx(-np.sqrt(0.5))
    length = [a["shaft_length"] + a["head_length"] for a in (along, after["arrows"][0])]
    assert length[0] / length[1] == pytest.approx(2.0 / 0.02, rel=1e-3)


def test_another_take_of_a_diagnosis_has_its_own_pushes(
    workspace: Path, takes: dict[str, Path], vehicle_file: Path
) -> None:
    content = view_of_workspace(workspace, "other")
    assert content.recording.name == "other"
    assert content.diagnosed
    knots, e = content.diagnosed.knots, content.estimate
    aside = np.hypot(*(knots[n] - np.interp(knots["time_s"], e.time_s, e.pose[:, c]) for c, n in enumerate("xy")))
    assert len(aside) > 50
    assert np.median(aside) < 0.05
    by_file = view_of_workspace(workspace, str(takes["other"]), vehicle_file)
    assert by_file.recording.name == "other"
    assert vehicle_file.name in {a.name for a in by_file.attachments}


def test_what_a_workspace_lacks_is_said(workspace: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(workspace, copy)
    shutil.rmtree(find_diagnosis(copy) / "base")
    assert "earlier bcid" in bcid("view", copy, code=4)
    (copy / "diagnosis" / "diagnosis.json").write_text("{}")
    assert "edited" in bcid("view", copy, code=4)
    shutil.rmtree(copy / "diagnosis")
    assert "holds no diagnosis.json" in bcid("view", copy, code=4)
    assert "neither report.json nor diagnosis.json" in bcid("view", copy, "--tables", tmp_path / "t", code=4)
    assert "name one of drive, other" in bcid("view", workspace, "--take", "third", code=2)
    shutil.copytree(workspace, tmp_path / "less")
    shutil.rmtree(tmp_path / "less" / "estimate")
    assert "not in this workspace any more" in bcid("view", tmp_path / "less", code=4)


def test_knots_of_other_places_are_refused(workspace: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("bcid.view.from_workspace.GAP_S", -30.0)
    with pytest.raises(InputRefused, match="none of its stretches was diagnosed"):
        view_of_workspace(workspace, "other")


def test_the_command_writes_three_files_and_none_that_exists(workspace: Path, tmp_path: Path) -> None:
    out = tmp_path / "new" / "drive.mcap"
    told = json.loads(bcid("view", workspace, "--out", out, "--format", "json").partition("layout for")[0])
    assert told["schema"] == "bcid.view/1"
    assert {p.name for p in out.parent.iterdir()} == {"drive.mcap", "drive.layout.json", "drive.vehicle.toml"}
    assert told["topics"]["/bcid/pushes"]["type"] == "foxglove.SceneUpdate"
    assert {topic: len(messages) for topic, messages in read_view(out).items()} == {
        topic: row["messages"] for topic, row in told["topics"].items()
    }
    assert "--force" in bcid("view", workspace, "--out", out, code=4)
    bcid("view", workspace, "--out", out, "--force")
    with pytest.raises(InputRefused):
        refuse_to_overwrite(view_files(out), lambda there: False)


def test_a_cut_of_a_take_is_viewed_by_the_pipeline_file_s_car(
    takes: dict[str, Path], vehicle_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "pipeline.toml").write_text(f'vehicle = "{vehicle_file}"\ntraining = ["none.csv"]\n')
    monkeypatch.chdir(tmp_path)
    bcid("view", takes["mcap"], "--out", "whole.mcap")
    bcid("view", f"{takes['mcap']}[10:20]", "--out", "part.mcap")
    # what is logged at one time of the whole take is logged at the same of its part
    whole, part = (read_view(Path(name))["/bcid/measured/pose"] for name in ("whole.mcap", "part.mcap"))
    times = [[m.log_ns for m in messages] for messages in (whole, part)]
    assert set(times[1]) < set(times[0])
    assert 9.0 < (times[1][-1] - times[1][0]) / 1e9 < 10.5
    assert 9.5 < (times[1][0] - times[0][0]) / 1e9 < 10.5


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["TAKE"], "needs --vehicle"), (["TAKE", "--vehicle", "CAR", "--take", "x"], "go with a workspace"),
        (["TAKE", "--vehicle", "CAR", "--tables", "x"], "go with a workspace"),
        (["TAKE", "--vehicle", "CAR", "--out", "x.csv"], "does not end in .mcap"),
        (["WORKSPACE", "--model", "x"], "go with a recording"),
        (["WORKSPACE", "--tables", "x", "--out", "x.mcap"], "no view is written"),
    ],
)  # fmt: skip
def test_options_that_do_not_go_together(
    words: list[str], said: str, workspace: Path, takes: dict[str, Path], vehicle_file: Path
) -> None:
    places = {"TAKE": takes["mcap"], "CAR": vehicle_file, "WORKSPACE": workspace}
    assert said in bcid("view", *(places.get(word, word) for word in words), code=2)


def test_the_layout_shows_topics_that_are_there(workspace: Path, view: Path, tmp_path: Path) -> None:
    bcid("view", workspace, "--out", tmp_path / "whole.mcap")
    for path in (view, tmp_path / "whole.mcap"):
        layout, topics = json.loads(view_files(path)[1].read_text()), read_view(path)
        panels = layout["configById"]
        assert set(panels["3D!floor"]["topics"]) <= set(topics)
        assert panels["3D!floor"]["topics"]["/bcid/cars"]["visible"]
        assert panels["RosOut!findings"]["topicToRender"] in topics
        lines = [p["value"] for panel in panels.values() for p in panel.get("paths", [])]
        for line in lines:
            topic, _, field = line.partition(".")
            assert field in topics[topic][0].message, line
        assert any("before/twist" in line for line in lines) == (path.name == "whole.mcap")
        assert panels_in(layout["layout"]) == set(panels)


def panels_in(part: object) -> set[str]:
    """The panels that a layout arranges."""
    if isinstance(part, dict):
        assert 0 < part["splitPercentage"] < 100
        return panels_in(part["first"]) | panels_in(part["second"])
    return {str(part)}
