"""Robots, closed configurations and smooth motions that tests share. Everything is seeded and cached."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

from redundancy_pin import CarrierMotion, PlatformMotion, load_robot, trajectory
from redundancy_pin.arrays import Array
from redundancy_pin.kinematics.assembly import assemble
from redundancy_pin.kinematics.closure import ConstraintSystem
from redundancy_pin.kinematics.coordinates import coordinates, moved
from redundancy_pin.loading import robot_from_model
from redundancy_pin.robot import Robot
from redundancy_pin.robot.scales import row_scale
from redundancy_pin.robot.shipped import shipped_robots
from redundancy_pin.view import show
from redundancy_pin.visualisation.viewer.page import View

SHIPPED = shipped_robots(gallery=False)
"""Those that every test of all robots takes; those of the gallery have ``test_gallery.py``."""


WITH_CARRIERS: dict[str, dict[str, object]] = {"five_bar": {"carriers": True}}
"""The third planar machine with carriers, beside the two of the thesis: tests ask for them, it has none by itself."""


@functools.cache
def robot_of(name: str, **arguments: object) -> Robot:
    """Load a robot once a session (arguments must be hashable); those of ``WITH_CARRIERS`` with theirs."""
    robot = load_robot(name, **{**WITH_CARRIERS.get(name, {}), **arguments})
    _as_loaded.append((robot, robot.model.copy()))
    return robot


_as_loaded: list[tuple[Robot, pin.Model]] = []


def changed() -> list[str]:
    """Return the robots of ``robot_of`` whose model a test has written to: the tests after it meet another machine."""
    return [str(robot) for robot, model in _as_loaded if robot.model != model]


@functools.cache
def view_of(name: str) -> View:
    """Show a robot on its default motion, once a session."""
    return show(robot_of(name))


@functools.cache
def system_of(robot: Robot) -> ConstraintSystem:
    """Return the constraint system of a robot, built once a session."""
    return ConstraintSystem(robot)


@functools.cache
def home_of(robot: Robot) -> Array:
    """Return the coordinates (n,) or pose (4, 4) of the reference configuration."""
    system = system_of(robot)
    return coordinates(robot, system.evaluate(robot.q_reference[None]))[0]


def index(robot: Robot, name: str) -> int:
    """Return where the position of a joint begins in q."""
    return int(robot.model.joints[robot.model.getJointId(name)].idx_q)


def places_of(model: pin.Model, q: Array, *links: str) -> list[pin.SE3]:
    """Return where links are at a configuration (nq,)."""
    data = model.createData()
    pin.framesForwardKinematics(model, data, np.array(q))
    return [pin.SE3(data.oMf[model.getFrameId(name, pin.FrameType.BODY)]) for name in links]


def driven_by(robot: Robot, *joints: str) -> Robot:
    """Return a robot with other main actuators."""
    return robot_from_model(
        robot.model,
        closures=robot.closures,
        actuated=joints,
        carriers=robot.carriers,
        independent=robot.platform or {"joints": robot.independent_joints},
        reference=np.array(robot.q_reference),
    )


def add_body(model: pin.Model, parent: int, joint: pin.JointModel, x: float, y: float, name: str) -> int:
    """Add a joint at (x, y, 0) of its parent, m, with a body of 1 kg on it, and return its number."""
    number = int(model.addJoint(parent, joint, pin.SE3(np.eye(3), np.array([x, y, 0.0])), name))
    model.appendBodyToJoint(number, pin.Inertia(1.0, np.zeros(3), 0.01 * np.eye(3)), pin.SE3.Identity())
    return number


def reach_of(robot: Robot) -> Array:
    """Return (n,) an excursion about home that stays inside the workspace of every shipped robot, m and rad."""
    return 0.15 * robot.characteristic_length / row_scale(robot)


def leg_lengths(robot: Robot, pose: Array) -> Array:
    """Return (6,) distances between the joints on base and platform of a Gough at a pose (4, 4)."""
    model, data = robot.model, robot.model.createData()
    pin.framesForwardKinematics(model, data, np.array(robot.q_reference))
    middle = data.oMf[model.getFrameId("platform")]
    lengths = []
    for i in range(1, 7):
        base = data.oMi[model.getJointId(f"swing_{i}")].translation
        tip = data.oMf[model.getFrameId(f"corner_{i}")] if i > 1 else data.oMi[model.getJointId("ball_1_x")]
        lengths.append(np.linalg.norm(pose[:3, :3] @ middle.actInv(tip).translation + pose[:3, 3] - base))
    return np.array(lengths)


def random_tree(robot: Robot, seed: int, count: int) -> tuple[Array, Array]:
    """Return random open configurations (count, nq) and velocities (count, nv): chains not closed."""
    rng = np.random.default_rng(seed)
    model = robot.model
    steps = rng.uniform(-1.0, 1.0, (count, model.nv))
    q = np.array([pin.integrate(model, np.array(robot.q_reference), step) for step in steps])
    return q, rng.uniform(-1.0, 1.0, (count, model.nv))


def random_closed(robot: Robot, seed: int, count: int) -> Array:
    """Return closed configurations (count, nq) at random poses about home."""
    rng = np.random.default_rng(seed)
    increments = rng.uniform(-1.0, 1.0, (count, robot.n)) * reach_of(robot)
    targets = moved(robot, np.repeat(home_of(robot)[None], count, axis=0), increments)
    assembled = assemble(system_of(robot), np.repeat(robot.q_reference[None], count, axis=0), targets)
    assert assembled.closed.all()
    return assembled.q


@dataclass(frozen=True)
class SmoothMotion:
    """Two incommensurate sines a coordinate about home, with exact derivatives; poses turn about all three axes."""

    robot: Robot
    amplitude: Array
    frequency: Array
    phase: Array

    def angles(self, t: Array) -> tuple[Array, Array, Array]:
        """Return (N, n) the increments from home and their two derivatives."""
        argument = self.frequency * t[:, None, None] + self.phase
        value = (self.amplitude * np.sin(argument)).sum(axis=1)
        rate = (self.amplitude * self.frequency * np.cos(argument)).sum(axis=1)
        second = -(self.amplitude * self.frequency**2 * np.sin(argument)).sum(axis=1)
        return value, rate, second

    def at(self, t: Array) -> PlatformMotion:
        """Return the motion at times t (N,)."""
        t = np.asarray(t, dtype=float)
        value, rate, second = self.angles(t)
        home = home_of(self.robot)
        if home.ndim == 1:
            return PlatformMotion(t, home + value, rate, second)
        pose = np.repeat(home[None], len(t), axis=0)
        pose[:, :3, 3] += value[:, :3]
        turn, omega, alpha = _turning(value[:, 3:], rate[:, 3:], second[:, 3:])
        pose[:, :3, :3] = turn @ home[:3, :3]
        return PlatformMotion(
            t, pose, np.concatenate([rate[:, :3], omega], axis=1), np.concatenate([second[:, :3], alpha], axis=1)
        )


def smooth_motion(robot: Robot, seed: int = 0, scale: float = 1.0, speed: float = 4.0) -> SmoothMotion:
    """Return a random smooth motion about home; ``speed`` is its highest frequency in rad/s."""
    rng = np.random.default_rng(seed)
    amplitude = rng.uniform(0.2, 0.5, (2, robot.n)) * reach_of(robot) * scale
    frequency = speed * rng.uniform(0.5, 1.0, (2, robot.n))
    return SmoothMotion(robot, amplitude, frequency, rng.uniform(0.0, 2 * np.pi, (2, robot.n)))


def carriers_at(robot: Robot, t: Array, seed: int = 0, speed: float = 5.0) -> CarrierMotion:
    """Return a smooth carrier motion within the tracks, with exact derivatives."""
    rng = np.random.default_rng(seed + 1000)
    half = np.array([min(-limits.lower, limits.upper) for limits in robot.carrier_limits])
    amplitude = 0.7 * half * rng.uniform(0.5, 1.0, robot.k)
    frequency, phase = speed * rng.uniform(0.5, 1.0, robot.k), rng.uniform(0.0, 2 * np.pi, robot.k)
    argument = frequency * np.asarray(t)[:, None] + phase
    return CarrierMotion(
        amplitude * np.sin(argument),
        amplitude * frequency * np.cos(argument),
        -amplitude * frequency**2 * np.sin(argument),
    )


def _turning(angle: Array, rate: Array, second: Array) -> tuple[Array, Array, Array]:
    """Return R = Rz(c) Ry(b) Rx(a), its angular velocity and acceleration (world axes)."""
    x_axis, y_axis, z_axis = np.eye(3)
    about_z = Rotation.from_rotvec(angle[:, 2:] * z_axis).as_matrix()
    about_zy = about_z @ Rotation.from_rotvec(angle[:, 1:2] * y_axis).as_matrix()
    turn = about_zy @ Rotation.from_rotvec(angle[:, :1] * x_axis).as_matrix()
    omega = np.zeros((len(angle), 3))
    alpha = np.zeros((len(angle), 3))
    for axis, column in ((np.broadcast_to(z_axis, omega.shape), 2), (about_z @ y_axis, 1), (about_zy @ x_axis, 0)):
        alpha += second[:, column, None] * axis + rate[:, column, None] * np.cross(omega, axis)
        omega = omega + rate[:, column, None] * axis
    return turn, omega, alpha


def gough_crossing() -> trajectory.Trajectory:
    """The platform of the shipped Gough robot, level and 0.6 m high, turns from 70 to 110 degrees: singular at 90."""
    poses = np.tile(np.eye(4), (2, 1, 1))
    poses[:, :3, :3] = Rotation.from_euler("z", [[70.0], [110.0]], degrees=True).as_matrix()
    poses[:, 2, 3] = 0.6
    return trajectory.reference.pose(*poses, 1.0)
