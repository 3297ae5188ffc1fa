"""The drag of two fitted cars at one speed, at which alone they can be compared.

A fit states R_1 and R_v = R_1 + R_2 v at the top speed V of its own takes, so that the R_v of one car in two fits
differ by R_2 times the difference of these speeds.  At a lower speed v, with a = v / V,

    R_v(v) = (1 - a) R_1 + a R_v(V),

whose error follows from those of both and their correlation.  A correlation that a fit does not state is at most
LIMITS.min_correlation, for which the error is the largest.
"""

import math

from bcid.evaluation.parameter_differences import KnownConstant
from bcid.models.limits import LIMITS
from bcid.models.newton_euler.model import NewtonEuler
from bcid.models.newton_euler.parameters import drag_per_speed, values_of_constants


def drag_at_lower_speed(one: NewtonEuler, other: NewtonEuler) -> tuple[tuple[KnownConstant, KnownConstant] | None, str]:
    """R_v of two cars, both of whose fits state it, at the lower of their top speeds; and a note of what was done.

    None where a fit does not say how sure R_v is at that speed.  The note is empty where both top speeds are the same.
    """
    speeds = [float(model.facts.get("top_speed_mps", 0.0)) for model in (one, other)]
    speed = min(speeds)
    first, second = drag_at_speed(one, speed), drag_at_speed(other, speed)
    note = "" if speeds[0] == speeds[1] else f"R_v was fitted at {speeds[0]:.2f} and at {speeds[1]:.2f} m/s, and is "
    if first is None or second is None:
        return None, f"{note}not compared: the fits do not say how sure it is at another speed"
    return (first, second), note and f"{note}compared at {speed:.2f} m/s"


def drag_at_speed(model: NewtonEuler, speed: float) -> KnownConstant | None:
    """R_v of a fitted car at a `speed` (m/s) of at most its takes' top speed, with its error; None if that is unknown.

    It is where the takes do not show R_1, or the top speed is not known.
    """
    facts, values = model.facts, values_of_constants(model.car, model.facts)
    about, top_speed = facts["fitted"], float(facts.get("top_speed_mps", 0.0))
    se = {s: about[s]["relative_se"] * abs(values[s]) for s in ("R_1", "R_v") if about.get(s, {}).get("relative_se")}
    if speed == top_speed and "R_v" in se:
        return KnownConstant(values["R_v"], se["R_v"], about["R_v"]["unit"])
    if len(se) < 2 or "R_1" in facts.get("at_bound", ()) or not speed > 0.0:
        return None
    stated = {frozenset(pair): rho for *pair, rho in facts.get("correlated", ())}
    rho = stated.get(frozenset(se), LIMITS.min_correlation)
    a = speed / top_speed
    low, high = (1.0 - a) * se["R_1"], a * se["R_v"]
    error = math.sqrt(low**2 + high**2 + 2.0 * rho * low * high)
    return KnownConstant(drag_per_speed(model.car, speed), error, about["R_v"]["unit"])
