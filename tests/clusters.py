"""Dask clusters of this machine for tests, begun as a user begins them."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

import pytest


class DaskCluster(NamedTuple):
    """A scheduler and the process that began its workers."""

    address: str
    scheduler: subprocess.Popen[bytes]
    workers: subprocess.Popen[bytes]


@contextmanager
def run_cluster(folder: Path, count: int, *options: str) -> Iterator[DaskCluster]:
    """A cluster of `count` workers, which are given further `options`; its log is in `folder`."""
    if find_spec("distributed") is None:
        pytest.skip("the extra fleet is not installed")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
    words = (
        ["dask_scheduler", "--host", address, "--no-dashboard"],
        ["dask_worker", address, "--nworkers", str(count), "--no-dashboard", *options],
    )
    # jobs of tests are found by the names of their modules, which are those of files seen from the repository
    homes = [str(Path(__file__).parents[1]), str(Path(__file__).parent)]
    path = os.pathsep.join([*homes, *os.environ.get("PYTHONPATH", "").split(os.pathsep)])
    with (folder / "log").open("w", encoding="utf-8") as log:
        scheduler, workers = (
            subprocess.Popen(
                [sys.executable, "-m", f"distributed.cli.{command}", *more],
                cwd=folder, stdout=log, stderr=log, env=os.environ | {"PYTHONPATH": path},
            )
            for command, *more in words
        )  # fmt: skip
    until = time.monotonic() + 60.0
    try:
        while (folder / "log").read_text(encoding="utf-8").count("Registered to") < count:
            if time.monotonic() > until:
                pytest.fail((folder / "log").read_text(encoding="utf-8")[-2000:])
            time.sleep(0.2)
        yield DaskCluster(address, scheduler, workers)
    finally:
        for process in (workers, scheduler):
            process.terminate()
        for process in (workers, scheduler):
            process.wait(30.0)
