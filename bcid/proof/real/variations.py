"""Other ways to ask the same question: from another start, or of three quarters of the drive.

A right answer hangs on neither, so that the share of answers that differ says how far one of them is a lottery.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from bcid.diagnosis.reference_model import ReferenceModel
from bcid.estimate.types import Estimate
from bcid.models.newton_euler.initial_guess import guess_car
from bcid.recording.types import Recording, Stream
from bcid.vehicle import Vehicle


class QuestionVariation(NamedTuple):
    """One way to ask a question: factors of the car that the fit begins with, and the part of the drive kept."""

    name: str
    factors: tuple[tuple[str, float], ...] = ()  # by base parameter
    part: tuple[float, float] = (0.0, 1.0)  # begin and end as shares of the drive


AS_ASKED = QuestionVariation("as asked")

STARTS = (
    QuestionVariation(
        "tyres and drag × 1.5", tuple((s, 1.5) for s in ("C_f", "C_r", "F_f_max", "F_r_max", "R_1", "R_2"))
    ),
    QuestionVariation("motor / 1.3", (("K_t", 1.0 / 1.3), ("F_m_max", 1.0 / 1.3))),
)  # fmt: skip
"""Starts of the base fit beside that of the question itself."""

PARTS = (
    QuestionVariation("first three quarters", part=(0.0, 0.75)),
    QuestionVariation("last three quarters", part=(0.25, 1.0)),
)
"""Parts of the drive on which a question is asked again."""


def move_start(
    reference: ReferenceModel | None, variation: QuestionVariation, estimates: list[Estimate], vehicle: Vehicle
) -> ReferenceModel | None:
    """The reference model with a fit that begins at another car, by the factors of a `variation`.

    What the simulation is, and how far it is trusted, stays.  Without a reference it is the car that a diagnosis
    guesses from the `estimates`, to be refitted freely.
    """
    if not variation.factors:
        return reference
    if reference is None:
        car = guess_car(estimates, vehicle, *estimates[0].steering_constants())._replace(u_0=0.0)
        reference = ReferenceModel(car, {})
    return reference._replace(begin=dict(variation.factors))


def cut_recording(recording: Recording, begin: float, end: float) -> Recording:
    """The part of a recording between two shares of its length, with the command that holds as it begins.

    Its times are those of the whole recording.
    """
    if (begin, end) == (0.0, 1.0):
        return recording
    t_0 = float(recording.poses.time_s[0])
    low, high = t_0 + begin * recording.duration_s, t_0 + end * recording.duration_s
    channels = {name: _cut_stream(stream, low, high, holds=True) for name, stream in recording.channels.items()}
    return replace(
        recording, poses=_cut_stream(recording.poses, low, high), channels=channels,
        commands=_cut_stream(recording.commands, low, high, holds=True),
        breaks_s=tuple(t for t in recording.breaks_s if low < t <= high),
    )  # fmt: skip


def _cut_stream(stream: Stream, low: float, high: float, holds: bool = False) -> Stream:
    """The samples of a stream from `low` to `high` (s), with the one before where a sample `holds` until the next."""
    first = int(np.searchsorted(stream.time_s, low, side="left"))
    last = int(np.searchsorted(stream.time_s, high, side="right"))
    if holds and first > 0 and (first == len(stream) or stream.time_s[first] > low):
        first -= 1
    return Stream(stream.time_s[first:last], stream.values[first:last])
