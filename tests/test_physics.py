"""The equations against closed forms, symmetries and limits."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcid.physics.car import LONGEST_STEP_S, Car, integration_step, wrench
from bcid.physics.kinematics import body_twist, kinematic_state, pose_rate, wheel_velocity, wrap_angle
from bcid.physics.motor import drag_force, force_controlled_line, force_on_line, speed_controlled_line
from bcid.physics.steering import steering_rate, steering_step
from bcid.physics.tyres import lateral_force, slip_angle, slip_angle_slopes

speeds = st.floats(-5.0, 5.0, allow_subnormal=False)  # half of the smallest subnormal is zero
forward = st.floats(0.05, 5.0)
angles = st.floats(-2.0, 2.0)
small = st.floats(-0.5, 0.5)
L_F, L_R = 0.54, 0.33


@given(forward, angles, small)
def test_rigid_body_holds_at_both_axles(v_f: float, beta_f: float, beta_r: float) -> None:
    """Errata 1: v_y + l_f w = v_f sin(beta_f), v_y - l_r w = v_x tan(beta_r)."""
    v_x, v_y, omega = body_twist(v_f, beta_f, beta_r, L_F, L_R)
    assert v_x == pytest.approx(v_f * math.cos(beta_f), abs=1e-12)
    assert v_y + L_F * omega == pytest.approx(v_f * math.sin(beta_f), abs=1e-12)
    assert v_y - L_R * omega == pytest.approx(v_x * math.tan(beta_r), abs=1e-12)


@given(forward, st.floats(-1.4, 1.4), small, angles)
def test_kinematic_state_inverts_body_twist(v_f: float, beta_f: float, beta_r: float, delta: float) -> None:
    v, alpha_f, alpha_r = kinematic_state(*body_twist(v_f, beta_f, beta_r, L_F, L_R), delta, L_F, L_R)
    assert v == pytest.approx(v_f, rel=1e-9)
    assert wrap_angle(alpha_f + delta - beta_f) == pytest.approx(0.0, abs=1e-9)
    assert alpha_r == pytest.approx(beta_r, abs=1e-8)


@given(speeds, speeds, speeds, angles)
def test_a_wheel_sees_the_same_speed_in_every_frame(v_x: float, v_y: float, omega: float, delta: float) -> None:
    """Errata 3: a rotation keeps lengths, and undoing it gives the contact velocity back."""
    along, across = wheel_velocity(v_x, v_y, omega, L_F, delta)
    assert math.hypot(along, across) == pytest.approx(math.hypot(v_x, v_y + L_F * omega), abs=1e-12)
    back_x = math.cos(delta) * along - math.sin(delta) * across
    assert back_x == pytest.approx(v_x, abs=1e-12)


def test_pose_rate_is_the_derivative_of_a_circle() -> None:
    """Errata 4 and 5: a car that circles with slip moves as its pose's numerical derivative says."""
    radius, omega, beta = 2.0, 0.7, 0.2  # the velocity points beta left of the nose
    step = 1e-6

    def pose(t: float) -> tuple[float, float, float]:
        course = omega * t
        return radius * math.sin(course), -radius * math.cos(course), course - beta

    for t in (0.0, 1.3, 4.0):
        x_0, y_0, theta = pose(t)
        x_1, y_1, _ = pose(t + step)
        speed = radius * omega
        rate = pose_rate(theta, speed * math.cos(beta), speed * math.sin(beta))
        assert rate == pytest.approx(((x_1 - x_0) / step, (y_1 - y_0) / step), abs=1e-5)


@given(st.floats(-50.0, 50.0))
def test_wrap_keeps_the_angle(angle: float) -> None:
    wrapped = wrap_angle(angle)
    assert -math.pi < wrapped <= math.pi + 1e-12
    assert math.cos(wrapped) == pytest.approx(math.cos(angle), abs=1e-9)
    assert math.sin(wrapped) == pytest.approx(math.sin(angle), abs=1e-9)


def test_steering_follows_the_closed_form() -> None:
    """Unsaturated: an exponential; saturated: a ramp."""
    assert steering_step(0.0, 0.1, 0.155, 1.418, 0.1) == pytest.approx(0.1 * (1 - math.exp(-0.1 / 0.155)), rel=1e-12)
    assert steering_step(0.0, 2.0, 0.155, 1.418, 0.1) == pytest.approx(0.1418, rel=1e-12)
    assert steering_rate(-2.0, 0.0, 0.155, 1.418) == -1.418


@given(angles, angles, st.floats(0.02, 0.5), st.floats(0.3, 5.0), st.floats(0.0, 0.3), st.floats(0.0, 0.3))
def test_steering_steps_compose(delta: float, u_s: float, T_s: float, d: float, one: float, other: float) -> None:
    """In closed form, two steps are one of their sum, however fast the servo."""
    together = steering_step(delta, u_s, T_s, d, one + other)
    apart = steering_step(steering_step(delta, u_s, T_s, d, one), u_s, T_s, d, other)
    assert together == pytest.approx(apart, abs=1e-12)
    assert min(delta, u_s) - 1e-12 <= together <= max(delta, u_s) + 1e-12


@given(speeds, st.floats(-1.0, 2.0))
def test_the_motor_only_supplies_and_the_brake_only_dissipates(v_w: float, u_m: float) -> None:
    """Errata 13: no force above the reference; below zero the power is never positive."""
    force = force_on_line(speed_controlled_line(u_m, 274.8, 597.0, 423.4), v_w)
    assert abs(force) <= 423.4
    if u_m >= 0:
        assert force >= 0.0
        assert force == 0.0 or u_m > v_w
    else:
        assert force * v_w <= 0.0


def test_force_law_has_a_dead_zone() -> None:
    """Contracts: F_m = K (u - u_0) - K_v v above u_0, nothing below."""
    still, driven = (force_controlled_line(u_m, 25.4, 0.164, 4.8, 0.0, 100.0) for u_m in (0.16, 0.3))
    assert force_on_line(still, 1.0) == 0.0
    assert force_on_line(driven, 0.5) == pytest.approx(25.4 * 0.136 - 2.4)


@given(speeds)
def test_drag_is_odd_and_dissipates(v: float) -> None:
    """Errata 6: with R_1 v + R_2 v^2 a car rolling backwards would be driven."""
    assert drag_force(-v, 40.0, 5.0) == -drag_force(v, 40.0, 5.0)
    assert drag_force(v, 40.0, 5.0) * v >= 0.0
    assert drag_force(v, 43.40, -15.61) * v >= 0.0  # the paper's, which falls with the speed


@given(small, st.floats(1.0, 1e4), st.floats(1.0, 1e4))
def test_tyre_force_is_odd_bounded_and_linear_at_small_slip(alpha: float, C: float, F_max: float) -> None:
    force = lateral_force(alpha, C, F_max)
    assert force == -lateral_force(-alpha, C, F_max)
    assert abs(force) <= F_max
    if abs(C * alpha) < F_max:
        assert force == -C * alpha


@given(speeds, speeds)
def test_slip_angle_does_not_ask_which_way_the_wheel_rolls(along: float, across: float) -> None:
    """Errata 15, and the bound v_0 makes it vanish with the speed."""
    assert slip_angle(along, across, 1.0) == slip_angle(-along, across, 1.0)
    assert abs(slip_angle(along, across, 1.0)) <= abs(across) + 1e-12
    assert np.sign(slip_angle(along, across, 1.0)) == np.sign(across)


@given(speeds, speeds)
def test_slopes_of_the_slip_angle_are_its_complex_steps(along: float, across: float) -> None:
    """On either side of the bound v_0, forwards and backwards."""
    tiny, sign = 1e-30, np.copysign(1.0, along)
    for v_0 in (0.1, 1.0, 100.0):
        by_along, by_across = slip_angle_slopes(along, across, v_0)
        fast = sign * (along + 1j * tiny) if abs(along) > v_0 else complex(v_0)
        assert by_along == pytest.approx(np.arctan(across / fast).imag / tiny, rel=1e-12, abs=1e-15)
        assert by_across == pytest.approx(np.arctan((across + 1j * tiny) / fast.real).imag / tiny, rel=1e-12)


def test_an_integration_step_suits_the_car() -> None:
    """A step bears the fastest mode of the car at rest, by the eigenvalues of the exact linearisation there."""
    bumper = Car(
        m=319.6, I_z=90.85, l_f=0.54, l_r=0.33, T_s=0.155, d=1.418, F_m_max=423.4, K_t=274.8, K_b=597.0, C_f=3594.0,
        C_r=7840.0, F_f_max=629.6, F_r_max=1360.0, R_1=43.4, R_2=4.0, v_0=1.0,
    )  # fmt: skip
    jetracer = bumper._replace(
        m=1.58, I_z=0.0048, l_f=0.0805, l_r=0.093, C_f=46.0, C_r=46.0, F_f_max=7.0, F_r_max=7.0, K_t=20.0, R_1=2.7,
        R_2=0.0,
    )  # fmt: skip
    assert integration_step(bumper) == LONGEST_STEP_S
    for car in (bumper, jetracer):
        h = 1e-6
        rest = np.array([wrench(0.5, v, w, 0.0, 0.0, car)[1:] for v, w in ((0.0, 0.0), (h, 0.0), (0.0, h))])
        slopes = (rest[1:] - rest[0]).T / h / np.array([[car.m], [car.I_z]])
        fastest = np.abs(np.linalg.eigvals(slopes)).max()
        assert fastest * integration_step(car) < 2.78
    assert integration_step(jetracer) < LONGEST_STEP_S
    assert integration_step(jetracer._replace(C_f=1e4)) == pytest.approx(LONGEST_STEP_S / 10)
