"""Numbers, quantities and units as text for pages and terminal."""

import sys
from collections.abc import Sequence
from math import floor, inf, isfinite, log10

from bcid.effects.entry import unit_in_words

VARIABLES = {
    "v_x": ("forward speed", "m/s"), "v_y": ("side speed", "m/s"), "speed": ("speed", "m/s"),
    "yaw_rate": ("yaw rate", "rad/s"), "steering": ("steering angle", "rad"),
    "steering_rate": ("steering rate", "rad/s"), "throttle": ("throttle", "m/s"), "braking": ("braking", "share"),
    "alpha_f": ("front slip angle", "rad"), "alpha_r": ("rear slip angle", "rad"), "heading": ("heading", "rad"),
}  # fmt: skip
"""Names and units of the quantities on which a mismatch may depend."""

SPAN_NAMES = {
    "v_x": "forward speed", "v_y": "side speed", "yaw_rate": "yaw rate", "v_x yaw_rate": "speed times yaw rate",
    "u_s": "steering command", "u_m": "throttle command",
}  # fmt: skip
"""What a card calls the quantities of which it says how far the data go."""

GREEK = {
    "tau": "τ", "sigma": "σ", "kappa": "κ", "epsilon": "ε", "rho": "ρ", "psi": "ψ", "inverse_P": "1/P",
}  # fmt: skip

_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def join_words(words: Sequence[str], last: str = "and") -> str:
    """The words as a list in a sentence, with the conjunction `last` before the last of them.

    >>> join_words(["a", "b", "c"]), join_words(["a", "b"], "or"), join_words(["a"])
    ('a, b and c', 'a or b', 'a')
    """
    return f"{', '.join(words[:-1])} {last} {words[-1]}" if len(words) > 1 else "".join(words)


def plain_name(name: str) -> str:
    """The identifier of an effect or of a quantity as words, with underscores and "+" replaced.

    >>> plain_name("steering_delay+motor_delay"), plain_name("v_x")
    ('steering delay with motor delay', 'forward speed')
    """
    return VARIABLES[name][0] if name in VARIABLES else name.replace("_", " ").replace("+", " with ")


def symbol_text(name: str) -> str:
    """A parameter's symbol as the equation writes it: τ for "tau", 1/P for "inverse_P"; any other as it is."""
    return GREEK.get(name, name)


def unit_text(text: str | None) -> str:
    """A unit in powers of kg, m and s as an engineer writes it; empty for a number without unit, any other as it is.

    >>> unit_text("kg s^-1"), unit_text("kg m^4"), unit_text("m^x")
    ('N s/m', 'kg m⁴', 'm^x')
    """
    try:
        words = unit_in_words(text or "1")
    except ValueError:  # no powers
        return text or ""
    return "" if words == "–" else words


def format_number(value: float | None, digits: int = 3) -> str:
    """A number to `digits` significant digits, a dash where there is none.

    >>> format_number(1234.5), format_number(0.04567, 2), format_number(2.1e-5, 2), format_number(None)
    ('1230', '0.046', '2.1 × 10⁻⁵', '–')
    """
    if value is None or not isfinite(value):
        return "–"
    mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
    power = int(exponent)
    if not -4 < power < 5:
        return f"{with_minus_sign(mantissa)} × 10{str(power).translate(_SUPERSCRIPTS)}"
    return format_rounded(value, digits - 1 - power)


def format_rounded(value: float, places: int) -> str:
    """A number as text, rounded to `places` decimals, or to tens or hundreds where `places` is -1 or -2."""
    return with_minus_sign(f"{round(value, places):.{max(places, 0)}f}")


def with_minus_sign(text: str) -> str:
    """The text with every hyphen replaced by a minus sign (U+2212)."""
    return text.replace("-", "−")


def format_with_error(value: float | None, se: float | None, unit: str | None = None) -> str:
    """A value ± its standard error `se` with its unit, both rounded to the error's first digit (two if it is 1).

    >>> format_with_error(0.0603, 0.0041, "m s^-1"), format_with_error(3594.0, 118.0), format_with_error(3.51e-5, 2e-6)
    ('0.060 ± 0.004 m/s', '3590 ± 120', '(3.5 ± 0.2) × 10⁻⁵')
    """
    after = f" {unit_text(unit)}".rstrip()
    # an error that is all but zero has no digits to round to
    if value is None or se is None or not (sys.float_info.min <= se < inf and isfinite(value)):
        return f"{format_number(value)}{after if value is not None else ''}"
    power = floor(log10(max(abs(value), se)))
    if not -4 < power < 5:
        inner = format_with_error(value / 10.0**power, se / 10.0**power)
        return f"({inner}) × 10{str(power).translate(_SUPERSCRIPTS)}{after}"
    lead = floor(log10(se))
    places = -lead + (1 if se / 10.0**lead < 1.95 else 0)
    return f"{format_rounded(value, places)} ± {format_rounded(se, places)}{after}"


def format_with_percent(value: float | None, se: float | None, unit: str | None = None) -> str:
    """A value ± its standard error with its unit, and in brackets that error in percent of the value.

    There are no brackets where that says nothing: where the error is as large as the value, or the value is a share.

    >>> format_with_percent(3594.0, 118.0, "N/rad"), format_with_percent(0.02, 0.03, "m")
    ('3590 ± 120 N/rad (3 %)', '0.02 ± 0.03 m')
    """
    text = format_with_error(value, se, unit)
    if not (unit_text(unit) and value and se and isfinite(value) and 0.0 < se < abs(value)):
        return text
    share = 100.0 * se / abs(value)
    return f"{text} ({f'{share:.0f}' if share >= 0.95 else f'{share:.1g}'} %)"


def format_p_value(p: float | None) -> str:
    """A p-value as text such as "p = 0.43", empty where there is none.

    >>> format_p_value(0.0004), format_p_value(0.43), format_p_value(None)
    ('p < 0.001', 'p = 0.43', '')
    """
    if p is None:
        return ""
    return "p < 0.001" if p < 0.001 else f"p = {p:.2g}"


def format_change(ratio: float | None) -> str:
    """The ratio of a value after to the value before, as a change in percent.

    >>> format_change(0.34), format_change(1.2), format_change(1.0), format_change(None)
    ('−66 %', '+20 %', '0 %', '–')
    """
    if ratio is None:
        return "–"
    return with_minus_sign(f"{100.0 * (ratio - 1.0):+.0f} %").replace("+0 ", "0 ").replace("−0 ", "0 ")


def format_thousandths(value: float | None, missing: str = "diverged") -> str:
    """An NMSE in units of 10^-3: two decimals, or two significant digits where it is very small or large.

    >>> format_thousandths(0.005973), format_thousandths(1.2e-5), format_thousandths(250.0), format_thousandths(None)
    ('5.97', '0.012', '2.5e+05', 'diverged')
    """
    if value is None:
        return missing
    if value >= 100.0:
        return f"{1e3 * value:.1e}"
    return f"{1e3 * value:.2g}" if 0.0 < value < 1e-4 else f"{1e3 * value:.{2 if value < 1.0 else 0}f}"
