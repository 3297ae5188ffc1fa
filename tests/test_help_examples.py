"""Every help ends with examples that the command line accepts, and the shell completes what stands in them."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from typer.main import get_command

from bcid.cli.app import COMMANDS, app
from bcid.cli.examples import EXAMPLES
from bcid.errors import UsageError

ROOT = Path(__file__).parent.parent


def test_every_command_has_examples_and_no_other_has() -> None:
    assert EXAMPLES.keys() == COMMANDS.keys()


@pytest.mark.parametrize("command", sorted(COMMANDS))
def test_examples_stand_in_the_help_and_are_accepted(command: str) -> None:
    import shlex

    group: Any = get_command(app)
    epilog = group.commands[command].epilog
    assert EXAMPLES[command]
    for line, what in EXAMPLES[command].items():
        assert line in epilog
        assert what in epilog
        program, name, *words = shlex.split(line)
        assert (program, name) == ("bcid", command)
        # raises for a word, an option or a value that there is not
        group.commands[command].make_context(command, words)


def test_examples_are_printed_line_by_line() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "bcid", "export", "--help"], capture_output=True, text=True, check=True, cwd=ROOT,
        env={**os.environ, "COLUMNS": "140"},
    )  # fmt: skip
    lines = [line.strip() for line in done.stdout.splitlines()]
    begin = lines.index("Examples:")
    assert [line for line in lines[begin + 1 :] if line] == [f"{a}  —  {b}" for a, b in EXAMPLES["export"].items()]


def completed(line: str, folder: Path) -> list[str]:
    """What bash would offer at the end of `line`."""
    program = "import sys; sys.argv = ['bcid']; from bcid.__main__ import start; start()"
    words = {"_BCID_COMPLETE": "complete_bash", "COMP_WORDS": line, "COMP_CWORD": str(len(line.split(" ")) - 1)}
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True, cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT), **words},
    )  # fmt: skip
    assert done.stderr == ""
    return done.stdout.split()


def test_the_shell_completes_commands_models_effects_and_formats(tmp_path: Path) -> None:
    for folder in ("newton-euler", "k-sindy", "k-sindy-rollout"):
        (tmp_path / "w" / "models" / folder).mkdir(parents=True)
        (tmp_path / "w" / "models" / folder / "model.json").write_text("{}")
    pipeline = 'vehicle = "v.toml"\ntraining = ["a.csv"]\nworkspace = "w"\n'
    (tmp_path / "pipeline.toml").write_text(pipeline, encoding="utf-8")
    assert completed("bcid dia", tmp_path) == ["diagnose"]
    assert completed("bcid fit --model newton", tmp_path) == ["newton-euler", "newton-euler-linear"]
    assert completed("bcid export k", tmp_path) == ["k-sindy", "k-sindy-rollout"]
    assert completed("bcid simulate --model n", tmp_path) == ["newton-euler"]
    assert completed("bcid export --format ca", tmp_path) == ["casadi"]
    assert completed("bcid plan rough", tmp_path) == ["rough_patch"]
    # where no name begins so, paths
    assert completed("bcid export w/mod", tmp_path) == ["w/models/"]
    assert completed("bcid export ./pip", tmp_path) == ["./pipeline.toml"]
    assert completed("bcid export .", tmp_path) == []
    (tmp_path / "pipeline.toml").write_text("no toml at all", encoding="utf-8")
    assert completed("bcid export pip", tmp_path) == ["pipeline.toml"]


@pytest.mark.parametrize("text", ["12", "12,7,3", "a,b", "0,3", "-1,2", "nan,2", "inf,2", ""])
def test_an_arena_that_is_none_is_refused(text: str) -> None:
    from bcid.cli.diagnosing import read_arena

    with pytest.raises(UsageError, match="such as 12,7"):
        read_arena(text)


def test_an_arena_is_shown_as_it_is_typed() -> None:
    from bcid.cli.diagnosing import read_arena

    group: Any = get_command(app)
    (option,) = [p for p in group.commands["plan"].params if p.name == "arena"]
    assert option.metavar == "LENGTH,WIDTH"
    assert read_arena(option.default) == (12.0, 7.0)
    for text in ("3,2", "3, 2", "3 2", "3x2", " 3 x 2 "):
        assert read_arena(text) == (3.0, 2.0)
