"""A car's constants under others' names move others' single-track models as the car itself moves."""

from __future__ import annotations

import re
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pytest
from exported_models import CAR, MODELS, PERIOD_S, augmented_car

from bcid.errors import UsageError
from bcid.evaluation.validity import DataRange, ModelValidity
from bcid.export.parameter_file import largest_acceleration, write_parameter_file
from bcid.models.interface import Model
from bcid.models.newton_euler.model import NewtonEuler
from bcid.physics.car import Car, motor_force, wrench

G = 9.81
SLIP = 1e-5
"""Sideways motion and angles (rad, m/s, rad/s) at which sines are their angles to ten digits."""

DRIVEN = DataRange((-0.4, -0.3, -1.0, -2.0, -0.31, -1.0), (2.5, 0.3, 1.2, 2.0, 0.28, 1.0))
"""What a model was fitted on: v_x, v_y, yaw rate, v_x yaw rate, u_s, u_m."""

YAML_FLOAT = re.compile(r"-?[0-9]+\.[0-9]*(e[-+][0-9]+)?")
"""What readers of YAML take for a number with a point: 1e-05 they take for a word."""

LAWS = {
    "speed": CAR,
    "force": CAR._replace(F_m_max=1e3 * CAR.m * G, K_t=500.0, u_0=0.1, K_v=50.0, sets_force=1.0),
    "force, limited": CAR._replace(F_m_max=300.0, K_t=500.0, u_0=0.1, K_v=50.0, sets_force=1.0),
}  # fmt: skip


class SingleTrack(NamedTuple):
    """What the published single-track model needs (Althoff and Würsching, CommonRoad: Vehicle Models)."""

    mu: float
    C_Sf: float
    C_Sr: float
    lf: float
    lr: float
    h: float
    m: float
    I: float  # noqa: E741  # the source's symbol

    def rates(self, v: float, beta: float, yaw_rate: float, delta: float, a: float = 0.0) -> tuple[float, float]:
        """Rate of the slip angle beta (rad/s) and yaw acceleration (rad/s^2) at the speed `v`, term by term."""
        mu, C_Sf, C_Sr, lf, lr, h, m, I = self  # noqa: E741
        front, rear = C_Sf * (G * lr - a * h), C_Sr * (G * lf + a * h)
        length = lf + lr
        beta_rate = (
            (mu / (v**2 * length) * (rear * lr - front * lf) - 1.0) * yaw_rate
            - mu / (v * length) * (rear + front) * beta
            + mu / (v * length) * front * delta
        )
        yaw_acceleration = (
            -mu * m / (v * I * length) * (lf**2 * front + lr**2 * rear) * yaw_rate
            + mu * m / (I * length) * (lr * rear - lf * front) * beta
            + mu * m / (I * length) * lf * front * delta
        )
        return beta_rate, yaw_acceleration


def parsed(text: str) -> dict[str, Any]:
    """Sections of a YAML file of nested mappings of numbers with points; anything else fails."""
    tree: dict[str, Any] = {}
    path = [tree]
    for line in text.splitlines():
        words = line.partition("#")[0].rstrip()
        if not words:
            continue
        depth = len(words) - len(words.lstrip())
        assert depth % 2 == 0
        key, colon, value = words.strip().partition(":")
        assert colon
        assert re.fullmatch(r"\w+", key)
        path = path[: depth // 2 + 1]
        assert len(path) == depth // 2 + 1, f"too deep: {line}"
        assert key not in path[-1], f"twice: {line}"
        if value:
            assert YAML_FLOAT.fullmatch(value.strip()), line
            path[-1][key] = float(value)
        else:
            path[-1][key] = {}
            path.append(path[-1][key])
    return tree


def text_of(model: Model, limits: DataRange | None = DRIVEN) -> str:
    """The file of a model, which needs no drive of it."""
    e: Any = SimpleNamespace(model=model, validity=limits and ModelValidity(None, limits), about="a_car: a model")
    return write_parameter_file(e)


def sections(car: Car, limits: DataRange | None = DRIVEN) -> dict[str, Any]:
    return parsed(text_of(NewtonEuler(car, PERIOD_S, {}), limits))


def gym_car(file: dict[str, Any]) -> SingleTrack:
    """The gym's model of a file."""
    return SingleTrack(*(file["f1tenth_gym"][key] for key in SingleTrack._fields))


def commonroad_car(file: dict[str, Any]) -> SingleTrack:
    """CommonRoad's model of a file: friction and one stiffness for both axles from the tyre."""
    p = file["commonroad"]
    mu, stiffness = p["tire"]["p_dy1"], -p["tire"]["p_ky1"] / p["tire"]["p_dy1"]
    return SingleTrack(mu, stiffness, stiffness, p["a"], p["b"], p["h_s"], p["m"], p["I_z"])


def own_rates(car: Car, v: float, beta: float, yaw_rate: float, delta: float) -> tuple[float, float]:
    """The same two rates of the car itself, its motor off and without drag."""
    car = car._replace(R_1=0.0, R_2=0.0)
    _, F_y, M_z = wrench(v * np.cos(beta), v * np.sin(beta), yaw_rate, delta, 0.0, car)
    return F_y / (car.m * v) - yaw_rate, M_z / car.I_z


MOTIONS = {
    "slides": (SLIP, 0.0, 0.0), "turns": (0.0, SLIP, 0.0), "is steered": (0.0, 0.0, SLIP),
    "all": (0.4 * SLIP, -0.7 * SLIP, SLIP),
}  # fmt: skip


@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("v", [1.0, 4.0])
def test_the_gym_turns_as_the_car_does(v: float, motion: str) -> None:
    wanted = own_rates(CAR, v, *MOTIONS[motion])
    assert gym_car(sections(CAR)).rates(v, *MOTIONS[motion]) == pytest.approx(wanted, rel=1e-8, abs=1e-14)


@pytest.mark.parametrize("motion", MOTIONS)
def test_commonroad_turns_as_a_car_does_that_steers_neutrally(motion: str) -> None:
    """Whose stiffness per load is the same at both axles, which is all that one number can say."""
    neutral = CAR._replace(C_f=9.0 * CAR.m * CAR.l_r, C_r=9.0 * CAR.m * CAR.l_f)
    wanted = own_rates(neutral, 2.0, *MOTIONS[motion])
    assert commonroad_car(sections(neutral)).rates(2.0, *MOTIONS[motion]) == pytest.approx(wanted, rel=1e-8, abs=1e-14)


def test_one_stiffness_keeps_the_side_force_of_any_car_and_makes_it_neutral() -> None:
    assert CAR.C_f * CAR.l_f != pytest.approx(CAR.C_r * CAR.l_r, rel=0.1)
    theirs, wanted = commonroad_car(sections(CAR)).rates(2.0, SLIP, 0.0, 0.0), own_rates(CAR, 2.0, SLIP, 0.0, 0.0)
    assert theirs[0] == pytest.approx(wanted[0], rel=1e-8)
    assert theirs[1] == pytest.approx(0.0, abs=1e-12)
    assert abs(wanted[1]) > 1e-6


def test_their_tyres_have_no_saturation_and_the_file_says_so() -> None:
    (_, theirs), (_, ours) = gym_car(sections(CAR)).rates(2.0, 0.0, 0.0, 0.6), own_rates(CAR, 2.0, 0.0, 0.0, 0.6)
    assert theirs > 1.2 * ours
    assert "no saturation" in text_of(NewtonEuler(CAR, PERIOD_S, {}))


@pytest.mark.parametrize("law", LAWS)
def test_the_largest_acceleration_is_that_of_the_motor_at_rest(law: str) -> None:
    car = LAWS[law]
    full_throttle = 1.0 if car.sets_force else 1e6
    wanted = motor_force(full_throttle, 0.0, car) / car.m
    file = sections(car)
    assert file["f1tenth_gym"]["a_max"] == file["commonroad"]["longitudinal"]["a_max"] == pytest.approx(wanted)
    assert wanted < G


def test_a_measured_speed_has_no_largest_acceleration() -> None:
    car = CAR._replace(follows_wheel=1.0, K_t=2000.0, F_m_max=1e3 * CAR.m * G)
    assert largest_acceleration(car) is None
    text = text_of(NewtonEuler(car, PERIOD_S, {}))
    file = parsed(text)
    assert "a_max" not in file["f1tenth_gym"] | file["commonroad"]["longitudinal"]
    assert re.search(r"# not known to the model: a_max", text)
    assert file["f1tenth_gym"]["v_min"] == -file["f1tenth_gym"]["v_max"]


def test_each_constant_says_how_well_it_is_known() -> None:
    fitted = {"C_f": {"relative_se": 0.02}, "F_r_max": {"relative_se": 3.0}, "F_f_max": {"relative_se": 0.01}}
    text = text_of(NewtonEuler(CAR, PERIOD_S, {"fitted": fitted}))
    assert re.search(rf"  C_f: .*, standard error {0.02 * CAR.C_f:.2g}\n", text)
    assert re.search(r"  F_r_max: .*, not identified by the recordings\n", text)
    assert re.search(r"  mu: .*; a guess, as F_r_max is not identified", text)
    assert re.search(r"  m: [0-9.]+  # kg\n", text)
    diagnosed = replace(MODELS["newton-euler-augmented"], facts={"se": {"C_r": 0.7 * CAR.C_r, "R_1": 9.0}})
    text = text_of(diagnosed)
    assert re.search(r"  C_r: .*, not identified by the recordings\n", text)
    assert re.search(r"  R_1: .*, standard error 9\n", text)


def test_the_names_are_those_that_others_read() -> None:
    file = sections(CAR)
    assert set(file) == {"newton_euler", "f1tenth_gym", "commonroad"}
    assert set(file["f1tenth_gym"]) == {
        "mu", "C_Sf", "C_Sr", "lf", "lr", "h", "m", "I", "s_min", "s_max", "sv_min", "sv_max", "v_switch", "a_max",
        "v_min", "v_max",
    }  # fmt: skip
    theirs = file["commonroad"]
    assert set(theirs) == {"a", "b", "h_s", "m", "I_z", "tire", "steering", "longitudinal"}
    assert set(theirs["tire"]) == {"p_dy1", "p_ky1"}
    assert theirs["tire"]["p_ky1"] < 0.0
    assert set(theirs["steering"]) == {"min", "max", "v_min", "v_max"}
    assert set(theirs["longitudinal"]) == {"v_min", "v_max", "v_switch", "a_max"}


def test_both_simulators_get_the_same_limits() -> None:
    file = sections(CAR)
    gym, steering, along = file["f1tenth_gym"], file["commonroad"]["steering"], file["commonroad"]["longitudinal"]
    assert [steering[key] for key in ("min", "max", "v_min", "v_max")] == [-0.31, 0.28, -CAR.d, CAR.d]
    assert [gym[key] for key in ("s_min", "s_max", "sv_min", "sv_max")] == [-0.31, 0.28, -CAR.d, CAR.d]
    assert along == {key: gym[key] for key in along}
    assert (gym["v_min"], gym["v_max"], gym["v_switch"]) == (0.0, 2.5, 2.5)


def test_a_car_that_reverses_may_go_as_fast_backward() -> None:
    fast_backward = DRIVEN._replace(low=(-3.0, *DRIVEN.low[1:]))
    gym = sections(CAR._replace(reverses=1.0), fast_backward)["f1tenth_gym"]
    assert (gym["v_min"], gym["v_max"]) == (-3.0, 3.0)
    assert sections(CAR, fast_backward)["f1tenth_gym"]["v_max"] == 2.5


def test_what_nobody_knows_is_left_out_and_named() -> None:
    text = text_of(NewtonEuler(CAR, PERIOD_S, {}), limits=None)
    gym = parsed(text)["f1tenth_gym"]
    assert not {"s_min", "s_max", "v_max", "v_switch", "width", "length"} & set(gym)
    assert gym["v_min"] == 0.0
    assert "# not known to the model: s_min, s_max, v_switch, v_max, width, length" in text


def test_the_wheel_s_limit_is_taken_where_the_model_knows_it() -> None:
    model = augmented_car({"steering_drag__k": 20.0})
    steering = parsed(text_of(model))["commonroad"]["steering"]
    assert (steering["min"], steering["max"]) == (-model.angle_limit, model.angle_limit)


def test_effects_that_have_no_place_there_are_named() -> None:
    text = text_of(augmented_car({"steering_delay__tau": 0.03, "marker_offset__d_x": 0.1, "marker_offset__d_y": 0.0}))
    assert "Effects left out: steering_delay, marker_offset." in text
    assert "no effects that are left out" in text_of(MODELS["newton-euler"])


def test_the_constants_are_those_that_were_fitted_with_what_chooses_their_law() -> None:
    ours = sections(LAWS["force"]._replace(front_share=0.0, reverses=1.0))["newton_euler"]
    assert {key: ours[key] for key in ("m", "C_f", "K_t", "u_0")} == {
        "m": 200.0,
        "C_f": CAR.C_f,
        "K_t": 500.0,
        "u_0": 0.1,
    }
    assert "F_m_max" not in ours  # this law has none
    flags = ("front_share", "sets_force", "follows_wheel", "reverses")
    assert [ours[key] for key in flags] == [0.0, 1.0, 0.0, 1.0]


def test_small_and_large_numbers_are_numbers_for_every_reader() -> None:
    ours = sections(CAR._replace(R_2=1e-05, K_b=1e20))["newton_euler"]
    assert (ours["R_2"], ours["K_b"]) == (1e-05, 1e20)


def test_a_model_without_constants_has_no_such_file() -> None:
    with pytest.raises(UsageError, match="no constants of a car"):
        text_of(MODELS["narx-mlp"], limits=None)
