"""The functions of one node for many nodes at once: CasADi's list of instructions, each of them on a block of nodes.

CasADi's own virtual machine runs the list for one node after the other. The same operations in the same order give the
same bits here, in a sixth of the time: that of Hessians was half of a solution's.
"""

import math
from collections.abc import Callable
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array
from fastmimic.base.jit import inlined, kernel

_LANES: Final = 32
_MUL, _ADD, _SUB, _OUTPUT, _INPUT, _DIV, _NEG, _SQRT, _EXP, _LOG, _COS, _SIN, _INV = range(13)
_OPERATIONS: Final = {
    **{"OP_MUL": _MUL, "OP_SQ": _MUL, "OP_ADD": _ADD, "OP_TWICE": _ADD, "OP_SUB": _SUB, "OP_DIV": _DIV, "OP_INV": _INV},
    **{"OP_NEG": _NEG, "OP_SQRT": _SQRT, "OP_EXP": _EXP, "OP_LOG": _LOG, "OP_COS": _COS, "OP_SIN": _SIN},
    **{"OP_INPUT": _INPUT, "OP_CONST": _INPUT, "OP_OUTPUT": _OUTPUT},
}
"""CasADi's names; an operand stands twice where it is the only one, so that 2 a is a + a and a² is a · a."""


class Tape(NamedTuple):
    """A CasADi function with one output as a list of k instructions.

    Attributes:
        steps: (k, 4) operation, its two operands and its result: places in the work space; of inputs and the output
            places in them, one input after the other and then the constants.
        constants: (c,) that the list reads.
        work: places in the work space.
        outputs: length of the output.
    """

    steps: NDArray[np.uint32]
    constants: Array
    work: int
    outputs: int


def tape_of(function: Any) -> Tape:
    """The list of a CasADi function."""
    import casadi as ca

    operations = {getattr(ca, name): number for name, number in _OPERATIONS.items()}
    first = np.cumsum([0, *(function.numel_in(i) for i in range(function.n_in()))]).tolist()
    steps, constants = np.zeros((function.n_instructions(), 4), dtype=np.uint32), list[float]()
    for k in range(len(steps)):
        given, result = function.instruction_input(k), function.instruction_output(k)
        operation = operations[function.instruction_id(k)]
        if operation == _INPUT and not given:
            given = [first[-1] + len(constants)]
            constants.append(function.instruction_constant(k))
        elif operation == _INPUT:
            given = [first[given[0]] + given[1]]
        steps[k] = operation, given[0], given[-1], result[-1]
    return Tape(steps, np.array(constants), function.sz_w(), function.numel_out(0))


def on_nodes(function: Any, nodes: int) -> Callable[..., Array]:
    """A dense function with one output, CasADi's or its tape, of inputs (nodes, …) for all nodes at once; it returns
    (nodes, …)."""
    if not isinstance(function, Tape):
        mapped = function.map(nodes)
        return lambda *given: np.asarray(mapped(*(part.T for part in given)).full().T)
    tape = function

    def run(*given: Array) -> Array:
        out = np.zeros((nodes, tape.outputs))
        values = np.hstack([*given, np.tile(tape.constants, (nodes, 1))])
        _run(tape.steps, values, np.zeros((tape.work, _LANES)), out)
        return out

    return run


@kernel
def _run(steps: NDArray[np.uint32], given: Array, work: Array, out: Array) -> None:
    """Runs a list for nodes (n, inputs), `_LANES` of them at once, into `out` (n, outputs)."""
    n = len(given)
    for first in range(0, n, _LANES):
        for k in range(len(steps)):
            operation, a, b, c = steps[k]
            if operation == _MUL:
                for lane in range(_LANES):
                    work[c, lane] = work[a, lane] * work[b, lane]
            elif operation == _ADD:
                for lane in range(_LANES):
                    work[c, lane] = work[a, lane] + work[b, lane]
            elif operation == _SUB:
                for lane in range(_LANES):
                    work[c, lane] = work[a, lane] - work[b, lane]
            elif operation == _OUTPUT:
                for lane in range(min(_LANES, n - first)):
                    out[first + lane, c] = work[a, lane]
            elif operation == _INPUT:
                for lane in range(_LANES):
                    work[c, lane] = given[min(first + lane, n - 1), a]
            else:
                for lane in range(_LANES):
                    work[c, lane] = _rarely(operation, work[a, lane], work[b, lane])


@inlined
def _rarely(operation: int, a: float, b: float) -> float:
    if operation == _DIV:
        return a / b
    if operation == _NEG:
        return -a
    if operation == _SQRT:
        return math.sqrt(a)
    if operation == _EXP:
        return math.exp(a)
    if operation == _LOG:
        return math.log(a)
    if operation == _COS:
        return math.cos(a)
    if operation == _SIN:
        return math.sin(a)
    return 1.0 / a
