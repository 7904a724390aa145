"""What a robot is: a Pinocchio tree, its closures, and the roles its joints play."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array, Frozen, IntArray, frozen, numbers, read_only, require_type
from redundancy_pin.errors import InputError
from redundancy_pin.robot.loads import Load, Payload, carrying, checked_loads, of_kind
from redundancy_pin.robot.lookup import find_joint

AXES = ("x", "y", "z", "rx", "ry", "rz")
"""Names of the rows a closure or a platform may use: translations, then rotations."""


def joint_position(joint: pin.JointModel, q: Array) -> Array:
    """Return (...) the position of a joint of one freedom at configurations (..., nq), m or rad.

    A continuous joint has a cosine and a sine in q: its angle is theirs, in (−π, π].
    """
    at = int(joint.idx_q)
    position: Array = np.arctan2(q[..., at + 1], q[..., at]) if joint.nq == 2 else q[..., at]
    return position


def slides(joint: pin.JointModel) -> bool:
    """Return whether a joint is prismatic; Pinocchio has a class for each axis (``JointModelPX``), and one for any."""
    return joint.nv == 1 and str(joint.shortname()).startswith("JointModelP")


@dataclass(frozen=True)
class Closure:
    """A loop closure: two frames of the tree that coincide along some axes.

    Attributes:
        name: what to call it in messages.
        frame_a, frame_b: names of the two frames (URDF links).
        axes: the constrained axes, a subset of ``AXES``, read in frame a. A planar pin joint is
            ``("x", "y")``, a hinge about z ``("x", "y", "z", "rx", "ry")``, a ball joint ``("x", "y", "z")``.
            ``("distance",)`` is a rod without mass that holds the origins of both frames at a constant distance.
        length: that distance, m; zero without a rod.
    """

    name: str
    frame_a: str
    frame_b: str
    axes: tuple[str, ...]
    length: float = 0.0

    @property
    def is_rod(self) -> bool:
        """Whether it is a rod of constant length."""
        return self.axes == ("distance",)


@dataclass(frozen=True)
class Coupling:
    """A coupling of two joints, such as a pair of gears: the position of one is a polynomial in that of the other.

    Attributes:
        name: what to call it in messages.
        joint: the joint whose position q follows; of one freedom, revolute or prismatic.
        of: the joint whose position p is followed; empty for a joint that is fixed at a position.
        polynomial: (c₀, c₁, …) in q = c₀ + c₁ p + c₂ p² + …, rad and m; of one number where ``of`` is empty.
        also: further joints and the factors by which their positions are added.
    """

    name: str
    joint: str
    of: str
    polynomial: tuple[float, ...]
    also: tuple[tuple[str, float], ...] = ()

    @property
    def joints(self) -> tuple[str, ...]:
        """All joints that it couples."""
        return tuple(filter(None, (self.joint, self.of, *(name for name, _ in self.also))))


@dataclass(frozen=True)
class CarrierLimits:
    """Limits of one carrier; infinite where nothing is declared.

    Attributes:
        lower, upper: track ends, m.
        speed: largest |ṡ|, m/s.
        acceleration: largest |s̈|, m/s².
        force: largest |force| of the carrier's actuator, N.
    """

    lower: float
    upper: float
    speed: float
    acceleration: float
    force: float


@dataclass(frozen=True)
class Platform:
    """The platform frame and the part of its pose that is the independent coordinates.

    With all three rotations among the axes, coordinates are poses (4, 4) and velocities are components of the twist, in
    world-aligned axes at the platform origin. With fewer, coordinates are numbers and velocities their rates:

    - one rotation about the base axis k: the angle, about that axis, of one axis of the platform frame (``pointer``),
      seen along k. If the platform turns about k only, its rate is the component of the angular velocity.
    - two rotations: two of roll, pitch, yaw, as the axes name them, R = Rz(rz) Ry(ry) Rx(rx), as in URDF. The closures
      determine the third angle. The pitch lies in [−π/2, π/2].

    Attributes:
        frame: name of the frame (URDF link).
        axes: subset of ``AXES``, in that order.
        pointer: number of the axis of the platform frame that defines the angle of a single rotation.
    """

    frame: str
    axes: tuple[str, ...]
    pointer: int = 0

    @property
    def rotations(self) -> tuple[int, ...]:
        """Base axes of the rotations among the axes: 0, 1, 2 for rx, ry, rz."""
        return tuple(k for k, axis in enumerate(AXES[3:]) if axis in self.axes)

    @property
    def is_pose(self) -> bool:
        """Whether the platform coordinates are homogeneous poses."""
        return len(self.rotations) == 3


@dataclass(frozen=True)
class WorkingModes:
    """How the working mode is read off a configuration: one joint a leg, and the sign that counts as +1.

    Attributes:
        joints: the indicator joint of each leg; sin(q) of a revolute, q of a prismatic joint.
        signs: the sign of the indicator in mode +1.
    """

    joints: tuple[str, ...]
    signs: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Body(Frozen):
    """A rigid body that a joint carries, payloads included.

    Attributes:
        name: name of the link that the joint carries; of the joint where the model names no link there.
        joint: name of the joint.
        links: names of all links of the body, marks included.
        mass: mass, kg.
        centre: (3,) centre of mass in the frame of the body, which is the joint's frame, m.
        principal_moments: (3,) principal moments of inertia about the centre of mass, in ascending order, kg·m².
    """

    name: str
    joint: str
    links: tuple[str, ...]
    mass: float
    centre: Array
    principal_moments: Array


@dataclass(frozen=True, eq=False, repr=False)
class Robot(Frozen):
    """A closed-chain robot, loaded, checked and frozen.

    Symbols: nq and nv as in Pinocchio; n independent velocities, m main actuators, k carriers.

    Attributes:
        name: its name.
        parameters: the resolved xacro arguments.
        urdf: the rendered URDF.
        model: the Pinocchio tree; treat it as read-only. Whoever puts another one in its place passes
            ``closed_form=None``, too: closed forms read ``parameters``, not the model.
        closures: the loop closures.
        platform: the platform, or None where the independent velocities are named joints.
        independent_joints: names of the independent joints (empty when there is a platform).
        actuated: names of the main actuators.
        carriers: names of the carrier joints.
        carrier_limits: their limits, in the same order.
        q_reference: (nq,) a closed configuration in the working mode, carriers at zero.
        working_modes: how to read working modes, or None where the robot declares none.
        working_mode: the mode of this robot, ±1 per leg (empty if none is declared).
        characteristic_length: length, m, that makes rotations comparable with translations.
        closed_form: name of the closed-form model that covers this robot ("2rpr", "3rrr"), or None.
        source: what to pass to ``load_robot`` to load it again: name of a shipped robot or absolute path of its
            declaration; empty for a robot that was not loaded.
        urdf_folder: absolute path of the folder of the URDF, which names of mesh files are relative to; empty for a
            robot that was not loaded.
        own_meshes_only: draw it only with meshes of its folder or package: a file chose it, not its user.
        notes: choices of the loader that the model leaves open, and content of its file that is ignored.
        loads: forces other than gravity and inertia; ``model`` includes the payloads.
        couplings: joints whose positions follow the positions of others; each is one more constraint.
        all_closures: ``closures`` with their redundant rows, which were left out; empty if none were.
        dependent_residual: largest residual of the rows left out, near the reference, rad or characteristic lengths:
            the rounding of a file.
    """

    name: str
    parameters: Mapping[str, float | bool | str]
    urdf: str
    model: pin.Model
    closures: tuple[Closure, ...]
    platform: Platform | None
    independent_joints: tuple[str, ...]
    actuated: tuple[str, ...]
    carriers: tuple[str, ...]
    carrier_limits: tuple[CarrierLimits, ...]
    q_reference: Array
    working_modes: WorkingModes | None
    working_mode: tuple[int, ...]
    characteristic_length: float
    closed_form: str | None
    source: str = ""
    urdf_folder: str = ""
    own_meshes_only: bool = False
    notes: tuple[str, ...] = ()
    loads: tuple[Load, ...] = ()
    couplings: tuple[Coupling, ...] = ()
    all_closures: tuple[Closure, ...] = ()
    dependent_residual: float = 0.0

    def __repr__(self) -> str:
        """Return the facts that distinguish robots, not the whole URDF."""
        mode = "".join("+" if sign > 0 else "-" for sign in self.working_mode)
        shown = ", ".join(f"{name}={value}" for name, value in self.parameters.items())
        counts = f"n={self.n}, m={self.m}, k={self.k}"
        return f"Robot({self.name!r}, {counts}" + (f", mode {mode}" if mode else "") + (f"; {shown})" if shown else ")")

    def loaded(self, *loads: Load) -> Robot:
        """Return the robot with further loads: wrenches, payloads, forces in joints, springs.

        Raises:
            InputError: no load, an unknown link or joint.
            UnsupportedRobotError: a joint that cannot have that load.
        """
        added = checked_loads(self.model, loads)
        payloads = of_kind(added, Payload)
        model = carrying(self.model, payloads) if payloads else self.model
        return replace(self, model=model, loads=self.loads + added)

    @property
    def n(self) -> int:
        """Number of independent velocities."""
        return len(self.platform.axes) if self.platform else len(self.independent_joints)

    @property
    def m(self) -> int:
        """Number of main actuators."""
        return len(self.actuated)

    @property
    def k(self) -> int:
        """Number of carriers."""
        return len(self.carriers)

    @cached_property
    def actuated_velocity(self) -> IntArray:
        """(m,) index of each main actuator in v."""
        return _indices(self.model, self.actuated, "idx_v")

    @cached_property
    def carrier_velocity(self) -> IntArray:
        """(k,) index of each carrier in v."""
        return _indices(self.model, self.carriers, "idx_v")

    @cached_property
    def carrier_position(self) -> IntArray:
        """(k,) index of each carrier in q."""
        return _indices(self.model, self.carriers, "idx_q")

    def joint_positions(self, q: ArrayLike, joints: Sequence[str] | None = None) -> Array:
        """Return (J,) or (N, J) positions of joints at configurations, m and rad.

        They are what an encoder reads: of a continuous joint, which has its cosine and its sine in q, the angle in
        (−π, π].

        Args:
            q: (nq,) or (N, nq) configurations.
            joints: J names of joints of one freedom; the main actuators when left out.

        Raises:
            InputError: no joint of that name, a joint of several freedoms, or configurations of another size.

        Example:
            >>> motors = robot.joint_positions(robot.q_reference)
        """
        several = np.asarray(q, dtype=object).ndim > 1
        given = numbers(q, "q", ("N", self.model.nq) if several else (self.model.nq,))
        names = self.actuated if joints is None else joints
        require_type(names, (list, tuple), "A list of joints", "Pass names in a list, such as robot.actuated.")
        found = [find_joint(self.model, name) for name in names]
        if wide := [str(self.model.names[joint.id]) for joint in found if joint.nv != 1]:
            raise InputError(
                f"Joint {wide[0]!r} has several freedoms, and no position that is one number.",
                remedy="Name joints of one freedom each; the others are in q as Pinocchio has them.",
                joints=wide,
            )
        positions = np.empty((*given.shape[:-1], len(found)))
        for k, joint in enumerate(found):
            positions[..., k] = joint_position(joint, given)
        return positions

    @property
    def effort_limits(self) -> Array:
        """(2, m) smallest and largest efforts of the main actuators, N or N·m, of the file; infinite for none.

        A URDF's zero means "not known". Plans keep to them unless they are given other limits;
        ``rp.distribute(reduced, lower=low, upper=high)`` keeps to the limits that are passed.
        """
        model, columns = self.model, self.actuated_velocity
        limits = np.stack([model.lowerEffortLimit[columns], model.upperEffortLimit[columns]])
        none = np.array([[-np.inf], [np.inf]])
        return frozen(np.where((limits == 0.0).all(axis=0) | (np.abs(limits) >= np.finfo(float).max), none, limits))

    @property
    def speed_limits(self) -> Array:
        """(m,) largest rates of the main actuators, m/s or rad/s, of the file; infinite for none.

        A URDF's zero means "not known". Plans keep to them unless they are given other limits.
        """
        limits = self.model.upperVelocityLimit[self.actuated_velocity]
        return frozen(np.where((limits == 0.0) | (limits >= np.finfo(float).max), np.inf, limits))

    @property
    def constraint_names(self) -> tuple[str, ...]:
        """Names of the rows of the constraints, ``"x of tip_2 = corner_2"``: closures, then couplings."""
        rows = (f"{axis} of {closure.name}" for closure in self.closures for axis in closure.axes)
        return (*rows, *(f"coupling {coupling.name}" for coupling in self.couplings))

    @property
    def bodies(self) -> tuple[Body, ...]:
        """The moving bodies, in the order of the joints: mass, centre of mass and principal moments of each."""
        model = self.model
        links: dict[int, list[str]] = {index: [] for index in range(model.njoints)}
        for frame in model.frames:
            if frame.type == pin.FrameType.BODY:
                links[int(frame.parentJoint)].append(str(frame.name))
        return tuple(
            Body(
                name=(links[index] or [str(model.names[index])])[0],
                joint=str(model.names[index]),
                links=tuple(links[index]),
                mass=float(model.inertias[index].mass),
                centre=frozen(model.inertias[index].lever),
                principal_moments=frozen(np.linalg.eigvalsh(model.inertias[index].inertia)),
            )
            for index in range(1, model.njoints)
        )

    @property
    def moving_mass(self) -> float:
        """Mass of all moving bodies, kg."""
        return sum(body.mass for body in self.bodies)

    @property
    def gravity(self) -> Array:
        """(3,) acceleration of gravity in the world frame, m/s²."""
        vector: Array = self.model.gravity.linear.copy()
        return vector


def _indices(model: pin.Model, joints: Sequence[str], which: str) -> IntArray:
    return read_only(np.array([getattr(find_joint(model, name), which) for name in joints], dtype=np.intp))
