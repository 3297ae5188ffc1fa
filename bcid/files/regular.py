"""Files that are read whole: regular ones of a bounded size, so that a pipe or a device is never waited for."""

from pathlib import Path


def check_regular_file(path: Path, max_bytes: int) -> None:
    """Raise unless `path` is a regular file of at most `max_bytes`, which can be read whole.

    Raises:
        OSError: there is no such file, or it cannot be looked at.
        ValueError: it is a folder, a pipe or a device, or is larger.
    """
    size = path.stat().st_size
    if not path.is_file():
        raise ValueError("is not a regular file")
    if size > max_bytes:
        raise ValueError(f"has {size} bytes, {max_bytes} are the most")


def read_regular_file(path: Path, max_bytes: int) -> bytes:
    """The content of the regular file at `path`, which has at most `max_bytes`.

    Raises:
        OSError: there is no such file, or it cannot be read.
        ValueError: it is a folder, a pipe or a device, or is larger.
    """
    check_regular_file(path, max_bytes)
    return path.read_bytes()
