"""What any force does to predicted poses: by its values in each knot, as far as differences of predictions."""

from __future__ import annotations

import numpy as np
import pytest
from cars import CAR
from test_remainder import with_functions
from test_variational import estimate, part, shove  # noqa: F401  # fixtures

from bcid.aliases import Floats
from bcid.effects.remainder import WheelDirections, unit_remainder
from bcid.effects.remainder_table import COEFFICIENT, COLUMNS, DIRECTION, DIRECTIONS, INPUTS, PHASE, ROLLING_V, WAVE
from bcid.likelihood.force_history import (
    ACTIONS,
    HEADING,
    answer_to,
    history_values,
    unit_actions,
)
from bcid.likelihood.lane_rollout import segment_layout
from bcid.likelihood.linearised_rollout import ALONG
from bcid.likelihood.nuisance import linearise_histories
from bcid.likelihood.predict import FINE, predict_poses
from bcid.likelihood.take import SEGMENT_S, Take
from bcid.likelihood.tracking_functions import (
    FIRST_WAVE,
    INTO,
    SHIFT,
    TRACKING_COLUMNS,
    TRACKING_DIRECTIONS,
    SeenRows,
    _rates,
    tracking_changes,
)


def one_function(direction: str, **wave: float) -> Floats:
    """A table of one function, of a unit at its crest, in a direction."""
    table = np.zeros((1, COLUMNS))
    table[0, DIRECTION], table[0, PHASE] = DIRECTIONS.index(direction), 0.3 if wave else 0.0
    for name, number in wave.items():
        table[0, WAVE + INPUTS.index(name)] = number
    return table


def answer(take: Take, table: Floats, on: dict[str, float]) -> Floats:
    """Derivatives (N, 3) of predicted poses by the coefficient of one function, from its history."""
    nothing = with_functions(take, np.zeros((0, COLUMNS)), on)
    at = linearise_histories(take, nothing, shove(take))
    return answer_to(at.history.D, history_values(table, at.history.along, nothing.car), take.first)[:, :, 0]


def difference(take: Take, table: Floats, on: dict[str, float], h: float = 1e-4) -> Floats:
    """Those by predictions with a little of it either way."""
    ends, layout, start = [], segment_layout(take), shove(take)
    for amount in (h, -h):
        some = table.copy()
        some[:, COEFFICIENT] = amount
        ends.append(predict_poses(layout, start, *with_functions(take, some, on).kernel_arguments))
    return (ends[0] - ends[1]) / (2.0 * h)


KNOT = SEGMENT_S / FINE.knots  # s

HELD = {"body_x": 1e-5, "rear_across": 1e-5, "yaw": 1e-5, "wheel_angle": 1e-4}
"""Directions that do not turn within a knot, so that a constant is held exactly; by parts of the largest answer."""


@pytest.mark.parametrize("on", [{}, {"mass_change__d": 0.3, "mass_change__t_s": -1e3}], ids=["base", "heavier"])
@pytest.mark.parametrize("direction", DIRECTIONS)
def test_a_constant_in_each_direction_is_answered_as_predictions_are(
    part: Take, direction: str, on: dict[str, float]  # noqa: F811
) -> None:  # fmt: skip
    table = one_function(direction)
    expected = difference(part, table, on)
    error = np.abs(answer(part, table, on) - expected) / np.abs(expected).max()
    assert np.quantile(error, 0.95) < HELD.get(direction, 5e-3)
    assert np.abs(expected).max() > 1e-3


@pytest.mark.parametrize("direction", DIRECTIONS)
@pytest.mark.parametrize("wave", [{"t": 4.0}, {"p_x": 1.0, "p_y": -0.7}, {"v_x": 1.5, "delta": 1.0}])
def test_what_varies_is_answered_by_its_value_in_each_knot(
    part: Take, direction: str, wave: dict[str, float]  # noqa: F811
) -> None:  # fmt: skip
    table = one_function(direction, **wave)
    expected = difference(part, table, {})
    error = np.abs(answer(part, table, {}) - expected) / np.abs(expected).max()
    assert np.quantile(error, 0.95) < 1e-2


def test_any_number_of_functions_is_answered_as_each_alone(part: Take) -> None:  # noqa: F811
    tables = [one_function("yaw", t=3.0), one_function("front_along"), one_function("world_y", p_x=0.5)]
    nothing = with_functions(part, np.zeros((0, COLUMNS)), {})
    at = linearise_histories(part, nothing, shove(part))
    whole = answer_to(at.history.D, history_values(np.concatenate(tables), at.history.along, nothing.car), part.first)
    assert whole.shape == (len(part.pose), 3, 3)
    for k, table in enumerate(tables):
        np.testing.assert_allclose(whole[:, :, k], answer(part, table, {}), atol=1e-12)
    none = answer_to(at.history.D, history_values(np.zeros((0, COLUMNS)), at.history.along, nothing.car), part.first)
    assert none.shape == (len(part.pose), 3, 0)


@pytest.mark.parametrize("front_share", [1.0, 0.0, 0.4])
def test_units_are_those_of_the_compiled_car(front_share: float) -> None:
    """In every direction, at any wheel angle and heading, ahead, backwards and about to stop."""
    rng, car = np.random.default_rng(0), CAR._replace(front_share=front_share)
    along = rng.uniform(-2.0, 2.0, (4, FINE.knots, ALONG))
    along[:, ::3, INPUTS.index("v_x")] *= 0.5 * ROLLING_V
    units = unit_actions(along, car)
    assert units.shape == (4, FINE.knots, ACTIONS, len(DIRECTIONS))
    for k in range(len(DIRECTIONS)):
        for s, i in ((0, 0), (1, 7), (2, 3), (3, FINE.knots - 1)):
            delta, heading, v_x = along[s, i, [INPUTS.index("delta"), HEADING, INPUTS.index("v_x")]]
            turned = (f(x) for x in (delta, heading) for f in (np.sin, np.cos))
            unit = unit_remainder(float(k), WheelDirections(*turned, np.tanh(v_x / ROLLING_V)), car)
            alpha = unit.alpha + unit.arm * car.m / car.I_z
            expected = [unit.f_x, unit.f_y, alpha, unit.turn]
            np.testing.assert_allclose(units[s, i, :, k], expected, atol=1e-12, err_msg=DIRECTIONS[k])


def test_what_acts_along_the_way_that_a_car_rolls_turns_round_with_it() -> None:
    """As dry friction does, from rest on."""
    along = np.zeros((1, FINE.knots, ALONG))
    v_x = np.linspace(-4.0 * ROLLING_V, 4.0 * ROLLING_V, FINE.knots)
    along[0, :, INPUTS.index("v_x")] = v_x
    rolling = unit_actions(along, CAR)[0, :, :, DIRECTIONS.index("rolling")]
    np.testing.assert_allclose(rolling[:, 0], np.tanh(v_x / ROLLING_V))
    np.testing.assert_allclose(rolling[[0, -1], 0], [-1.0, 1.0], atol=1e-3)
    assert not rolling[:, 1:].any()


def test_what_is_told_of_a_knot_is_the_drive_there(part: Take) -> None:  # noqa: F811
    at = linearise_histories(part, with_functions(part, np.zeros((0, COLUMNS)), {}), shove(part))
    along = at.history.along
    assert along.shape[1] == FINE.knots
    t, knot = along[:, :, INPUTS.index("t")], np.arange(FINE.knots)
    np.testing.assert_allclose(t - t[:, :1], np.broadcast_to(KNOT * knot, t.shape), atol=1e-9)
    np.testing.assert_allclose(t[:, 0], part.begin_s - part.zero_s + 0.5 * KNOT, atol=1e-9)
    seen = part.seen_rows.time_s
    for s in (0, part.segments - 1):
        own = slice(part.first[s], part.first[s + 1])
        for k, column in enumerate((INPUTS.index("p_x"), INPUTS.index("p_y"), HEADING)):
            there = np.interp(t[s], seen[own], at.poses[own, k])
            inside = (t[s] > seen[own][0]) & (t[s] < seen[own][-1])
            np.testing.assert_allclose(along[s, inside, column], there[inside], atol=5e-3)


# --- in the tracking ------------------------------------------------------------------------------------------------


def path(t: Floats) -> Floats:
    """Poses of a car that goes about, with rates of the order of one."""
    return np.column_stack([np.sin(t), 0.5 * t**2, np.cos(2.0 * t)])


def test_rates_are_gradients_of_each_segment() -> None:
    """As `np.gradient` has them for uneven times; a segment of one row shows none."""
    rng, sizes = np.random.default_rng(1), [7, 1, 2, 30]
    first = np.concatenate([[0], np.cumsum(sizes)])
    times = [s + np.cumsum(rng.uniform(0.01, 0.09, n)) for s, n in enumerate(sizes)]
    poses = np.concatenate([path(t) for t in times])
    found = np.split(_rates(poses, SeenRows(np.concatenate(times), first)), first[1:-1])
    np.testing.assert_array_equal(found[1], 0.0)
    for k in (0, 2, 3):
        expected = np.gradient(path(times[k]), times[k], axis=0)
        np.testing.assert_allclose(found[k], expected, rtol=1e-9, atol=1e-9)


def test_rows_at_one_time_have_a_finite_rate() -> None:
    """Where two takes meet, a segment may begin when another ends."""
    t = np.array([0.0, 0.1, 0.2, 0.2, 0.3])
    found = _rates(path(t), SeenRows(t, np.array([0, 3, 5])))
    assert np.isfinite(found).all()
    np.testing.assert_allclose(found[3:], np.gradient(path(t[3:]), t[3:], axis=0))


def seen_function(direction: str, **wave: float) -> Floats:
    table = np.zeros((1, TRACKING_COLUMNS))
    table[0, INTO], table[0, SHIFT] = TRACKING_DIRECTIONS.index(direction), 0.2
    for name, number in wave.items():
        table[0, FIRST_WAVE + ("p_x", "p_y", "t").index(name)] = number
    return table


@pytest.mark.parametrize("direction", TRACKING_DIRECTIONS)
def test_a_unit_moves_the_seen_pose_in_its_direction(direction: str) -> None:
    t = np.linspace(2.0, 3.4, 40)
    poses, rows = path(t), SeenRows(t, np.array([0, 40]))
    found = tracking_changes(seen_function(direction, p_x=0.7, t=2.0), poses, rows)[:, :, 0]
    value = np.cos(0.7 * poses[:, 0] + 2.0 * t + 0.2)[:, None]
    cos, sin, zero = np.cos(poses[:, 2]), np.sin(poses[:, 2]), np.zeros(40)
    one = zero + 1.0
    expected = {
        "seen_x": (one, zero, zero), "seen_y": (zero, one, zero), "seen_yaw": (zero, zero, one),
        "seen_along": (cos, sin, zero), "seen_across": (-sin, cos, zero),
        "seen_late": tuple(-np.gradient(poses, t, axis=0).T),
    }[direction]  # fmt: skip
    np.testing.assert_allclose(found, value * np.column_stack(expected), atol=1e-9)


def test_what_is_seen_late_is_where_the_car_was() -> None:
    """By 10 ms, of a smooth path."""
    t, late = np.linspace(0.0, 1.4, 29), 0.01
    table = np.zeros((1, TRACKING_COLUMNS))
    table[0, INTO] = TRACKING_DIRECTIONS.index("seen_late")
    change = tracking_changes(table, path(t), SeenRows(t, np.array([0, 29])))[:, :, 0] * late
    np.testing.assert_allclose(change[1:-1], (path(t - late) - path(t))[1:-1], atol=5e-4)
    assert tracking_changes(np.zeros((0, TRACKING_COLUMNS)), path(t), SeenRows(t, np.array([0, 29]))).shape == (
        29,
        3,
        0,
    )
