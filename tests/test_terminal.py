"""A whole run of takes with hostile names, on a terminal: nothing of a name reaches it as a command."""

from __future__ import annotations

import os
import pty
import re
import subprocess
import sys
from pathlib import Path

import pytest
from making import circling_take

from bcid.simulation.samples import VEHICLE

HOSTILE = "\x1b]0;owned\x07\x1b[2J\x9b31m\u202etake"
PIPELINE = """\
vehicle = "car.toml"
training = ["{take}.csv"]
validation = "other.csv"
workspace = "w"
models = ["k-sindy"]
[report]
timing_repeats = 1
"""
# what rich itself sends to a terminal: colours, and where the progress bar's line begins and ends
OWN_SEQUENCES = re.compile(r"\x1b\[[0-9;]*m|\x1b\[\?25[lh]|\x1b\[[0-9]*[AKG]|\x1b\[2K|\r")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "car.toml").write_text(VEHICLE)
    circling_take(tmp_path, HOSTILE, 30.0)
    circling_take(tmp_path, "other", 30.0)
    written = "".join(f"\\u{ord(c):04x}" for c in HOSTILE)
    (tmp_path / "pipeline.toml").write_text(PIPELINE.format(take=written))
    return tmp_path


def on_a_terminal(words: list[str], folder: Path) -> str:
    """All that a command prints where both stdout and stderr are a terminal."""
    ours, theirs = pty.openpty()
    run = subprocess.Popen(
        [sys.executable, "-m", "bcid", *words], cwd=folder, stdin=theirs, stdout=theirs, stderr=theirs,
        env={**os.environ, "TERM": "xterm", "COLUMNS": "100"},
    )  # fmt: skip
    os.close(theirs)
    printed = b""
    while True:
        try:
            more = os.read(ours, 1 << 16)
        except OSError:  # the terminal's other end is closed
            break
        if not more:
            break
        printed += more
    run.wait()
    os.close(ours)
    return printed.decode(errors="replace")


@pytest.mark.parametrize("words", [["run"], ["ingest"], ["ingest", "--check"]], ids=" ".join)
def test_names_are_no_commands_to_a_terminal(words: list[str], folder: Path) -> None:
    printed = on_a_terminal([*words, "-p", "pipeline.toml"], folder)
    assert "Traceback" not in printed
    assert "take" in printed, printed
    rest = OWN_SEQUENCES.sub("", printed)
    assert [c for c in rest if not c.isprintable() and c not in "\n "] == []
    assert "\x1b]" not in printed
    assert "\x1b[2J" not in printed


def test_a_refusal_of_such_a_name_is_no_command_either(folder: Path) -> None:
    (folder / f"{HOSTILE}.csv").write_text("nothing")
    for words in (["run", "-p", "pipeline.toml"], ["ingest", f"{HOSTILE}.csv", "--vehicle", "car.toml", "--out", "o"]):
        printed = on_a_terminal(words, folder)
        assert "error" in printed
        assert [c for c in OWN_SEQUENCES.sub("", printed) if not c.isprintable() and c not in "\n "] == []


def test_a_name_that_is_no_text_is_refused(tmp_path: Path) -> None:
    """A Latin-1 name: no document could hold it."""
    (tmp_path / "car.toml").write_text(VEHICLE)
    name = os.fsencode(tmp_path) + b"/caf\xe9.csv"
    circling_take(tmp_path, "take").rename(os.fsdecode(name))
    words = [sys.executable, "-m", "bcid", "ingest", name, "--vehicle", "car.toml", "--out", "w"]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, check=False)
    assert done.returncode == 4
    assert b"UTF-8" in done.stderr
    assert b"internal error" not in done.stderr
