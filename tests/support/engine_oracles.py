"""Random open trees and motions for the tests of the engines."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pinocchio as pin
import zoo
from scipy.integrate import solve_ivp

from redundancy_pin import PlatformMotion
from redundancy_pin.arrays import Array
from redundancy_pin.robot import Robot


class Timed:
    """One of the zoo's smooth motions, as a trajectory that starts at time 0."""

    def __init__(self, robot: Robot, duration: float, seed: int = 0, speed: float = 4.0) -> None:
        self._motion = zoo.smooth_motion(robot, seed, speed=speed)
        self.duration = duration
        self.breaks = np.empty(0)

    def sample_at(self, times: Array) -> PlatformMotion:
        return self._motion.at(np.asarray(times, dtype=float))


def random_tree(seed: int, joints: int = 5, ordered: bool = True) -> Robot:
    """A branched tree without closures: skew axes, every supported type of joint, full inertias, skew gravity."""
    rng = np.random.default_rng(seed)
    model = pin.Model()
    axis = _unit(rng)
    kinds: list[Callable[[], object]] = [
        pin.JointModelRX,
        pin.JointModelPZ,
        lambda: pin.JointModelRevoluteUnaligned(axis),
        lambda: pin.JointModelPrismaticUnaligned(axis),
        pin.JointModelRUBY,
        pin.JointModelRZ,
    ]
    for index in range(joints):
        # Pinocchio's mass matrix wants branches one after the other: go on from the last joint, or from one below it
        below = [int(j) for j in model.supports[index]]
        parent = below[int(rng.integers(0, len(below)))] if index % 2 else index
        if not ordered:
            parent = (0, 1, 2, 1, 3, 2)[index % 6]
        kind = kinds[(index + seed) % len(kinds)]()
        joint = model.addJoint(parent, kind, _placement(rng), f"joint_{index}")
        points = rng.normal(size=(4, 3)) * 0.2
        model.appendBodyToJoint(joint, _points(points, rng.uniform(0.3, 1.0, 4)), _placement(rng, 0.1))
        model.addFrame(
            pin.Frame(f"frame_{index}", joint, model.getFrameId(f"joint_{index}"), _placement(rng), pin.FrameType.BODY)
        )
    model.gravity.linear = np.array([1.0, -2.0, -9.0])
    names = tuple(str(name) for name in model.names)[1:]
    return dataclasses.replace(
        zoo.robot_of("four_bar"),
        name="random tree",
        model=model,
        closures=(),
        platform=None,
        independent_joints=names,
        actuated=names,
        carriers=(),
        carrier_limits=(),
        q_reference=pin.neutral(model),
        working_modes=None,
        working_mode=(),
    )


def random_state(robot: Robot, seed: int) -> tuple[Array, Array]:
    rng = np.random.default_rng(seed)
    model = robot.model
    return pin.integrate(model, pin.neutral(model), rng.uniform(-1, 1, model.nv)), rng.uniform(-1, 1, model.nv)


def integrated(robot: Robot, q: Array, v: Array, effort: Callable[[float], Array], duration: float) -> Array:
    """Return the configuration an open tree reaches: Pinocchio's ABA under an adaptive Runge-Kutta of order 8."""
    model, data = robot.model, robot.model.createData()

    def rate(t: float, y: Array) -> Array:
        place = pin.integrate(model, q, y[: model.nv])
        return np.concatenate([y[model.nv :], pin.aba(model, data, place, y[model.nv :], effort(t))])

    start = np.concatenate([np.zeros(model.nv), v])
    solution = solve_ivp(rate, (0.0, duration), start, method="DOP853", rtol=1e-11, atol=1e-12)
    return pin.integrate(model, q, solution.y[: model.nv, -1])


def _unit(rng: np.random.Generator) -> Array:
    axis = rng.normal(size=3)
    return axis / np.linalg.norm(axis)


def _placement(rng: np.random.Generator, size: float = 0.4) -> pin.SE3:
    return pin.SE3(pin.exp3(rng.normal(size=3)), size * rng.normal(size=3))


def _points(points: Array, masses: Array) -> pin.Inertia:
    inertia = pin.Inertia.Zero()
    for point, mass in zip(points, masses, strict=True):
        inertia = inertia + pin.Inertia(float(mass), point, np.zeros((3, 3)))
    return inertia
