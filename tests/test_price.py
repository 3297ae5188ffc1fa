"""The price of a parameter: one, and the same wherever parameters are weighed."""

from __future__ import annotations

import numpy as np
import pytest
from concealed import concealing

from bcid.diagnosis.search.refits import refit_with_effects
from bcid.effects.table import EFFECTS
from bcid.experiment.detectability import required_gain_nats
from bcid.likelihood.price import price_nats


@pytest.mark.parametrize(("parameters", "segments", "nats"), [(0, 400, 0.0), (2, 400, np.log(400.0)), (3, 1, 0.0)])
def test_a_parameter_costs_half_the_logarithm_of_the_segments(parameters: int, segments: int, nats: float) -> None:
    assert price_nats(parameters, segments) == pytest.approx(nats)
    assert price_nats(parameters, 4 * segments) - nats == pytest.approx(parameters * np.log(2.0))


def test_a_take_without_segments_has_no_price() -> None:
    assert price_nats(5, 0) == 0.0


def test_fits_pay_it_for_each_parameter_of_an_effect() -> None:
    """None for what every fit has."""
    base, take = concealing(yaw_scrub=20.0)
    patch = refit_with_effects(base, take, ("slippery_patch",), [0.3, 2.0, 2.0, 1.0])
    for fit, parameters in ((base, 0), (patch, len(EFFECTS["slippery_patch"].parameters))):
        paid = fit.log_likelihood + fit.log_prior - fit.penalised_log_likelihood
        assert paid == pytest.approx(price_nats(parameters, take.segments))


def test_what_a_drive_does_not_show_and_a_plan_pay_the_same() -> None:
    patch = EFFECTS["slippery_patch"]
    asked = required_gain_nats(patch, 400, 12.0)
    assert asked == pytest.approx(12.0 + price_nats(len(patch.parameters), 400))
