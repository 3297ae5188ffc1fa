"""Questions to real recordings with a known omission: the TOML file, read and refused where it asks nothing."""

from __future__ import annotations

from pathlib import Path
from typing import Any, get_args

from pydantic import Field

from bcid.diagnosis.reference import Parameters, read_parameters
from bcid.effects.entry import Channel
from bcid.effects.table import EFFECTS
from bcid.errors import InputRefused
from bcid.files.toml import Settings, read_toml
from bcid.proof.real.edits import EDITS

VEHICLE = "vehicle"
NOT_ASKED = "not asked"  # a verdict: what makes no difference where it is withheld
UNKNOWN = tuple(f"unknown in {channel}" for channel in get_args(Channel))


class Withheld(Settings):
    """What the simulation is denied: an effect, parameters, or what the vehicle file knows."""

    recording: str
    name: str
    effect: str = ""
    parameters: dict[str, float] = Field(default_factory=dict)  # of the simulation, that make it so
    vehicle: dict[str, Any] = Field(default_factory=dict)  # tables laid over the vehicle file's
    accepted: list[str]  # ids, "unknown in CHANNEL", or "vehicle" for all that is neither measurement nor floor
    control: bool = False  # none of `accepted` may be named
    known: list[str] = Field(default_factory=list)  # of a control: what other drives of the car show as well

    @property
    def head(self) -> dict[str, str]:
        """Of its row."""
        tier = "control" if self.control else "withheld"
        return {"tier": tier, "recording": self.recording, "case": self.name}

    @property
    def asks(self) -> dict[str, Any]:
        """What a diagnosis depends on: neither its name nor what will be accepted."""
        return self.model_dump(exclude={"name", "accepted", "known"})

    @property
    def withholds(self) -> bool:
        """Whether anything is withheld at all."""
        return bool(self.effect or self.parameters or self.vehicle)


class Edited(Settings):
    """An effect made in a real recording."""

    recording: str
    effect: str
    value: float

    @property
    def head(self) -> dict[str, str]:
        """Of its row."""
        return {"tier": "edited", "recording": self.recording, "case": f"{self.effect} {self.value:g}"}

    @property
    def asks(self) -> dict[str, Any]:
        """What a diagnosis depends on."""
        return self.model_dump()


class Cases(Settings):
    """What is asked of real recordings of one vehicle; files count from this one, recordings from their folder."""

    vehicle: str
    simulation: str | None = None  # none: the base model is refitted to each recording
    calibrated: dict[str, dict[str, Any]] = Field(default_factory=dict)  # by recording: tables over the vehicle file's
    withheld: list[Withheld] = Field(default_factory=list)
    edited: list[Edited] = Field(default_factory=list)

    @property
    def size(self) -> int:
        """How many questions."""
        return len(self.withheld) + len(self.edited)

    def edits_of(self, recording: str) -> tuple[str, ...]:
        """The effects that are made in one recording."""
        return tuple(sorted({edit.effect for edit in self.edited if edit.recording == recording}))

    def vehicle_file(self, file: Path) -> Path:
        """Of these questions of `file`."""
        return file.parent / self.vehicle

    def simulation_file(self, file: Path) -> Path | None:
        """Of these questions of `file`."""
        return None if self.simulation is None else file.parent / self.simulation


def read_cases(file: Path) -> Cases:
    """The questions of the TOML `file`.

    Raises:
        InputRefused: what is no such file, or what would be answered rightly by asking nothing.
    """
    cases = read_toml(file, Cases, "file of real cases", "pipelines/dart/cases.toml is one")
    path = cases.simulation_file(file)
    simulation = Parameters(parameters={}) if path is None else read_parameters(path)
    for case in cases.withheld:
        _check(case, simulation, file)
    asked = {case.recording for case in cases.withheld} | {edit.recording for edit in cases.edited}
    unasked = set(cases.calibrated) - asked
    if unasked:
        raise InputRefused(file, "calibrated", f"nothing is asked of {', '.join(sorted(unasked))}", "check the names")
    for edit in cases.edited:
        if edit.effect not in EDITS:
            raise InputRefused(file, f"edited {edit.effect!r}", "no such edit", f"one of {', '.join(EDITS)}")
    return cases


def _check(case: Withheld, simulation: Parameters, file: Path) -> None:
    """Raise `InputRefused` where there is nothing to withhold or to accept."""
    place = f"withheld {case.name!r}"
    if case.effect and case.effect not in simulation.effects:
        some = f"one of {', '.join(simulation.effects)}"
        raise InputRefused(file, place, f"the simulation has no {case.effect!r}", some)
    strange = [a for a in case.accepted if a not in (*EFFECTS, VEHICLE, *UNKNOWN)]
    if strange or not case.accepted:
        ids = f"see `bcid effects` for the ids; or {', '.join(UNKNOWN)}"
        raise InputRefused(file, place, f"accepts {strange or 'nothing'}", ids)
    changed = [s for s, v in case.parameters.items() if s not in simulation.parameters or not v > 0.0]
    if changed:
        some = f"one of {', '.join(simulation.parameters) or 'a simulation, which is not named'}, above zero"
        raise InputRefused(file, place, f"changes parameters {', '.join(changed)} of the simulation", some)
    unknown = [k for k in case.known if k not in EFFECTS]
    if unknown or (case.known and not case.control):
        raise InputRefused(file, place, f"knows {unknown or 'something and is no control'}", "see `bcid effects`")
