"""The bilinear programme: its derivatives against differences, its solution against a closed form."""

import casadi
import numpy as np
import pytest
from scipy.sparse import csc_matrix

from redundancy_pin.planners.whole_trajectory.mesh import grid_of, with_middles
from redundancy_pin.planners.whole_trajectory.program import Program
from redundancy_pin.trajectory import reference


def random_program(seed):
    rng = np.random.default_rng(seed)
    program = Program()
    a, b = program.variable("a", (3, 2)), program.variable("b", (4,))
    rows = program.rows((3, 2), -1.0, 1.0)
    program.add(rows, a, rng.normal(size=(3, 2)))
    program.add(rows, b[0], rng.normal(size=(3, 2)))
    program.add_product(rows, a, a, rng.normal(size=(3, 2)))
    program.add_product(rows, a, b[1], rng.normal(size=(3, 2)))
    program.add_product(rows[0], b[2], b[3], rng.normal(size=2))
    program.add_product(rows[0], b[3], b[2], rng.normal(size=2))  # the same product again, the other way round
    program.charge(b, rng.normal(size=4))
    program.charge_square(a, rng.uniform(size=(3, 2)))
    return program, rng


def dense(matrix):
    return csc_matrix(casadi.DM(matrix).sparse()).toarray()


@pytest.mark.parametrize("seed", range(3))
def test_derivatives_agree_with_automatic_ones(seed):
    program, rng = random_program(seed)
    functions, derivatives = program.functions()
    x, f, g = (functions[name] for name in "xfg")
    at, lam_f, lam_g = rng.normal(size=program.size), 1.7, rng.normal(size=program.row_count)
    automatic = casadi.Function(
        "automatic",
        [x],
        [
            casadi.gradient(f, x),
            casadi.jacobian(g, x),
            casadi.triu(casadi.hessian(lam_f * f + casadi.dot(casadi.DM(lam_g), g), x)[0]),
        ],
    )
    gradient, jacobian, hessian = automatic(at)
    np.testing.assert_allclose(derivatives["grad_f"](at, [])[1], gradient, atol=1e-12)
    np.testing.assert_allclose(dense(derivatives["jac_g"](at, [])[1]), dense(jacobian), atol=1e-12)
    np.testing.assert_allclose(dense(derivatives["hess_lag"](at, [], lam_f, lam_g)), dense(hessian), atol=1e-12)


def test_split_and_join_are_inverse():
    program, rng = random_program(0)
    x = rng.normal(size=program.size)
    np.testing.assert_array_equal(program.join(program.split(x)), x)


class Source:
    start, end, exact = 0.0, 1.0, True
    breaks, knots = np.array([0.4]), np.array([0.25])


def test_grid_has_every_event_on_a_node():
    grid = grid_of(Source, [0.7], 0.03)
    assert np.diff(grid.t).max() <= 0.03 * (1.0 + 1e-9)
    assert (grid.t == 0.4).sum() == 2
    assert (grid.t == 0.25).sum() == 1
    np.testing.assert_array_equal(grid.t[grid.singular], [0.7])
    np.testing.assert_array_equal(np.flatnonzero(grid.smooth), grid.singular)
    assert grid.weights.sum() == pytest.approx(1.0, rel=1e-14)


def test_middles_are_smooth_and_keep_the_rest():
    grid = grid_of(Source, [0.7], 0.03)
    steps = np.zeros(len(grid.t) - 1, dtype=bool)
    steps[[0, int(grid.singular[0]), len(steps) - 1]] = True
    finer = with_middles(grid, steps)
    assert len(finer.t) == len(grid.t) + 3
    assert np.isin(grid.t, finer.t).all()
    np.testing.assert_array_equal(finer.t[finer.singular], [0.7])
    assert finer.smooth.sum() == 4


def test_jumps_of_the_reference_are_twice_on_its_grid():
    trajectory = reference.corner()
    from redundancy_pin.trajectory.functions_of_time import continuous_motion

    grid = grid_of(continuous_motion(trajectory), [], 0.05)
    np.testing.assert_array_equal(grid.t[1:][np.diff(grid.t) == 0.0], trajectory.breaks)
