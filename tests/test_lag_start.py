"""How a motor's lag begins: what the throttle before a segment has left, and how lags stand in an RK4 step."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from bcid.aliases import Floats
from bcid.diagnosis.diagnose import fit_base_model
from bcid.diagnosis.search.screen import screen_effects, simulate_trials
from bcid.effects.actuators import ActuatorChain, actuation_at, actuator_chain
from bcid.effects.car import unpack_body
from bcid.effects.constants import Constants
from bcid.effects.lags import decay_at_stage
from bcid.effects.motion import integrate_body, steady_lags
from bcid.effects.table import effect_switches
from bcid.estimate.run import estimate_motion
from bcid.estimate.tune import tune_estimator
from bcid.likelihood.lane_start import first_lags_of_one, steps_of_recording
from bcid.physics.car import Car
from bcid.proof.blind.small_case import SmallCase
from bcid.proof.blind.small_files import published_simulation_text
from bcid.simulation.small_car import draw_small_car
from bcid.virtual_lab import read_simulation_text, read_vehicle_text, record_drive

H, T, LIMIT, C = 0.0125, 12.0, 0.45, Constants()
FRONT, REAR, SMALL = 0.48, 0.0, Car(
    m=1.87, I_z=0.0215, l_f=0.111, l_r=0.125, T_s=0.08, d=10.0, F_m_max=200.0, K_t=21.8, K_b=3.9, C_f=61.0, C_r=70.0,
    F_f_max=4.1, F_r_max=4.0, R_1=0.6, R_2=0.05, v_0=1.0, sets_force=1.0, K_v=1.2,
)  # fmt: skip
OWN = {"motor_dead_zone__width": 0.13, "motor_fade__k": 2.0, "rear_rolling_coulomb__c": 1.0}


def stepping_chain(car: Car, e: Any, every: float, seed: int = 3) -> ActuatorChain:
    """The actuators under a throttle, brakes among it, and a steering that step to random values every so many s."""
    rng = np.random.default_rng(seed)
    times = np.arange(0.0, T, every) + 0.4 * every
    commands = np.column_stack([rng.uniform(-0.2, 0.3, len(times)), rng.choice([0.25, 0.4, 0.6, -0.3], len(times))])
    return actuator_chain(times, commands, 0.0, round(T / H), H, car, LIMIT, e)


def long_rollout(car: Car, e: Any, chain: ActuatorChain) -> Floats:
    """States and lags (n + 1, 9) of a car that rolls at 1 m/s as the chain begins."""
    b, n = unpack_body(np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0])), round(T / H)
    lags = steady_lags(b, actuation_at(0, chain, T), car, e, C)
    return np.asarray(integrate_body(b, lags, 0, n, chain, T, np.zeros((1, 3)), n, car, e, C))


def rms(values: list[float]) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


@pytest.mark.parametrize("front_share", [1.0, FRONT, REAR])
@pytest.mark.parametrize("tau", [0.05, 0.12])
def test_a_segment_begins_as_a_rollout_begun_earlier_goes_on(front_share: float, tau: float) -> None:
    """Its forces, and the path of the next 1.5 s; a motor that were steady at the beginning would lead elsewhere."""
    car, e = SMALL._replace(front_share=front_share), effect_switches(OWN | {"motor_lag__tau": tau})
    chain = stepping_chain(car, e, 0.31)
    path, n = long_rollout(car, e, chain), round(1.5 / H)
    apart: dict[str, list[float]] = {"first": [], "steady": []}
    force: dict[str, list[float]] = {"first": [], "steady": []}
    for k in range(round(2.0 / H), round(10.0 / H), 37):
        b = unpack_body(path[k])
        first = first_lags_of_one(b, k, steps_of_recording(k, chain), chain, T, car, e, C)
        steady = steady_lags(b, actuation_at(k, chain, T), car, e, C)
        for name, lags in (("first", first), ("steady", steady)):
            on = integrate_body(b, lags, k, n, chain, T, np.zeros((1, 3)), n, car, e, C)
            apart[name].append(float(np.abs(on[:, :2] - path[k : k + n + 1, :2]).max()))
            miss = front_share * (lags.F_mf - path[k, 7]) + (1.0 - front_share) * (lags.F_mr - path[k, 8])
            force[name].append(abs(miss))
    assert rms(force["steady"]) > 0.6
    assert rms(force["first"]) < 0.1 * rms(force["steady"])
    assert rms(apart["steady"]) > 0.02
    assert rms(apart["first"]) < 0.1 * rms(apart["steady"])


@pytest.mark.parametrize("late", [0.0, 0.3, 0.85])
def test_at_a_constant_speed_the_force_is_the_closed_form(late: float) -> None:
    """A car too heavy to change its speed: each step of the throttle decays for itself, wherever in a step it came."""
    tau, m = 0.09, 1e9
    car, e = SMALL._replace(m=m, I_z=m, front_share=REAR), effect_switches(OWN | {"motor_lag__tau": tau})
    times = np.r_[0.0, (np.array([10.0, 31.0, 33.0, 40.0]) + late) * H]
    throttles, k, v = np.array([0.3, 0.6, -0.4, 0.5, 0.05]), 44, 1.1
    commands = np.column_stack([0.0 * throttles, throttles])
    chain = actuator_chain(times, commands, 0.0, 80, H, car, LIMIT, e)
    b = unpack_body(np.array([0.0, 0.0, 0.0, v, 0.0, 0.0]))
    opened = np.maximum(throttles - OWN["motor_dead_zone__width"], 0.0)
    fade = (car.K_v + OWN["motor_fade__k"] * opened) * v
    steady = np.where(throttles < 0.0, throttles * car.K_b * v, np.where(opened > 0.0, car.K_t * opened - fade, 0.0))
    expected = steady[-1] - np.sum(np.diff(steady) * np.exp(-(k * H - times[1:]) / tau))
    assert first_lags_of_one(b, k, k, chain, T, car, e, C).F_mr == pytest.approx(expected, abs=1e-4)
    # before what is known the motor was steady
    few = steady[2] + (steady[3] - steady[2]) * (1.0 - np.exp(-(k * H - times[3]) / tau))
    few += (steady[4] - steady[3]) * (1.0 - np.exp(-(k * H - times[4]) / tau))
    known = k - 32
    assert first_lags_of_one(b, k, known, chain, T, car, e, C).F_mr == pytest.approx(few, abs=1e-9)
    assert first_lags_of_one(b, k, 0, chain, T, car, e, C).F_mr == pytest.approx(steady[4], abs=1e-9)


def test_the_first_force_is_smooth_in_the_lag_and_fades_with_it() -> None:
    """Slopes over a hundredth and a thousandth of it agree; without a lag it is the steady force."""
    base = effect_switches(OWN)
    car, chain = SMALL._replace(front_share=FRONT), stepping_chain(SMALL, base, 0.13)
    b, k = unpack_body(np.array([0.0, 0.0, 0.0, 0.9, 0.02, 0.5])), 301

    def force(tau: float) -> float:
        e = effect_switches(OWN | {"motor_lag__tau": tau})
        return float(first_lags_of_one(b, k, k, chain, T, car, e, C).F_mf)

    for tau in np.linspace(0.02, 0.3, 23):
        wide, narrow = (force(tau + w) - force(tau - w) for w in (1e-2 * tau, 1e-3 * tau))
        assert wide / 1e-2 == pytest.approx(narrow / 1e-3, abs=2e-3)
    steady = float(steady_lags(b, actuation_at(k, chain, T), car, base, C).F_mf)
    assert force(0.0) == steady
    assert force(1e-5) == pytest.approx(steady, abs=1e-3)


@pytest.mark.parametrize("ratio", [0.0, 1e-7, 1e-3, 0.0099, 0.0101, 0.3, 4.0, 300.0])
def test_a_decay_in_a_step_keeps_its_impulse_and_how_far_it_carries(ratio: float) -> None:
    """RK4's sums over its stages are both integrals over the step, here by Gauss's rule."""
    begin, middle, end = (decay_at_stage(2.0, ratio, share) for share in (0.0, 0.5, 1.0))
    x, w = np.polynomial.legendre.leggauss(200)
    s, w = 0.5 * (x + 1.0), 0.5 * w
    decay = 2.0 * np.exp(-ratio * s)
    assert (begin + 4.0 * middle + end) / 6.0 == pytest.approx(float(w @ decay), abs=1e-10)
    assert (begin + 2.0 * middle) / 6.0 == pytest.approx(float(w @ ((1.0 - s) * decay)), abs=1e-10)


@pytest.mark.parametrize("share", [0.0, 0.25, 0.6])
@pytest.mark.parametrize("tau", [0.0, 0.004, 0.1])
def test_a_throttle_that_changes_within_a_step_carries_as_far_as_in_fine_steps(share: float, tau: float) -> None:
    car, e = SMALL._replace(front_share=FRONT), effect_switches(OWN | {"motor_lag__tau": tau})
    ends = []
    for h in (H, H / 16.0):
        times, commands = np.array([0.0, (8.0 + share) * H]), np.array([[0.2, 0.2], [0.2, 0.5]])
        n = round(1.0 / h)
        chain = actuator_chain(times, commands, 0.0, n, h, car, LIMIT, e)
        b = unpack_body(np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.9]))
        lags = steady_lags(b, actuation_at(0, chain, T), car, e, C)
        ends.append(integrate_body(b, lags, 0, n, chain, T, np.zeros((1, 3)), n, car, e, C)[:: round(H / h)])
    assert np.abs(ends[0][:, 0] - ends[1][:, 0]).max() < 4e-5


def test_a_take_of_nothing_of_a_car_with_a_lag_shows_no_delay() -> None:
    """Of throttle or steering, nor late poses; with steady beginnings the throttle's delay gained 40 to 300 nats."""
    car = draw_small_car(np.random.default_rng(4))
    assert car.plant.motor_lag > 0.05
    case = SmallCase("small-null", 0, (), seed=2, car=car, trust=0.05, duration_s=60.0, rate_hz=100.0, driver="hand")
    vehicle = read_vehicle_text(case.lab_files.vehicle)
    recording = record_drive(case.simulate(), case.rate_hz, vehicle, "nothing")
    estimate = estimate_motion(recording, vehicle, tune_estimator([recording], vehicle, 0.1, 0.3, {}))
    reference = read_simulation_text(published_simulation_text(car.plant, case.trust), estimate, vehicle)
    base = fit_base_model([recording], [estimate], vehicle, reference=reference)
    scores = {c.effect: c.score for c in screen_effects(base.fit, base.take, simulate_trials(base.fit, base.take))}
    assert max(scores[name] for name in ("motor_delay", "steering_delay", "pose_latency")) < 10.0, scores
