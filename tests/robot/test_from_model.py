"""Robots made of a Pinocchio model in Python: the same machine as from files, the same checks, and no files."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from constrained import constrained
from zoo import robot_of

import redundancy_pin as rp
from redundancy_pin.errors import DeclarationError, InputError

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
    followed = rp.inverse_kinematics(robot, MOTION)
    acceleration = constrained(robot, followed.q[0].copy(), followed.v[0].copy(), tau)
    np.testing.assert_allclose(acceleration, followed.a[0], atol=1e-7)


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


def first(name, *values):
    """Return a change of a model: the first value of an array, or of its lower and upper ends."""

    def change(model):
        for key, value in zip((f"lower{name}", f"upper{name}") if len(values) == 2 else (name,), values, strict=True):
            array = np.array(getattr(model, key))
            array[0] = value
            setattr(model, key, array)

    return change


FAR = pin.SE3(np.eye(3), np.array([np.inf, 0.0, 0.0]))
REFUSED = [
    (lambda _: {"actuated": ["cranc"]}, r"The model has no moving joint 'cranc'.*Did you mean 'crank'"),
    (lambda _: {"reference": [1.0]}, "reference"),
    (lambda _: {"closures": [3]}, r"closures\[0\] is 3"),
    (lambda _: {"actuated": "crank"}, "actuated is 'crank'"),
    (lambda _: {"model": "robot.urdf"}, "The model is 'robot.urdf'"),
    (lambda model: model.inertias.__setitem__(1, pin.Inertia(-1.0, np.zeros(3), np.eye(3))), "a negative mass, -1 kg"),
    (lambda model: model.inertias.__setitem__(1, pin.Inertia(1.0, np.full(3, np.nan), np.eye(3))), "a centre of mass"),
    (lambda model: model.inertias.__setitem__(1, pin.Inertia(np.nan, np.zeros(3), np.eye(3))), "the mass nan"),
    (first("armature", -1.0), r"the armature \[-1.0\]"),
    (first("PositionLimit", 2.0, 1.0), r"limits of position \[2.0\] to \[1.0\]"),
    (first("EffortLimit", np.nan, 1.0), "limits of effort"),
    (lambda model: model.jointPlacements.__setitem__(1, FAR), "not placed by finite numbers"),
    (lambda model: setattr(model.gravity, "angular", np.ones(3)), "angular part"),
    (
        lambda model: {
            "closures": [pin.PointContactConstraintModel(model, 1, pin.SE3.Identity(), 2, pin.SE3.Identity())]
        },
        "can let go and slide",
    ),
]


@pytest.mark.parametrize(("change", "message"), REFUSED, ids=[message for _, message in REFUSED])
def test_models_and_arguments_that_make_no_machine(change, message):
    """Files are refused with such numbers, and W τ = f came out of a model with them without a word."""
    model = planar_parallelogram()
    given = change(model) or {}
    with pytest.raises((DeclarationError, InputError), match=message):
        made(**{"model": model} | given)


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
        assert robot.joint_positions(robot.q_reference, ["rocker", "crank"]).shape == (2,)
        for wrong in (
            *({"joints": names} for names in (["ball"], ["no such joint"], "crank")),
            *({"q": q} for q in (np.zeros(3), np.zeros((2, 3, 7)), "text", [[1.0], [1.0, 2.0]])),
        ):
            with pytest.raises(InputError):
                robot.joint_positions(**{"q": robot.q_reference, **wrong})
    else:
        with pytest.raises(DeclarationError, match="the joint\\(s\\) 'ball' of several freedoms"):
            rp.robot_from_model(model, **given)
