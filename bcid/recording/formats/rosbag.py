"""The folder of a ROS 2 bag: which files its metadata.yaml names, and which of them are there and can be read.

rosbag2 writes a list `relative_file_paths` of the recording's parts.  Only they count: another file in the folder may
be of another take.  Parts compressed whole (`ros2 bag record --compression-mode file`) and SQLite bags are not read.
"""

import re
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from typing import NamedTuple

from bcid.errors import InputRefused
from bcid.recording.formats.limits import MESSAGE as LIMITS
from bcid.recording.formats.names import list_names, printable_name

BAG_METADATA = "metadata.yaml"  # beside the parts of a rosbag2 recording
MCAP_SUFFIX, SQLITE_SUFFIX = ".mcap", ".db3"
PACKED_SUFFIXES = {".zstd": "zstd -d", ".zst": "zstd -d", ".lz4": "lz4 -d", ".gz": "gzip -d"}
"""Suffixes of files that are compressed whole, with what unpacks them."""
PACKED_MAGICS = {b"\x28\xb5\x2f\xfd": ".zst", b"\x04\x22\x4d\x18": ".lz4", b"\x1f\x8b": ".gz"}
"""First bytes of such files, whatever they are called."""
PART_NAME = re.compile(r"(.*)_(\d+)\Z")
LIST_KEY = "relative_file_paths:"
REINDEX = "`ros2 bag reindex FOLDER` writes metadata.yaml anew; or name the .mcap file itself"


class BagFolder(NamedTuple):
    """The parts of a bag in order, by their paths, and what is odd about the folder."""

    parts: tuple[Path, ...] = ()  # MCAP files that are read
    missing: tuple[str, ...] = ()  # named and not there
    packed: tuple[Path, ...] = ()  # compressed whole
    sqlite: tuple[Path, ...] = ()
    foreign: tuple[str, ...] = ()  # MCAP files that are not named
    guessed: bool = False  # by the names of the files, as there is no metadata.yaml


def parse_file_list(metadata: str) -> list[str]:
    """The file names in the list `relative_file_paths` of a metadata.yaml, without folders, each once; [] without any.

    Read line by line in linear time, as rosbag2 and YAML writers write the list: a name a line after `-`, or all in
    brackets.
    """
    lines = iter(metadata.splitlines())
    opened = next((line.strip() for line in lines if line.strip().startswith(LIST_KEY)), "")
    rest = opened[len(LIST_KEY) :].strip()
    entries = _read_bracketed_list(rest, lines) if rest.startswith("[") else _read_dashed_list(lines)
    names = [PurePosixPath(_strip_quotes(entry)).name for entry in entries]
    return list(dict.fromkeys(name for name in names if name))


def _read_bracketed_list(first: str, lines: Iterator[str]) -> list[str]:
    """The entries of a list in brackets, which begins with the text `first` and may go on over `lines`."""
    parts = [first[1:]]
    while "]" not in parts[-1]:
        line = next(lines, "]")
        parts.append(line)
    return " ".join(parts).partition("]")[0].split(",")


def _read_dashed_list(lines: Iterator[str]) -> list[str]:
    """The entries of a list of one line each, up to the first line that is none; blank lines and comments aside."""
    entries = []
    for line in lines:
        text = line.strip()
        if text.startswith("- "):
            entries.append(text[2:])
        elif text and not text.startswith("#"):
            break
    return entries


def _strip_quotes(entry: str) -> str:
    """A scalar of a YAML list without its quotes, or without a comment behind it."""
    text = entry.strip()
    if text[:1] in ("'", '"') and (end := text.find(text[0], 1)) > 0:
        return text[1:end]
    return text.partition(" #")[0].strip()


def read_bag_folder(folder: Path) -> BagFolder:
    """What a folder holds of a ROS 2 bag, by its metadata.yaml; without one, by the numbered names of its MCAP files.

    Raises:
        InputRefused: metadata.yaml is too long, or names no files; or without one, the files may be of several takes.
    """
    metadata = folder / BAG_METADATA
    there = sorted(p.name for p in folder.iterdir() if p.is_file())
    mcap_files = [name for name in there if name.endswith(MCAP_SUFFIX)]
    if not metadata.is_file():
        return _guess_bag_folder(folder, mcap_files)
    if metadata.stat().st_size > LIMITS.max_metadata_bytes:
        cause = f"has {metadata.stat().st_size} bytes, {LIMITS.max_metadata_bytes} are the most"
        raise InputRefused(metadata, "file", cause, REINDEX)
    listed = parse_file_list(metadata.read_text(encoding="utf-8", errors="replace"))
    if not listed:
        raise InputRefused(metadata, "relative_file_paths", "names no files", REINDEX)
    parts, missing, packed, sqlite = list[Path](), list[str](), list[Path](), list[Path]()
    for name in listed:
        plain = next((name.removesuffix(s) for s in PACKED_SUFFIXES if name.endswith(s)), name)
        # unpacked since, or packed since
        present = next((n for n in (plain, name, *(plain + s for s in PACKED_SUFFIXES)) if n in there), None)
        if present is None:
            missing.append(name)
        elif present != plain:
            packed.append(folder / present)
        else:
            (sqlite if plain.endswith(SQLITE_SUFFIX) else parts).append(folder / plain)
    foreign = tuple(name for name in mcap_files if folder / name not in parts)
    return BagFolder(tuple(parts), tuple(missing), tuple(packed), tuple(sqlite), foreign)


def _guess_bag_folder(folder: Path, mcap_files: list[str]) -> BagFolder:
    """The parts of a bag whose folder has no metadata.yaml, as when its recorder was killed, by their numbered names.

    Raises:
        InputRefused: the names are not those of one bag's parts.
    """
    numbered = {n: (m[1], int(m[2][:9])) for n in mcap_files if (m := PART_NAME.match(n.removesuffix(MCAP_SUFFIX)))}
    if not mcap_files:
        return BagFolder(guessed=True)
    if len(numbered) < len(mcap_files) or len({prefix for prefix, _ in numbered.values()}) > 1:
        cause = f"has no {BAG_METADATA}, and its files may be of several takes: {list_names(mcap_files)}"
        raise InputRefused(folder, "folder", cause, REINDEX)
    order = sorted(numbered, key=lambda name: numbered[name][1])
    prefix, last = numbered[order[-1]]
    numbers = {number for _, number in numbered.values()}
    lacking = [f"{prefix}_{k}{MCAP_SUFFIX}" for k in range(min(last, len(order) * 2)) if k not in numbers]
    return BagFolder(tuple(folder / name for name in order), tuple(lacking), guessed=True)


def bag_parts(folder: Path) -> list[Path]:
    """The MCAP files of a ROS 2 bag, in order; [] where a folder holds none.

    Raises:
        InputRefused: the bag is one in SQLite, or compressed whole, or its files cannot be told.
    """
    bag = read_bag_folder(folder)
    if bag.parts:
        return list(bag.parts)
    if bag.packed:
        raise InputRefused(bag.packed[0], "file", *explain_packed(bag.packed[0]))
    if bag.sqlite:
        raise InputRefused(bag.sqlite[0], "file", *explain_sqlite(bag.sqlite[0]))
    if bag.missing:
        cause = f"names {list_names(bag.missing)}, which is not there"
        raise InputRefused(folder / BAG_METADATA, "relative_file_paths", cause, "copy the whole folder of the bag")
    return []


def explain_packed(path: Path, suffix: str = "") -> tuple[str, str]:
    """Cause and next step for a file that is compressed whole, such as bag_0.mcap.zstd.

    `suffix` is that of its compression, which unpacking tools want at the name's end; the name's own unless stated.
    """
    suffix, name = suffix or path.suffix, printable_name(path.name)
    cause = f"is compressed whole ({suffix}), which is not read"
    if path.suffix in PACKED_SUFFIXES:
        return cause, f"unpack it: {PACKED_SUFFIXES[path.suffix]} '{name}'"
    return cause, f"name it '{name}{suffix}' and unpack it: {PACKED_SUFFIXES[suffix]} '{name}{suffix}'"


def explain_sqlite(path: Path) -> tuple[str, str]:
    """Cause and next step for a ROS 2 bag in SQLite."""
    name = printable_name(path.name)
    step = f"convert it: mcap convert '{name}' '{name.removesuffix(SQLITE_SUFFIX)}.mcap', or `ros2 bag convert`"
    return "is a ROS 2 bag in SQLite (.db3), which is not read", step


def unread_parts(path: Path) -> list[tuple[Path, str, str]]:
    """Parts of the bag at `path` that hold a part of the recording and cannot be read: path, cause and next step."""
    if not path.is_dir():
        return []
    bag = read_bag_folder(path)
    return [(p, *explain_packed(p)) for p in bag.packed] + [(p, *explain_sqlite(p)) for p in bag.sqlite]


def describe_odd_parts(path: Path) -> list[str]:
    """Sentences on parts of a bag that are missing or not named, or on `path` as one part of several; [] if whole."""
    if path.is_dir():
        bag, texts = read_bag_folder(path), list[str]()
        if bag.guessed:
            read = list_names(p.name for p in bag.parts)
            texts.append(f"a folder without {BAG_METADATA}: read by their names, {read}")
        if bag.missing:
            named = f"a split bag whose {BAG_METADATA} names" if not bag.guessed else "a split bag that should have"
            texts.append(f"{named} {list_names(bag.missing)} too, which is not there")
        if bag.foreign:
            texts.append(f"not named in {BAG_METADATA}, and not read: {list_names(bag.foreign)}")
        return texts
    if path.suffix != MCAP_SUFFIX or not (path.parent / BAG_METADATA).is_file():
        return []
    try:
        bag = read_bag_folder(path.parent)
    except InputRefused:
        # it is not needed for one file
        return []
    others = [p.name for p in (*bag.parts, *bag.packed) if p.name != path.name]
    if path not in bag.parts:
        return [f"not one of the files that {BAG_METADATA} beside it names"] if others else []
    return [f"one part of a split bag: name the folder for {list_names(others)} too"] if others else []
