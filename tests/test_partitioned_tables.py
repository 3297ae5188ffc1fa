"""Many recordings as tables in parts, which other programs read as one table."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from bcid.cli.app import app
from bcid.errors import InputRefused
from bcid.pipeline import partitioned_tables
from bcid.recording.cuts import read_cut_recording
from bcid.recording.formats.raw import TimeCut
from bcid.recording.read import read_recording
from bcid.vehicle import Vehicle


def _read_by_pandas(folder: Path) -> dict[str, list[object]]:
    import pandas as pd

    table = pd.read_parquet(folder)
    return {name: table[name].astype(str if name == "recording" else float).tolist() for name in table}


def _read_by_pyarrow(folder: Path) -> dict[str, list[object]]:
    import pyarrow.dataset as ds

    return dict(ds.dataset(folder, partitioning="hive").to_table().to_pydict())


def _read_by_polars(folder: Path) -> dict[str, list[object]]:
    polars = pytest.importorskip("polars", reason="polars is not installed")
    return dict(polars.read_parquet(folder / "**" / "*.parquet", hive_partitioning=True).to_dict(as_series=False))


def _read_by_duckdb(folder: Path) -> dict[str, list[object]]:
    duckdb = pytest.importorskip("duckdb", reason="DuckDB is not installed")
    place = (folder / "*" / "*.parquet").as_posix()
    table = duckdb.read_parquet(place, hive_partitioning=True).fetchnumpy()
    return {name: column.tolist() for name, column in table.items()}


def _read_by_spark(folder: Path) -> dict[str, list[object]]:
    sql = pytest.importorskip("pyspark.sql", reason="Spark is not installed")
    rows = sql.SparkSession.builder.master("local[1]").getOrCreate().read.parquet(str(folder)).collect()
    return {name: [row[name] for row in rows] for name in rows[0].asDict()}


TABLE_READERS = (_read_by_pandas, _read_by_pyarrow, _read_by_polars, _read_by_duckdb, _read_by_spark)


@pytest.fixture(scope="module")
def parted(takes: dict[str, Path], vehicle_file: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two takes, one of them twice, written as tables in parts by two commands."""
    folder = tmp_path_factory.mktemp("parted")
    for words in ([str(takes["motive"]), f"{takes['mcap']}[5:20]"], [f"{takes['mcap']}[20:30]"]):
        line = ["ingest", *words, "--vehicle", str(vehicle_file), "--out", str(folder / "w")]
        line += ["--table", str(folder / "tables")]
        assert CliRunner().invoke(app, line, catch_exceptions=False).exit_code == 0
        with pytest.raises(InputRefused, match="exists already"):
            CliRunner().invoke(app, line, catch_exceptions=False)
    return folder / "tables"


@pytest.mark.parametrize("read", TABLE_READERS)
def test_tables_in_parts_are_read_as_one(
    parted: Path, takes: dict[str, Path], vehicle: Vehicle, read: Callable[[Path], dict[str, list[object]]]
) -> None:
    expected = {
        "drive": read_recording(takes["motive"], vehicle),
        **{
            f"drive_m[{a}:{b}]": read_cut_recording(takes["mcap"], vehicle, None, False, TimeCut(a, b))
            for a, b in ((5, 20), (20, 30))
        },
    }
    for table, names in (("poses", ("x_m", "y_m", "yaw_rad")), ("commands", ("steering_rad", "throttle_mps"))):
        columns = read(parted / table)
        assert set(columns) == {"time_s", *names, "recording"}
        owners = np.array(columns["recording"])
        assert set(owners) == set(expected)
        for name, recording in expected.items():
            stream = recording.poses if table == "poses" else recording.commands
            own = np.column_stack([np.array(columns[c], dtype=float)[owners == name] for c in ("time_s", *names)])
            own = own[np.argsort(own[:, 0])]
            assert np.array_equal(own, np.column_stack([stream.time_s, stream.values])), name


def test_each_column_of_a_table_in_parts_says_its_unit(parted: Path) -> None:
    import pyarrow.parquet as pq

    for path in parted.rglob("*.parquet"):
        for field in pq.read_schema(path):
            assert field.metadata[b"unit"].decode() == partitioned_tables.UNITS[field.name]
