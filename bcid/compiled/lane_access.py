"""Lanes read from and written to arrays: contiguous ones of doubles only."""

# mypy: disable-error-code="untyped-decorator,no-untyped-call"
# numba's decorators and types have none

from typing import Any

from llvmlite import ir
from numba import types
from numba.core.errors import TypingError

from bcid.aliases import Floats
from bcid.compiled.lanes import INDEX, LANES, OPTIONS, VECTOR, LanesType, lanes, numba_intrinsic, numba_overload


def _require_doubles(numbers: Any) -> None:
    """Raise numba's `TypingError` unless the type `numbers` is a contiguous array of doubles."""
    if not (isinstance(numbers, types.Array) and (numbers.dtype, numbers.layout) == (types.float64, "C")):
        raise TypingError("lanes are read from and written to contiguous arrays of doubles only")


@numba_intrinsic
def load_lanes(_typing: Any, numbers: Any, at: Any) -> Any:
    """Numba intrinsic: load `numbers[at : at + LANES]`, of a contiguous array (n,) of doubles, as one vector."""

    def code(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        data = context.make_array(signature.args[0])(context, builder, given[0]).data
        loaded = builder.load(builder.bitcast(builder.gep(data, [given[1]]), VECTOR.as_pointer()))
        loaded.align = 8
        return loaded

    _require_doubles(numbers)
    return lanes(numbers, types.int64), code


@numba_intrinsic
def store_lanes(_typing: Any, x: Any, numbers: Any, at: Any) -> Any:
    """Numba intrinsic: write the vector `x` to `numbers[at : at + LANES]` of a contiguous array (n,) of doubles."""

    def code(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        data = context.make_array(signature.args[1])(context, builder, given[1]).data
        builder.store(given[0], builder.bitcast(builder.gep(data, [given[2]]), VECTOR.as_pointer())).align = 8
        return context.get_dummy_value()

    _require_doubles(numbers)
    return types.void(lanes, numbers, types.int64), code


@numba_intrinsic
def gather_lanes(_typing: Any, numbers: Any, places: Any, ahead: Any) -> Any:
    """Numba intrinsic: the vector of LANES doubles whose number i is `numbers[places[i] + ahead]`.

    `numbers` (n,) are doubles, `places` (LANES,) int64, both contiguous; `ahead` is one offset for all.
    """

    def code(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        data, at = (
            context.make_array(kind)(context, builder, array).data
            for kind, array in zip(signature.args[:2], given[:2], strict=True)
        )
        out = VECTOR(ir.Undefined)
        for i in range(LANES):
            place = builder.add(builder.load(builder.gep(at, [ir.IntType(64)(i)])), given[2])
            out = builder.insert_element(out, builder.load(builder.gep(data, [place])), INDEX(i))
        return out

    _require_doubles(numbers)
    if not (isinstance(places, types.Array) and (places.dtype, places.layout) == (types.int64, "C")):
        raise TypingError("lanes are picked at places of a contiguous array of int64 only")
    return lanes(numbers, places, types.int64), code


def get_like(like: float, numbers: Floats, i: int) -> float:
    """Number `i` of a contiguous array of doubles; vector `i` of LANES of them where `like` is a vector."""
    number: float = numbers[i]
    return number


def put_like(x: float, numbers: Floats, i: int) -> None:
    """Write `x` to place `i` of a contiguous array of doubles, or of vectors of LANES of them where it is a vector."""
    numbers[i] = x


def _put_number(x, numbers, i):  # type: ignore[no-untyped-def]
    """`put_like` of a number, as numba compiles it."""
    numbers[i] = x


# written without annotations for numba, which compares those of the choice and of what is chosen
numba_overload(get_like, jit_options=OPTIONS)(
    lambda like, numbers, i: (
        (lambda like, numbers, i: load_lanes(numbers, i * LANES))
        if isinstance(like, LanesType)
        else (lambda like, numbers, i: numbers[i])
    )
)
numba_overload(put_like, jit_options=OPTIONS)(
    lambda x, numbers, i: (
        (lambda x, numbers, i: store_lanes(x, numbers, i * LANES)) if isinstance(x, LanesType) else _put_number
    )
)
