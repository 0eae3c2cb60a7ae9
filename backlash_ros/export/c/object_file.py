"""Ticks as an object file, by way of numba and LLVM: no Python runtime, no allocation, nothing but a C library's maths.

numba has compiled a tick for this machine and keeps it as LLVM's code, too. Here each tick gets a function that C can
call, everything else is made internal and dropped where nothing calls it, and LLVM compiles what is left for the
target. Rounding is that of IEEE 754 on every target, operation by operation: nothing is fused or reordered, since the
ticks are compiled without fast-math. Only functions of the C library, such as ``exp``, may differ in the last bit.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numba
from llvmlite import binding, ir
from numba.np import arrayobj

from backlash_ros.control.acting import ActingLaw
from backlash_ros.control.motion.setpoint import DURATION
from backlash_ros.control.tick import Inputs, TickConstants, TickMemory
from backlash_ros.foundation.record import size_of
from backlash_ros.foundation.signals import STATE_NAMES

_llvm: Any = binding
_ir: Any = ir
_types: Any = numba.types
_arrays: Any = arrayobj

TARGETS = {
    "x86_64-unknown-linux-gnu": "x86-64-v2",
    "aarch64-unknown-linux-gnu": "generic",
    "armv7-unknown-linux-gnueabihf": "cortex-a7",
    "thumbv7em-unknown-none-eabihf": "cortex-m7",
}
"""Targets as LLVM calls them, and the least processor that the code needs; that of the Cortex-M7 has doubles."""

_BUILT_IN = re.compile(r"llvm\.(?!x86|aarch64|arm)")
"""What LLVM translates itself, or by memcpy, memmove and memset, which each C compiler has."""
_MATHS = re.compile(
    r"(?:llvm\.)?(sqrt|floor|ceil|trunc|exp|exp2|expm1|log|log1p|log2|log10|pow|sin|cos|tan|tanh|atan|atan2|hypot|fmod)"
    r"(?:\.f64)?"
)
"""Functions of the C library, called as such or as one that LLVM knows."""
_EXACT = {"sqrt", "floor", "ceil", "trunc", "fmod"}
"""Those whose result is the same in each of them."""


_ROUNDS = 3
"""How often LLVM optimizes: what one round finds out lets the next one drop more."""


@dataclass(frozen=True)
class ObjectFile:
    """An object file, and the functions of the C library that it needs whose last bit is not the same in each of them.

    The functions are, by ``name``, ``int32_t name(const double *constants, double *memory, const double *law,
    double *state, double *plan, int64_t rows, double *measured, double *inputs, double *command)``: see `tick.Tick`.
    They return 0, or another number if no command can be computed.
    """

    content: bytes
    maths: tuple[str, ...]


def object_file(laws: Mapping[str, ActingLaw], target: str) -> ObjectFile:
    """Compile the tick with each law, by the name of the function that C calls, for one of `TARGETS`.

    Raises
    ------
    ValueError
        If a law calls something that is not in a C library, such as what allocates memory.
    """
    module, machine = _linked(laws), _machine(target)
    inner = (thing for thing in (*module.functions, *module.global_variables) if not thing.is_declaration)
    for k, thing in enumerate(thing for thing in inner if thing.name not in laws):
        thing.linkage, thing.name = _llvm.Linkage.internal, f"inner_{k}"  # numba's names differ from run to run
    module.triple, module.data_layout = machine.triple, str(machine.target_data)
    for _ in range(_ROUNDS):
        _optimize(module, machine)
    maths = _maths_of(module)
    return ObjectFile(machine.emit_object(module), maths)


def _machine(target: str) -> Any:
    _llvm.initialize_all_targets()
    _llvm.initialize_all_asmprinters()
    found = _llvm.Target.from_triple(target)
    place = "static" if "-none-" in target else "pic"
    return found.create_target_machine(cpu=TARGETS[target], opt=3, reloc=place, codemodel="default")


def _linked(laws: Mapping[str, ActingLaw]) -> Any:
    """Return the module of all ticks and of what they call, with their functions for C."""
    results = {name: _compiled(acting.tick) for name, acting in laws.items()}
    front = next(iter(laws.values())).tick.targetctx.create_module("ticks")  # type: ignore[attr-defined]
    _add_no_allocation(front)
    for name, acting in laws.items():
        _add_function(front, name, acting, results[name])
    module = _llvm.parse_assembly(str(front))
    for library in {id(result): result.library for result in results.values()}.values():
        module.link_in(_llvm.parse_bitcode(library._get_module_for_linking().as_bitcode()))
    return module


def _compiled(tick: Any) -> Any:
    """Return numba's result for a tick, which is compiled for one signature."""
    (result,) = tick.overloads.values()
    return result


def _add_no_allocation(front: Any) -> None:
    """Add an allocation that fails: numba calls it where ``a[:] = b`` overlaps, which nothing does in a tick.

    So LLVM drops what would follow, and an overlap would be an error.
    """
    memory = _ir.IntType(8).as_pointer()
    allocate = _ir.Function(front, _ir.FunctionType(memory, [_ir.IntType(64)]), "NRT_Allocate")
    _ir.IRBuilder(allocate.append_basic_block()).ret(_ir.Constant(memory, None))
    free = _ir.Function(front, _ir.FunctionType(_ir.VoidType(), [memory]), "NRT_Free")
    _ir.IRBuilder(free.append_basic_block()).ret_void()


def _add_function(front: Any, name: str, acting: ActingLaw, result: Any) -> None:
    """Add the function that C calls: it makes arrays of pointers, and hands them to a tick."""
    context: Any = acting.tick.targetctx  # type: ignore[attr-defined]
    number, whole = _ir.DoubleType().as_pointer(), _ir.IntType(64)
    shape = _ir.FunctionType(_ir.IntType(32), [*[number] * 5, whole, *[number] * 3])
    function = _ir.Function(front, shape, name)
    builder = _ir.IRBuilder(function.append_basic_block())
    constants, memory, law, state, plan, rows, measured, inputs, command = function.args
    arrays = (
        (constants, size_of(TickConstants)),
        (memory, size_of(TickMemory)),
        (law, acting.law.constants.size),
        (state, acting.state.size),
        (plan, rows),
        (measured, len(STATE_NAMES)),
        (inputs, size_of(Inputs)),
    )
    kinds = result.fndesc.argtypes
    given = [_array(context, builder, kind, *each) for kind, each in zip(kinds, arrays, strict=True)]
    callee = context.declare_function(front, result.fndesc)
    status, value = context.call_conv.call_function(builder, callee, result.fndesc.restype, kinds, given)
    builder.store(value, command)
    builder.ret(status.code)


def _array(context: Any, builder: Any, kind: Any, pointer: Any, length: Any) -> Any:
    """Return numba's array of numbers that are elsewhere: ``length`` of them, or rows of a plan."""

    def whole(value: int) -> Any:
        return context.get_constant(_types.intp, value)

    array = context.make_array(kind)(context, builder)
    size = length if kind.ndim == 2 else whole(length)
    _arrays.populate_array(
        array,
        data=builder.bitcast(pointer, array.data.type),
        shape=[size, whole(DURATION + 1)][: kind.ndim],
        strides=[whole(8 * (DURATION + 1)), whole(8)][-kind.ndim :],
        itemsize=whole(8),
        meminfo=None,
    )
    return array._getvalue()


def _optimize(module: Any, machine: Any) -> None:
    """Let LLVM optimize a module, by the way that this version of it has."""
    if hasattr(_llvm, "create_pass_builder"):
        builder = _llvm.create_pass_builder(machine, _llvm.create_pipeline_tuning_options(speed_level=3))
        builder.getModulePassManager().run(module, builder)
        return
    passes, populated = _llvm.create_module_pass_manager(), _llvm.create_pass_manager_builder()
    populated.opt_level, populated.inlining_threshold, populated.slp_vectorize = 3, 225, True
    machine.add_analysis_passes(passes)
    populated.populate(passes)
    passes.run(module)


def _maths_of(module: Any) -> tuple[str, ...]:
    """Return the functions of the C library that are not exact; ValueError if anything else is called."""
    called = {function.name for function in module.functions if function.is_declaration}
    found = {match[1]: name for name in called if (match := _MATHS.fullmatch(name))}
    if others := sorted(name for name in called - {*found.values()} if not _BUILT_IN.match(name)):
        raise ValueError(
            f"the law cannot be exported: its step needs {', '.join(others)}, which no C library has; "
            "keep arrays in the law's state, and make no new ones"
        )
    return tuple(sorted(found.keys() - _EXACT))
