"""The Newton-Euler car with every effect in its place; with all switches off it is the base model to the last bit.

Order on the way from command to force: delay, servo (dead band, rate asymmetry), lag, play - these need the
commands alone and run ahead of the body (`steering_chain`) - then, at the body's speed, linkage, compliance,
tyres, motor, drag, floor.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from bcid.compiled.lanes import some, where
from bcid.compiled.njit import njit, njit_inline
from bcid.effects import corrections, forces, measurement, motor, steering, tyres
from bcid.effects.constants import Constants
from bcid.physics.car import Car, motor_force
from bcid.physics.elementary import sincos
from bcid.physics.kinematics import wheel_velocity
from bcid.physics.motor import drag
from bcid.physics.tyres import slip_angle

COMPLIANCE_STEPS = 40
COMPLIANCE_MISS = 1e-12  # rad


class Body(NamedTuple):
    """Pose and twist of the CoG."""

    p_x: float
    p_y: float
    theta: float
    v_x: float
    v_y: float
    omega: float


class Drive(NamedTuple):
    """What the actuators and the clock give at an instant."""

    t: float  # s since the recording began
    T: float  # its length, s
    delta: float  # angle at the end of the steering chain (rad)
    u_m: float  # throttle after its delay
    u_next: float  # what it changes to within the step,
    late: float  # and the weight of that: none where nothing changes


class Lagged(NamedTuple):
    """Quantities that may lag: front slip angle (rad), motor force at the front and rear wheels (N)."""

    alpha_f: float
    F_mf: float
    F_mr: float


class Wrench(NamedTuple):
    """On the body, and what the lagging quantities would be at once."""

    F_x: float
    F_y: float
    M_z: float
    heavier: float
    steady: Lagged
    v_fx: float


class _Front(NamedTuple):
    F_l: float
    F_a: float
    alpha_s: float
    F_m: float
    v_fx: float


@njit_inline
def _held_force(u_m: float, v_w: float, drive: Drive, p: Car, e: Any, c: Constants) -> float:
    """F_m (N) at one wheel under one throttle, with the motor's effects."""
    u_m = motor.dead_zone(u_m, e.motor_dead_zone__width)
    F = corrections.faded(motor_force(u_m, v_w, p), u_m, v_w, p.u_0, e.motor_fade__k)
    supplied = motor.power_limit(F, v_w, e.motor_power_limit__inverse_P, c.v_p)
    supplied = motor.sag(supplied, drive.t, drive.T, e.motor_sag__s)
    supplied += motor.regeneration(u_m, v_w, p.K_t, p.F_m_max, e.motor_regeneration__r)
    return where(u_m >= 0.0, supplied, F)


@njit_inline
def throttle_force(v_w: float, drive: Drive, p: Car, e: Any, c: Constants) -> float:
    """F_m (N) at one wheel; forces are averaged, not throttles, of which the force is no linear function."""
    F = _held_force(drive.u_m, v_w, drive, p, e, c)
    if some(drive.late != 0.0):
        F += drive.late * (_held_force(drive.u_next, v_w, drive, p, e, c) - F)
    return F


@njit_inline
def _front(
    delta_w: float, b: Body, drive: Drive, lagged: Lagged, grip: float, F_lr: float, p: Car, e: Any, c: Constants
) -> _Front:
    """Force along and across the front wheel at the angle `delta_w`, with F_lr along the rear ones."""
    v_fx, v_fy = wheel_velocity(b.v_x, b.v_y, b.omega, p.l_f, delta_w)
    F_m = throttle_force(v_fx, drive, p, e, c)
    pull = lagged.F_mf if e.motor_lag__tau > 0.0 else F_m
    rolling = drag(v_fx, p.R_1, p.R_2)
    F_d = rolling
    F_d += forces.front_coulomb_friction(v_fx, e.front_coulomb_friction__c, c.v_c)
    F_d += forces.steering_drag(delta_w, v_fx, e.steering_drag__k)
    if e.rough_patch__b != 0.0:
        rough = forces.inside(b.p_x, b.p_y, e.rough_patch__x, e.rough_patch__y, e.rough_patch__radius)
        F_d += where(rough, e.rough_patch__b * v_fx, 0.0)
    F_l = p.front_share * (pull - rolling) - (F_d - rolling)
    alpha_s = slip_angle(v_fx, v_fy, corrections.slip_speed(p.v_0, e.slip_speed__d))
    alpha = lagged.alpha_f if e.tyre_relaxation__sigma > 0.0 else alpha_s
    load = tyres.load_factor(F_l, delta_w, F_lr, p.m, e.load_transfer__k)
    F_max = tyres.friction_circle(p.F_f_max * grip * load, p.front_share * pull, e.friction_circle__kappa)
    shift = tyres.ply_steer(v_fx, e.front_ply_steer__f, c.v_c)
    F_max = corrections.grip_left(-p.C_f * load * alpha + shift, F_max, e.tyre_fall__f)
    F_a = tyres.side_force(alpha, p.C_f * load, F_max, shift, e.tyre_soft_saturation__s)
    return _Front(F_l, F_a, alpha_s, F_m, v_fx)


@njit
def _side_force_at(
    delta_w: float, b: Body, drive: Drive, lagged: Lagged, grip: float, F_lr: float, p: Car, e: Any, c: Constants
) -> float:
    """The front wheel's side force at an angle, not inlined: a step would hold this code thirty times."""
    return _front(delta_w, b, drive, lagged, grip, F_lr, p, e, c).F_a


@njit_inline
def _wheel_angle(
    b: Body, drive: Drive, lagged: Lagged, grip: float, F_lr: float, p: Car, e: Any, c: Constants
) -> float:
    """delta_w: linkage, then compliance with the wheel's own side force, solved together by regula falsi."""
    speed = math.hypot(b.v_x, b.v_y) if e.steering_speed_gain__k != 0.0 else 0.0
    base: float = steering.linkage(
        corrections.scaled_steering(drive.delta, e.steering_scale__g), speed,
        e.steering_nonlinearity__k, e.steering_side_gain__a, e.steering_speed_gain__k,
        e.steering_offset__o,
    )  # fmt: skip
    k: float = e.steering_compliance__k
    if k == 0.0:
        return base
    reach = 2.0 * abs(k) * p.F_f_max
    low, high = base - reach, base + reach
    miss_low = low - base - k * _side_force_at(low, b, drive, lagged, grip, F_lr, p, e, c)
    miss_high = high - base - k * _side_force_at(high, b, drive, lagged, grip, F_lr, p, e, c)
    for _ in range(COMPLIANCE_STEPS):
        slope = miss_high - miss_low
        going = (abs(miss_high) >= COMPLIANCE_MISS) & (slope != 0.0)  # else found, or so weak that nothing moves
        if not some(going):
            break
        angle = where(going, high - miss_high * (high - low) / where(going, slope, 1.0), high)
        miss = angle - base - k * _side_force_at(angle, b, drive, lagged, grip, F_lr, p, e, c)
        crossed = miss * miss_high < 0.0
        low = where(going & crossed, high, low)
        halved = where(crossed, miss_high, 0.5 * miss_low)  # the Illinois rule: the end that stays counts half
        miss_low, miss_high, high = where(going, halved, miss_low), where(going, miss, miss_high), angle
    return high


@njit_inline
def _rear_side_force(b: Body, v_rx: float, v_ry: float, grip: float, p: Car, e: Any) -> float:
    """F_ar (N) of one wheel in the middle, or of two."""
    v_0 = corrections.slip_speed(p.v_0, e.slip_speed__d)
    F_max = p.F_r_max * grip
    if e.two_rear_wheels__t == 0.0:
        alpha = slip_angle(v_rx, v_ry, v_0) + tyres.rear_toe(v_rx, e.rear_toe__epsilon, v_0)
        F_there = corrections.grip_left(-p.C_r * alpha, F_max, e.tyre_fall__f)
        total: float = tyres.side_force(alpha, p.C_r, F_there, 0.0, e.tyre_soft_saturation__s)
        return total
    total = 0.0
    for hand in (-0.5, 0.5):
        v_wx = b.v_x - hand * e.two_rear_wheels__t * b.omega
        alpha = slip_angle(v_wx, v_ry, v_0) + tyres.rear_toe(v_wx, e.rear_toe__epsilon, v_0)
        F_there = corrections.grip_left(-p.C_r * alpha, F_max, e.tyre_fall__f)
        total += 0.5 * tyres.side_force(alpha, p.C_r, F_there, 0.0, e.tyre_soft_saturation__s)
    return total


@njit_inline
def wrench(b: Body, drive: Drive, lagged: Lagged, p: Car, e: Any, c: Constants) -> Wrench:
    """Forces and moment on the body with every effect in its place."""
    grip = 1.0
    if e.slippery_patch__D != 0.0:
        slippery = forces.inside(b.p_x, b.p_y, e.slippery_patch__x, e.slippery_patch__y, e.slippery_patch__radius)
        grip = where(slippery, 1.0 - e.slippery_patch__D, 1.0)
    v_rx, v_ry = wheel_velocity(b.v_x, b.v_y, b.omega, -p.l_r, 0.0)
    F_mr = throttle_force(v_rx, drive, p, e, c) if p.front_share < 1.0 else 0.0
    pull_r = lagged.F_mr if e.motor_lag__tau > 0.0 else F_mr
    F_lr = (1.0 - p.front_share) * (pull_r - drag(v_rx, p.R_1, p.R_2))
    delta_w = _wheel_angle(b, drive, lagged, grip, F_lr, p, e, c)
    front = _front(delta_w, b, drive, lagged, grip, F_lr, p, e, c)
    F_ar = _rear_side_force(b, v_rx, v_ry, grip, p, e)
    sin_d, cos_d = sincos(delta_w)
    F_x = cos_d * front.F_l - sin_d * front.F_a + F_lr
    F_fy = sin_d * front.F_l + cos_d * front.F_a
    F_y, M_z = F_fy + F_ar, p.l_f * F_fy - p.l_r * F_ar

    M_z += forces.drive_lateral_offset(front.F_l, delta_w, F_lr, e.drive_lateral_offset__a)
    F_x += forces.rear_rolling_coulomb(b.v_x, e.rear_rolling_coulomb__c, c.v_c)
    F_x += forces.rear_rolling_viscous(b.v_x, e.rear_rolling_viscous__b)
    air_x, air_y = forces.quadratic_drag(b.v_x, b.v_y, e.quadratic_drag__k)
    one_x, one_m = forces.rear_drag_asymmetry(b.v_x, b.omega, e.rear_drag_asymmetry__b, c.track)
    cable_x, cable_y = forces.tether(
        b.p_x, b.p_y, e.tether_pull__k, e.tether_pull__x, e.tether_pull__y, e.tether_pull__r_0
    )
    heavier = measurement.heavier(drive.t, e.mass_change__d, e.mass_change__t_s)
    world_x = cable_x + heavier * p.m * e.floor_slope__g_x
    world_y = cable_y + heavier * p.m * e.floor_slope__g_y
    F_x += air_x + one_x
    F_y += air_y
    if e.tether_pull__k != 0.0 or e.floor_slope__g_x != 0.0 or e.floor_slope__g_y != 0.0:
        sin_t, cos_t = sincos(b.theta)
        F_x += cos_t * world_x + sin_t * world_y
        F_y += cos_t * world_y - sin_t * world_x
    M_z += one_m + forces.yaw_scrub(b.omega, e.yaw_scrub__c) + forces.yaw_coulomb(b.omega, e.yaw_coulomb__c, c.w_c)
    return Wrench(F_x, F_y, M_z, heavier, Lagged(front.alpha_s, front.F_m, F_mr), front.v_fx)


@njit
def alike_everywhere(e: Any) -> bool:
    """Whether the car drives alike wherever it is and whichever way it heads."""
    here = e.slippery_patch__D != 0.0 or e.rough_patch__b != 0.0 or e.tether_pull__k != 0.0
    return not (here or e.floor_slope__g_x != 0.0 or e.floor_slope__g_y != 0.0)


@njit
def lag_after(start: float, steady_0: float, steady: float, ratio: float) -> float:
    """A first-order lag after `ratio` time constants, exactly where its input runs linearly from steady_0 to steady."""
    E = math.exp(-ratio)
    passed = ratio != 0.0
    after = steady - (steady - steady_0) * (1.0 - E) / where(passed, ratio, 1.0) + (start - steady_0) * E
    return where(passed, after, start)
