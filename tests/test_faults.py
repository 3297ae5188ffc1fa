"""A short form of `make fuzz`, and faults that whole commands meet: a full disk, company in the workspace."""

from __future__ import annotations

import resource
import subprocess
import sys
from pathlib import Path

import pytest
from faults.fuzzing import UNFORESEEN, Batch, kinds, run_batch

MUTANTS = 40
SMALL_DISK = 20_000  # bytes a file may have


@pytest.mark.parametrize("kind", kinds())
@pytest.mark.filterwarnings("default")
def test_mutants_are_refused_or_read_and_nothing_is_lost_in_silence(kind: str) -> None:
    _, counts, failures, _ = run_batch(Batch(kind, 0, MUTANTS))
    assert failures == []
    # the guard around all readers is for what nobody foresaw: what a test meets is to be foreseen
    assert counts[UNFORESEEN] == 0
    assert sum(counts.values()) == MUTANTS


def ingest(take: Path, vehicle: Path, out: Path) -> list[str]:
    words = [sys.executable, "-m", "bcid", "ingest", str(take), "--vehicle", str(vehicle), "--out", str(out)]
    return [*words, "--format", "quiet"]


def small_disk() -> None:
    resource.setrlimit(resource.RLIMIT_FSIZE, (SMALL_DISK, SMALL_DISK))


def test_a_full_disk_ends_with_one_message_and_the_next_run_goes_on(
    takes: dict[str, Path], vehicle_file: Path, tmp_path: Path
) -> None:
    words = ingest(takes["motive"], vehicle_file, tmp_path / "w")
    full = subprocess.run(words, capture_output=True, text=True, preexec_fn=small_disk, check=False)
    assert full.returncode == 4
    assert "disk or the quota is full" in full.stderr
    assert "Traceback" not in full.stderr
    assert not list((tmp_path / "w").glob("ingest/*"))
    assert subprocess.run(words, capture_output=True, check=False).returncode == 0
    assert len(list((tmp_path / "w").glob("ingest/*"))) == 1


@pytest.mark.slow
def test_eight_runs_in_one_workspace_make_one_artifact(
    takes: dict[str, Path], vehicle_file: Path, tmp_path: Path
) -> None:
    words = ingest(takes["mcap"], vehicle_file, tmp_path / "w")
    runs = [subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE) for _ in range(8)]
    ended = [(run.communicate()[1], run.returncode) for run in runs]
    assert [code for _, code in ended] == [0] * 8, ended
    assert len(list((tmp_path / "w" / "ingest").iterdir())) == 1
    assert not [p for p in (tmp_path / "w" / ".unfinished").iterdir() if p.is_dir()]
