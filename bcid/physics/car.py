"""The Newton-Euler car: a rigid body whose twist rate comes from motor, drag and tyre forces.

    v_x' = F_x/m + w v_y,   v_y' = F_y/m - w v_x,   w' = M_z/I_z          (paper, force balance)

State [v_x, v_y, w, delta]; RK4 with two substeps per period (paper, fnewtoneuler).
"""

import math
from typing import NamedTuple

from bcid.aliases import Floats
from bcid.compiled.lanes import multiply_add, where
from bcid.compiled.njit import njit, njit_inline
from bcid.compiled.rebuild import rebuild
from bcid.physics.elementary import sincos
from bcid.physics.kinematics import wheel_velocity
from bcid.physics.motor import (
    MotorLine,
    drag_force,
    force_controlled_line,
    force_on_line,
    speed_controlled_line,
    speed_following_line,
)
from bcid.physics.steering import steering_rate
from bcid.physics.tyres import lateral_force, slip_angle


class Car(NamedTuple):
    """All constants of the base model, SI; the symbols are the paper's."""

    m: float  # kg
    I_z: float  # kg m^2
    l_f: float  # m
    l_r: float  # m
    T_s: float  # s, steering time constant
    d: float  # rad/s, steering rate limit
    F_m_max: float  # N
    K_t: float  # N s/m; force law: N per unit throttle
    K_b: float  # N s/m
    C_f: float  # N/rad
    C_r: float  # N/rad
    F_f_max: float  # N
    F_r_max: float  # N
    R_1: float  # N s/m
    R_2: float  # N s^2/m^2
    v_0: float  # m/s, errata 14
    front_share: float = 1.0  # share of F_m - F_d at the front axle: 1 front drive, 0 rear
    sets_force: float = 0.0  # 1 where the throttle sets a force (law "force"), 0 for a speed
    u_0: float = 0.0  # force law: dead zone
    K_v: float = 0.0  # force law: N s/m
    reverses: float = 0.0  # 1 where a throttle below zero drives backward, 0 where it is a brake share
    follows_wheel: float = 0.0  # 1 where the throttle is the driven wheel's measured speed (law "measured-speed")


CarState = tuple[float, float, float, float]
"""v_x, v_y (m/s, body), yaw rate (rad/s), delta (rad)."""

LONGEST_STEP_S = 0.025
# of a step times the fastest rate; RK4 diverges from 2.78 on
MAX_STEP_TIMES_RATE = 2.4
# share by which a half of a period may be longer than one half of it, by rounding
STEP_MARGIN = 1e-6
# s, in which a car follows its driven wheel's measured speed; of faster ones poses of millimetres tell nothing
FASTEST_FOLLOWING_S = 0.01
# parts of LONGEST_STEP_S; the constants of a faster car were badly fitted
MAX_STEP_DIVISIONS = 10


def typical_inertia_and_tyres(
    m: float, l_f: float, l_r: float, inertia: float, grip_f: float, grip_r: float
) -> dict[str, float]:
    """Typical I_z, C_f, C_r, F_f_max, F_r_max (SI) of a car of mass `m` (kg) with axles l_f and l_r (m) from the CoG.

    I_z = inertia m l_f l_r, where `inertia` has no unit; F_max = grip m, with `grip_f`, `grip_r` in N/kg.  Tyre
    stiffness grows with the mass, too, and is larger at the rear, so that the car goes straight on its own.
    """
    return {
        "I_z": inertia * m * l_f * l_r, "C_f": 12.0 * m, "C_r": 25.0 * m, "F_f_max": grip_f * m, "F_r_max": grip_r * m,
    }  # fmt: skip


def integration_step(p: Car) -> float:
    """An RK4 step (s) that is stable for the car `p` at any speed: LONGEST_STEP_S divided by a whole number up to 10.

    Side slip and yaw rate decay at rates of C/(m v_0) and C l^2/(I_z v_0) at most, summed over both axles.  I_z
    counts as at most m l_f l_r, that of two masses over the axles, since some fits determine it badly.  A car that
    follows its wheel's measured speed does so at a rate of K_t/m, and of K_t l_f^2/I_z where a driven front wheel is
    turned across; K_t/m counts as at least 1/FASTEST_FOLLOWING_S, so that a fit from `p` on needs no finer step.
    """
    I_z = min(p.I_z, p.m * p.l_f * p.l_r)
    rate = ((p.C_f + p.C_r) / p.m + (p.C_f * p.l_f**2 + p.C_r * p.l_r**2) / I_z) / p.v_0
    rate += p.follows_wheel * max(p.K_t / p.m, 1.0 / FASTEST_FOLLOWING_S) * (1.0 + p.front_share * p.m * p.l_f**2 / I_z)
    return LONGEST_STEP_S / min(max(1, math.ceil(LONGEST_STEP_S * rate / MAX_STEP_TIMES_RATE)), MAX_STEP_DIVISIONS)


@njit_inline
def forward_motor_line(u_m: float, p: Car) -> MotorLine:
    """The force, as a line in the wheel's speed, of a motor that only drives forward, by the motor law of `p`.

    The throttle `u_m` >= 0 sets a reference speed (m/s) or a force (as share of full throttle); below 0 it is a brake
    share.  Where it is the wheel's measured speed (m/s), it may have either sign.
    """
    if p.follows_wheel > 0.0:
        return speed_following_line(u_m, p.K_t, p.F_m_max)
    if p.sets_force > 0.0:
        return force_controlled_line(u_m, p.K_t, p.u_0, p.K_v, p.K_b, p.F_m_max)
    return speed_controlled_line(u_m, p.K_t, p.K_b, p.F_m_max)


@njit_inline
def forward_motor_force(u_m: float, v_w: float, p: Car) -> float:
    """Motor force (N) at the wheel speed `v_w` (m/s) under the throttle `u_m` of a motor that only drives forward.

    It is that of `forward_motor_line`; with vectors for `u_m`, lines of the laws have no type in common.
    """
    if p.follows_wheel > 0.0:
        return force_on_line(speed_following_line(u_m, p.K_t, p.F_m_max), v_w)
    if p.sets_force > 0.0:
        return force_on_line(force_controlled_line(u_m, p.K_t, p.u_0, p.K_v, p.K_b, p.F_m_max), v_w)
    return force_on_line(speed_controlled_line(u_m, p.K_t, p.K_b, p.F_m_max), v_w)


@njit_inline
def motor_line(u_m: float, p: Car) -> MotorLine:
    """The motor's force F_m under the throttle `u_m` as a line in the wheel's speed, by the motor law of `p`.

    Where the car reverses, u_m < 0 is a reference speed (m/s) or a force backward, else a brake share.  A motor drives
    backward as it drives forward: F_m(u_m, v_w) = -F_m(-u_m, -v_w).
    """
    if p.reverses > 0.0:
        backward = u_m < 0.0
        line = forward_motor_line(abs(u_m), p)
        return MotorLine(
            where(backward, -line.F_0, line.F_0), where(backward, -line.v_0, line.v_0), line.slope,
            where(backward, -line.high, line.low), where(backward, -line.low, line.high),
        )  # fmt: skip
    return forward_motor_line(u_m, p)


@njit_inline
def motor_force(u_m: float, v_w: float, p: Car) -> float:
    """Motor force F_m (N) at the wheel speed `v_w` (m/s) under the throttle `u_m`, by the motor law of `p`."""
    return force_on_line(motor_line(u_m, p), v_w)


@njit_inline
def with_brake(p: Car, brake_share: float) -> Car:
    """The car `p` while its brake is on: its rolling drag R_1 grown by K_b times `brake_share`, from 0 to 1.

    It is the throttle's brake (docs/errata.md row 13) without the motor's limit: a brake of its own is not the motor.
    """
    return Car(
        p.m, p.I_z, p.l_f, p.l_r, p.T_s, p.d, p.F_m_max, p.K_t, p.K_b, p.C_f, p.C_r, p.F_f_max, p.F_r_max,
        p.R_1 + brake_share * p.K_b, p.R_2, p.v_0, p.front_share, p.sets_force, p.u_0, p.K_v, p.reverses,
        p.follows_wheel,
    )  # fmt: skip


@njit_inline
def rear_drive(u_m: float, v_w: float, p: Car) -> float:
    """Force (N) along the rear wheels, of motor and drag, at their speed `v_w` (m/s) under the throttle `u_m`."""
    return (1.0 - p.front_share) * (motor_force(u_m, v_w, p) - drag_force(v_w, p.R_1, p.R_2))


@njit_inline
def no_rear_drive(u_m: float, v_w: float, p: Car) -> float:
    """The `rear_drive` of a car with front drive alone: 0 N."""
    return 0.0


@njit_inline
def wrench_of_axles(
    F_lf: float, F_af: float, F_lr: float, F_ar: float, sin_d: float, cos_d: float, p: Car
) -> tuple[float, float, float]:
    """Force F_x, F_y (N) and moment M_z (N m) on the body from the forces (N) along and across both axles' wheels.

    `sin_d`, `cos_d` are of the front wheel's angle (paper, second equation; docs/errata.md row 2 for the sign in F_x).
    """
    F_fy = multiply_add(sin_d, F_lf, cos_d * F_af)
    return multiply_add(cos_d, F_lf, F_lr - sin_d * F_af), F_fy + F_ar, multiply_add(p.l_f, F_fy, -p.l_r * F_ar)


@njit_inline
def wrench(v_x: float, v_y: float, yaw_rate: float, delta: float, u_m: float, p: Car) -> tuple[float, float, float]:
    """Force F_x, F_y (N) and moment M_z (N m) of the base model on the body: motor, drag and tyres.

    `v_x`, `v_y` (m/s) and `yaw_rate` (rad/s) are the body-frame twist of the CoG, `delta` (rad) the wheel angle,
    `u_m` the throttle (paper, second equation).
    """
    v_fx, v_fy = wheel_velocity(v_x, v_y, yaw_rate, p.l_f, delta)
    v_rx, v_ry = v_x, multiply_add(-p.l_r, yaw_rate, v_y)
    F_af = lateral_force(slip_angle(v_fx, v_fy, p.v_0), p.C_f, p.F_f_max)
    F_ar = lateral_force(slip_angle(v_rx, v_ry, p.v_0), p.C_r, p.F_r_max)
    F_lf = p.front_share * (motor_force(u_m, v_fx, p) - drag_force(v_fx, p.R_1, p.R_2))
    F_lr = rear_drive(u_m, v_rx, p)
    sin_d, cos_d = sincos(delta)
    return wrench_of_axles(F_lf, F_af, F_lr, F_ar, sin_d, cos_d, p)


@njit_inline
def state_rate(
    v_x: float, v_y: float, yaw_rate: float, delta: float, u_s: float, u_m: float, p: Car
) -> tuple[float, float, float, float]:
    """Time derivative of the base model's state [v_x, v_y (m/s, body), yaw_rate (rad/s), delta (rad)].

    `u_s` (rad) is the steering command, `u_m` the throttle (paper, force balance, and steering in App. actuators).
    """
    F_x, F_y, M_z = wrench(v_x, v_y, yaw_rate, delta, u_m, p)
    delta_rate = steering_rate(u_s, delta, p.T_s, p.d)
    # a loop divides once, not in every step
    inverse_m, inverse_I_z = 1.0 / p.m, 1.0 / p.I_z
    return (
        multiply_add(inverse_m, F_x, yaw_rate * v_y), multiply_add(inverse_m, F_y, -yaw_rate * v_x),
        inverse_I_z * M_z, delta_rate,
    )  # fmt: skip


@njit_inline
def _ahead(state: CarState, h: float, rate: CarState) -> CarState:
    """The state [v_x, v_y, yaw rate, delta] `h` seconds ahead at a constant `rate`."""
    return (
        multiply_add(h, rate[0], state[0]), multiply_add(h, rate[1], state[1]),
        multiply_add(h, rate[2], state[2]), multiply_add(h, rate[3], state[3]),
    )  # fmt: skip


@njit_inline
def rk4_step(state: CarState, u_s: float, u_m: float, p: Car, h: float) -> CarState:
    """State [v_x, v_y, yaw rate, delta] of the base model after one RK4 step of `h` seconds at constant commands.

    The state is in m/s (body frame), rad/s and rad; `u_s` (rad) is the steering command, `u_m` the throttle.
    """
    k_1 = state_rate(*state, u_s, u_m, p)
    k_2 = state_rate(*_ahead(state, 0.5 * h, k_1), u_s, u_m, p)
    k_3 = state_rate(*_ahead(state, 0.5 * h, k_2), u_s, u_m, p)
    k_4 = state_rate(*_ahead(state, h, k_3), u_s, u_m, p)
    sixth, third = h * (1.0 / 6.0), h * (1.0 / 3.0)
    return _ahead(_ahead(_ahead(_ahead(state, sixth, k_1), third, k_2), third, k_3), sixth, k_4)


@njit_inline
def advance_period(state: CarState, u_s: float, u_m: float, p: Car, period: float) -> CarState:
    """State [v_x, v_y, yaw rate, delta] of the base model after one `period` (s) of constant commands.

    Two RK4 steps, as f_NE of the paper; the state is in m/s (body frame), rad/s and rad; `u_s` (rad) is the steering
    command, `u_m` the throttle.
    """
    half = 0.5 * period
    return rk4_step(rk4_step(state, u_s, u_m, p, half), u_s, u_m, p, half)


rk4_step_by_front_drive = rebuild(rk4_step, {rear_drive: no_rear_drive}, __name__)
"""`rk4_step` of a car with front drive alone."""


@njit
def step_cars(state: Floats, step: Floats, p: Car) -> None:
    """Advance B cars of equal constants `p` by one RK4 step each, of lengths of their own, in place.

    `state` (4, B) has the rows v_x, v_y (m/s, body), yaw rate (rad/s), delta (rad), `step` (4, B) its length (s),
    steering (rad), throttle and brake share.  A step of length 0 changes nothing.  The loop's body is arithmetic and
    selections only, which the compiler turns into vector instructions.
    """
    # `v_x, v_y, omega, delta = state` would hide that rows are contiguous
    v_x, v_y, omega, delta = state[0], state[1], state[2], state[3]
    h, u_s, u_m, brake = step[0], step[1], step[2], step[3]
    if p.front_share == 1.0:
        for b in range(len(v_x)):
            v_x[b], v_y[b], omega[b], delta[b] = rk4_step_by_front_drive(
                (v_x[b], v_y[b], omega[b], delta[b]), u_s[b], u_m[b], with_brake(p, brake[b]), h[b]
            )
        return
    for b in range(len(v_x)):
        v_x[b], v_y[b], omega[b], delta[b] = rk4_step(
            (v_x[b], v_y[b], omega[b], delta[b]), u_s[b], u_m[b], with_brake(p, brake[b]), h[b]
        )
