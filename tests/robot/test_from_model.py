"""Robots made of a Pinocchio model in Python: the same machine as from files, the same checks, and no files."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pinocchio as pin
import pytest
from zoo import robot_of

import redundancy_pin as rp
from redundancy_pin.errors import DeclarationError, InputError, UnsupportedRobotError
from redundancy_pin.robot import Closure, Platform
from redundancy_pin.robot.from_model import in_order_of
from redundancy_pin.robot.rebuild import rebuilt

SIDE = 0.4


def planar_parallelogram(tilt=None):
    """Two cranks and a coupler of a parallelogram-like four-bar, in any plane, with damping-free hinges about z."""
    tilt = tilt or pin.SE3.Identity()
    model = pin.Model()
    model.name = "four"
    body = pin.Inertia(1.0, np.array([0.5 * SIDE, 0.0, 0.0]), np.diag([1e-4, 0.01, 0.01]))

    def add(parent, place, name):
        joint = model.addJoint(parent, pin.JointModelRZ(), place, name)
        model.appendBodyToJoint(joint, body, pin.SE3.Identity())
        return joint

    def at(x):
        return pin.SE3(np.eye(3), np.array([x, 0.0, 0.0]))

    crank = add(0, tilt, "crank")
    coupler = add(crank, at(SIDE), "coupler")
    rocker = add(0, tilt * at(1.2 * SIDE), "rocker")
    model.addFrame(pin.Frame("pin", coupler, at(1.3 * SIDE), pin.FrameType.OP_FRAME))
    model.addFrame(pin.Frame("end", rocker, at(1.1 * SIDE), pin.FrameType.OP_FRAME))
    return model


REFERENCE = np.array([1.4, -1.3, 1.2])


def made(model=None, **changes):
    given = {
        "closures": [("pin", "end", ["x", "y"])],
        "actuated": ["crank"],
        "independent": ["crank"],
        "reference": REFERENCE,
        **changes,
    }
    return rp.robot_from_model(planar_parallelogram() if model is None else model, **given)


@pytest.mark.parametrize("name", ["five_bar", "gough"])
def test_it_is_the_robot_of_the_files(name):
    known = robot_of(name)
    limits = [
        {
            "joint": joint,
            "position": [limit.lower, limit.upper],
            "speed": limit.speed,
            "acceleration": limit.acceleration,
        }
        for joint, limit in zip(known.carriers, known.carrier_limits, strict=True)
    ]
    modes = known.working_modes
    robot = rp.robot_from_model(
        known.model,
        closures=known.closures,
        actuated=known.actuated,
        carriers=limits,
        independent=known.platform,
        reference=known.q_reference,
        characteristic_length=known.characteristic_length,
        working_modes=modes and {"joints": modes.joints, "signs": modes.signs, "default": known.working_mode},
    )
    assert robot.model is not known.model
    for what in ("closures", "platform", "actuated", "carriers", "working_mode", "n", "m", "k"):
        assert getattr(robot, what) == getattr(known, what), what
    np.testing.assert_allclose(robot.q_reference, known.q_reference, atol=1e-12)
    system = rp.kinematics.closure.ConstraintSystem(known)
    x = rp.kinematics.coordinates.coordinates(known, system.evaluate(known.q_reference[None]))
    rng = np.random.default_rng(1)
    motion = rp.PlatformMotion([0.0], x, rng.normal(size=(1, known.n)), rng.normal(size=(1, known.n)))
    ours, theirs = (rp.RneaDynamics(each).reduce(motion) for each in (robot, known))
    np.testing.assert_allclose(ours.f, theirs.f, atol=1e-11)
    np.testing.assert_allclose(ours.W, theirs.W, atol=1e-11)


TILTED = pin.SE3(pin.rpy.rpyToMatrix(0.4, -0.7, 0.3), np.array([0.1, 0.2, 0.3]))


@pytest.mark.parametrize("tilt", [pin.SE3.Identity(), TILTED], ids=["flat", "tilted"])
@pytest.mark.parametrize("kind", [3, 6])
def test_a_constraint_model_of_pinocchio_closes_a_loop(tilt, kind):
    model = planar_parallelogram(tilt)
    ends = [model.frames[model.getFrameId(name)] for name in ("pin", "end")]
    turned = [pin.SE3(frame.placement) for frame in ends]
    if kind == 6:  # a weld of the last link to itself, cut in the middle: a fourth hinge makes the loop movable
        wrist = model.addJoint(ends[0].parentJoint, pin.JointModelRZ(), ends[0].placement, "wrist")
        anchor = (wrist, pin.SE3.Identity(), ends[1].parentJoint, turned[1])
        constraint = pin.FrameAnchorConstraintModel(model, *anchor)
        start = np.array([1.4, -1.3, 1.1, 1.2]) if model.getJointId("wrist") == 3 else np.array([1.4, -1.3, 1.2, 1.1])
    else:
        # the placement is turned: which row of the three is redundant depends on the frame
        turned[0].rotation = turned[0].rotation @ pin.rpy.rpyToMatrix(0.0, 0.5 * np.pi, 0.0)
        constraint = pin.RigidConstraintModel(
            pin.ContactType.CONTACT_3D, model, ends[0].parentJoint, turned[0], ends[1].parentJoint, turned[1]
        )
        start = REFERENCE
    robot = rp.robot_from_model(model, closures=[constraint], actuated=["crank"], reference=start)
    assert robot.independent_joints == ("crank",)
    (closure,) = robot.closures
    assert len(closure.axes) == kind - (1 if kind == 3 else 3)
    left_out, chosen, *_ = robot.notes
    assert left_out.count(" of '") == kind - len(closure.axes)
    assert "crank" in chosen
    effort = _effort(robot)
    if kind == 3:
        _agrees_with_constraint_dynamics(robot)
    else:  # the wrist has no mass: the same machine as the one above
        same = made(planar_parallelogram(tilt))
        np.testing.assert_allclose(effort, _effort(same), rtol=1e-9)


MOTION = rp.PlatformMotion([0.0], [[1.6]], [[0.7]], [[-1.1]])


def _effort(robot):
    return rp.distribute(rp.RneaDynamics(robot).reduce(MOTION)).tau[0]


def _agrees_with_constraint_dynamics(robot):
    """Forward dynamics of Pinocchio under the effort of our inverse dynamics gives the acceleration back."""
    tau = np.zeros(robot.model.nv)
    tau[robot.actuated_velocity] = _effort(robot)
    lifted = rp.inverse_kinematics(robot, MOTION)
    model, (closure,) = robot.model, robot.closures
    a, b = (model.frames[model.getFrameId(name, pin.FrameType.BODY)] for name in (closure.frame_a, closure.frame_b))
    point = pin.RigidConstraintModel(
        pin.ContactType.CONTACT_3D, model, a.parentJoint, a.placement, b.parentJoint, b.placement
    )
    data, constraints = model.createData(), pin.StdVec_RigidConstraintModel()
    constraints.append(point)
    datas = pin.StdVec_RigidConstraintData()
    datas.append(point.createData())
    pin.initConstraintDynamics(model, data, constraints, datas)
    q, v = lifted.q[0].copy(), lifted.v[0].copy()
    acceleration = pin.constraintDynamics(
        model, data, q, v, tau, constraints, datas, pin.ProximalSettings(1e-13, 1e-8, 20)
    )
    np.testing.assert_allclose(acceleration, lifted.a[0], atol=1e-7)


def test_reference_forms():
    given = made()
    again = made(reference={"joints": {"crank": 1.4}, "guess": {"coupler": -1.3, "rocker": 1.2}})
    assert given.q_reference[0] == pytest.approx(1.4, abs=0.2)
    moved = made(reference=again.q_reference)
    np.testing.assert_allclose(moved.q_reference, again.q_reference, atol=1e-12)
    assert again.q_reference[0] == 1.4
    # independent left out
    assert made(independent=None).independent_joints == ("crank",)
    assert made(actuated=["rocker"], independent=None).independent_joints == ("rocker",)


def test_gravity_name_and_copies():
    model = planar_parallelogram()
    model.gravity.linear = np.array([0.0, -9.81, 0.0])
    robot = made(model, name="mine")
    assert robot.name == "mine"
    assert made(model).name == "four"
    np.testing.assert_array_equal(robot.gravity, [0.0, -9.81, 0.0])
    model.gravity.linear = np.zeros(3)
    np.testing.assert_array_equal(robot.gravity, [0.0, -9.81, 0.0])
    assert not model.existFrame("pin", pin.FrameType.BODY)
    for other in (copy.deepcopy(robot), pickle.loads(pickle.dumps(robot))):
        assert other.notes == robot.notes
        np.testing.assert_array_equal(other.q_reference, robot.q_reference)


def test_a_platform_and_a_picture():
    robot = made(independent=Platform("pin", ("x",)), reference={"platform": [0.3], "guess": {"crank": 1.4}})
    assert robot.n == 1
    from redundancy_pin.visualisation.viewer.mechanism import solids_of

    assert {solid.role for solid in solids_of(robot)} >= {"link", "closure"}


def test_joints_in_any_order_are_numbered_depth_first():
    """Pinocchio's mass matrix is wrong where a sibling comes between a joint and what it carries."""
    model, body = pin.Model(), pin.Inertia(1.0, np.array([0.3, 0.1, 0.2]), 0.1 * np.eye(3))
    place = pin.SE3(np.eye(3), np.array([0.5, 0.0, 0.1]))
    for name, parent, kind in (
        ("left", 0, pin.JointModelRY()),
        ("right", 0, pin.JointModelRZ()),
        ("left_knee", 1, pin.JointModelRX()),
        ("right_knee", 2, pin.JointModelPZ()),
    ):
        model.appendBodyToJoint(model.addJoint(parent, kind, place, name), body, pin.SE3.Identity())
    model.armature = np.arange(4.0)
    model.upperPositionLimit = np.array([1.0, 2.0, 3.0, 4.0])
    for name, joint in (("hand", 3), ("shoe", 4)):
        model.addFrame(pin.Frame(name, joint, place, pin.FrameType.OP_FRAME))
    start = np.array([0.1, 0.3, 0.2, 0.4])
    loop = ("hand", "shoe", ["x", "y"])
    robot = rp.robot_from_model(model, closures=[loop], actuated=["left", "left_knee"], reference=start)
    own = robot.model
    assert list(own.names)[1:] == ["left", "left_knee", "right", "right_knee"]
    assert own.armature.tolist() == [0.0, 2.0, 1.0, 3.0]
    assert own.upperPositionLimit.tolist() == [1.0, 3.0, 2.0, 4.0]
    q, data = np.array(robot.q_reference), own.createData()
    mass = pin.crba(own, data, q)
    mass = np.triu(mass) + np.triu(mass, 1).T
    still = np.zeros(4)
    weight = np.array(pin.rnea(own, data, q, still, still))
    by_rnea = np.array([np.array(pin.rnea(own, data, q, still, unit)) - weight for unit in np.eye(4)])
    np.testing.assert_allclose(mass, by_rnea, atol=1e-12)
    pin.forwardKinematics(own, data, q)
    hand, shoe = (data.oMi[own.getJointId(name)] * place for name in ("left_knee", "right_knee"))
    np.testing.assert_allclose(hand.actInv(shoe).translation[:2], 0.0, atol=1e-9)
    assert np.abs(q - start[[0, 2, 1, 3]]).max() < 0.5
    assert any("depth first" in note for note in robot.notes)


def test_joints_of_several_numbers_keep_theirs_in_another_order():
    """A ball has four numbers and three velocities, a hinge that turns on two and one: by name, whatever the order."""
    model, body = pin.Model(), pin.Inertia(1.0, np.array([0.3, 0.1, 0.2]), 0.1 * np.eye(3))
    for name, parent, kind in (
        ("ball", 0, pin.JointModelSpherical()),
        ("wheel", 0, pin.JointModelRUBZ()),
        ("slide", 1, pin.JointModelPX()),
        ("knob", 2, pin.JointModelRX()),
    ):
        model.appendBodyToJoint(model.addJoint(parent, kind, pin.SE3.Identity(), name), body, pin.SE3.Identity())
    model.armature, model.upperPositionLimit = np.arange(6.0), np.arange(8.0)
    model.lowerEffortLimit, model.upperEffortLimit = -np.arange(6.0) - 1.0, np.arange(6.0) + 2.0
    own, at = rebuilt(model)
    assert list(own.names)[1:] == ["ball", "slide", "wheel", "knob"]
    assert at == [0, 1, 3, 2, 4]
    # numbers 0 to 3 of the ball, 4 and 5 of the wheel, 6 of the slide, 7 of the knob
    assert own.upperPositionLimit.tolist() == [0.0, 1.0, 2.0, 3.0, 6.0, 4.0, 5.0, 7.0]
    assert in_order_of(own, model, at, np.arange(8.0)).tolist() == own.upperPositionLimit.tolist()
    assert own.armature.tolist() == [0.0, 1.0, 2.0, 4.0, 3.0, 5.0]
    assert own.lowerEffortLimit.tolist() == (-own.armature - 1.0).tolist()
    assert own.upperEffortLimit.tolist() == (own.armature + 2.0).tolist()


BAD = {
    "joint": (
        {"actuated": ["cranc"]},
        DeclarationError,
        r"The model has no moving joint 'cranc'.*Did you mean 'crank'",
    ),
    "frame": ({"closures": [("pin", "ende", ["x", "y"])]}, DeclarationError, "no link 'ende'"),
    "axes": ({"closures": [("pin", "end", ["x", "w"])]}, DeclarationError, r"closures\[0\].axes"),
    "over": ({"closures": [("pin", "end", ["x", "y", "z"])]}, DeclarationError, "over-constrained.*z of 'pin = end'"),
    "under": ({"closures": [Closure("c", "pin", "end", ("x",))]}, DeclarationError, "under-constrained"),
    "two roles": ({"carriers": ["crank"]}, DeclarationError, "two roles"),
    "open": ({"reference": {"joints": {"crank": 0.2}}}, None, ""),
    "reference": ({"reference": [1.0]}, InputError, "reference"),
    "closure": ({"closures": [3]}, InputError, r"closures\[0\] is 3"),
    "actuated": ({"actuated": "crank"}, InputError, "actuated is 'crank'"),
    "no model": ({"model": "robot.urdf"}, InputError, "The model is 'robot.urdf'"),
}


@pytest.mark.parametrize("case", [case for case in BAD if BAD[case][1]])
def test_refusals(case):
    changes, kind, message = BAD[case]
    with pytest.raises(kind, match=message):
        made(**changes)


def unsound(change):
    model = planar_parallelogram()
    change(model)
    return model


def with_values(name, *values):
    """Return a change of a model: values of an array of its joint 1."""

    def change(model):
        for key, value in zip((f"lower{name}", f"upper{name}") if len(values) == 2 else (name,), values, strict=True):
            array = np.array(getattr(model, key))
            array[0] = value
            setattr(model, key, array)

    return change


def with_mass(mass):
    return lambda model: model.inertias.__setitem__(1, pin.Inertia(mass, np.zeros(3), np.eye(3)))


UNSOUND = {
    "mass": (with_mass(-1.0), "the mass -1"),
    "no mass": (with_mass(np.nan), "the mass nan"),
    "armature": (with_values("armature", -1.0), r"the armature \[-1.0\]"),
    "range": (with_values("PositionLimit", 2.0, 1.0), r"limits of position \[2.0\] to \[1.0\]"),
    "effort": (with_values("EffortLimit", np.nan, 1.0), "limits of effort"),
    "place": (
        lambda model: model.jointPlacements.__setitem__(1, pin.SE3(np.eye(3), np.array([np.inf, 0.0, 0.0]))),
        "not placed by finite numbers",
    ),
    "gravity": (lambda model: setattr(model.gravity, "angular", np.ones(3)), "angular part"),
}


@pytest.mark.parametrize("case", UNSOUND)
def test_numbers_that_no_machine_has_are_refused(case):
    """Files are refused with such, and W τ = f came out of a model with them without a word."""
    change, message = UNSOUND[case]
    with pytest.raises(InputError, match=message):
        made(unsound(change))


def test_friction_of_the_model_is_said_not_to_be_in_force():
    model = unsound(with_values("damping", 0.5))
    note = next(note for note in made(model).notes if "Not in force" in note)
    assert f"damping of {model.names[1]}. robot.loaded(" in note
    assert not any("Not in force" in note for note in made().notes)


def test_a_contact_is_no_closure():
    if not hasattr(pin, "PointContactConstraintModel"):
        pytest.skip("this Pinocchio has none")
    model = planar_parallelogram()
    contact = pin.PointContactConstraintModel(model, 1, pin.SE3.Identity(), 2, pin.SE3.Identity())
    with pytest.raises(InputError, match="can let go and slide"):
        made(model, closures=[contact])


def test_what_does_not_close_is_refused():
    model = planar_parallelogram()
    model.jointPlacements[3] = pin.SE3(np.eye(3), np.array([9.0, 0.0, 0.0]))
    with pytest.raises(DeclarationError, match="do not close near the reference: the closure residual is"):
        made(model)


def test_joints_of_other_kinds_are_refused():
    model = planar_parallelogram()
    screw = model.addJoint(
        3, pin.JointModelHelicalUnaligned(np.array([0.0, 0.0, 1.0]), 0.1), pin.SE3.Identity(), "screw"
    )
    model.appendBodyToJoint(screw, pin.Inertia.Random(), pin.SE3.Identity())
    model.addFrame(pin.Frame("nut", screw, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    with pytest.raises(UnsupportedRobotError, match="screw"):
        made(model, closures=[("pin", "nut", ["x", "y"])], reference=None)


def test_bricards_six_hinges_stay_closed_in_all_six_rows():
    """A trihedral loop of six hinges moves against Grübler's count: one of its six rows is left out, and holds."""
    model, parent, turn = pin.Model(), 0, 0.5 * np.pi
    place = pin.SE3.Identity()
    body = pin.Inertia(1.0, np.array([0.5, 0.0, 0.0]), 0.1 * np.eye(3))
    for i in range(6):
        parent = model.addJoint(parent, pin.JointModelRZ(), place, f"hinge_{i}")
        model.appendBodyToJoint(parent, body, pin.SE3.Identity())
        place = pin.SE3(pin.rpy.rpyToMatrix(turn if i % 2 == 0 else -turn, 0.0, 0.0), np.array([1.0, 0.0, 0.0]))
    weld = pin.FrameAnchorConstraintModel(model, parent, place, 0, pin.SE3.Identity())
    start = (2.0 * np.pi / 3.0) * np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0])
    robot = rp.robot_from_model(model, closures=[weld], actuated=["hinge_0"], reference=start)
    assert sum(len(closure.axes) for closure in robot.closures) == 5
    home = robot.q_reference[robot.model.joints[robot.model.getJointId(robot.independent_joints[0])].idx_q]
    x = home - np.linspace(0.0, 0.3, 20)[:, None]  # a hinge opens by 2π/3 and no wider
    lifted = rp.inverse_kinematics(
        robot, rp.PlatformMotion(np.linspace(0.0, 1.0, 20), x, np.ones_like(x), np.zeros_like(x))
    )
    data = robot.model.createData()
    for q in lifted.q:
        pin.forwardKinematics(robot.model, data, np.array(q))
        np.testing.assert_allclose((data.oMi[parent] * place).homogeneous, np.eye(4), atol=1e-9)


def test_rows_that_are_redundant_at_one_pose_only_are_no_redundant_rows():
    """Two links stretched between fixed pins: at that pose alone the rows have rank 1; it cannot move at all."""
    model = planar_parallelogram()
    model.jointPlacements[3] = pin.SE3(np.eye(3), np.array([9.0, 0.0, 0.0]))
    end = pin.SE3(np.eye(3), np.array([SIDE, 0.0, 0.0]))
    pivot = pin.SE3(np.eye(3), np.array([2.0 * SIDE, 0.0, 0.0]))
    point = pin.PointAnchorConstraintModel(model, 2, end, 0, pivot)
    with pytest.raises(DeclarationError, match=r"over-constrained: 3 closure rows have rank 1, .* the loops open, by"):
        rp.robot_from_model(model, closures=[point], actuated=["rocker"], reference=np.zeros(3))


def test_a_machine_of_one_joint_at_one_instant() -> None:
    """A pendulum: m g l sin q and m l² q̈."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelRY(), pin.SE3.Identity(), "hinge")
    model.appendBodyToJoint(joint, pin.Inertia(2.0, np.array([0.0, 0.0, -0.5]), np.zeros((3, 3))), pin.SE3.Identity())
    pendulum = rp.RneaDynamics(rp.robot_from_model(model, actuated=["hinge"], independent=["hinge"]))
    f = pendulum.reduce(rp.PlatformMotion([0.0], [[0.3]], [[0.7]], [[1.1]])).f
    np.testing.assert_allclose(f, [[2.0 * 9.81 * 0.5 * np.sin(0.3) + 2.0 * 0.25 * 1.1]], rtol=1e-12)


def test_loads_act_on_points_of_the_model_and_on_what_joints_carry():
    """A point that no closure names, a joint without frames, the ground; Jᵀ w by Pinocchio's own Jacobian."""
    model = planar_parallelogram()
    model.addFrame(pin.Frame("tool", 2, pin.SE3(np.eye(3), np.array([0.1, 0.2, 0.0])), pin.FrameType.OP_FRAME))
    robot = made(model)
    x = robot.q_reference[:1] + np.zeros((2, 1))
    motion = rp.PlatformMotion([0.0, 1.0], x, np.zeros((2, 1)), np.ones((2, 1)))
    free, wrench = rp.RneaDynamics(robot).reduce(motion).f, np.array([1.0, 2.0, 0.0, 0.0, 0.0, 3.0])
    gamma, data = rp.inverse_kinematics(robot, motion).gamma[0], model.createData()
    pin.computeJointJacobians(model, data, np.array(robot.q_reference))
    pin.updateFramePlacements(model, data)
    for name, jacobian in (
        ("tool", pin.getFrameJacobian(model, data, model.getFrameId("tool"), pin.LOCAL_WORLD_ALIGNED)),
        ("coupler", pin.getJointJacobian(model, data, 2, pin.LOCAL_WORLD_ALIGNED)),
        ("universe", np.zeros((6, 3))),
    ):
        f = rp.RneaDynamics(robot.loaded(rp.Wrench(name, wrench))).reduce(motion).f
        np.testing.assert_allclose(free - f, np.tile(gamma.T @ jacobian.T @ wrench, (2, 1)), atol=1e-12)
    rotor = rp.RneaDynamics(robot.loaded(rp.JointForces("rocker", rotor_inertia=1e-3, gear=10.0))).reduce(motion).f
    # the rocker stands on the ground: gear² · inertia at its own rate
    a = rp.inverse_kinematics(robot, motion).a[:, 2]
    np.testing.assert_allclose(rotor - free, 0.1 * a[:, None] * gamma[2], atol=1e-12)


@pytest.mark.parametrize("long", [False, True])
def test_a_ball_that_ends_where_it_begins_is_no_rod(long):
    """Between balls at one place nothing spins about a line; a rod of half a metre about the origin does."""
    model, body = pin.Model(), pin.Inertia(1.0, np.zeros(3), 0.1 * np.eye(3))
    near, far = np.array([0.25, 0.0, 0.0]), np.array([-0.25 if long else 0.25, 0.0, 0.0])
    for name, parent, kind, place in (
        ("crank", 0, pin.JointModelRZ(), near - [0.0, 0.2, 0.0]),
        ("ball", 1, pin.JointModelSpherical(), np.array([0.0, 0.2, 0.0])),
        ("rocker", 0, pin.JointModelRZ() if long else pin.JointModelRX(), far - [0.0, 0.3, 0.0]),
    ):
        joint = model.addJoint(parent, kind, pin.SE3(np.eye(3), place), name)
        model.appendBodyToJoint(joint, body, pin.SE3.Identity())
    ends = pin.SE3(np.eye(3), far - near), pin.SE3(np.eye(3), np.array([0.0, 0.3, 0.0]))
    constraint = pin.RigidConstraintModel(pin.ContactType.CONTACT_3D, model, 2, ends[0], 3, ends[1])
    given = {"closures": [constraint], "actuated": ["crank"], "reference": pin.neutral(model)}
    if long:
        robot = rp.robot_from_model(model, **given)
        assert robot.independent_joints == ("crank",)
        assert any("spin of ball" in note for note in robot.notes)
    else:
        with pytest.raises(DeclarationError, match="the joint\\(s\\) 'ball' of several freedoms"):
            rp.robot_from_model(model, **given)
