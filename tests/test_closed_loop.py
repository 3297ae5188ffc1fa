"""Rollouts restarted through a take: many at once are the same as one after the other, and diverged ones are told."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from cars import CAR

from bcid.aliases import Floats
from bcid.estimate.command_parts import hold_for_periods
from bcid.evaluation.closed_loop import integrate_poses, position_errors, predict_with_restarts
from bcid.models.interface import history_at, rollout
from bcid.models.newton_euler.model import NewtonEuler

PERIOD_S = 0.1


def drive(rows: int) -> Any:
    """What stands for an estimate: `rows` rows of slow driving in two segments, the second a third of the rows."""
    rng = np.random.default_rng(3)
    time_s = PERIOD_S * np.arange(rows)
    twist = np.column_stack([1.0 + 0.3 * np.sin(time_s), 0.05 * np.cos(time_s), 0.2 * np.sin(0.7 * time_s)])
    command = np.column_stack([0.3 * np.sin(0.5 * time_s), 1.0 + 0.2 * rng.standard_normal(rows)])
    cut = 2 * rows // 3

    class Drive(SimpleNamespace):
        def __len__(self) -> int:
            return rows

        def segments(self) -> list[slice]:
            return [slice(0, cut), slice(cut, rows)]

    return Drive(
        time_s=time_s, twist=twist, pose=np.cumsum(PERIOD_S * twist, axis=0), kinematic=np.zeros((rows, 4)),
        parts=hold_for_periods(command, PERIOD_S), period_s=PERIOD_S,
    )  # fmt: skip


class OneByOne:
    """A model of which only single vehicles can be rolled out."""

    def __init__(self, model: Any) -> None:
        self.name, self.lags, self.init, self.scan = model.name, model.lags, model.init, model.scan


class Exploding:
    """A car whose speed is ten times what it was, after every step, where it was above 1.2 m/s at the start."""

    name, lags = "exploding", 0

    def init(self, history: Any) -> Floats:
        return np.array(history.twist[-1])

    def scan(self, carry: Floats, commands: Floats) -> tuple[Floats, Floats]:
        factor = 10.0 if carry[0] > 1.2 else 1.0
        twist = carry * factor ** np.arange(1, len(commands) + 1)[:, None]
        return twist[-1], twist

    def scan_many(self, carries: Floats, commands: Floats) -> tuple[Floats, Floats]:
        twists = np.stack([self.scan(carry, parts)[1] for carry, parts in zip(carries, commands, strict=True)])
        return twists[:, -1], twists


@pytest.mark.parametrize("every_s", [0.2, 0.7, 3.0, 60.0])
def test_many_at_once_are_those_one_by_one(every_s: float) -> None:
    """Lengths that do not divide the segments leave a shorter rollout at the end of each."""
    take, model = drive(100), NewtonEuler(CAR, PERIOD_S, {})
    found, plain = (predict_with_restarts(m, take, every_s) for m in (model, OneByOne(model)))
    np.testing.assert_allclose(found.twist, plain.twist, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(found.pose, plain.pose, rtol=0.0, atol=1e-9)
    starts = np.flatnonzero(found.start)
    assert starts[0] == 0
    assert 66 in starts
    for a, b in zip(starts, [*starts[1:], 100], strict=True):
        alone = rollout(model, history_at(take, int(a), model.lags), take.parts[a : b - 1])
        np.testing.assert_allclose(found.twist[a:b], alone, rtol=0.0, atol=1e-9)
        np.testing.assert_array_equal(found.twist[a], take.twist[a])
        np.testing.assert_array_equal(found.pose[a:b], integrate_poses(take.pose[a], found.twist[a:b], PERIOD_S))


def test_a_diverged_rollout_is_nan_beyond_its_start_and_infinitely_off() -> None:
    take = drive(90)
    found, plain = (predict_with_restarts(m, take, 1.0) for m in (Exploding(), OneByOne(Exploding())))
    starts = np.flatnonzero(found.start)
    explodes = take.twist[starts, 0] > 1.2
    assert explodes.any()
    assert not explodes.all()
    for start, lost in zip(starts, explodes, strict=True):
        np.testing.assert_array_equal(found.twist[start], take.twist[start])
        assert np.isnan(found.twist[start + 1 : start + 10]).all() == lost
    np.testing.assert_array_equal(found.twist, plain.twist)
    errors = position_errors(Exploding(), take, 1.0)  # type: ignore[arg-type]  # it is asked for no more
    from_rows = [k for s in take.segments() for k in range(s.start, s.stop - 10, 10)]
    np.testing.assert_array_equal(np.isinf(errors), take.twist[from_rows, 0] > 1.2)
