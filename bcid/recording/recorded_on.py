"""When a recording was made, as far as its file says."""

from datetime import UTC, datetime
from pathlib import Path

from bcid.recording.formats.detect import HEAD_BYTES, MCAP_MAGIC, recording_files

KEY = "Capture Start Time"
"""In the first row of a Motive export, before a local time."""
FIRST_YEAR = 2000
"""Earliest year of a stamp that counts from 1970: earlier ones are of a clock that began with the machine."""


def recorded_on(recording: Path) -> str | None:
    """When a recording was made: a Motive export's own words, or the UTC minute of the first message of an MCAP file.

    None where the file does not say, cannot be read, or has stamps of no calendar.
    """
    first = recording_files(recording)[0]
    try:
        with first.open("rb") as file:
            head = file.read(HEAD_BYTES)
    except OSError:
        return None
    if head.startswith(MCAP_MAGIC):
        return _first_message(first)
    cells = head.partition(b"\n")[0].decode("utf-8", "replace").split(",")
    return dict(zip(cells[::2], cells[1::2], strict=False)).get(KEY, "").strip() or None


def _first_message(path: Path) -> str | None:
    """The UTC minute of the first message of an MCAP file, by its summary; None where it has none."""
    from mcap.exceptions import McapError
    from mcap.reader import make_reader

    try:
        with path.open("rb") as file:
            summary = make_reader(file).get_summary()
        stamp = summary.statistics.message_start_time if summary and summary.statistics else 0
        moment = datetime.fromtimestamp(stamp / 1e9, UTC)
    except (McapError, OSError, ValueError, OverflowError):
        return None
    return f"{moment:%Y-%m-%d %H:%M} UTC" if moment.year >= FIRST_YEAR else None
