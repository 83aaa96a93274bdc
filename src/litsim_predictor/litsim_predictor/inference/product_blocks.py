"""Products and sums that numba cannot express: multiplied and added at once, and summed in registers.

A product is added to a sum by one operation, which rounds once (FMA). Blocks of products of matrices keep their sums
in the processor's registers: written out in Python, each sum is loaded and stored again for every few of its terms, and
many short loops begin and end. Every sum has one order, independent of the block it is in.
"""

from __future__ import annotations

from typing import Any

from llvmlite import binding, ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

BLOCK_ROWS = 4
LANES = 16 if binding.get_host_cpu_features().get("avx512f") else 8
"""Columns that one register holds; a block is one or two registers wide."""

_FLOAT, _INDEX = ir.FloatType(), ir.IntType(64)
_LANES = ir.VectorType(_FLOAT, LANES)
_EVERY_LANE = ir.Constant(ir.VectorType(ir.IntType(32), LANES), None)  # is the first one of a register


@intrinsic  # type: ignore[untyped-decorator]
def multiply_add(_typing: Any, a: Any, b: Any, c: Any) -> tuple[Any, Any]:
    """Return a b + c of single precision, rounded once."""
    return types.float32(a, b, c), lambda _context, builder, _signature, given: builder.fma(*given)


def _adds_block(rows: int, registers: int) -> Any:
    """An intrinsic that adds the product of `values` (m, k) and `weight` (k, n) to a block of `out` (m, n).

    The block has `rows` rows from `i` on, and `registers` times LANES columns from `j` on.
    """

    @intrinsic  # type: ignore[untyped-decorator]
    def add_block(_typing: Any, values: Any, weight: Any, out: Any, i: Any, j: Any) -> tuple[Any, Any]:
        return types.void(values, weight, out, i, j), generate

    def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        values, weight, out = (
            context.make_array(kind)(context, builder, value)
            for kind, value in zip(signature.args[:3], given[:3], strict=True)
        )
        kind = ir.FunctionType(_LANES, [_LANES] * 3)
        fused = cgutils.get_or_insert_function(builder.module, kind, f"llvm.fma.v{LANES}f32")  # a b + c
        (_, inner), (_, columns) = (cgutils.unpack_tuple(builder, matrix.shape) for matrix in (values, out))
        down = [builder.add(given[3], ir.Constant(_INDEX, row)) for row in range(rows)]
        along = [builder.add(given[4], ir.Constant(_INDEX, LANES * register)) for register in range(registers)]

        def place(array: Any, row: Any, width: Any, column: Any, kind: Any = _LANES) -> Any:
            cell = builder.gep(array.data, [builder.add(builder.mul(row, width), column)])
            return builder.bitcast(cell, kind.as_pointer())

        places = [[place(out, row, columns, column) for column in along] for row in down]
        sums = [
            [cgutils.alloca_once_value(builder, builder.load(pointer, align=4)) for pointer in row] for row in places
        ]
        with cgutils.for_range(builder, inner) as loop:
            weights = [builder.load(place(weight, loop.index, columns, column), align=4) for column in along]
            for row, of_row in zip(down, sums, strict=True):
                value = builder.load(place(values, row, inner, loop.index, _FLOAT))
                first = builder.insert_element(ir.Constant(_LANES, ir.Undefined), value, ir.Constant(ir.IntType(32), 0))
                everywhere = builder.shuffle_vector(first, first, _EVERY_LANE)
                for total, factor in zip(of_row, weights, strict=True):
                    builder.store(builder.call(fused, [everywhere, factor, builder.load(total)]), total)
        for at_row, of_row in zip(places, sums, strict=True):
            for pointer, total in zip(at_row, of_row, strict=True):
                builder.store(builder.load(total), pointer, align=4)
        return context.get_dummy_value()

    return add_block


add_block, add_narrow_block = _adds_block(BLOCK_ROWS, 2), _adds_block(BLOCK_ROWS, 1)
add_row_block, add_narrow_row_block = _adds_block(1, 2), _adds_block(1, 1)
