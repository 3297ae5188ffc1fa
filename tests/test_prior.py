"""What is known of parameters before a take: normal laws, and Student's t."""

import numpy as np
import pytest
from scipy import stats

from bcid.likelihood.prior import TRUST_NU, Prior

CENTRE, SD = np.array([0.3, -1.0, 2.0]), np.array([0.1, 2.0, 0.5])
MIXED = Prior(CENTRE, SD**-2.0, np.array([np.inf, TRUST_NU, TRUST_NU]), np.ones(3))


@pytest.mark.parametrize("seed", range(3))
def test_the_density_is_scipy_s(seed: int) -> None:
    phi = CENTRE + SD * np.random.default_rng(seed).normal(0.0, 3.0, 3)
    laws = [stats.norm(CENTRE[0], SD[0]), *(stats.t(TRUST_NU, CENTRE[j], SD[j]) for j in (1, 2))]
    expected = sum(law.logpdf(x) - law.logpdf(c) for law, x, c in zip(laws, phi, CENTRE, strict=True))
    assert MIXED.log_density(phi) == pytest.approx(expected)
    assert MIXED.log_density(CENTRE) == 0.0


def test_the_slope_is_that_of_the_density() -> None:
    phi, step = CENTRE + SD * [1.5, -4.0, 0.2], 1e-6
    differences = [
        (MIXED.log_density(phi + step * e) - MIXED.log_density(phi - step * e)) / (2.0 * step) for e in np.eye(3)
    ]
    np.testing.assert_allclose(MIXED.slope(phi), differences, rtol=1e-6)


def test_a_newton_step_with_its_stiffness_never_lowers_the_density() -> None:
    """It leads to the centre, from wherever it sets out, and a normal law of the stiffness lies below the density."""
    for off in (0.1, 1.0, 5.0, 50.0):
        phi = CENTRE + off * SD
        stiffness = MIXED.stiffness(phi)
        np.testing.assert_allclose(phi + MIXED.slope(phi) / stiffness, CENTRE)
        for share in np.linspace(-1.0, 2.0, 13):
            there = CENTRE + share * (phi - CENTRE)
            below = 0.5 * np.sum(stiffness * ((phi - CENTRE) ** 2 - (there - CENTRE) ** 2))
            assert MIXED.log_density(there) - MIXED.log_density(phi) >= below - 1e-9


def test_far_from_its_scale_a_figure_costs_the_same_for_each_doubling() -> None:
    costs = [-MIXED.log_density(CENTRE + np.array([0.0, off, 0.0]) * SD) for off in (50.0, 100.0, 200.0)]
    assert np.diff(costs) == pytest.approx(2 * [(TRUST_NU + 1.0) * np.log(2.0)], rel=1e-2)


def test_nothing_known_costs_nothing() -> None:
    unknown = Prior(CENTRE, np.zeros(3), np.full(3, np.inf), np.ones(3))
    assert unknown.log_density(CENTRE + 7.0) == 0.0
    assert not unknown.slope(CENTRE + 7.0).any()
    assert not unknown.deviations(CENTRE + 7.0).any()
