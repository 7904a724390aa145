"""Loops closed from far away and at a pose, Γ and its margin, and the search for a pose in the working mode."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import zoo
from written import J, urdf_of, write_robot

from redundancy_pin import load_robot
from redundancy_pin.arrays import CLOSURE_TOLERANCE, SINGULAR_MARGIN
from redundancy_pin.errors import DeclarationError
from redundancy_pin.kinematics.assembly import (
    assemble,
    evaluated,
)
from redundancy_pin.kinematics.branch import follower
from redundancy_pin.kinematics.closing import closed_near
from redundancy_pin.kinematics.closure import ConstraintSystem
from redundancy_pin.kinematics.coordinates import coordinates, difference, working_modes
from redundancy_pin.kinematics.multistart import multistart, wrapped
from redundancy_pin.loading import with_limits
from redundancy_pin.robot import Robot
from redundancy_pin.robot.scales import position_unit, row_scale, velocity_scale

TURN = 2.0 * np.pi
AXES = np.eye(3)
INVERSION = 1e-12
"""Rounding of an inverse, relative."""

CLOSED = 1e-9  # m or rad: the closure tolerance, as Pinocchio's placements show it

AXES_OF = {
    "hinge about x": ("x", "y", "z", "ry", "rz"),
    "hinge about y": ("x", "y", "z", "rx", "rz"),
    "hinge about z": ("x", "y", "z", "rx", "ry"),
    "weld": ("x", "y", "z", "rx", "ry", "rz"),
}


def arm(folder: Path, kind: str, size: float) -> Robot:
    """A body with all six freedoms, welded or hinged to a seat that turns too; ``size`` m count as a radian."""
    names = ["slide_x", "slide_y", "slide_z", "turn_z", "turn_y", "turn_x"]
    links = ["base", *(f"after_{name}" for name in names)]
    joints = [
        J(name, "prismatic" if i < 3 else "revolute", links[i], links[i + 1], axis=AXES["xyz".index(name[-1])].tolist())
        for i, name in enumerate(names)
    ]
    joints.append(J("carry", "revolute", "base", "seat", axis=(0.6, 0.0, 0.8)))
    independent = ["carry"] if kind == "weld" else ["carry", f"turn_{kind[-1]}"]
    declaration = {
        "closures": [{"frames": ["seat", links[-1]], "axes": list(AXES_OF[kind])}],
        "actuated": independent,
        "independent": {"joints": independent},
        "reference": {"joints": dict.fromkeys(independent, 0.0)},
        "characteristic_length": size,
    }
    return load_robot(write_robot(folder, urdf_of(joints), declaration))


def apart(robot: Robot, q: np.ndarray, kind: str) -> tuple[float, float]:
    """How far the frames are from each other, m, and by which angle they, or their hinges' axes, are turned away."""
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    ends = robot.closures[0].frame_a, robot.closures[0].frame_b
    a, b = (data.oMf[robot.model.getFrameId(name, pin.FrameType.BODY)] for name in ends)
    turn = a.rotation.T @ b.rotation
    if kind == "weld":
        return float(np.linalg.norm(a.translation - b.translation)), float(np.linalg.norm(pin.log3(turn)))
    k = "xyz".index(kind[-1])
    sine = np.linalg.norm(np.cross(turn[:, k], AXES[k]))
    return float(np.linalg.norm(a.translation - b.translation)), float(np.arctan2(sine, turn[k, k]))


@pytest.mark.parametrize("kind", AXES_OF)
@pytest.mark.parametrize("size", [0.25, 1.0, 4.0])
def test_frames_far_away_are_turned_together(tmp_path: Path, kind: str, size: float) -> None:
    """From anywhere within 1.2 rad and characteristic lengths, and never the wrong way round."""
    robot = arm(tmp_path, kind, size)
    system, rng = ConstraintSystem(robot), np.random.default_rng(4)
    for _ in range(12):
        one = assemble(system, rng.uniform(-1.2, 1.2, (1, robot.model.nq)) * position_unit(robot))
        reached, gap = one.q[0], one.residual[0]
        assert gap < CLOSED
        assert max(apart(robot, reached, kind)) < CLOSED


@pytest.mark.parametrize("kind", ["hinge about x", "hinge about y", "hinge about z"])
def test_hinges_that_are_opposite_turn_over(tmp_path: Path, kind: str) -> None:
    """Either way round; the sines of rows say that nothing is open there. Followers refuse such a configuration."""
    robot = arm(tmp_path, kind, 1.0)
    q = np.zeros(robot.model.nq)
    over = next(name for name in ("turn_z", "turn_y") if name[-1] != kind[-1])
    q[zoo.index(robot, over)] = np.pi
    assert apart(robot, q, kind)[1] == pytest.approx(np.pi)
    assert max(apart(robot, assemble(ConstraintSystem(robot), q[None]).q[0], kind)) < CLOSED
    own = follower(robot)
    assert own.close(own.home.q, own.home.x) is not None
    assert own.close(q, own.home.x) is None


def two_bars(folder: Path, end: tuple[float, float]) -> Robot:
    """Load two bars of 1 m, the first hinged to the base and the second to a place (x, y), m."""
    joints = [
        J("first", "revolute", "base", "one"),
        J("elbow", "revolute", "one", "two", (1.0, 0.0, 0.0)),
        J("end", "fixed", "two", "tip", (1.0, 0.0, 0.0)),
        J("place", "fixed", "base", "pin", (*end, 0.0)),
        J("other", "revolute", "base", "away", (0.0, 1.0, 0.0)),
    ]
    declaration = {
        "closures": [{"frames": ["tip", "pin"], "axes": ["x", "y"]}],
        "actuated": ["other"],
        "independent": {"joints": ["other"]},
        "redundant_rows": True,
        "reference": {"joints": {"other": 0.0}, "guess": {"first": 0.4, "elbow": -0.8}},
    }
    return load_robot(write_robot(folder, urdf_of(joints), declaration))


@pytest.mark.parametrize("target", [(1.0, 0.0), (-1.2, 0.0), (0.3, 0.0)])
def test_loops_that_no_step_leads_to_are_closed_from_beside(tmp_path: Path, target: tuple[float, float]) -> None:
    """The bars are stretched in line with where their end belongs: no small turn brings it nearer."""
    robot = two_bars(tmp_path, target)
    first, elbow = closed_near(robot, np.zeros(robot.model.nq))[[zoo.index(robot, name) for name in ("first", "elbow")]]
    end = np.array([np.cos(first) + np.cos(first + elbow), np.sin(first) + np.sin(first + elbow)])
    np.testing.assert_allclose(end, target, atol=1e-10)


def test_the_gap_that_is_left_is_what_bars_lack(tmp_path: Path) -> None:
    """Two hinges farther apart than both bars: stretched they lack the rest, in m."""
    with pytest.raises(DeclarationError, match="do not close") as caught:
        two_bars(tmp_path, (3.0, 0.0))
    # a gap is the largest part along an axis of the frame, which in a plane is no less than the whole over root 2
    assert 1.0 / np.sqrt(2.0) <= caught.value.details["residual"] <= 1.01


@pytest.mark.long_for("mode0", "mode1")
@pytest.mark.parametrize("mode", [(-1, -1, -1, -1, -1, -1), (1, -1, 1, 1, -1, -1), (-1, 1, 1, -1, 1, 1)])
def test_every_mode_of_six_legs_is_found_for_other_lengths(mode: tuple[int, ...]) -> None:
    """One random start in 64 falls to a given mode of six legs: they are put together leg by leg."""
    robot = load_robot("gough", base_radius=0.7, platform_radius=0.27, height=0.52, working_mode=mode)
    assembled = zoo.system_of(robot).evaluate(np.array(robot.q_reference)[None])
    assert np.abs(assembled.phi).max() < CLOSURE_TOLERANCE
    np.testing.assert_array_equal(working_modes(robot, np.array(robot.q_reference)[None])[0], mode)
    lengths = [robot.q_reference[zoo.index(robot, f"slide_{leg}")] for leg in range(1, 7)]
    np.testing.assert_array_equal(np.sign(lengths), mode)


# --- closing at a pose, Γ and its margin


# K of these machines has condition numbers below 1e3: the residual of its inverse stays below 1e3 roundings.


@pytest.mark.parametrize("name", zoo.SHIPPED)
def test_bad_guesses_end_closed_at_the_target_or_say_that_they_did_not(name: str) -> None:
    """Random guesses one radian (or metre) off. Plain Newton loses 3 to 13 % of them on all but the 2-RPR."""
    robot = zoo.robot_of(name)
    system, target = zoo.system_of(robot), np.repeat(zoo.home_of(robot)[None], 400, axis=0)
    assembled = assemble(system, zoo.random_tree(robot, 5, 400)[0], target)
    state = system.evaluate(assembled.q)
    away = difference(robot, target, coordinates(robot, state)) * row_scale(robot)
    off = np.concatenate([state.phi, away], axis=1)
    np.testing.assert_array_equal(assembled.closed, np.abs(off).max(axis=1) < CLOSURE_TOLERANCE)
    np.testing.assert_allclose(assembled.residual, np.abs(off).max(axis=1), atol=1e-15)
    assert assembled.closed.mean() > 0.975


def test_newton_ends_where_full_steps_would_run_in_circles() -> None:
    """From a nearly stretched leg a full Newton step throws the elbow over several turns; the line search does not."""
    robot = zoo.robot_of("five_bar")
    system = zoo.system_of(robot)
    stretched = assemble(system, robot.q_reference[None], np.array([[0.25, np.sqrt(1 - 0.25**2) - 1e-7]])).q
    target = np.array([[0.25, 0.3]])
    assembled = assemble(system, stretched, target)
    assert assembled.closed.all()
    state = system.evaluate(stretched)
    k = np.concatenate([state.Jc, state.Jx], axis=1)[0][:, system.pose_columns]
    residual = np.concatenate([-state.phi, target - coordinates(robot, state)], axis=1)[0]
    assert np.abs(np.linalg.solve(k, residual)).max() > 100 * np.pi  # the case is necessary
    # the elbows stay within a turn of where they were
    assert np.abs(assembled.q - stretched).max() < 2 * np.pi


def test_gap_out_of_reach_compares_with_geometry() -> None:
    """Both legs of the five-bar are short of the target; the rows of closure and target share the shortage.

    The largest of four rows is at least the larger shortage over two pairs of axes, 1 / (2√2) of it. The line search
    stops near the best; full steps would fling the legs about and leave nearly twice the shortage.
    """
    robot = zoo.robot_of("five_bar")
    rng = np.random.default_rng(0)
    angle, beyond = rng.uniform(0.2, np.pi - 0.2, 300), rng.uniform(0.05, 1.0, 300)
    target = [0.25, 0.0] + (1.25 + beyond)[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    short = np.stack([np.linalg.norm(target - hinge, axis=1) - 1.0 for hinge in ([0.0, 0.0], [0.5, 0.0])]).max(axis=0)
    assembled = assemble(zoo.system_of(robot), np.repeat(robot.q_reference[None], 300, axis=0), target)
    assert not assembled.closed.any()
    assert np.all(assembled.residual > short / (2 * np.sqrt(2)))
    assert np.all(assembled.residual < 1.1 * short)


def test_closing_alone_changes_the_guess_as_little_as_possible() -> None:
    """With neither target nor actuators the change is normal to the closed set, to second order in its length."""
    robot = zoo.robot_of("3rrr")
    system = zoo.system_of(robot)
    closed = zoo.random_closed(robot, 22, 5)
    push = np.zeros_like(closed)
    push[:, system.pose_columns] = 1e-4 * np.random.default_rng(1).uniform(-1, 1, (5, len(system.pose_columns)))
    assembled = assemble(system, closed + push)
    assert assembled.closed.all()
    change = assembled.q - closed - push
    jc = system.evaluate(assembled.q).Jc
    _, _, right = np.linalg.svd(jc[:, :, system.pose_columns])
    tangent = right[:, jc.shape[1] :]
    along = np.einsum("ntv,nv->nt", tangent, change[:, system.pose_columns])
    assert np.abs(change).max() > 1e-6
    assert np.abs(along).max() < 100 * 1e-4**2


def test_redundant_rows_still_close() -> None:
    """The hinge chain with its guess turned back and forth: rank-deficient steps are minimum-norm, not refused."""
    robot = zoo.robot_of("five_bar")
    system = zoo.system_of(robot)
    folded = np.array(robot.q_reference)
    for name in ("elbow_1", "elbow_2"):
        folded[zoo.index(robot, name)] = 0.0
    assembled = assemble(system, folded[None])
    assert assembled.closed.all()


def test_carriers_keep_their_positions() -> None:
    robot = zoo.robot_of("3rrr")
    guess = np.array(robot.q_reference)[None] + 0.01
    guess[0, robot.carrier_position] = [0.3, -0.2, 0.1]
    assembled = assemble(zoo.system_of(robot), guess, zoo.home_of(robot)[None])
    np.testing.assert_array_equal(assembled.q[0, robot.carrier_position], [0.3, -0.2, 0.1])


def test_the_search_finds_its_mode_from_any_guess() -> None:
    """From another mode, from angles a turn further, and where a characteristic length of 1 m looks like a radian."""
    plain = zoo.robot_of("3rrr")
    wound = np.array(plain.q_reference)
    wound[plain.actuated_velocity] += TURN
    for mode, guess, size in (
        (plain.working_mode, np.array(plain.q_reference), plain.characteristic_length),
        (plain.working_mode, wound, plain.characteristic_length),
        ((1, -1, 1), np.array(zoo.robot_of("3rrr", working_mode=(-1, 1, -1)).q_reference), plain.characteristic_length),
        ((-1, -1, -1), np.array(plain.q_reference), 1.0),
    ):
        robot = replace(plain, working_mode=mode, characteristic_length=size)
        (q, residual, in_mode), again = (multistart(ConstraintSystem(robot), guess, zoo.home_of(plain)) for _ in "ab")
        assert in_mode
        assert residual < CLOSURE_TOLERANCE
        np.testing.assert_array_equal(working_modes(robot, q[None])[0], mode)
        assert np.abs(q).max() <= np.pi
        np.testing.assert_array_equal(q, again.q)
        if mode == plain.working_mode:  # the nearest to the guess
            np.testing.assert_allclose(q, plain.q_reference, atol=1e-9)


@pytest.mark.parametrize(
    ("limits", "angle", "guess", "expected"),
    [
        # within half a turn, whatever the turn; half a turn itself is the positive one
        ((-10.0, 10.0), 1.0 + 2 * TURN, None, 1.0),
        ((-10.0, 10.0), -np.pi, None, np.pi),
        ((-10.0, 10.0), 4.0, None, 4.0 - TURN),
        # allowed as it is, also at the limit: the guess does not count
        ((1.0, 2.0), 2.0, 7.0, 2.0),
        # beyond a limit: the turn of the guess, where that is within
        ((-6.0, -3.5), TURN - 4.0, -4.5, -4.0),
        ((9.0, 14.0), 4.0, 10.0, 4.0 + TURN),
        ((3.5, 3.9), 4.0, 4.5, 4.0 - TURN),
        ((3.5, 4.0), 4.0, 4.0, 4.0),
    ],
)
def test_passive_angles_are_of_the_turn_that_is_allowed(limits, angle, guess, expected) -> None:
    robot = with_limits(zoo.robot_of("five_bar"), {"elbow_1": {"lower": limits[0], "upper": limits[1]}})
    at = zoo.index(robot, "elbow_1")
    q = np.array(robot.q_reference)
    q[at] = angle
    near = None if guess is None else np.array(robot.q_reference)
    if near is not None:
        near[at] = guess
    assert wrapped(robot, q[None], near)[0, at] == pytest.approx(expected, abs=1e-14)


def test_gamma_obeys_the_closures_and_the_margin_is_a_lower_bound(shipped: Robot) -> None:
    """Of the smallest singular value of K with velocities in m/s on both sides, within the root of its size."""
    system = zoo.system_of(shipped)
    assert not any(row.rotation for row in system.rows)  # closure rows are in m/s already
    closed = evaluated(system, zoo.random_closed(shipped, 11, 8))
    state, gamma = closed.state, closed.gamma
    np.testing.assert_allclose(state.Jc @ gamma, 0.0, atol=INVERSION)
    np.testing.assert_allclose(
        state.Jx @ gamma, np.broadcast_to(np.eye(shipped.n), (8, shipped.n, shipped.n)), atol=INVERSION
    )
    assert np.all(gamma[:, shipped.carrier_velocity] == 0.0)
    k = np.concatenate([state.Jc, state.Jx * row_scale(shipped)[:, None]], axis=1) / velocity_scale(shipped)
    smallest = np.linalg.svd(k[:, :, system.pose_columns], compute_uv=False).min(axis=1)
    assert np.all(closed.margin <= smallest * (1 + INVERSION))
    assert np.all(closed.margin >= smallest / np.sqrt(len(system.pose_columns)) * (1 - INVERSION))


def five_bar_at(height: float) -> np.ndarray:
    """Return a configuration of the five-bar on its axis of symmetry; both legs stretch together at the top."""
    robot = zoo.robot_of("five_bar")
    reach = np.sqrt(1.0 - 0.25**2)  # links of 0.5 m, hinges 0.5 m apart
    target = np.array([[0.25, reach - height]])
    return assemble(zoo.system_of(robot), robot.q_reference[None], target, max_iterations=200).q


@pytest.mark.parametrize("name", ["five_bar", "2rpr"])
def test_margin_is_zero_and_gamma_nan_at_a_type_i_singularity(name: str) -> None:
    robot = zoo.robot_of(name)
    system = zoo.system_of(robot)
    if name == "five_bar":
        singular = five_bar_at(0.0)
    else:  # the end-effector on the first base hinge: that leg has no direction
        singular = robot.q_reference[None].copy()
        slides = [zoo.index(robot, f"slide_{leg}") for leg in (1, 2)]
        swivel = zoo.index(robot, "swivel_2")
        singular[0, slides], singular[0, swivel] = (0.0, 0.5), np.pi
    assert np.abs(system.evaluate(singular).phi).max() < 1e-11
    both = np.concatenate([singular, robot.q_reference[None]])
    known = evaluated(system, both)
    assert known.margin[0] == 0.0
    assert np.isnan(known.gamma[0, system.pose_columns]).all()
    # the regular neighbour in the same stack is untouched
    alone = evaluated(system, robot.q_reference[None])
    np.testing.assert_allclose(known.gamma[1], alone.gamma[0], rtol=1e-12)
    assert known.margin[1] == pytest.approx(alone.margin[0])


@pytest.mark.parametrize("exponent", [-9.0, -6.5, -3.0])
def test_margin_falls_with_the_square_root_of_the_way_to_full_stretch(exponent: float) -> None:
    """cos of the elbow angle gives the reach, so the sine of the elbow, and the margin, goes with √height."""
    robot = zoo.robot_of("five_bar")
    system = zoo.system_of(robot)
    height = 10.0**exponent
    margin = evaluated(system, five_bar_at(height)).margin[0]
    unit = evaluated(system, five_bar_at(1e-4)).margin[0] / 1e-2
    # the next term of the expansion is of the relative order √height; Newton leaves the elbow off by 1e-11 / √height
    assert margin == pytest.approx(unit * np.sqrt(height), rel=0.1)
    assert margin > SINGULAR_MARGIN
