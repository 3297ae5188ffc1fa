"""Functions without a name beside a hypothesis: those of a remainder, which are fitted, and those of a simulation."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats
from bcid.effects.harmonics import AnglePlan, join_plans, plan_angles
from bcid.effects.remainder_table import COEFFICIENT, ROOM
from bcid.effects.table import NO_FUNCTIONS
from bcid.errors import UsageError
from bcid.likelihood.tracking_functions import AMOUNT, NO_TRACKING


class UnnamedFunctions(NamedTuple):
    """Functions without a name, with their coefficients."""

    on_body: Floats = NO_FUNCTIONS  # (B, COLUMNS) as in `bcid.effects.remainder`
    tracking: Floats = NO_TRACKING  # (M, TRACKING_COLUMNS) as in `bcid.likelihood.tracking_functions`
    plan: AnglePlan | None = None  # by which those on the body are computed; each by its own angle without one

    @property
    def size(self) -> int:
        """How many functions there are, on the body and in the tracking."""
        return len(self.on_body) + len(self.tracking)

    def join(self, more: UnnamedFunctions) -> UnnamedFunctions:
        """These functions, and `more` behind them.

        Raises:
            UsageError: they are more than there is room for.
        """
        if not self.size or not more.size:
            return self if self.size else more
        tracking = np.concatenate([self.tracking, more.tracking])
        if not len(self.on_body) or not len(more.on_body):
            return (self if len(self.on_body) else more)._replace(tracking=tracking)
        on_body = np.concatenate([self.on_body, more.on_body])
        if len(on_body) > ROOM:
            cause = f"{len(on_body)} functions without a name, {ROOM} at most"
            raise UsageError(f"{cause}\n  next: diagnose against a simulation of names alone")
        first, second = (f.plan or plan_angles(f.on_body) for f in (self, more))
        return UnnamedFunctions(on_body, tracking, join_plans(on_body, first, second))


NO_UNNAMED = UnnamedFunctions()


class RemainderFunctions(NamedTuple):
    """Functions without a name, which act beside a hypothesis, and how large their coefficients may be."""

    functions: Floats  # (B, COLUMNS) on the body, as in `bcid.effects.remainder`, with coefficients of zero
    tracking: Floats  # (M, TRACKING_COLUMNS) as in `bcid.likelihood.tracking_functions`, likewise
    channel: tuple[str, ...]  # (B + M,) in which each acts
    sd: Floats  # (B + M,) prior standard deviations of the coefficients (m/s^2, rad/s^2, rad, m, s)
    plan: AnglePlan | None = None  # by which those on the body are computed

    def with_coefficients(self, c: Floats) -> UnnamedFunctions:
        """The functions with the coefficients `c` (B + M,)."""
        body, tracking = self.functions.copy(), self.tracking.copy()
        body[:, COEFFICIENT], tracking[:, AMOUNT] = c[: len(body)], c[len(body) :]
        return UnnamedFunctions(body, tracking, self.plan)


NO_REMAINDER = RemainderFunctions(NO_FUNCTIONS, NO_TRACKING, (), np.zeros(0))
