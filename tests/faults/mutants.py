"""Mutants of files: bytes as disks and cables damage them, cells as people and spreadsheets do."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

Rng = np.random.Generator
Mutator = Callable[[bytes, Rng], bytes]

NASTY = (
    b"", b"nan", b"inf", b"-inf", b"1e400", b"1.#INF", b"-0", b"0x10", b"1,5", b"1;5", b"true", b"None", b"'", b'"',
    b"\x1b[31m", b"<script>", b"[/red]", b"=CMD()", b"../../x", b"\xff\xfe", b"\x00", b"9" * 400, b"-1e-320",
    b"\xc3\xa9", b"\xe2\x88\x921.5", b"12:30", b" ", b"1e9", b"-99999", b"2147483648", b"\n", b"\r", b"\t", b"{",
    b'"""', b"[", b"#", b"1_000",
)  # fmt: skip
EXTREMES = (0, 1, 255, 1 << 16, 1 << 31, 1 << 32, (1 << 62), (1 << 63), (1 << 64) - 1)


def _span(data: bytes, rng: Rng, most: int = 64) -> tuple[int, int]:
    begin = int(rng.integers(len(data)))
    return begin, min(len(data), begin + int(rng.integers(1, most)))


def flip_a_bit(data: bytes, rng: Rng) -> bytes:
    """One bit."""
    changed, at = bytearray(data), int(rng.integers(8 * len(data)))
    changed[at // 8] ^= 1 << at % 8
    return bytes(changed)


def flip_bits(data: bytes, rng: Rng) -> bytes:
    """Up to 32 bits anywhere."""
    for _ in range(int(rng.integers(2, 33))):
        data = flip_a_bit(data, rng)
    return data


def overwrite(data: bytes, rng: Rng) -> bytes:
    """A span of random bytes."""
    a, b = _span(data, rng)
    return data[:a] + rng.bytes(b - a) + data[b:]


def zeros(data: bytes, rng: Rng) -> bytes:
    """A span that was never written."""
    a, b = _span(data, rng, 4096)
    return data[:a] + bytes(b - a) + data[b:]


def delete(data: bytes, rng: Rng) -> bytes:
    """A span that is lost."""
    a, b = _span(data, rng, 4096)
    return data[:a] + data[b:]


def repeat(data: bytes, rng: Rng) -> bytes:
    """A span that comes twice."""
    a, b = _span(data, rng, 4096)
    return data[:b] + data[a:b] + data[b:]


def exchange(data: bytes, rng: Rng) -> bytes:
    """Two halves of a span in the other order."""
    a, b = _span(data, rng, 4096)
    middle = (a + b) // 2
    return data[:a] + data[middle:b] + data[a:middle] + data[b:]


def cut(data: bytes, rng: Rng) -> bytes:
    """The file's beginning."""
    return data[: int(rng.integers(len(data)))]


def append(data: bytes, rng: Rng) -> bytes:
    """More behind the end."""
    return data + (bytes if rng.random() < 0.5 else rng.bytes)(int(rng.integers(1, 256)))


def number(data: bytes, rng: Rng) -> bytes:
    """Eight bytes that read as an extreme number: lengths, counts and stamps."""
    at = int(rng.integers(max(1, len(data) - 8)))
    return data[:at] + int(rng.choice(np.array(EXTREMES, dtype=object))).to_bytes(8, "little") + data[at + 8 :]


def cell(data: bytes, rng: Rng) -> bytes:
    """A cell, or a value between quotes and commas, that holds something nasty."""
    lines = data.split(b"\n")
    row = int(rng.integers(len(lines)))
    cells = lines[row].split(b",")
    cells[int(rng.integers(len(cells)))] = NASTY[int(rng.integers(len(NASTY)))]
    lines[row] = b",".join(cells)
    return b"\n".join(lines)


def cells(data: bytes, rng: Rng) -> bytes:
    """Several of them."""
    for _ in range(int(rng.integers(2, 20))):
        data = cell(data, rng)
    return data


def lines(data: bytes, rng: Rng) -> bytes:
    """Lines lost, doubled, or in another order."""
    rows = data.split(b"\n")
    a = int(rng.integers(len(rows)))
    b = min(len(rows), a + int(rng.integers(1, 50)))
    part = rows[a:b]
    how = int(rng.integers(4))
    if how == 0:
        part = []
    elif how == 1:
        part = part + part
    elif how == 2:
        part = [part[i] for i in rng.permutation(len(part))]
    else:
        part = [row[: int(rng.integers(len(row) + 1))] for row in part]
    return b"\n".join([*rows[:a], *part, *rows[b:]])


def separators(data: bytes, rng: Rng) -> bytes:
    """Other separators or decimal signs, everywhere or once."""
    old, new = [(b",", b";"), (b".", b","), (b",", b"\t"), (b"\n", b"\r\n"), (b"\n", b"\r"), (b",", b", ")][
        int(rng.integers(6))
    ]
    return data.replace(old, new, -1 if rng.random() < 0.5 else 1)


def encoding(data: bytes, rng: Rng) -> bytes:
    """Other encodings of the same text."""
    text = data.decode("utf-8", "replace")
    return text.encode(["utf-16", "utf-16-le", "utf-8-sig", "latin-1", "utf-32"][int(rng.integers(5))], "replace")


BYTES: tuple[Mutator, ...] = (
    flip_a_bit, flip_bits, overwrite, zeros, delete, repeat, exchange, cut, append, number,
)  # fmt: skip
TEXT: tuple[Mutator, ...] = (*BYTES[:9], cell, cells, cells, lines, lines, separators, encoding)
