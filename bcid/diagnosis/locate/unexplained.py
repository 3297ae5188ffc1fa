"""What is left beside a fit: what of its pushes is predictable, what free functions would explain, where pushes lie."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from bcid.diagnosis.locate.channel_gains import explained_by
from bcid.diagnosis.locate.push_directions import Lying, lying
from bcid.diagnosis.locate.pushes import Disturbances, disturbances
from bcid.diagnosis.locate.regression import Remainder, remainder
from bcid.diagnosis.locate.scan_statistic import Circle
from bcid.likelihood.refit import Fit
from bcid.likelihood.take import Take

TELLING = 5.0  # nats from which a channel's functions or directions explain something
FAIR = 0.1  # of what trees predict, below which the same says nothing either
UNPUSHED = ("pose", "time")


class Left(NamedTuple):
    """Three views of it: a model that trees have, plain functions at every place of a car, and directions alone."""

    remainder: Remainder
    entering: Mapping[str, float]  # nats that free functions in each channel would gain, most first
    lying: tuple[Lying, ...]  # in which directions pushes lie, the likeliest first

    @classmethod
    def of(cls, fit: Fit, take: Take, place: Circle | None = None) -> Left:
        """Beside a fit; `place` stands out on the floor."""
        pushes = disturbances(fit, take)
        return cls.by(pushes, remainder(pushes, fit.car()), fit, take, place)

    @classmethod
    def by(cls, pushes: Disturbances, whole: Remainder, fit: Fit, take: Take, place: Circle | None) -> Left:
        """The same, where the pushes are known already, and what of the `whole` of them is predictable."""
        return cls(whole, explained_by(fit, take, place), lying(pushes, fit.car()))

    @property
    def channel(self) -> str:
        """The channel whose functions explain most, or the one in whose directions pushes lie, if that explains more.

        What is seen otherwise than it is does not push, and seems to push in any direction: where its functions explain
        most, no direction counts.  Where neither explains much of it, the channel in which most is predictable.
        """
        least = max(TELLING, FAIR * self._predicted)
        first = next(iter(self.entering))
        way = next(iter(self.lying), None)
        lies = way.nats if way else 0.0
        if self.entering[first] > least and (first in UNPUSHED or self.entering[first] > lies):
            return first
        return way.channel if way and lies > least else self.remainder.channel

    @property
    def _predicted(self) -> float:
        """Nats that trees predict, beyond chance."""
        return self.remainder.gain if self.remainder.predictable else 0.0

    def way(self, gate: float) -> Lying | None:
        """In which directions pushes lie, if that is in the channel where most is left and chance does not reach it."""
        first = next(iter(self.lying), None)
        return first if first and first.nats > gate and first.channel == self.channel else None

    def nats(self, gate: float) -> float:
        """What something more would be worth; none where chance may be all there is, which does not reach the gate."""
        views = (max(self.entering.values()), max((way.nats for way in self.lying), default=0.0))
        return max(self._predicted, *(nats if nats > gate else 0.0 for nats in views))
