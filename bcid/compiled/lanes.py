"""Several numbers abreast: `Lanes`, a vector of LANES doubles on which compiled functions compute as on one number.

An equation written once for one number (with `where` in place of a branch on a number) is also one for LANES of them,
such as the states of as many segments, and takes about as long for all as for one: the machine's vector registers
hold them.  The compiler finds such vectors by itself in plain loops only; a car with forty effects, each of which may
be off, is none.  The vectors are LLVM's own, hence the intermediate code written out.
"""

# mypy: disable-error-code="untyped-decorator,no-untyped-call"
# numba's decorators and types have none

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.errors import TypingError
from numba.core.typeconv.castgraph import Conversion
from numba.extending import intrinsic, lower_cast, models, overload, register_jitable, register_model

LANES = 4
_DOUBLE, _BIT, _INDEX = ir.DoubleType(), ir.IntType(1), ir.IntType(32)
_VECTOR, _BITS = ir.VectorType(_DOUBLE, LANES), ir.VectorType(_BIT, LANES)
_intrinsic: Any = intrinsic  # numba's own types know nothing of these
_overload: Any = partial(overload, jit_options={"forceinline": True, "error_model": "numpy"})


class _Lanes(types.Type):
    """LANES doubles; a single number becomes as many of itself."""

    def __init__(self) -> None:
        super().__init__("Lanes")

    def can_convert_from(self, _typing: Any, other: Any) -> Any:
        return Conversion.safe if isinstance(other, types.Float | types.Integer) else None

    def unify(self, _typing: Any, other: Any) -> Any:
        return self if isinstance(other, types.Float | types.Integer) else None


class _Mask(types.Type):
    """As many truths."""

    def __init__(self) -> None:
        super().__init__("Mask")


lanes, _mask = _Lanes(), _Mask()


@register_model(_Lanes)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, manager: Any, of: Any) -> None:
        super().__init__(manager, of, _VECTOR)


@register_model(_Mask)
class _MaskModel(models.PrimitiveModel):
    def __init__(self, manager: Any, of: Any) -> None:
        super().__init__(manager, of, _BITS)


def _spread(context: Any, builder: Any, kind: Any, _to: Any, value: Any) -> Any:
    x = context.cast(builder, value, kind, types.float64)
    one = builder.insert_element(_VECTOR(ir.Undefined), x, _INDEX(0))
    return builder.shuffle_vector(one, _VECTOR(ir.Undefined), ir.VectorType(_INDEX, LANES)([0] * LANES))


for _kind in (types.Float, types.Integer):
    lower_cast(_kind, _Lanes)(_spread)


def _fixed(of: Any, arguments: int) -> Any:
    """The intrinsic `of` any number of arguments with so many: numba wants them written out."""
    one, two, three = (
        lambda typing, a: of(typing, a),  # noqa: PLW0108
        lambda typing, a, b: of(typing, a, b),  # noqa: PLW0108
        lambda typing, a, b, c: of(typing, a, b, c),  # noqa: PLW0108
    )
    return _intrinsic((one, two, three)[arguments - 1])


def _operation(result: Any, wanted: tuple[Any, ...], code: Callable[..., Any]) -> Any:
    """An intrinsic of the `wanted` types, to which its arguments are cast; `code` writes it into a builder."""

    def of(_typing: Any, *_given: Any) -> Any:
        return result(*wanted), lambda _context, builder, _signature, given: code(builder, *given)

    return _fixed(of, len(wanted))


def _called(name: str) -> Callable[..., Any]:
    """Code that calls one of LLVM's own functions of vectors."""

    def code(builder: Any, *given: Any) -> Any:
        kind = ir.FunctionType(_VECTOR, [_VECTOR] * len(given))
        function = cgutils.get_or_insert_function(builder.module, kind, f"llvm.{name}.v{LANES}f64")
        return builder.call(function, given)

    return code


def _compared(how: str) -> Callable[..., Any]:
    return lambda builder, a, b: (builder.fcmp_unordered if how == "!=" else builder.fcmp_ordered)(how, a, b)


_one, _two = (lanes,), (lanes, lanes)
_select = _operation(lanes, (_mask, lanes, lanes), lambda builder, c, a, b: builder.select(c, a, b))
_any = _operation(
    types.boolean, (_mask,),
    lambda builder, m: builder.icmp_unsigned("!=", builder.bitcast(m, ir.IntType(LANES)), ir.IntType(LANES)(0)),
)  # fmt: skip
_floor, _abs, _sqrt = (_operation(lanes, _one, _called(name)) for name in ("floor", "fabs", "sqrt"))
_copysign = _operation(lanes, _two, _called("copysign"))


def _lanes_among(*kinds: Any) -> bool:
    return any(isinstance(kind, _Lanes | _Mask) for kind in kinds)


def _overloads(function: Any, implementation: Any, arguments: int) -> None:
    """`function` of lanes is `implementation`, of one argument or of two of which either may be a single number."""

    def one(a: Any) -> Any:
        return implementation(a)

    def two(a: Any, b: Any) -> Any:
        return implementation(a, b)

    def of_one(a: Any) -> Any:
        return one if _lanes_among(a) else None

    def of_two(a: Any, b: Any) -> Any:
        return two if _lanes_among(a, b) else None

    _overload(function)(of_one if arguments == 1 else of_two)


for _functions, _code in {
    (operator.add, operator.iadd): lambda builder, a, b: builder.fadd(a, b),
    (operator.sub, operator.isub): lambda builder, a, b: builder.fsub(a, b),
    (operator.mul, operator.imul): lambda builder, a, b: builder.fmul(a, b),
    (operator.truediv, operator.itruediv): lambda builder, a, b: builder.fdiv(a, b),
}.items():
    for _function in _functions:
        _overloads(_function, _operation(lanes, _two, _code), 2)
for _function, _how in {
    operator.lt: "<", operator.le: "<=", operator.gt: ">", operator.ge: ">=", operator.eq: "==", operator.ne: "!=",
}.items():  # fmt: skip
    _overloads(_function, _operation(_mask, _two, _compared(_how)), 2)
_overloads(operator.neg, _operation(lanes, _one, lambda builder, a: builder.fneg(a)), 1)
_overloads(abs, _abs, 1)
_overloads(math.sqrt, _sqrt, 1)
_overloads(math.copysign, _copysign, 2)
_overloads(operator.or_, _operation(_mask, (_mask, _mask), lambda builder, a, b: builder.or_(a, b)), 2)
_overloads(operator.and_, _operation(_mask, (_mask, _mask), lambda builder, a, b: builder.and_(a, b)), 2)


def where(condition: bool, a: float, b: float) -> float:
    """`a` where the condition holds, else `b`; both are computed."""
    return a if condition else b


def some(condition: bool) -> bool:
    """Whether it holds in any lane."""
    return condition


def floor(x: float) -> float:
    """The largest whole number not above x, as a float."""
    return float(np.floor(x))


@_overload(where)
def _where(condition: Any, a: Any, b: Any) -> Any:
    def one(condition: Any, a: Any, b: Any) -> Any:
        return a if condition else b

    def each(condition: Any, a: Any, b: Any) -> Any:
        return _select(condition, a, b)

    return each if isinstance(condition, _Mask) else one


@_overload(some)
def _some(condition: Any) -> Any:
    def one(condition: Any) -> Any:
        return condition

    def each(condition: Any) -> Any:
        return _any(condition)

    return each if isinstance(condition, _Mask) else one


@_overload(floor)
def _floored(x: Any) -> Any:
    def one(x: Any) -> Any:
        return np.floor(x)

    def each(x: Any) -> Any:
        return _floor(x)

    return each if isinstance(x, _Lanes) else one


def _smaller(a: Any, b: Any) -> Any:
    return where(b < a, b, a)


def _larger(a: Any, b: Any) -> Any:
    return where(b > a, b, a)


_inlined: Any = register_jitable(forceinline=True, error_model="numpy")
_overloads(min, _inlined(_smaller), 2)
_overloads(max, _inlined(_larger), 2)


@_intrinsic
def lane(_typing: Any, x: Any, i: Any) -> Any:
    """The number in lane `i` of `x`."""
    if not isinstance(x, _Lanes):
        raise TypingError("only lanes have numbers in them")

    def code(_context: Any, builder: Any, _signature: Any, given: Any) -> Any:
        return builder.extract_element(given[0], builder.trunc(given[1], _INDEX))

    return types.float64(lanes, types.int64), code


@_intrinsic
def load(_typing: Any, numbers: Any, at: Any) -> Any:
    """LANES of a contiguous array's `numbers` (n,) from `at` on."""

    def code(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        data = context.make_array(signature.args[0])(context, builder, given[0]).data
        loaded = builder.load(builder.bitcast(builder.gep(data, [given[1]]), _VECTOR.as_pointer()))
        loaded.align = 8
        return loaded

    _check(numbers)
    return lanes(numbers, types.int64), code


@_intrinsic
def store(_typing: Any, x: Any, numbers: Any, at: Any) -> Any:
    """Write `x` to LANES of a contiguous array's `numbers` (n,) from `at` on."""

    def code(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        data = context.make_array(signature.args[1])(context, builder, given[1]).data
        builder.store(given[0], builder.bitcast(builder.gep(data, [given[2]]), _VECTOR.as_pointer())).align = 8
        return context.get_dummy_value()

    _check(numbers)
    return types.void(lanes, numbers, types.int64), code


def _check(numbers: Any) -> None:
    if not (isinstance(numbers, types.Array) and (numbers.dtype, numbers.layout) == (types.float64, "C")):
        raise TypingError("lanes are read from and written to contiguous arrays of doubles only")


def _by_lane(function: Any, arguments: int) -> Any:
    """The C library's `function`, called for one lane after the other."""

    def of(typing: Any, *_given: Any) -> Any:
        kind, alone = typing.resolve_value_type(function), (types.float64,) * arguments
        one = kind.get_call_type(typing, alone, {})

        def code(context: Any, builder: Any, _signature: Any, given: Any) -> Any:
            call, out = context.get_function(kind, one), _VECTOR(ir.Undefined)
            for i in map(_INDEX, range(LANES)):
                out = builder.insert_element(out, call(builder, [builder.extract_element(v, i) for v in given]), i)
            return out

        return lanes(*(lanes,) * arguments), code

    return _fixed(of, arguments)


_overloads(math.tanh, _by_lane(math.tanh, 1), 1)
_overloads(math.exp, _by_lane(math.exp, 1), 1)
_overloads(math.hypot, _by_lane(math.hypot, 2), 2)


@_intrinsic
def gather(_typing: Any, numbers: Any, places: Any, ahead: Any) -> Any:
    """Of a contiguous array's `numbers` (n,) those at `places` (LANES,), each so many further `ahead`."""

    def code(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        data, at = (
            context.make_array(kind)(context, builder, array).data
            for kind, array in zip(signature.args[:2], given[:2], strict=True)
        )
        out = _VECTOR(ir.Undefined)
        for i in range(LANES):
            place = builder.add(builder.load(builder.gep(at, [ir.IntType(64)(i)])), given[2])
            out = builder.insert_element(out, builder.load(builder.gep(data, [place])), _INDEX(i))
        return out

    _check(numbers)
    if not (isinstance(places, types.Array) and (places.dtype, places.layout) == (types.int64, "C")):
        raise TypingError("lanes are picked at places of a contiguous array of int64 only")
    return lanes(numbers, places, types.int64), code
