"""Poses that a tracker writes where it saw nothing are left out and counted, in every format; a car at zero is not."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from making import circling_take
from test_readers import json_mcap, rewritten

from bcid.recording.checks.lost import drop_lost_poses, find_lost_poses
from bcid.recording.checks.samples import Samples
from bcid.recording.formats.raw import RawTake
from bcid.recording.read import read_raw_take
from bcid.vehicle import Vehicle

N = 600
T = np.arange(N) / 60.0
LOST = np.isin(np.arange(N), [100, *range(200, 230), *range(400, 403)])


def circle() -> np.ndarray:
    """Poses (N, 3) of a car that circles, 1 m off the origin, with noise as cameras have."""
    yaw = 0.6 * T
    clean = np.column_stack([1.0 + np.sin(yaw) / 0.6, 1.0 - np.cos(yaw) / 0.6, yaw])
    return clean + np.random.default_rng(1).normal(0.0, 3e-4, clean.shape)


@pytest.mark.parametrize("written", [[0.0, 0.0, 0.0], [-9999.0] * 3, [-9.999, -9.999, -9999.0], [1e6, 0.0, 0.0]])
def test_placeholders_are_found(written: list[float]) -> None:
    poses = circle()
    poses[LOST] = written
    np.testing.assert_array_equal(find_lost_poses(poses[:, :2], poses[:, 2:]), LOST)
    kept = drop_lost_poses(Samples(T, poses, []))
    np.testing.assert_array_equal(kept.values, poses[~LOST])
    assert [(i.action, i.kind, i.count) for i in kept.irregularities] == [("excluded", "lost pose", LOST.sum())]


def stand_at_zero(poses: np.ndarray) -> np.ndarray:
    """The car stands at the origin to the last digit, as in a simulation, and drives off."""
    stand = np.zeros((200, 3))
    drive = np.column_stack([np.cumsum(np.linspace(0.0, 0.02, N - 200)), np.zeros((N - 200, 2))])
    return np.vstack([stand, drive])


NO_LOSS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "a drive": lambda p: p,
    "rounded to centimetres": lambda p: np.round(p, 2),
    "each pose three times": lambda p: np.repeat(p[::3], 3, axis=0),
    "a stand at zero": stand_at_zero,
    "a stand at zero, then a jump in the record": lambda p: np.vstack([np.zeros((1, 3)), p[1:] - p[1]]),
    "nothing but zeros": lambda p: 0.0 * p,
    "a stop": lambda p: np.vstack([p[:300], np.tile(p[300], (100, 1)), p[300:500]]),
}


@pytest.mark.parametrize("name", list(NO_LOSS))
def test_a_drive_has_no_placeholders(name: str) -> None:
    poses = NO_LOSS[name](circle())
    assert not find_lost_poses(poses[:, :2], poses[:, 2:]).any()


def count_lost(take: RawTake) -> int:
    """How many poses are noted as lost, and left out."""
    return sum(i.count for i in take.irregularities if i.kind == "lost pose" and i.action == "excluded")


def test_lost_poses_of_a_motive_export(vehicle: Vehicle, tmp_path: Path) -> None:
    """Zeros throughout, which are no quaternion, in more rows than may be broken."""

    def change(rows: list[list[str]]) -> list[list[str]]:
        for row in rows[207:307]:
            row[2:9] = ["0.000000"] * 7
        return rows

    take = read_raw_take(rewritten(circling_take(tmp_path), tmp_path / "lost.csv", change), vehicle)
    assert count_lost(take) == 100
    assert np.isnan(take.pose[200:300]).all()
    assert np.isfinite(take.pose[300:]).all()


@pytest.mark.parametrize("turn", [(0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)])
def test_lost_poses_in_messages(turn: tuple[float, ...], vehicle: Vehicle, tmp_path: Path) -> None:
    poses = circle()
    seen = {
        k: ({"x": p[0], "y": p[1], "z": 0.3}, {"x": 0.0, "y": 0.0, "z": np.sin(p[2] / 2), "w": np.cos(p[2] / 2)})
        for k, p in enumerate(poses)
    }
    nowhere = ({"x": 0.0, "y": 0.0, "z": 0.0}, dict(zip("xyzw", turn, strict=True)))
    messages = [
        (t, {"pose": dict(zip(("position", "orientation"), nowhere if LOST[k] else seen[k], strict=True))})
        for k, t in enumerate(T)
    ]
    commands = [(t, {"steering_rad": 0.5, "throttle_mps": 1.2}) for t in T[::3]]
    topics = {"/p": ("foxglove.PoseInFrame", messages), "/c": ("own", commands)}
    file = json_mcap(tmp_path / "t.mcap", topics)
    named = Vehicle.model_validate({**vehicle.model_dump(by_alias=True), "topics": {"pose": "/p", "command": "/c"}})
    take = read_raw_take(file, named)
    assert count_lost(take) == LOST.sum()
    np.testing.assert_array_equal(np.isnan(take.pose).any(axis=1), LOST)
