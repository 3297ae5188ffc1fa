"""All rows of the catalogue, by their number."""

from __future__ import annotations

from collections.abc import Callable

from catalogue.lab import Lab, Tries

ROWS: dict[int, Callable[[Lab], Tries]] = {}


def row(number: int) -> Callable[[Callable[[Lab], Tries]], Callable[[Lab], Tries]]:
    """Enter what is tried for a row."""

    def enter(f: Callable[[Lab], Tries]) -> Callable[[Lab], Tries]:
        ROWS[number] = f
        return f

    return enter
