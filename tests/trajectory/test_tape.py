"""CasADi's functions of a node for many nodes at once."""

from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from numba import config as numba_config

from fastmimic.robot import Robot, load_robot
from fastmimic.trajectory import tape
from fastmimic.trajectory.config import TrajectoryConfig
from fastmimic.trajectory.node import N_GIVEN, N_VARIABLES, casadi_functions, node_functions


def _every_operation() -> ca.Function:
    x, y = ca.SX.sym("x", 2), ca.SX.sym("y", 3)
    waves = ca.sin(x[0]) * ca.cos(y[2]) + ca.exp(-x[1]) / ca.log(2.5 + ca.sqrt(y[0] ** 2 + 1))
    return ca.Function("every", [x, y], [ca.vertcat(waves, 2 * y[1], 1 / (x[0] + 3), -y[0], 0.75, x[1] - y[1], y[2])])


@pytest.mark.parametrize("nodes", [1, tape._LANES, 2 * tape._LANES + 5])
def test_all_nodes_at_once_give_casadis_bits(nodes: int) -> None:
    function = _every_operation()
    rng = np.random.default_rng(nodes)
    x, y = rng.normal(size=(nodes, 2)), rng.normal(size=(nodes, 3))
    assert np.array_equal(tape.on_nodes(tape.tape_of(function), nodes)(x, y), function.map(nodes)(x.T, y.T).full().T)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["a1", "go2"])
def test_a_nodes_derivatives_are_casadis(name: str, a1: Robot) -> None:
    functions = casadi_functions(a1 if name == "a1" else load_robot(name), TrajectoryConfig())
    rng = np.random.default_rng(0)
    for function in (functions.gradient, functions.jacobian, functions.hessian):
        given = [0.1 * rng.normal(size=(40, function.numel_in(i))) for i in range(function.n_in())]
        found = tape.on_nodes(tape.tape_of(function), 40)(*given)
        assert np.isfinite(found).any()
        assert np.array_equal(found, function.map(40)(*(part.T for part in given)).full().T, equal_nan=True)


def test_an_operation_that_is_not_known_is_not_left_out() -> None:
    x = ca.SX.sym("x")
    with pytest.raises(KeyError):
        tape.tape_of(ca.Function("tangent", [x], [ca.tan(x)]))


@pytest.mark.skipif(bool(numba_config.DISABLE_JIT), reason="without the JIT, CasADi runs its own list")
def test_what_was_kept_is_what_was_made(a1: Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    light = replace(a1, mass=0.9 * a1.mass)  # one that no other test has met
    made = node_functions(light, TrajectoryConfig())
    assert node_functions(light, TrajectoryConfig(clearance_share=0.3)) is made
    (file,) = tmp_path.rglob("*.npz")
    again = node_functions(replace(light), TrajectoryConfig())
    assert again is not made
    node = [np.full((1, size), 0.1) for size in (N_VARIABLES, N_GIVEN)]
    assert np.array_equal(made.rows(*node).full(), again.rows(*node).full(), equal_nan=True)
    for name in ("gradient", "jacobian"):
        found, wanted = (tape.on_nodes(getattr(functions, name), 1)(*node) for functions in (again, made))
        assert np.array_equal(found, wanted, equal_nan=True)
    assert np.array_equal(made.hessian.steps, again.hessian.steps)
    file.unlink()
    node_functions(replace(light), TrajectoryConfig(friction=0.5))
    assert len(list(tmp_path.rglob("*.npz"))) == 1
