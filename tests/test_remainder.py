"""What has no name: functions without a name in the car, and their derivatives."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import pytest
from cars import CAR
from test_variational import BASE, Instant, at_steps, drive, estimate, part, shove  # noqa: F401  # fixtures

from bcid.diagnosis.diagnose import fit_base_model
from bcid.diagnosis.remainder.evidence import Quadratic, channel_worths, likeliest_spreads
from bcid.diagnosis.remainder.fit import basis_for, fit_with_remainder
from bcid.diagnosis.remainder.functions import TERMS, RemainderBasis, remainder_basis
from bcid.effects.remainder import COEFFICIENT, COLUMNS, DIRECTION, DIRECTIONS, INPUTS, PHASE, WAVE
from bcid.effects.table import effect_switches
from bcid.estimate.run import estimate_motion
from bcid.likelihood.force_history import ACTIONS, HISTORY
from bcid.likelihood.lane_rollout import segment_layout
from bcid.likelihood.nuisance import linearise_residuals
from bcid.likelihood.predict import FINE, linearise_poses, predict_poses, wrap_yaw
from bcid.likelihood.prediction_inputs import PredictionInputs
from bcid.likelihood.refit import refit
from bcid.likelihood.take import N_NUISANCE, N_START, Take
from bcid.likelihood.tracking_functions import TRACKING_COLUMNS
from bcid.simulation.car import Plant, Sensor
from bcid.simulation.drive import simulate_drive
from bcid.virtual_lab import TUNING, record_drive, simulated_vehicle

LENGTHS = np.array([1.0, 1.0, 1.0, 0.3, 0.3, 0.8, 1.0, 1.0, 2.0, 2.0, 40.0])


def draw_functions(rng: np.random.Generator, each: int, size: float) -> np.ndarray:
    """So many functions in each direction, of random waves and phases, with coefficients of about `size`."""
    table = np.zeros((each * len(DIRECTIONS), COLUMNS))
    table[:, COEFFICIENT] = size * rng.standard_normal(len(table))
    table[:, DIRECTION] = np.repeat(np.arange(len(DIRECTIONS)), each)
    table[:, PHASE] = rng.uniform(0.0, 2.0 * np.pi, len(table))
    table[:, WAVE:] = rng.standard_normal((len(table), len(INPUTS))) / LENGTHS
    return table


def with_functions(take: Take, functions: np.ndarray, on: dict[str, float]) -> PredictionInputs:
    known = BASE.prediction_inputs(BASE.phi_of(BASE.nominal), take)
    return known._replace(switches=effect_switches(on, functions))


@pytest.mark.parametrize(
    "on",
    [
        {},
        {"motor_lag__tau": 0.2, "rear_rolling_viscous__b": 20.0},
        {"tether_pull__k": 3.0, "tyre_relaxation__sigma": 0.2},
    ],
    ids=["base", "lag", "place"],
)
def test_derivatives_of_functions_without_a_name(part: Take, on: dict[str, float]) -> None:  # noqa: F811
    """By each coefficient, and with them on by initial states and pushes, as central differences of predictions."""
    rng = np.random.default_rng(3)
    table, start, layout = draw_functions(rng, 2, 0.05), shove(part), segment_layout(part)
    inputs = with_functions(part, table, on)
    r, A, J = linearise_residuals(part, inputs, start)
    poses, derivatives = part.pose - r, np.concatenate([A, J], axis=2)
    assert derivatives.shape[2] == N_NUISANCE + len(table)
    plain = predict_poses(layout, start, *inputs.kernel_arguments)
    np.testing.assert_allclose(wrap_yaw(poses - plain), 0.0, atol=1e-12)
    columns, h = [], 1e-5
    for j in range(N_NUISANCE + len(table)):
        ends = []
        for sign in (1.0, -1.0):
            functions, states = table.copy(), start.copy()
            if j < N_NUISANCE:
                states[:, j] += sign * h
            else:
                functions[j - N_NUISANCE, COEFFICIENT] += sign * h
            ends.append(predict_poses(layout, states, *with_functions(part, functions, on).kernel_arguments))
        columns.append((ends[0] - ends[1]) / (2.0 * h))
    expected = np.stack(columns, axis=2)
    size = np.abs(expected).max(axis=(0, 1))
    assert (size > 1e-4).all()
    error = np.abs(derivatives - expected) / size
    # a kink within a difference is none of these; functions are held over 0.125 s
    assert np.quantile(error[:, :, :N_NUISANCE], 0.95) < (5e-3 if on else 1e-4)
    assert np.quantile(error, 0.95) < 2e-2
    assert np.median(error.max(axis=(0, 1))) < 5e-2


def add_functions(x: np.ndarray, now: Instant, p: Any, table: np.ndarray) -> tuple[complex, np.ndarray]:
    """How far functions turn the wheel, and the accelerations that they add, written anew for complex numbers."""
    p_x, p_y, theta, v_x, v_y, w = x
    c, s, front = np.cos(now.delta), np.sin(now.delta), v_y + p["l_f"] * w
    along, across = c * v_x + s * front, c * front - s * v_x

    def slip(along: complex, across: complex) -> complex:
        fast = along if along.real >= 0.0 else -along
        return np.arctan(across / (fast if fast.real > p["v_0"].real else p["v_0"]))

    alpha_f, alpha_r = slip(along, across), slip(v_x, v_y - p["l_r"] * w)
    inputs = np.array([v_x, w, along, alpha_f, alpha_r, now.delta, now.delta_rate, now.u_m, p_x, p_y, now.t])
    value = table[:, COEFFICIENT] * np.cos(table[:, WAVE:] @ inputs + table[:, PHASE])
    total = dict(zip(DIRECTIONS, (value[table[:, DIRECTION] == i].sum() for i in range(len(DIRECTIONS))), strict=True))
    driven, share = total["driven_along"], p["front_share"]
    ahead = total["front_along"] + share * driven
    side = s * ahead + c * total["front_across"]
    f_x = total["body_x"] + c * ahead - s * total["front_across"] + (1.0 - share) * driven
    f_x += np.cos(theta) * total["world_x"] + np.sin(theta) * total["world_y"]
    f_y = side + total["rear_across"] + np.cos(theta) * total["world_y"] - np.sin(theta) * total["world_x"]
    moment = p["m"] * (p["l_f"] * side - p["l_r"] * total["rear_across"]) / p["I_z"] + total["yaw"]
    return total["wheel_angle"], np.array([f_x, f_y, moment])


def add_history(
    x: np.ndarray, now: Instant, p: Any, table: np.ndarray, actions: np.ndarray, begin: tuple[int, int]
) -> tuple[complex, np.ndarray]:
    """What `add_functions` gives, and the accelerations and the turn (knots, ACTIONS) that act in a knot besides.

    `begin` holds a segment's first step and its number of steps.
    """
    turn, accelerations = add_functions(x, now, p, table)
    *pushed, turned = actions[(now.step - begin[0]) * FINE.knots // begin[1]]
    return turn + turned, accelerations + np.array(pushed)


@pytest.mark.parametrize("each", [0, 2])
def test_derivatives_are_complex_steps_of_functions_written_anew(part: Take, each: int) -> None:  # noqa: F811
    """By initial states, and by what acts in each knot; functions of one direction stand together, or anywhere."""
    few, rng, tiny = part.part(np.array([0, 3, 6, 9])), np.random.default_rng(6), 1e-30
    table = draw_functions(rng, each, 0.05)
    table[len(DIRECTIONS) :] = rng.permutation(table[len(DIRECTIONS) :])
    start, plain, inputs = shove(few), {s: complex(v) for s, v in CAR._asdict().items()}, with_functions(few, table, {})
    chain, car, e, c = inputs.kernel_arguments
    layout = at_steps(few, segment_layout(few))
    poses, derivatives, _ = linearise_poses(layout, start, chain, np.array([car]), np.zeros(0), FINE, e, c)
    assert derivatives.shape[2] == N_START + HISTORY
    for s in range(few.segments):
        mine, where = slice(s * few.steps, (s + 1) * few.steps), (int(few.step[s]), few.steps)
        columns = []
        for j in range(N_START + HISTORY):
            state, actions = start[s].astype(complex), np.zeros(HISTORY, dtype=complex)
            (state if j < N_START else actions)[j if j < N_START else j - N_START] += 1j * tiny
            acting = partial(add_history, table=table, actions=actions.reshape(FINE.knots, ACTIONS), begin=where)
            columns.append(drive(state, inputs, *where, plain, acting)[1:])
        np.testing.assert_allclose(poses[mine], columns[-1].real, rtol=0.0, atol=1e-9)
        expected = np.stack(columns, axis=2).imag / tiny
        size = np.abs(expected).max(axis=(0, 1))
        # by the twist, tyres are one-sided differences
        np.testing.assert_array_less(np.abs(derivatives[mine] - expected).max(axis=(0, 1)), 2e-5 * size + 5e-6)


def test_functions_with_no_coefficient_change_nothing(part: Take) -> None:  # noqa: F811
    start, layout = shove(part), segment_layout(part)
    known = BASE.prediction_inputs(BASE.phi_of(BASE.nominal), part)
    none = with_functions(part, draw_functions(np.random.default_rng(5), 3, 0.0), {})
    before, after = (predict_poses(layout, start, *i.kernel_arguments) for i in (known, none))
    np.testing.assert_allclose(before, after, atol=1e-12)


def test_a_constant_force_is_a_push(part: Take) -> None:  # noqa: F811
    """A function of wave zero along the body, over the mass, is an acceleration of the pushes."""
    layout, start = segment_layout(part), part.start.copy()
    table = np.zeros((1, COLUMNS))
    table[0, COEFFICIENT] = 0.2
    by_function = predict_poses(layout, start, *with_functions(part, table, {}).kernel_arguments)
    start[:, 6::3] += 0.2
    known: Any = BASE.prediction_inputs(BASE.phi_of(BASE.nominal), part)
    np.testing.assert_allclose(by_function, predict_poses(layout, start, *known.kernel_arguments), atol=1e-12)


# --- evidence ------------------------------------------------------------------------------------------------------


def test_log_evidence_is_that_of_the_linear_model_integrated() -> None:
    """log N(r; 0, 1 + B T B^T) - log N(r; 0, 1), by the full covariance."""
    rng = np.random.default_rng(1)
    B, sd = rng.standard_normal((40, 6)), np.array([0.3, 0.0, 1.0, 2.0, 0.1, 0.5])
    r = B @ (sd * rng.standard_normal(6)) + rng.standard_normal(40)
    whole = np.eye(40) + (B * sd**2) @ B.T
    expected = 0.5 * (r @ r - r @ np.linalg.solve(whole, r) - np.linalg.slogdet(whole)[1])
    quadratic = Quadratic(B.T @ r, B.T @ B)
    assert quadratic.log_evidence(sd) == pytest.approx(expected, abs=1e-9)
    c = quadratic.posterior_mean(sd)
    assert c[1] == 0.0
    on = np.flatnonzero(sd)
    np.testing.assert_allclose(B[:, on].T @ (r - B @ c), c[on] / sd[on] ** 2, atol=1e-9)
    covariance = quadratic.posterior_covariance(sd)
    expected = np.linalg.inv(quadratic.G[np.ix_(on, on)] + np.diag(sd[on] ** -2.0))
    np.testing.assert_allclose(covariance[np.ix_(on, on)], expected, atol=1e-12)
    assert not covariance[1].any()


def columns_basis(channel: tuple[str, ...]) -> RemainderBasis:
    K = len(channel)
    return RemainderBasis(np.zeros((K, COLUMNS)), np.zeros((0, TRACKING_COLUMNS)), channel, np.ones(K))


def test_spreads_are_zero_in_noise_and_near_the_truth_where_something_is() -> None:
    rng = np.random.default_rng(2)
    basis, zeros, found = columns_basis(("fx",) * 8 + ("mz",) * 8), 0, []
    for _ in range(20):
        B = rng.standard_normal((400, 16)) * 10.0
        noise = Quadratic(B.T @ (r := rng.standard_normal(400)), B.T @ B)
        zeros += not any(likeliest_spreads(noise, basis, basis.channels).values())
        more = r + B[:, 8:] @ (0.2 * rng.standard_normal(8))
        quadratic = Quadratic(B.T @ more, B.T @ B)
        spread = likeliest_spreads(quadratic, basis, basis.channels)
        found.append(spread["mz"])
        worth = channel_worths(quadratic, basis, spread)
        assert worth.get("fx", 0.0) < 8.0 < worth["mz"]
    assert zeros >= 5
    assert 0.1 < np.median(found) < 0.4


def concealing(**plant: float) -> tuple[Any, Take]:
    """The base model fitted to three simulated minutes of a car with something the model lacks."""
    vehicle = simulated_vehicle()
    recording = record_drive(simulate_drive(Plant(**plant), Sensor(), 180.0, 4), 60.0, vehicle)
    base = fit_base_model([recording], [estimate_motion(recording, vehicle, TUNING)], vehicle)
    return base.fit, base.take


def test_a_take_of_nothing_needs_no_remainder() -> None:
    fit, take = concealing()
    rest = fit_with_remainder(fit, take, basis_for(fit, take))
    assert rest.nats < 3.0
    assert rest.fit.hypothesis.effects == fit.hypothesis.effects


@pytest.mark.parametrize(("name", "constants", "channel"), [
    ("yaw_scrub", {"yaw_scrub": 20.0}, "mz"), ("rear_rolling_viscous", {"rear_rolling_viscous": 25.0}, "fx"),
])  # fmt: skip
def test_a_name_adds_much_beside_the_remainder_that_may_replace_it(
    name: str, constants: dict[str, float], channel: str
) -> None:
    """Before it is named the remainder finds its channel; beside the name nothing is left."""
    fit, take = concealing(**constants)
    basis = basis_for(fit, take)
    before = fit_with_remainder(fit, take, basis)
    assert next(iter(before.seen.channel_nats())) == channel
    more, phi = fit.hypothesis.add_effect(name, fit.phi, list(constants.values()))
    named = refit(take, more, phi, fit.start, fit.scales)
    after = fit_with_remainder(named, take, basis)
    assert before.nats > 100.0
    assert after.nats < 5.0
    assert after.log_evidence - before.log_evidence > 50.0


def test_a_missing_moment_is_seen_as_a_curve(part: Take) -> None:  # noqa: F811
    """Half waves span what a drive went through: at its edges they are 1 and -1."""
    q = dict.fromkeys(INPUTS, np.linspace(-2.0, 2.0, 101))
    basis = remainder_basis(q, BASE.nominal)
    row = next(
        f for f, t in zip(basis.functions, TERMS, strict=True) if t.direction == "yaw" and dict(t.waves) == {"t": 1}
    )
    at = [np.cos(row[PHASE] + row[WAVE + INPUTS.index("t")] * s) for s in (-2.0, 0.0, 2.0)]
    np.testing.assert_allclose(at, [1.0, 0.0, -1.0], atol=1e-12)
