"""Whether a law of the user's is one: what every effect of the vocabulary fulfils, asked on many states.

Off it changes nothing; on it acts, and the less the smaller its size; it is finite; in other units of mass, length and
time it is the same law, as its declared units say; it runs on vectors of numbers as on one.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np
from numba.core.errors import NumbaError

from bcid.aliases import Floats, Switches
from bcid.compiled.lane_access import load_lanes, store_lanes
from bcid.compiled.lanes import LANES
from bcid.compiled.njit import njit
from bcid.effects.entry import VehicleScale
from bcid.effects.own import QUANTITIES, OwnEffect
from bcid.effects.own_laws import (
    LAWS,
    MOTOR,
    STEERING,
    OwnInputs,
    add_own_pushes,
    mark_of,
    own_motor_force,
    own_wheel_angle,
)
from bcid.effects.table import effect_switches, further_effects

RESULT_UNITS = {"fx": "kg m s^-2", "fy": "kg m s^-2", "mz": "kg m^2 s^-2", "steering": "rad", "motor": "kg m s^-2"}
"""Unit of what a law returns, by channel; those of "any" are the first three's."""

STATES = 1000
"""States at which a law is tried."""

LARGEST = {
    "p_x": 4.0, "p_y": 4.0, "theta": math.pi, "v_x": 3.0, "v_y": 1.0, "omega": 3.0, "delta": 0.6, "delta_rate": 3.0,
    "u_m": 2.0, "F_m": 50.0, "v_w": 3.0,
}  # fmt: skip
"""Largest sizes of the quantities there, of either sign."""

WIDER, OF_A_WIDER_RANGE = 10.0, ("p_x", "p_y", "v_x", "v_y", "u_m", "v_w")
"""At every other state these are larger by the factor, as in a hall, or of a fast car."""

# s, length of the recording there, and kg, greatest mass
LENGTH_S, LARGEST_MASS = 100.0, 300.0
# a law whose amplitude is this small a share of its size must make less than the second share of its difference
TINY_SHARE, TINY_EFFECT = 1e-6, 1e-2
SAME = 1e-9  # relative difference of two results that are the same but for rounding
LANE_FUNCTIONS = "+ - * /, comparisons, & |, abs, min, max, math.sqrt, exp, tanh, hypot, copysign, sincos, floor, where"


# --- on states ----------------------------------------------------------------------------------------------------


def _draw_states(rng: np.random.Generator) -> list[dict[str, float]]:
    """STATES values of every quantity of QUANTITIES."""
    drawn = {name: rng.uniform(-high, high, STATES) for name, high in LARGEST.items()}
    for name in OF_A_WIDER_RANGE:
        drawn[name][1::2] *= WIDER
    drawn |= {"t": rng.uniform(0.0, LENGTH_S, STATES), "T": np.full(STATES, LENGTH_S)}
    drawn["m"] = rng.uniform(0.01, 1.0, STATES) * LARGEST_MASS
    return [{name: float(values[k]) for name, values in drawn.items()} for k in range(STATES)]


def _typical(effect: OwnEffect) -> dict[str, float]:
    """Every parameter and constant of an effect at its size; its place near the middle, its time half way."""
    middle = {"x": 0.3, "y": -0.2, "t_s": 0.5 * LENGTH_S}
    values = {p.symbol: middle.get(p.symbol, p.size) if p.is_place else p.size for p in effect.parameters}
    return values | {c.symbol: float(c.value) for c in effect.constants}


def _evaluate(effect: OwnEffect, state: Mapping[str, float], values: Mapping[str, float]) -> Floats:
    """What a law returns at a state, as an array (1,), or (3,) where its channel is "any".

    Raises:
        TypeError: it is no number, or not three.
    """
    given = {**state, **values}
    result = effect.plain_law(*(given[name] for name in effect.arguments))
    numbers = result if effect.channel == "any" else (result,)
    if not isinstance(numbers, tuple) or len(numbers) != (3 if effect.channel == "any" else 1):
        raise TypeError("a law of any returns three numbers (F_x, F_y, M_z)")
    if not all(isinstance(x, int | float | np.floating) for x in numbers):
        raise TypeError(f"a law of {effect.channel} returns a number, not {type(numbers[0]).__name__}")
    return np.array(numbers, dtype=float)


def wrong_on_states(effect: OwnEffect) -> Iterator[str]:
    """What a law does wrong on many states, by plain Python."""
    states, typical = _draw_states(np.random.default_rng(0)), _typical(effect)
    off = {p.symbol: 0.0 for p in effect.amplitude_parameters}
    start = np.array([_output_without_effect(effect, state) for state in states])

    def difference(values: Mapping[str, float]) -> Floats:
        """What the law changes at all states, (STATES, 1 or 3), at these values."""
        changes: Floats = np.array([_evaluate(effect, state, {**typical, **values}) for state in states]) - start
        return changes

    bounds = [{p.symbol: value} for p in effect.amplitude_parameters for value in (p.low, p.high, 0.5 * p.size)]
    for values in ({}, off, *bounds):
        if not np.isfinite(difference(values)).all():
            at = ", ".join(f"{s} = {v:g}" for s, v in {**typical, **values}.items())
            yield f"its law returns a number that is not finite at {at}"
            return
    if (difference(off) != 0.0).any():
        yield "its law changes something where its parameters are zero; it must change nothing, to the last bit"
        return
    for p in effect.amplitude_parameters:
        alone = np.abs(difference({**off, p.symbol: p.size})).max()
        tiny = np.abs(difference({**off, p.symbol: TINY_SHARE * p.size})).max()
        if alone == 0.0:
            yield (
                f"parameter {p.symbol} alone, at its size, changes nothing at any of {STATES} states: let it be a "
                "constant where it only shapes the law, or give a size that acts"
            )
        elif tiny > TINY_EFFECT * alone:
            yield f"its law does not fade as {p.symbol} goes to zero: it jumps"
    yield from _wrong_beyond_its_place(effect, states, difference({}))
    yield from _wrong_units(effect, states, typical)


def _output_without_effect(effect: OwnEffect, state: Mapping[str, float]) -> list[float]:
    """What a law returns at a state where the effect is off."""
    if effect.channel in STEERING:
        return [state["delta"]]
    return [state["F_m"]] if effect.channel in MOTOR else [0.0] * (3 if effect.channel == "any" else 1)


def _wrong_beyond_its_place(
    effect: OwnEffect, states: Sequence[Mapping[str, float]], change: Floats
) -> Iterator[str]:  # fmt: skip
    """Whether a law acts outside of its circle, or before its time, where a diagnosis does not look."""
    symbols, at = {p.symbol for p in effect.place_parameters}, _typical(effect)
    acts = (change != 0.0).any(axis=1)
    if "t_s" in symbols and acts[[s["t"] < at["t_s"] for s in states]].any():
        yield "it acts before its time t_s"
    if "radius" in symbols:
        outside = [math.hypot(s["p_x"] - at["x"], s["p_y"] - at["y"]) > at["radius"] for s in states]
        if acts[outside].any():
            yield "it acts outside of its circle: farther than radius from (x, y)"


def _wrong_units(
    effect: OwnEffect, states: Sequence[Mapping[str, float]], values: Mapping[str, float]
) -> Iterator[str]:  # fmt: skip
    """Whether the law is another one in other units of mass, length and time, as no law of physics is."""
    kg, m, s = np.exp(np.random.default_rng(1).uniform(0.3, 0.9, 3)).tolist()
    scale = VehicleScale(kg, m, s)
    declared = {p.symbol: p.unit for p in effect.parameters} | {c.symbol: c.unit for c in effect.constants}
    in_other = {symbol: value * scale.factor_of(declared[symbol]) for symbol, value in values.items()}
    channels = ("fx", "fy", "mz") if effect.channel == "any" else (effect.channel,)
    factors = np.array([scale.factor_of(RESULT_UNITS[channel]) for channel in channels])
    wanted = np.array([_evaluate(effect, state, values) for state in states]) * factors

    def is_same(throttle_unit: str) -> bool:
        units = {name: q.unit for name, q in QUANTITIES.items()} | {"u_m": throttle_unit}
        given = [{name: x * scale.factor_of(units[name]) for name, x in state.items()} for state in states]
        found = np.array([_evaluate(effect, state, in_other) for state in given])
        return bool(np.abs(found - wanted).max() <= SAME * np.abs(wanted).max())

    # a throttle is a speed of one vehicle and a share of another's full force
    if not (is_same("m s^-1") or is_same("1")):
        yield (
            "its units do not fit: with kg, m and s rescaled it is another law; see to the declared units, and let "
            "every number in the law that has one be a parameter or a constant"
        )


# --- compiled -----------------------------------------------------------------------------------------------------


@njit
def _results_in_lanes(out: Floats, given: Floats, m: float, e: Switches) -> None:
    """Write what the user's laws in `e` make of LANES states at once to `out` (5, LANES): a push, an angle, a force.

    `given` (14 LANES,) holds the states by quantity, one after the other; the mass `m` (kg) is the same of all.
    """
    s = OwnInputs(
        load_lanes(given, 0), load_lanes(given, LANES), load_lanes(given, 2 * LANES), load_lanes(given, 3 * LANES),
        load_lanes(given, 4 * LANES), load_lanes(given, 5 * LANES), load_lanes(given, 6 * LANES),
        load_lanes(given, 7 * LANES), load_lanes(given, 8 * LANES), load_lanes(given, 9 * LANES),
        load_lanes(given, 10 * LANES), m, load_lanes(given, 12 * LANES), load_lanes(given, 13 * LANES),
    )  # fmt: skip
    none, flat = 0.0 * s.v_x, out.reshape(out.size)
    F_x, F_y, M_z = add_own_pushes((none, none, none), s, e)
    store_lanes(F_x, flat, 0)
    store_lanes(F_y, flat, LANES)
    store_lanes(M_z, flat, 2 * LANES)
    store_lanes(own_wheel_angle(s.delta, s, e), flat, 3 * LANES)
    store_lanes(own_motor_force(s.F_m, s, e), flat, 4 * LANES)


@njit
def _results_of_one(out: Floats, s: OwnInputs, e: Switches) -> None:
    """Write what the user's laws in `e` make of the state `s` to `out` (5,): a push, an angle and a force."""
    out[0], out[1], out[2] = add_own_pushes((0.0, 0.0, 0.0), s, e)
    out[3], out[4] = own_wheel_angle(s.delta, s, e), own_motor_force(s.F_m, s, e)


def wrong_in_compiled_code(effect: OwnEffect, digest: str) -> Iterator[str]:
    """Whether a law cannot be compiled, on single numbers and on vectors, or gives other numbers then."""
    mark = f"{mark_of(digest)}_{effect.id}"
    LAWS[mark] = (effect.as_own_law(),)
    typical = _typical(effect)
    states = _draw_states(np.random.default_rng(2))[:LANES]
    states = [{**state, "T": LENGTH_S, "m": 0.5 * LARGEST_MASS} for state in states]
    with further_effects([effect], mark):
        e = effect_switches({f: typical[p.symbol] for f, p in zip(effect.fields, effect.parameters, strict=True)})
        inputs = [OwnInputs(**state) for state in states]
        plain = np.array([_results_in_python(s, e) for s in inputs])
        one, many = np.empty((LANES, 5)), np.empty((5, LANES))
        given = np.array(inputs).T.ravel()

        def run_one() -> None:
            for row, s in zip(one, inputs, strict=True):
                _results_of_one(row, s, e)

        for run, how in (
            (run_one, "on single numbers"),
            (lambda: _results_in_lanes(many, given, inputs[0].m, e), "on vectors"),
        ):
            if cause := _cause_of_failure(run):
                yield f"its law cannot be compiled {how}: {cause}"
                return
    close = SAME * np.abs(plain).max()
    if not (np.allclose(one, plain, SAME, close) and np.allclose(many.T, plain, SAME, close)):
        yield "its law gives other numbers where it is compiled"


def _results_in_python(s: OwnInputs, e: Switches) -> list[float]:
    """What the user's laws in `e` make of the state `s`, by plain Python: a push, an angle and a force."""
    return [*add_own_pushes((0.0, 0.0, 0.0), s, e), own_wheel_angle(s.delta, s, e), own_motor_force(s.F_m, s, e)]


def _cause_of_failure(run: Callable[[], None]) -> str:
    """Why numba cannot compile what `run` calls, in words; nothing where it can."""
    try:
        run()
    except NumbaError as error:
        text = str(error)
        if "Mask" in text and "bool" in text:
            return "it branches on a quantity; write where(condition, a, b), in which both are computed"
        if plain := re.findall(r"Untyped global name '(\w+)'", text):
            return f"it names {plain[-1]}, which is not compiled; put @compiled over a function"
        if missing := re.findall(r"Function\(<built-in function (\w+)>\)", text):
            return f"{missing[-1]} is not known there, but {LANE_FUNCTIONS} are"
        lines = [line.strip() for line in text.splitlines() if line.strip()]
        return next((line for line in lines if "rror" in line or "not" in line), lines[0])
    return ""
