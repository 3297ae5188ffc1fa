"""The MCAP file of a view, with the layout that shows it and the vehicle file that reads it back; all or none."""

import json
from collections.abc import Iterable
from pathlib import Path
from typing import IO, Any, NamedTuple

from bcid import __version__
from bcid.files.outputs import MayReplace, staged_outputs
from bcid.view.content import Attachment, ViewContent
from bcid.view.layout import make_layout
from bcid.view.schemas import schema_bytes
from bcid.view.topics import Topic, list_topics
from bcid.view.vehicle_file import vehicle_toml, view_vehicle

METADATA_NAME, VEHICLE_NAME = "bcid", "view.vehicle.toml"
OTHER_FILE = "name another file with --out"


class WrittenView(NamedTuple):
    """The files of a view, and how many messages of which type each topic holds."""

    mcap: Path
    layout: Path
    vehicle: Path
    topics: dict[str, tuple[str, int]]


def view_files(path: Path) -> tuple[Path, Path, Path]:
    """The files of the view whose MCAP file is `path`: it, its layout, and its vehicle file."""
    return path, path.with_suffix(".layout.json"), path.with_suffix(".vehicle.toml")


def write_view(content: ViewContent, path: Path, may_replace: MayReplace) -> WrittenView:
    """Write a view to the MCAP file `path`, and NAME.layout.json and NAME.vehicle.toml beside it.

    The same content gives the same bytes.

    Raises:
        InputRefused: a file would be overwritten that may not be, or the folder cannot be written to.
        DiskFull: the disk is full.
    """
    topics, files = list_topics(content), view_files(path)
    reading = vehicle_toml(view_vehicle(content.vehicle, content.recording))
    with staged_outputs(path.parent, may_replace, OTHER_FILE) as folder:
        mcap, layout, vehicle = (folder / file.name for file in files)
        with mcap.open("wb") as file:
            _write_mcap(file, content, topics, reading)
        layout.write_text(json.dumps(make_layout(content, [t.name for t in topics]), indent=1), encoding="utf-8")
        vehicle.write_text(reading, encoding="utf-8")
    return WrittenView(*files, {t.name: (t.schema, len(t.messages)) for t in topics})


def _write_mcap(file: IO[bytes], content: ViewContent, topics: Iterable[Topic], reading: str) -> None:
    """Write the messages of all topics in the order of their stamps, with attachments and metadata.

    Among the attachments is the text of the vehicle file for `reading` the view back.

    Messages lie in compressed chunks with checksums and indexes, so that viewers can jump to any time.
    """
    from mcap.writer import CompressionType, Writer

    writer = Writer(file, compression=CompressionType.ZSTD, enable_crcs=True, enable_data_crcs=True)
    writer.start(library=f"bcid {__version__}")
    schemas, timed = dict[str, int](), list[tuple[int, int, dict[str, Any]]]()
    for topic in topics:
        if topic.schema not in schemas:
            schemas[topic.schema] = writer.register_schema(topic.schema, "jsonschema", schema_bytes(topic.schema))
        channel = writer.register_channel(topic.name, "json", schemas[topic.schema])
        timed += [(ns, channel, message) for ns, message in topic.messages]
    for ns, channel, message in sorted(timed, key=lambda t: t[:2]):
        data = json.dumps(message, separators=(",", ":"), allow_nan=False, ensure_ascii=False).encode()
        writer.add_message(channel, log_time=ns, publish_time=ns, data=data)
    zero = content.zero_ns
    for attachment in (*content.attachments, Attachment(VEHICLE_NAME, "application/toml", reading.encode())):
        writer.add_attachment(zero, zero, attachment.name, attachment.media_type, attachment.data)
    writer.add_metadata(METADATA_NAME, _metadata(content))
    writer.finish()  # type: ignore[no-untyped-call]


def _metadata(content: ViewContent) -> dict[str, str]:
    """What a view was made from, by name, as texts."""
    sources = {f"source {k} sha256": s.sha256 for k, s in enumerate(content.recording.sources, 1)}
    return {
        "made_by": f"bcid {__version__}", "recording": content.recording.name, "zero_ns": str(content.zero_ns),
        "point": "centre of gravity, as far as the vehicle file says how the tracked body is mounted", **sources,
        **content.facts,
    }  # fmt: skip
