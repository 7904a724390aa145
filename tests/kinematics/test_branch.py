"""Following a branch: each step is on the branch of the start or refused, also where the closures lose rank."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import zoo
from change_point_oracle import change_point
from flat_linkages import Loop, parallelogram, random_loop, row_of_four_bars, several_on_one_crank
from folding import folding_four_bar, joint, rocker_angle, rocker_motion

import redundancy_pin as rp
from redundancy_pin.dynamics.compiled import CompiledDynamics
from redundancy_pin.dynamics.distribution import distribute
from redundancy_pin.dynamics.reactions import joint_reactions
from redundancy_pin.dynamics.rnea import RneaDynamics
from redundancy_pin.errors import InputError, SingularPoseError, WorkingModeError
from redundancy_pin.kinematics.branch import (
    BranchEnd,
    ClosedState,
    Follower,
    follower,
)
from redundancy_pin.kinematics.closed_state import NEAR_RANK_LOSS
from redundancy_pin.kinematics.coordinates import mode_indicator, with_independent_joints
from redundancy_pin.kinematics.inverse_kinematics import inverse_kinematics
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.robot import Payload
from redundancy_pin.singularities.classify import classify_motion
from redundancy_pin.status import SampleStatus


@pytest.mark.parametrize("independent", [{"joints": ["a", "b"]}, {"platform": "tip", "axes": ["x", "y"]}])
def test_a_chain_without_closures_is_followed(independent: dict[str, Any]) -> None:
    """Two links in a plane, whose tip is where trigonometry puts it."""
    model = pin.Model()
    for parent, name in enumerate("ab"):
        zoo.add_body(model, parent, pin.JointModelRZ(), float(parent), 0.0, name)
    model.addBodyFrame("tip", 2, pin.SE3(np.eye(3), np.array([0.8, 0.0, 0.0])), 0)
    reference = {"guess": {"a": 0.3, "b": 0.5}, **({} if "joints" in independent else {"platform": [1.5, 0.9]})}
    robot = rp.robot_from_model(model, actuated=["a", "b"], independent=independent, reference=reference)
    own = follower(robot)
    x = own.home.x + np.array([0.02, -0.01])
    reached = own.advance(own.home, x)
    assert isinstance(reached, ClosedState)
    a, b = reached.q
    tip = [np.cos(a) + 0.8 * np.cos(a + b), np.sin(a) + 0.8 * np.sin(a + b)]
    np.testing.assert_allclose([a, b] if "joints" in independent else tip, x, atol=1e-12)


def test_a_state_that_the_branch_contradicts_is_refused() -> None:
    own = follower(zoo.robot_of("3rrr"))
    x = own.home.x + np.array([0.01, 0.0, 0.0])
    assert own.step(own.home, x) is not None
    assert own.step(replace(own.home, gamma=3.0 * own.home.gamma), x) is None


def along(*x: float) -> np.ndarray:
    return np.array(x)


REACH = np.sqrt(1.0 - 0.25**2)
"""Height on the axis of symmetry at which both legs of the five-bar are stretched: 1 m legs, hinges 0.5 m apart."""


@pytest.mark.parametrize(
    ("x", "status"),
    [
        (along(0.25, 1.5), SampleStatus.UNREACHABLE),
        (along(0.25, REACH), SampleStatus.TYPE_I),
        (-0.5 * zoo.home_of(zoo.robot_of("five_bar")), SampleStatus.BRANCH_LOST),  # through the hinge of the first leg
        (along(np.nan, 0.5), SampleStatus.NOT_FINITE),
    ],
)
def test_a_branch_that_ends_says_why_and_where(x: np.ndarray, status: SampleStatus) -> None:
    own = follower(zoo.robot_of("five_bar"))
    end = own.advance(own.home, x)
    assert isinstance(end, BranchEnd)
    assert end.status is status
    assert not end.rank_lost
    np.testing.assert_array_equal(end.x, x)
    if status is SampleStatus.NOT_FINITE:
        return
    assert end.is_final == (status is not SampleStatus.BRANCH_LOST)
    # shared by the rows of closures and target: legs at 14.5° to the axis
    assert (end.residual > 0.1) == (status is SampleStatus.UNREACHABLE)
    way = x - own.home.x
    done = (end.last.x - own.home.x) @ way / (way @ way)
    assert 0.0 <= done < 1.0
    np.testing.assert_allclose(end.last.x, own.home.x + done * way, atol=1e-12)
    assert isinstance(own.advance(own.home, end.last.x), ClosedState)


def test_a_state_keeps_no_array_that_others_change() -> None:
    own = follower(zoo.robot_of("five_bar"))
    x = np.array(own.home.x) + 0.01
    states = own.close(own.home.q, x), own.step(own.home, x), own.singular_state(x, *map(np.array, (own.home.q, x)))
    x[0] = 9.0
    for state in states:
        assert state is not None
        assert state.x[0] == own.home.x[0] + 0.01
        assert not any(part.flags.writeable for part in (state.x, state.q, state.gamma, state.inverse))


@pytest.mark.parametrize("beside", [0.0, 1e-6, -1e-6])
def test_no_plain_step_leads_to_a_rank_loss(beside: float, tmp_path: Path) -> None:
    """Newton's rounding shows in the rates there; ``pass_through`` has the state and its rates, ``rates`` refuses."""
    robot = folding_four_bar(tmp_path, (0.4, 0.2, 0.35, 0.25), (1.0, 1.9, 1.5))
    own = follower(robot)
    before = own.advance(own.home, np.array([np.pi - 0.05]))
    assert isinstance(before, ClosedState)
    plain = own.step(before, np.array([np.pi + beside]))
    assert plain is None or plain.margin < own.near
    passed = own.pass_through(before, np.array([np.pi + beside]), np.ones(1), np.zeros(1))
    assert passed is not None
    assert passed.state.interpolated
    with pytest.raises(SingularPoseError, match="pass_through"):
        own.rates(passed.state, np.ones(1), np.zeros(1))


@pytest.mark.parametrize("length", [1.0, 2.0**5])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_step_across_a_rank_loss_stays_on_the_smooth_branch(length: float, side: float) -> None:
    """A parallelogram through its flat pose: coupler and crank go on turning against each other, in any unit."""
    robot = row_of_four_bars(1, crank=length, coupler=length)
    own = follower(robot)
    turn = np.array([1.0 if name.startswith("crank") else -1.0 for name in list(robot.model.names)[1:]])
    before = own.close(side * 0.03 * turn, np.array([side * 0.03]))
    assert before is not None
    assert before.margin == pytest.approx(0.03, rel=1.0)
    for goal in (-0.03, -0.01, 0.01, 0.0):
        reached = own.advance(before, np.array([side * goal]))
        assert isinstance(reached, ClosedState)
        np.testing.assert_allclose(reached.q, side * goal * turn, atol=1e-9)
        np.testing.assert_allclose(reached.gamma[:, 0], turn, atol=1e-7)


@pytest.mark.parametrize("excess", [1e-6, 1e-7, 1e-8, 1e-9])
@pytest.mark.parametrize("count", [2, 7, 40])
def test_no_branch_is_changed_where_two_nearly_touch(excess: float, count: int, tmp_path: Path) -> None:
    """The coupler stays on its side of a four-bar that misses its flat pose by a little: followed, or given up."""
    robot = folding_four_bar(tmp_path, (0.4, 0.2, 0.35, 0.25 + excess), (1.0, 1.9, 1.5))
    own, coupler = follower(robot), zoo.index(robot, "coupler")
    here = own.advance(own.home, np.array([np.pi - 0.02]))
    assert isinstance(here, ClosedState)
    side = np.sign(np.sin(here.q[coupler]))
    for angle in np.linspace(np.pi - 0.02, np.pi + 0.02, count)[1:]:
        reached = own.advance(here, np.array([angle]))
        if isinstance(reached, BranchEnd):
            break
        here = reached
        assert np.sign(np.sin(here.q[coupler])) == side


def test_states_and_coordinates_that_do_not_fit_are_refused() -> None:
    """Another shape, no pose, another robot, or the same tree and loops with other independent coordinates."""
    own, gough = follower(zoo.robot_of("five_bar")), follower(zoo.robot_of("gough"))
    home, short = own.home, along(0.4)
    for call in (own.advance, own.step, lambda here, x: own.pass_through(here, x, *np.zeros((2, 2)))):
        with pytest.raises(InputError, match=r"x has shape \(1,\), expected \(2,\)"):
            call(home, short)
    for call, message in (
        (lambda: own.close(home.q, short), r"x has shape \(1,\), expected \(2,\)"),
        (lambda: own.state_at(np.zeros(3)), r"q has shape \(3,\)"),
        (lambda: own.advance(home, home.x + 1j), "complex"),
        (lambda: own.rates(home, np.array(1.0), along(0.0, 0.0)), r"xd has shape \(\), expected \(2,\)"),
        (lambda: own.rates(home, along(0.0, 0.0), along(np.nan, 0.0)), "xdd has 1 value"),
    ):
        with pytest.raises(InputError, match=message):
            call()
    for factor in (np.diag([2.0, 2.0, 2.0, 1.0]), np.diag([1.0, 1.0, -1.0, 1.0]), 2.0 * np.eye(4)):
        with pytest.raises(InputError, match="not a homogeneous pose"):
            gough.advance(gough.home, gough.home.x @ factor)
    motion = rp.PlatformMotion([0.0], home.x[None], *np.zeros((2, 1, 2)))
    for name in ("delta", "four_bar"):
        other = follower(zoo.robot_of(name)).home
        for go_on in (own.advance, own.follow, own.step):
            with pytest.raises(InputError, match=f"{name}.*five_bar"):
                go_on(other, home.x)
        with pytest.raises(InputError, match=f"{name}.*five_bar"):
            inverse_kinematics(own.robot, motion, start=other, mark_unreachable=True)
    driven = follower(with_independent_joints(own.robot, own.robot.actuated))
    with pytest.raises(InputError, match="no closed state"):
        driven.advance(home, driven.home.x)
    loaded = follower(own.robot.loaded(Payload("end_effector", 1.0)))
    assert isinstance(loaded.advance(home, loaded.home.x + 0.01), ClosedState)


# --- poses where the closures lose rank: the branch goes on with its tangent


POSITION = 1e-12
RATE = 1e-9
"""What Newton's rounding leaves next to the pose, and the eighth-order differences of the closed form."""
ACCELERATION = 1e-7

PARALLELOGRAM = (0.3, 0.2, 0.3, 0.2)
LINKAGES = {
    "folding": ((0.4, 0.2, 0.35, 0.25), (1.0, 1.9, 1.5)),
    "parallelogram": (PARALLELOGRAM, (1.0, 1.0, 2.0)),
    "antiparallelogram": (PARALLELOGRAM, (1.0, -2.5, -2.0)),
    "equal sides": ((0.3, 0.3, 0.3, 0.3), (1.0, 1.0, 2.0)),
    "kite": ((0.3, 0.2, 0.2, 0.3), (1.0, 2.0, 2.0)),
}
SAMPLES = {
    "one at the pose": np.linspace(-1.0, 1.0, 101),
    "back, one at the pose": np.linspace(1.0, -1.0, 101),
    "one beside it": np.linspace(-1.0, 1.0, 101) + 3e-7,
    "one a little further": np.linspace(-1.0, 1.0, 101) + 2e-4,
    "coarse": np.linspace(-1.0, 1.0, 10) + 0.033,
    "dense": np.linspace(-2e-2, 2e-2, 401),
    "from the pose on": np.linspace(0.0, 1.0, 51),
    "at the pose alone": np.zeros(2),
    "to the pose from afar": np.array([-2.0, 0.0]),
    "to the pose from the other side": np.array([0.3 - np.pi, 0.0]),
}
RATE_OF_CRANK, SECOND_RATE = 2.0, 0.7


def turning(crank: np.ndarray) -> PlatformMotion:
    size = (len(crank), 1)
    t = np.arange(len(crank)) * 0.01
    return PlatformMotion(t, crank[:, None], np.full(size, RATE_OF_CRANK), np.full(size, SECOND_RATE))


@pytest.mark.parametrize(
    ("modes", "mark"),
    [
        (True, False),
        *(pytest.param(*both, marks=pytest.mark.long) for both in ((False, False), (False, True), (True, True))),
    ],
)
@pytest.mark.parametrize(
    ("linkage", "samples"),
    [  # every linkage, and every kind of samples, once in make test
        pytest.param(
            linkage,
            samples,
            marks=() if linkage == "parallelogram" or i == k or (i, k) in ((0, 8), (0, 9)) else pytest.mark.long,
        )
        for i, linkage in enumerate(LINKAGES)
        for k, samples in enumerate(SAMPLES)
    ],
)
def test_a_four_bar_goes_through_its_flat_pose_on_its_branch(
    linkage: str, samples: str, modes: bool, mark: bool, tmp_path: Path
) -> None:
    lengths, guess = LINKAGES[linkage]
    offsets = SAMPLES[samples]
    # behind the pose a declared mode is on the other branch: start on the side where the reference is
    if modes and offsets[0] > 0.0:
        guess = (guess[0] + 4.0, guess[1] + 3.0, guess[2])
    robot = folding_four_bar(tmp_path, lengths, guess, modes=modes)
    motion = turning(np.pi + offsets)
    tree = inverse_kinematics(robot, motion, mark_unreachable=mark)
    angle, rate, second = rocker_motion(robot, lengths, motion.x[:, 0], motion.xd[:, 0], motion.xdd[:, 0])
    rocker = joint(robot, "rocker")
    assert tree.reachable.all()
    assert tree.residual.max() < 1e-14
    assert np.abs(np.sin((tree.q[:, rocker] - angle) / 2.0)).max() < POSITION
    assert np.abs(tree.v[:, rocker] - rate).max() < RATE
    assert np.abs(tree.a[:, rocker] - second).max() < ACCELERATION
    np.testing.assert_allclose(tree.v, np.einsum("nvi,ni->nv", tree.gamma, motion.xd), atol=RATE)


@pytest.mark.long_for("1e-06-501", "1e-06-51", "1e-08-501", "1e-08-10", "1e-08-51", "1e-10-501", "1e-10-10")
@pytest.mark.parametrize("samples", [10, 51, 501])
@pytest.mark.parametrize("excess", [1e-2, 1e-4, 1e-6, 1e-8, 1e-10])
def test_branches_that_all_but_touch_are_not_taken_for_one_another(samples: int, excess: float, tmp_path: Path) -> None:
    """Longer by so little, the linkage comes within its root of the flat pose and turns back: no tangent crosses."""
    (g, a, b, c), guess = LINKAGES["folding"]
    lengths = (g, a, b, c + excess)
    robot = folding_four_bar(tmp_path, lengths, guess)
    side = np.sign(np.sin(robot.q_reference[joint(robot, "coupler")]))
    motion = turning(np.linspace(np.pi - 1.0, np.pi + 1.0, samples))
    tree = inverse_kinematics(robot, motion)
    assert (np.sign(np.sin(tree.q[:, joint(robot, "coupler")])) == side).all()
    home = np.array([robot.q_reference[joint(robot, "crank")]])
    sign = min(
        (1, -1),
        key=lambda s: abs(np.sin(rocker_angle(lengths, s)(home)[0] - robot.q_reference[joint(robot, "rocker")])),
    )
    # at the tightest turn Newton knows the angle to rounding over the root of the excess
    error = np.sin((tree.q[:, joint(robot, "rocker")] - rocker_angle(lengths, sign)(motion.x[:, 0])) / 2.0)
    assert np.abs(error).max() < 1e-15 / np.sqrt(excess) * 10.0 + 1e-12


def test_reactions_are_not_made_up_where_the_closures_determine_none(tmp_path: Path) -> None:
    """Flat, the linkage can be prestressed: closure forces are undetermined, and least squares would hide it."""
    robot = folding_four_bar(tmp_path, *LINKAGES["folding"])
    along = RneaDynamics(robot).along(turning(np.pi + np.linspace(-0.5, 0.5, 5)))
    assert classify_motion(along.tree, tolerance=1e-7).type_i.tolist() == [False, False, True, False, False]
    reactions = joint_reactions(along, distribute(along.reduce()).tau)
    assert np.isnan(reactions.closure_force).any(axis=1).tolist() == [False, False, True, False, False]
    assert np.isnan(reactions.joint_wrench).any(axis=(1, 2)).tolist() == [False, False, True, False, False]
    # the tangent of the other branch is a virtual motion too there, and nothing balances the forces along it
    assert (reactions.residual < 1e-9).tolist() == [True, True, False, True, True]


def test_a_crank_beyond_half_a_turn_starts_in_its_mode(tmp_path: Path) -> None:
    """Multistart keeps the turn of the joint that the motion prescribes."""
    robot = folding_four_bar(tmp_path, *LINKAGES["folding"], modes=True)
    tree = inverse_kinematics(robot, turning(np.linspace(4.1, 4.2, 5)))
    np.testing.assert_allclose(tree.q[:, joint(robot, "crank")], tree.motion.x[:, 0], atol=POSITION)
    assert (mode_indicator(robot, tree.q) > 0.0).all()


def flat_sides(robot: rp.Robot, offset: float) -> list[list[ClosedState]]:
    """Return the points before and behind the flat pose with the coupler on either side: [before, behind][side]."""
    own, coupler, sides = follower(robot), joint(robot, "coupler"), []
    for crank in (np.pi - offset, np.pi + offset):
        both = np.array(sorted(rp.assembly_modes(robot, [crank]).q, key=lambda q: -np.sin(q[coupler])))
        both[:, joint(robot, "crank")] = crank
        sides.append([own.close(q, np.array([crank])) for q in both])
    return sides


@pytest.mark.parametrize("excess", [1e-3, 1e-5, 1e-7, 0.0])
def test_only_a_smooth_branch_through_a_rank_loss_is_a_crossing(excess: float, tmp_path: Path) -> None:
    """The coupler changes over where the linkage folds flat; where it almost does, no branch leads there."""
    g, a, b, c = LINKAGES["folding"][0]
    robot = folding_four_bar(tmp_path, (g, a, b, c + excess), LINKAGES["folding"][1])
    before, behind = flat_sides(robot, 0.02)
    own = follower(robot)
    for side in (0, 1):
        assert own.crosses(before[side], behind[1 - side]) == (excess == 0.0)
        assert not own.crosses(before[side], behind[side])
        assert not own.crosses(before[side], replace(before[side], x=before[side].x + 1e-3))


@pytest.mark.parametrize("beside", [1e-1, 1e-2, 1e-3])
def test_a_reference_beside_a_pose_where_three_loops_are_flat_costs_no_digits(beside: float) -> None:
    """Parallelograms side by side: all cranks turn alike, couplers against them."""
    robot = row_of_four_bars(3)
    turn = np.array([1.0 if name.startswith("crank") else -1.0 for name in list(robot.model.names)[1:]])
    robot = replace(robot, q_reference=beside * turn)
    assert follower(robot).near == NEAR_RANK_LOSS
    crank = np.linspace(beside, -1.02 * beside, 41)[:, None]
    rate = np.ones_like(crank)
    tree = inverse_kinematics(robot, PlatformMotion(np.arange(41.0), crank, 2.0 * rate, 3.0 * rate, check_rates=False))
    for values, expected in ((tree.q, crank * turn), (tree.v, 2.0 * rate * turn), (tree.a, 3.0 * rate * turn)):
        np.testing.assert_allclose(values, expected, atol=1e-6)


def random_crank(seed: int) -> tuple[list[Loop], float, np.ndarray]:
    """Return one to three loops with flat poses up to 0.3 rad apart, the crank's angle at the reference, and angles."""
    rng = np.random.default_rng(seed)
    apart = 10.0 ** rng.uniform(-4.0, -0.5) if rng.random() < 0.9 else 0.0
    loops = [random_loop(rng, float(apart * turn)) for turn in (0.0, *rng.uniform(-1.0, 1.0, seed % 3))]
    start, count = float(rng.uniform(0.7, 2.4)), int(rng.choice([51, 401, 2001]))
    first, last = start, start - float(rng.uniform(2.5, 5.0))
    if rng.random() < 0.3:
        first = float(rng.uniform(1e-3, 0.2))
        last = -first
    return loops, start, np.linspace(first, last, count)


def require_closed_form(
    loops: list[Loop], start: float, crank: np.ndarray, dynamics: type[RneaDynamics | CompiledDynamics] = RneaDynamics
) -> bool:
    """Judge configurations and efforts by each loop's branch; return whether the motion was taken."""
    robot = several_on_one_crank(loops, start)
    second, size = 0.7, (len(crank), 1)
    rate = (crank[-1] - crank[0]) * 1.0
    motion = PlatformMotion(
        np.linspace(0.0, 1.0, len(crank)), crank[:, None], np.full(size, rate), np.full(size, second), check_rates=False
    )
    try:
        reduced = dynamics(robot).along(motion).reduce()
    except (SingularPoseError, WorkingModeError):
        return False
    effort = np.full(len(crank), second * (1.0 - len(loops)) / 3.0)  # each loop's inertia has the crank's in it
    tree = inverse_kinematics(robot, motion) if dynamics is RneaDynamics else None
    for i, (coupler, rocker, ground, towards, side) in enumerate(loops):
        branch = change_point((1.0, coupler, rocker, ground), side)
        inertia, slope = (np.array(part((crank - towards)[None])).ravel() for part in (branch.inertia, branch.slope))
        effort += inertia * second + 0.5 * slope * rate**2
        if tree is not None:
            ends = np.array(branch.angles((crank - towards)[None])).T
            turned = np.exp(1j * (tree.q[:, joint(robot, f"rocker_{i}")] - towards))
            np.testing.assert_allclose(turned, ends[:, 0] + 1j * ends[:, 1], atol=NEAR_RANK_LOSS * 1e-6)
    np.testing.assert_allclose(reduced.f[:, 0], effort, atol=SHARE * np.abs(effort).max())
    return True


SHARE = 1e-5
"""Of the largest effort: what rounding may take next to a rank loss before a pose is refused."""


def test_a_branch_with_a_kink_halfway_between_two_poses_is_not_taken_for_the_smooth_one() -> None:
    """The trapezoidal rule does not tell them apart there, and no determinant changes its sign on it."""
    loop = 0.5701468583888362, 1.0, 0.5701468583888362, 0.0, -1
    crank = np.linspace(1.7852898927714493, -2.7920864903877467, 51)
    assert require_closed_form([loop], float(crank[0]), crank)


@pytest.mark.parametrize("seed", [109, pytest.param(164, marks=pytest.mark.long)])
def test_two_loops_that_are_flat_within_one_step_stay_on_their_branches(seed: int) -> None:
    """The sign of the determinant of all rows is the same behind both."""
    assert require_closed_form(*random_crank(seed))


@pytest.mark.parametrize("beside", [0.0, 1e-4, 5e-3])
def test_a_loop_that_rests_at_or_beside_its_flat_pose_while_another_goes_through(beside: float) -> None:
    robot, turning = parallelogram("second"), np.linspace(0.05, -0.05, 11)
    x = np.stack([turning, np.full(11, beside)], axis=1)
    t = np.linspace(0.0, 1.0, 11)
    xd, xdd = np.tile([-0.1, 0.0], (11, 1)), np.tile([0.7, -0.3], (11, 1))
    tree = inverse_kinematics(robot, PlatformMotion(t, x, xd, xdd, check_rates=False))
    for name, column, sign in (("crank_1", 0, 1.0), ("coupler_1", 0, -1.0), ("second_1", 1, 1.0), ("beam", 1, -1.0)):
        at = joint(robot, name)
        np.testing.assert_allclose(tree.q[:, at], sign * x[:, column], atol=POSITION)
        np.testing.assert_allclose(tree.v[:, at], sign * xd[:, column], atol=RATE)
        np.testing.assert_allclose(tree.a[:, at], sign * xdd[:, column], atol=1e-5)


@pytest.mark.parametrize("length", [2.0**-6, 1.0, 2.0**6])
@pytest.mark.parametrize(("rate", "second", "nearest"), [(0.0, 0.0, 1e-5), (1e-9, 1.0, 1e-5), (-1.0, 0.0, 1e-3)])
def test_how_near_a_rank_loss_may_be_is_an_angle_in_any_unit_of_length(
    length: float, rate: float, second: float, nearest: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of Γ rounding takes 1e-16 over the square of the angle, of accelerations by rates 1e-16 over its cube.

    Of either 1e-5 is too much: at 3e-6 and at 2e-4, but for a factor of what the margin is per angle.
    """
    monkeypatch.setattr(Follower, "pass_through", lambda *_: None)
    robot = row_of_four_bars(1, crank=length, coupler=length)
    for beside, taken in ((0.01 * nearest, False), (0.1 * nearest, False), (nearest, True), (10.0 * nearest, True)):
        rates = np.full((2, 1), rate), np.full((2, 1), second)
        motion = PlatformMotion(np.array([0.0, 1.0]), np.array([[1.0], [beside]]), *rates, check_rates=False)
        if taken:
            assert inverse_kinematics(robot, motion).q[1, 1] == pytest.approx(-beside, abs=1e-9)
        else:
            with pytest.raises(SingularPoseError, match=r"sample 1 \(t = 1 s, x = .* the closures lose rank"):
                inverse_kinematics(robot, motion)


@pytest.mark.long
def test_random_loops_on_one_crank_are_right_or_refused() -> None:
    assert sum(require_closed_form(*random_crank(seed)) for seed in range(300)) >= 285


@pytest.mark.long
def test_machine_code_is_right_there_or_refuses() -> None:
    """It carries nothing across a rank loss."""
    assert sum(require_closed_form(*random_crank(seed), CompiledDynamics) for seed in range(200)) >= 20


def test_a_step_follows_if_it_is_what_the_trapezoidal_rule_predicts() -> None:
    """q̇ = Γ ẋ with Γ = 1 and then 3: an increment of 0.1 moves q by 0.2, not back, by nothing, or thrice as far."""
    robot = zoo.robot_of("five_bar")
    nv = robot.model.nv
    gamma0, gamma1, increment = np.full((nv, 1), 1.0), np.full((nv, 1), 3.0), np.full(1, 0.1)
    for step, follows in ((0.2, True), (-0.2, False), (0.0, False), (0.6, False)):
        assert follower(robot).is_continuous(np.full(nv, step), gamma0, gamma1, increment) == follows
