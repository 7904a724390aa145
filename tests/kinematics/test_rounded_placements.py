"""Files of rounded placements: planar machines stay planar, with the efforts of the exact ones, in every format.

The shipped planar machines are written as they stand at their references, every loop closed by a hinge, with placements
that are off at random. The efforts of the exact machine are those of plain Pinocchio, its loops closed in the plane.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pinocchio as pin
import pytest
import yaml
from loop_oracle import Loops
from scipy.spatial.transform import Rotation

import redundancy_pin as rp
from redundancy_pin.errors import DeclarationError, UnreachablePoseError
from redundancy_pin.kinematics.branch import follower
from redundancy_pin.robot import Robot
from redundancy_pin.robot.shipped import declaration_path
from redundancy_pin.status import ResultStatus, SampleStatus

MACHINES = ("four_bar", "five_bar", "2rpr", "3rrr", "excavator")
HINGE = ["x", "y", "z", "rx", "ry"]
MOMENTS = ("xx", "xy", "xz", "yy", "yz", "zz")

GRAIN = pin.Inertia(0.01, np.zeros(3), 1e-4 * np.eye(3))
"""kg and kg·m²; of each body, as MuJoCo takes none without moments about all axes."""

FILE_ROUNDED = 4e-4
"""rad; tilts of a coupler that a loop of the four-bar below takes as rounding."""

GRAVITY = np.array([0.4, -9.0, 0.0])

AMPLIFIED = 10.0
"""Relative error of efforts over that of placements; 7.4 is the largest of a dozen seeds in each format."""


class Body(NamedTuple):
    """A body and the joint that carries it: on which body, where, and the axis it turns about or slides along."""

    name: str
    parent: str
    place: pin.SE3
    slides: bool
    axis: np.ndarray
    inertia: pin.Inertia


class End(NamedTuple):
    body: str
    place: pin.SE3


class Machine(NamedTuple):
    """Bodies in the order of a tree, hinges that close the loops, the size (m), and the joints that are driven."""

    bodies: tuple[Body, ...]
    hinges: tuple[tuple[End, End], ...]
    size: float
    driven: tuple[str, ...]


def drawn(name: str, **arguments: float) -> Machine:
    """Return a shipped machine at its reference, carriers left out; its joints are at zero there."""
    robot = rp.load_robot(name, **arguments)
    model, data = robot.model, robot.model.createData()
    pin.computeJointJacobians(model, data, np.array(robot.q_reference))
    pin.updateFramePlacements(model, data)
    names, bodies = ["ground", *(str(each) for each in list(model.names)[1:])], []
    for i in range(1, model.njoints):
        parent, motion = model.parents[i], pin.getJointJacobian(model, data, i, pin.LOCAL)[:, model.joints[i].idx_v]
        slides, place = bool(np.any(motion[:3])), data.oMi[parent].actInv(data.oMi[i])
        if names[i] not in robot.carriers:
            axis = motion[:3] if slides else motion[3:]
            bodies.append(Body(names[i], names[parent], place, slides, axis, model.inertias[i] + GRAIN))
    hinges = []
    for closure in robot.closures:
        frames = [model.frames[model.getFrameId(each)] for each in (closure.frame_a, closure.frame_b)]
        a, b = (data.oMi[each.parentJoint] * each.placement for each in frames)
        ends = a, pin.SE3(a.rotation, b.translation)  # frames that coincide
        hinges.append(
            tuple(
                End(names[f.parentJoint], data.oMi[f.parentJoint].actInv(end))
                for f, end in zip(frames, ends, strict=True)
            )
        )
    return Machine(tuple(bodies), tuple(hinges), robot.characteristic_length, robot.actuated)


def off(machine: Machine, amount: float, rng: np.random.Generator) -> Machine:
    """Return the machine with all placements off by up to an amount, rad and sizes, along and about each axis."""

    def wrong(place: pin.SE3) -> pin.SE3:
        turn, shift = rng.uniform(-amount, amount, (2, 3))
        return place * pin.SE3(pin.exp3(turn), machine.size * shift)

    bodies = tuple(body._replace(place=wrong(body.place)) for body in machine.bodies)
    hinges = tuple(tuple(end._replace(place=wrong(end.place)) for end in ends) for ends in machine.hinges)
    return machine._replace(bodies=bodies, hinges=hinges)


# --- formats ----------------------------------------------------------------------------------------------------------


def numbers(values: np.ndarray) -> str:
    return " ".join(f"{value:.17g}" for value in np.asarray(values).ravel())


def rpy(place: pin.SE3) -> np.ndarray:
    return pin.rpy.matrixToRpy(place.rotation)


def origin(place: pin.SE3) -> str:
    return f'<origin xyz="{numbers(place.translation)}" rpy="{numbers(rpy(place))}"/>'


def inertia_of(body: Body) -> tuple[float, np.ndarray, np.ndarray]:
    """Return mass, centre, and moments xx, xy, xz, yy, yz, zz about it."""
    moments = body.inertia.inertia
    return body.inertia.mass, body.inertia.lever, moments[np.triu_indices(3)]


def urdf(machine: Machine, loops: bool) -> str:
    parts = ['<robot name="drawn"><link name="ground"/>']
    for body in machine.bodies:
        mass, centre, moments = inertia_of(body)
        named = " ".join(f'i{at}="{value:.17g}"' for at, value in zip(MOMENTS, moments, strict=True))
        inertial = (
            f'<inertial><origin xyz="{numbers(centre)}"/><mass value="{mass:.17g}"/><inertia {named}/></inertial>'
        )
        kind = "prismatic" if body.slides else "revolute"
        parts.append(
            f'<link name="{body.name}">{inertial}</link><joint name="{body.name}" type="{kind}">{origin(body.place)}'
            f'<parent link="{body.parent}"/><child link="{body.name}"/><axis xyz="{numbers(body.axis)}"/>'
            '<limit lower="-3" upper="3" effort="1e3" velocity="1e3"/></joint>'
        )
    for k, ends in enumerate(machine.hinges):
        if loops:
            one, other = (f'link="{end.body}">{origin(end.place)}' for end in ends)
            parts.append(
                f'<loop name="pin_{k}" type="revolute"><predecessor {one}</predecessor><successor {other}</successor>'
                '<axis xyz="0 0 1"/></loop>'
            )
            continue
        for end, side in zip(ends, "ab", strict=True):
            parts.append(
                f'<link name="{side}_{k}"/><joint name="to_{side}_{k}" type="fixed">{origin(end.place)}'
                f'<parent link="{end.body}"/><child link="{side}_{k}"/></joint>'
            )
    return "".join([*parts, "</robot>"])


def in_urdf(folder: Path, machine: Machine) -> Robot:
    path = folder / "drawn.urdf"
    path.write_text(urdf(machine, loops=True))
    return rp.load_robot(path, actuated=",".join(machine.driven), gravity=GRAVITY)


def in_yaml(folder: Path, machine: Machine) -> Robot:
    (folder / "drawn.urdf").write_text(urdf(machine, loops=False))
    declaration = {
        "name": "drawn",
        "urdf": "drawn.urdf",
        "closures": [{"frames": [f"a_{k}", f"b_{k}"], "axes": HINGE} for k in range(len(machine.hinges))],
        "redundant_rows": True,
        "actuated": list(machine.driven),
        "independent": {"joints": list(machine.driven)},
        "reference": {"joints": dict.fromkeys(machine.driven, 0.0)},
        "gravity": GRAVITY.tolist(),
    }
    path = folder / "robot.yaml"
    path.write_text(yaml.safe_dump(declaration))
    return rp.load_robot(path)


def in_mjcf(folder: Path, machine: Machine) -> Robot:
    """Two points on the axis of each hinge are connected."""
    pytest.importorskip("mujoco")

    def body_of(body: Body) -> str:
        mass, centre, moments = inertia_of(body)
        full = moments[[0, 3, 5, 1, 2, 4]]
        turn = Rotation.from_matrix(body.place.rotation).as_quat()[[3, 0, 1, 2]]
        inertial = f'<inertial pos="{numbers(centre)}" mass="{mass:.17g}" fullinertia="{numbers(full)}"/>'
        kind = "slide" if body.slides else "hinge"
        return (
            f'<body name="{body.name}" pos="{numbers(body.place.translation)}" quat="{numbers(turn)}">'
            f'<joint name="{body.name}" type="{kind}" axis="{numbers(body.axis)}"/>{inertial}'
            f"{inside(body.name)}</body>"
        )

    def inside(name: str) -> str:
        sites = [
            f'<site name="{side}{j}_{k}" pos="{numbers(end.place.act(np.array([0.0, 0.0, j * machine.size])))}"/>'
            for k, ends in enumerate(machine.hinges)
            for end, side in zip(ends, "ab", strict=True)
            for j in (0, 1)
            if end.body == name
        ]
        return "".join([*sites, *(body_of(each) for each in machine.bodies if each.parent == name)])

    pairs = [f'<connect site1="a{j}_{k}" site2="b{j}_{k}"/>' for k in range(len(machine.hinges)) for j in (0, 1)]
    motors = [f'<motor joint="{name}"/>' for name in machine.driven]
    path = folder / "drawn.xml"
    path.write_text(
        f'<mujoco model="drawn"><option gravity="{numbers(GRAVITY)}"/><compiler angle="radian"/>'
        f"<worldbody>{inside('ground')}</worldbody><equality>{''.join(pairs)}</equality>"
        f"<actuator>{''.join(motors)}</actuator></mujoco>"
    )
    return rp.load_robot(path)


FORMATS: dict[str, Callable[[Path, Machine], Robot]] = {
    "urdf": in_urdf,
    "yaml": in_yaml,
    "mjcf": in_mjcf,
}


# --- the exact machine, by plain Pinocchio ----------------------------------------------------------------------------


def in_plane(machine: Machine) -> Loops:
    """Return the exact machine with its loops closed in the plane x, y."""
    model, ids = pin.Model(), {"ground": 0}
    model.gravity.linear = GRAVITY
    for body in machine.bodies:
        kind = pin.JointModelPrismaticUnaligned if body.slides else pin.JointModelRevoluteUnaligned
        ids[body.name] = model.addJoint(ids[body.parent], kind(body.axis), body.place, body.name)
        model.appendBodyToJoint(ids[body.name], body.inertia, pin.SE3.Identity())
    for k, ends in enumerate(machine.hinges):
        for end, side in zip(ends, "ab", strict=True):
            model.addFrame(pin.Frame(f"{side}_{k}", ids[end.body], end.place, pin.FrameType.OP_FRAME))
    return Loops(model, [(f"a_{k}", f"b_{k}") for k in range(len(machine.hinges))], machine.driven)


def samples(n: int) -> list[np.ndarray]:
    rng = np.random.default_rng(3)
    return [rng.uniform(-1.0, 1.0, (3, n)) * np.array([[0.1], [2.0], [5.0]]) for _ in range(3)]


def error(machine: Machine, dynamics: object) -> float:
    """Return the largest difference of efforts from the exact machine's, relative to the largest effort."""
    exact = in_plane(machine)
    want = np.array([exact.torque(*motion) for motion in samples(len(machine.driven))])
    got = [dynamics.torque(*motion) for motion in samples(len(machine.driven))]
    assert {each.status for each in got} <= {SampleStatus.OK, SampleStatus.NEAR_SINGULAR}
    return float(np.abs(np.array([each.tau for each in got]) - want).max() / np.abs(want).max())


CASES = [
    (name, kind) for i, name in enumerate(MACHINES) for kind in (FORMATS if i == 0 else [*FORMATS, *FORMATS][i : i + 2])
]
"""The four-bar in every format, each of the others in two."""


@pytest.mark.parametrize(("name", "kind"), CASES)
def test_rounded_placements(name: str, kind: str, tmp_path: Path) -> None:
    """Same degrees of freedom and efforts as the exact machine, and a note; wrong placements are an error."""
    exact = drawn(name)
    for amount, seed in ((0.0, 0), (1e-6, 1), (1e-4, 2)):
        robot = FORMATS[kind](tmp_path, off(exact, amount, np.random.default_rng(seed)))
        assert (robot.n, robot.independent_joints, robot.actuated) == (len(exact.driven), exact.driven, exact.driven)
        (note,) = (each for each in robot.notes if each.startswith("Redundant closure rows left out"))
        missed = re.search(r"closed in them to (\S+) .* rounded", note)
        assert (missed is not None) == (amount > 0.0)
        if missed:
            assert 0.01 * amount < float(missed[1]) < 10.0 * amount
        assert error(exact, rp.RneaDynamics(robot)) < AMPLIFIED * amount + 1e-12
    with pytest.raises(DeclarationError, match=r"redundant except for|closure residual is|over-constrained") as caught:
        FORMATS[kind](tmp_path, off(exact, 1e-2, np.random.default_rng(5)))
    assert 2e-3 < caught.value.details["residual"] < 0.1


@pytest.mark.parametrize("kind", ["urdf", "yaml"])
def test_what_is_taken_turns_round(kind: str, tmp_path: Path) -> None:
    """A tilted coupler, drawn with its loop open: refused, or the machine of the file with efforts all round."""
    exact = drawn("four_bar")
    x, one = np.linspace(-3.0, 3.0, 13)[:, None], np.ones((13, 1))
    motion, taken, want = rp.PlatformMotion(x[:, 0], x, one, 0.0 * one), [], np.zeros(0)
    for tilt in (0.0, 2e-4, *np.linspace(3e-4, 2e-3, 6), 1e-2):
        off_by = pin.SE3(pin.exp3(np.array([tilt, 0.0, 0.2])), np.zeros(3))
        bodies = [each._replace(place=each.place * off_by) if each.name == "coupler" else each for each in exact.bodies]
        try:
            robot = FORMATS[kind](tmp_path, exact._replace(bodies=tuple(bodies)))
        except DeclarationError:
            continue
        tau = rp.distribute(rp.RneaDynamics(robot).along(motion).reduce()).tau
        want = tau if tilt == 0.0 else want
        np.testing.assert_allclose(tau, want, atol=AMPLIFIED * tilt * np.abs(want).max())
        taken.append(tilt)
    assert taken[:2] == [0.0, 2e-4]
    assert taken[-1] < 1e-2


@pytest.mark.parametrize(("lift", "is_closed"), [(3e-5, True), (3e-4, False)])
def test_dependent_rows_of_exact_placements(lift: float, is_closed: bool, tmp_path: Path) -> None:
    """An end that leaves the plane by 3e-4 of the size, behind what was measured at the reference, is not closed."""
    robot = in_yaml(tmp_path, drawn("four_bar"))
    model = robot.model.copy()
    frame = model.frames[model.getFrameId("b_0")]
    frame.placement = frame.placement * pin.SE3(np.eye(3), np.array([0.0, 0.0, lift * robot.characteristic_length]))
    lifted, motion = replace(robot, model=model), rp.PlatformMotion([0.0], [[0.0]], [[1.0]], [[0.0]])
    if is_closed:
        np.testing.assert_allclose(rp.inverse_kinematics(lifted, motion).q, rp.inverse_kinematics(robot, motion).q)
        return
    with pytest.raises(UnreachablePoseError, match="z of") as caught:
        rp.inverse_kinematics(lifted, motion)
    assert caught.value.details["residual"] == pytest.approx(lift * robot.characteristic_length)


def test_a_pose_out_of_reach_blames_no_row_that_was_left_out() -> None:
    """A five-bar whose loop is a ball: z of it is left out, and far away x and y stay open. It has no working modes."""
    box = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    joint = '<joint name="{0}" type="{4}"><parent link="{1}"/><child link="{2}"/>'
    joint += '<origin xyz="{3} 0 0"/><axis xyz="0 0 1"/></joint>'
    links = ["base", "a", "b", "c", "d", "left", "right"]
    joints = [("q1", "base", "a", 0.0), ("p1", "a", "b", 1.0), ("q2", "base", "c", 0.4), ("p2", "c", "d", 1.0)]
    text = "".join(f'<link name="{name}">{box}</link>' for name in links[1:])
    text += "".join(joint.format(*one, "continuous") for one in joints)
    text += "".join(joint.format(f"to_{end}", link, end, 1.0, "fixed") for link, end in (("b", "left"), ("d", "right")))
    model = pin.buildModelFromXML(f'<robot name="r"><link name="base"/>{text}</robot>')
    robot = rp.robot_from_model(
        model,
        actuated=["q1", "q2"],
        closures=[{"frames": ["left", "right"], "axes": ["x", "y", "z"]}],
        redundant_rows=True,
        independent={"platform": "left", "axes": ["x", "y"]},
        reference={"guess": {"q1": 2.0, "p1": -1.2, "q2": 1.1, "p2": 1.2}},
    )
    with pytest.raises(UnreachablePoseError) as caught:
        rp.inverse_kinematics(robot, rp.PlatformMotion([0.0], [[0.2, 2.6]], [[0.0, 0.0]], [[0.0, 0.0]]))
    assert "stay open by" in caught.value.message
    assert "left out" not in caught.value.message
    assert "working_mode" not in caught.value.remedy


@pytest.mark.parametrize(
    ("tilt", "across", "axes"),
    [*((tilt, 0.0, HINGE[:3]) for tilt in (0.0, 1e-4, 5.5e-4, 6e-4)), (0.0, 1e-4, HINGE), (0.0, 9e-4, HINGE)],
)
def test_contradictions_lead_to_no_other_assembly(tilt: float, across: float, axes: list[str]) -> None:
    """A loop that opens by little more than rounding near the guess is refused: elsewhere it may open by less.

    Tilted across the crank it opens by less than rounding, and its redundant rows lock the crank, everywhere alike.
    """
    model = pin.Model()
    crank = model.addJoint(0, pin.JointModelRUBZ(), pin.SE3.Identity(), "crank")
    place = pin.SE3(pin.rpy.rpyToMatrix(tilt, across, 0.9), np.array([0.3, 0.0, 0.0]))
    coupler = model.addJoint(crank, pin.JointModelRUBZ(), place, "coupler")
    rocker = model.addJoint(0, pin.JointModelRUBZ(), pin.SE3(np.eye(3), np.array([0.5, 0.0, 0.0])), "rocker")
    for name, joint, length in (("one", coupler, 0.6), ("other", rocker, 0.4)):
        end = pin.SE3(np.eye(3), np.array([length, 0.0, 0.0]))
        model.addFrame(pin.Frame(name, joint, 0, end, pin.FrameType.BODY))
        model.appendBodyToJoint(joint, pin.Inertia.Random(), pin.SE3.Identity())
    guess = pin.integrate(model, pin.neutral(model), np.array([1.0, -0.8, 1.9]))
    arguments = {"actuated": ["crank"], "closures": [("one", "other", axes)], "reference": guess}
    if max(tilt, across) > FILE_ROUNDED:
        with pytest.raises(DeclarationError, match="redundant except for"):
            rp.robot_from_model(model, redundant_rows=True, **arguments)
        return
    robot = rp.robot_from_model(model, redundant_rows=True, **arguments)
    turned = pin.difference(model, guess, np.array(robot.q_reference))
    np.testing.assert_allclose(turned, [-0.525, -0.536, -1.487], atol=2e-3)


def test_rows_that_hardly_hold_and_lock_nothing_are_meant() -> None:
    """Seven hinges tilted by 0.01 rad in a loop have one degree of freedom; with four motors the plane is wrong."""
    rng, model, angles = (
        np.random.default_rng(2),
        pin.Model(),
        2.0 * np.pi * np.arange(7) / 7.0 + 0.2 * np.arange(7) ** 2,
    )
    places = [
        pin.SE3(pin.exp3(np.append(rng.uniform(-0.01, 0.01, 2), 0.0)), np.array([np.cos(angle), np.sin(angle), 0.0]))
        for angle in angles
    ]
    joint, before = 0, pin.SE3.Identity()
    for k, place in enumerate(places[:6]):
        joint = model.addJoint(joint, pin.JointModelRZ(), before.actInv(place), f"hinge_{k}")
        model.appendBodyToJoint(joint, pin.Inertia.Random(), pin.SE3.Identity())
        before = place
    model.addFrame(pin.Frame("end", joint, 0, before.actInv(places[6]), pin.FrameType.BODY))
    model.addFrame(pin.Frame("start", 0, 0, places[6], pin.FrameType.BODY))
    closures = [("start", "end", HINGE)]
    robot = rp.robot_from_model(model, actuated=["hinge_0"], closures=closures, redundant_rows=True)
    assert (robot.n, robot.closures[0].axes) == (1, tuple(HINGE))
    with pytest.raises(DeclarationError, match="redundant except for"):
        rp.robot_from_model(model, actuated=[f"hinge_{k}" for k in range(4)], closures=closures, redundant_rows=True)


def test_generated_code_and_simulations_of_rounded_placements(tmp_path: Path) -> None:
    """They take the same rows: a five-bar falls as the exact one does."""
    exact = drawn("five_bar")
    robot = in_yaml(tmp_path, off(exact, 1e-4, np.random.default_rng(6)))
    assert error(exact, rp.CompiledDynamics(robot)) < AMPLIFIED * 1e-4
    ends = []
    for machine in (exact, off(exact, 1e-4, np.random.default_rng(6))):
        run = rp.simulate(in_yaml(tmp_path, machine), duration=0.2, dt=0.1)
        assert (run.status, run.events) == (ResultStatus.OK, ())
        ends.append(run.x[-1])
    assert np.abs(ends[0]).max() > 0.05
    np.testing.assert_allclose(ends[1], ends[0], atol=AMPLIFIED * 1e-4 * np.abs(ends[0]).max())


def test_virtual_work_of_rounded_placements(tmp_path: Path) -> None:
    """The 3-RRR with axes tilted by 1e-4 in its file, all rows of its hinges declared: its closed form fits."""
    folder = tmp_path / "tilted"
    shutil.copytree(declaration_path("3rrr").parent, folder)
    rng = np.random.default_rng(7)
    (xacro,) = folder.glob("*.xacro")

    def tilted_by(match: re.Match[str]) -> str:
        return '{} rpy="{:.3g} {:.3g} 0"/>'.format(match[1], *rng.uniform(-1e-4, 1e-4, 2))

    text = re.sub(r'(<origin xyz="[^"]*")/>', tilted_by, xacro.read_text())
    assert text != xacro.read_text()
    xacro.write_text(text)
    declaration = (folder / "robot.yaml").read_text().replace("axes: [x, y]}", "axes: [x, y, z, rx, ry]}")
    (folder / "robot.yaml").write_text(declaration + "\nredundant_rows: true\n")
    tilted, motion = rp.load_robot(folder), (np.array([0.9, 0.5, 0.1]), np.ones(3), np.ones(3))
    assert [each.axes for each in tilted.all_closures] == [tuple(HINGE)] * 2
    want = rp.VirtualWork("3rrr").torque(*motion).tau
    for dynamics in (rp.VirtualWork(tilted), rp.RneaDynamics(tilted)):
        np.testing.assert_allclose(dynamics.torque(*motion).tau, want, atol=AMPLIFIED * 1e-4 * np.abs(want).max())


def test_tilted_hinges_restore_no_rank(tmp_path: Path) -> None:
    """A parallelogram with a hinge tilted by 1e-4 passes its flat pose as the exact one does, and is singular there."""
    exact = drawn("four_bar", ground_length=0.4, crank_length=0.1, coupler_length=0.4, rocker_length=0.1)
    ((one, other),) = exact.hinges
    turned = other._replace(place=other.place * pin.SE3(pin.exp3(np.array([1e-4, 0.0, 0.0])), np.zeros(3)))
    flat, found = np.pi - 1.0, []  # the crank is drawn at 1 rad
    near = np.array([-1e-4, -3e-5, -1e-5, 1e-6, 1e-5, 3e-5, 1e-4])
    x = np.concatenate([np.linspace(0.0, flat - 1e-2, 40), flat + near, flat + np.linspace(1e-2, 0.3, 10)])
    motion = rp.PlatformMotion(x, x[:, None], np.ones((len(x), 1)), np.zeros((len(x), 1)))
    for machine in (exact, exact._replace(hinges=((one, turned),))):
        robot = in_yaml(tmp_path, machine)
        along = rp.RneaDynamics(robot).along(motion)
        margins = rp.classify(robot, along.tree.q).serial_margin
        run = rp.simulate(robot, duration=0.6, dt=0.1)
        own = follower(robot)
        ratios = [own.state_at(q).gamma[:, 0] for q in along.tree.q[40:47]]  # near the flat pose
        found.append((rp.distribute(along.reduce()).tau, margins, ratios, [event.kind for event in run.events]))
    (tau, margins, ratios, events), (tilted, others, gamma, same) = found
    np.testing.assert_allclose(gamma, ratios, atol=1e-3)
    assert margins.min() < 1e-5
    np.testing.assert_allclose(others, margins, atol=1e-5)
    np.testing.assert_allclose(tilted, tau, rtol=1e-3)
    assert "closure_rank" in events
    assert same == events
