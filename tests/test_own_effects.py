"""Effects of a user's own: read and checked, in the compiled car on numbers and vectors, and in its derivatives."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cars import CAR
from own_effects import ACTUATORS, DRAG, MAGNET, REFUSED, own_file
from test_effects import REST, H, commands, integrate, moved, random_body

from bcid.effects.actuators import actuator_chain
from bcid.effects.car import BodyState, LagState, varies_with_pose, wrench_with_effects
from bcid.effects.constants import Constants
from bcid.effects.entry import VehicleScale
from bcid.effects.own_file import IN_USE, own_effects_in_use
from bcid.effects.table import EFFECTS, ENTRIES, OFF, effect_switches
from bcid.errors import InputRefused, UsageError
from bcid.estimate.run import estimate_motion
from bcid.likelihood.hypothesis import Hypothesis
from bcid.likelihood.lane_rollout import segment_layout
from bcid.likelihood.predict import COARSE, linearise_poses, predict_poses
from bcid.likelihood.take import cut_segments
from bcid.recording.types import Recording

WIDTH = 1e-4  # of differences by m, rad, m/s and rad/s
NO_LAGS = LagState(0.0, 0.0, 0.0)


def wrench(b: BodyState, now: Any, on: dict[str, float]) -> tuple[float, float, float]:
    """Force and moment on the body with the effects `on`."""
    w = wrench_with_effects(b, now, NO_LAGS, CAR, effect_switches(on), Constants())
    return w.F_x, w.F_y, w.M_z


# --- reading ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", sorted(REFUSED))
def test_a_file_that_is_wrong_is_refused(name: str, tmp_path: Path) -> None:
    text, cause = REFUSED[name]
    with pytest.raises(InputRefused) as refused:
        own_file(tmp_path, text)
    assert cause in str(refused.value)
    assert "effects.py" in str(refused.value)
    assert "next:" in str(refused.value)


def test_what_is_wrong_is_told_at_once(tmp_path: Path) -> None:
    """Of two effects with faults each is told of."""
    second = DRAG[DRAG.index("@effect") :].replace("own_drag", "yaw_scrub")
    with pytest.raises(InputRefused) as refused:
        own_file(tmp_path, DRAG.replace("kg s^-1", "kg m^-1") + second)
    assert "own_drag" in str(refused.value)
    assert "yaw_scrub" in str(refused.value)


def test_no_file_and_no_text_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputRefused, match="cannot be read"):
        own_file(tmp_path / "nowhere", "")
    with pytest.raises(InputRefused, match="cannot be read"):
        own_file(tmp_path, b"\xff\xfe")


def test_a_law_that_acts_far_off_in_a_narrow_place_is_right(tmp_path: Path) -> None:
    far = MAGNET.replace('"m", 1.0', '"m", 22.0').replace('"m", 1.5', '"m", 0.8')
    assert far != MAGNET
    assert own_file(tmp_path, far).effects[0].constants[0].value == 22.0


def test_running_a_file_leaves_nothing_beside_it(tmp_path: Path) -> None:
    own_file(tmp_path, DRAG)
    assert [path.name for path in tmp_path.iterdir()] == ["effects.py"]


# --- in the car ---------------------------------------------------------------------------------------------------


def test_effects_are_in_the_vocabulary_while_they_are_in_use(tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    own, other = own_file(tmp_path, MAGNET), own_file(tmp_path / "other", DRAG)
    before = (dict(EFFECTS), dict(ENTRIES), dict(OFF), effect_switches().dtype)
    with own_effects_in_use(own):
        assert EFFECTS["magnet_strip"].depends_on == ("place", "heading")
        assert effect_switches().magnet_strip__k == 0.0
        with own_effects_in_use(own):  # once more is the same
            assert [file.sha256 for file in IN_USE] == [own.sha256]
        with pytest.raises(UsageError, match="in use already"), own_effects_in_use(other):
            pass
        assert "magnet_strip" in EFFECTS
    assert (dict(EFFECTS), dict(ENTRIES), dict(OFF), effect_switches().dtype) == before
    assert not IN_USE


def test_a_push_is_added_to_the_wrench(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    with own_effects_in_use(own_file(tmp_path, MAGNET)):
        for _ in range(50):
            b, now = random_body(rng)
            away = b.p_x - 1.0
            pull = -60.0 * away * math.exp(-((away / 1.5) ** 2))
            found = np.subtract(wrench(b, now, {"magnet_strip__k": 60.0}), wrench(b, now, {}))
            expected = [pull * math.cos(b.theta), -pull * math.sin(b.theta), 0.0]
            np.testing.assert_allclose(found, expected, atol=1e-10)


def test_an_actuator_is_changed(tmp_path: Path) -> None:
    """A worn horn is a greater angle to the left; a warm motor is one that sags by the square of the time."""
    rng = np.random.default_rng(1)
    with own_effects_in_use(own_file(tmp_path, ACTUATORS)):
        for _ in range(50):
            b, now = random_body(rng)
            turned = now._replace(delta=1.1 * now.delta) if now.delta > 0.0 else now
            found, expected = wrench(b, now, {"worn_horn__a": 0.1}), wrench(b, turned, {})
            assert found == pytest.approx(expected, rel=1e-12)
            found, expected = (
                wrench(b, now, {name: s}) for name, s in (("warm_motor__s", 0.4), ("motor_sag__s", 0.4 * now.t / now.T))
            )
            assert found == pytest.approx(expected, rel=1e-12)
            drag = wrench(b, now, {"oblique_drag__b": 5.0})[0] - wrench(b, now, {})[0]
            assert drag == pytest.approx(-5.0 * b.v_x * abs(b.v_y), abs=1e-10)


def test_off_and_in_use_is_the_base_model_to_the_last_bit(tmp_path: Path) -> None:
    """Of a drive, without the file, with it and its effects off, and with another effect on."""
    without = {name: moved(effect_switches(on)) for name, on in {"": {}, "yaw": {"yaw_scrub__c": 9.0}}.items()}
    with own_effects_in_use(own_file(tmp_path, MAGNET)):
        np.testing.assert_array_equal(moved(effect_switches()), without[""])
        np.testing.assert_array_equal(moved(effect_switches({"yaw_scrub__c": 9.0})), without["yaw"])
        on = moved(effect_switches({"magnet_strip__k": 60.0}))
    assert np.abs(on - without[""]).max() > 0.01


def test_other_text_is_other_code(tmp_path: Path) -> None:
    """In one process and under one name: machine code is known by what the file holds."""
    times, u = commands()
    drives = []
    for text in (MAGNET, MAGNET.replace('"m", 1.0', '"m", -1.0')):
        with own_effects_in_use(own_file(tmp_path, text)):
            e = effect_switches({"magnet_strip__k": 60.0})
            chain = actuator_chain(times, u, 0.0, 100, H, CAR, 2.012, e)
            drives.append(integrate(REST, 100, chain, 20.0, CAR, e, Constants()))
    assert drives[0][-1, 0] > 0.0 > drives[1][-1, 0]


def test_only_a_law_of_the_place_makes_forces_vary_with_the_pose(tmp_path: Path) -> None:
    with own_effects_in_use(own_file(tmp_path, MAGNET)):
        assert varies_with_pose(effect_switches({"magnet_strip__k": 60.0}))
        assert not varies_with_pose(effect_switches({"yaw_scrub__c": 60.0}))
    with own_effects_in_use(own_file(tmp_path, DRAG)):
        assert not varies_with_pose(effect_switches({"own_drag__c": 60.0}))


def test_sizes_are_the_user_s_whatever_the_vehicle(tmp_path: Path) -> None:
    with own_effects_in_use(own_file(tmp_path, MAGNET)):
        small = Hypothesis((), CAR, 2.012, Constants(), units=VehicleScale(0.01, 0.2, 0.3))
        assert small.entries["magnet_strip"].parameters == EFFECTS["magnet_strip"].parameters


# --- in predictions -----------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("component", range(6), ids=["x", "y", "yaw", "v_x", "v_y", "omega"])
def test_derivatives_by_the_initial_state_are_those_of_predictions(
    component: int, tmp_path: Path, recording: Recording, vehicle: Any, tuning: Any
) -> None:
    """Of vectors of segments with the law on, by the variational equation and by central differences."""
    take = cut_segments(recording, estimate_motion(recording, vehicle, tuning)).part(np.arange(4, 24, 2))
    with own_effects_in_use(own_file(tmp_path, MAGNET)):
        hypothesis = Hypothesis(("magnet_strip",), CAR, 2.012, Constants())
        inputs = hypothesis.prediction_inputs(hypothesis.phi_of(CAR, [60.0]), take)
        layout, start = segment_layout(take), take.start.copy()
        linearised = linearise_poses(
            layout, start, inputs.chain, np.array([CAR]), np.zeros(0), COARSE, *inputs.kernel_arguments[2:]
        )  # fmt: skip
        paths = []
        for step in (WIDTH, -WIDTH):
            start[:, component] = take.start[:, component] + step
            paths.append(predict_poses(layout, start, *inputs.kernel_arguments))
    found, told = (paths[0] - paths[1]) / (2.0 * WIDTH), linearised[1][:, :, component]
    np.testing.assert_allclose(told, found, atol=2e-3 * np.abs(found).max())
