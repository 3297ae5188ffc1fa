"""The Newton-Euler car with every effect in its place; with all switches off it is the base model to the last bit.

Delays, servo, steering lag and play need the commands alone and run ahead of the body (`bcid.effects.actuators`).
Here follow, at the body's speed: linkage, compliance, tyres, motor, drag, floor.
"""

from typing import NamedTuple

from bcid.aliases import Floats, Switches
from bcid.compiled.lanes import any_lane, where
from bcid.compiled.njit import njit, njit_inline
from bcid.effects import corrections, forces, measurement, motor, steering, tyres
from bcid.effects.constants import Constants
from bcid.effects.linkage import linkage_angle
from bcid.effects.own_laws import (
    OwnInputs,
    add_own_pushes,
    own_motor_force,
    own_pushes_vary_with_pose,
    own_wheel_angle,
)
from bcid.effects.remainder import RemainderAction
from bcid.physics.car import Car, forward_motor_force, motor_force, wrench_of_axles
from bcid.physics.elementary import sincos
from bcid.physics.kinematics import wheel_velocity
from bcid.physics.motor import drag_force
from bcid.physics.tyres import lateral_force, slip_angle

MAX_COMPLIANCE_STEPS = 40
COMPLIANCE_TOLERANCE_RAD = 1e-12
# throttle (m/s, or share) that no command reaches
BEYOND_ANY_THROTTLE = 1e9


class BodyState(NamedTuple):
    """Pose (m, m, rad) and twist (m/s, m/s, rad/s) of the CoG; x and y in the world, v_x and v_y in the body frame."""

    p_x: float
    p_y: float
    theta: float
    v_x: float
    v_y: float
    omega: float


class Actuation(NamedTuple):
    """Steering angle and throttle that the actuators give at an instant."""

    t: float  # s since the recording began
    T: float  # its length, s
    delta: float  # angle at the end of the steering chain (rad)
    delta_rate: float  # and its rate over the step (rad/s)
    u_m: float  # throttle after its delay
    u_next: float  # throttle after its change within the step
    late: float  # weight of u_next: 0 where the throttle stays
    brake: float  # share of a brake that is no part of the throttle
    rest: RemainderAction  # what has no name; zeros where there is none


class LagState(NamedTuple):
    """Quantities that may lag: front slip angle (rad), motor force at a front and at a rear wheel (N)."""

    alpha_f: float
    F_mf: float
    F_mr: float


class Wrench(NamedTuple):
    """Force and moment on the body, with what is needed to advance mass and lags."""

    F_x: float
    F_y: float
    M_z: float
    mass_factor: float
    steady: LagState
    v_fx: float


class _FrontWheel(NamedTuple):
    """Forces along (F_l) and across (F_a) the front wheel (N), its steady slip angle, motor force and rolling speed."""

    F_l: float
    F_a: float
    alpha_s: float
    F_m: float
    v_fx: float


@njit
def unpack_body(x: Floats) -> BodyState:
    """Pose [p_x, p_y, theta] (world) and twist [v_x, v_y, omega] (body) in a row `x` (9,) of `integrate_body`."""
    return BodyState(x[0], x[1], x[2], x[3], x[4], x[5])


@njit
def unpack_lags(x: Floats) -> LagState:
    """Lagging front slip angle alpha_f (rad), motor forces F_mf, F_mr (N) in a row `x` (9,) of `integrate_body`."""
    return LagState(x[6], x[7], x[8])


@njit_inline
def own_inputs(b: BodyState, act: Actuation, p: Car) -> OwnInputs:
    """What the user's laws may depend on at a state `b`; of a throttle that changes within a step, the mean."""
    zero, u_m = 0.0 * b.v_x, act.u_m + act.late * (act.u_next - act.u_m)
    return OwnInputs(
        act.t, act.T, b.p_x, b.p_y, b.theta, b.v_x, b.v_y, b.omega, act.delta, act.delta_rate, u_m, p.m, zero, zero
    )  # fmt: skip


@njit_inline
def _own_inputs_of_motor(u_m: float, v_w: float, act: Actuation, p: Car) -> OwnInputs:
    """What the user's laws of a motor may depend on: throttle, wheel speed (m/s), time (s) and the car's mass (kg)."""
    none = 0.0 * v_w
    return OwnInputs(
        act.t, act.T, none, none, none, none, none, none, none, none, u_m, p.m, none, v_w
    )  # fmt: skip


@njit_inline
def own_pushes(b: BodyState, act: Actuation, p: Car, e: Switches) -> tuple[float, float, float]:
    """Force (N, N) and moment (N m) on the body by the user's laws in `e`, at a state `b`; zeros where none is."""
    none = 0.0 * b.v_x
    pushes: tuple[float, float, float] = add_own_pushes((none, none, none), own_inputs(b, act, p), e)
    return pushes


@njit_inline
def _forward_motor_force_at(u_m: float, v_w: float, act: Actuation, p: Car, e: Switches, c: Constants) -> float:
    """Motor force (N) under the throttle `u_m` at the wheel speed `v_w` (m/s), before any lag, of a forward motor.

    The motor's effects in `e` act on the law of `p`: dead zone, fade, power limit, sag, regeneration; time comes
    from `act`.
    """
    u_m = motor.motor_dead_zone(u_m, e.motor_dead_zone__width)
    F = corrections.motor_fade(forward_motor_force(u_m, v_w, p), u_m, v_w, p.u_0, e.motor_fade__k)
    supplied = motor.motor_power_limit(F, v_w, e.motor_power_limit__inverse_P, c.v_p)
    supplied = motor.motor_sag(supplied, act.t, act.T, e.motor_sag__s)
    supplied += motor.motor_regeneration(u_m, v_w, p.K_t, p.F_m_max, e.motor_regeneration__r)
    supplied = own_motor_force(supplied, _own_inputs_of_motor(u_m, v_w, act, p), e)
    return where(u_m >= 0.0, supplied, F)


@njit_inline
def _motor_force_at(u_m: float, v_w: float, act: Actuation, p: Car, e: Switches, c: Constants) -> float:
    """Motor force F_m (N) under the throttle `u_m` at the wheel speed `v_w` (m/s), before any lag, with its effects.

    Where the car reverses, F_m(u_m, v_w) = -F_m(-u_m, -v_w), effects included.
    """
    # below zero for a car that reverses, never for another: a branch would compile the motor's effects twice
    backward = u_m < (p.reverses - 1.0) * BEYOND_ANY_THROTTLE
    F_m = _forward_motor_force_at(where(backward, -u_m, u_m), where(backward, -v_w, v_w), act, p, e, c)
    return where(backward, -F_m, F_m)


@njit_inline
def motor_force_with_effects(v_w: float, act: Actuation, p: Car, e: Switches, c: Constants) -> float:
    """Motor force F_m (N) at the wheel speed `v_w` (m/s) under the throttle of `act`, with the motor's effects in `e`.

    Where the throttle changes within a step, the forces under both throttles are averaged: F_m is not linear in u_m.
    """
    F = _motor_force_at(act.u_m, v_w, act, p, e, c)
    if any_lane(act.late != 0.0):
        F += act.late * (_motor_force_at(act.u_next, v_w, act, p, e, c) - F)
    return F


@njit_inline
def _front_wheel_forces(
    delta_w: float,
    b: BodyState,
    act: Actuation,
    lags: LagState,
    grip: float,
    F_lr: float,
    p: Car,
    e: Switches,
    c: Constants,
) -> _FrontWheel:
    """Forces along and across the front wheel (N) at its angle `delta_w` (rad), with the effects that act on it.

    `grip` multiplies the largest side force F_f_max (a slippery patch's factor); `F_lr` is the rear axle's drive
    force (N); `lags` holds the lagging slip angle and motor force, used instead of the steady ones while their effect
    is on.
    """
    v_fx, v_fy = wheel_velocity(b.v_x, b.v_y, b.omega, p.l_f, delta_w)
    F_m = motor_force_with_effects(v_fx, act, p, e, c)
    pull = lags.F_mf if e.motor_lag__tau > 0.0 else F_m
    rolling = drag_force(v_fx, p.R_1 + act.brake * p.K_b, p.R_2)
    F_d = rolling
    F_d += forces.front_coulomb_friction(v_fx, e.front_coulomb_friction__c, c.v_c)
    F_d += forces.steering_drag(delta_w, v_fx, e.steering_drag__k)
    F_d += forces.steering_friction(delta_w, v_fx, e.steering_friction__c, c.v_c)
    F_d += forces.rough_patch(
        b.p_x, b.p_y, v_fx, e.rough_patch__b, e.rough_patch__x, e.rough_patch__y, e.rough_patch__radius
    )
    F_l = p.front_share * (pull - rolling) - (F_d - rolling)
    alpha_s = slip_angle(v_fx, v_fy, corrections.slip_speed(p.v_0, e.slip_speed__d))
    alpha = lags.alpha_f if e.tyre_relaxation__sigma > 0.0 else alpha_s
    load = tyres.load_transfer(F_l, delta_w, F_lr, p.m, e.load_transfer__k)
    F_max = tyres.friction_circle(p.F_f_max * grip * load, p.front_share * pull, e.friction_circle__kappa)
    linear = -p.C_f * load * alpha + tyres.front_ply_steer(v_fx, e.front_ply_steer__f, c.v_c)
    F_max = corrections.tyre_fall(linear, F_max, e.tyre_fall__f)
    F_a = tyres.tyre_soft_saturation(linear, F_max, e.tyre_soft_saturation__s)
    return _FrontWheel(F_l, F_a, alpha_s, F_m, v_fx)


@njit
def _compliance_residual(
    delta_w: float, delta: float, b: BodyState, act: Actuation, lags: LagState, grip: float, F_lr: float, p: Car,
    e: Switches, c: Constants,
) -> float:  # fmt: skip
    """Residual delta_w - delta - k F_af(delta_w) (rad) of the compliant front wheel's angle, 0 at the balance.

    `delta` is the angle without compliance, `F_af` the side force (N) under the forces of `_front_wheel_forces`,
    whose other arguments these are.  Not inlined, since a step calls it often.
    """
    F_af = _front_wheel_forces(delta_w, b, act, lags, grip, F_lr, p, e, c).F_a
    return steering.steering_compliance(delta_w, delta, F_af, e.steering_compliance__k)


@njit_inline
def _solve_wheel_angle(
    b: BodyState, act: Actuation, lags: LagState, grip: float, F_lr: float, p: Car, e: Switches, c: Constants
) -> float:
    """Angle delta_w (rad) of the front wheel: the steering's angle after the effects of linkage and compliance.

    The compliance depends on the side force at the angle sought, and is solved by regula falsi; the arguments are
    those of `_front_wheel_forces`.
    """
    delta = steering.steering_speed_gain(linkage_angle(act.delta, e), b.v_x, b.v_y, e.steering_speed_gain__k)
    delta = steering.steering_offset(delta, e.steering_offset__o)
    delta = own_wheel_angle(delta, own_inputs(b, act, p), e)
    k: float = e.steering_compliance__k
    if k == 0.0:
        return delta
    reach = 2.0 * abs(k) * p.F_f_max
    low, high = delta - reach, delta + reach
    miss_low = _compliance_residual(low, delta, b, act, lags, grip, F_lr, p, e, c)
    miss_high = _compliance_residual(high, delta, b, act, lags, grip, F_lr, p, e, c)
    for _ in range(MAX_COMPLIANCE_STEPS):
        slope = miss_high - miss_low
        # done where the balance is found, or the compliance so weak that nothing moves
        going = (abs(miss_high) >= COMPLIANCE_TOLERANCE_RAD) & (slope != 0.0)
        if not any_lane(going):
            break
        angle = where(going, high - miss_high * (high - low) / where(going, slope, 1.0), high)
        miss = _compliance_residual(angle, delta, b, act, lags, grip, F_lr, p, e, c)
        crossed = miss * miss_high < 0.0
        low = where(going & crossed, high, low)
        # the Illinois rule: the end that stays counts half
        halved = where(crossed, miss_high, 0.5 * miss_low)
        miss_low, miss_high, high = where(going, halved, miss_low), where(going, miss, miss_high), angle
    return high


@njit_inline
def _rear_tyre_force(v_along: float, v_across: float, F_max: float, p: Car, e: Switches) -> float:
    """Side force (N), limited by `F_max` (N), of a rear tyre that rolls at `v_along` and slides at `v_across` (m/s).

    The force is -C_r alpha with the whole axle's cornering stiffness C_r, changed by the effects in `e` on toe angle,
    slip angle and saturation.
    """
    v_0 = corrections.slip_speed(p.v_0, e.slip_speed__d)
    alpha = slip_angle(v_along, v_across, v_0) + tyres.rear_toe(v_along, e.rear_toe__epsilon, v_0)
    F_max = corrections.tyre_fall(-p.C_r * alpha, F_max, e.tyre_fall__f)
    return tyres.tyre_soft_saturation(-p.C_r * alpha, F_max, e.tyre_soft_saturation__s)


@njit_inline
def _rear_side_force(b: BodyState, v_rx: float, v_ry: float, grip: float, p: Car, e: Switches) -> float:
    """Side force F_ar (N) of the rear axle, by one wheel in its middle or as the mean of two wheels a track apart.

    Two wheels are computed where the effect two_rear_wheels is on in `e`.  `v_rx`, `v_ry` are the velocity (m/s) of
    the axle's middle in the body frame; `grip` multiplies F_r_max (a slippery patch's factor).
    """
    if e.two_rear_wheels__t == 0.0:
        return _rear_tyre_force(v_rx, v_ry, p.F_r_max * grip, p, e)
    total = 0.0
    for side in (-0.5, 0.5):
        v_wx = corrections.two_rear_wheels(b.v_x, b.omega, e.two_rear_wheels__t, side)
        total += 0.5 * _rear_tyre_force(v_wx, v_ry, p.F_r_max * grip, p, e)
    return total


@njit_inline
def force_by_place(b: BodyState, mass_factor: float, p: Car, e: Switches) -> tuple[float, float]:
    """Force (N) along and across the body by cable and floor slope, the smooth ones that depend on place and heading.

    `mass_factor` multiplies the mass of `p`; cable and slope are effects in `e`.
    """
    cable_x, cable_y = forces.tether_pull(
        b.p_x, b.p_y, e.tether_pull__k, e.tether_pull__x, e.tether_pull__y, e.tether_pull__r_0
    )
    slope_x, slope_y = forces.floor_slope(mass_factor * p.m, e.floor_slope__g_x, e.floor_slope__g_y)
    world_x, world_y = cable_x + slope_x, cable_y + slope_y
    sin_t, cos_t = sincos(b.theta)
    return cos_t * world_x + sin_t * world_y, cos_t * world_y - sin_t * world_x


@njit
def is_pulled_by_place(e: Switches) -> bool:
    """Whether a force that depends smoothly on place or heading is on in `e`: a cable's or a floor slope's."""
    return bool(e.tether_pull__k != 0.0 or e.floor_slope__g_x != 0.0 or e.floor_slope__g_y != 0.0)


@njit
def varies_with_pose(e: Switches) -> bool:
    """Whether forces on the body depend smoothly on its pose in `e`: by cable, slope, the user's, or without a name."""
    return bool(is_pulled_by_place(e) or e.remainders > 0.0 or own_pushes_vary_with_pose(e))


@njit
def is_lagging(e: Switches) -> bool:
    """Whether the motor's force or the front tyre's slip angle lags behind its steady value in `e`."""
    return bool(e.motor_lag__tau > 0.0 or e.tyre_relaxation__sigma > 0.0)


@njit_inline
def _base_motor_force(v_w: float, act: Actuation, p: Car) -> float:
    """Motor force F_m (N) of the base model at the wheel speed `v_w` (m/s) under the throttle of `act`.

    Where the throttle changes within a step, the forces under both throttles are averaged.
    """
    F = motor_force(act.u_m, v_w, p)
    if any_lane(act.late != 0.0):
        F += act.late * (motor_force(act.u_next, v_w, p) - F)
    return F


@njit_inline
def _base_wrench(b: BodyState, act: Actuation, delta: float, p: Car) -> Wrench:
    """Force and moment on the body of the base model: what `wrench_with_effects` returns with all effects off.

    What has no name is added.  Without forty switches to ask for, it takes less than half the time.
    """
    v_fx, v_fy = wheel_velocity(b.v_x, b.v_y, b.omega, p.l_f, delta)
    v_rx, v_ry = wheel_velocity(b.v_x, b.v_y, b.omega, -p.l_r, 0.0)
    zero, R_1 = 0.0 * b.v_x, p.R_1 + act.brake * p.K_b
    F_m, alpha = _base_motor_force(v_fx, act, p), slip_angle(v_fx, v_fy, p.v_0)
    F_mr = _base_motor_force(v_rx, act, p) if p.front_share < 1.0 else zero
    F_l = p.front_share * (F_m - drag_force(v_fx, R_1, p.R_2))
    F_lr = (1.0 - p.front_share) * (F_mr - drag_force(v_rx, R_1, p.R_2))
    F_af = lateral_force(alpha, p.C_f, p.F_f_max)
    F_ar = lateral_force(slip_angle(v_rx, v_ry, p.v_0), p.C_r, p.F_r_max)
    sin_d, cos_d = sincos(delta)
    F_x, F_y, M_z = wrench_of_axles(F_l, F_af, F_lr, F_ar, sin_d, cos_d, p)
    return Wrench(F_x, F_y, M_z, zero + 1.0, LagState(alpha, F_m, F_mr), v_fx)


@njit_inline
def wrench_with_effects(b: BodyState, act: Actuation, lags: LagState, p: Car, e: Switches, c: Constants) -> Wrench:
    """Force F_x, F_y (N) and moment M_z (N m) on the body: the base model's, with every effect that is on in `e`.

    Equation: paper, section Physics Based Models, 2nd equation, with the sign in F_x of docs/errata.md row 2.  With
    all effects off, the result equals `bcid.physics.car.wrench` to the last bit.  The wrench also carries the mass
    factor and the steady values of the lagging quantities; of `lags`, their present values, only those are read whose
    lag is on.
    """
    if e.any_on_body == 0.0:
        if e.remainders == 0.0:
            return _base_wrench(b, act, act.delta, p)
        w, rest = _base_wrench(b, act, act.delta + act.rest.turn, p), act.rest
        return Wrench(
            w.F_x + p.m * rest.f_x, w.F_y + p.m * rest.f_y, w.M_z + p.m * rest.arm + p.I_z * rest.alpha,
            w.mass_factor, w.steady, w.v_fx,
        )  # fmt: skip
    grip = tyres.slippery_patch(
        b.p_x, b.p_y, e.slippery_patch__D, e.slippery_patch__x, e.slippery_patch__y, e.slippery_patch__radius
    )
    v_rx, v_ry = wheel_velocity(b.v_x, b.v_y, b.omega, -p.l_r, 0.0)
    F_mr = motor_force_with_effects(v_rx, act, p, e, c) if p.front_share < 1.0 else 0.0
    pull_r = lags.F_mr if e.motor_lag__tau > 0.0 else F_mr
    F_lr = (1.0 - p.front_share) * (pull_r - drag_force(v_rx, p.R_1 + act.brake * p.K_b, p.R_2))
    delta_w = _solve_wheel_angle(b, act, lags, grip, F_lr, p, e, c) + act.rest.turn
    front = _front_wheel_forces(delta_w, b, act, lags, grip, F_lr, p, e, c)
    F_ar = _rear_side_force(b, v_rx, v_ry, grip, p, e)
    sin_d, cos_d = sincos(delta_w)
    F_x, F_y, M_z = wrench_of_axles(front.F_l, front.F_a, F_lr, F_ar, sin_d, cos_d, p)

    M_z += forces.drive_lateral_offset(front.F_l, delta_w, F_lr, e.drive_lateral_offset__a)
    F_x += forces.rear_rolling_coulomb(b.v_x, e.rear_rolling_coulomb__c, c.v_c)
    F_x += forces.rear_rolling_viscous(b.v_x, e.rear_rolling_viscous__b)
    air_x, air_y = forces.quadratic_drag(b.v_x, b.v_y, e.quadratic_drag__k)
    wheel_x, wheel_m = forces.rear_drag_asymmetry(b.v_x, b.omega, e.rear_drag_asymmetry__b, c.track)
    mass_factor = measurement.mass_change(act.t, e.mass_change__d, e.mass_change__t_s)
    F_x += air_x + wheel_x + p.m * act.rest.f_x
    F_y += air_y + p.m * act.rest.f_y
    if is_pulled_by_place(e):
        pull_x, pull_y = force_by_place(b, mass_factor, p, e)
        F_x += pull_x
        F_y += pull_y
    M_z += wheel_m + forces.yaw_scrub(b.omega, e.yaw_scrub__c) + forces.yaw_coulomb(b.omega, e.yaw_coulomb__c, c.w_c)
    M_z += p.m * act.rest.arm + p.I_z * act.rest.alpha
    F_x, F_y, M_z = add_own_pushes((F_x, F_y, M_z), own_inputs(b, act, p), e)
    return Wrench(F_x, F_y, M_z, mass_factor, LagState(front.alpha_s, front.F_m, F_mr), front.v_fx)
