"""Functions without a name from multiples of a few angles: the same numbers as cosines one by one."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from test_remainder import draw_functions
from test_variational import BASE, estimate, part, shove  # noqa: F401  # fixtures

from bcid.diagnosis.remainder.functions import RemainderBasis, remainder_basis
from bcid.effects.harmonics import (
    FACTORS,
    INVERSE_POWERS,
    MOST_POWERS,
    ON_COSINE,
    ON_SINE,
    POWERS,
    AnglePlan,
    angle_powers,
    plan_angles,
    product_of_powers,
)
from bcid.effects.remainder_table import COEFFICIENT, COLUMNS, INPUTS, PHASE, WAVE, RemainderInputs
from bcid.effects.table import effect_switches
from bcid.likelihood.nuisance import linearise_nuisances
from bcid.likelihood.take import Take
from bcid.likelihood.tracking_functions import NO_TRACKING
from bcid.likelihood.unnamed_functions import NO_UNNAMED, UnnamedFunctions

CAR = SimpleNamespace(m=2.0, l_f=0.1, l_r=0.15, I_z=0.03)


@pytest.fixture(scope="module")
def basis() -> RemainderBasis:
    rng = np.random.default_rng(5)
    return remainder_basis({n: rng.uniform(-1.0, 2.0, 300) * (1.0 + j) for j, n in enumerate(INPUTS)}, CAR)


def values_by_plan(functions: np.ndarray, plan: AnglePlan, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Values of functions with their coefficients, and derivatives by k . s, in the order of the table."""
    e, at = effect_switches({}, functions, plan), RemainderInputs(*s)
    powers, values, slopes = angle_powers(e, at), np.empty(len(functions)), np.empty(len(functions))
    for j in range(len(functions)):
        x, y = product_of_powers(e, j, powers, at.v_x)
        own = e.remainder[j]
        values[plan.order[j]] = own[ON_COSINE] * x + own[ON_SINE] * y
        slopes[plan.order[j]] = own[ON_SINE] * x - own[ON_COSINE] * y
    return values, slopes


def test_functions_of_two_plans_are_those_of_each(basis: RemainderBasis) -> None:
    """As of a simulation and of what is missing beside it, which went through other ranges."""
    rng = np.random.default_rng(2)
    wider = remainder_basis({n: rng.uniform(-3.0, 4.0, 300) * (1.0 + j) for j, n in enumerate(INPUTS)}, CAR)
    parts = []
    for some, count in ((basis, 60), (wider, 90)):
        functions = some.functions[rng.permutation(len(some.functions))[:count]].copy()
        functions[:, COEFFICIENT] = rng.standard_normal(count)
        parts.append(UnnamedFunctions(functions, NO_TRACKING, plan_angles(functions, some.half_waves)))
    both = parts[0].join(parts[1])
    assert both.plan is not None
    assert len(both.plan.angles) < 60  # many functions share an angle
    for _ in range(5):
        s = rng.uniform(-3.0, 5.0, len(INPUTS))
        values, _ = values_by_plan(both.on_body, both.plan, s)
        angle = both.on_body[:, WAVE:] @ s + both.on_body[:, PHASE]
        np.testing.assert_allclose(values, both.on_body[:, COEFFICIENT] * np.cos(angle), atol=1e-9)
    assert NO_UNNAMED.join(parts[0]) is parts[0]


@pytest.mark.parametrize("known", [True, False], ids=["half waves", "angles of their own"])
def test_values_and_slopes_are_those_of_cosines(basis: RemainderBasis, known: bool) -> None:
    rng = np.random.default_rng(1)
    functions = basis.functions.copy()
    functions[:, COEFFICIENT] = rng.standard_normal(len(functions))
    half_waves = basis.half_waves if known else np.zeros_like(basis.half_waves)
    for _ in range(5):
        s = rng.uniform(-3.0, 5.0, len(INPUTS))
        angle = functions[:, WAVE:] @ s + functions[:, PHASE]
        values, slopes = values_by_plan(functions, plan_angles(functions, half_waves), s)
        np.testing.assert_allclose(values, functions[:, COEFFICIENT] * np.cos(angle), atol=1e-12)
        np.testing.assert_allclose(slopes, -functions[:, COEFFICIENT] * np.sin(angle), atol=1e-12)


def test_all_half_waves_of_a_basis_are_multiples_of_one_angle_for_each_quantity(basis: RemainderBasis) -> None:
    """Straight lines alone, a hundredth of a half wave, have angles of their own."""
    plan = plan_angles(basis.functions, basis.half_waves)
    straight = sum(name.endswith("=") and (f[WAVE:] != 0.0).any()
                   for name, f in zip(basis.channel, basis.functions, strict=False))  # fmt: skip
    assert len(plan.angles) == len(INPUTS) + straight
    assert (plan.angles[:, POWERS] <= MOST_POWERS).all()
    assert plan.angles[:, [POWERS, INVERSE_POWERS]].sum() < len(basis.functions) / 2


def test_the_sine_of_a_wave_has_the_angle_of_its_cosine() -> None:
    wave = np.zeros((3, COLUMNS))
    wave[:, WAVE + 8], wave[:, WAVE + 9] = 3.1, -1.7
    wave[1, PHASE], wave[2, WAVE + 8] = -0.5 * np.pi, 3.2
    plan = plan_angles(wave)
    assert len(plan.angles) == 2
    assert plan.factors[0, 1] == plan.factors[1, 1] != plan.factors[2, 1]


def test_a_function_of_more_quantities_than_factors_has_an_angle_of_its_own(basis: RemainderBasis) -> None:
    f = np.zeros((1, COLUMNS))
    f[0, WAVE : WAVE + FACTORS + 1] = basis.half_waves[: FACTORS + 1, 1]
    f[0, PHASE] = basis.half_waves[: FACTORS + 1, 0].sum()
    assert len(plan_angles(f, basis.half_waves).angles) == 1
    f[0, WAVE] = 0.0
    assert len(plan_angles(f, basis.half_waves).angles) == FACTORS


def test_predictions_are_the_same_with_and_without_a_plan(part: Take, basis: RemainderBasis) -> None:  # noqa: F811
    """In vectors of segments, with functions in the order in which their coefficients stand."""
    rng = np.random.default_rng(2)
    on = np.sort(rng.choice(len(basis.functions), 60, replace=False))
    functions = np.concatenate([basis.functions[on], draw_functions(rng, 1, 0.0)])
    functions[:, COEFFICIENT] = 0.05 * rng.standard_normal(len(functions))
    known = BASE.prediction_inputs(BASE.phi_of(BASE.nominal), part)
    each, planned = (
        linearise_nuisances(part, known._replace(switches=effect_switches({}, functions, plan)), shove(part))
        for plan in (None, plan_angles(functions, basis.half_waves))
    )
    assert np.abs(each.r - linearise_nuisances(part, known, shove(part)).r).max() > 1e-3
    np.testing.assert_allclose(planned.r, each.r, atol=1e-9)
    np.testing.assert_allclose(planned.A, each.A, rtol=1e-7, atol=1e-8)
