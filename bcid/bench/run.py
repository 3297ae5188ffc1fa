"""All rows of the benchmark, and its JSON."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from bcid.bench import fits, rollouts
from bcid.bench.timing import Row

SCHEMA = "bcid.bench/1"
PEERS = ("numpy", "casadi", "torch", "onnxruntime", "pysindy", "deepSI", "deap", "filterpy")

PATHS: dict[str, Callable[[int], Iterator[Row]]] = {
    "newton-euler": rollouts.newton_euler,
    "newton-euler-many": rollouts.many_newton_eulers,
    "perceptrons": rollouts.perceptrons,
    "k-sindy": rollouts.sparse_sum,
    "filters": fits.filters,
    "training": fits.training,
    "fit": fits.white_box,
}
"""What can be timed, by the name that `bcid bench --only` takes."""


def run(names: Sequence[str], repeats: int) -> Iterator[Row]:
    """The rows of `names`, each as it is found."""
    for name in names:
        yield from PATHS[name](repeats)


def outcome(rows: Sequence[Row], repeats: int, machine: dict[str, Any]) -> dict[str, Any]:
    """The benchmark's JSON."""
    return {
        "schema": SCHEMA, "machine": machine, "repeats": repeats, "versions": versions(),
        "rows": [row.as_json() for row in rows], "missed": [f"{r.path} against {r.peer}" for r in rows if r.missed],
    }  # fmt: skip


def versions() -> dict[str, str | None]:
    """Of numba and the peers; None of one that is not installed."""
    found = dict[str, str | None]()
    for name in ("numba", *PEERS):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = None  # its rows are left out
    return found
