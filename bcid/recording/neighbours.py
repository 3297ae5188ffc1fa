"""Which other file of a recording's folder holds the commands that fit its motion, where its own do not."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from bcid.errors import BcidError
from bcid.recording.checks.commanded_motion import compare_on_grid
from bcid.recording.checks.limits import AGREEMENT as LIMITS
from bcid.recording.checks.steering_verdict import judge_steering
from bcid.recording.checks.turning import prepare_turning
from bcid.recording.checks.verdict import FOREIGN
from bcid.recording.formats.detect import COMMANDS_ENDING, detect_format
from bcid.recording.formats.rosbag import BAG_METADATA
from bcid.recording.read import read_raw_take
from bcid.recording.types import Irregularity, Recording, Stream, command_source_path
from bcid.vehicle import Vehicle


def find_fitting_commands(path: Path, recording: Recording, vehicle: Vehicle) -> Path | None:
    """The file beside a recording at `path` whose commands explain its turning; None where there is none.

    At most `AGREEMENT.max_neighbours` files, or folders of bags, of at most `AGREEMENT.max_neighbour_bytes` are read.
    """
    own = Path(command_source_path(recording.sources)).name
    beside = [p for p in _list_alike(path) if p.name != own]
    shares = dict[Path, float]()
    for other in beside[: LIMITS.max_neighbours]:
        share = _share_explained(path, other, recording, vehicle)
        if share > LIMITS.least_share:
            shares[other] = share
    return max(shares, key=lambda p: shares[p], default=None)


def _list_alike(path: Path) -> list[Path]:
    """What lies beside a recording at `path` and may hold the commands of its motion, by name; [] if nobody may look.

    Beside a Motive export these are commands files, beside a bag's folder such folders, else files of its suffix.
    """
    # a path such as "." has no name, and no folder above it
    path = path if path.name not in ("", "..") else path.resolve()
    motive = not path.is_dir() and detect_format(path) == "motive"
    try:
        others = sorted(p for p in path.parent.iterdir() if p.name != path.name)
    except OSError:
        return []
    if path.is_dir():
        return [p for p in others if (p / BAG_METADATA).is_file() and _is_small(p)]
    alike = (p for p in others if (p.name.endswith(COMMANDS_ENDING) if motive else p.suffix == path.suffix))
    return [p for p in alike if p.is_file() and _is_small(p)]


def _is_small(path: Path) -> bool:
    """Whether a file, or all files in a folder, have at most `AGREEMENT.max_neighbour_bytes`; not if it has gone."""
    try:
        files = list(path.iterdir()) if path.is_dir() else [path]
        return sum(p.stat().st_size for p in files) <= LIMITS.max_neighbour_bytes
    except OSError:
        return False


def _share_explained(path: Path, other: Path, recording: Recording, vehicle: Vehicle) -> float:
    """The share of a recording's turning that the commands in `other` explain; 0 where it cannot be read.

    The vehicle file's clock offset counts for them as for the recording's own, less the mean age that it states.
    """
    try:
        if other.name.endswith(COMMANDS_ENDING):
            raw = read_raw_take(path, vehicle, other)
        else:
            raw = read_raw_take(other, vehicle)
    except (BcidError, OSError):
        return 0.0
    known = np.isfinite(raw.command).all(axis=1) & np.isfinite(raw.command_time_s)
    time_s, rows = np.unique(raw.command_time_s[known], return_index=True)
    if len(time_s) < 2:
        return 0.0
    offset_s = vehicle.clock.offset_s - 0.5 * (vehicle.clock.commands_read_every_s or 0.0)
    changed = replace(recording, commands=Stream(time_s + offset_s, raw.command[known][rows]))
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
