"""Where pushes lie: drawn along each way, beside a rough floor, and what of several views of a remainder counts."""

from __future__ import annotations

import numpy as np
import pytest
from cars import CAR

from bcid.diagnosis.limits import LOCATE_LIMITS
from bcid.diagnosis.locate.mismatch import RemainingMismatch
from bcid.diagnosis.locate.push_directions import DirectionGain, _SegmentPushes, direction_gains, list_push_directions
from bcid.diagnosis.locate.pushes import STATE_NAMES, Disturbances
from bcid.diagnosis.locate.regression import DisturbanceRegression
from bcid.likelihood.take import KNOTS
from bcid.physics.car import wrench
from bcid.physics.kinematics import wheel_velocity
from bcid.physics.tyres import slip_angle

SEGMENTS = 150
INERTIA = np.array([CAR.m, CAR.m, CAR.I_z])
FLOOR = np.array([3.0, 3.0, 1.5])  # N, N, N m
WAYS = range(15)


def seen(seed: int, way: int | None = None, size: float = 8.0) -> Disturbances:
    """Pushes of a rough floor, and along a way, of a car that does all kinds of things; a hundredth is doubtful."""
    rng = np.random.default_rng(seed)
    K = KNOTS * SEGMENTS
    mean = {name: rng.uniform(-1.0, 1.0, K) for name in STATE_NAMES}
    mean |= {"delta": rng.uniform(-1.5, 1.5, K), "theta": rng.uniform(-3.0, 3.0, K), "F_m": rng.uniform(0.0, 60.0, K)}
    mean |= {"alpha_f": rng.uniform(-0.3, 0.3, K), "alpha_r": rng.uniform(-0.2, 0.2, K)}
    nothing = np.zeros((K, 3))
    still = Disturbances(
        mean["p_x"], np.arange(K) // KNOTS, nothing, nothing, mean, nothing, np.zeros((SEGMENTS, 3 * KNOTS)),
        np.tile(1e-8 * np.eye(3 * KNOTS), (SEGMENTS, 1, 1)),
    )  # fmt: skip
    pushes = FLOOR * rng.standard_normal((K, 3))
    for d in list_push_directions(still, CAR)[way].vectors if way is not None else ():
        pushes += size * d / np.sqrt(np.mean(np.sum(d**2, axis=1))) * rng.standard_normal((K, 1))
    return still._replace(poses_only=(pushes / INERTIA).reshape(SEGMENTS, -1))


@pytest.mark.parametrize("way", WAYS)
def test_pushes_lie_where_they_were_drawn(way: int) -> None:
    of = seen(way, way)
    drawn = list_push_directions(of, CAR)[way]
    found = direction_gains(of, CAR)[0]
    assert found.channel == drawn.channel
    assert found.description == drawn.description
    assert found.gain_nats > 20.0


def test_every_way_is_tried() -> None:
    assert len(list_push_directions(seen(0), CAR)) == len(WAYS)


def test_a_rough_floor_s_pushes_lie_nowhere() -> None:
    most = [direction_gains(seen(seed), CAR)[0].gain_nats for seed in range(20)]
    assert max(most) < LOCATE_LIMITS.min_gain_nats


def test_a_segment_that_shows_nothing_does_not_count() -> None:
    of = seen(3, 2)
    lost = of._replace(poses_only=of.poses_only.copy(), poses_only_covariance=of.poses_only_covariance.copy())
    lost.poses_only[4], lost.poses_only_covariance[7] = np.nan, np.inf
    assert direction_gains(lost, CAR)[0].gain_nats == pytest.approx(direction_gains(of, CAR)[0].gain_nats, rel=0.05)


def test_where_no_segment_shows_a_push_none_lies_anywhere() -> None:
    of = seen(3, 2)
    assert direction_gains(of._replace(poses_only=np.full_like(of.poses_only, np.nan)), CAR) == ()


GRIPPING = CAR._replace(
    R_1=30.0, R_2=0.0, F_f_max=1e5, F_r_max=1e5, sets_force=1.0, K_t=100.0, u_0=0.0, K_v=0.0, K_b=0.0, F_m_max=1e5
)
V_X, V_Y, YAW_RATE, DELTA, THROTTLE = 3.0, 0.2, 0.4, 0.5, 0.6
CHANGED = [
    ("along the front wheel, the more the faster it goes", "R_1", 1.0),
    ("along the body, the more the faster it goes", "R_1", 0.0),
    ("along the driven wheels, the more the harder they drive", "K_t", 1.0),
    ("along the driven wheels, the more the harder they drive", "K_t", 0.0),
    ("across the front wheel, the more the larger its side force", "C_f", 1.0),
    ("across the rear wheels, the more the larger their side force", "C_r", 1.0),
    ("as if the front wheel turned", "delta", 0.0),
]  # what a model's parameter does lies in a way; the front's share of drive and drag


@pytest.mark.parametrize(("words", "parameter", "front_share"), CHANGED)
def test_a_way_is_what_a_parameter_changes_of_the_wrench(words: str, parameter: str, front_share: float) -> None:
    """By finite differences of the model's own wrench; nothing but its direction counts."""
    car = GRIPPING._replace(front_share=front_share, **({"R_1": 0.0} if parameter == "delta" else {}))
    v_f = wheel_velocity(V_X, V_Y, YAW_RATE, car.l_f, DELTA)
    state = {name: np.zeros(1) for name in STATE_NAMES} | {
        "v_x": V_X, "v_y": V_Y, "omega": YAW_RATE, "delta": DELTA, "F_m": car.K_t * THROTTLE, "u_m": THROTTLE,
        "alpha_f": slip_angle(*v_f, car.v_0),
        "alpha_r": slip_angle(*wheel_velocity(V_X, V_Y, YAW_RATE, -car.l_r, 0.0), car.v_0),
    }  # fmt: skip
    of = seen(0)._replace(states={name: np.atleast_1d(value) for name, value in state.items()})

    def after(sign: float) -> np.ndarray:
        if parameter == "delta":
            return np.array(wrench(V_X, V_Y, YAW_RATE, DELTA + sign * 1e-5, THROTTLE, car))
        off = car._replace(**{parameter: getattr(car, parameter) * (1.0 + sign * 1e-5)})
        return np.array(wrench(V_X, V_Y, YAW_RATE, DELTA, THROTTLE, off))

    moved = after(1.0) - after(-1.0)
    (way,) = (w for w in list_push_directions(of, car) if w.description == words)
    unit = way.vectors[0][0] / np.linalg.norm(way.vectors[0][0])
    np.testing.assert_allclose(moved - (moved @ unit) * unit, 0.0, atol=1e-4 * np.linalg.norm(moved))
    assert np.linalg.norm(moved) > 0.0


def test_the_slope_is_the_likelihood_s() -> None:
    of = seen(5, 2)
    pushes = _SegmentPushes.from_disturbances(of, CAR)
    squares = [pushes.outer_products(d) for d in list_push_directions(of, CAR)[12].vectors]
    at = np.array([0.7, 1.4])
    _, slope = pushes._negative_log_likelihood(at, squares)
    for j, step in enumerate(1e-5 * np.eye(2)):
        ahead, behind = (pushes._negative_log_likelihood(at + sign * step, squares)[0] for sign in (1.0, -1.0))
        assert slope[j] == pytest.approx((ahead - behind) / 2e-5, rel=1e-5)


NOTHING = DisturbanceRegression("mz", 0.1, {"mz": 0.1}, (), 0.0, None, 0.25)


@pytest.mark.parametrize(
    ("entering", "nats", "channel"),
    [
        ({"motor": 90.0}, 60.0, "motor"), ({"motor": 60.0}, 90.0, "fy"), ({"pose": 60.0}, 90.0, "pose"),
        ({"motor": 2.0}, 90.0, "fy"), ({"motor": 2.0}, 3.0, "mz"), ({"motor": 8.0}, -3.0, "motor"),
    ],
)  # fmt: skip
def test_what_explains_most_says_where_it_enters(entering: dict[str, float], nats: float, channel: str) -> None:
    left = RemainingMismatch(NOTHING, entering, (DirectionGain("fy", "across the front wheel", nats),))
    assert left.channel == channel
    way = left.significant_direction(14.0)
    assert (way is not None) is (channel == "fy")


def test_what_explains_next_to_nothing_of_what_trees_predict_says_nothing() -> None:
    """A moment against the servo's rate: no function has it, and it is not a floor's either."""
    predictable = DisturbanceRegression("mz", 0.9, {"mz": 0.9}, (), 1000.0, None, 0.25)
    left = RemainingMismatch(predictable, {"steering": 11.0}, (DirectionGain("fy", "across the front wheel", 40.0),))
    assert left.channel == "mz"
    assert left._replace(regression=NOTHING).channel == "fy"


def test_what_only_lies_somewhere_is_left_too() -> None:
    """A drive wheel that is not round pushes along itself, whenever it likes."""
    left = RemainingMismatch(NOTHING, {"motor": -3.0}, (DirectionGain("fx", "along the front wheel", 40.0),))
    assert left.gain_nats(14.0) == 40.0
    assert left.gain_nats(50.0) == 0.0
