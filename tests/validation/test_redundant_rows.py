"""Mechanisms that move against Grübler's count: closed in all rows, no false singularities, reactions of least norm."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from closed_forward import ClosedForward
from scipy.integrate import solve_ivp

import redundancy_pin as rp
from redundancy_pin.errors import DeclarationError, UnreachablePoseError
from redundancy_pin.kinematics.branch import follower
from redundancy_pin.planners.intersample_check import closure_rank_losses
from redundancy_pin.singularities.classify import SingularityKind
from redundancy_pin.trajectory.continuous_motion import as_motion

CLOSED = 1e-10
"""m and rad, ten roundings of Newton's method."""

ALPHA, BETA = np.deg2rad(60.0), np.deg2rad(100.0)
RATIO = np.sin(0.5 * (BETA + ALPHA)) / np.sin(0.5 * (BETA - ALPHA))
"""Bennett: tan(θ₁/2) tan(θ₂/2) of opposite equal links, a / sin α = b / sin β."""

LENGTHS = [1.0, np.sin(BETA) / np.sin(ALPHA)]


@pytest.fixture(scope="module")
def bennett():
    """Four hinges, three of the six rows of its weld redundant, which three changes along the motion."""
    model, parent, place = pin.Model(), 0, pin.SE3.Identity()
    for i, (length, twist) in enumerate(zip(2 * LENGTHS, 2 * [ALPHA, BETA], strict=True)):
        parent = model.addJoint(parent, pin.JointModelRZ(), place, f"hinge_{i + 1}")
        body = pin.Inertia(1.0, np.array([0.5 * length, 0.0, 0.0]), np.diag([0.005, 0.05, 0.05]))
        model.appendBodyToJoint(parent, body, pin.SE3.Identity())
        place = pin.SE3(pin.utils.rotate("x", twist), np.array([length, 0.0, 0.0]))
    weld = pin.FrameAnchorConstraintModel(model, 0, pin.SE3.Identity(), parent, place)
    first, second = 0.7, 2.0 * np.arctan(RATIO / np.tan(0.35))
    start = np.array([first, second, -first, -second])
    return rp.robot_from_model(model, closures=[weld], actuated=["hinge_1"], reference=start)


def open_by(robot, q):
    """The weld's error by Pinocchio's own logarithm."""
    model, closure = robot.model, robot.all_closures[0]
    data, worst = model.createData(), 0.0
    for one in q:
        pin.framesForwardKinematics(model, data, np.array(one))
        ends = [data.oMf[model.getFrameId(name)] for name in (closure.frame_a, closure.frame_b)]
        worst = max(worst, float(np.abs(pin.log6(ends[0].actInv(ends[1])).vector).max()))
    return worst


def least_of_all_rows(robot, q):
    """Return the smallest singular value of Pinocchio's rows of the weld, all six, over that of the first hinge."""
    model, closure = robot.model, robot.all_closures[0]
    frame, world = model.getFrameId(closure.frame_b), pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    rows = pin.computeFrameJacobian(model, model.createData(), np.array(q), frame, world)  # the other end is at rest
    first = [name == robot.independent_joints[0] for name in list(model.names)[1:]]
    return np.linalg.svd([*rows[:3] / robot.characteristic_length, *rows[3:], first], compute_uv=False)[-1]


@pytest.fixture(scope="module")
def turn(bennett):
    """Most of a turn of the first hinge, past two places where the rows that count lose rank, and at one of them."""
    path = rp.trajectory.from_points([[0.7], [np.pi + 0.01], [5.5]], [0.0, 0.5, 1.0], ends="rest")
    return rp.RneaDynamics(bennett).along(path.sample(0.01))


def test_all_rows_stay_closed_along_bennetts_law(bennett, turn):
    assert sum(len(closure.axes) for closure in bennett.closures) == 3
    assert [closure.axes for closure in bennett.all_closures] == [("x", "y", "z", "rx", "ry", "rz")]
    q = turn.tree.q
    assert open_by(bennett, q) < CLOSED
    np.testing.assert_allclose(np.tan(0.5 * q[:, 0]) * np.tan(0.5 * q[:, 1]), RATIO, rtol=1e-9)


def test_rows_that_others_make_up_for_are_no_singularities(bennett, turn):
    margin = np.abs(turn.closure_margin())
    assert margin.min() < 0.02 * margin.max()  # of the rows that count
    for robot, counts in ((bennett, (5, len(turn.motion))), (three_cranks(1.0), (12,))):
        dynamics, turns = rp.RneaDynamics(robot), as_motion(turn.motion)
        for count in counts:  # however far apart the samples are
            along = dynamics.along(turns.sample_at(np.linspace(turns.start, turns.end, count)))
            assert closure_rank_losses(dynamics, along, turns) == ()
    assert rp.find_crossings(bennett, turn.motion) == ()
    at = rp.classify(bennett, turn.tree.q)
    assert set(at.kind) == {SingularityKind.REGULAR}
    assert at.serial_margin.min() > 0.1 * at.serial_margin.max()
    np.testing.assert_allclose(at.serial_margin, [least_of_all_rows(bennett, q) for q in turn.tree.q], rtol=1e-9)
    run = rp.simulate(bennett, duration=1.5, dt=0.05)
    assert (run.status.value, run.events) == ("ok", ())
    assert max(run.gap.max(), open_by(bennett, run.q)) < CLOSED
    assert np.ptp(run.q[:, 0]) > 3.0
    assert np.ptp(run.energy) < 1e-7


def test_rates_where_all_rows_serve_are_derivatives_of_bennetts_law(bennett):
    """Near a place where the independent rows lose rank: θ₂(θ₁) = 2 atan(RATIO / tan(θ₁/2)), differentiated twice."""
    own = follower(bennett)
    here, served = own.home, 0
    for angle in np.linspace(0.7, 5.5, 97):
        here = own.advance(here, np.array([angle]))
        if here.basis is None:
            continue
        served += 1
        tangent = np.tan(0.5 * angle)
        size = RATIO**2 + tangent**2
        slope = -RATIO * (1.0 + tangent**2) / size
        bend = -RATIO * tangent * (1.0 + tangent**2) * (RATIO**2 - 1.0) / size**2
        _, v, a = own.rates(here, np.array([2.0]), np.array([3.0]))
        np.testing.assert_allclose(v, 2.0 * np.array([1.0, slope, -1.0, -slope]), atol=1e-8)
        second = 4.0 * bend + 3.0 * slope
        np.testing.assert_allclose(a, [3.0, second, -3.0, -second], atol=1e-7)
    assert served >= 3


def test_reactions_of_redundant_rows_are_of_least_norm(bennett, turn):
    """λ of least norm by Pinocchio's frames, moments divided by the characteristic length."""
    tau = rp.distribute(turn.reduce()).tau
    reactions = rp.joint_reactions(turn, tau)
    assert reactions.closures == tuple(f"{axis} of constraint_1" for axis in ("x", "y", "z", "rx", "ry", "rz"))
    assert reactions.residual.max() < 1e-9
    scale = np.repeat([1.0, bennett.characteristic_length], 3)
    rows, (q, v, a) = ClosedForward(replace(bennett, closures=bennett.all_closures)), turn.tree_motion()
    data = bennett.model.createData()
    for k in range(0, len(tau), 10):
        J, _ = rows.rows(q[k], v[k])
        effort = pin.rnea(bennett.model, data, q[k], v[k], a[k]) - np.append(tau[k], np.zeros(3))
        least = scale * (np.linalg.pinv((scale[:, None] * J).T, rcond=1e-9) @ effort)
        np.testing.assert_allclose(reactions.closure_force[k], least, atol=1e-8)


def test_a_closure_that_is_said_twice_shares_its_forces(bennett):
    """All rows of the second are redundant."""
    roles = {"actuated": ["hinge_1"], "reference": np.array(bennett.q_reference)}
    first = pin.FrameAnchorConstraintModel(bennett.model, *_ends(bennett))
    once, twice = (rp.robot_from_model(bennett.model, closures=[first] * n, **roles) for n in (1, 2))
    assert [len(each.axes) for each in twice.all_closures] == [6, 6]
    motion = rp.PlatformMotion([0.0], [[1.0]], [[2.0]], [[3.0]])
    forces = []
    for robot in (once, twice):
        along = rp.RneaDynamics(robot).along(motion)
        forces.append(rp.joint_reactions(along, rp.distribute(along.reduce()).tau).closure_force[0])
    np.testing.assert_allclose(forces[1], 0.5 * np.tile(forces[0], 2), atol=1e-9)


def _ends(robot):
    """Joints and placements of the weld's frames."""
    frames = [robot.model.frames[robot.model.getFrameId(f"constraint_1_{end}")] for end in "ab"]
    return (part for frame in frames for part in (frame.parentJoint, frame.placement))


def test_redundant_rows_are_allowed_by_name(bennett):
    """Else they are refused."""
    roles = {"actuated": ["hinge_1"], "independent": ["hinge_1"], "reference": np.array(bennett.q_reference)}
    closures = [("constraint_1_a", "constraint_1_b", ["x", "y", "z", "rx", "ry", "rz"])]
    with pytest.raises(DeclarationError, match=r"over-constrained.*redundant: .*redundant_rows: true"):
        rp.robot_from_model(bennett.model, closures=closures, **roles)
    free = rp.robot_from_model(bennett.model, closures=closures, redundant_rows=True, **roles)
    assert len(free.all_closures[0].axes) == 6


def test_rows_that_open_are_noticed():
    """A row that is not redundant put among those that were left out: the angle at a pin of a four-bar."""
    bar = rp.load_robot("four_bar")
    model, (pin_joint,) = pin.Model(bar.model), bar.closures
    data = model.createData()
    pin.framesForwardKinematics(model, data, np.array(bar.q_reference))
    first, second = (model.getFrameId(name) for name in (pin_joint.frame_a, pin_joint.frame_b))
    link = model.frames[second].parentJoint
    place = data.oMi[link].actInv(pin.SE3(data.oMf[first].rotation, data.oMf[second].translation))
    model.addFrame(pin.Frame("turned", link, 0, place, pin.FrameType.BODY))
    pinned = replace(pin_joint, frame_b="turned")
    bar = replace(bar, model=model, closures=(pinned,), all_closures=(replace(pinned, axes=("x", "y", "rz")),))
    t, home = np.linspace(0.0, 1.0, 11)[:, None], bar.q_reference[0]
    motion = rp.PlatformMotion(t[:, 0], home + t, np.ones_like(t), np.zeros_like(t))
    assert rp.inverse_kinematics(bar, motion[:1]).reachable.all()
    with pytest.raises(UnreachablePoseError, match=r"of sample 1 .*stay open by"):
        rp.inverse_kinematics(bar, motion)
    with pytest.raises(UnreachablePoseError, match="stay open by"):
        rp.inverse_kinematics(bar, motion[-1:])
    assert rp.inverse_kinematics(bar, motion, mark_unreachable=True).reachable.tolist() == [True] + 10 * [False]
    run = rp.simulate(bar, duration=0.5)
    assert run.status.value == "not_converged"
    assert "the closures leave a gap" in run.reason
    assert run.gap.max() > 1e-5


CRANK, PIVOTS = 0.4, np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.45, 0.7, 0.0]])
BODIES = [(1.0, np.array([0.2, 0.0, 0.0])), (2.0, np.array([0.2, 0.02, 0.0])), (3.0, np.array([0.2, 0.04, 0.0]))]
PLATE, INERTIA = 3.0, 0.02


def three_cranks(angle, length=CRANK, wrong=0.0):
    """A plate on three equal cranks: four rows of rank three; those of two cranks lose it twice a turn, all never.

    ``wrong``: how much longer the third is, as in a file of rounded numbers.
    """
    model = pin.Model()
    model.gravity = pin.Motion(np.array([0.0, -9.81, 0.0]), np.zeros(3))
    tip, cranks = pin.SE3(np.eye(3), np.array([length, 0.0, 0.0])), []
    for i, (mass, centre) in enumerate(BODIES):
        cranks.append(model.addJoint(0, pin.JointModelRZ(), pin.SE3(np.eye(3), PIVOTS[i]), f"crank_{i + 1}"))
        model.appendBodyToJoint(cranks[i], pin.Inertia(mass, centre, INERTIA * np.eye(3)), pin.SE3.Identity())
        end = tip * pin.SE3(np.eye(3), np.array([wrong * (i == 2), 0.0, 0.0]))
        model.addFrame(pin.Frame(f"end_{i + 1}", cranks[i], end, pin.FrameType.OP_FRAME))
    plate = model.addJoint(cranks[0], pin.JointModelRZ(), tip, "plate")
    model.appendBodyToJoint(plate, pin.Inertia(PLATE, np.array([0.5, 0.3, 0.0]), np.eye(3)), pin.SE3.Identity())
    closures = []
    for i in (1, 2):
        model.addFrame(pin.Frame(f"pin_{i + 1}", plate, pin.SE3(np.eye(3), PIVOTS[i]), pin.FrameType.OP_FRAME))
        closures.append((f"pin_{i + 1}", f"end_{i + 1}", ["x", "y"]))
    start = {f"crank_{i}": angle for i in (1, 2, 3)} | {"plate": -angle}
    q = np.zeros(model.nq)
    for name, value in start.items():
        q[model.joints[model.getJointId(name)].idx_q] = value
    return rp.robot_from_model(
        model, closures=closures, actuated=["crank_1"], independent=["crank_1"], reference=q, redundant_rows=True
    )


def torque_of_three_cranks(angle, acceleration):
    """The plate translates with the tips: I α + m g dy/dθ of every body."""
    torque = PLATE * (CRANK**2 * acceleration + 9.81 * CRANK * np.cos(angle))
    for mass, (x, y, _) in BODIES:
        torque = torque + (INERTIA + mass * (x * x + y * y)) * acceleration
        torque = torque + mass * 9.81 * (x * np.cos(angle) - y * np.sin(angle))
    return torque


@pytest.mark.parametrize("angle", [0.3, 1.0, 2.0, 4.0])
@pytest.mark.parametrize("turns", [1.0, -1.0])
def test_which_rows_count_is_chosen_along_the_motion(angle, turns):
    """Through the poses at which one pair of cranks is stretched, where the rows chosen at the reference lose rank."""
    robot, t = three_cranks(angle), np.linspace(0.0, 1.0, 201)
    assert sum(len(closure.axes) for closure in robot.closures) == 3
    x = angle + 2.0 * np.pi * turns * t + 0.75 * t**2
    sides = np.array([PIVOTS[1], PIVOTS[2], PIVOTS[2] - PIVOTS[1]])
    flat = (np.arctan2(sides[:, 1], sides[:, 0])[:, None] + np.pi * np.arange(-4, 5)).ravel()
    x = np.unique(np.concatenate([x, flat[(flat > x.min()) & (flat < x.max())]]))[:: int(turns)]
    xd, xdd = np.full_like(x, 3.0 * turns), np.full_like(x, 1.5)
    times, parts = np.linspace(0.0, 1.0, len(x)), [part[:, None] for part in (x, xd, xdd)]
    along = rp.RneaDynamics(robot).along(rp.PlatformMotion(times, *parts, check_rates=False))
    for name, sign in (("crank_1", 1.0), ("crank_2", 1.0), ("crank_3", 1.0), ("plate", -1.0)):
        joint = robot.model.joints[robot.model.getJointId(name)]
        np.testing.assert_allclose(along.tree.q[:, joint.idx_q], sign * x, atol=CLOSED)
        np.testing.assert_allclose(along.tree.a[:, joint.idx_v], sign * 1.5, atol=1e-9)
    want = torque_of_three_cranks(x, 1.5)
    np.testing.assert_allclose(along.reduce().f[:, 0], want, atol=1e-10 * np.abs(want).max())


def test_platforms_move_where_two_cranks_are_in_line():
    """The rows chosen at the reference lose rank there, and all rows do not: the first crank drives as everywhere."""
    robot = three_cranks(1.0)
    sides = [PIVOTS[1], PIVOTS[2], PIVOTS[2] - PIVOTS[1]]
    q = [np.zeros(robot.model.nq) for _ in sides]
    for one, side in zip(q, sides, strict=True):
        for name, sign in (("crank_1", 1.0), ("crank_2", 1.0), ("crank_3", 1.0), ("plate", -1.0)):
            one[robot.model.joints[robot.model.getJointId(name)].idx_q] = sign * np.arctan2(side[1], side[0])
    found = rp.performance(robot, q)
    np.testing.assert_allclose(found.W, np.ones((3, 1, 1)), atol=CLOSED)
    np.testing.assert_allclose(rp.platform_stiffness(robot, q, {"crank_3": 2.0, "plate": 3.0}).ravel(), 5.0)


@pytest.mark.parametrize("wrong", [1e-9, 1e-5])
def test_what_inverse_kinematics_closes_is_closed(wrong):
    """Where two cranks are in line combinations of all rows close, which the rows in use contradict by rounding."""
    robot, t = three_cranks(1.0, wrong=wrong), np.linspace(0.0, 1.0, 60)[:, None]
    turn = rp.PlatformMotion(t[:, 0], 1.0 + 2.0 * np.pi * t, np.full_like(t, 2.0 * np.pi), 0.0 * t)
    tree = rp.inverse_kinematics(robot, turn)
    assert set(rp.classify(robot, tree.q).kind) == {SingularityKind.REGULAR}
    np.testing.assert_allclose(rp.performance(robot, tree.q).W, np.ones((60, 1, 1)), atol=10.0 * wrong)


def test_rows_of_rounded_numbers_do_not_serve_where_independent_ones_do():
    """Short cranks make margins small everywhere: no rank is lost there, and independent rows hold to rounding."""
    robot = three_cranks(0.9, length=0.02, wrong=1e-11)
    t = np.linspace(0.0, 1.0, 50)[:, None]
    tree = rp.inverse_kinematics(robot, rp.PlatformMotion(t[:, 0], 0.9 + 0.4 * t**2, 0.8 * t, np.full_like(t, 0.8)))
    assert tree.serial_margin_bound.max() < 0.1  # less than what is ample in other machines
    rows = ClosedForward(robot)
    for q, v, a in zip(tree.q, tree.v, tree.a, strict=True):
        J, bias = rows.rows(q, v)
        np.testing.assert_allclose(J @ v, 0.0, atol=1e-14)  # all rows together miss it by 1e-12 and more
        np.testing.assert_allclose(J @ a + bias, 0.0, atol=1e-14)


class _Push:
    """A constant torque on the first crank."""

    def effort(self, t, state):
        return np.array([6.0]), np.zeros(0)


def require_one_equation(robot, run, push, start, within=1e-6):
    """The motion of the one equation by another integrator, all rows closed, forces in closures that balance."""
    assert (run.status.value, run.events) == ("ok", ())
    assert run.gap.max() < CLOSED

    rows, data, balanced = ClosedForward(robot), robot.model.createData(), 0
    driven = np.eye(robot.model.nv)[robot.actuated_velocity][0]
    for q, v, a, force in zip(run.q[::5], run.v[::5], run.a[::5], run.closure_force[::5], strict=True):
        J, _ = rows.rows(np.array(q), np.array(v))
        if np.linalg.svd(J, compute_uv=False)[-1] > 0.01:  # else the rows of the robot cannot say it
            effort = pin.rnea(robot.model, data, np.array(q), np.array(v), np.array(a))
            np.testing.assert_allclose(effort - push * driven - J.T @ force, 0.0, atol=1e-6)
            balanced += 1
    assert balanced > 2

    def rate(t, y):
        still = torque_of_three_cranks(y[0], 0.0)
        return [y[1], (push - still) / (torque_of_three_cranks(y[0], 1.0) - still)]

    span = run.t[0], run.t[-1]
    alone = solve_ivp(rate, span, start, method="DOP853", rtol=1e-12, atol=1e-12, t_eval=run.t)
    np.testing.assert_allclose(run.x[:, 0], alone.y[0], atol=within)
    np.testing.assert_allclose(run.xd[:, 0], alone.y[1], atol=10.0 * within)


@pytest.mark.parametrize(
    ("angle", "duration", "passed"), [pytest.param(1.0, 2.5, 1, marks=pytest.mark.long, id="to and fro"), (2.0, 1.2, 3)]
)
def test_simulations_pass_where_two_cranks_are_in_line(angle, duration, passed):
    """Over two turns."""
    robot = three_cranks(angle)
    run = rp.simulate(robot, _Push(), duration=duration, rtol=1e-9, atol=1e-11)
    require_one_equation(robot, run, 6.0, [angle, 0.0])
    assert (np.abs(np.diff(np.sign(np.sin(run.x[:, 0])))) > 0).sum() > passed


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-6, 1e-4, 0.01])
def test_simulations_start_at_rest_where_two_cranks_are_in_line(angle):
    """At the pose at which the rows chosen at the reference lose rank, and beside it."""
    robot = three_cranks(1.0)
    start = rp.simulation.closed_state(robot, [angle])
    run = rp.simulate(robot, start=start, duration=0.3, rtol=1e-9, atol=1e-11)
    require_one_equation(robot, run, 0.0, [angle, 0.0])


@pytest.mark.parametrize(
    "settings", [pytest.param({"rtol": 1e-9, "atol": 1e-11}, marks=pytest.mark.long, id="fine"), {"integrator": "RK45"}]
)
def test_simulations_go_on_with_other_rows(settings):
    """Thrown up, the cranks come to rest where two are in line, and fall past another such pose."""
    robot, below = three_cranks(1.0), -0.5

    def height(angle):
        potential = PLATE * CRANK * np.sin(angle)
        return potential + sum(mass * (x * np.sin(angle) + y * np.cos(angle)) for mass, (x, y, _) in BODIES)

    inertia = torque_of_three_cranks(0.0, 1.0) - torque_of_three_cranks(0.0, 0.0)
    speed = np.sqrt(2.0 * 9.81 * (height(0.0) - height(below)) / inertia)
    start = rp.simulation.closed_state(robot, [below], [speed])
    run = rp.simulate(robot, start=start, duration=1.0, **settings)
    require_one_equation(robot, run, 0.0, [below, speed])
    assert run.x[:, 0].max() == pytest.approx(0.0, abs=1e-3)
    assert run.x[-1, 0] < -np.pi + 1.0
