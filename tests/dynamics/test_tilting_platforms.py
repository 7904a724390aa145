"""Platforms whose coordinates are height, roll and pitch, against closed forms, energy and forward dynamics.

The closed form: a ball joint of leg i stays in the plane of that leg, normal to its hinge. The three conditions give
yaw, x and y (Carretero, Podhorodeski, Nahon and Gosselin, "Kinematic analysis and optimization of a new three
degree-of-freedom spatial parallel manipulator", J. Mech. Des. 122, 2000): R[1, 0] = R[0, 1],
x = b (R[0, 0] - R[1, 1]) / 2, y = -b R[1, 0]. It takes complex numbers, whose imaginary parts of 1e-30 give exact
derivatives.
"""

from __future__ import annotations

import shutil
from functools import cache
from math import cos, sin
from pathlib import Path
from tempfile import mkdtemp

import numpy as np
import pinocchio as pin
import pytest
import yaml
import zoo
from generated_c import COMPILERS, Code
from scipy.spatial.transform import Rotation

import redundancy_pin as rp
from redundancy_pin.arrays import Array, BoolArray
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.dynamics.compiled import CompiledDynamics
from redundancy_pin.dynamics.results import ReducedDynamics
from redundancy_pin.errors import DeclarationError
from redundancy_pin.kinematics.branch import follower
from redundancy_pin.kinematics.inverse_kinematics import JointTrajectory, inverse_kinematics
from redundancy_pin.robot import Robot
from redundancy_pin.robot.scales import velocity_unit
from redundancy_pin.robot.shipped import models_root
from redundancy_pin.simulation import FeedForward, motion_reference
from redundancy_pin.status import SampleStatus

AZIMUTHS = 2.0 * np.pi / 3.0 * np.arange(3)
BASE, PLATFORM, HEIGHT, LINK = 0.3, 0.2, 0.5, 0.45
HOME = {"3rps": HEIGHT, "3prs": 0.6}
"""Height of the platform at the reference, m."""
NAMES = tuple(HOME)
NATURAL = ("z", "rx", "ry")
_STEP = 1e-30
_OUTWARD = np.stack([np.cos(AZIMUTHS), np.sin(AZIMUTHS), 0.0 * AZIMUTHS])


def poses(x: Array, size: float = 1.0) -> tuple[Array, Array]:
    """Return rotations (N, 3, 3) and origins (N, 3) of platforms at height, roll and pitch (N, 3)."""
    z, roll, pitch = x.T
    yaw = np.arctan(np.sin(pitch) * np.sin(roll) / (np.cos(pitch) + np.cos(roll)))
    (cr, sr), (cp, sp), (cy, sy) = ((np.cos(angle), np.sin(angle)) for angle in (roll, pitch, yaw))
    rotation = np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    ).transpose(2, 0, 1)
    b = PLATFORM * size
    origin = np.stack([0.5 * b * (rotation[:, 0, 0] - rotation[:, 1, 1]), -b * rotation[:, 1, 0], z], axis=1)
    return rotation, origin


def actuators(name: str, x: Array, size: float = 1.0, link: float = LINK) -> Array:
    """Return (N, 3) the positions of the actuators: lengths of legs, or heights of slides; NaN out of reach."""
    balls = _balls(x, size)
    if name == "3rps":
        return np.sqrt(((balls - BASE * size * _OUTWARD) ** 2).sum(axis=1))
    with np.errstate(invalid="ignore"):
        return balls[:, 2] - np.sqrt((link * size) ** 2 - _across(x, size) ** 2)


def _balls(x: Array, size: float) -> Array:
    rotation, origin = poses(x, size)
    return origin[:, :, None] + rotation @ (PLATFORM * size * _OUTWARD)


def _across(x: Array, size: float = 1.0) -> Array:
    """Return (N, 3) how far the ball joints are inward of the base circle."""
    return BASE * size - (_balls(x, size) * _OUTWARD).sum(axis=1)


def slopes(name: str, x: Array) -> Array:
    """Return W (N, 3, 3): the derivative of actuator j by coordinate i."""
    parts = [actuators(name, x + 1j * _STEP * np.eye(3)[i]).imag / _STEP for i in range(3)]
    return np.stack(parts, axis=1)


def motion(name: str, t: Array) -> rp.PlatformMotion:
    """Return a motion with large tilts about both axes at once, with exact rates."""
    amplitude, frequency = np.array([0.06, 0.35, 0.45]), np.array([2.0, 3.1, 2.3])
    phase = frequency * t[:, None] + [0.3, 0.7, 1.9]
    x = np.array([HOME[name], 0.0, 0.0]) + amplitude * np.sin(phase)
    xd, xdd = amplitude * frequency * np.cos(phase), -amplitude * frequency**2 * np.sin(phase)
    return rp.PlatformMotion(t, x, xd, xdd)


def coordinates(axes: tuple[str, ...], x: Array) -> Array:
    """Return (N, n) other coordinates of the platform at height, roll and pitch (N, 3)."""
    rotation, origin = poses(x)
    two = sum(axis.startswith("r") for axis in axes) == 2
    ratios = {
        "rx": rotation[:, 2, 1] / (rotation[:, 2, 2] if two else rotation[:, 1, 1]),
        "ry": x[:, 2] if two else rotation[:, 0, 2] / rotation[:, 2, 2],
        "rz": rotation[:, 1, 0] / rotation[:, 0, 0],
    }
    angles = {axis: part if two and axis == "ry" else np.arctan(part) for axis, part in ratios.items()}
    return np.stack([angles[axis] if axis in angles else origin[:, "xyz".index(axis)] for axis in axes], axis=1)


def in_coordinates(axes: tuple[str, ...], name: str, t: Array) -> rp.PlatformMotion:
    """Return the motion ``motion`` in other coordinates; what is differentiated once is good to 1e-9."""
    h = 1e-3
    slope = {step: _slope(axes, motion(name, t + step * h).x) for step in (-2, -1, 0, 1, 2)}
    rate = (slope[-2] - 8.0 * slope[-1] + 8.0 * slope[1] - slope[2]) / (12.0 * h)
    own = motion(name, t)
    xd = np.einsum("nij,nj->ni", slope[0], own.xd)
    xdd = np.einsum("nij,nj->ni", slope[0], own.xdd) + np.einsum("nij,nj->ni", rate, own.xd)
    return rp.PlatformMotion(t, coordinates(axes, own.x), xd, xdd)


def _slope(axes: tuple[str, ...], x: Array) -> Array:
    return np.stack([coordinates(axes, x + 1j * _STEP * each).imag / _STEP for each in np.eye(3)], axis=2)


def robot_called(
    name: str,
    folder: Path,
    size: float = 1.0,
    axes: tuple[str, ...] = NATURAL,
    at: Array | None = None,
    link: float = LINK,
) -> Robot:
    """Return a robot: the 3-RPS that is shipped, or a 3-PRS, whose platform hangs on a ball joint.

    The platform of the latter may have other coordinates ``axes``, and its reference at height, roll and pitch ``at``.
    """
    if name == "3rps":
        return rp.load_robot(name, base_radius=BASE * size, platform_radius=PLATFORM * size, height=HEIGHT * size)
    (folder / "3prs.urdf").write_text(_prs(size, link), encoding="utf-8")
    x = np.array([[HOME["3prs"], 0.0, 0.0]] if at is None else [at])
    place = coordinates(axes, x)[0] * [1.0 if axis.startswith("r") else size for axis in axes]
    swing = -np.arcsin(_across(x)[0] / link)
    guess: dict[str, float] = {}
    for i, (slide, angle) in enumerate(zip(actuators("3prs", x, link=link)[0] * size, swing, strict=True), start=1):
        guess |= {f"slide_{i}": float(slide), f"swing_{i}": float(angle)}
    data = {
        "urdf": "3prs.urdf",
        "gravity": [0, 0, -9.81],
        "joint_types": {"ball": "ball"},
        "closures": [{"frames": [f"corner_{i}", f"tip_{i}"], "axes": ["x", "y", "z"]} for i in (2, 3)],
        "actuated": ["slide_1", "slide_2", "slide_3"],
        "independent": {"platform": "platform", "axes": list(axes)},
        "reference": {"platform": place.tolist(), "guess": guess},
    }
    path = folder / "robot.yaml"
    path.write_text(yaml.safe_dump(data), encoding="utf-8")
    return rp.load_robot(path)


def _prs(size: float, link: float) -> str:
    parts = ['<robot name="3prs"><link name="base"/>']
    for i, azimuth in enumerate(AZIMUTHS.tolist(), start=1):
        at = f"{BASE * size * cos(azimuth)!r} {BASE * size * sin(azimuth)!r} 0"
        parts += [
            _joint(f"slide_{i}", "prismatic", "base", f"cart_{i}", "0 0 1", at, f"0 0 {azimuth!r}"),
            _body(f"cart_{i}", 0.8, (0.0, 0.0, 0.0), 1e-3, size),
            _joint(f"swing_{i}", "revolute", f"cart_{i}", f"link_{i}", "0 1 0"),
            _body(f"link_{i}", 0.5, (0.0, 0.0, 0.5 * link), 8e-3, size),
        ]
    parts += [
        _joint("ball", "revolute", "link_1", "corner_1", "0 0 1", f"0 0 {link * size!r}"),
        '<link name="corner_1"/>',
        _joint("plate", "fixed", "corner_1", "platform", "0 0 1", f"{-PLATFORM * size!r} 0 0"),
        _body("platform", 3.0, (0.01, -0.02, 0.03), 2e-2, size),
    ]
    for i, azimuth in enumerate(AZIMUTHS.tolist()[1:], start=2):
        at = f"{PLATFORM * size * cos(azimuth)!r} {PLATFORM * size * sin(azimuth)!r} 0"
        parts += [_joint(f"mount_{i}", "fixed", "platform", f"corner_{i}", "0 0 1", at), f'<link name="corner_{i}"/>']
        parts += [
            _joint(f"end_{i}", "fixed", f"link_{i}", f"tip_{i}", "0 0 1", f"0 0 {link * size!r}"),
            f'<link name="tip_{i}"/>',
        ]
    return "".join([*parts, "</robot>"])


def _joint(name: str, kind: str, parent: str, child: str, axis: str, xyz: str = "0 0 0", rpy: str = "0 0 0") -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/>'
        '<limit lower="-1000" upper="1000" velocity="100" effort="1000"/></joint>'
    )


def _body(name: str, mass: float, centre: tuple[float, float, float], moment: float, size: float) -> str:
    place = " ".join(repr(part * size) for part in centre)
    moments = " ".join(
        f'{key}="{moment * size**2 * share!r}"' for key, share in (("ixx", 1), ("iyy", 0.9), ("izz", 0.7))
    )
    return (
        f'<link name="{name}"><inertial><origin xyz="{place}"/><mass value="{mass}"/>'
        f'<inertia {moments} ixy="0" ixz="0" iyz="0"/></inertial></link>'
    )


ROUNDING = 1e-11
"""Chains are closed to 1e-11 m; conditions of W are below 100."""

DIFFERENCES = 1e-7
"""Central differences over 2 ms of motions with periods of 2 s: h² / 6 times the third rate, against the largest."""

TIMES = np.linspace(0.0, 2.0, 41)


@cache
def robot_of(name: str) -> Robot:
    return robot_called(name, Path(mkdtemp()))


@cache
def lifted(name: str) -> JointTrajectory:
    return inverse_kinematics(robot_of(name), motion(name, TIMES))


@cache
def reduced(name: str) -> tuple[ReducedDynamics, ...]:
    along = motion(name, TIMES)
    return tuple(kind(robot_of(name)).reduce(along) for kind in (rp.RneaDynamics, CompiledDynamics))


def near(found: Array, expected: Array, share: float = ROUNDING) -> None:
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=share * np.abs(expected).max())


@pytest.mark.parametrize("name", NAMES)
def test_the_pose_and_the_actuators_are_those_of_the_closed_form(name: str) -> None:
    tree, robot = lifted(name), robot_of(name)
    rotation, origin = poses(tree.motion.x)
    assert np.abs(origin[:, :2]).max() > 0.01  # parasitic motions are there
    assert np.abs(np.arctan2(rotation[:, 1, 0], rotation[:, 0, 0])).max() > 0.04
    near(tree.q[:, _positions(robot)], actuators(name, tree.motion.x))
    data, frame = robot.model.createData(), robot.model.getFrameId("platform", pin.FrameType.BODY)
    for q, turned, place in zip(tree.q, rotation, origin, strict=True):
        pin.framesForwardKinematics(robot.model, data, q)
        near(data.oMf[frame].rotation, turned)
        near(data.oMf[frame].translation, place)


def _positions(robot: Robot) -> list[int]:
    return [int(robot.model.joints[robot.model.getJointId(name)].idx_q) for name in robot.actuated]


@pytest.mark.parametrize("name", NAMES)
def test_W_and_f_are_those_of_the_closed_form_and_of_the_energy(name: str) -> None:
    """The power f · ẋ, and that of the actuators, is the rate of the energy; both backends have the same f."""
    robot, h = robot_of(name), 1e-3
    along, slope = motion(name, TIMES), slopes(name, motion(name, TIMES).x)
    energy = [_energy(robot, inverse_kinematics(robot, motion(name, TIMES + step))) for step in (-2 * h, -h, h, 2 * h)]
    rate = (energy[0] - 8.0 * energy[1] + 8.0 * energy[2] - energy[3]) / (12.0 * h)
    for result in reduced(name):
        near(result.W, slope)
        near(result.f, reduced(name)[0].f)
        near((result.f * along.xd).sum(axis=1), rate, DIFFERENCES)
        speeds = np.einsum("nij,ni->nj", slope, along.xd)
        near((rp.distribute(result).tau * speeds).sum(axis=1), rate, DIFFERENCES)


@pytest.mark.parametrize("name", NAMES)
def test_accelerations_of_compiled_dynamics_are_those_that_the_efforts_are_for(name: str) -> None:
    """The motion's a is that of Pinocchio's rows, and its efforts are RNEA's; velocity terms are a third of it."""
    tree, tau, dynamics = lifted(name), rp.distribute(reduced(name)[0]).tau, CompiledDynamics(robot_of(name))
    found = [dynamics.acceleration(q, v, effort) for q, v, effort in zip(tree.q, tree.v, tau, strict=True)]
    assert {each.status for each in found} == {SampleStatus.OK}
    near(np.array([each.a for each in found]), tree.a, 1e-9)
    due_to_velocities = tree.a - np.einsum("nvi,ni->nv", tree.gamma, tree.motion.xdd)
    assert np.abs(due_to_velocities).max() > 0.3 * np.abs(tree.a).max()


def _energy(robot: Robot, tree: JointTrajectory) -> Array:
    data = robot.model.createData()
    return np.array(
        [
            pin.computeKineticEnergy(robot.model, data, q, v) + pin.computePotentialEnergy(robot.model, data, q)
            for q, v in zip(tree.q, tree.v, strict=True)
        ]
    )


OTHERS = {
    ("x", "z", "rz"): False,
    ("x", "z", "ry"): False,
    ("y", "z", "rx"): False,
    ("z", "rx", "rz"): False,
    ("z", "ry", "rz"): True,
    ("x", "y", "z"): False,
}
"""Other coordinates that fit where the platform is tilted, and whether they are tried in compiled dynamics too."""

TILTED = np.array([0.62, 0.28, 0.39])

SPAN = np.linspace(0.0, 0.2, 9)

DIFFERENTIATED = 1e-7
"""Rates of the other coordinates are good to 1e-9; their conditions are up to 100."""


@pytest.mark.parametrize("axes", OTHERS, ids="-".join)
def test_other_coordinates_of_the_same_motion_give_the_same_efforts(axes: tuple[str, ...], tmp_path: Path) -> None:
    robot = robot_called("3prs", tmp_path, axes=axes, at=TILTED)
    expected = rp.distribute(rp.RneaDynamics(robot_of("3prs")).reduce(motion("3prs", SPAN))).tau
    for kind in (rp.RneaDynamics, CompiledDynamics)[: 1 + OTHERS[axes]]:
        near(rp.distribute(kind(robot).reduce(in_coordinates(axes, "3prs", SPAN))).tau, expected, DIFFERENTIATED)


@pytest.mark.parametrize("name", NAMES)
def test_forward_dynamics_follow_the_motion_that_the_efforts_are_for(name: str) -> None:
    robot = robot_of(name)
    points = np.array([[0.0, 0.0, 0.0], [0.04, 0.3, -0.2], [0.0, -0.25, 0.3]]) + np.array([HOME[name], 0.0, 0.0])
    course = rp.trajectory.from_points(points, [0.0, 0.5, 1.0])
    run = rp.simulate(robot, FeedForward(motion_reference(robot, course)), dt=0.05)
    assert run.status.value == "ok"
    np.testing.assert_allclose(run.x, course.evaluate(np.minimum(run.t, course.duration)).x, atol=1e-6)


@pytest.mark.skipif(not COMPILERS, reason="no compiler is installed")
def test_generated_c_agrees() -> None:
    code, along, (expected, _) = Code(robot_of("3rps")), motion("3rps", TIMES), reduced("3rps")
    state = code.start()
    assert code.go_to(state, along.x[0]) == 0
    tau = rp.distribute(expected).tau
    for k in range(len(along)):
        got = code.efforts(state, along.x[k], along.xd[k], along.xdd[k])
        near(got.tau, tau[k])
        near(got.W.reshape(3, 3), expected.W[k])
        feet = code.platform(
            state, actuators("3rps", along.x[k : k + 1])[0], slopes("3rps", along.x[k : k + 1])[0].T @ along.xd[k]
        )
        near(feet.x, along.x[k])
        near(feet.xd, along.xd[k], 1e-9)


@pytest.mark.parametrize("axes", [("x", "y", "z"), ("rx", "ry", "rz"), ("y", "z", "rx"), ("z", "rx")], ids="-".join)
def test_axes_that_do_not_fit_are_refused_with_some_that_do(axes: tuple[str, ...], tmp_path: Path) -> None:
    folder = shutil.copytree(models_root() / "gallery" / "3rps", tmp_path / "3rps")
    data = yaml.safe_load((folder / "robot.yaml").read_text(encoding="utf-8"))
    data["independent"]["axes"] = list(axes)
    pose = {"xyz": [0, 0, 0.5]} if axes == ("rx", "ry", "rz") else [0.5 if axis == "z" else 0 for axis in axes]
    data["reference"]["platform"] = pose
    (folder / "robot.yaml").write_text(yaml.safe_dump(data), encoding="utf-8")
    with pytest.raises(DeclarationError) as caught:
        rp.load_robot(folder)
    assert "These axes of 'platform' fit: [z, rx, ry]." in caught.value.remedy


# --- starts for poses that the straight way does not reach, whatever the size of the machine

SHORT = 0.12
"""Length of the links, as a part of that of the machine: little more than spans from the base to a level platform."""


def found(dynamics: Dynamics, x: Array) -> BoolArray:
    """Return which coordinates have a configuration, each looked for by itself."""
    rest = np.zeros((1, dynamics.robot.n))
    one_by_one = [rp.PlatformMotion([0.0], each[None], rest, rest) for each in x]
    return np.array([dynamics.along(one, unreachable="mark").reduce().reachable[0] for one in one_by_one])


@pytest.mark.parametrize("size", [0.01, pytest.param(100.0, marks=pytest.mark.long)])
def test_poses_out_of_reach_are_told_from_others(size: float, tmp_path: Path) -> None:
    """Of a 3-PRS, those at which a link does not span from its slide to its ball joint."""
    x = np.array([0.6, 0.0, 0.0]) + np.random.default_rng(5).uniform(-1.0, 1.0, (12, 3)) * [1.5, 0.7, 0.7]
    expected = np.isfinite(actuators("3prs", x, link=SHORT)).all(axis=1)
    assert 3 <= expected.sum() <= 9
    dynamics = CompiledDynamics(robot_called("3prs", tmp_path, size, link=SHORT))
    np.testing.assert_array_equal(found(dynamics, x * [size, 1.0, 1.0]), expected)


LENGTHS = (
    "base_radius",
    "platform_radius",
    "cylinder_length",
    "cylinder_radius",
    "piston_length",
    "piston_radius",
    "height",
)


def gough(size: float) -> Robot:
    """Return the platform with all lengths so many times as long."""
    plain = zoo.robot_of("gough")
    return rp.load_robot("gough", **{name: float(plain.parameters[name]) * size for name in LENGTHS})


@pytest.mark.long
@pytest.mark.parametrize("size", [0.001, 0.01, 100.0])
def test_a_gough_platform_finds_its_legs(size: float) -> None:
    """Each leg is the vector between its joints, anywhere within 1.5 m and turned by up to half a turn about each axis:
    there is always one, as slides have no ends here."""
    robot, rng = gough(size), np.random.default_rng(3)
    x = np.repeat(np.eye(4)[None], 60, axis=0)
    x[:, :3, 3] = rng.uniform(-1.5, 1.5, (60, 3)) * size
    x[:, :3, :3] = Rotation.from_rotvec(rng.uniform(-2.6, 2.6, (60, 3))).as_matrix()
    assert found(CompiledDynamics(robot), x).all()


@pytest.mark.parametrize("size", [0.01, 100.0])
def test_noise_of_a_start_counts_in_lengths_of_the_machine(size: float) -> None:
    """A hundredth of a margin of 0.1 is noise for every size, and a tenth of the machine is none."""
    robot, random = gough(size), np.random.default_rng(5)
    backends = CompiledDynamics(robot), rp.RneaDynamics(robot)
    x, zero, unit = follower(robot).home.x, np.zeros(6), velocity_unit(robot)
    for noise, status in ((1e-4, SampleStatus.OK), (0.3, SampleStatus.BRANCH_LOST)):
        for _ in range(5):
            start = pin.integrate(robot.model, robot.q_reference, noise * random.normal(size=len(unit)) * unit)
            assert [one.torque(x, zero, zero, start=start).status for one in backends] == [status, status]
