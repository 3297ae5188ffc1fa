"""Fine waves are found in their direction at their wave number, and none where there is nothing."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from concealed import concealing

from bcid.aliases import Floats
from bcid.diagnosis.limits import SEARCH_LIMITS
from bcid.diagnosis.remainder import waves
from bcid.diagnosis.remainder.explain import basis_for, explain
from bcid.diagnosis.remainder.functions import RemainderBasis
from bcid.diagnosis.remainder.information import TakeInformation, gather_information
from bcid.diagnosis.remainder.waves import (
    CHANNEL_OF,
    FINEST_HZ,
    OVER_PLACE,
    SLOWEST_CYCLES,
    Gains,
    Wave,
    add_waves,
    find_wave,
)
from bcid.effects.remainder_table import COLUMNS, DIRECTION, DIRECTIONS, INPUTS, PHASE, WAVE
from bcid.likelihood.refit import Fit
from bcid.likelihood.take import N_NUISANCE, SEGMENT_S, Take
from bcid.likelihood.tracking_functions import (
    FIRST_WAVE,
    INTO,
    TRACKING_COLUMNS,
    TRACKING_DIRECTIONS,
    TRACKING_INPUTS,
)
from bcid.simulation.car import Sensor
from bcid.simulation.drive import SHAKE_S
from bcid.simulation.dynamics import SHIMMY_RADPS
from bcid.simulation.surroundings import SWAY_S

SECONDS = 90.0


class Null(NamedTuple):
    """A take of nothing, the base model's fit to it, and what it says of free functions."""

    fit: Fit
    take: Take
    basis: RemainderBasis
    at: TakeInformation

    def pushed(self, function: Floats, amount: float | Floats) -> TakeInformation:
        """What the take says where a function acts as well, so much of it (in each segment), to first order."""
        some = add_waves(self.basis, [Wave("fx", np.vstack([function, function]), 0.0)])
        at = gather_information(self.fit, self.take, some, np.zeros(len(some.size)))
        j, n = some.channel.index("fx~") if function.shape[0] == COLUMNS else -2, len(at.phi)
        rows = at.rows[:, :, N_NUISANCE + n : -1]
        moved = np.concatenate(
            [rows[a:b] @ at.values[s, :, j] for s, (a, b) in enumerate(zip(at.first, at.first[1:], strict=False))]
        )
        amounts = np.repeat(np.broadcast_to(amount, self.take.segments), np.diff(self.take.first))
        poses = self.take.pose + amounts[:, None] * moved * self.fit.scales.r
        return gather_information(self.fit, self.take._replace(pose=poses), self.basis, self.at.c)


@pytest.fixture(scope="module")
def null() -> Null:
    fit, take = concealing(SECONDS)
    basis = basis_for(fit, take)
    return Null(fit, take, basis, gather_information(fit, take, basis, np.zeros(len(basis.size))))


def look(null: Null, at: TakeInformation) -> Wave | None:
    """The best wave beside the names, which may answer, and no other function."""
    c = np.zeros(len(null.basis.size))
    return find_wave(at, null.fit.car(), at.robust_weights, at.weigh(at.robust_weights).names_beside(c), c)


def on_body(direction: str, **wave: float) -> Floats:
    row = np.zeros(COLUMNS)
    row[DIRECTION], row[PHASE] = DIRECTIONS.index(direction), 0.7
    for name, number in wave.items():
        row[WAVE + INPUTS.index(name)] = number
    return row


SIZES = {"yaw": 0.05, "wheel_angle": 0.004}
SMALL = 0.02
"""Accelerations (m/s^2) that segments bear: a large wave takes weight from segments where it is not zero."""
RESOLUTION = 2.0 * np.pi / SECONDS


@pytest.mark.parametrize("omega", [1.1, 4.0, 9.0])
@pytest.mark.parametrize("direction", CHANNEL_OF)
def test_a_periodic_force_is_found_in_its_direction_at_its_frequency(null: Null, direction: str, omega: float) -> None:
    found = look(null, null.pushed(on_body(direction, t=omega), SIZES.get(direction, SMALL)))
    assert found is not None
    assert DIRECTIONS[int(found.functions[0, DIRECTION])] == direction
    assert found.channel == CHANNEL_OF[direction]
    assert found.functions[0, WAVE + INPUTS.index("t")] == pytest.approx(omega, abs=RESOLUTION)
    others = [WAVE + INPUTS.index(name) for name in INPUTS if name != "t"]
    assert not found.functions[:, others].any()
    # cosine and sine
    np.testing.assert_allclose(found.functions[:, PHASE], [0.0, -0.5 * np.pi])
    np.testing.assert_array_equal(found.functions[0, WAVE:], found.functions[1, WAVE:])


@pytest.mark.parametrize("wave", [{"p_x": 3.0, "p_y": 0.0}, {"p_x": 2.0, "p_y": -4.0}, {"p_y": 5.0}])
@pytest.mark.parametrize("direction", OVER_PLACE)
def test_a_grating_over_the_floor_is_found_with_both_its_wave_numbers(
    null: Null, direction: str, wave: dict[str, float]
) -> None:
    found = look(null, null.pushed(on_body(direction, **wave), SIZES.get(direction, SMALL)))
    assert found is not None
    assert DIRECTIONS[int(found.functions[0, DIRECTION])] == direction
    k = found.functions[0, [WAVE + INPUTS.index("p_x"), WAVE + INPUTS.index("p_y")]]
    truth = np.array([wave.get("p_x", 0.0), wave.get("p_y", 0.0)])
    spacing = np.pi / np.ptp(null.at.along[:, :, INPUTS.index("p_x") : INPUTS.index("p_y") + 1].reshape(-1, 2), axis=0)
    assert min(np.abs((k - truth) / spacing).max(), np.abs((k + truth) / spacing).max()) < 1.0


SEEN = ("seen_x", "seen_y", "seen_yaw")
"""Directions of waves in the tracking."""


@pytest.mark.parametrize("direction", SEEN)
def test_a_swinging_camera_is_found_in_what_is_seen(null: Null, direction: str) -> None:
    omega, row = 7.0, np.zeros(TRACKING_COLUMNS)
    row[INTO], row[FIRST_WAVE + TRACKING_INPUTS.index("t")] = TRACKING_DIRECTIONS.index(direction), omega
    found = look(null, null.pushed(row, 2e-4))
    assert found is not None
    assert found.channel == "pose"
    assert found.functions.shape == (2, TRACKING_COLUMNS)
    assert TRACKING_DIRECTIONS[int(found.functions[0, INTO])] == direction
    number = found.functions[0, FIRST_WAVE + TRACKING_INPUTS.index("t")]
    assert number == pytest.approx(omega, abs=RESOLUTION)


def test_nothing_swings_where_nothing_is(null: Null) -> None:
    """Neither in the take itself nor where chance turns the sign of what is left of each segment."""
    assert look(null, null.at) is None
    rng, predicted = np.random.default_rng(3), []
    left = null.at.rows[:, :, -1] * null.fit.scales.r
    for _ in range(6):
        sign = np.repeat(rng.choice((-1.0, 1.0), null.take.segments), np.diff(null.take.first))
        poses = null.take.pose + (sign - 1.0)[:, None] * left
        at = gather_information(null.fit, null.take._replace(pose=poses), null.basis, null.at.c)
        predicted.append(look(null, at))
    assert predicted == [None] * 6


def every_wave(null: Null, at: TakeInformation) -> list[tuple[str, str, Gains]]:
    """Channel, direction and gains of all waves, the names left where they are, and no function beside them."""
    body = waves._gains_on_body(at, null.fit.car(), at.robust_weights, at.carrier_slopes)
    acts = np.zeros(at.values.shape[:2])
    return [*body, *waves._gains_in_tracking(at, at.robust_weights, np.zeros(len(at.phi)), acts)]


def test_a_wave_costs_what_the_choice_of_so_many_does(null: Null) -> None:
    at = null.pushed(on_body("body_x", t=4.0), SMALL)
    found, every = look(null, at), every_wave(null, at)
    assert found is not None
    counts = {(c, d): len(g.likely) for c, d, g in every if "t" in g.waves}
    assert found.price == pytest.approx(np.log(sum(len(g.likely) for _, _, g in every)))
    assert min(counts.values()) > 2.0 * SECONDS * (FINEST_HZ - SLOWEST_CYCLES / SECONDS)
    assert set(counts) == {(c, d) for d, c in CHANNEL_OF.items()} | {("pose", d) for d in SEEN}
    assert [d for _, d, g in every if "p_x" in g.waves] == list(OVER_PLACE)
    # by chance the best gains about as much, and never so much more
    by_chance = max(g.likely.max() for _, _, g in every_wave(null, null.at))
    assert 0.4 * found.price < by_chance < found.price + SEARCH_LIMITS.min_wave_nats


def test_a_wave_gains_what_its_two_functions_do(null: Null) -> None:
    """Against the likelihood's own quadratic in both coefficients, the names left where they are."""
    at = null.pushed(on_body("yaw", t=4.0), SIZES["yaw"])
    for channel, direction, gains in every_wave(null, at):
        k = int(np.argmax(gains.likely))
        wave = Wave(channel, waves._wave_functions(channel, direction, gains.waves, k), float(gains.likely[k]))
        basis = add_waves(null.basis, [wave])
        own = np.flatnonzero([name.endswith("~") for name in basis.channel])
        more = gather_information(null.fit, moved_take(null, at), basis, np.zeros(len(basis.size)))
        weighed = more.weigh(at.robust_weights)
        b, G = weighed.slope_c[own], weighed.G_c[np.ix_(own, own)]
        gain = 0.5 * float(b @ np.linalg.solve(G, b))
        assert wave.gain == pytest.approx(gain, rel=0.3, abs=3.0), (channel, direction)


def test_a_wave_must_gain_more_than_is_asked_for(null: Null) -> None:
    """As smooth functions err by a share of what they explain."""
    at, c = null.pushed(on_body("yaw", t=4.0), SIZES["yaw"]), np.zeros(len(null.basis.size))
    found = look(null, at)
    assert found is not None
    beside = (null.fit.car(), at.robust_weights, at.weigh(at.robust_weights).names_beside(c), c)
    again = find_wave(at, *beside, least=0.99 * found.gain)
    assert again is not None
    assert again.gain == found.gain
    assert find_wave(at, *beside, least=1.01 * found.gain) is None


# --- sums that scatter more than white noise does ----------------------------------------------------------------

SEGMENTS, INSTANTS = 60, 12
STEP_S = SEGMENT_S / INSTANTS


def swinging(rng: np.random.Generator, coloured: float, coherent: float, omega: float = 9.0) -> Gains:
    """Gains of waves in time, of slopes that carry white noise of unit information, and two kinds of waves.

    The `coherent` one goes through all segments; the `coloured` one begins at a random phase in each.
    """
    t = (np.arange(SEGMENTS)[:, None] * INSTANTS + np.arange(INSTANTS)) * STEP_S
    phase = rng.uniform(0.0, 2.0 * np.pi, (SEGMENTS, 1))
    slope = rng.standard_normal(t.shape) + coloured * np.cos(omega * t + phase) + coherent * np.cos(omega * t)
    return waves._spectrum(slope, SEGMENTS * np.eye(INSTANTS), t, STEP_S)


def best_gains(coloured: float, coherent: float) -> tuple[float, float]:
    """The greatest gains by the likelihood and by the scatter, of the median of seven draws."""
    rng = np.random.default_rng(8)
    each = [swinging(rng, coloured, coherent) for _ in range(7)]
    return tuple(float(np.median([gains.max() for gains in kind])) for kind in (  # type: ignore[return-value]
        [g.likely for g in each], [g.scattered for g in each],
    ))  # fmt: skip


def test_noise_that_is_not_white_makes_no_wave() -> None:
    """Its sums over segments are as large as a wave's, and scatter as much."""
    enough = np.log(2.0 * SEGMENTS * SEGMENT_S * FINEST_HZ) + SEARCH_LIMITS.min_wave_nats
    likely, scattered = best_gains(coloured=3.0, coherent=0.0)
    assert likely > 2.0 * enough
    assert scattered < enough
    likely, scattered = best_gains(coloured=0.0, coherent=0.0)
    assert scattered <= likely < enough


def test_what_swings_in_each_segment_as_it_likes_is_no_wave_of_a_take(null: Null) -> None:
    """Though by the likelihood alone some wave gains far more than it costs."""
    rng, refused = np.random.default_rng(10), 0
    for _ in range(4):
        sign = rng.choice((-1.0, 1.0), null.take.segments)
        at = null.pushed(on_body("yaw", t=4.0), 2.0 * SIZES["yaw"] * sign)
        price = np.log(sum(len(g.likely) for _, _, g in every_wave(null, at)))
        assert look(null, at) is None
        refused += max(g.likely.max() for _, _, g in every_wave(null, at)) > price + SEARCH_LIMITS.min_wave_nats
    assert refused > 2


def test_a_wave_that_goes_through_the_take_stands_out_from_the_scatter() -> None:
    """Beside coloured noise of the same size, too."""
    enough = np.log(2.0 * SEGMENTS * SEGMENT_S * FINEST_HZ) + SEARCH_LIMITS.min_wave_nats
    for coloured in (0.0, 1.5):
        likely, scattered = best_gains(coloured, coherent=1.5)
        assert scattered > enough
        assert likely >= scattered


def test_scatter_is_that_of_the_sums_over_segments() -> None:
    """Of a grating as of a wave in time: the whole sum squared, over the sum of squares or the information."""
    rng = np.random.default_rng(9)
    whole, each, information = (rng.uniform(0.5, 5.0, 40) for _ in range(3))
    gains = Gains.of_sums(whole, each, information, {})
    np.testing.assert_allclose(gains.likely, 0.5 * whole / information)
    np.testing.assert_allclose(gains.scattered, np.minimum(whole / each, gains.likely))


def moved_take(null: Null, at: TakeInformation) -> Take:
    """The take with the residual that `at` has."""
    return null.take._replace(pose=null.take.pose + (at.rows - null.at.rows)[:, :, -1] * null.fit.scales.r)


def test_waves_stand_beside_the_basis_with_a_spread_of_their_own(null: Null) -> None:
    """Those on the body before the tracking's functions, in whose order coefficients are."""
    body = Wave("mz", np.vstack([on_body("yaw", t=3.0)] * 2), 40.0, 9.0)
    seen = Wave("pose", np.zeros((2, TRACKING_COLUMNS)), 30.0, 9.5)
    more = add_waves(null.basis, [seen, body])
    B, M = len(null.basis.functions), len(null.basis.tracking)
    assert (len(more.functions), len(more.tracking)) == (B + 2, M + 2)
    assert more.channel == (*null.basis.channel[:B], "mz~", "mz~", *null.basis.channel[B:], "pose~", "pose~")
    np.testing.assert_array_equal(more.size[:B], null.basis.size[:B])
    np.testing.assert_array_equal(more.size[B : B + 2], null.basis.yaw_size)
    np.testing.assert_array_equal(more.size[B + 2 : -2], null.basis.size[B:])
    assert more.prices == {"pose~": 9.5, "mz~": 9.0}
    again = add_waves(more, [body])
    assert again.prices == {"pose~": 9.5, "mz~": 18.0}
    # what does not act is not paid for
    off = dict.fromkeys(again.channels, 0.0)
    assert (again.price(off), again.price(off | {"mz~": 0.1, "fx": 1.0})) == (0.0, 18.0)
    assert again.channel.count("mz~") == 4


# --- of the simulation ---------------------------------------------------------------------------------------------


def waves_in_time(fit: Fit, take: Take) -> list[tuple[str, float]]:
    """Channel and frequency (rad/s) of the waves in time that a remainder finds beside smooth functions."""
    more = explain(fit, take, basis_for(fit, take)).basis
    on_car, in_tracking = WAVE + INPUTS.index("t"), FIRST_WAVE + TRACKING_INPUTS.index("t")
    omega = [*more.functions[:, on_car], *more.tracking[:, in_tracking]]
    return [(c.removesuffix("~"), float(w)) for c, w in zip(more.channel, omega, strict=True) if c.endswith("~")]


@pytest.mark.parametrize(
    ("plant", "sensor", "channel", "omega"),
    [
        ({"floor_sway": 30.0}, {}, "fx", 2.0 * np.pi / SWAY_S),
        ({}, {"camera_shake": 2e-3}, "pose", 2.0 * np.pi / SHAKE_S),
        ({"steering_shimmy": 0.03}, {}, "steering", SHIMMY_RADPS),
    ],
    ids=["floor", "camera", "shimmy"],
)
def test_what_swings_in_the_simulation_is_found(
    plant: dict[str, float], sensor: dict[str, float], channel: str, omega: float
) -> None:
    found = waves_in_time(*concealing(SECONDS, 4, Sensor(**sensor), **plant))
    assert [w for c, w in found if c == channel and abs(w - omega) < RESOLUTION], found
