"""The panel of takes on which limits are halved and doubled: drawn by lot over the tiers, and the README's example."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bcid.proof.blind.blind_case import BlindCase
from bcid.proof.blind.concealed_effects import ConcealedEffect
from bcid.simulation.car import REAL_EXTRAS, Plant
from bcid.simulation.samples import TAKES

PANEL = {
    "single": 8, "null": 4, "pair": 4, "left-out": 5, "outside": 5, "small-exact": 3, "small-wrong": 3,
    "single-imperfect": 4, "null-imperfect": 3, "half-size": 3, "two-minutes": 3, "ten-hertz": 2,
    "three-times-noise": 2, "small-plus": 2, "small-null": 2, "triple": 2, "small-outside": 1, "closed-loop": 1,
    "measurement-and-vehicle": 1, "unexcited": 1,
}  # fmt: skip
"""Takes of each tier in the whole panel of 60, besides the example; a smaller one begins with one of each, in order."""

EXAMPLE_TIER = "example"
_EXAMPLE_NUMBER, _EXAMPLE = next((i, take) for i, take in enumerate(TAKES) if take.conceals)
_EXAMPLE_SEED = 1000 + _EXAMPLE_NUMBER  # as in the committed sample logs


@dataclass(frozen=True)
class ExampleCase(BlindCase):
    """The README's example: a take of the sample logs, of a car that lacks three things."""

    def plant(self) -> Plant:
        """The car of the sample logs, with what is concealed in this take."""
        return Plant(**REAL_EXTRAS, **dict(_EXAMPLE.conceals))

    def _drive_seed(self) -> int:
        """Seed of the take in the sample logs."""
        return _EXAMPLE_SEED


EXAMPLE = ExampleCase(
    EXAMPLE_TIER, 0, tuple(map(ConcealedEffect, ("rough_patch", "tyre_soft_saturation", "rear_rolling_viscous"))),
    duration_s=_EXAMPLE.duration_s,
)  # fmt: skip


def draw_panel(cases: Sequence[BlindCase], seed: int, takes: int | None = None) -> list[BlindCase]:
    """Draw so many `takes` (None: all) of the `cases` of a suite by lot, as PANEL shares them out over the tiers.

    The first is the README's example.  A smaller panel is the beginning of a larger one of the same seed.
    """
    drawn = list[tuple[int, int, BlindCase]]()
    for k, (tier, number) in enumerate(PANEL.items()):
        members = [case for case in cases if case.tier == tier]
        lot = np.random.default_rng([seed, k, 17]).permutation(len(members))
        drawn += [(turn, k, members[i]) for turn, i in enumerate(lot[:number])]
    in_turn = sorted(drawn, key=lambda entry: entry[:2])
    return [EXAMPLE, *(case for _, _, case in in_turn)][:takes]
