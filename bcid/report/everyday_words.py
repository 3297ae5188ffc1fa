"""How large a finding is in everyday words: "the steering has 1.7° of play to either side".

One rule by units turns SI numbers into what people say: radians are degrees, fractions of a second milliseconds, shares
percent, fractions of a metre centimetres.  One phrase per effect says what the number is of; where that is a force that
grows with the speed, or an angle that grows with a force, the phrase names the speed or force, and `Size.times` and
`Size.unit` multiply by it.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import degrees, hypot, inf, isfinite, radians

from bcid.documents.diagnosis import NamedEffect, Quantity
from bcid.effects.entry import unit_in_words
from bcid.report.formats import format_with_error

GRAVITY = 9.81
"""m/s^2, with which a floor's slope is told from the acceleration that it makes."""

HOUR_S = 3600.0


@dataclass(frozen=True)
class Size:
    """A number in a phrase, made of an effect's parameters."""

    symbols: tuple[str, ...]  # of which several are the components of a vector, whose length it is
    times: float = 1.0  # what they are multiplied by
    unit: str | None = None  # of the product, as powers such as "kg m s^-2"; None for the parameter's own
    sides: tuple[str, str] = ("", "")  # words after a positive, and after a negative number


@dataclass(frozen=True)
class Phrase:
    """What the size of an effect means, with the names of sizes, or symbols of parameters, in braces."""

    text: str
    negative: str | None = None  # where the first of the effect's parameters is below zero; None if that is not told
    sizes: Mapping[str, Size] = field(default_factory=dict)  # those that are not just a parameter


def _at(symbol: str, times: float, unit: str) -> dict[str, Size]:
    """The size called `symbol` of the parameter of that symbol, multiplied by so many `times` what leads to `unit`."""
    return {symbol: Size((symbol,), times, unit)}


_FORCE, _MOMENT = "kg m s^-2", "kg m^2 s^-2"

PHRASES: dict[str, Phrase] = {
    "rear_rolling_coulomb": Phrase("the rear wheels brake with {c}, however slowly they roll"),
    "rear_rolling_viscous": Phrase("the rear wheels brake with {b} at 1 m/s", sizes=_at("b", 1.0, _FORCE)),
    "front_coulomb_friction": Phrase("the front wheel brakes with {c}, however slowly it rolls"),
    "quadratic_drag": Phrase(
        "a drag of {k} at 1 m/s brakes the car, four times as much at twice the speed", sizes=_at("k", 1.0, _FORCE)
    ),
    "rear_drag_asymmetry": Phrase(
        "the left rear wheel drags with {b} at 1 m/s", "the right rear wheel drags with {b} at 1 m/s",
        _at("b", 1.0, _FORCE),
    ),
    "steering_drag": Phrase(
        "turned by 10°, the steered wheel drags with {k} at 1 m/s", sizes=_at("k", radians(10.0), _FORCE)
    ),
    "steering_friction": Phrase(
        "turned by 10°, the steered wheel rubs with {c} at any speed", sizes=_at("c", radians(10.0), _FORCE)
    ),
    "rough_patch": Phrase(
        "a floor that brakes with {b} at 1 m/s, within {radius} of its centre", sizes=_at("b", 1.0, _FORCE)
    ),
    "floor_slope": Phrase(
        "a floor that falls by {fall} on each metre, which is {tilt}",
        sizes={"fall": Size(("g_x", "g_y"), 1.0 / GRAVITY, "m"), "tilt": Size(("g_x", "g_y"), 1.0 / GRAVITY, "rad")},
    ),
    "tether_pull": Phrase(
        "a cable that pulls with {k} for each 10 cm beyond its slack of {r_0}", sizes=_at("k", 0.1, _FORCE)
    ),
    "yaw_scrub": Phrase(
        "turning by 90° in a second is braked with {c}", sizes=_at("c", radians(90.0), _MOMENT)
    ),
    "yaw_coulomb": Phrase("turning is braked with {c}, however slow it is"),
    "drive_lateral_offset": Phrase(
        "the driven wheel pulls {a} to the right of the middle", "the driven wheel pulls {a} to the left of the middle"
    ),
    "tyre_relaxation": Phrase("the front tyre has to roll {sigma} before most of its side force is there"),
    "friction_circle": Phrase(
        "pulling costs the front tyre {kappa} of the side grip that a round circle of friction would cost it"
    ),
    "tyre_soft_saturation": Phrase("the tyres give way softly: {s} of the way from a sharp limit to a smooth one"),
    "load_transfer": Phrase(
        "each 1 m/s² of acceleration takes {k} of the front tyre’s grip",
        "each 1 m/s² of acceleration gives the front tyre {k} more grip", _at("k", 1.0, "1"),
    ),
    "front_ply_steer": Phrase(
        "the front wheel pulls to the left with {f} where it rolls straight",
        "the front wheel pulls to the right with {f} where it rolls straight",
    ),
    "rear_toe": Phrase("the rear wheels point {epsilon} away from straight ahead"),
    "slippery_patch": Phrase("a floor with {D} less grip, within {radius} of its centre"),
    "motor_delay": Phrase("the motor follows its command {tau} late"),
    "motor_lag": Phrase("the motor needs {tau} for two thirds of a change of its force"),
    "motor_dead_zone": Phrase("the first {width} of the throttle do nothing"),
    "motor_sag": Phrase(
        "the motor pulls {s} less at the end of the drive than at its beginning",
        "the motor pulls {s} more at the end of the drive than at its beginning",
    ),
    "motor_power_limit": Phrase("the motor gives no more than {P}"),
    "motor_regeneration": Phrase("letting the throttle go brakes with {r} of the force with which it pulls"),
    "steering_offset": Phrase(
        "the wheel stands {o} to the left where it should stand straight",
        "the wheel stands {o} to the right where it should stand straight",
    ),
    "steering_backlash": Phrase("the steering has {b} of play to either side"),
    "steering_dead_band": Phrase("the steering ignores commands that differ by less than {b} from where it stands"),
    "steering_delay": Phrase("the wheel follows its command {tau} late"),
    "steering_lag": Phrase("the wheel needs {tau} more for two thirds of a change of its angle"),
    "steering_nonlinearity": Phrase(
        "at 30° of steering the wheel turns {k} more than it should",
        "at 30° of steering the wheel turns {k} less than it should", _at("k", radians(30.0) ** 3, "rad"),
    ),
    "steering_side_gain": Phrase(
        "the wheel turns {a} farther than it should to the left, and as much less to the right",
        "the wheel turns {a} less than it should to the left, and as much farther to the right",
    ),
    "steering_speed_gain": Phrase(
        "the wheel turns {k} less for each 1 m/s of speed", "the wheel turns {k} more for each 1 m/s of speed",
        _at("k", 1.0, "1"),
    ),
    "steering_rate_asymmetry": Phrase(
        "the servo turns {a} faster to the left than it should, and as much slower to the right",
        "the servo turns {a} slower to the left than it should, and as much faster to the right",
    ),
    "steering_compliance": Phrase(
        "100 N of side force turn the wheel by {k} along with it",
        "100 N of side force turn the wheel by {k} against it", _at("k", 100.0, "rad"),
    ),
    "mass_change": Phrase("from {t_s} on the car is {d} heavier", "from {t_s} on the car is {d} lighter"),
    "pose_latency": Phrase("poses come {tau} late", "poses come {tau} early"),
    "clock_drift": Phrase(
        "the clock of the poses gains {rho} in an hour on that of the commands",
        "the clock of the poses loses {rho} in an hour to that of the commands", _at("rho", HOUR_S, "s"),
    ),
    "marker_offset": Phrase(
        "the tracked point lies {x} and {y} the centre of gravity",
        sizes={
            "x": Size(("d_x",), sides=("ahead", "behind")),
            "y": Size(("d_y",), sides=("to the left of", "to the right of")),
        },
    ),
    "body_yaw_misalignment": Phrase(
        "the tracked body is turned by {psi} to the left of the car",
        "the tracked body is turned by {psi} to the right of the car",
    ),
    "pose_scale": Phrase("distances are measured {kappa} too long", "distances are measured {kappa} too short"),
}  # fmt: skip
"""What the size of each effect of the vocabulary means."""


def size_in_words(finding: NamedEffect) -> str:
    """How large a finding is, in everyday words; empty where its effect has no phrase, or a number of it is missing.

    >>> play = NamedEffect(effect="steering_backlash", parameters={"b": Quantity(value=0.0299, se=0.0008, unit="rad")})
    >>> size_in_words(play)
    'the steering has 1.71 ± 0.05° of play to either side'
    """
    phrase = PHRASES.get(finding.effect)
    if phrase is None:
        return ""
    numbers = {s: q for s, q in finding.parameters.items() if q.value is not None and isfinite(q.value)}
    sizes = {symbol: Size((symbol,)) for symbol in numbers} | dict(phrase.sizes)
    words = {name: _size_text(s, numbers) for name, s in sizes.items() if all(k in numbers for k in s.symbols)}
    first = next(iter(numbers.values()), Quantity())
    text = phrase.negative if phrase.negative and (first.value or 0.0) < 0.0 else phrase.text
    try:
        return text.format_map(words)
    except KeyError:
        return ""


def _size_text(size: Size, numbers: Mapping[str, Quantity]) -> str:
    """The absolute value of a size with its standard error, in everyday units, and the side that its sign says."""
    parts = [numbers[symbol] for symbol in size.symbols]
    values = [q.value or 0.0 for q in parts]
    length = hypot(*values)
    # to first order, of a vector as well, whose components' errors count as independent
    slopes = [v / length if length else 1.0 for v in values]
    errors = [q.se for q in parts if q.se is not None]
    se = hypot(*(s * e for s, e in zip(slopes, errors, strict=True))) if len(errors) == len(parts) else None
    unit = unit_in_words(size.unit) if size.unit else parts[0].unit
    text = in_everyday_units(length * size.times, None if se is None else se * size.times, unit)
    return f"{text} {size.sides[values[0] < 0.0]}".rstrip()


def in_everyday_units(value: float, se: float | None, unit: str) -> str:
    """A value ± its standard error in the units that people say.

    `unit` is as documents hold it: in words ("N s/m"), or as powers.

    >>> in_everyday_units(0.06, 0.004, "s"), in_everyday_units(0.2, 0.01, "1"), in_everyday_units(0.02, None, "m")
    ('60 ± 4 ms', '20.0 ± 1.0 %', '2.00 cm')
    """
    factor, words = {
        "rad": (degrees(1.0), "°"), "1": (100.0, " %"), "–": (100.0, " %"), "": (100.0, " %"),
        "s": (1e3, " ms") if abs(value) < 1.0 else (1.0, " s"),
        "m": (100.0, " cm") if abs(value) < 1.0 else (1.0, " m"),
    }.get(unit, (1.0, f" {unit}"))  # fmt: skip
    known = se is not None and 0.0 < se < inf
    return format_with_error(value * factor, se * factor if se is not None and known else None) + words
