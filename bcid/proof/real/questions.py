"""Questions to real recordings as a TOML file: drives, what is withheld of their simulation, edits, and pairs.

Every withholding is asked of every drive, every edit of every drive that says `edited`; which of these questions have
an answer is computed (`bcid.proof.real.oracle`), not listed.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import Field

from bcid.diagnosis.reference import ParameterFile, read_parameter_file
from bcid.effects.table import EFFECTS, ENTRIES
from bcid.errors import InputRefused
from bcid.files.toml import PathText, Settings, read_toml
from bcid.proof.real.edits import EDITS


class RecordedDrive(Settings):
    """A recording of which questions are asked."""

    recording: str
    day: str = ""  # drives with the same text are of the same car as it was on one day
    vehicle: dict[str, Any] = Field(default_factory=dict)  # tables in place of the vehicle file's
    edited: bool = False  # the edits are asked of it
    predicted_only: bool = False  # nothing is asked of it: it is only there for pairs
    tracking_fails: bool = False  # nothing of the vehicle may be named, and nothing else is asked of it
    known: list[str] = Field(default_factory=list)  # effects that may be named there: other drives show them too

    @property
    def shows_the_car(self) -> bool:
        """Whether the drive is diagnosed for what its car is like on that day."""
        return not (self.tracking_fails or self.predicted_only)


class Withholding(Settings):
    """What is taken from a simulation: effects, and perhaps parameters or what the vehicle file knows."""

    effects: list[str] = Field(min_length=1)  # to be named: of the simulation, or what the vehicle's tables stand for
    parameters: dict[str, float] = Field(default_factory=dict)  # of the simulation, in place of its own
    vehicle: dict[str, Any] = Field(default_factory=dict)  # tables in place of the vehicle file's
    # parameters by effect and symbol, of those that the simulation lacks
    sizes: dict[str, dict[str, float]] = Field(default_factory=dict)


class DrivePair(Settings):
    """Two recordings of one car: models are fitted to the first, and predict the second."""

    fit: str
    test: str


class QuestionFile(Settings):
    """All questions to recordings of one vehicle; in the TOML file paths count from its folder."""

    vehicle: PathText
    simulation: PathText | None = None  # without one the base model is refitted to each recording
    drives: list[RecordedDrive]
    withheld: dict[str, Withholding] = Field(default_factory=dict)  # by the name of the question
    edits: dict[str, float] = Field(default_factory=dict)  # size by effect
    pairs: list[DrivePair] = Field(default_factory=list)

    def drive(self, recording: str) -> RecordedDrive:
        """The drive of this recording."""
        return next(drive for drive in self.drives if drive.recording == recording)

    def fellows(self, drive: RecordedDrive) -> tuple[str, ...]:
        """The recordings of the other drives of the same day, in order; empty for a drive without a day."""
        same = [d.recording for d in self.drives if drive.day and d.day == drive.day and d.shows_the_car]
        return tuple(recording for recording in same if recording != drive.recording)


class WithheldQuestion(NamedTuple):
    """What is withheld from the simulation of one recording."""

    recording: str
    name: str
    withholding: Withholding


class EditedQuestion(NamedTuple):
    """An effect of known size, made in a real recording by an edit."""

    recording: str
    effect: str
    value: float


def read_questions(file: Path) -> QuestionFile:
    """Read and check the TOML file of questions about real recordings, which test a diagnosis.

    A question withholds something from the vehicle's published simulation, or edits a recording so that it shows an
    effect of known size; the diagnosis has to name it.  The returned paths are joined to the file's folder.

    Raises:
        InputRefused: the file cannot be read so, or a question names what does not exist.
    """
    questions = read_toml(file, QuestionFile, "file of questions", "pipelines/dart/cases.toml is one")
    path = questions.simulation and file.parent / questions.simulation
    questions = questions.model_copy(update={"vehicle": file.parent / questions.vehicle, "simulation": path})
    simulation = ParameterFile(parameters={}) if path is None else read_parameter_file(path)
    _check_drives(questions, file)
    for name, withholding in questions.withheld.items():
        _check_withholding(name, withholding, simulation, file)
    strange = [effect for effect in questions.edits if effect not in EDITS]
    if strange:
        raise InputRefused(file, f"edits.{strange[0]}", "no such edit", f"one of {', '.join(EDITS)}")
    return questions


def _check_drives(questions: QuestionFile, file: Path) -> None:
    """Raise `InputRefused` for a recording listed twice, a pair of unlisted ones, or an effect that does not exist."""
    names = [drive.recording for drive in questions.drives]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise InputRefused(file, "drives", f"{', '.join(twice)} stands there twice", "list each recording once")
    paired = [name for pair in questions.pairs for name in (pair.fit, pair.test)]
    if any(name not in names for name in paired) or any(pair.fit == pair.test for pair in questions.pairs):
        raise InputRefused(file, "pairs", "not two of the drives", f"two of {', '.join(names)}")
    for drive in questions.drives:
        _refuse_unknown(drive.known, EFFECTS, file, f"known of {drive.recording!r}", "effect")
        if drive.known and not drive.tracking_fails:
            cause = "only where the tracking fails something is known"
            raise InputRefused(file, f"known of {drive.recording!r}", cause, "leave it out; other drives are asked")


def _check_withholding(name: str, withholding: Withholding, simulation: ParameterFile, file: Path) -> None:
    """Raise `InputRefused` where a withholding names what does not exist, or takes nothing from the `simulation`."""
    place = f"withheld {name!r}"
    _refuse_unknown(withholding.effects, ENTRIES, file, place, "effect")
    _refuse_unknown(withholding.sizes, withholding.effects, file, place, "withheld effect")
    for effect in withholding.effects:
        if effect in simulation.effects:
            continue
        symbols = {p.symbol for p in ENTRIES[effect].parameters}
        if not withholding.vehicle or set(withholding.sizes.get(effect, ())) != symbols:
            choices = f"one of {', '.join(simulation.effects)}, or tables of the vehicle file and `sizes`"
            raise InputRefused(file, place, f"the simulation has no {effect!r}", choices)
    changed = [s for s, v in withholding.parameters.items() if s not in simulation.parameters or not v > 0.0]
    if changed:
        choices = f"one of {', '.join(simulation.parameters) or 'a simulation, which is not named'}, above zero"
        raise InputRefused(file, place, f"changes parameters {', '.join(changed)} of the simulation", choices)


def _refuse_unknown(
    names: Iterable[str], known: Iterable[str] | Mapping[str, Any], file: Path, place: str, what: str
) -> None:
    """Raise `InputRefused` where one of the `names` is none of those `known`; `what` they are called."""
    unknown = sorted(set(names) - set(known))
    if unknown:
        raise InputRefused(file, place, f"there is no {what} {', '.join(unknown)}", "see `bcid effects` for the ids")
