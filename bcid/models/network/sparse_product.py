"""y += x W by rows of W, with the sums in vector registers.

A compiled loop over the columns of W reads and writes y once per row; here so many columns at a time stay in
registers while the rows of what is not zero go by, found from a mask of x.  The vectors are LLVM's own, of whatever
width the machine has: numba has no word for them, hence the intermediate code written out.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.errors import TypingError
from numba.extending import intrinsic

from bcid.aliases import Singles
from bcid.compiled.njit import njit_inline

LANES = 16  # of a vector
MASKED = 64  # elements of x that are looked at together
_SINGLE, _INT, _BIT, _INDEX = ir.FloatType(), ir.IntType(64), ir.IntType(1), ir.IntType(32)
_VECTOR, _WIDE = ir.VectorType(_SINGLE, LANES), ir.VectorType(_SINGLE, MASKED)
_NO_VECTOR = _VECTOR(ir.Undefined)


def _build_row_adder(vectors: int) -> Any:
    """Build a compiled `add(x, W, y, first)` that adds x W to y in `vectors` times 16 columns, from column `first` on.

    x (n,), W (n, m) and y (m,) are of single precision; the sums stay in registers, and rows of W whose x is zero are
    mostly skipped.
    """

    @intrinsic
    def add(typing: Any, x: Any, W: Any, y: Any, first: Any) -> Any:
        if not all(isinstance(a, types.Array) and (a.dtype, a.layout) == (types.float32, "C") for a in (x, W, y)):
            raise TypingError("rows are added of contiguous arrays of single precision only")

        def code(context: Any, builder: Any, signature: Any, given: Any) -> Any:
            arrays = [context.make_array(signature.args[i])(context, builder, given[i]) for i in range(3)]
            (px, pW, py), (n, m) = (a.data for a in arrays), cgutils.unpack_tuple(builder, arrays[1].shape, 2)
            columns = [builder.add(given[3], _INT(LANES * k)) for k in range(vectors)]
            sums = [cgutils.alloca_once_value(builder, _load_vector(builder, py, at)) for at in columns]

            def add_row(i: Any) -> None:
                first_x = builder.insert_element(_NO_VECTOR, builder.load(builder.gep(px, [i])), _INDEX(0))
                all_x = builder.shuffle_vector(first_x, _NO_VECTOR, ir.VectorType(_INDEX, LANES)([0] * LANES))
                for total, at in zip(sums, columns, strict=True):
                    w = _load_vector(builder, pW, builder.add(builder.mul(i, m), at))
                    product = builder.fmul(all_x, w, flags=["contract"])
                    builder.store(builder.fadd(builder.load(total), product, flags=["contract"]), total)

            masked = builder.mul(builder.udiv(n, _INT(MASKED)), _INT(MASKED))
            with cgutils.for_range_slice(builder, _INT(0), masked, _INT(MASKED), _INT) as (base, _):
                mask = builder.fcmp_unordered("!=", _load_vector(builder, px, base, _WIDE), _WIDE(None))
                with _loop_over_set_bits(builder, builder.bitcast(mask, _INT)) as bit:
                    add_row(builder.add(base, bit))
            with cgutils.for_range_slice(builder, masked, n, _INT(1), _INT) as (i, _):
                add_row(i)
            for total, at in zip(sums, columns, strict=True):
                pointer = builder.bitcast(builder.gep(py, [at]), _VECTOR.as_pointer())
                builder.store(builder.load(total), pointer).align = 4
            return context.get_dummy_value()

        return types.void(x, W, y, first), code

    return add


def _load_vector(builder: Any, data: Any, at: Any, kind: Any = _VECTOR) -> Any:
    """Emit LLVM code that loads a vector of the LLVM type `kind` (default 16 singles) at element `at` of `data`."""
    loaded = builder.load(builder.bitcast(builder.gep(data, [at]), kind.as_pointer()))
    loaded.align = 4
    return loaded


@contextmanager
def _loop_over_set_bits(builder: Any, mask: Any) -> Iterator[Any]:
    """Emit an LLVM loop over the positions of the ones in a 64-bit `mask`, lowest first, as a context manager.

    The code emitted in the `with` block is the loop's body; the position is what the block is given.
    """
    left = cgutils.alloca_once_value(builder, mask)
    kind = ir.FunctionType(_INT, [_INT, _BIT])
    trailing_zeros = cgutils.get_or_insert_function(builder.module, kind, "llvm.cttz.i64")
    more, body, end = (builder.append_basic_block(name) for name in ("more", "body", "end"))
    builder.branch(more)
    builder.position_at_end(more)
    now = builder.load(left)
    builder.cbranch(builder.icmp_unsigned("!=", now, _INT(0)), body, end)
    builder.position_at_end(body)
    builder.store(builder.and_(now, builder.sub(now, _INT(1))), left)
    yield builder.call(trailing_zeros, [now, _BIT(1)])
    builder.branch(more)
    builder.position_at_end(end)


_WIDTHS = (8 * LANES, 4 * LANES)
_add_widest, _add_wide = (_build_row_adder(width // LANES) for width in _WIDTHS)


@njit_inline
def add_product(x: Singles, W: Singles, y: Singles) -> None:
    """Add x W to y in place, with x (n,), W (n, m), y (m,) contiguous; rows of W whose x is zero are mostly skipped.

    Raises:
        ValueError: the shapes do not fit.
    """
    widest, wide = _WIDTHS
    m, first = len(y), 0
    if W.shape[0] != len(x) or W.shape[1] != m:
        raise ValueError("x W is of other shapes")
    for _ in range(m // widest):
        _add_widest(x, W, y, first)
        first += widest
    for _ in range((m - first) // wide):
        _add_wide(x, W, y, first)
        first += wide
    if first < m:
        for i in range(len(x)):
            if x[i] != 0.0:
                for j in range(first, m):
                    y[j] += x[i] * W[i, j]
