"""The search for places and times: it looks at those segments alone that may tell, and finds what was concealed."""

from __future__ import annotations

import numpy as np
import pytest
from concealed import concealing

from bcid.diagnosis.search.place_search import refine_places, segments_in_reach
from bcid.likelihood.nuisance import pose_residuals
from bcid.likelihood.refit import Fit, refit
from bcid.likelihood.take import Take

PLACES = {
    "rough_patch": (60.0, 1.0, 0.5, 0.6), "slippery_patch": (0.5, -1.0, 1.0, 0.6), "mass_change": (0.3, 60.0),
    "tether_pull": (2.0, 1.0, 0.5, 1.0),
}  # fmt: skip


@pytest.fixture(scope="module")
def base() -> tuple[Fit, Take]:
    return concealing(motor_dead_zone=0.1)


@pytest.mark.parametrize("name", PLACES)
def test_segments_out_of_reach_are_the_same_wherever_a_place_is_moved(name: str, base: tuple[Fit, Take]) -> None:
    """So that a search leaves them out; a tether pulls everywhere."""
    fit, take = base
    more, phi = fit.hypothesis.add_effect(name, fit.phi, list(PLACES[name]))
    there = refit(take, more, phi, fit.start, fit.scales)
    widths = np.where(more.is_place, 12.0 if name == "mass_change" else 0.4, 0.0)
    chosen = segments_in_reach(there, take, name, phi, widths)
    others = take.rows(np.setdiff1d(np.arange(take.segments), chosen))
    assert (len(others) > 0.4 * len(take.pose)) == (name != "tether_pull")
    rng = np.random.default_rng(3)
    began = pose_residuals(take, more.prediction_inputs(phi, take), there.start)
    for _ in range(20):
        moved = phi + widths * rng.uniform(-1.0, 1.0, len(phi))
        r = pose_residuals(take, more.prediction_inputs(moved, take), there.start)
        np.testing.assert_allclose(r[others], began[others], atol=1e-12)


def test_a_place_is_found_from_beside_it() -> None:
    fit, take = concealing(rough_patch=80.0, rough_patch_x=1.0, rough_patch_y=0.5)
    more, phi = fit.hypothesis.add_effect("rough_patch", fit.phi, [80.0, 1.4, 0.9, 0.8])
    found = refine_places(refit(take, more, phi, fit.start, fit.scales), take)
    x, y, radius = (found.effect_estimates()[f"rough_patch__{s}"][0] for s in ("x", "y", "radius"))
    assert np.hypot(x - 1.0, y - 0.5) < 0.1
    assert abs(radius - 1.0) < 0.1
