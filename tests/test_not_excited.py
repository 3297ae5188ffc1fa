"""How well a drive shows effects: sizes at which a nat is expected, and what the drive cannot show at all."""

from __future__ import annotations

import math

import numpy as np
import pytest
from concealed import concealing

from bcid.diagnosis.judge.not_excited import Excitation, measure_excitation
from bcid.diagnosis.search.refits import refit_with_effects
from bcid.effects.table import EFFECTS

SECONDS, EXPECTED = 120.0, 20.0


@pytest.fixture(scope="module")
def excitation() -> Excitation:
    """What two minutes of a car show that lacks nothing."""
    fit, take = concealing(SECONDS)
    return measure_excitation(fit, take, fit.hypothesis.units, lambda effect: 14.0)


def test_an_effect_gains_what_its_size_is_expected_to(excitation: Excitation) -> None:
    """A gain scatters by the root of twice what is expected: six nats of these twenty."""
    gains = []
    for effect, symbol in (("rear_rolling_viscous", "b"), ("yaw_scrub", "c"), ("steering_offset", "o")):
        size = math.sqrt(EXPECTED) * excitation.nat_sizes[effect][symbol]
        fit, take = concealing(SECONDS, **{effect: size})
        with_it = refit_with_effects(fit, take, (effect,), [size])
        gains.append(with_it.log_likelihood - fit.log_likelihood)
    assert np.mean(gains) == pytest.approx(EXPECTED, abs=10.0)


def test_sizes_are_told_of_all_that_a_drive_shows_but_for_what_has_a_place(excitation: Excitation) -> None:
    places = {name for name, effect in EFFECTS.items() if effect.place_parameters}
    assert not places & excitation.nat_sizes.keys()
    assert len(excitation.nat_sizes) > 0.8 * (len(EFFECTS) - len(places))
    assert all(size > 0.0 for sizes in excitation.nat_sizes.values() for size in sizes.values())
