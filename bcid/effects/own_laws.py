"""How laws that are not in the package get into the compiled car: by the type of the record of switches.

A compiled function is made for the types of its arguments, and the type of the switches (`bcid.effects.table`) is the
list of their fields.  Where a user's effects are in use, the record has one field more, the mark, whose name holds the
digest of the user's file.  A function here looks for the mark while the compiler asks for its code: without one it
hands back what it was given, which is no code at all, so that the car without such laws is the car to the last bit and
no slower; with one its code calls the laws that are registered under that mark, on numbers and on vectors of them.
Machine code on disk is kept under the types of arguments, hence under the digest of the user's file.

The plain functions do the same on numbers, and on nodes where a model is exported.
"""

# mypy: disable-error-code="untyped-decorator,no-untyped-call"
# numba's decorators and types have none

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numba

from bcid.aliases import Switches
from bcid.compiled.lanes import OPTIONS, numba_overload

MARK = "own_laws_"
"""How the name of a field of the switches begins that stands for the laws of one file."""

MAX_DIGEST = 24
"""Hex digits of the file's digest in the mark: 96 bits."""


class OwnInputs(NamedTuple):
    """What a law of the user's may depend on, at the body's state; a law names those that it takes."""

    t: float  # s since the recording began
    T: float  # its length, s
    p_x: float  # place of the CoG in the world, m
    p_y: float
    theta: float  # heading, rad
    v_x: float  # velocity in the body frame, m/s
    v_y: float
    omega: float  # yaw rate, rad/s
    delta: float  # steering angle, rad
    delta_rate: float  # and its rate, rad/s
    u_m: float  # throttle
    m: float  # mass, kg
    F_m: float  # motor force (N) and speed (m/s) of the driven wheel
    v_w: float


class Argument(NamedTuple):
    """Where one argument of a law is read: a quantity of `OwnInputs`, a field of the switches, or a constant."""

    quantity: str = ""
    field: str = ""
    constant: float = 0.0


class OwnLaw(NamedTuple):
    """A compiled law of the user's, and what calls it."""

    function: Any
    channel: str
    arguments: tuple[Argument, ...]
    amplitudes: tuple[str, ...]  # fields that are all zero where the effect is off

    @property
    def varies_with_pose(self) -> bool:
        """Whether the law depends on the place or the heading."""
        return any(a.quantity in POSE for a in self.arguments)


POSE = ("p_x", "p_y", "theta")
PUSHES, STEERING, MOTOR = ("fx", "fy", "mz", "any"), ("steering",), ("motor",)
"""Channels of laws that add a force or moment to the body, and of those that change the wheel's angle, and the motor's
force."""

LAWS: dict[str, tuple[OwnLaw, ...]] = {}
"""The laws that the compiler knows in this process, by mark."""


def mark_of(digest: str) -> str:
    """The field of the switches that stands for the laws of the file with this SHA-256."""
    return MARK + digest[:MAX_DIGEST]


def add_push(push: Any, channel: str, force: Any) -> Any:
    """The push (F_x, F_y, M_z) (N, N, N m) and what a law of the `channel` returns: a number, of "any" all three."""
    x, y, z = push
    match channel:
        case "fx":
            return x + force, y, z
        case "fy":
            return x, y + force, z
        case "mz":
            return x, y, z + force
    return x + force[0], y + force[1], z + force[2]


def call_law(law: OwnLaw, values: Sequence[Any]) -> Any:
    """What a law returns for the `values` of its arguments, by plain Python."""
    return getattr(law.function, "py_func", law.function)(*values)


def _laws_of(fields: Sequence[str], channels: Sequence[str]) -> tuple[OwnLaw, ...]:
    """The laws that act in one of the `channels`, of the marks among the `fields` of a record."""
    marks = [field for field in fields if field.startswith(MARK)]
    return tuple(law for mark in marks for law in LAWS[mark] if law.channel in channels)


def _field_names(e: Switches) -> Sequence[str]:
    """Names of the switches in a record of numpy, or in the attributes of any other object."""
    return e.dtype.names if hasattr(e, "dtype") else tuple(vars(e))


def _plain_values(law: OwnLaw, s: OwnInputs, e: Switches) -> list[Any]:
    """Values of a law's arguments at the inputs `s`, its parameters from the switches `e`."""
    return [
        getattr(s, a.quantity) if a.quantity else (getattr(e, a.field) if a.field else a.constant)
        for a in law.arguments
    ]


def _active_laws(e: Switches, channels: Sequence[str]) -> list[OwnLaw]:
    """The laws in `channels` of which an amplitude is not zero in the switches `e`."""
    laws = _laws_of(_field_names(e), channels)
    return [law for law in laws if any(getattr(e, field) != 0.0 for field in law.amplitudes)]


def add_own_pushes(push: Any, s: OwnInputs, e: Switches) -> Any:
    """The push (F_x, F_y, M_z) (N, N, N m) on the body, and what the user's laws in `e` add at the inputs `s`."""
    for law in _active_laws(e, PUSHES):
        push = add_push(push, law.channel, call_law(law, _plain_values(law, s, e)))
    return push


def own_wheel_angle(delta: float, s: OwnInputs, e: Switches) -> float:
    """Angle (rad) of the steered wheel that the user's laws in `e` make of `delta`, one after the other."""
    for law in _active_laws(e, STEERING):
        delta = call_law(law, _plain_values(law, s._replace(delta=delta), e))
    return delta


def own_motor_force(F_m: float, s: OwnInputs, e: Switches) -> float:
    """Motor force (N) that the user's laws in `e` make of `F_m`, one after the other."""
    for law in _active_laws(e, MOTOR):
        F_m = call_law(law, _plain_values(law, s._replace(F_m=F_m), e))
    return F_m


def own_pushes_vary_with_pose(e: Switches) -> bool:
    """Whether a law of the user's that is on in `e` pushes the body by its place or heading."""
    return any(law.varies_with_pose for law in _active_laws(e, PUSHES))


# --- the same in compiled code ------------------------------------------------------------------------------------

_numba_njit: Any = numba.njit  # whose options are not all declared
_inlined: Any = _numba_njit(**OPTIONS, no_cpython_wrapper=True)


def _reader(argument: Argument) -> Any:
    """Compiled function of inputs and switches that returns one argument of a law."""
    if argument.quantity:
        place = OwnInputs._fields.index(argument.quantity)
        return _inlined(lambda s, e: s[place])
    if argument.field:
        field = argument.field
        return _inlined(lambda s, e: e[field])
    value = argument.constant
    return _inlined(lambda s, e: value)


def _reader_of_all(arguments: Sequence[Argument]) -> Any:
    """Compiled function of inputs and switches that returns all arguments of a law as a tuple."""
    if not arguments:
        return _inlined(lambda s, e: ())
    first, others = _reader(arguments[0]), _reader_of_all(arguments[1:])
    return _inlined(lambda s, e: (first(s, e), *others(s, e)))


def _is_on(amplitudes: Sequence[str]) -> Any:
    """Compiled function of the switches: whether one of the fields `amplitudes` is not zero."""
    if not amplitudes:
        return _inlined(lambda e: False)
    field, others = amplitudes[0], _is_on(amplitudes[1:])
    return _inlined(lambda e: e[field] != 0.0 or others(e))


def _adder(channel: str) -> Any:
    """Compiled function that adds to a push (F_x, F_y, M_z), of which the law has the `channel`."""
    return {
        "fx": _inlined(lambda push, force: (push[0] + force, push[1], push[2])),
        "fy": _inlined(lambda push, force: (push[0], push[1] + force, push[2])),
        "mz": _inlined(lambda push, force: (push[0], push[1], push[2] + force)),
        "any": _inlined(lambda push, force: (push[0] + force[0], push[1] + force[1], push[2] + force[2])),
    }[channel]


def _pushes_of(laws: Sequence[OwnLaw]) -> Any:
    """Compiled function of a push, inputs and switches that returns the push with those of all `laws`."""
    if not laws:
        return _inlined(lambda push, s, e: push)
    law, others = laws[0], _pushes_of(laws[1:])
    function, arguments = law.function, _reader_of_all(law.arguments)
    is_on, add = _is_on(law.amplitudes), _adder(law.channel)

    @_inlined
    def add_all(push: Any, s: Any, e: Any) -> Any:
        if is_on(e):
            push = add(push, function(*arguments(s, e)))
        return others(push, s, e)

    return add_all


def _changes_of(laws: Sequence[OwnLaw], quantity: str) -> Any:
    """Compiled function of a number, inputs and switches that returns what all `laws` make of it, a `quantity`."""
    if not laws:
        return _inlined(lambda number, s, e: number)
    law, others, present = laws[0], _changes_of(laws[1:], quantity), _replace_input(quantity)
    function, arguments, is_on = law.function, _reader_of_all(law.arguments), _is_on(law.amplitudes)

    @_inlined
    def change_all(number: Any, s: Any, e: Any) -> Any:
        if is_on(e):
            number = function(*arguments(present(s, number), e))
        return others(number, s, e)

    return change_all


def _replace_input(quantity: str) -> Any:
    """Compiled function of inputs and a number that returns the inputs with the number as their `quantity`."""
    if quantity == "delta":
        return _inlined(lambda s, x: OwnInputs(
            s.t, s.T, s.p_x, s.p_y, s.theta, s.v_x, s.v_y, s.omega, x, s.delta_rate, s.u_m, s.m, s.F_m, s.v_w
        ))  # fmt: skip
    return _inlined(lambda s, x: OwnInputs(
        s.t, s.T, s.p_x, s.p_y, s.theta, s.v_x, s.v_y, s.omega, s.delta, s.delta_rate, s.u_m, s.m, x, s.v_w
    ))  # fmt: skip


def _compile_for(plain: Callable[..., Any], channels: Sequence[str], build: Callable[..., Any]) -> None:
    """Let compiled code that calls `plain` call what `build` makes of the laws in `channels` of the switches' type."""

    def choose(start: Any, s: Any, e: Any) -> Any:
        laws = _laws_of(tuple(e.fields), channels)
        if not laws:
            return lambda start, s, e: start
        code = build(laws)
        return lambda start, s, e: code(start, s, e)  # noqa: PLW0108  # numba wants a plain function

    # names of arguments may differ from those of the plain function
    numba_overload(plain, jit_options=OPTIONS, strict=False)(choose)


_compile_for(add_own_pushes, PUSHES, _pushes_of)
_compile_for(own_wheel_angle, STEERING, lambda laws: _changes_of(laws, "delta"))
_compile_for(own_motor_force, MOTOR, lambda laws: _changes_of(laws, "F_m"))


@numba_overload(own_pushes_vary_with_pose, jit_options=OPTIONS, strict=False)
def _choose_varies(e: Any) -> Any:
    """The code of `own_pushes_vary_with_pose` for the type of the switches."""
    laws = [law for law in _laws_of(tuple(e.fields), PUSHES) if law.varies_with_pose]
    is_on = _is_on([field for law in laws for field in law.amplitudes])
    return lambda e: is_on(e)  # noqa: PLW0108  # numba wants the argument's name
