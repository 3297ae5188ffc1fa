"""A vehicle under way: its pose and twist, advanced by a model one period after the other."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bcid.aliases import Floats
from bcid.errors import UsageError
from bcid.evaluation.closed_loop import integrate_poses
from bcid.evaluation.validity import ModelValidity, RangeExit
from bcid.models.interface import Model
from bcid.prediction.prediction import BeyondData


@dataclass(frozen=True)
class Motion:
    """Where a vehicle is and how it moves, by a model; `step` returns the motion one period later."""

    model: Model
    validity: ModelValidity | None
    carry: Floats  # the model's state
    pose: Floats  # (3,) x m, y m (world), yaw rad
    twist: Floats  # (3,) v_x m/s, v_y m/s (body), yaw rate rad/s
    time_s: float
    warned: frozenset[str] = frozenset()  # quantities whose exit from the model's data has been warned of

    def step(self, command: Sequence[float] | Floats) -> Motion:
        """The motion after one period under `command` = [u_s (rad), u_m].

        Warns:
            BeyondData: a quantity leaves the range of the data that the model was fitted on, for the first time.

        Raises:
            UsageError: the command is not two finite numbers.
        """
        given = np.asarray(command, dtype=np.float64)
        if given.shape != (2,) or not np.isfinite(given).all():
            raise UsageError(f"the command is {command!r}\n  next: give two finite numbers, [u_s, u_m]")
        carry, twist = self.model.step(self.carry, given)
        h = self.model.period_s
        pose = integrate_poses(self.pose, np.stack([self.twist, twist]), h)[-1]
        after = replace(self, carry=carry, pose=pose, twist=twist, time_s=self.time_s + h)
        exits = self.validity.range.first_exits(twist[None], given[None]) if self.validity else []
        return after.warn_of(exits, stacklevel=3)

    def warn_of(self, exits: Iterable[RangeExit], stacklevel: int) -> Motion:
        """This motion, after a warning of each quantity that is beyond the model's data now for the first time."""
        h, fresh = self.model.period_s, [e for e in exits if e.quantity not in self.warned]
        for e in fresh:
            text = e._replace(step=round(self.time_s / h)).describe(h)
            warnings.warn(f"beyond the data of {self.model.name}: {text}", BeyondData, stacklevel=stacklevel)
        return replace(self, warned=self.warned | {e.quantity for e in fresh})
