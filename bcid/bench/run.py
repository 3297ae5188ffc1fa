"""The table of what can be timed, and the JSON of the timings."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from bcid.bench import exports, filters, fits, reading, rollouts
from bcid.bench.timing import Skipped, Timing

SCHEMA = "bcid.bench/1"
PEERS = (
    "numpy", "casadi", "jax", "torch", "onnxruntime", "pysindy", "deepSI", "deap", "filterpy", "scipy", "pyarrow",
    "pandas", "mcap",
)  # fmt: skip

HOT_PATHS: dict[str, Callable[[int], Iterator[Timing | Skipped]]] = {
    "newton-euler": rollouts.time_newton_euler_rollout,
    "newton-euler-many": rollouts.time_many_newton_euler_rollouts,
    "perceptrons": rollouts.time_k_mlp_rollout,
    "k-sindy": rollouts.time_k_sindy_rollout,
    "filters": filters.time_filters,
    "reading": reading.time_reading,
    "training": fits.time_training_epoch,
    "least-squares": fits.time_least_squares,
    "fit": fits.time_white_box_fit,
    "exports": exports.time_exported_steps,
}
"""Functions that time a hot path, by the name that `bcid bench --only` takes; their argument is the number of turns."""


def summarise_timings(
    timed: Mapping[str, Sequence[Timing | Skipped]], repeats: int, machine: dict[str, Any]
) -> dict[str, Any]:
    """The speed benchmark's JSON (`bcid.bench/1`): timings, peers skipped and why, versions, and goals that are missed.

    `timed` holds what was timed by the name in HOT_PATHS, which is "only" of a row.  `repeats` is the number of turns
    that were timed, `machine` describes the computer; both are taken over as they are.
    """
    rows = [(name, row) for name, several in timed.items() for row in several]
    timings = [{"only": name} | row.as_json() for name, row in rows if isinstance(row, Timing)]
    return {
        "schema": SCHEMA, "machine": machine, "repeats": repeats, "versions": library_versions(), "rows": timings,
        "skipped": [{"only": name} | asdict(row) for name, row in rows if isinstance(row, Skipped)],
        "missed": list_missed(timings),
    }  # fmt: skip


def list_missed(rows: Iterable[Mapping[str, Any]]) -> list[str]:
    """Texts that name each row of the benchmark's JSON whose goal is missed: "PATH against PEER"."""
    return [f"{row['path']} against {row['peer']}" for row in rows if row["missed"]]


def library_versions() -> dict[str, str | None]:
    """Installed versions of numba and of the peers' libraries; None for one that is not installed."""
    versions = dict[str, str | None]()
    for name in ("numba", *PEERS):
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            versions[name] = None  # its rows are left out
    return versions
