"""A car adapted on line: it is given each command and each pose as they come, and says what it knows by now."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bcid.adaptation.adapt import Adaptation
from bcid.adaptation.filter import PLACE, Knowledge, settling_poses, start_filter
from bcid.adaptation.filter_run import run_filter
from bcid.adaptation.quantities import with_quantities
from bcid.aliases import Floats
from bcid.errors import UsageError
from bcid.export.formulas import TWIST
from bcid.models.newton_euler.augmented import AugmentedNewtonEuler

ORIGIN = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class AdaptedCar:
    """A car of which k constants were followed over a recording, and can be followed further."""

    adaptation: Adaptation
    released: tuple[str, ...] = ()  # limits of forces that the model's drives did not reach, m g in the adapted car

    @property
    def names(self) -> tuple[str, ...]:
        """The quantities that were followed."""
        return self.adaptation.names

    @property
    def time_s(self) -> Floats:
        """Times (K,) in s of the recording."""
        return self.adaptation.drive.estimate.time_s

    @property
    def values(self) -> Floats:
        """The quantities (K, k) as they were known at each time: factors, or parameters of effects in SI units."""
        return self.adaptation.track.values

    @property
    def sd(self) -> Floats:
        """The standard deviations (K, k) of the quantities."""
        return self.adaptation.track.sd

    def begin(
        self, pose: Sequence[float] = ORIGIN, twist: Sequence[float] | None = None, delta: float | None = None,
        gap_s: float = 0.0,
    ) -> CarUnderWay:  # fmt: skip
        """Go on with what is known at the recording's end: on line, a command and a pose after the other.

        Args:
            pose: where the tracked point is: x, y (m) and yaw (rad).
            twist: how it moves: v_x, v_y (m/s) and yaw rate (rad/s); None where that is not known.
            delta: the steering angle (rad); None where it is not known.
            gap_s: the time (s) since the recording's end, over which what was learnt fades.

        Raises:
            UsageError: these are no numbers, or not as many, or the gap is below zero.
        """
        return CarUnderWay(self.adaptation, pose, twist, delta, gap_s)


class CarUnderWay:
    """The filter of an adaptation, under way on another drive or further on the same one.

    It assumes what was tuned to the recording of the adaptation, and knows of the quantities what it did at the end.
    """

    def __init__(
        self, adaptation: Adaptation, pose: Sequence[float], twist: Sequence[float] | None, delta: float | None,
        gap_s: float,
    ) -> None:  # fmt: skip
        """Begin at a measured pose, twist and steering angle, `gap_s` (s) after the end of the adaptation."""
        self.adaptation = adaptation
        self._settling: int  # poses from which nothing more is learnt of the quantities
        ended_s = float(adaptation.drive.estimate.time_s[-1])
        self._begin(pose, twist, delta, adaptation.track.values[-1], adaptation.track.covariance, gap_s, ended_s)

    def step(self, command: Sequence[float], pose: Sequence[float] | None = None) -> None:
        """Let a period pass in which a `command` [u_s (rad), u_m] held; `pose` is what was measured at its end, if any.

        Raises:
            UsageError: these are no numbers, or not as many.
        """
        measured = np.full(3, np.nan) if pose is None else _numbers(pose, 3, "a pose")
        given = _numbers(command, 2, "a command")
        run_filter(self.adaptation.filter, self._z, self._P, given[None], measured[None], self._settling)
        self._settling = max(self._settling - (pose is not None), 0)
        self._time_s += self.adaptation.formulas.period_s

    def restart(
        self, pose: Sequence[float], gap_s: float, twist: Sequence[float] | None = None, delta: float | None = None
    ) -> None:
        """Begin anew after a gap of `gap_s` (s) without poses, over which what was learnt fades.

        Where twist or steering angle are not known, poses show them, and nothing else is learnt from those of the first
        second.
        Where commands are known over the gap, `step` without a pose is better: it goes on with all that is known.

        Raises:
            UsageError: these are no numbers, or not as many, or the gap is below zero.
        """
        self._begin(pose, twist, delta, self.values, self.covariance, gap_s, self._time_s)

    def _begin(
        self, pose: Sequence[float], twist: Sequence[float] | None, delta: float | None, values: Floats,
        covariance: Floats, gap_s: float, ended_s: float,
    ) -> None:  # fmt: skip
        """Begin with quantities that had these `values` (k,) and `covariance` (k, k) at `ended_s`, before a gap."""
        if not 0.0 <= gap_s < math.inf:
            raise UsageError(f"a gap cannot last {gap_s:g} s\n  next: give the time since the last pose")
        formulas, noise = self.adaptation.formulas, self.adaptation.noise
        known = Knowledge(values, covariance, gap_s, ended_s + gap_s)
        at = _numbers(pose, 3, "a pose")
        moving = None if twist is None else _numbers(twist, 3, "a twist")
        steered = None if delta is None else float(_numbers([delta], 1, "a steering angle")[0])
        self._z, self._P = start_filter(formulas, noise, at, moving, steered, known)
        self._settling = settling_poses(formulas) if moving is None or steered is None else 0
        self._time_s = known.time_s

    @property
    def names(self) -> tuple[str, ...]:
        """The quantities that are followed."""
        return self.adaptation.names

    @property
    def values(self) -> Floats:
        """The quantities (k,) as they are known now: factors, or parameters of effects in SI units."""
        return self._z[len(self.adaptation.formulas.states) :].copy()

    @property
    def covariance(self) -> Floats:
        """The covariance (k, k) of the quantities."""
        n = len(self.adaptation.formulas.states)
        return self._P[n:, n:].copy()

    @property
    def sd(self) -> Floats:
        """The standard deviations (k,) of the quantities."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))

    @property
    def pose(self) -> Floats:
        """The filtered pose (3,) of the centre of gravity: x, y (m) and yaw (rad)."""
        return self._states(PLACE)

    @property
    def twist(self) -> Floats:
        """The filtered twist (3,) of the centre of gravity: v_x, v_y (m/s) and yaw rate (rad/s)."""
        return self._states(tuple(quantity.name for quantity in TWIST))

    def _states(self, names: Sequence[str]) -> Floats:
        """The states called `names`."""
        states = [state.name for state in self.adaptation.formulas.states]
        return self._z[[states.index(name) for name in names]]

    def model(self) -> AugmentedNewtonEuler:
        """The car as it is known now."""
        quantities = self.adaptation.quantities
        return with_quantities(self.adaptation.model, list(zip(quantities, self.values.tolist(), strict=True)))


def _numbers(given: Sequence[float], count: int, what: str) -> Floats:
    """So many finite numbers as an array.

    Raises:
        UsageError: they are not as many, or not finite.
    """
    try:
        found = np.asarray(given, float)
    except (TypeError, ValueError):  # such as a text
        found = np.full(count, np.nan)
    if found.shape != (count,) or not np.isfinite(found).all():
        raise UsageError(f"{given!r} is not {what}, of {count} finite numbers\n  next: check what is given")
    return found
