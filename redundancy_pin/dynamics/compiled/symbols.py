"""The closed chain written in casadi's symbols: closures, platform and Newton–Euler over a Pinocchio tree.

Everything is scalar expressions (SX), so that what does not move, or is zero in a plane, costs nothing. Spatial vectors
are in the frames of the bodies, as in Featherstone, "Rigid Body Dynamics Algorithms", 2008, chapter 5:

    V_i = ⁱX_p V_p + S_i v_i,   A_i = ⁱX_p A_p + S_i v̇_i + V_i × S_i v_i,   F_i = I_i A_i + V_i ×* I_i V_i + Σ F_child,

and the generalised force of joint i is S_iᵀ F_i. Constraint rows are differentiated by casadi and not by hand: with
q̇ = E(q) v, the rate of a row y(q) is ∂y/∂q E v, and its bias the rate of that at v̇ = 0.

This module shares nothing with ``kinematics`` and ``dynamics.rnea``, which it is compared with.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import IntArray
from redundancy_pin.dynamics.compiled.load_symbols import LoadSymbols
from redundancy_pin.dynamics.compiled.parameters import (
    Topology,
    layout_of,
    numbers_of,
    places_of,
    pose_columns,
    topology_of,
    turning_joints,
)
from redundancy_pin.errors import UnsupportedRobotError
from redundancy_pin.robot import AXES, Closure, Robot, Wrench
from redundancy_pin.robot.checks import is_pose
from redundancy_pin.robot.loads import of_kind
from redundancy_pin.robot.lookup import find_joint, find_link
from redundancy_pin.robot.types import slides

SX: TypeAlias = Any
"""casadi.SX; casadi has no type hints."""


class _Casadi:
    """The library casadi, imported at its first use: an import takes 0.2 s, and robots in the cache need none."""

    def __getattr__(self, name: str) -> Any:
        import casadi

        return getattr(casadi, name)


ca: Any = _Casadi()


@dataclass(frozen=True, eq=False)
class _Joint:
    """A joint: where its frame is in its parent's at q, its motion subspace S, and q̇ = E(q) v."""

    index: int
    parent: int
    q: slice
    v: slice
    rotation: SX
    translation: SX
    subspace: SX
    axis: SX
    rate: SX
    moved: SX


class SymbolicChain:
    """Expressions of the robots of one topology.

    Args:
        robot: one of them.
        topology: the common topology; the robot's topology when left out, which may have more parameters.

    Attributes:
        parameters: the vector of the robot's numbers, see ``parameters.parameter_vector``: scales, then ``model``.
        model_numbers: (F) all numbers of ``parameters.numbers_of``: the structural ones, and parameters.
        q, v, a: configuration (nq), velocity and acceleration (nv) of the tree, carriers included.
        trig: cosine and sine of each angle of ``turning``, one after the other: computed once for many functions at one
            configuration.
        turning: indices in q of the joints that turn and are no carriers.
        external: (6 w) force and moment of each wrench on the robot, in its own axes.
        x: target coordinates: (n) numbers, or the 16 of a pose, row by row.
        pose_columns: (p,) velocity indices without the carriers'.
        equation_unit, step_unit: (r + n) and (p) the characteristic length for lengths and 1 for angles: residuals
            over the former and steps of the pose columns over the latter have no unit.
        rows: r, the number of closure rows.

    Raises:
        UnsupportedRobotError: a joint of a type that is not covered.
    """

    def __init__(self, robot: Robot, topology: Topology | None = None) -> None:
        self.robot, self.model = robot, robot.model
        self.topology, self._places = topology or topology_of(robot), places_of(robot)
        self.layout = layout_of(self.topology)
        self.parameters = ca.SX.sym("parameters", self.layout.size)
        self.length = self._section("LENGTH")
        self.model_numbers = ca.SX(numbers_of(robot).values)
        free = np.flatnonzero(self.topology.free).tolist()
        self.model_numbers[free] = self._section("MODEL")
        self.q, self.v, self.a = (
            ca.SX.sym(name, size) for name, size in (("q", self.model.nq), ("v", self.model.nv), ("a", self.model.nv))
        )
        self.is_pose = is_pose(robot)
        self.x = ca.SX.sym("x", 16 if self.is_pose else robot.n)
        self.step = ca.SX.sym("step", self.model.nv)
        self.external = ca.SX.sym("external", 6 * len(of_kind(robot.loads, Wrench)))
        self._loads = LoadSymbols(self, ca, self.external)
        self.turning = turning_joints(robot)
        self.trig = ca.SX.sym("trig", 2 * len(self.turning))
        self._joints = [self._joint(index) for index in range(1, self.model.njoints)]
        self.pose_columns: IntArray = pose_columns(robot)
        self.equation_unit = self._section("EQUATION_UNIT")
        self.step_unit = self._section("VELOCITY_UNIT")[self.pose_columns.tolist()]
        self.rows = self.equation_unit.numel() - robot.n
        self._place()

    def _section(self, name: str) -> SX:
        """Return a section of the parameters, as a column."""
        start = self.layout.starts[name]
        return self.parameters[start : start + self.layout.sizes[name]]

    def number(self, *key: Any) -> SX:
        """Return the numbers of a key of ``parameters.places_of``, as a column."""
        return self.model_numbers[self._places[key]]

    def _matrix(self, *key: Any) -> SX:
        """Return numbers that stand row by row as a matrix of three columns."""
        return ca.reshape(self.number(*key), 3, 3).T

    def _joint(self, index: int) -> _Joint:
        model, joint = self.model, self.model.joints[index]
        kind = _kind(joint)
        at_q, at_v = slice(joint.idx_q, joint.idx_q + joint.nq), slice(joint.idx_v, joint.idx_v + joint.nv)
        subspace = ca.reshape(self.number("joint", index, "subspace"), joint.nv, 6).T
        axis = subspace[:3, 0] if kind.startswith("P") else subspace[3:, 0]
        q, v, step = self.q[at_q], self.v[at_v], self.step[at_v]
        nothing = ca.SX.zeros(3)
        if kind.startswith("P") and kind != "Planar":
            turned, shift, rate, moved = ca.SX.eye(3), axis * q, v, q + step
        elif kind == "Translation":
            turned, shift, rate, moved = ca.SX.eye(3), q, v, q + step
        elif kind == "Planar":
            turned = _about(ca.SX([0.0, 0.0, 1.0]), q[2], q[3])
            shift = ca.vertcat(q[0], q[1], 0.0)
            along = turned[:2, :2]
            rate = ca.vertcat(along @ v[:2], -q[3] * v[2], q[2] * v[2])
            moved = ca.vertcat(q[:2] + along @ step[:2], _turned_by(q[2:], step[2]))
        elif kind == "FreeFlyer":
            turned, shift = _of_quaternion(q[3:]), q[:3]
            rate = ca.vertcat(turned @ v[:3], 0.5 * _times_vector(q[3:], v[3:]))
            moved = ca.vertcat(q[:3] + turned @ step[:3], _quaternion_moved(q[3:], step[3:]))
        elif kind == "Spherical":
            turned, shift, rate = _of_quaternion(q), nothing, 0.5 * _times_vector(q, v)
            moved = _quaternion_moved(q, step)
        elif kind.startswith("RUB") or kind == "RevoluteUnboundedUnaligned":
            turned, shift = _about(axis, q[0], q[1]), nothing
            rate, moved = ca.vertcat(-q[1] * v, q[0] * v), _turned_by(q, step)
        elif kind.startswith("R") and joint.nq == 1:
            cosine, sine = self._trig_of(joint.idx_q)
            turned, shift, rate, moved = _about(axis, cosine, sine), nothing, v, q + step
        else:
            raise UnsupportedRobotError(
                f"Joint {model.names[index]!r} has type {kind}, which compiled dynamics do not cover.",
                remedy="Build it from revolute, continuous, prismatic, planar, ball or floating joints, or use "
                "RneaDynamics.",
                joint=model.names[index],
                type=kind,
            )
        rotation, translation = self._matrix("joint", index, "rotation"), self.number("joint", index, "origin")
        return _Joint(
            index,
            int(model.parents[index]),
            at_q,
            at_v,
            rotation @ turned,
            translation + rotation @ shift,
            subspace,
            axis,
            rate,
            moved,
        )

    def _inertia(self, index: int) -> tuple[SX, SX, SX]:
        """Return mass, first moment (3) and inertia about the joint's origin (3, 3) of a body."""
        body = self.number("joint", index, "body")
        xx, xy, yy, xz, yz, zz = ca.vertsplit(body[4:])
        columns = [ca.vertcat(*column) for column in ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))]
        return body[0], body[1:4], ca.horzcat(*columns)

    def _inertial_force(self, index: int, motion: tuple[SX, SX, SX, SX]) -> tuple[SX, SX]:
        """Return force and moment (3) that give a body its motion, about its joint's origin, in its frame.

        Args:
            index: the joint that moves the body.
            motion: angular velocity, velocity of the origin, and the rates of both, Featherstone's.
        """
        (w, u, dw, du) = motion
        mass, first, inertia = self._inertia(index)
        momentum = mass * u + ca.cross(w, first)
        push = mass * du + ca.cross(dw, first)
        spin = inertia @ w + ca.cross(first, u)
        moment = inertia @ dw + ca.cross(first, du) + ca.cross(w, spin) + ca.cross(u, momentum)
        return push + ca.cross(w, momentum), moment

    def _trig_of(self, index: int) -> tuple[SX, SX]:
        """Return cosine and sine of an entry of q."""
        if index in self.turning:
            at = 2 * self.turning.index(index)
            return self.trig[at], self.trig[at + 1]
        return ca.cos(self.q[index]), ca.sin(self.q[index])

    def _place(self) -> None:
        """Place the frames of closures and platform in the world, and give them their velocities."""
        world = {0: (ca.SX.eye(3), ca.SX.zeros(3), ca.SX.zeros(3), ca.SX.zeros(3))}
        for joint in self._joints:
            rotation, origin, spin, speed = world[joint.parent]
            turned = rotation @ joint.rotation
            arm = rotation @ joint.translation
            own = joint.subspace @ self.v[joint.v]
            new_spin = spin + turned @ own[3:]
            world[joint.index] = turned, origin + arm, new_spin, speed + ca.cross(spin, arm) + turned @ own[:3]
        self._world = world

    def frame(self, name: str) -> tuple[SX, SX, SX, SX]:
        """Return rotation (3, 3), origin (3), angular velocity (3) and velocity of the origin (3) of a link, world."""
        frame = find_link(self.model, name)
        rotation, origin, spin, speed = self._world[int(frame.parentJoint)]
        turned, arm = self._matrix("link", name, "rotation"), rotation @ self.number("link", name, "origin")
        return rotation @ turned, origin + arm, spin, speed + ca.cross(spin, arm)

    @cached_property
    def configuration_rate(self) -> SX:
        """(nq) q̇ = E(q) v."""
        return ca.vertcat(*(joint.rate for joint in self._joints))

    @cached_property
    def rates(self) -> SX:
        """Rates of q and trig, linear in v."""
        q_rate = self.configuration_rate
        rates = [q_rate]
        for i, index in enumerate(self.turning):
            rates += [-self.trig[2 * i + 1] * q_rate[index], self.trig[2 * i] * q_rate[index]]
        return ca.vertcat(*rates)

    def rate_of(self, expression: SX) -> SX:
        """Return the rate of an expression in q and trig (and v, constant), ∂/∂q · E v."""
        return ca.jtimes(expression, ca.vertcat(self.q, self.trig), self.rates)

    def by_tangent(self, expression: SX) -> SX:
        """Return the derivative (rows, nv) of an expression in q and trig by a tangent step of the tree."""
        return ca.jacobian(expression, ca.vertcat(self.q, self.trig)) @ ca.jacobian(self.rates, self.v)

    @cached_property
    def closure_rows(self) -> SX:
        """(r) closure residuals, m; for rotation rows the sine of the error angle; then the rows of couplings."""
        robot = self.robot
        rows = [
            self._rod(i) if closure.is_rod else self._closure_row(closure, axis)
            for i, closure in enumerate(robot.closures)
            for axis in closure.axes
        ]
        for i, each in enumerate(robot.couplings):
            joint, of = (find_joint(self.model, name).idx_q for name in (each.joint, each.of or each.joint))
            polynomial, factors = (self.number("coupling", i, what) for what in ("polynomial", "also"))
            polynomial = ca.vertsplit(polynomial)
            also = [find_joint(self.model, name).idx_q for name, _ in each.also]
            more = ca.dot(factors, self.q[also]) if also else 0.0
            rows.append(self.q[joint] - more - sum(c * self.q[of] ** power for power, c in enumerate(polynomial)))
        return ca.vertcat(*rows) if rows else ca.SX(0, 1)

    def _rod(self, number: int) -> SX:
        """Return the squared length of a rod minus its nominal square, over twice the nominal length, m."""
        closure, length = self.robot.closures[number], self.number("rod", number)
        line = self.frame(closure.frame_b)[1] - self.frame(closure.frame_a)[1]
        return 0.5 * (ca.dot(line, line) / length - length)

    def _closure_row(self, closure: Closure, axis: str) -> SX:
        (rotation_a, origin_a, *_), (rotation_b, origin_b, *_) = (
            self.frame(closure.frame_a),
            self.frame(closure.frame_b),
        )
        turning, k = divmod(AXES.index(axis), 3)
        if not turning:
            return ca.dot(rotation_a[:, k], origin_b - origin_a)
        # what is off is a small rotation ε of B in A: the columns of AᵀB are e_c + ε × e_c
        between = rotation_a.T @ rotation_b
        i, j = (k + 1) % 3, (k + 2) % 3
        free = [c for c in range(3) if AXES[3 + c] not in closure.axes]
        if free == [j]:  # the other column of the hinge's own axis is equivalent, and stays exact for large angles
            return -between[i, j]
        return between[j, i]

    @cached_property
    def alignment(self) -> SX:
        """Positive where axes of hinges and welds coincide, and a pose is less than a quarter turn off its target.

        False closures have cosines of −1, and of 0 where the axes of a weld changed places: less a half, or their
        rounding would choose.
        """
        cosines = [ca.SX(1.0)]
        for closure in self.robot.closures:
            free = [k for k in range(3) if AXES[3 + k] not in closure.axes]
            between = self.frame(closure.frame_a)[0].T @ self.frame(closure.frame_b)[0]
            cosines += [between[k, k] - 0.5 for k in {0: [0, 1, 2], 1: free}.get(len(free), [])]
        if self.is_pose:
            turn = self._to_target()
            cosines.append(0.5 * (ca.trace(turn) - 1.0))
        return ca.vertcat(*cosines)

    def _to_target(self) -> SX:
        name = self.robot.platform.frame if self.robot.platform else ""
        return ca.reshape(self.x, 4, 4).T[:3, :3] @ self.frame(name)[0].T

    @cached_property
    def missing(self) -> SX:
        """(n) residual of the target coordinates, m and rad; of a pose the sine of the angle, as a vector."""
        platform = self.robot.platform
        if platform is None:
            return ca.vertcat(*(self._joint_missing(i, name) for i, name in enumerate(self.robot.independent_joints)))
        rotation, origin, *_ = self.frame(platform.frame)
        rows = []
        if self.is_pose:
            turn = self._to_target()
            place = ca.reshape(self.x, 4, 4).T[:3, 3]
            vector = 0.5 * ca.vertcat(turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1])
            full = ca.vertcat(place - origin, vector)
            return ca.vertcat(*(full[AXES.index(axis)] for axis in platform.axes))
        for i, axis in enumerate(platform.axes):
            turning, k = divmod(AXES.index(axis), 3)
            rows.append(_wrapped(self.x[i] - self._angle(rotation, k)) if turning else self.x[i] - origin[k])
        return ca.vertcat(*rows)

    def _joint_missing(self, i: int, name: str) -> SX:
        joint = find_joint(self.model, name)
        q = self.q[joint.idx_q : joint.idx_q + joint.nq]
        return _wrapped(self.x[i] - ca.atan2(q[1], q[0])) if joint.nq == 2 else self.x[i] - q

    def _angle(self, rotation: SX, k: int) -> SX:
        """Return the coordinate that is a rotation about base axis k, of fewer than three; see ``Platform``."""
        platform = self.robot.platform
        if platform is None or len(platform.rotations) == 1:
            column = platform.pointer if platform else 0
            return ca.atan2(rotation[(k + 2) % 3, column], rotation[(k + 1) % 3, column])
        level = ca.sqrt(rotation[0, 0] ** 2 + rotation[1, 0] ** 2)
        sine, cosine = {
            0: (rotation[2, 1], rotation[2, 2]),
            1: (-rotation[2, 0], level),
            2: (rotation[1, 0], rotation[0, 0]),
        }[k]
        return ca.atan2(sine, cosine)

    def _angle_rate(self, rotation: SX, spin: SX, k: int) -> SX:
        """Return the rate of that coordinate: of a platform that nothing else turns, a component of its spin."""
        platform = self.robot.platform
        across = [spin[axis] for axis in range(3) if axis != k]
        if self.is_pose or (platform and len(platform.rotations) == 1 and all(part.is_zero() for part in across)):
            return spin[k]
        return self.rate_of(self._angle(rotation, k))

    @cached_property
    def coordinates(self) -> SX:
        """(n) independent coordinates at q, or the 16 of a pose, row by row."""
        platform = self.robot.platform
        if platform is None:
            joints = [find_joint(self.model, name) for name in self.robot.independent_joints]
            parts = [self.q[joint.idx_q : joint.idx_q + joint.nq] for joint in joints]
            return ca.vertcat(*(ca.atan2(q[1], q[0]) if q.numel() == 2 else q for q in parts))
        rotation, origin, *_ = self.frame(platform.frame)
        if self.is_pose:
            pose = ca.vertcat(ca.horzcat(rotation, origin), ca.SX([[0.0, 0.0, 0.0, 1.0]]))
            return ca.vec(pose.T)
        turned = [divmod(AXES.index(axis), 3) for axis in platform.axes]
        return ca.vertcat(*(self._angle(rotation, k) if turning else origin[k] for turning, k in turned))

    @cached_property
    def row_rates(self) -> SX:
        """(p) rates of the closure rows, then the independent velocities: K v, linear in v."""
        platform = self.robot.platform
        closures = self.rate_of(self.closure_rows) if self.rows else ca.SX(0, 1)
        if platform is None:
            joints = (find_joint(self.model, name) for name in self.robot.independent_joints)
            return ca.vertcat(closures, *(self.v[joint.idx_v] for joint in joints))
        rotation, _, spin, speed = self.frame(platform.frame)
        axes = [divmod(AXES.index(axis), 3) for axis in platform.axes]
        own = [self._angle_rate(rotation, spin, k) if turning else speed[k] for turning, k in axes]
        return ca.vertcat(closures, *own)

    @cached_property
    def K(self) -> SX:
        """(p, p) rows over the velocities that move the pose."""
        return ca.jacobian(self.row_rates, self.v)[:, self.pose_columns.tolist()]

    @cached_property
    def bias(self) -> SX:
        """(p) the rate of K v at v̇ = 0."""
        return self.rate_of(self.row_rates)

    @cached_property
    def moved(self) -> SX:
        """(nq) the configuration a tangent step away, to first order in the step."""
        return ca.vertcat(*(joint.moved for joint in self._joints))

    @cached_property
    def mode_indicators(self) -> SX:
        """(legs) times the robot's own mode: positive in it."""
        modes = self.robot.working_modes
        values = []
        for i, name in enumerate(modes.joints if modes else ()):
            joint = find_joint(self.model, name)
            q = self.q[joint.idx_q : joint.idx_q + joint.nq]
            side = q[1] if joint.nq == 2 else q / self.length if slides(joint) else self._trig_of(joint.idx_q)[1]
            values.append(self.number("mode")[i] * side)
        return ca.vertcat(*values) if values else ca.SX(0, 1)

    @cached_property
    def efforts(self) -> tuple[SX, SX]:
        """(nv) generalised forces of the open tree, and (6) what holds the base: about the world origin, world axes."""
        model, gravity = self.model, self.number("gravity")
        motions: dict[int, tuple[SX, SX, SX, SX]] = {0: (ca.SX.zeros(3), ca.SX.zeros(3), ca.SX.zeros(3), -gravity)}
        forces: dict[int, list[SX]] = {0: [ca.SX.zeros(3), ca.SX.zeros(3)]}
        for joint in self._joints:
            spin, speed, turn, pull = motions[joint.parent]
            into, arm = joint.rotation.T, joint.translation
            own, rest = joint.subspace @ self.v[joint.v], joint.subspace @ self.a[joint.v]
            w, u = into @ spin + own[3:], into @ (speed + ca.cross(spin, arm)) + own[:3]
            dw = into @ turn + rest[3:] + ca.cross(w, own[3:])
            du = into @ (pull + ca.cross(turn, arm)) + rest[:3] + ca.cross(w, own[:3]) + ca.cross(u, own[3:])
            motions[joint.index] = w, u, dw, du
            forces[joint.index] = list(self._inertial_force(joint.index, (w, u, dw, du)))

        def push(index: int, place: SX, force: SX, moment: SX) -> None:
            rotation, origin, *_ = self._world[index]
            forces[index][0] -= rotation.T @ force
            forces[index][1] -= rotation.T @ (moment + ca.cross(place - origin, force))

        self._loads.on_bodies(push)
        efforts = ca.SX.zeros(model.nv)
        for joint in reversed(self._joints):
            force, moment = forces[joint.index]
            efforts[joint.v] = joint.subspace.T @ ca.vertcat(force, moment)
            if joint.subspace.shape[1] in (1, 3):
                axis = joint.rotation @ joint.axis
                own = self.q[joint.q][0], self.v[joint.v], self.a[joint.v]
                effort, turned = self._loads.in_joint(joint.index, own, axis, *motions[joint.parent][0:3:2])
                efforts[joint.v] += effort
                forces[joint.parent][1] += turned
            back = joint.rotation @ force
            forces[joint.parent][0] += back
            forces[joint.parent][1] += joint.rotation @ moment + ca.cross(joint.translation, back)
        return efforts + self.number("armature") * self.a, ca.vertcat(*forces[0])

    @cached_property
    def energy(self) -> SX:
        """Kinetic plus potential energy, J; zero height at the world origin."""
        total = 0.0
        for joint in self._joints:
            rotation, origin, spin, speed = self._world[joint.index]
            mass, first, inertia = self._inertia(joint.index)
            w, u = rotation.T @ spin, rotation.T @ speed
            total += 0.5 * mass * ca.dot(u, u) + ca.dot(u, ca.cross(w, first)) + 0.5 * ca.dot(w, inertia @ w)
            total -= ca.dot(self.number("gravity"), mass * origin + rotation @ first)
        total += self._loads.energy(self._in_world)
        return total + 0.5 * ca.dot(self.number("armature"), self.v**2)

    def _in_world(self, index: int) -> tuple[SX, SX, SX, SX]:
        """Return position, rate and axis of a joint of one freedom, and the angular velocity of the link before it."""
        joint = next(joint for joint in self._joints if joint.index == index)
        axis = self._world[index][0] @ joint.axis
        return self.q[joint.q][0], self.v[joint.v], axis, self._world[joint.parent][2]


def _about(axis: SX, cosine: SX, sine: SX) -> SX:
    """Return the rotation about a unit axis (Rodrigues)."""
    square = axis @ axis.T
    return square + cosine * (ca.SX.eye(3) - square) + sine * ca.skew(axis)


def _wrapped(angle: SX) -> SX:
    return angle - 2.0 * np.pi * ca.floor(angle / (2.0 * np.pi) + 0.5)


def _turned_by(q: SX, angle: SX) -> SX:
    """Return cosine and sine turned by an angle."""
    c, s = ca.cos(angle), ca.sin(angle)
    turned = ca.vertcat(q[0] * c - q[1] * s, q[1] * c + q[0] * s)
    return turned / ca.sqrt(ca.dot(turned, turned))  # or rounding would pile up in a controller that runs for days


def _of_quaternion(q: SX) -> SX:
    """Return the rotation of a unit quaternion (x, y, z, w)."""
    x, y, z, w = q[0], q[1], q[2], q[3]
    return ca.vertcat(
        ca.horzcat(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)),
        ca.horzcat(2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)),
        ca.horzcat(2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)),
    )


def _times_vector(q: SX, vector: SX) -> SX:
    """Return the product of a quaternion (x, y, z, w) with a vector, (0, vector) from the right."""
    return ca.vertcat(q[3] * vector + ca.cross(q[:3], vector), -ca.dot(q[:3], vector))


def _quaternion_moved(q: SX, step: SX) -> SX:
    moved = q + 0.5 * _times_vector(q, step)
    return moved / ca.sqrt(ca.dot(moved, moved))


def _kind(joint: pin.JointModel) -> str:
    return str(joint.shortname()).removeprefix("JointModel")
