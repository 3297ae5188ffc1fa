"""The command line as a person or a script meets it: help, formats, exit codes, one error at a time."""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from making import circling_take
from typer.main import get_command

from bcid.cli.app import app

ROOT = Path(__file__).parent.parent
COMMANDS = sorted(get_command(app).commands)  # type: ignore[attr-defined]


def bcid(*words: str | Path, cwd: Path | None = None, **env: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "bcid", *map(str, words)],
        capture_output=True, text=True, cwd=cwd or ROOT, env={**os.environ, **env}, timeout=300, check=False,
    )  # fmt: skip


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_and_option_has_help_and_documentation(command: str) -> None:
    registered = get_command(app).commands[command]  # type: ignore[attr-defined]
    assert registered.help
    pages = (ROOT / "README.md", *(ROOT / "docs").glob("*.md"))
    assert any(f"bcid {command}" in page.read_text(encoding="utf-8") for page in pages)
    for option in registered.params:
        assert getattr(option, "help", None), option.name


def test_help_costs_no_heavy_import() -> None:
    """Not even numpy or pydantic, each of which takes longer to import than typer does."""
    heavy = {"torch", "numba", "pysindy", "pandas", "pyarrow", "scipy", "matplotlib", "sklearn", "numpy", "pydantic"}
    program = "import sys; from bcid.cli.app import app; app(['--help'], standalone_mode=False); print(*sys.modules)"
    out = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, cwd=ROOT)
    assert "Usage" in out.stdout
    imported = {*out.stdout.splitlines()[-1].split()}
    assert heavy & imported == set()
    # what draws boxes around help costs more than typer and all commands together
    assert not {name for name in imported if name.partition(".")[0] in ("rich", "pygments", "markdown_it")}


def test_the_list_of_commands_is_cut_off_nowhere() -> None:
    out = subprocess.run(
        [sys.executable, "-m", "bcid", "--help"], capture_output=True, text=True, check=True, cwd=ROOT,
        env={**os.environ, "COLUMNS": "80"},
    )  # fmt: skip
    assert "..." not in out.stdout.partition("Commands:")[2]


def test_models_in_three_formats() -> None:
    human = bcid("models")
    assert human.returncode == 0
    assert "k-sindy-mlp" in human.stdout
    assert "\x1b" not in human.stdout + human.stderr
    listed = json.loads(bcid("models", "--format", "json").stdout)
    assert listed["models"][0]["model"] == "newton-euler"
    assert bcid("models", "--format", "quiet").stdout == ""


def test_effects_are_listed_and_looked_up() -> None:
    listed = json.loads(bcid("effects", "--format", "json").stdout)
    assert len(listed["effects"]) == 42
    one = bcid("effects", "yaw_scrub")
    assert "M_z −= c·ω" in one.stdout
    refused(bcid("effects", "yaw_scrup"), 2, "yaw_scrub", "next: ")


def refused(result: subprocess.CompletedProcess[str], code: int, *texts: str) -> None:
    assert result.returncode == code, result.stderr
    assert "Traceback" not in result.stderr
    assert result.stdout == ""
    for text in texts:
        assert text in result.stderr


def test_errors_have_a_place_a_cause_and_a_next_step(tmp_path: Path, vehicle_file: Path) -> None:
    out = ("--out", tmp_path / "w")
    take = circling_take(tmp_path)
    refused(bcid("run", cwd=tmp_path), 4, "pipeline.toml: pipeline file: there is none here", "next: ", "bcid init")
    refused(
        bcid("estimate", tmp_path / "none.csv", "--vehicle", vehicle_file, *out),
        4,
        "none.csv",
        "does not exist",
        "next: ",
    )
    refused(bcid("estimate", take, "--vehicle", tmp_path / "no.toml", *out), 4, "no.toml", "next: ")
    bad = tmp_path / "bad.toml"
    bad.write_text(vehicle_file.read_text(encoding="utf-8").replace("mass_kg", "mass"))
    refused(
        bcid("estimate", take, "--vehicle", bad, *out), 4, "bad.toml", "body.mass", "did you mean mass_kg", "next: "
    )
    refused(bcid("estimate", take), 2, "--vehicle", "next: ")
    refused(bcid("fit", "--model", "bicycle"), 2, "bicycle", "next: ")
    refused(bcid("estimate", "--bogus"), 2, "No such option: --bogus (", "next: ", "--help")
    refused(bcid("estimate", "--vehicel", "v.toml"), 2, "--vehicle", "next: ")
    refused(bcid("diagnos"), 2, "'diagnos'", "Did you mean", "diagnose", "next: ")
    refused(bcid("fit", "--model"), 2, "requires an argument", "next: ")
    refused(bcid("simulate", "--set", "gravity=9"), 2, "gravity", "next: ")
    refused(bcid("ingest", take, "--vehicle", vehicle_file, *out, "--format", "xml"), 2)


def test_init_writes_files_that_can_be_read(tmp_path: Path) -> None:
    from bcid.pipeline.config import read_pipeline_file
    from bcid.vehicle import read_vehicle

    made = bcid("init", tmp_path / "new")
    assert made.returncode == 0
    assert read_vehicle(tmp_path / "new" / "vehicle.toml").name == "my-car"
    assert len(read_pipeline_file(tmp_path / "new" / "pipeline.toml").models) == 6
    refused(bcid("init", tmp_path / "new"), 4, "exists already", "next: ", "--force")


def test_the_contract_s_own_vehicle_file_is_read(tmp_path: Path) -> None:
    """The example of the specification, word for word."""
    from bcid.vehicle import read_vehicle

    path = tmp_path / "v.toml"
    path.write_text(
        'name = "bumper-car"\n[body]\nmass_kg = 319.6\ncog_to_front_m = 0.54\ncog_to_rear_m = 0.33\n'
        'drive = "front"\nrear_track_m = 0.60\n[steering]\nmax_angle_rad = 2.012\nmax_rate_radps = 1.418\n'
        'time_constant_s = 0.155\n[motor]\nreference_speed_mps = 2.033\n[mocap]\nrigid_body = "bumper_car"\n'
        'up_axis = "Y"\n[topics]\npose = "/mocap/bumper_car/pose"\ncommand = "/bumper_car/command"\n'
    )
    assert read_vehicle(path).steering.max_rate_radps == 1.418


@pytest.mark.slow
def test_recordings_may_be_named_directly(tmp_path: Path, takes: dict[str, Path], vehicle_file: Path) -> None:
    where = ("--vehicle", vehicle_file, "--out", tmp_path / "w")
    taken = bcid("ingest", takes["motive"], *where, "--format", "json")
    assert taken.returncode == 0
    assert taken.stderr == ""
    assert json.loads(taken.stdout)["recordings"][0]["name"] == "drive"
    estimated = json.loads(bcid("estimate", takes["motive"], *where, "--format", "json").stdout)
    folder = Path(estimated["estimates"][0]["folder"])
    assert {p.name for p in folder.iterdir()} >= {"estimate.parquet", "estimate.json", "manifest.json"}
    fit = bcid("fit", takes["motive"], "--model", "k-sindy", *where)
    assert fit.returncode == 0
    assert "v_f(k+1) =" not in fit.stdout
    assert "v_f(k+1) =" in bcid("fit", takes["motive"], "--model", "k-sindy", "--equations", *where).stdout
    poses = bcid("fit", takes["motive"], "--model", "newton-euler", "--loss", "poses", *where)
    assert poses.returncode == 0
    assert "front cornering stiffness" in poses.stdout
    assert (tmp_path / "w" / "models" / "newton-euler-poses" / "limits.json").exists()
    unable = bcid("fit", takes["motive"], "--model", "k-mlp", "--loss", "poses", *where)
    assert unable.returncode == 2
    assert "choose one-step or rollout" in unable.stderr


def test_of_several_recordings_all_that_are_refused_are_told(
    tmp_path: Path, takes: dict[str, Path], vehicle_file: Path
) -> None:
    for name in ("a.csv", "b.csv"):
        (tmp_path / name).write_text("t\n", encoding="utf-8")
    named = (tmp_path / "a.csv", takes["motive"], tmp_path / "b.csv")
    taken = bcid("ingest", *named, "--vehicle", vehicle_file, "--out", tmp_path / "w")
    assert taken.returncode == 4
    assert "a.csv: " in taken.stderr
    assert "b.csv: " in taken.stderr
    assert "drive" in taken.stdout  # the good one between them is read, and told


HOSTILE = "x\x1b[31m\x07\u202ecsv"


def test_hostile_names_are_inert(tmp_path: Path, vehicle_file: Path) -> None:
    take = circling_take(tmp_path, name="[red]<script>x")
    done = bcid("ingest", take, "--vehicle", vehicle_file, "--out", tmp_path / "w")
    assert done.returncode == 0
    assert "[red]<script>x" in done.stdout


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="no such names there")
def test_no_control_character_of_a_name_is_printed(tmp_path: Path, vehicle_file: Path) -> None:
    """In results, progress and errors; of takes, models, effects, cars and options; in tables, titles and sentences."""
    take = circling_take(tmp_path, name=f"{HOSTILE}\nerror: forged")
    where, car = ("--out", tmp_path / "w"), tmp_path / f"car{HOSTILE}.toml"
    car.write_text(vehicle_file.read_text(encoding="utf-8").replace('"bumper-car"', '"car\\u001b[31m"'))
    told = [
        bcid("ingest", take, "--vehicle", car, *where),
        bcid("ingest", "--check", take, "--vehicle", car),
        bcid("estimate", take, "--vehicle", car, *where),
        bcid("ingest", tmp_path / f"none{HOSTILE}\nerror: forged.csv", "--vehicle", car, *where),
        bcid("estimate", take, "--vehicle", tmp_path / HOSTILE, *where),
        bcid("effects", HOSTILE),
        bcid("fit", "--model", HOSTILE),
        bcid("models", f"--{HOSTILE}"),
        bcid(HOSTILE),
        bcid("prove", "--quick", "--case", HOSTILE, *where),
        bcid("diagnose", take, "--vehicle", car, *where, "--simulation", HOSTILE),
    ]
    for done in told:
        text = done.stdout + done.stderr
        assert "Traceback" not in text
        assert "internal error" not in text
        assert not {c for c in text if not c.isprintable()} - {"\n", "\N{NO-BREAK SPACE}", "\N{NARROW NO-BREAK SPACE}"}
        assert not [line for line in text.splitlines() if line.startswith("error: forged")]


def test_titles_of_tables_and_stages_are_cleaned(monkeypatch: pytest.MonkeyPatch) -> None:
    from bcid.cli.options import Format
    from bcid.cli.sink import CleanConsole, Sink, plain_table

    table = plain_table(f"title {HOSTILE}", [f"column {HOSTILE}"], [[f"cell {HOSTILE}"]], f"caption {HOSTILE}")
    told = io.StringIO()
    CleanConsole(file=told, width=200).print(table)
    monkeypatch.setenv("NO_COLOR", "1")
    sink = Sink(Format.human)
    sink.err, sink.lively = CleanConsole(file=told, width=200), True
    with sink.stage(f"stage {HOSTILE}") as progress:
        progress(0.5, f"text {HOSTILE}")
    sink.report_reused(f"reused {HOSTILE}")
    sink.note(f"note {HOSTILE}")
    sink.error(f"error {HOSTILE}")
    text = told.getvalue()
    assert text.count("x�[31m��csv") >= 8
    assert all(c.isprintable() or c == "\n" for c in text)


def test_takes_that_are_no_go_end_with_exit_code_4(tmp_path: Path, vehicle_file: Path) -> None:
    """One of several is enough; each says why."""
    good, short = circling_take(tmp_path, "good", 40.0), circling_take(tmp_path, "short", 3.0)
    alone = bcid("ingest", "--check", short, "--vehicle", vehicle_file)
    assert alone.returncode == 4
    assert "no-go" in alone.stdout
    assert "short.csv: health: no-go" in alone.stderr
    both = bcid("ingest", "--check", good, short, "--vehicle", vehicle_file, "--format", "json")
    assert both.returncode == 4
    assert [t["go"] for t in json.loads(both.stdout)["recordings"]][1] is False
    assert "short.csv: health: no-go" in both.stderr
