"""The locus against geometry: collinear and concurrent links, stretched legs, motions that locked actuators allow."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest
import zoo

import redundancy_pin as rp
from redundancy_pin.arrays import Array
from redundancy_pin.dynamics.virtual_work.three_rrr import ThreeRrrGeometry, inverse_displacement
from redundancy_pin.errors import InputError, UnsupportedRobotError
from redundancy_pin.robot import Robot
from redundancy_pin.robot.scales import row_scale
from redundancy_pin.singularities.classify import SingularityKind, classify
from redundancy_pin.singularities.locus import SingularLocus, singular_locus

EXACT = 1e-9
"""What is promised of a point: the scaled singular value that is left. Newton leaves 1e-15."""

GRID = 42
"""Coarse grids are enough: every point is refined."""


def locus_of(name: str, mode: tuple[int, ...] | None = None, orientation: float | None = None) -> SingularLocus:
    return _locus_of(name, mode, orientation)


@functools.cache  # which tells arguments that are left out from those that are not
def _locus_of(name: str, mode: tuple[int, ...] | None, orientation: float | None) -> SingularLocus:
    robot = zoo.robot_of(name, working_mode=mode) if mode else zoo.robot_of(name)
    return singular_locus(robot, orientation=orientation, resolution=GRID)


def legs_of(robot: Robot, x: Array):
    return inverse_displacement(ThreeRrrGeometry.from_parameters(robot.parameters), x, robot.working_mode)


def points_of(locus: SingularLocus, kind: SingularityKind) -> tuple[Array, Array]:
    curves = locus.of_kind(kind)
    return np.concatenate([c.points for c in curves]), np.concatenate([c.q for c in curves])


@pytest.mark.parametrize(
    ("resolution", "turn"),
    [*(pytest.param(n, np.inf, marks=pytest.mark.long) for n in (10, 25)), (15, np.inf), (15, 0.2)],
)
def test_the_border_of_the_five_bar_is_one_closed_curve_on_two_circles(resolution: int, turn: float) -> None:
    """The middle column of 15 and of 25 nodes meets the border in its corners, where two singular values vanish.

    Ranges of the motors, ``turn`` rad to each side of the reference, do not bound what is searched.
    """
    robot = zoo.robot_of("five_bar")
    if np.isfinite(turn):
        middle = {joint: robot.q_reference[zoo.index(robot, joint)] for joint in robot.actuated}
        robot = rp.with_limits(robot, {joint: {"lower": q - turn, "upper": q + turn} for joint, q in middle.items()})
    locus = singular_locus(robot, resolution=resolution)
    assert locus.unresolved == 0
    summary = locus.summary()
    assert summary["curves"] == {
        kind.label: {"curves": len(curves), "points": len(np.concatenate([one.points for one in curves]))}
        for kind in SingularityKind
        if (curves := locus.of_kind(kind))
    }
    assert (summary["nodes"], summary["reachable"]) == (locus.margin.size, locus.reachable.sum())
    assert len(repr(locus)) < 200
    (border,) = locus.of_kind(SingularityKind.TYPE_I)
    np.testing.assert_array_equal(border.points[0], border.points[-1])
    outside = border.points[:, :1] < 0.25
    radius = np.linalg.norm(border.points - np.where(outside, [[0.5, 0.0]], [[0.0, 0.0]]), axis=1)
    np.testing.assert_allclose(radius, 1.0, atol=EXACT)  # one leg of 1 m is stretched
    cell = np.hypot(*(axis[1] - axis[0] for axis in locus.axes))
    for tip in ([0.25, np.sqrt(1.0 - 0.25**2)], [0.25, -np.sqrt(1.0 - 0.25**2)]):
        assert np.linalg.norm(border.points - tip, axis=1).min() < cell
    chords = np.linalg.norm(np.diff(border.points, axis=0), axis=1)
    assert chords.max() < 3.0 * cell
    assert chords.sum() == pytest.approx(4.0 * np.arccos(0.25), rel=0.02)  # nothing is passed twice, nothing left out
    with pytest.raises(InputError, match="SingularityKind"):
        locus.of_kind("TYPE_I")


def test_two_rpr_is_singular_on_its_base_line() -> None:
    locus = locus_of("2rpr")
    assert {curve.kind for curve in locus.curves} == {SingularityKind.TYPE_II}
    np.testing.assert_allclose(locus.points[:, 1], 0.0, atol=1e-11)
    # legs have another length to either side of a base hinge: there a curve ends
    ends = sorted(tuple(sorted(curve.points[[0, -1], 0])) for curve in locus.curves)
    low, high = locus.axes[0][[0, -1]]
    np.testing.assert_allclose(ends, [(low, 0.0), (0.0, 0.5), (0.5, high)], atol=1e-9)


def test_without_working_modes_continuity_tells_branches_apart() -> None:
    """Of the five-bar with links of 0.5: the tip turns about elbows that coincide, along the border."""
    robot = replace(zoo.robot_of("five_bar"), working_modes=None, working_mode=())
    locus = singular_locus(robot, resolution=120)
    cell = np.hypot(*(axis[1] - axis[0] for axis in locus.axes))
    centre = np.array([0.25, -np.sqrt(3) / 4])
    arcs = [c.points for c in locus.of_kind(SingularityKind.TYPE_II) if (c.points[:, 1] < -0.5).all()]
    for arc in arcs:
        np.testing.assert_allclose(np.linalg.norm(arc - centre, axis=1), 0.5, atol=1e-11)
    # all of it that is farther than a cell from the border
    angles = np.linspace(-2 * np.pi / 3, -np.pi / 3, 200)
    there = centre + 0.5 * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    inside = 1.0 - np.linalg.norm(there[:, None] - np.array([[0.0, 0.0], [0.5, 0.0]]), axis=2).max(axis=1) > cell
    assert inside.sum() > 20
    drawn = np.concatenate(arcs)
    assert np.linalg.norm(there[inside, None] - drawn, axis=2).min(axis=1).max() < 2.0 * cell


@pytest.mark.long_for("mode1-0.3")
@pytest.mark.parametrize(("mode", "orientation"), [(None, None), ((1, -1, 1), 0.3)])
def test_three_rrr_is_type_ii_where_its_distal_lines_meet_in_a_point(mode, orientation) -> None:
    """Lines (e, A × e) are concurrent or parallel when their determinant vanishes; elsewhere it does not."""
    locus = locus_of("3rrr", mode, orientation)
    on, _ = points_of(locus, SingularityKind.TYPE_II)
    on = on[np.abs(legs_of(locus.robot, on).c).min(axis=0) > 1e-6]  # at their ends a leg may be folded
    assert np.abs(line_determinant(locus.robot, on)).max() < 1e-10
    shape = locus.margin.shape
    nodes = np.zeros((shape[0] * shape[1], 3))
    nodes[:, :2] = np.stack(np.meshgrid(*locus.axes, indexing="ij"), axis=-1).reshape(-1, 2)
    nodes[:, 2] = orientation or 0.0
    away = np.abs(locus.margin.ravel()) > 0.01
    determinant = line_determinant(locus.robot, nodes[away])
    # det W has the sign of det of the lines over the product of c, and c keeps its sign in a working mode
    sign = np.sign(determinant) * np.sign(locus.margin.ravel()[away])
    assert (sign == sign[0]).all()


def line_determinant(robot: Robot, x: Array) -> Array:
    legs = legs_of(robot, x)
    corner = x[:, 0] + 1j * x[:, 1] + legs.arm
    rows = np.stack([legs.e.real, legs.e.imag, (np.conj(corner) * legs.e).imag], axis=-1)
    return np.linalg.det(rows.transpose(1, 0, 2))


def test_five_bar_is_type_ii_where_its_distal_links_are_in_line() -> None:
    locus = locus_of("five_bar")
    x, q = points_of(locus, SingularityKind.TYPE_II)
    robot = locus.robot
    base = [q[:, zoo.index(robot, f"base_{leg}")] for leg in (1, 2)]
    elbows = [
        np.stack([0.5 * np.cos(a) + shift, 0.5 * np.sin(a)], axis=1) for a, shift in zip(base, (0.0, 0.5), strict=True)
    ]
    one, other = (x - elbow for elbow in elbows)
    np.testing.assert_allclose(one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0], 0.0, atol=1e-10)
    assert np.abs(x - [0.25, np.sqrt(3) / 4]).max(axis=1).min() < 0.05  # and the point that is known in closed form


@pytest.mark.long_for("mode1-0.3")
@pytest.mark.parametrize(("mode", "orientation"), [(None, None), ((1, -1, 1), 0.3)])
def test_locked_actuators_let_the_platform_move_along_the_uncontrolled_twist(mode, orientation) -> None:
    """Along it actuators turn with the square of the distance only; across it they turn with the distance."""
    locus = locus_of("3rrr", mode, orientation)
    x, q = points_of(locus, SingularityKind.TYPE_II)
    inner = np.abs(legs_of(locus.robot, x).c).min(axis=0) > 0.1  # where the closed form is well conditioned
    x, classes = x[inner], classify(locus.robot, q[inner])
    here = legs_of(locus.robot, x).theta

    def turned(twist: Array, step: float) -> Array:
        change = legs_of(locus.robot, x + step * twist).theta - here
        return np.abs((change + np.pi) % (2 * np.pi) - np.pi).max(axis=0)

    small, large = (turned(classes.uncontrolled_twist, step) for step in (1e-4, 2e-4))
    assert small.max() < 1e-4 * 1e-2
    ratio = large / small
    assert np.median(np.abs(ratio - 4.0)) < 0.01
    across = (
        np.roll(classes.uncontrolled_twist, 1, axis=1) / np.roll(row_scale(locus.robot), 1) * row_scale(locus.robot)
    )
    assert np.median(turned(across, 2e-4) / turned(across, 1e-4)) == pytest.approx(2.0, abs=0.01)


def test_bounds_orientation_and_reachable_nodes_are_those_of_the_closed_form() -> None:
    robot = zoo.robot_of("3rrr")
    locus = singular_locus(robot, bounds=[(0.5, 1.2), (0.2, 0.8)], orientation=0.1, resolution=21)
    assert [(axis[0], axis[-1]) for axis in locus.axes] == [(0.5, 1.2), (0.2, 0.8)]
    assert locus.fixed == {"rz": 0.1}
    assert locus.reference[2] == 0.1
    locus = locus_of("3rrr")
    nodes = np.zeros((locus.margin.size, 3))
    nodes[:, :2] = np.stack(np.meshgrid(*locus.axes, indexing="ij"), axis=-1).reshape(-1, 2)
    np.testing.assert_array_equal(locus.reachable.ravel(), legs_of(locus.robot, nodes).reachable.all(axis=0))
    for array in (locus.margin, locus.serial_margin, locus.points, locus.axes[0], locus.curves[0].points):
        assert not array.flags.writeable


def test_what_cannot_be_drawn_is_refused() -> None:
    with pytest.raises(UnsupportedRobotError, match="gough"):
        singular_locus(zoo.robot_of("gough"))
    spatial = zoo.robot_of("gough")
    assert spatial.platform is not None
    two_tilts = replace(spatial, platform=replace(spatial.platform, axes=("x", "y", "rx", "ry")))
    with pytest.raises(UnsupportedRobotError, match="x, y, rx, ry"):
        singular_locus(two_tilts)
    for name, given in (
        ("orientation", {"orientation": 0.2}),
        ("resolution", {"resolution": 2}),
        ("bounds", {"bounds": [(1.0, 0.0), (0.0, 1.0)]}),
        ("bounds", {"bounds": [(0.0, 1.0)]}),
    ):
        with pytest.raises(InputError, match=name):
            singular_locus(zoo.robot_of("2rpr"), **given)


def test_four_bar_lists_the_crank_angles_at_which_coupler_and_rocker_are_in_line() -> None:
    robot = zoo.robot_of("four_bar", ground_length=0.4, crank_length=0.3, coupler_length=0.35, rocker_length=0.2)
    locus = singular_locus(robot, resolution=GRID)
    reach = np.array([0.35 - 0.2, 0.35 + 0.2])
    expected = np.arccos((0.4**2 + 0.3**2 - reach**2) / (2 * 0.4 * 0.3))
    np.testing.assert_allclose(locus.points[:, 0], expected, atol=1e-10)
    assert {curve.kind for curve in locus.curves} == {SingularityKind.COMBINED}
    assert locus.names == ("crank",)
    assert locus.units == ("rad",)


def test_a_crank_that_turns_fully_has_no_singularity() -> None:
    locus = locus_of("four_bar")
    assert locus.curves == ()
    assert locus.points.shape == (0, 1)
    assert locus.reachable.all()
