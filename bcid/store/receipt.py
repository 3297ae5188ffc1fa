"""Results beside which their folder keeps the digests that they were written with: these may be renewed, no others."""

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

from bcid.files.json import read_json, write_json
from bcid.files.outputs import OTHER_FOLDER, refuse_to_overwrite, replace_whole, staged_outputs
from bcid.store.artifact import file_sha256

RECEIPT = ".written.json"
_DIGESTS = "written"


def refuse_to_renew(folder: Path, names: Iterable[str], force: bool = False) -> None:
    """Do nothing where the files `names` in `folder` are absent, or as `renew_results` wrote them, or with `force`.

    Raises:
        InputRefused: one of them was edited, or written by somebody else.
    """
    written = _read_digests(folder)
    refuse_to_overwrite([folder / name for name in names], lambda path: force or file_sha256(path) in written)


def renew_results(folder: Path, writers: Mapping[str, Callable[[Path], object]], force: bool = False) -> None:
    """Write results into `folder` by `writers`, a function of the path for each name, and replace those of before.

    Raises:
        InputRefused: one is there that was edited, or written by somebody else, and not `force`.
        DiskFull: the disk is full.
    """
    written = _read_digests(folder)
    with staged_outputs(folder, lambda path: force or file_sha256(path) in written) as staged:
        for name, write in writers.items():
            write(staged / name)
        # before they are in their places, so that an interruption leaves no result that is not known
        digests = sorted(written | {file_sha256(staged / name) for name in writers})
        replace_whole(folder / RECEIPT, lambda path: write_json(path, {_DIGESTS: digests}), OTHER_FOLDER)


def _read_digests(folder: Path) -> frozenset[str]:
    """SHA-256 of all files that `renew_results` has written into `folder`; none where its receipt cannot be read."""
    try:
        digests = read_json(folder / RECEIPT)[_DIGESTS]
    except (OSError, ValueError, KeyError):
        return frozenset()
    return frozenset(map(str, digests)) if isinstance(digests, list) else frozenset()
