"""A blind test from end to end: answers are sealed, takes are run, the seals are opened, all is counted."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from bcid.proof.baselines import summary
from bcid.proof.blind.cases import Case, quick_suite, subset, suite
from bcid.proof.blind.run_cases import asked_before, code_of_rows, run_all
from bcid.proof.blind.seal import answer_of, opened, seal_up
from bcid.proof.rows import written
from bcid.proof.scores.outcome import outcome
from bcid.simulation.samples import VEHICLE
from bcid.simulation.writing import write_mcap


@dataclass(frozen=True)
class Sizes:
    """How much is concealed."""

    repeats: int = 3  # takes that conceal one effect, of every effect
    nulls: int = 300
    imperfect_nulls: int = 100
    pairs: int = 50
    every: int = 1  # one case in so many of each tier


@dataclass(frozen=True)
class Blind:
    """Which takes are asked, and whether their answers are sealed."""

    seed: int = 1
    salt: str = ""  # nothing is sealed without
    quick: bool = False  # a part of its own
    sizes: Sizes = Sizes()
    others: bool = False  # other methods as well

    @cached_property
    def cases(self) -> list[Case]:
        """What is concealed."""
        of = self.sizes
        whole = list(suite(self.seed, of.repeats, of.nulls, of.imperfect_nulls, of.pairs))
        return quick_suite(whole, self.seed) if self.quick else subset(whole, of.every)


def laid_out(case: Case, folder: Path) -> Path:
    """A case's recording in `folder`, beside the vehicle file and its answer, for whoever wants to look at it."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{case.name}.mcap"
    write_mcap(path, case.driven(), case.rate_hz, case.seed)
    (folder / "bumper_car.toml").write_text(VEHICLE, encoding="utf-8")
    (folder / f"{case.name}.answer.json").write_text(json.dumps(answer_of(case), indent=1), encoding="utf-8")
    return path


def blind_test(
    test: Blind, folder: Path, workers: int = 1, minutes: float | None = None,
    sealed: Callable[[str | None], None] = lambda seal: None,
    progress: Callable[[int], None] = lambda done: None,
) -> dict[str, Any]:  # fmt: skip
    """The outcome of all that has run in `folder`, now or before; no case begins after so many `minutes`.

    `sealed` is called with the seal before the first take, `progress` after each.

    Raises:
        UsageError: the folder holds the seals of other answers.
        InputRefused: a seal that does not fit.
    """
    cases, seal, before = test.cases, None, written(folder)
    if test.salt:
        seal = seal_up(cases, test.salt, folder, asked_before(cases, folder))
    sealed(seal)
    rows = list[dict[str, Any]]()
    for row in run_all(cases, folder, workers, test.others, minutes):
        rows.append(row)
        progress(len(rows))
    ran = {row["case"] for row in rows}
    about = {
        "seed": test.seed, "salt": test.salt, "quick": test.quick, "sizes": asdict(test.sizes), "of": len(cases),
        "tiers_of": dict(Counter(c.tier for c in cases)), "seal": seal, "code": code_of_rows(test.others),
    }  # fmt: skip
    unsealed = (
        opened([c for c in cases if c.name in ran], test.salt, folder, written(folder) - before) if test.salt else {}
    )
    return outcome(rows, {**about, **unsealed}) | {"baselines": summary(rows)}
