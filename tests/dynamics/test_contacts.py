"""Rows of efforts against another solver (DAQP), and closure forces against free bodies."""

from __future__ import annotations

import numpy as np
import pytest
import zoo
from scipy.optimize import nnls

import redundancy_pin as rp
from redundancy_pin.arrays import Array
from redundancy_pin.dynamics.base import ReducedDynamics
from redundancy_pin.dynamics.contacts import ClosureForces, closure_forces
from redundancy_pin.dynamics.distribution import EffortRows
from redundancy_pin.dynamics.rnea import RneaAlongMotion
from redundancy_pin.errors import InputError
from redundancy_pin.status import SampleStatus

EXACT = 1e-12
OPTIMUM = 1e-5  # relative; DAQP keeps conditions to 1e-6


Gripping = tuple[RneaAlongMotion, ReducedDynamics, ClosureForces, EffortRows]


@pytest.fixture(scope="module")
def gripping() -> Gripping:
    """A five-bar with all four hinges driven: two arms that hold a point between them, and squeeze it."""
    five_bar = zoo.robot_of("five_bar")
    robot = rp.robot_from_model(
        five_bar.model,
        closures=[{"name": "grip", "frames": ["tip_2", "end_effector"], "axes": ["x", "y"]}],
        actuated=["base_1", "elbow_1", "base_2", "elbow_2"],
        carriers=five_bar.carriers,
        independent=five_bar.platform,
        reference=np.array(five_bar.q_reference),
    )
    along = rp.RneaDynamics(robot).along(zoo.smooth_motion(five_bar, 1).at(np.linspace(0.0, 1.0, 6)))
    force = closure_forces(along)
    return along, along.reduce(), force, force.rows(force.component("grip", "x"), 20.0, 20.0)


def least(W: Array, f: Array, rows: EffortRows, k: int) -> Array:
    """Return the τ of least norm with W τ = f and the rows, by non-negative least squares (Lawson and Hanson 1974)."""
    C = rows.matrix[k] if rows.matrix.ndim == 3 else rows.matrix
    low, high = (side[k] if np.ndim(side) == 2 else np.broadcast_to(side, len(C)) for side in (rows.lower, rows.upper))
    A, low, high = np.concatenate([W, C]), np.concatenate([f, low]), np.concatenate([f, high])
    G = np.concatenate([A[np.isfinite(low)], -A[np.isfinite(high)]])
    h = np.concatenate([low[np.isfinite(low)], -high[np.isfinite(high)]])
    size = np.linalg.norm(G, axis=1)
    G, h = G / size[:, None], h / size
    multipliers, left = nnls(np.concatenate([G.T, h[None] / np.abs(h).max()]), np.eye(W.shape[1] + 1)[-1])
    assert left > 1e-9  # else nothing keeps them
    pressed = multipliers > 0.0
    return np.asarray(np.linalg.lstsq(G[pressed], h[pressed], rcond=None)[0])


def test_a_squeeze_holds_exactly_and_costs_least(gripping: Gripping) -> None:
    along, reduced, force, squeeze = gripping
    distribution = rp.distribute(reduced, rows=[squeeze])
    assert distribution.solved.all()
    reactions = rp.joint_reactions(along, distribution.tau)
    assert np.abs(reactions.closure_force[:, 0] - 20.0).max() < 1e-6
    assert np.abs(reactions.closure_force - force.at(distribution.tau)).max() < 1e-8
    assert np.abs(np.einsum("nij,nj->ni", reduced.W, distribution.tau) - reduced.f).max() < 1e-8
    for k in range(len(reduced.f)):
        oracle = least(reduced.W[k], reduced.f[k], squeeze, k)
        assert np.abs(distribution.tau[k] - oracle).max() < OPTIMUM * np.abs(oracle).max()
    free = rp.distribute(reduced)
    assert np.linalg.norm(free.tau) < np.linalg.norm(distribution.tau)


def test_contacts_stay_in_their_cones_and_motors_in_their_bounds(gripping: Gripping) -> None:
    along, reduced, force, _ = gripping
    cone = force.friction_cone("grip", 0.5, normal="x", least=5.0)
    upper = np.abs(rp.distribute(reduced, rows=[cone]).tau).max(axis=0) * [1.5, 0.95, 1.5, 1.5]  # one motor is weak
    distribution = rp.distribute(reduced, rows=[cone], lower=-upper, upper=upper)
    assert distribution.solved.all()
    normal, tangent = rp.joint_reactions(along, distribution.tau).closure_force.T
    assert (normal > 5.0 - 1e-6).all()
    assert (np.abs(tangent) < 0.5 * normal + 1e-6).all()
    assert (np.abs(distribution.tau) <= upper).all()
    assert (np.abs(distribution.tau[:, 1]) > 0.99 * upper[1]).any()
    bounds = EffortRows(np.eye(4), -upper, upper)
    for k in range(len(reduced.f)):
        both = EffortRows(*(np.concatenate(parts) for parts in zip(
            (cone.matrix[k], cone.lower[k], np.full(len(cone.lower[k]), np.inf)),
            (bounds.matrix, bounds.lower, bounds.upper), strict=True)))  # fmt: skip
        oracle = least(reduced.W[k], reduced.f[k], both, 0)
        assert np.abs(distribution.tau[k] - oracle).max() < 1e-4 * np.abs(oracle).max()


def test_conditions_that_cannot_be_kept_are_a_status(gripping: Gripping) -> None:
    along, reduced, force, squeeze = gripping
    distribution = rp.distribute(reduced, rows=[squeeze], lower=-0.5, upper=0.5)
    assert (distribution.status == SampleStatus.BOUND_INFEASIBLE).all()
    assert np.isnan(distribution.tau).all()
    # equal rows that contradict each other have no residual at all
    other = force.rows(force.component("grip", "x"), 30.0, 30.0)
    assert np.isinf(rp.distribute(reduced, rows=[squeeze, other]).residual).all()
    # a robot without choice keeps rows or does not
    five_bar = zoo.robot_of("five_bar")
    own = rp.RneaDynamics(five_bar).reduce(along.motion)
    efforts = rp.distribute(own).tau
    limit = float(np.median(efforts[:, 0]))
    kept = rp.distribute(own, rows=[EffortRows(np.array([[1.0, 0.0]]), np.array([-np.inf]), np.array([limit]))])
    assert ((kept.status == SampleStatus.BOUND_INFEASIBLE) == (efforts[:, 0] > limit + 1e-9)).all()


def foot() -> ClosureForces:
    """A point foot in a plane: what holds it are the two efforts themselves."""
    return ClosureForces(("x of foot", "z of foot"), np.zeros((1, 2)), np.eye(2)[None])


@pytest.mark.parametrize("sides", [3, 4, 5, 8])
def test_a_cone_in_a_plane_is_the_same_to_both_sides_whatever_the_number_of_sides(sides: int) -> None:
    cone = foot().friction_cone("foot", 0.5, sides=sides)
    tangential = np.linspace(-1.0, 1.0, 401)
    held = [bool((cone.matrix[0] @ [x, 1.0] >= cone.lower[0] - EXACT).all()) for x in tangential]
    assert held == (np.abs(tangential) <= 0.5 + EXACT).tolist()


@pytest.mark.parametrize("sides", [3, 4, 8])
def test_a_cone_in_space_is_a_pyramid_with_its_edges_on_coulombs_cone(sides: int) -> None:
    force = ClosureForces(("x of foot", "y of foot", "z of foot"), np.zeros((1, 3)), np.eye(3)[None])
    cone = force.friction_cone("foot", 0.5, sides=sides)

    def held(radius: float, angle: Array) -> list[bool]:
        forces = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.ones_like(angle)])
        return [bool(one) for one in (cone.matrix[0] @ forces >= cone.lower[0][:, None]).all(axis=0)]

    around = np.linspace(-np.pi, np.pi, 97)
    edges = (2.0 * np.arange(sides) + 1.0) * np.pi / sides
    assert all(held(0.5 * (1.0 - 1e-9), edges))
    assert all(held(0.5 * (1.0 - 1e-9) * np.cos(np.pi / sides), around))
    assert not any(held(0.5 * (1.0 + 1e-9), around))


WRONG_CONES = [
    {"friction": "a"},
    {"friction": np.inf},
    {"sides": 3.5},
    {"sides": "x"},
    {"least": np.nan},
    {"least": [1, 2]},
]
WRONG_ROWS = [
    ([1, 2, 3], 0, 1),
    ("x", 0, 1),
    ([1, 0], 2, 1),
    ([1, 0], np.nan, 1),
    ([1, 0], [0, 0, 0], 1),
    ([np.nan, 0], 0, 1),
]


def test_cones_and_rows_of_no_sense_are_refused() -> None:
    for given in WRONG_CONES:
        with pytest.raises(InputError):
            foot().friction_cone(**{"closure": "foot", "friction": 0.5, **given})
    for direction, lower, upper in WRONG_ROWS:
        with pytest.raises(InputError):
            foot().rows(direction, lower, upper)
    with pytest.raises(InputError, match="no closure row 'y of foot'"):
        foot().friction_cone("foot", 0.5, normal="y")
    with pytest.raises(InputError, match="friction is -1"):
        foot().friction_cone("foot", -1.0)


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        (None, "rows is None"),
        (EffortRows(np.eye(4), np.zeros(4), np.ones(4)), r"rows is one EffortRows. Pass a list .* rows=\[squeeze\]"),
        ([EffortRows("x", 0, 1)], "matrix is not an array"),
        ([EffortRows(np.eye(4), np.ones(4), np.zeros(4))], "lower is above upper"),
        ([EffortRows(np.eye(3), np.zeros(3), np.ones(3))], "matrix has shape"),
        ([5], "Rows of efforts was expected"),
    ],
)
def test_rows_that_do_not_fit_are_refused(gripping: Gripping, rows: object, message: str) -> None:
    along, reduced, _, _ = gripping
    with pytest.raises(InputError, match=message):
        rp.distribute(reduced, rows=rows)
    with pytest.raises(InputError, match="RNEA dynamics along a motion"):
        closure_forces(along.robot)
