"""A blind test from end to end: answers are sealed, takes are run, the seals are opened, all is counted."""

import json
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import Any

from bcid.documents.prove import ProveDocument
from bcid.execution.jobs import Workers
from bcid.proof.blind.blind_case import BlindCase
from bcid.proof.blind.cases import draw_quick_suite, draw_suite, thin_tiers
from bcid.proof.blind.run_cases import case_code_digest, count_cases_with_rows, run_all_cases
from bcid.proof.blind.seal import case_answer, open_seals, write_seals
from bcid.proof.blind.small_files import SIMULATION_FILE
from bcid.proof.rows import count_written_rows
from bcid.proof.scores.outcome import blind_outcome
from bcid.simulation.writing import write_mcap_take


@dataclass(frozen=True)
class SuiteSizes:
    """Number of takes in the tiers of a suite."""

    repeats: int = 3  # takes of each effect that conceal it alone, and so many in each tier of small cars
    nulls: int = 300  # takes that conceal nothing, and a fifth of it of small cars
    imperfect_nulls: int = 100  # and in a car that the base model does not fit
    pairs: int = 50  # takes that conceal two effects
    every: int = 1  # only one case in so many of each tier
    other_laws: int = 40  # of small cars of other formulas than published, and as many less one effect
    other_day: int = 40  # of small cars on another day than published, and as many less one effect
    tricycles: int = 40

    @classmethod
    def of_stored_run(cls, sizes: Mapping[str, int]) -> "SuiteSizes":
        """The sizes that a run has stored; tiers that there were not yet when it was made have no takes."""
        return cls(**{**dict.fromkeys((size.name for size in fields(cls)), 0), **sizes})


@dataclass(frozen=True)
class BlindTest:
    """A blind test: which takes are diagnosed, and whether their answers are sealed."""

    seed: int = 1
    salt: str = ""  # without one nothing is sealed
    quick: bool = False  # twenty cases
    sizes: SuiteSizes = SuiteSizes()
    with_baselines: bool = False  # other methods run on the same takes

    @cached_property
    def cases(self) -> list[BlindCase]:
        """The cases of this test: a quick suite, or every `sizes.every`-th case of each tier."""
        sizes = self.sizes
        usual = (sizes.repeats, sizes.nulls, sizes.imperfect_nulls, sizes.pairs)
        whole = list(draw_suite(self.seed, *usual, sizes.other_laws, sizes.other_day, sizes.tricycles))
        return draw_quick_suite(whole, self.seed) if self.quick else thin_tiers(whole, sizes.every)


def write_case_files(case: BlindCase, folder: Path) -> Path:
    """Write a blind case (a simulated drive with concealed effects) into a folder: recording, vehicle file and answer.

    The recording is MCAP, the answer JSON; where there is a published simulation to compare with, it is written, too.
    A file of one of these names is replaced.  Returns the recording's path.
    """
    path, files = folder / f"{case.name}.mcap", case.lab_files
    write_mcap_take(path, case.simulate(), case.rate_hz, case.seed, files.body)
    (folder / files.vehicle_file).write_text(files.vehicle, encoding="utf-8")
    if files.simulation:
        (folder / SIMULATION_FILE).write_text(files.simulation, encoding="utf-8")
    (folder / f"{case.name}.answer.json").write_text(json.dumps(case_answer(case), indent=1), encoding="utf-8")
    return path


def run_blind_test(
    test: BlindTest, folder: Path, workers: Workers = 1, minutes: float | None = None,
    announce_seal: Callable[[str | None], None] = lambda seal: None,
    progress: Callable[[int], None] = lambda done: None,
) -> ProveDocument:  # fmt: skip
    """Run a blind test: diagnose simulated drives with concealed effects, and score the answers (prove.json).

    With a salt the answers are sealed by keyed hashes before the first case runs, and checked afterwards.  The result
    of each case is stored in `folder`, where a later call continues.  No case begins after so many `minutes`.
    `announce_seal` is called with the seal (None without a salt) before the first case, `progress` with the number of
    finished cases after each.

    Raises:
        UsageError: the folder holds the seals of other answers.
        InputRefused: a seal does not fit its answer.
    """
    cases, seal, before = test.cases, None, count_written_rows(folder)
    if test.salt:
        seal = write_seals(cases, test.salt, folder, count_cases_with_rows(cases, folder))
    announce_seal(seal)
    rows = list[dict[str, Any]]()
    for row in run_all_cases(cases, folder, workers, test.with_baselines, minutes):
        rows.append(row)
        progress(len(rows))
    ran = {row["case"] for row in rows}
    about = {
        "seed": test.seed, "salt": test.salt, "quick": test.quick, "sizes": asdict(test.sizes), "of": len(cases),
        "tiers_of": dict(Counter(c.tier for c in cases)), "seal": seal, "code": case_code_digest(test.with_baselines),
    }  # fmt: skip
    if test.salt:
        opened = [case for case in cases if case.name in ran]
        about |= open_seals(opened, test.salt, folder, count_written_rows(folder) - before)
    return blind_outcome(rows, about)
