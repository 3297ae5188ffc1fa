"""What an author publishes of a small car whose laws are of other formulas: the vocabulary's laws, fitted to them.

Each law of the vocabulary is fitted to the plant's by least squares over the range in which such a car is driven, as
somebody would who has measured the car on a bench.  The vocabulary's laws stand here in arrays, written anew.
"""

from collections.abc import Callable, Iterable
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats
from bcid.effects.table import EFFECTS
from bcid.proof.blind.small_files import Figures
from bcid.simulation.car import Plant
from bcid.simulation.drive_train import requested_motor_force
from bcid.simulation.other_laws import dry_steered_drag, magic_side_force, two_sided_angle
from bcid.simulation.wheels import rolling_resistance

LARGEST_SLIP_RAD = 0.4
SLOWEST_MPS, FASTEST_MPS = 0.05, 2.6  # of what is driven
LARGEST_THROTTLE = 0.6
DRY_MPS = 0.05  # in which the vocabulary's dry frictions set in

DIGITS = 5
"""Significant digits of a published figure, so few that processors hardly ever differ in them."""

STEERED_DRAGS = tuple(name for name in ("steering_drag", "steering_friction") if name in EFFECTS)
"""Effects of the vocabulary by which a steered wheel drags: in proportion to the speed, and dry."""


class LawFit(NamedTuple):
    """A law of the vocabulary beside the plant's that it was fitted to, over what is driven."""

    figures: dict[str, float]  # by symbol
    plant: Floats  # values of the plant's law
    fitted: Floats  # values of the vocabulary's there

    @property
    def error(self) -> float:
        """Root mean square of the difference as a share of that of the plant's law."""
        return float(np.linalg.norm(self.fitted - self.plant) / np.linalg.norm(self.plant))


def _round_figures(values: Iterable[float]) -> list[float]:
    """The values with DIGITS significant digits."""
    return [float(f"{value:.{DIGITS}g}") for value in values]


def _fit_law(symbols: tuple[str, ...], law: Callable[[Floats], Floats], plant: Floats, first: list[float]) -> LawFit:
    """Fit the vocabulary's `law` of parameters with these `symbols`, from the `first` ones, to values of the `plant`'s.

    Steps are reckoned in shares of the first values, which therefore are not zero.
    """
    from scipy.optimize import least_squares

    unit, scale = np.array(first), np.linalg.norm(plant)

    def misfit(share: Floats) -> Floats:
        return np.asarray((law(share * unit) - plant) / scale)

    share = least_squares(misfit, np.ones(len(first)), jac="3-point", xtol=1e-12, ftol=1e-14, gtol=1e-12).x
    found = _round_figures(share * unit)
    return LawFit(dict(zip(symbols, found, strict=True)), plant, law(np.array(found)))


def fit_motor(p: Plant) -> LawFit:
    """Fit (K_t - k v)(u - width) - K_v v, above a hard dead zone, to the motor's force (N) at throttles and speeds.

    The line is fitted where the motor pulls; it and its dead zone are compared with the plant at all throttles.
    """
    throttles, speeds = np.linspace(0.0, LARGEST_THROTTLE, 49), np.linspace(0.1, FASTEST_MPS, 12)
    u, v = (grid.ravel() for grid in np.meshgrid(throttles, speeds))
    force = np.array([requested_motor_force(a, b, 0.0, 1.0, 0.0, p) for a, b in zip(u, v, strict=True)])
    pulls = u > p.motor_dead_zone + 2.0 / p.zone_steepness
    # K_t u - K_t width - (K_v - k width) v - k u v
    terms = np.column_stack([u, -np.ones(len(u)), -v, -u * v])[:, : 4 if p.pulsed_fade > 0.0 else 3]
    K_t, offset, slope, *fades = _round_figures(np.linalg.lstsq(terms[pulls], force[pulls])[0])
    width, k = offset / K_t, fades[0] if fades else 0.0
    figures = {"K_t": K_t, "width": width, "K_v": slope + k * width, **({"k": k} if fades else {})}
    figures = dict(zip(figures, _round_figures(list(figures.values())), strict=True))
    above = u - figures["width"]
    line = (figures["K_t"] - k * v) * above - figures["K_v"] * v
    return LawFit(figures, force, np.where(above > 0.0, line, 0.0))


def fit_rolling_drag(p: Plant) -> LawFit:
    """Fit c tanh(v/0.05) + R_1 v + R_2 v² to the drag (N) of a car that rolls straight on."""
    v = np.linspace(SLOWEST_MPS, FASTEST_MPS, 120)
    drag = p.rear_rolling_coulomb * np.tanh(v / p.dry_speed) + np.array([rolling_resistance(s, p) for s in v])

    def law(c: Floats) -> Floats:
        return np.asarray(c[0] * np.tanh(v / DRY_MPS) + c[1] * v + c[2] * v * v)

    return _fit_law(("c", "R_1", "R_2"), law, drag, [p.rear_rolling_coulomb, p.rolling_drag, p.rolling_drag_2])


def fit_tyres(p: Plant) -> LawFit:
    """Fit (1 - s) clip(C α, F) + s F tanh(C α/F), one s for both axles, to the tyres' side forces (N)."""
    slip = np.linspace(0.0, LARGEST_SLIP_RAD, 80)
    axles = (p.front_stiffness, p.front_grip, p.front_magic), (p.rear_stiffness, p.rear_grip, p.rear_magic)
    force = [magic_side_force(C * a, F, shape, p.magic_curvature) for C, F, shape in axles for a in slip]

    def law(c: Floats) -> Floats:
        soft = min(max(c[4], 0.0), 1.0)
        sides = [
            (1.0 - soft) * np.minimum(C * slip, F) + soft * F * np.tanh(C * slip / F)
            for C, F in ((c[0], c[2]), (c[1], c[3]))
        ]
        return np.concatenate(sides)

    first = [p.front_stiffness, p.rear_stiffness, p.front_grip, p.rear_grip, 0.8]
    fit = _fit_law(("C_f", "C_r", "F_f_max", "F_r_max", "s"), law, np.array(force), first)
    return fit._replace(figures={**fit.figures, "s": min(max(fit.figures["s"], 0.0), 1.0)})


def fit_linkage(p: Plant) -> LawFit:
    """Fit (δ + k δ³)(1 + a sign δ) + o to the wheel's angle (rad) over the servo's range."""
    servo = np.linspace(-p.angle_limit, p.angle_limit, 161)
    angle = np.array([two_sided_angle(x, p.linkage_centre, p.left_reach, p.right_reach) for x in servo])

    def law(c: Floats) -> Floats:
        return np.asarray((servo + c[1] * servo**3) * (1.0 + c[0] * np.sign(servo)) + c[2])

    side = 0.1 if p.left_reach > p.right_reach else -0.1
    return _fit_law(("a", "k", "o"), law, angle, [side, -1.0, -p.linkage_centre])


def fit_servo(p: Plant) -> LawFit:
    """Fit a first-order lag T_s after a delay tau to the turn of a servo of second order at a step of its command."""
    t, turn = _step_response(p)

    def law(c: Floats) -> Floats:
        return np.asarray(1.0 - np.exp(-np.maximum(t - c[1], 0.0) / c[0]))

    return _fit_law(("T_s", "tau"), law, turn, [0.7 * p.servo_time, 0.3 * p.servo_time])


def fit_servo_of_two_lags(p: Plant) -> LawFit:
    """Fit two equal lags after a delay to that turn: what a servo of second order has beyond one of first order.

    The second lag, of the time constant `lag`, is the steering_lag of the vocabulary.
    """
    t, turn = _step_response(p)

    def law(c: Floats) -> Floats:
        since = np.maximum(t - c[1], 0.0) / c[0]
        return np.asarray(1.0 - (1.0 + since) * np.exp(-since))

    return _fit_law(("lag", "tau"), law, turn, [0.5 * p.servo_time, 0.1 * p.servo_time])


def _step_response(p: Plant) -> tuple[Floats, Floats]:
    """Times (s) after a step of its command, and the turn by then of a servo of second order, as a share."""
    t = np.linspace(0.0, 8.0 * p.servo_time, 400)
    decay = 2.0 * p.servo_damping / p.servo_time
    # a damping of just 1 is the limit of those below
    damping = min(p.servo_damping, 1.0 - 1e-6)
    ring, lean = decay * np.sqrt(1.0 - damping**2), damping / np.sqrt(1.0 - damping**2)
    return t, 1.0 - np.exp(-damping * decay * t) * (np.cos(ring * t) + lean * np.sin(ring * t))


def fit_steered_drag(p: Plant) -> LawFit:
    """Fit k |δ| v, and c |δ| tanh(v/0.05) where the vocabulary has that, to the drag (N) of a steered wheel."""
    reach = min(p.left_reach, p.right_reach)
    turned, v = (grid.ravel() for grid in np.meshgrid(np.linspace(0.02, reach, 15), np.linspace(0.1, FASTEST_MPS, 30)))
    drag = [dry_steered_drag(a, b, p.dry_steered_drag, p.dry_steered_rise) for a, b in zip(turned, v, strict=True)]
    laws = {"steering_drag": turned * v, "steering_friction": turned * np.tanh(v / DRY_MPS)}

    def law(c: Floats) -> Floats:
        return np.asarray(sum(size * laws[name] for size, name in zip(c, STEERED_DRAGS, strict=True)))

    return _fit_law(STEERED_DRAGS, law, np.array(drag), len(STEERED_DRAGS) * [p.dry_steered_drag])


@lru_cache(maxsize=256)
def nearest_figures(plant: Plant) -> Figures:
    """The figures of the vocabulary's laws that come nearest to those of a `plant` with laws of other formulas.

    Inertia, brake and motor lag are the plant's own.
    """
    motor, drag, tyres, linkage, servo = (
        fit(plant).figures for fit in (fit_motor, fit_rolling_drag, fit_tyres, fit_linkage, fit_servo)
    )
    parameters = {
        "I_z": plant.inertia, "T_s": servo["T_s"], "K_t": motor["K_t"], "K_v": motor["K_v"], "K_b": plant.brake_gain,
        **{symbol: tyres[symbol] for symbol in ("C_f", "C_r", "F_f_max", "F_r_max")},
        "R_1": drag["R_1"], "R_2": drag["R_2"],
    }  # fmt: skip
    effects = {
        "motor_dead_zone": {"width": motor["width"]}, "motor_lag": {"tau": plant.motor_lag},
        "rear_rolling_coulomb": {"c": drag["c"]}, "tyre_soft_saturation": {"s": tyres["s"]},
        "steering_side_gain": {"a": linkage["a"]}, "steering_nonlinearity": {"k": linkage["k"]},
        "steering_offset": {"o": linkage["o"]}, "steering_delay": {"tau": servo["tau"]},
    }  # fmt: skip
    if "k" in motor:
        effects["motor_fade"] = {"k": motor["k"]}
    if plant.dry_steered_drag > 0.0:
        steered = fit_steered_drag(plant).figures
        effects |= {name: {EFFECTS[name].parameters[0].symbol: size} for name, size in steered.items()}
    return Figures(parameters, effects)
