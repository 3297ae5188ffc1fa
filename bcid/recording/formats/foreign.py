"""Files of programs whose formats are not read: what each is, by its suffix or first bytes, and what converts it."""

from pathlib import Path
from typing import NamedTuple

AS_CSV = "save it as CSV (UTF-8), and map its columns in the vehicle file: [columns]"
BY_PANDAS = "write its columns as a table (pandas: DataFrame.to_csv or to_parquet), and map them: [columns]"
UNPACK = "unpack it, and name the file inside"


class ForeignFormat(NamedTuple):
    """A format that is not read: how its files begin, their suffixes, what they are, and the next step."""

    magics: tuple[bytes, ...]
    suffixes: tuple[str, ...]
    what: str
    next_step: str


FOREIGN = (
    ForeignFormat(
        (), (".tak",), "is a take of Motive's own format",
        "open it in Motive: File, Export Tracking Data, as CSV with rigid bodies",
    ),
    ForeignFormat(
        (b"\x02P", b"\x03P", b"\x04P"), (".c3d",), "is a C3D file of marker positions",
        "export the rigid body as CSV from the tracking program (Vicon Nexus: Export ASCII; Qualisys: TSV, 6D)",
    ),
    ForeignFormat((b"\xd0\xcf\x11\xe0",), (".xls", ".xlsx", ".xlsm", ".ods", ".numbers"), "is a spreadsheet", AS_CSV),
    ForeignFormat((b"\x93NUMPY",), (".npy", ".npz"), "is an archive of NumPy arrays", BY_PANDAS),
    ForeignFormat(
        (b"MATLAB ",), (".mat",), "is a MATLAB file",
        "write its columns as a table (MATLAB: writetable or parquetwrite), and map them: [columns]",
    ),
    ForeignFormat((b"\x89HDF\r\n\x1a\n",), (".h5", ".hdf5", ".hdf"), "is an HDF5 file", BY_PANDAS),
    ForeignFormat((b"ARROW1", b"FEA1"), (".arrow", ".feather"), "is an Arrow or Feather table", BY_PANDAS),
    ForeignFormat((b"ULog\x01\x12\x35",), (".ulg",), "is a log of PX4", f"run ulog2csv on it; {BY_PANDAS}"),
    ForeignFormat((), (".pkl", ".pickle"), "is a pickle, which can run programs and is never opened", BY_PANDAS),
    ForeignFormat((b"{", b"["), (".json", ".jsonl", ".ndjson"), "is a JSON text", BY_PANDAS),
    ForeignFormat((), (".bvh", ".trc", ".fbx"), "is a file of a skeleton or of markers", f"export poses; {AS_CSV}"),
    ForeignFormat((b"%PDF",), (".pdf",), "is a PDF document", "name the recording itself"),
    ForeignFormat((b"\x1f\x8b",), (".gz", ".tgz"), "is compressed (gzip)", UNPACK),
    ForeignFormat((b"BZh",), (".bz2",), "is compressed (bzip2)", UNPACK),
    ForeignFormat((b"\xfd7zXZ",), (".xz",), "is compressed (xz)", UNPACK),
    ForeignFormat((b"7z\xbc\xaf",), (".7z",), "is an archive (7z)", UNPACK),
    ForeignFormat((b"PK\x03\x04",), (".zip",), "is an archive (zip), or a document that is one", UNPACK),
)  # fmt: skip
"""The formats that people have instead; a suffix counts before the first bytes, which several share."""
READ_AS_TEXT = (".csv", ".txt", ".tsv")


def explain_foreign(path: Path, head: bytes) -> tuple[str, str] | None:
    """What a file that is not read is, and the next step, by its suffix or its first bytes `head`; None if unknown."""
    suffix = path.suffix.lower()
    by_suffix = next((f for f in FOREIGN if suffix in f.suffixes), None)
    by_head = next((f for f in FOREIGN if head.startswith(f.magics) and f.magics), None)
    # a table may begin with any sign, an archive that is named as a table is none
    chosen = by_suffix or (by_head if suffix not in READ_AS_TEXT or not head.isascii() else None)
    return None if chosen is None else (f"{chosen.what}, which is not read", chosen.next_step)
