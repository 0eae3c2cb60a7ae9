"""The tuned numbers in the copy of the package that `tuned_copy.py` makes: code loads each from memory at every use.

Compiled code finds the memory by a symbol, so that it may be cached on disk like any other.
"""

import json
from pathlib import Path
from typing import Any

import llvmlite.binding as llvm
import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic, overload

BASE: dict[str, float] = json.loads(Path(__file__).with_suffix(".json").read_text())
"""The numbers as they are in the package, by file and name."""
SIZE = len(BASE)
VALUES_AND_READ = np.array([*BASE.values(), *[0.0] * SIZE])
"""The numbers as they are used, then for each of them 1 once it was read."""
_SYMBOL = "backlash_tuned_numbers"
llvm.add_symbol(_SYMBOL, VALUES_AND_READ.ctypes.data)


def tuned(k: int) -> float:
    """Return the number with an index."""
    VALUES_AND_READ[SIZE + k] = 1.0
    return float(VALUES_AND_READ[k])


@intrinsic
def _load(typingctx: Any, k: Any) -> Any:  # noqa: ARG001 - numba asks for this signature
    def generate(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        double, whole, module = ir.DoubleType(), ir.IntType(64), builder.module
        cells = module.globals.get(_SYMBOL) or ir.GlobalVariable(module, ir.ArrayType(double, 2 * SIZE), _SYMBOL)
        begin, place = ir.Constant(whole, 0), arguments[0]
        read = builder.gep(cells, [begin, builder.add(place, ir.Constant(whole, SIZE))])
        builder.store(ir.Constant(double, 1.0), read)
        return builder.load(builder.gep(cells, [begin, place]))

    return types.float64(types.int64), generate


overload(tuned)(lambda k: lambda k: _load(k))  # noqa: ARG005, PLW0108 - numba asks with the argument's type
