"""CasADi's functions of a node for many nodes at once."""

import casadi as ca
import numpy as np
import pytest
from numba import config as numba_config

from fastmimic.robot import Robot, load_robot
from fastmimic.trajectory import tape
from fastmimic.trajectory.config import TrajectoryConfig
from fastmimic.trajectory.node import node_functions


def _every_operation() -> ca.Function:
    x, y = ca.SX.sym("x", 2), ca.SX.sym("y", 3)
    waves = ca.sin(x[0]) * ca.cos(y[2]) + ca.exp(-x[1]) / ca.log(2.5 + ca.sqrt(y[0] ** 2 + 1))
    return ca.Function("every", [x, y], [ca.vertcat(waves, 2 * y[1], 1 / (x[0] + 3), -y[0], 0.75, x[1] - y[1], y[2])])


@pytest.mark.parametrize("nodes", [1, tape._LANES, 2 * tape._LANES + 5])
def test_all_nodes_at_once_give_casadis_bits(nodes: int) -> None:
    function = _every_operation()
    rng = np.random.default_rng(nodes)
    x, y = rng.normal(size=(nodes, 2)), rng.normal(size=(nodes, 3))
    assert np.array_equal(tape.on_nodes(function, nodes)(x, y), function.map(nodes)(x.T, y.T).full().T)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["a1", "go2"])
def test_a_nodes_derivatives_are_casadis(name: str, a1: Robot) -> None:
    functions = node_functions(a1 if name == "a1" else load_robot(name), TrajectoryConfig())
    rng = np.random.default_rng(0)
    for function in (functions.gradient, functions.jacobian, functions.hessian):
        given = [0.1 * rng.normal(size=(40, function.numel_in(i))) for i in range(function.n_in())]
        found = tape.on_nodes(function, 40)(*given)
        assert np.isfinite(found).any()
        assert np.array_equal(found, function.map(40)(*(part.T for part in given)).full().T, equal_nan=True)


@pytest.mark.skipif(bool(numba_config.DISABLE_JIT), reason="without the JIT, CasADi runs its own list")
def test_an_operation_that_is_not_known_is_not_left_out() -> None:
    x = ca.SX.sym("x")
    with pytest.raises(KeyError):
        tape.on_nodes(ca.Function("tangent", [x], [ca.tan(x)]), 3)
