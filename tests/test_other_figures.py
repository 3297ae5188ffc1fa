"""Figures of a simulation that are others in the car of a drive, told in SI units with what they are worth."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from concealed import concealing

from bcid.diagnosis.diagnose import fit_base_model
from bcid.diagnosis.judge.other_figures import ChangedFigure, find_other_figures
from bcid.diagnosis.reference_model import ReferenceModel
from bcid.estimate.run import estimate_motion
from bcid.likelihood.refit import Fit
from bcid.simulation.car import Plant, Sensor
from bcid.simulation.drive import simulate_drive
from bcid.virtual_lab import TUNING, record_drive, simulated_vehicle

GATE = 12.0  # nats


@cache
def fit_against_published(**times: float) -> tuple[Fit, Fit]:
    """The free fit of a drive, and one against it as a published car with constants so many times as large."""
    free, _ = concealing()
    vehicle = simulated_vehicle()
    recording = record_drive(simulate_drive(Plant(), Sensor(), 120.0, 4), 60.0, vehicle)
    published = ReferenceModel.from_fit(free)
    car = published.car._replace(**{s: factor * getattr(published.car, s) for s, factor in times.items()})
    reference = published._replace(car=car, relative_sd=0.05)
    estimate = estimate_motion(recording, vehicle, TUNING)
    return free, fit_base_model([recording], [estimate], vehicle, reference).fit


def told_alone(fit: Fit) -> tuple[ChangedFigure, ...]:
    return find_other_figures(fit, fit, GATE)


def as_published(fit: Fit) -> Fit:
    """The fit with all figures of its simulation as they are published."""
    trusted = fit.hypothesis.trusted_simulation
    assert trusted is not None
    phi = fit.phi.copy()
    phi[: len(trusted.phi)] = trusted.phi
    return replace(fit, phi=phi)


def test_of_a_simulation_that_holds_nothing_is_told() -> None:
    _, fit = fit_against_published()
    assert find_other_figures(fit, fit, GATE) == ()


@pytest.mark.parametrize(("symbol", "times"), [("K_t", 0.5), ("C_r", 1.6), ("R_1", 3.0)])
def test_a_figure_published_wrongly_is_told_with_the_one_that_is_needed(symbol: str, times: float) -> None:
    free, fit = fit_against_published(**{symbol: times})
    (found,) = find_other_figures(fit, fit, GATE)
    needed = getattr(free.car(), symbol)
    assert found.symbol == symbol
    assert found.published == pytest.approx(times * needed)
    assert abs(found.needed - needed) < 4.0 * found.se < 0.2 * needed
    assert found.nats > GATE


def test_what_chance_reaches_is_not_told() -> None:
    _, fit = fit_against_published(K_t=0.5)
    (found,) = find_other_figures(fit, fit, GATE)
    assert find_other_figures(fit, fit, 0.9 * found.nats) == (found,)
    assert find_other_figures(fit, fit, 1.1 * found.nats) == ()


def test_a_figure_that_is_bent_only_where_nothing_stands_beside_it_is_not_told() -> None:
    """As by what has no name, of which figures do a part until a remainder does it."""
    _, bent = fit_against_published(K_t=0.5)
    assert find_other_figures(bent, as_published(bent), GATE) == ()
    wider = replace(bent, covariance=4.0 * bent.covariance)
    (alone,), (found,) = find_other_figures(bent, bent, GATE), find_other_figures(bent, wider, GATE)
    assert (found.symbol, found.needed) == (alone.symbol, alone.needed)
    assert found.nats == pytest.approx(0.25 * alone.nats)
    assert found.se == pytest.approx(2.0 * alone.se)
    assert find_other_figures(wider, bent, GATE) == (found,)


def test_a_figure_at_a_bound_is_none_that_is_needed() -> None:
    """Beyond it no car is: something else is missing there."""
    _, fit = fit_against_published(C_r=1.6)
    phi = fit.phi.copy()
    own = fit.hypothesis.log_parameters.index("C_r")
    phi[own] = fit.hypothesis.bounds()[0][own]
    assert told_alone(replace(fit, phi=phi)) == ()
    phi[own] += 0.1
    assert [f.symbol for f in told_alone(replace(fit, phi=phi))] == ["C_r"]


def test_without_a_simulation_there_are_no_figures() -> None:
    free, _ = fit_against_published()
    assert free.hypothesis.trusted_simulation is None
    assert find_other_figures(free, free, 0.0) == ()
    assert np.isfinite(free.log_likelihood)
