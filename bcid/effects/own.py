"""What a user's file of effects imports: how an effect of one's own is declared (docs/own_effects.md).

An effect is one function, its law, under the decorator `effect`.  Its arguments are named: each is a quantity of
QUANTITIES, the symbol of one of the effect's parameters, or that of one of its constants.  The law runs compiled, on
single numbers and on vectors of them, and is read as formulas where a model is exported; so it computes with
+ - * /, abs, min, max, `math.sqrt`, `math.exp`, `math.tanh`, `math.hypot`, `math.copysign`, and from here `sincos`,
`floor` and `where`, which stands for a branch on a quantity.  A further function that it calls is `compiled`.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

from bcid.compiled.lanes import floor, where
from bcid.compiled.njit import njit, njit_inline
from bcid.effects.entry import Channel, Effect, Kind, Parameter
from bcid.effects.own_laws import MOTOR, PUSHES, STEERING, Argument, OwnLaw
from bcid.physics.elementary import sincos

__all__ = ["Constant", "Parameter", "compiled", "effect", "floor", "sincos", "where"]

compiled = njit_inline
"""Decorator of a function that laws call."""


class LawQuantity(NamedTuple):
    """What a law may depend on."""

    unit: str
    meaning: str
    channels: tuple[str, ...]  # of laws that may name it
    word: str  # for it, in diagnosis.json


_EVERYWHERE, _ON_BODY = (*PUSHES, *STEERING, *MOTOR), (*PUSHES, *STEERING)
QUANTITIES: dict[str, LawQuantity] = {
    "t": LawQuantity("s", "time since the recording began", _EVERYWHERE, "time"),
    "T": LawQuantity("s", "the recording's length", _EVERYWHERE, "time"),
    "p_x": LawQuantity("m", "place of the centre of gravity in the world", PUSHES, "place"),
    "p_y": LawQuantity("m", "place of the centre of gravity in the world", PUSHES, "place"),
    "theta": LawQuantity("rad", "heading, counter-clockwise", PUSHES, "heading"),
    "v_x": LawQuantity("m s^-1", "velocity ahead", _ON_BODY, "v_x"),
    "v_y": LawQuantity("m s^-1", "velocity to the left", _ON_BODY, "v_y"),
    "omega": LawQuantity("rad s^-1", "yaw rate, counter-clockwise", _ON_BODY, "yaw_rate"),
    "delta": LawQuantity("rad", "steering angle, left positive", _ON_BODY, "steering"),
    "delta_rate": LawQuantity("rad s^-1", "its rate", _ON_BODY, "steering_rate"),
    "u_m": LawQuantity("m s^-1", "throttle: a speed, or a share of full force", (*PUSHES, *MOTOR), "throttle"),
    "m": LawQuantity("kg", "the vehicle's mass", _EVERYWHERE, ""),
    "F_m": LawQuantity("kg m s^-2", "motor force", MOTOR, "throttle"),
    "v_w": LawQuantity("m s^-1", "speed of the driven wheel", MOTOR, "v_x"),
}  # fmt: skip
"""The quantities that a law may name, and the channels in which it may."""


class Constant(NamedTuple):
    """A number of a law that is not fitted, such as the speed at which friction has its full size."""

    symbol: str
    unit: str
    value: float
    meaning: str


@dataclass(frozen=True)
class OwnEffect(Effect):
    """An effect of the user's."""

    constants: tuple[Constant, ...] = ()

    @property
    def arguments(self) -> tuple[str, ...]:
        """Names of the law's arguments, in their order."""
        return tuple(inspect.signature(self.plain_law).parameters)

    @property
    def plain_law(self) -> Callable[..., Any]:
        """The law as plain Python."""
        plain: Callable[..., Any] = getattr(self.law, "py_func", self.law)
        return plain

    def as_own_law(self) -> OwnLaw:
        """The law with where its arguments are read, as the compiled car calls it."""
        symbols = {p.symbol: field for p, field in zip(self.parameters, self.fields, strict=True)}
        constants = {c.symbol: float(c.value) for c in self.constants}
        arguments = tuple(
            Argument(field=symbols[name]) if name in symbols
            else Argument(constant=constants[name]) if name in constants
            else Argument(quantity=name)
            for name in self.arguments
        )  # fmt: skip
        amplitudes = tuple(symbols[p.symbol] for p in self.amplitude_parameters)
        return OwnLaw(self.law, self.channel, arguments, amplitudes)


def effect(
    equation: str, *, channel: Channel, parameters: tuple[Parameter, ...], constants: tuple[Constant, ...] = (),
    kind: Kind = "vehicle", looks_like: tuple[str, ...] = (), source: str = "",
) -> Callable[[Callable[..., Any]], OwnEffect]:  # fmt: skip
    """Decorator that makes of a law an effect of the vocabulary, whose id is the law's name.

    Args:
        equation: the law in print.
        channel: what the law returns: "fx", "fy" (N, body frame) or "mz" (N m), which are added to the force or moment
            on the body; "any", all three as a tuple; "steering", the wheel's angle (rad) instead of `delta`; "motor",
            the motor's force (N) instead of `F_m`.
        parameters: what is fitted, with bounds and sizes for the user's vehicle; zero is off.
        constants: further numbers of the law, with their units.
        kind: "vehicle", or "environment" for what stays behind where the vehicle goes elsewhere.
        looks_like: ids of effects that the recordings may not tell from this one.
        source: where the law comes from.
    """

    def declare(law: Callable[..., Any]) -> OwnEffect:
        named = [QUANTITIES[name].word for name in inspect.signature(law).parameters if name in QUANTITIES]
        words = tuple(word for word in dict.fromkeys(named) if word)
        return OwnEffect(
            njit(law), equation, tuple(parameters), channel, kind, tuple(looks_like), words, source=source,
            suits_one_vehicle=True, constants=tuple(constants),
        )  # fmt: skip

    return declare
