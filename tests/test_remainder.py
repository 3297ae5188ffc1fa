"""What has no name: functions without a name in the car, and their derivatives."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from cars import CAR
from concealed import concealing
from test_effects import random_body
from test_variational import BASE, Instant, at_steps, drive, estimate, part, shove  # noqa: F401  # fixtures

from bcid.diagnosis.limits import LOCATE_LIMITS
from bcid.diagnosis.locate.pushes import estimate_disturbances
from bcid.diagnosis.remainder.evidence import SPREADS, Quadratic, channel_worths, likeliest_spreads
from bcid.diagnosis.remainder.explain import Explained, basis_for, explain, explain_with_copies
from bcid.diagnosis.remainder.fit import fit_with_remainder, needed_functions
from bcid.diagnosis.remainder.functions import (
    CHANNELS,
    COPIES,
    LINEAR,
    QUANTITIES,
    SEEN,
    SEEN_COPIES,
    TERMS,
    RemainderBasis,
    channel_of,
    remainder_basis,
)
from bcid.effects.car import LagState, wrench_with_effects
from bcid.effects.constants import Constants
from bcid.effects.remainder_table import (
    COEFFICIENT,
    COLUMNS,
    DIRECTION,
    DIRECTIONS,
    INPUTS,
    PHASE,
    ROLLING_V,
    WAVE,
    WHEEL_ANGLE,
)
from bcid.effects.table import effect_switches
from bcid.effects.unnamed_action import add_remainder
from bcid.likelihood.force_history import ACTIONS, HISTORY
from bcid.likelihood.lane_rollout import segment_layout
from bcid.likelihood.nuisance import linearise_nuisances, linearise_residuals, pose_residuals
from bcid.likelihood.predict import FINE, linearise_poses, predict_poses, wrap_yaw
from bcid.likelihood.prediction_inputs import PredictionInputs
from bcid.likelihood.refit import refit
from bcid.likelihood.take import N_NUISANCE, N_START, Take
from bcid.likelihood.tracking_functions import (
    AMOUNT,
    FIRST_WAVE,
    INTO,
    TRACKING_COLUMNS,
    TRACKING_DIRECTIONS,
    TRACKING_INPUTS,
)
from bcid.likelihood.unnamed_functions import UnnamedFunctions

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
    return known._replace(switches=effect_switches(on, functions), functions=functions)


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
    alone = linearise_nuisances(part, inputs, start)  # pushes as they are, not summed over knots
    np.testing.assert_allclose(alone.r, r, atol=1e-12)
    np.testing.assert_allclose(alone.A, A, rtol=1e-9, atol=1e-10)
    poses, derivatives = part.pose - r, np.concatenate([A, J], axis=2)
    assert derivatives.shape[2] == N_NUISANCE + len(table)
    predicted = predict_poses(layout, start, *inputs.kernel_arguments)
    np.testing.assert_allclose(wrap_yaw(poses - predicted), 0.0, atol=1e-12)
    expected = central_differences(part, table, on)
    size = np.abs(expected).max(axis=(0, 1))
    assert (size > 1e-4).all()
    error = np.abs(derivatives - expected) / size
    # a kink within a difference is none of these; functions are held over 0.125 s
    each = np.quantile(error, 0.95, axis=(0, 1))
    assert (each < 5e-2).all()
    assert np.quantile(error, 0.95) < 2e-2
    assert np.median(error.max(axis=(0, 1))) < 5e-2
    assert np.quantile(error[:, :, :N_NUISANCE], 0.95) < 1e-4
    turns = table[:, DIRECTION] == WHEEL_ANGLE
    table[turns, WAVE:-1] = 0.0
    A = linearise_residuals(part, with_functions(part, table, on), start).A
    expected = central_differences(part, table, on, N_NUISANCE)
    assert np.quantile(np.abs(A - expected) / np.abs(expected).max(axis=(0, 1)), 0.95) < 1e-4


def central_differences(take: Take, table: np.ndarray, on: dict[str, float], only: int | None = None) -> np.ndarray:
    """Derivatives (N, 3, C) of predictions by initial states and pushes, then by coefficients: the first `only`."""
    start, layout, columns, h = shove(take), segment_layout(take), [], 1e-5
    for j in range(only or N_NUISANCE + len(table)):
        ends = []
        for sign in (1.0, -1.0):
            functions, states = table.copy(), start.copy()
            if j < N_NUISANCE:
                states[:, j] += sign * h
            else:
                functions[j - N_NUISANCE, COEFFICIENT] += sign * h
            ends.append(predict_poses(layout, states, *with_functions(take, functions, on).kernel_arguments))
        columns.append((ends[0] - ends[1]) / (2.0 * h))
    return np.stack(columns, axis=2)


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
    f_x += np.tanh(v_x / ROLLING_V) * total["rolling"]
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


@pytest.mark.parametrize(
    ("on", "servo"),
    [
        ({"steering_offset__o": 0.05}, lambda delta: delta - 0.05),
        ({"steering_scale__g": 0.2}, lambda delta: delta / 1.2),
        ({"steering_side_gain__a": 0.1}, lambda delta: delta / (1.1 if delta > 0.0 else 0.9)),
    ],
    ids=["offset", "scale", "side"],
)
def test_functions_depend_on_the_angle_of_the_wheel(on: dict[str, float], servo: Callable[[float], float]) -> None:
    """However far the servo has to turn for it: what a tyre does without a name is its own."""
    rng, lags = np.random.default_rng(8), LagState(0.0, 0.0, 0.0)
    table = draw_functions(rng, 3, 0.3)
    plain, bent = effect_switches({}, table), effect_switches(on, table)
    for _ in range(50):
        b, now = random_body(rng)
        expected = wrench_with_effects(b, add_remainder(now, b, CAR, plain), lags, CAR, plain, Constants())
        there = now._replace(delta=servo(now.delta))
        found = wrench_with_effects(b, add_remainder(there, b, CAR, bent), lags, CAR, bent, Constants())
        assert found[:3] == pytest.approx(expected[:3], rel=1e-9, abs=1e-9)


def test_what_a_simulation_knows_of_the_tracking_moves_seen_poses(part: Take) -> None:  # noqa: F811
    shift = np.zeros((1, TRACKING_COLUMNS))
    shift[0, AMOUNT], shift[0, INTO] = 0.2, TRACKING_DIRECTIONS.index("seen_x")
    aside = replace(BASE, known=UnnamedFunctions(tracking=shift))
    before, after = (
        pose_residuals(part, h.prediction_inputs(h.phi_of(h.nominal), part), part.start) for h in (BASE, aside)
    )
    np.testing.assert_allclose(before - after, np.tile([0.2, 0.0, 0.0], (len(before), 1)), atol=1e-12)


def test_functions_lie_over_the_angles_through_which_the_wheel_went() -> None:
    fit, take = concealing(60.0)
    more, phi = fit.hypothesis.add_effect("steering_offset", fit.phi, [0.1])
    turned = replace(fit, hypothesis=more, phi=phi)
    straight, aside = (estimate_disturbances(f, take).states["delta"] for f in (fit, turned))
    np.testing.assert_allclose(aside, straight + 0.1, atol=1e-12)


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


def random_quadratic(rng: np.random.Generator, basis: RemainderBasis, sizes: dict[str, float]) -> Quadratic:
    """Of a linear model with unit noise, in which each channel's functions act with so large coefficients."""
    K = len(basis.size)
    B = rng.standard_normal((60, K)) + 0.5 * rng.standard_normal((60, 1))  # which are alike
    c = np.array([sizes.get(name, 0.0) for name in basis.channel]) * basis.size * rng.standard_normal(K)
    return Quadratic(B.T @ (B @ c + rng.standard_normal(60)), B.T @ B)


@pytest.mark.parametrize("sizes", [{}, {"mz": 0.6}, {"fx": 1.0, "mz": 0.3}], ids=["nothing", "one", "both"])
def test_spreads_are_the_likeliest_of_all(sizes: dict[str, float]) -> None:
    """Of every pair of spreads, by the evidence itself: never by more than a round of improvement may leave."""
    rng = np.random.default_rng(11)
    K = 10
    basis = columns_basis(("fx",) * 4 + ("mz",) * 6)._replace(size=rng.uniform(0.2, 1.0, K))
    for _ in range(4):
        quadratic = random_quadratic(rng, basis, sizes)
        found = likeliest_spreads(quadratic, basis, basis.channels)
        every = [quadratic.log_evidence(basis.sd({"fx": a, "mz": b})) for a, b in itertools.product(SPREADS, repeat=2)]
        assert quadratic.log_evidence(basis.sd(found)) == pytest.approx(max(every), abs=0.15)
        assert quadratic.log_evidence(basis.sd(dict.fromkeys(found, 0.0))) == 0.0
        near = likeliest_spreads(quadratic, basis, basis.channels, {"fx": SPREADS[9], "mz": SPREADS[3]})
        assert quadratic.log_evidence(basis.sd(near)) == pytest.approx(max(every), abs=0.5)


def test_only_channels_that_are_asked_for_have_a_spread() -> None:
    rng = np.random.default_rng(12)
    basis = columns_basis(("fx",) * 3 + ("mz",) * 3)
    quadratic = random_quadratic(rng, basis, {"fx": 1.0, "mz": 1.0})
    found = likeliest_spreads(quadratic, basis, ["mz"], {"fx": SPREADS[8]})
    assert found["fx"] == 0.0
    nats = [quadratic.log_evidence(basis.sd({"fx": 0.0, "mz": tau})) for tau in SPREADS]
    assert found["mz"] == SPREADS[int(np.argmax(nats))]
    c = quadratic.posterior_mean(basis.sd(found))
    assert not c[:3].any()


@pytest.mark.parametrize("group", ["fx~", "fx="])
def test_waves_and_copies_count_as_their_channel_s(group: str) -> None:
    """What a channel adds beside the others is what the evidence loses without it, its waves and copies with it."""
    rng = np.random.default_rng(13)
    basis = columns_basis(("fx",) * 3 + (group,) * 2 + ("mz",) * 3)
    quadratic = random_quadratic(rng, basis, {"fx": 0.5, group: 1.0, "mz": 0.7})
    spread = likeliest_spreads(quadratic, basis, basis.channels)
    worths = channel_worths(quadratic, basis, spread)
    assert set(worths) == {"fx", "mz"}
    whole = quadratic.log_evidence(basis.sd(spread))
    best = max(quadratic.log_evidence(basis.sd({"fx": 0.0, group: 0.0, "mz": tau})) for tau in SPREADS)
    assert worths["fx"] == pytest.approx(whole - best, abs=1e-9)
    assert list(worths.values()) == sorted(worths.values(), reverse=True)


def test_copies_that_were_not_asked_for_take_no_channel_s_place() -> None:
    """They stay out of what the others explain without it, too."""
    rng = np.random.default_rng(14)
    basis = columns_basis(("fx",) * 3 + ("mz",) * 3 + ("fy=",) * 3)
    B = rng.standard_normal((60, 3))
    B = np.column_stack([rng.standard_normal((60, 3)), B, B])  # copies of what moves in mz
    quadratic = Quadratic(B.T @ (B[:, 3:6] @ np.ones(3) + rng.standard_normal(60)), B.T @ B)
    spread = likeliest_spreads(quadratic, basis, basis.groups(()))
    assert spread["fy="] == 0.0
    assert spread["mz"] > 0.0
    assert channel_worths(quadratic, basis, spread)["mz"] > 20.0


def test_what_is_needed_is_some_standard_deviations_from_zero() -> None:
    quadratic = Quadratic(np.zeros(4), np.diag([100.0, 100.0, 100.0, 0.0]))
    sd, c = np.array([1.0, 1.0, 0.0, 1.0]), np.array([0.2, -0.01, 5.0, 5.0])
    assert needed_functions(quadratic, sd, c).tolist() == [0]


# --- the functions -------------------------------------------------------------------------------------------------


def spanning() -> RemainderBasis:
    """The whole basis of a drive through all from -1 to 1."""
    return remainder_basis(dict.fromkeys(INPUTS, np.linspace(-1.0, 1.0, 201)), BASE.nominal)


def test_the_basis_has_every_term_once_in_order() -> None:
    basis, on_body, in_tracking = spanning(), (*TERMS, *COPIES), (*SEEN, *SEEN_COPIES)
    assert (len(basis.functions), len(basis.tracking)) == (len(on_body), len(in_tracking))
    assert basis.channel == tuple(t.channel for t in (*on_body, *in_tracking))
    assert len(basis.size) == len(basis.channel)
    assert not basis.functions[:, COEFFICIENT].any()
    assert not basis.prices
    rows = np.round(np.column_stack([basis.functions[:, DIRECTION], basis.functions[:, PHASE:]]), 9)
    assert len(np.unique(rows, axis=0)) == len(rows)
    for row, term in zip(basis.functions, on_body, strict=True):
        assert DIRECTIONS[int(row[DIRECTION])] == term.direction
    for row, term in zip(basis.tracking, in_tracking, strict=True):
        assert TRACKING_DIRECTIONS[int(row[INTO])] == term.direction
    # the more half waves, the smaller
    alone = [(sum(a * a for a in t.waves.values()), s) for t, s in zip(TERMS, basis.size, strict=False)
             if t.direction == "body_x"]  # fmt: skip
    assert all(s == pytest.approx(1.0 / (1.0 + n)) for n, s in alone)


def test_constants_are_copies_of_laws_and_stand_apart() -> None:
    """All but a moment: of a force, of a turn of the wheel and of what is seen each constant has a name."""
    for term in (*TERMS, *SEEN):
        assert term.waves or term.direction == "yaw", term
        assert not term.channel.endswith(("=", "~"))
    copies = (*COPIES, *SEEN_COPIES)
    for term in copies:
        assert set(term.waves.values()) <= {LINEAR}
        assert term.channel.endswith("=")
    constants = {t.direction for t in copies if not t.waves}
    # a moment has no name, and an offset of the place is the world's
    assert constants == {*DIRECTIONS, *TRACKING_DIRECTIONS} - {"yaw", "seen_x", "seen_y"}
    assert {t.direction for t in copies if t.waves} == {"body_x", "yaw", "wheel_angle", "seen_x", "seen_y"}


def test_a_straight_line_is_one_at_both_ends() -> None:
    """A straight line's unit is the prior's common size at the ends of the range; it is zero in its middle."""
    basis, terms = spanning(), (*TERMS, *COPIES)
    k = next(i for i, t in enumerate(terms) if t.waves == {"v_x": LINEAR})
    row, v_x = basis.functions[k], np.linspace(-2.0, 2.0, 5)
    low, high = -(np.pi / 2.0 + row[PHASE]) / row[WAVE], (np.pi / 2.0 - np.pi - row[PHASE]) / row[WAVE]
    assert low == pytest.approx(high)  # the node, in the middle of the range
    slope = np.gradient(np.cos(row[WAVE] * v_x + row[PHASE]), v_x)
    np.testing.assert_allclose(slope, slope[0], rtol=1e-3)
    assert basis.size[k] == pytest.approx(2.0 / (np.pi * LINEAR), rel=1e-3)


def test_channels_are_groups_of_their_functions() -> None:
    basis = spanning()
    assert {channel_of(name) for name in basis.channels} == set(CHANNELS)
    own = {name for name in basis.channels if name == channel_of(name)}
    assert own == set(CHANNELS)
    assert {*basis.groups(())} == own
    assert {*basis.groups(("fx", "pose"))} == own | {"fx=", "pose="}
    assert basis.groups(CHANNELS) == basis.channels


@pytest.mark.parametrize("group", ["fx", "fx~", "fx="])
def test_waves_and_constants_belong_to_their_channel(group: str) -> None:
    assert channel_of(group) == "fx"


def test_quantities_are_told_by_what_functions_depend_on() -> None:
    basis = spanning()
    found = basis.quantities()
    assert set(found) == set(QUANTITIES.values())
    for k, term in enumerate((*TERMS, *COPIES, *SEEN, *SEEN_COPIES)):
        assert {q for q, on in found.items() if on[k]} == {QUANTITIES[name] for name in term.waves}, term
    column = FIRST_WAVE + TRACKING_INPUTS.index("t")
    np.testing.assert_array_equal(found["time"][len(basis.functions) :], basis.tracking[:, column] != 0.0)


def test_chosen_functions_keep_channel_and_size() -> None:
    """Those on the body first, as they stand in a fit."""
    basis = spanning()
    B, sd = len(basis.functions), np.arange(1.0, len(basis.size) + 1.0)
    on = np.array([3, 40, B, B + 5])
    chosen = basis.choose(on, sd)
    np.testing.assert_array_equal(chosen.functions, basis.functions[[3, 40]])
    np.testing.assert_array_equal(chosen.tracking, basis.tracking[[0, 5]])
    assert chosen.channel == tuple(basis.channel[j] for j in on)
    np.testing.assert_array_equal(chosen.sd, sd[on])


def explaining(by: dict[str, float]) -> Explained:
    """What functions of one quantity each explain of a channel, so many nats."""
    functions = np.zeros((len(by) + 1, COLUMNS))
    for k, name in enumerate(by):
        functions[k, WAVE + INPUTS.index(name)] = 1.0
    functions[-1, WAVE + INPUTS.index("u_m")] = 1.0
    basis = RemainderBasis(
        functions, np.zeros((0, TRACKING_COLUMNS)), ("fx",) * (len(by) - 1) + ("fx~", "motor"), np.ones(len(by) + 1)
    )
    c = np.ones(len(by) + 1)
    b = 2.0 * np.array([*by.values(), 1e3])
    return Explained(
        (), basis, {"fx": 1.0, "fx~": 1.0, "motor": 1.0}, Quadratic(b, np.diag(b)), c, np.zeros(0), np.ones(3)
    )


def test_what_explains_most_says_on_what_it_depends() -> None:
    """Of the channel that is asked for, with its waves; only what explains a fair share, and not too many."""
    assert explaining({"v_x": 60.0, "delta": 40.0}).depends_on("fx") == ("v_x", "steering")
    assert explaining({"v_x": 30.0, "t": 70.0}).depends_on("fx") == ("time",)  # 30 % is no more than the least
    assert explaining({"v_x": 20.0, "p_x": 25.0, "p_y": 25.0, "t": 30.0}).depends_on("fx") == ("place",)
    assert explaining({"v_x": 20.0, "p_x": 25.0, "p_y": 25.0, "t": 30.0}).depends_on("motor") == ("throttle",)
    assert explaining({"v_x": 5.0, "delta": -1.0}).depends_on("fx") == ("v_x",)
    assert len(explaining({"v_x": 33.0, "t": 33.0, "delta": 33.0}).depends_on("fx")) == LOCATE_LIMITS.max_quantities
    assert explaining({"v_x": 0.0, "delta": 0.0}).depends_on("fx") == ()


@pytest.mark.parametrize(("constant", "told"), [(100.0, ("v_x",)), (200.0, ())])
def test_a_constant_depends_on_nothing(constant: float, told: tuple[str, ...]) -> None:
    """Beside it what varies is told, unless that is little."""
    seen = explaining({"v_x": 60.0, "t": 10.0, "delta": constant})
    functions = seen.basis.functions.copy()
    functions[2, WAVE:] = 0.0
    channel = (*seen.basis.channel[:2], "fx=", "motor")
    assert seen._replace(basis=seen.basis._replace(functions=functions, channel=channel)).depends_on("fx") == told


def test_what_is_explained_is_worth_its_evidence_less_its_price() -> None:
    seen = explaining({"v_x": 60.0, "delta": 40.0})
    whole = seen.quadratic.log_evidence(seen.basis.sd(seen.spread))
    assert seen.nats == pytest.approx(whole)
    group = seen.basis.channel[0]
    dear = seen._replace(basis=seen.basis._replace(prices={group: 7.0}))
    assert dear.nats == pytest.approx(whole - 7.0)
    assert dear._replace(spread={**seen.spread, group: 0.0}).nats == pytest.approx(
        seen._replace(spread={**seen.spread, group: 0.0}).nats
    )
    more = seen.beside(columns_basis((*seen.basis.channel, "mz~", "mz~")))
    assert more.spread["mz~"] == 0.0
    assert {n: more.spread[n] for n in seen.spread} == dict(seen.spread)


# --- of takes ------------------------------------------------------------------------------------------------------


def test_a_take_of_nothing_needs_no_remainder() -> None:
    fit, take = concealing(180.0)
    rest = fit_with_remainder(fit, take, explain(fit, take, basis_for(fit, take)))
    assert rest.nats < 3.0
    assert rest.fit.hypothesis.effects == fit.hypothesis.effects


@pytest.mark.parametrize(("name", "constants", "channel"), [
    ("yaw_scrub", {"yaw_scrub": 20.0}, "mz"), ("rear_rolling_viscous", {"rear_rolling_viscous": 25.0}, "fx"),
])  # fmt: skip
def test_a_name_adds_much_beside_the_remainder_that_may_replace_it(
    name: str, constants: dict[str, float], channel: str
) -> None:
    """Before it is named the remainder finds its channel; beside the name nothing is left."""
    fit, take = concealing(180.0, **constants)
    basis = basis_for(fit, take)
    before = fit_with_remainder(fit, take, explain(fit, take, basis))
    assert next(iter(before.seen.channel_nats())) == channel
    more, phi = fit.hypothesis.add_effect(name, fit.phi, list(constants.values()))
    named = refit(take, more, phi, fit.start, fit.scales)
    after = fit_with_remainder(named, take, explain(named, take, basis))
    assert before.nats > 100.0
    assert after.nats < 8.0  # less than any gate
    assert after.log_evidence - before.log_evidence > 50.0


def test_half_waves_span_what_a_drive_went_through() -> None:
    """At its edges they are 1 and -1."""
    q = dict.fromkeys(INPUTS, np.linspace(-2.0, 2.0, 101))
    basis = remainder_basis(q, BASE.nominal)
    row = next(
        f for f, t in zip(basis.functions, TERMS, strict=True) if t.direction == "yaw" and dict(t.waves) == {"t": 1}
    )
    at = [np.cos(row[PHASE] + row[WAVE + INPUTS.index("t")] * s) for s in (-2.0, 0.0, 2.0)]
    np.testing.assert_allclose(at, [1.0, 0.0, -1.0], atol=1e-12)


def test_functions_of_what_stays_at_one_value_do_not_turn_by_what_predictions_err() -> None:
    """A wheel is turned at the beginning, then held: its range is the whole turn, not the noise about its end."""
    held = np.r_[np.linspace(0.0, 0.2, 5), 0.2 + 1e-7 * np.sin(np.arange(995.0))]
    for turned, angles in ((held, (0.0, 0.2)), (held[5:], (0.2, 0.2 + 1e-3))):
        basis = remainder_basis({**dict.fromkeys(INPUTS, np.linspace(-2.0, 2.0, 101)), "delta": turned}, BASE.nominal)
        phase, per_rad = basis.half_waves[INPUTS.index("delta")]
        at = phase + per_rad * np.array(angles)
        np.testing.assert_allclose(at, (0.0, np.pi) if turned is held else (0.5 * np.pi, np.pi), atol=1e-3)


def test_copies_explain_only_in_channels_that_are_asked_for() -> None:
    """An angle that the wheel always has, which smooth functions explain in part."""
    fit, take = concealing(180.0, steering_offset=0.02)
    basis = basis_for(fit, take)
    none = explain(fit, take, basis)
    other, own = (explain_with_copies(fit, take, basis, copied) for copied in (("fx", "pose"), ("steering",)))
    assert not [n for n, tau in none.spread.items() if n.endswith("=") and tau > 0.0]
    assert {n for n, tau in other.spread.items() if n.endswith("=") and tau > 0.0} <= {"fx=", "pose="}
    assert [n for n, tau in own.spread.items() if n.endswith("=") and tau > 0.0] == ["steering="]
    assert own.nats > other.nats + 30.0
    j = own.basis.channel.index("steering=")
    assert abs(own.c[j]) == pytest.approx(0.02, rel=0.3)
    for seen in (none, other):
        assert seen.c[j] == 0.0


def test_a_refit_holds_copies_only_in_channels_that_are_asked_for() -> None:
    fit, take = concealing(180.0, steering_offset=0.02)
    basis = explain(fit, take, basis_for(fit, take)).basis
    without, copied = (
        fit_with_remainder(fit, take, explain_with_copies(fit, take, basis, own), own) for own in ((), ("steering",))
    )
    assert not [n for n in without.fit.hypothesis.remainder.channel if n.endswith("=")]
    assert [n for n in copied.fit.hypothesis.remainder.channel if n.endswith("=")] == ["steering="]
    assert copied.log_evidence > without.log_evidence + 30.0


@pytest.mark.parametrize("plant", [{"yaw_scrub": 2.0}, {"yaw_scrub": 8.0, "rough_force": 3.0, "rough_moment": 1.5}])
def test_a_refit_explains_no_less_than_was_promised_to_first_order(plant: dict[str, float]) -> None:
    """It may be several times as much: what is explained is no push, and pushes are expected to be smaller."""
    fit, take = concealing(120.0, **plant)
    basis = basis_for(fit, take)
    seen = explain(fit, take, basis)
    rest = fit_with_remainder(fit, take, seen)
    assert seen.nats > 50.0
    assert rest.nats > 0.9 * seen.nats
    assert rest.fit.scales.q[2] < fit.scales.q[2]
    assert rest.named is fit


def test_a_refit_that_cannot_reach_what_it_must_exceed_ends_early() -> None:
    """What it found till then is less than its evidence, which it says; a bound within reach changes nothing."""
    fit, take = concealing(120.0, yaw_scrub=8.0, rear_rolling_viscous=25.0)
    seen = explain(fit, take, basis_for(fit, take))
    whole = fit_with_remainder(fit, take, seen)
    early = fit_with_remainder(fit, take, seen, to_exceed=whole.log_evidence + 1e4)
    near = fit_with_remainder(fit, take, seen, to_exceed=whole.log_evidence)
    assert (whole.settled, early.settled, near.settled) == (True, False, True)
    assert fit.penalised_log_likelihood < early.log_evidence < whole.log_evidence
    assert near.log_evidence == whole.log_evidence
