"""Fits with a remainder that are found from one another: with a name more, with copies of laws, and once again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from concealed import concealing

from bcid.diagnosis.limits import SEARCH_LIMITS
from bcid.diagnosis.reference_model import ReferenceModel
from bcid.diagnosis.remainder.explain import basis_for, explain
from bcid.diagnosis.remainder.fit import (
    CONVERGED_NATS,
    RemainderFit,
    add_beside_remainder,
    allow_copies,
    converge_further,
    fit_with_remainder,
    leave_out,
)
from bcid.diagnosis.search import refits
from bcid.effects.remainder_table import COEFFICIENT
from bcid.likelihood.nuisance import linearise_residuals, pose_residuals
from bcid.likelihood.refit import Fit, refit
from bcid.likelihood.take import Take
from bcid.likelihood.tracking_functions import AMOUNT


@pytest.fixture(scope="module")
def unnamed_scrub() -> tuple[RemainderFit, Take]:
    """A base model with a remainder that stands for tyres which scrub, and for a wheel that hangs to one side."""
    fit, take = concealing(180.0, yaw_scrub=20.0, steering_offset=0.02)
    return fit_with_remainder(fit, take, explain(fit, take, basis_for(fit, take))), take


def quick_fit(rest: RemainderFit, take: Take, name: str, value: float) -> Fit:
    """The fit without the remainder that has an effect more, along the tangent of that without."""
    plain = rest.named
    more, phi = plain.hypothesis.add_effect(name, plain.phi, [value])
    return refit(take, more, phi, plain.start, plain.scales, refits.QUICK, plain.tangent)


def test_a_right_name_takes_the_place_of_the_remainder_from_which_it_is_tried(
    unnamed_scrub: tuple[RemainderFit, Take],
) -> None:
    """A wrong one adds nothing there, and costs nothing but its price."""
    rest, take = converge_further(*unnamed_scrub), unnamed_scrub[1]
    right = add_beside_remainder(rest, quick_fit(rest, take, "yaw_scrub", 5.0), take)
    assert right.log_evidence > rest.log_evidence + 15.0
    assert right.fit.hypothesis.effects[-1] == "yaw_scrub"
    (size,) = refits.estimates_by_symbol(right.fit, "yaw_scrub").values()
    assert size[0] == pytest.approx(20.0, rel=0.15)
    wrong = add_beside_remainder(rest, quick_fit(rest, take, "motor_sag", 0.01), take)
    assert -8.0 < wrong.log_evidence - rest.log_evidence < 4.0


def test_a_further_refit_from_where_it_ended_gains_next_to_nothing(unnamed_scrub: tuple[RemainderFit, Take]) -> None:
    """What it would gain would count for the name that is tried next."""
    rest, take = unnamed_scrub
    once = converge_further(rest, take)
    assert once.log_evidence >= rest.log_evidence
    assert converge_further(once, take).log_evidence - once.log_evidence < CONVERGED_NATS


def test_a_simulation_has_what_has_no_name_in_the_fit_that_it_comes_from(
    unnamed_scrub: tuple[RemainderFit, Take],
) -> None:
    """It predicts as the fit does; a remainder beside it acts besides, and has derivatives of its own."""
    rest, take = unnamed_scrub
    fit, h = rest.fit, rest.fit.hypothesis
    assert len(h.remainder.functions) > 5
    as_fitted = h.prediction_inputs(fit.phi, take)
    simulation = ReferenceModel.from_fit(fit)
    alone = replace(rest.named.hypothesis, nominal=simulation.car, known=simulation.known)
    phi = alone.phi_of(simulation.car, list(simulation.effects.values()))
    r = pose_residuals(take, as_fitted, fit.start)
    np.testing.assert_allclose(pose_residuals(take, alone.prediction_inputs(phi, take), fit.start), r, atol=1e-12)
    half = simulation.known._replace(on_body=simulation.known.on_body.copy(), tracking=simulation.known.tracking.copy())
    half.on_body[:, COEFFICIENT] *= 0.5
    half.tracking[:, AMOUNT] *= 0.5
    beside = replace(h, known=half)
    phi = np.r_[fit.phi[: h.named_size], 0.5 * fit.phi[h.named_size :]]
    inputs = beside.prediction_inputs(phi, take)
    np.testing.assert_allclose(pose_residuals(take, inputs, fit.start), r, atol=1e-9)
    whole, again = (linearise_residuals(take, i, fit.start) for i in (as_fitted, inputs))
    np.testing.assert_allclose(again.J, whole.J, atol=1e-7)


def test_copies_of_laws_are_added_to_the_functions_that_are_there(unnamed_scrub: tuple[RemainderFit, Take]) -> None:
    rest, take = unnamed_scrub
    copied = allow_copies(rest, take, ("steering",))
    assert copied.log_evidence > rest.log_evidence + 8.0
    assert "steering=" in copied.fit.hypothesis.remainder.channel
    # which channels are needed beside all names is read from what is seen with them
    assert copied.seen.spread["steering="] > 0.0
    assert "steering=" not in rest.seen.spread or rest.seen.spread["steering="] == 0.0
    # without copies it is converged to its share, and is never less likely
    assert (
        0.0 <= allow_copies(rest, take, ()).log_evidence - rest.log_evidence < SEARCH_LIMITS.converged_share * rest.nats
    )


def test_a_remainder_grows_into_the_place_of_a_name_that_is_left_out(unnamed_scrub: tuple[RemainderFit, Take]) -> None:
    """From the fit with the name evidence comes back to what it is without it, but for what refits are converged to."""
    rest, take = converge_further(*unnamed_scrub), unnamed_scrub[1]
    named = add_beside_remainder(rest, quick_fit(rest, take, "yaw_scrub", 5.0), take)
    assert named.seen.effects == rest.named.hypothesis.effects  # as it tells
    less = leave_out(named, rest.named, take)
    assert less.named is rest.named
    assert less.fit.hypothesis.effects == rest.named.hypothesis.effects
    assert less.log_evidence == pytest.approx(
        rest.log_evidence, abs=max(4.0, 2.0 * SEARCH_LIMITS.converged_share * rest.nats)
    )
