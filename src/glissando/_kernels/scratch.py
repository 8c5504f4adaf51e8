"""Small arrays of fixed size on the stack, for intermediate results of kernels.

They cost nothing, whereas an array on the heap takes as long as a product of its size, and the
compiler knows that they overlap with no other. Their content is undefined at first unless they are
zeros. They exist until the end of the kernel that makes them, which must not return them.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from math import prod
from typing import Any


class StackArray:
    """Constructor of arrays inside kernels, with dimensions given as literal integers."""

    def __init__(self, rank: int, *, zeros: bool = False) -> None:
        self.rank, self.zeros = rank, zeros

    def __call__(self, *dimensions: int) -> Any:
        raise NotImplementedError("An array on the stack is made inside a compiled kernel alone.")

    @cached_property
    def compiled(self) -> Any:
        """The constructor as an intrinsic of numba."""
        from numba.extending import intrinsic

        typing: Any = {  # numba reads the number of arguments from the signature
            1: lambda context, a: _typed(self.zeros, a),
            2: lambda context, a, b: _typed(self.zeros, a, b),
            3: lambda context, a, b, c: _typed(self.zeros, a, b, c),
        }
        return intrinsic(prefer_literal=True)(typing[self.rank])


def _typed(zeros: bool, *dimensions: Any) -> tuple[Any, Callable[..., Any]] | None:
    """Type of an array of these dimensions and generator of its code; None unless literal."""
    from numba.core import types

    if not all(isinstance(each, types.IntegerLiteral) for each in dimensions):
        return None
    shape = tuple(each.literal_value for each in dimensions)
    array = types.Array(types.float64, len(shape), "C")
    return array(*dimensions), lambda *code: _generate(array, shape, zeros, *code[:2])


def _generate(array: Any, shape: tuple[int, ...], zeros: bool, context: Any, builder: Any) -> Any:
    """An array whose memory is on the stack of the function that is being built."""
    from llvmlite import ir
    from numba.core import cgutils, types
    from numba.np.arrayobj import populate_array

    def numbers(values: tuple[int, ...]) -> list[Any]:
        return [context.get_constant(types.intp, value) for value in values]

    memory = cgutils.alloca_once(builder, ir.ArrayType(ir.DoubleType(), prod(shape)))
    memory.align = 64
    if zeros:
        cgutils.memset(builder, memory, ir.Constant(ir.IntType(64), 8 * prod(shape)), 0)
    made = context.make_array(array)(context, builder)
    strides = tuple(8 * prod(shape[i + 1 :]) for i in range(len(shape)))
    data = builder.bitcast(memory, ir.DoubleType().as_pointer())
    populate_array(
        made, data=data, shape=numbers(shape), strides=numbers(strides),
        itemsize=numbers((8,))[0], meminfo=None,
    )  # fmt: skip
    return made._getvalue()


vector, matrix, cube = (StackArray(rank) for rank in (1, 2, 3))
zero_vector, zero_matrix, zero_cube = (StackArray(rank, zeros=True) for rank in (1, 2, 3))
