"""Which other file of a recording's folder holds the commands that fit its motion, where its own do not."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from bcid.errors import BcidError
from bcid.recording.checks.commanded_motion import compare_on_grid
from bcid.recording.checks.steering_verdict import judge_steering
from bcid.recording.checks.turning import prepare_turning
from bcid.recording.checks.verdict import FOREIGN
from bcid.recording.formats.detect import detect_format
from bcid.recording.limits import AGREEMENT as LIMITS
from bcid.recording.read import read_raw_take
from bcid.recording.types import Irregularity, Recording, Stream, command_source_path
from bcid.vehicle import Vehicle

COMMANDS_ENDING = ".commands.csv"


def find_fitting_commands(path: Path, recording: Recording, vehicle: Vehicle) -> Path | None:
    """The file beside a recording at `path` whose commands explain its turning; None where there is none.

    Of a Motive export other commands files are tried, of any other format other recordings; at most
    `AGREEMENT.max_neighbours` files of at most `AGREEMENT.max_neighbour_bytes` are read.
    """
    ending = COMMANDS_ENDING if detect_format(path) == "motive" else path.suffix
    own = {path.name, Path(command_source_path(recording.sources)).name}
    beside = [
        p for p in sorted(path.parent.glob(f"*{ending}"))
        if p.name not in own and p.is_file() and p.stat().st_size <= LIMITS.max_neighbour_bytes
    ]  # fmt: skip
    shares = dict[Path, float]()
    for other in beside[: LIMITS.max_neighbours]:
        share = _share_explained(path, other, recording, vehicle)
        if share > LIMITS.least_share:
            shares[other] = share
    return max(shares, key=lambda p: shares[p], default=None)


def _share_explained(path: Path, other: Path, recording: Recording, vehicle: Vehicle) -> float:
    """The share of a recording's turning that the commands in the file `other` explain; 0 where it cannot be read."""
    try:
        if other.name.endswith(COMMANDS_ENDING):
            raw = read_raw_take(path, vehicle, other)
        else:
            raw = read_raw_take(other, vehicle)
    except BcidError:
        return 0.0
    known = np.isfinite(raw.command).all(axis=1) & np.isfinite(raw.command_time_s)
    time_s, rows = np.unique(raw.command_time_s[known], return_index=True)
    if len(time_s) < 2:
        return 0.0
    changed = replace(recording, commands=Stream(time_s, raw.command[known][rows]))
    data = prepare_turning(changed, vehicle)
    if data is None:
        return 0.0
    agreement = judge_steering(compare_on_grid(changed, data, vehicle), changed, vehicle)
    return agreement.share if agreement.verdict is None and agreement.judged else 0.0


def name_fitting_commands(path: Path, recording: Recording, vehicle: Vehicle) -> Recording:
    """The recording whose verdict on commands of another take names the file that fits better, if there is one."""
    if not any(odd.kind == FOREIGN for odd in recording.irregularities):
        return recording
    better = find_fitting_commands(path, recording, vehicle)
    if better is None:
        return recording
    named = f"those of {better.name} fit; "

    def add_name(odd: Irregularity) -> Irregularity:
        cause, _, step = odd.detail.rpartition("; ")
        return replace(odd, detail=f"{cause}; {named}{step}") if odd.kind == FOREIGN else odd

    return replace(recording, irregularities=tuple(add_name(odd) for odd in recording.irregularities))
