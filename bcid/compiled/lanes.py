"""Vectors of numbers: `Lanes`, LANES doubles on which compiled functions compute as on one number.

An equation written once for one number (with `where` in place of a branch on a number) is also one for LANES of them,
such as the states of as many segments, and takes about as long for all as for one: the machine's vector registers
hold them.  The compiler finds such vectors by itself in plain loops only; a car with forty effects, each of which may
be off, is none.  The vectors are LLVM's own, hence the intermediate code written out.
"""

# mypy: disable-error-code="untyped-decorator,no-untyped-call"
# numba's decorators and types have none

import math
import operator
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.typeconv.castgraph import Conversion
from numba.extending import intrinsic, lower_cast, models, overload, register_jitable, register_model

LANES = 8
_DOUBLE, _BIT, INDEX = ir.DoubleType(), ir.IntType(1), ir.IntType(32)
VECTOR, _BITS = ir.VectorType(_DOUBLE, LANES), ir.VectorType(_BIT, LANES)
numba_intrinsic: Any = intrinsic  # numba's own types know nothing of these
numba_overload: Any = overload
OPTIONS: Any = {"forceinline": True, "error_model": "numpy", "no_cfunc_wrapper": True}
_overload: Any = partial(numba_overload, jit_options=OPTIONS)


class LanesType(types.Type):
    """The type of LANES doubles; a single number becomes as many of itself."""

    def __init__(self) -> None:
        super().__init__("Lanes")

    def can_convert_from(self, _typing: Any, other: Any) -> Any:
        """Say that a single number converts safely."""
        return Conversion.safe if isinstance(other, types.Float | types.Integer) else None

    def unify(self, _typing: Any, other: Any) -> Any:
        """Lanes, where a branch gives a single number."""
        return self if isinstance(other, types.Float | types.Integer) else None


class _Mask(types.Type):
    """The type of LANES truth values."""

    def __init__(self) -> None:
        super().__init__("Mask")


lanes, _mask = LanesType(), _Mask()
# stored as LLVM vectors of doubles and of bits
register_model(LanesType)(partial(models.PrimitiveModel, be_type=VECTOR))
register_model(_Mask)(partial(models.PrimitiveModel, be_type=_BITS))


def _broadcast(context: Any, builder: Any, kind: Any, _to: Any, value: Any) -> Any:
    """Emit LLVM code for numba's cast of a number of type `kind` to a vector: the number as a double, LANES times."""
    x = context.cast(builder, value, kind, types.float64)
    one = builder.insert_element(VECTOR(ir.Undefined), x, INDEX(0))
    return builder.shuffle_vector(one, VECTOR(ir.Undefined), ir.VectorType(INDEX, LANES)([0] * LANES))


for _kind in (types.Float, types.Integer):
    lower_cast(_kind, LanesType)(_broadcast)


def _intrinsic_of_arity(typed: Any, arity: int) -> Any:
    """Numba intrinsic of `arity` (1 to 3) arguments from `typed(typing, *arguments)`: numba takes no starred ones."""
    one, two, three = (
        lambda typing, a: typed(typing, a),  # noqa: PLW0108
        lambda typing, a, b: typed(typing, a, b),  # noqa: PLW0108
        lambda typing, a, b, c: typed(typing, a, b, c),  # noqa: PLW0108
    )
    return numba_intrinsic((one, two, three)[arity - 1])


def _make_operation(result: Any, operands: tuple[Any, ...], code: Callable[..., Any]) -> Any:
    """A numba intrinsic from the types `operands` to the type `result`; `code` emits its LLVM instructions."""

    def typed(_typing: Any, *_given: Any) -> Any:
        return result(*operands), lambda _context, builder, _signature, given: code(builder, *given)

    return _intrinsic_of_arity(typed, len(operands))


def _call_vector_function(name: str) -> Callable[..., Any]:
    """Emitter of LLVM code that applies LLVM's own vector function `name`, such as "floor", to vectors of doubles."""

    def code(builder: Any, *given: Any) -> Any:
        kind = ir.FunctionType(VECTOR, [VECTOR] * len(given))
        function = cgutils.get_or_insert_function(builder.module, kind, f"llvm.{name}.v{LANES}f64")
        return builder.call(function, given)

    return code


def _compare(relation: str) -> Callable[..., Any]:
    """Emitter of LLVM code that compares two vectors of doubles, number by number, by `relation`, such as "<".

    As for single numbers, NaN is unequal to everything and in no other relation.
    """
    return lambda builder, a, b: (builder.fcmp_unordered if relation == "!=" else builder.fcmp_ordered)(relation, a, b)


_one, _two = (lanes,), (lanes, lanes)
_select = _make_operation(lanes, (_mask, lanes, lanes), lambda builder, c, a, b: builder.select(c, a, b))
_any = _make_operation(
    types.boolean, (_mask,),
    lambda builder, m: builder.icmp_unsigned("!=", builder.bitcast(m, ir.IntType(LANES)), ir.IntType(LANES)(0)),
)  # fmt: skip
_floor, _abs, _sqrt = (_make_operation(lanes, _one, _call_vector_function(name)) for name in ("floor", "fabs", "sqrt"))


def _has_lanes(*kinds: Any) -> bool:
    """Whether any of the numba types `kinds` is a vector of LANES doubles or a vector of LANES truth values (mask)."""
    return any(isinstance(kind, LanesType | _Mask) for kind in kinds)


def _overload_for_lanes(function: Any, implementation: Any, arity: int, for_number: Any = None) -> None:
    """Let compiled code call `implementation` for `function` where arguments are vectors of LANES doubles or masks.

    `arity` is the number of arguments; of three, the first alone decides.  For single numbers compiled code calls
    `for_number`, or what numba itself has for `function`.
    """
    # written out for numba, which compares names and annotations of the two
    call: Any = (
        lambda a: implementation(a),  # noqa: PLW0108
        lambda a, b: implementation(a, b),  # noqa: PLW0108
        lambda a, b, c: implementation(a, b, c),  # noqa: PLW0108
    )[arity - 1]
    choose: Any = (
        lambda a: call if _has_lanes(a) else for_number,
        lambda a, b: call if _has_lanes(a, b) else for_number,
        lambda a, b, c: call if _has_lanes(a) else for_number,
    )[arity - 1]
    _overload(function)(choose)


for _functions, _code in {
    (operator.add, operator.iadd): lambda builder, a, b: builder.fadd(a, b),
    (operator.sub, operator.isub): lambda builder, a, b: builder.fsub(a, b),
    (operator.mul, operator.imul): lambda builder, a, b: builder.fmul(a, b),
    (operator.truediv, operator.itruediv): lambda builder, a, b: builder.fdiv(a, b),
}.items():
    for _function in _functions:
        _overload_for_lanes(_function, _make_operation(lanes, _two, _code), 2)
for _function, _relation in {
    operator.lt: "<", operator.le: "<=", operator.gt: ">", operator.ge: ">=", operator.eq: "==", operator.ne: "!=",
}.items():  # fmt: skip
    _overload_for_lanes(_function, _make_operation(_mask, _two, _compare(_relation)), 2)
_overload_for_lanes(operator.neg, _make_operation(lanes, _one, lambda builder, a: builder.fneg(a)), 1)
_overload_for_lanes(abs, _abs, 1)
_overload_for_lanes(math.sqrt, _sqrt, 1)
_overload_for_lanes(math.copysign, _make_operation(lanes, _two, _call_vector_function("copysign")), 2)
_overload_for_lanes(operator.or_, _make_operation(_mask, (_mask, _mask), lambda builder, a, b: builder.or_(a, b)), 2)
_overload_for_lanes(operator.and_, _make_operation(_mask, (_mask, _mask), lambda builder, a, b: builder.and_(a, b)), 2)


def where(condition: bool, a: float, b: float) -> float:
    """`a` where the condition holds, else `b`; on vectors number by number.  Both are computed: there is no branch."""
    return a if condition else b


def any_lane(condition: bool) -> bool:
    """Whether the condition holds for any number of a vector (lane); a single truth value is returned as it is."""
    return condition


def floor(x: float) -> float:
    """The largest whole number not above x, as a float; on vectors number by number."""
    return float(np.floor(x))


def multiply_add(a: float, b: float, c: float) -> float:
    """A b + c, rounded once where the machine can; on vectors, if `a` is one, number by number."""
    return a * b + c


def _call_multiply_add(_typing: Any, *numbers: Any) -> Any:
    """Numba's type and emitter of LLVM's fused product and sum, in single precision where all `numbers` are of it."""
    kind = types.float32 if all(number is types.float32 for number in numbers) else types.float64

    def code(_context: Any, builder: Any, _signature: Any, given: Any) -> Any:
        typed = ir.FunctionType(given[0].type, [given[0].type] * 3)
        name = "llvm.fmuladd.f32" if kind is types.float32 else "llvm.fmuladd.f64"
        return builder.call(cgutils.get_or_insert_function(builder.module, typed, name), given)

    return kind(kind, kind, kind), code


_overload_for_lanes(where, _select, 3, lambda a, b, c: b if a else c)
_overload_for_lanes(any_lane, _any, 1, lambda a: a)
_overload_for_lanes(floor, _floor, 1, lambda a: np.floor(a))  # noqa: PLW0108
_multiply_add_lanes = _make_operation(lanes, (lanes,) * 3, _call_vector_function("fmuladd"))
_multiply_add = _intrinsic_of_arity(_call_multiply_add, 3)

# any of its three arguments may be a vector
_overload(multiply_add)(
    lambda a, b, c: (
        (lambda a, b, c: _multiply_add_lanes(a, b, c))  # noqa: PLW0108
        if _has_lanes(a, b, c)
        else (lambda a, b, c: _multiply_add(a, b, c))  # noqa: PLW0108
    )
)
# as with Python's own, `a` where either is NaN
_inlined: Any = register_jitable(forceinline=True, error_model="numpy")
_overload_for_lanes(min, _inlined(lambda a, b: where(b < a, b, a)), 2)
_overload_for_lanes(max, _inlined(lambda a, b: where(b > a, b, a)), 2)


def _call_per_lane(function: Any, arity: int) -> Any:
    """Numba intrinsic on vectors that calls the C library's `function` of `arity` arguments number by number."""

    def typed(typing: Any, *_given: Any) -> Any:
        kind = typing.resolve_value_type(function)
        signature = kind.get_call_type(typing, (types.float64,) * arity, {})

        def code(context: Any, builder: Any, _signature: Any, given: Any) -> Any:
            call, out = context.get_function(kind, signature), VECTOR(ir.Undefined)
            for i in map(INDEX, range(LANES)):
                out = builder.insert_element(out, call(builder, [builder.extract_element(v, i) for v in given]), i)
            return out

        return lanes(*(lanes,) * arity), code

    return _intrinsic_of_arity(typed, arity)


_overload_for_lanes(math.tanh, _call_per_lane(math.tanh, 1), 1)
_overload_for_lanes(math.exp, _call_per_lane(math.exp, 1), 1)
_overload_for_lanes(math.hypot, _call_per_lane(math.hypot, 2), 2)
