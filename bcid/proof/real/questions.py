"""Questions to real recordings as a TOML file, refused where a question needs no answer or cannot have one."""

from pathlib import Path
from typing import Any, get_args

from pydantic import Field

from bcid.diagnosis.reference import ParameterFile, read_parameter_file
from bcid.effects.entry import Channel
from bcid.effects.table import EFFECTS
from bcid.errors import InputRefused
from bcid.files.toml import PathText, Settings, read_toml
from bcid.proof.real.edits import EDITS

ANY_VEHICLE_EFFECT = "vehicle"
# verdict where the simulation predicts as well without what is withheld
NOT_ASKED = "not asked"
UNKNOWN_IN_CHANNEL = tuple(f"unknown in {channel}" for channel in get_args(Channel))


class WithheldQuestion(Settings):
    """What is withheld from the simulation: an effect, parameters, or what the vehicle file knows."""

    recording: str
    name: str
    effect: str = ""
    parameters: dict[str, float] = Field(default_factory=dict)  # of the simulation, in place of its own
    vehicle: dict[str, Any] = Field(default_factory=dict)  # tables in place of the vehicle file's
    accepted: list[str]  # ids, "unknown in CHANNEL", or "vehicle" for every effect of the vehicle
    control: bool = False  # none of `accepted` may be named
    known: list[str] = Field(default_factory=list)  # effects that a control may name: other drives show them too

    @property
    def row_head(self) -> dict[str, str]:
        """Fields of the question's row that say what was asked: tier, recording and case."""
        tier = "control" if self.control else "withheld"
        return {"tier": tier, "recording": self.recording, "case": self.name}

    @property
    def key_fields(self) -> dict[str, Any]:
        """Fields that the answer depends on, for the row's key: not the question's name, nor what is accepted."""
        return self.model_dump(exclude={"name", "accepted", "known"})


class EditedQuestion(Settings):
    """An effect of known size, made in a real recording by an edit."""

    recording: str
    effect: str
    value: float

    @property
    def row_head(self) -> dict[str, str]:
        """Fields of the question's row that say what was asked: tier, recording and case."""
        return {"tier": "edited", "recording": self.recording, "case": f"{self.effect} {self.value:g}"}

    @property
    def key_fields(self) -> dict[str, Any]:
        """Fields that the answer depends on, for the row's key."""
        return self.model_dump()


class QuestionFile(Settings):
    """All questions to recordings of one vehicle; in the TOML file paths count from its folder."""

    vehicle: PathText
    simulation: PathText | None = None  # without one the base model is refitted to each recording
    calibrated: dict[str, dict[str, Any]] = Field(default_factory=dict)  # vehicle tables of single recordings
    withheld: list[WithheldQuestion] = Field(default_factory=list)
    edited: list[EditedQuestion] = Field(default_factory=list)


def read_questions(file: Path) -> QuestionFile:
    """Read and check the TOML file of questions about real recordings, which test a diagnosis.

    A question withholds something from the vehicle's published simulation, or edits a recording so that it shows an
    effect of known size; the diagnosis has to name it.  The returned paths are joined to the file's folder.

    Raises:
        InputRefused: the file cannot be read so, or a question names what does not exist or accepts no answer.
    """
    questions = read_toml(file, QuestionFile, "file of questions", "pipelines/dart/cases.toml is one")
    path = questions.simulation and file.parent / questions.simulation
    questions = questions.model_copy(update={"vehicle": file.parent / questions.vehicle, "simulation": path})
    simulation = ParameterFile(parameters={}) if path is None else read_parameter_file(path)
    for question in questions.withheld:
        _check_withheld(question, simulation, file)
    asked = {q.recording for q in questions.withheld} | {q.recording for q in questions.edited}
    unasked = set(questions.calibrated) - asked
    if unasked:
        raise InputRefused(file, "calibrated", f"nothing is asked of {', '.join(sorted(unasked))}", "check the names")
    for edit in questions.edited:
        if edit.effect not in EDITS:
            raise InputRefused(file, f"edited {edit.effect!r}", "no such edit", f"one of {', '.join(EDITS)}")
    return questions


def _check_withheld(question: WithheldQuestion, simulation: ParameterFile, file: Path) -> None:
    """Raise `InputRefused` if a question names an effect or parameter that does not exist, or has no right answer.

    The question withholds an effect or parameters from the `simulation` (or from the vehicle file); the diagnosis has
    to name what is missing.
    """
    place = f"withheld {question.name!r}"
    if question.effect and question.effect not in simulation.effects:
        choices = f"one of {', '.join(simulation.effects)}"
        raise InputRefused(file, place, f"the simulation has no {question.effect!r}", choices)
    strange = [a for a in question.accepted if a not in (*EFFECTS, ANY_VEHICLE_EFFECT, *UNKNOWN_IN_CHANNEL)]
    if strange or not question.accepted:
        ids = f"see `bcid effects` for the ids; or {', '.join(UNKNOWN_IN_CHANNEL)}"
        raise InputRefused(file, place, f"accepts {strange or 'nothing'}", ids)
    changed = [s for s, v in question.parameters.items() if s not in simulation.parameters or not v > 0.0]
    if changed:
        choices = f"one of {', '.join(simulation.parameters) or 'a simulation, which is not named'}, above zero"
        raise InputRefused(file, place, f"changes parameters {', '.join(changed)} of the simulation", choices)
    unknown = [k for k in question.known if k not in EFFECTS]
    if unknown or (question.known and not question.control):
        raise InputRefused(file, place, f"knows {unknown or 'something and is no control'}", "see `bcid effects`")
