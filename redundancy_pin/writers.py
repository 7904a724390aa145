"""Write a robot as MJCF that MuJoCo runs: loops, couplings, motors, forces in joints.

The text is put together here and not by MuJoCo's ``MjSpec``, whose ``to_xml`` writes six digits: loops would be open by
1e-6 of their size, and a file that is read again would be another machine.
"""

from __future__ import annotations

import itertools
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import Array, positive
from redundancy_pin.errors import InputError, UnsupportedRobotError, shown
from redundancy_pin.io.files import require_writable, write_text
from redundancy_pin.kinematics.assembly import assemble
from redundancy_pin.kinematics.closure import ConstraintSystem
from redundancy_pin.kinematics.multistart import draw_starts
from redundancy_pin.kinematics.spinning_rods import UNIVERSAL
from redundancy_pin.kinematics.tree import motion_subspace
from redundancy_pin.loading import RobotLike, as_robot
from redundancy_pin.robot import AXES, Closure, Coupling, JointForces, Payload, Robot
from redundancy_pin.robot.lookup import find_joint_index, find_link
from redundancy_pin.robot.loop_joints import ends_of
from redundancy_pin.robot.scales import force_terms

IMPEDANCE = 0.9999
"""The highest impedance that MuJoCo accepts (its mjMAXIMP): the share of the acceleration a constraint may ask for."""

LEAST_INERTIA = 1e-12
"""Mass and moments of inertia of links that have none, relative to those of the machine: MuJoCo accepts no zero. This
changes the motion by a millionth of a micrometre on machines of a metre."""

_SMALLEST, _SMALL = 2e-15, 1e-6
"""kg and kg·m²: MuJoCo accepts no less than 1e-15 (its mjMINVAL); and the share of the machine's own that it may be."""

LEAST_SHARE = 1e-8
"""Smallest eigenvalue of the open tree's mass matrix, its diagonal scaled to 1, that MuJoCo can divide by: the rounding
of accelerations grows with its inverse."""

_TRIALS = 5
"""Random configurations at which a row has to be idle."""

_STILL = 1e-12
"""Rounding of a row, in characteristic lengths or rad."""

_AROUND, _ROUNDED = 0.1, 2e-5
"""How far from the reference frames are looked at, and how far they may part where a file is rounded, both in
characteristic lengths or rad."""

_NO_LIMIT, _FAR = 1e300, 1e10
"""rad or m: Pinocchio's joints without limits have those of doubles, 1.8e308; what stands for one where the other end
has a limit."""

_MOST_COUPLED = 5
"""Numbers of the polynomial of an equality of MuJoCo."""


def write_mjcf(robot: RobotLike, path: str | Path, *, step: float = 1e-3, reflected: bool = False) -> Path:
    """Write a robot as MJCF that MuJoCo runs: loops, couplings, motors, damping, and its reference as a keyframe.

    Joints and motors have the names of the robot's, main actuators first: ``data.ctrl`` are efforts, their limits
    ranges that cut nothing off. MuJoCo's constraints are soft; they are as stiff as it takes at that step.

    Args:
        robot: a robot, or its name or path.
        path: the file.
        step: of the integration, s.
        reflected: write the inertia of every rotor as armature, gear² · inertia. MJCF has no other, which is
            all there is to it where what carries the rotor cannot turn about its axis; others are refused without.

    Returns:
        The path that was written.

    Raises:
        UnsupportedRobotError: a joint, closure or load that MJCF does not have; a joint that moves no mass.
        OutputError: the file cannot be written.

    Example:
        >>> rp.write_mjcf("four_bar", "four_bar.xml").name
        'four_bar.xml'
    """
    robot, step = as_robot(robot), positive(step, "step", "s")
    target = require_writable(path)
    root = mjcf(robot, step, 2.0 * step, reflected=reflected)
    write_text(target, _xml(root))
    return target


def mjcf(
    robot: Robot,
    step: float,
    time_constant: float,
    impedance: float = IMPEDANCE,
    integrator: str = "RK4",
    *,
    reflected: bool = False,
) -> ElementTree.Element:
    """Return a robot as MJCF: joints, sites and motors by the names of the robot's joints and frames.

    Args:
        robot: the robot.
        step: of the integration, s.
        time_constant: of the soft constraints, s, critically damped.
        impedance: of the soft constraints.
        integrator: MuJoCo's name of the integrator.
        reflected: see ``write_mjcf``.

    Raises:
        UnsupportedRobotError: a joint, closure or load that MuJoCo does not have, or an open tree
            without inertia in some direction.
    """
    _require_inertia(robot)
    least = _least_inertia(robot)
    forces, armature = _forces(robot, reflected=reflected)
    model, data = robot.model, robot.model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    root = ElementTree.Element("mujoco", model=robot.name)
    _add(root, "compiler", angle="radian", autolimits="true", inertiafromgeom="false", fusestatic="false")
    solver = {"solver": "Newton", "tolerance": 0, "iterations": 50}
    option = _add(root, "option", gravity=robot.gravity, timestep=step, integrator=integrator, **solver)
    # ranges of efforts are said and not enforced, as here: what is beyond them is seen in a plan, not cut off unseen
    _add(option, "flag", contact="disable", warmstart="enable", clampctrl="disable")
    bodies = [_add(root, "worldbody")]
    for index in range(1, model.njoints):
        name, placement = str(model.names[index]), model.jointPlacements[index]
        parent = bodies[model.parents[index]]
        body = _add(parent, "body", name=name, pos=placement.translation, quat=_quaternion(placement.rotation))
        _add(body, "joint", **_joint(model, data, index, armature), **forces.get(name, {}))
        _inertial(body, model.inertias[index], least)
        bodies.append(body)
    tendons, equality = _add(root, "tendon"), _add(root, "equality")
    soft = {"solref": (time_constant, 1.0), "solimp": (impedance, impedance, 0.001, 0.5, 2.0)}
    sites: set[str] = set()
    for closure in robot.closures:
        kind, places = constraint_of(robot, closure)
        for number, offset in enumerate(places):
            names = [_free_name(f"{closure.name}:{number}{side}", sites) for side in "ab"]
            for name, frame in zip(names, (closure.frame_a, closure.frame_b), strict=True):
                _site(bodies, model, name, frame, offset)
            if closure.is_rod:
                rod = _add(tendons, "spatial", name=closure.name)
                for name in names:
                    _add(rod, "site", site=name)
                longer = closure.length - float(np.linalg.norm(np.subtract(*ends_of(closure, model, data))))
                _add(equality, kind, name=closure.name, tendon1=closure.name, polycoef=(longer, *[0.0] * 4), **soft)
            else:
                _add(equality, kind, site1=names[0], site2=names[1], **soft)
    for coupling in robot.couplings:
        _couple(equality, tendons, coupling, soft)
    if robot.platform is not None:
        frame = robot.platform.frame
        _site(bodies, model, _free_name(f"platform:{frame}", sites), frame, np.zeros(3))
    motors = _add(root, "actuator")
    strongest = np.array([limits.force for limits in robot.carrier_limits])
    efforts = np.hstack([robot.effort_limits, [-strongest, strongest]]).T
    for name, ends in zip((*robot.actuated, *robot.carriers), efforts, strict=True):
        limited = np.isfinite(ends).any() and ends[0] < ends[1]
        _add(motors, "motor", name=name, joint=name, **({"ctrlrange": np.clip(ends, -_FAR, _FAR)} if limited else {}))
    _add(_add(root, "keyframe"), "key", name="reference", qpos=_position(model, np.array(robot.q_reference)))
    return root


def _free_name(name: str, taken: set[str]) -> str:
    """Return a name that is not among those taken, and take it."""
    free = next(each for number in itertools.count() if (each := f"{name}{number or ''}") not in taken)
    taken.add(free)
    return free


def _couple(
    equality: ElementTree.Element, tendons: ElementTree.Element, coupling: Coupling, soft: dict[str, tuple[float, ...]]
) -> None:
    """Add a coupling: an equality of two joints, or of two tendons if it has further terms.

    The first tendon's length is q_joint − Σ f_i q_i, the second's q_of; both are zero at the initial configuration.
    """
    if len(coupling.polynomial) > _MOST_COUPLED:
        raise UnsupportedRobotError(
            f"The coupling {coupling.name!r} has a polynomial of degree {len(coupling.polynomial) - 1}.",
            remedy=f"MuJoCo takes degrees up to {_MOST_COUPLED - 1}.",
            coupling=coupling.name,
        )
    powers = np.zeros(_MOST_COUPLED)
    powers[: len(coupling.polynomial)] = coupling.polynomial
    ends, kind = [coupling.joint, *filter(None, [coupling.of])], "joint"
    if coupling.also:
        minus = [(name, -factor) for name, factor in coupling.also]
        terms = [[(coupling.joint, 1.0), *minus], *([(name, 1.0)] for name in ends[1:])]
        ends, kind = [f"{coupling.name}:{number}" for number in range(len(terms))], "tendon"
        for name, joints in zip(ends, terms, strict=True):
            tendon = _add(tendons, "fixed", name=name)
            for joint, factor in joints:
                _add(tendon, "joint", joint=joint, coef=factor)
    named = {f"{kind}{number + 1}": name for number, name in enumerate(ends)}
    _add(equality, kind, name=coupling.name, **named, polycoef=powers, **soft)


def _joint(model: pin.Model, data: pin.Data, index: int, armatures: Array) -> dict[str, object]:
    """Return MuJoCo's joint for one of Pinocchio's, as attributes; armatures (nv,)."""
    name, joint = str(model.names[index]), model.joints[index]
    armature = armatures[joint.idx_v : joint.idx_v + joint.nv]
    if np.ptp(armature) > 0.0:
        raise UnsupportedRobotError(
            f"Joint {name!r} has the armatures {armature.tolist()}; MuJoCo has one a joint.",
            remedy="Give it the same about all axes.",
            joint=name,
        )
    kind = str(joint.shortname()).removeprefix("JointModel")
    attributes: dict[str, object] = {"name": name, "armature": float(armature[0])}
    if kind == "Spherical":
        return {**attributes, "type": "ball"}
    if kind == "FreeFlyer" and model.parents[index] == 0 and model.jointPlacements[index].isIdentity():
        return {**attributes, "type": "free"}
    if joint.nv != 1:
        raise UnsupportedRobotError(
            f"Joint {name!r} has type {joint.shortname()}, which MuJoCo has not, or not there.",
            remedy="Build it from hinges, slides and balls.",
            joint=name,
        )
    subspace = motion_subspace(model, data, index)[:, 0]
    turning = bool(np.abs(subspace[3:]).any())
    described: dict[str, object] = {
        **attributes,
        "type": "hinge" if turning else "slide",
        "axis": subspace[3:] if turning else subspace[:3],
    }
    if joint.nq == 1:
        ends = [float(limit[joint.idx_q]) for limit in (model.lowerPositionLimit, model.upperPositionLimit)]
        if np.abs(ends).min() < _NO_LIMIT and ends[0] < ends[1]:  # of one end alone the other is far away
            described["range"] = np.clip(ends, -_FAR, _FAR)
    return described


def constraint_of(robot: Robot, closure: Closure) -> tuple[str, list[Array]]:
    """Return MuJoCo's constraint for a closure, and the points of the frames (3,), m, it joins; no point without one.

    Rows that no motion can violate (z of a planar mechanism, those that were left out as redundant) may be added: soft
    constraints stand them. The spin of a rod between two balls, which is fixed here and moves nothing, is free there.

    Raises:
        UnsupportedRobotError: no constraint of MuJoCo's has this mask.
    """
    if closure.is_rod:
        return "tendon", [np.zeros(3)]
    if closure.frame_a.endswith(UNIVERSAL):
        return "connect", [np.zeros(3)] if "x" in closure.axes else []
    constrained = set(closure.axes) | _idle(robot, closure)
    rotations = [axis for axis in AXES[3:] if axis in constrained]
    if {"x", "y", "z"} <= constrained:
        if not any(axis.startswith("r") for axis in closure.axes):
            return "connect", [np.zeros(3)]
        if len(rotations) == 3:
            return "weld", [np.zeros(3)]
        if len(rotations) == 2:  # a hinge: two points on its axis
            free = next(i for i in range(3) if AXES[3 + i] not in constrained)
            return "connect", [np.zeros(3), robot.characteristic_length * np.eye(3)[free]]
    raise UnsupportedRobotError(
        f"The closure {closure.name!r} holds {', '.join(closure.axes)}, which no constraint of MuJoCo does.",
        remedy="Use Exudyn, whose joints take any mask.",
        closure=closure.name,
    )


def _idle(robot: Robot, closure: Closure) -> set[str]:
    """Return the axes along which the frames cannot part, whatever the joints do, or the loops let them do."""
    whole = ConstraintSystem(replace(robot, closures=(replace(closure, axes=AXES),), couplings=()))
    rng = np.random.default_rng(0)
    steps = rng.uniform(-1.0, 1.0, (_TRIALS, robot.model.nv))
    state = whole.evaluate(np.array([pin.integrate(robot.model, np.array(robot.q_reference), d) for d in steps]))
    unit = whole.closure_unit
    moved = (np.abs(state.Jc).max(axis=(0, 2)) + np.abs(state.phi).max(axis=0)) / unit
    system, q = ConstraintSystem(robot), np.array(robot.q_reference)
    reached = assemble(system, draw_starts(system, q, _TRIALS, rng, spread=_AROUND))
    closed = np.concatenate([q[None], reached.q[reached.closed]])
    apart = np.abs(whole.evaluate(closed).phi).max(axis=0) / unit
    still = (moved < _STILL) | ((apart < _ROUNDED) & (len(closed) > 1))
    return {axis for axis, idle in zip(AXES, still, strict=True) if idle}


def _require_inertia(robot: Robot) -> None:
    """MuJoCo divides by the mass matrix of the open tree, so each joint needs inertia behind it, closures or not."""
    upper = pin.crba(robot.model, robot.model.createData(), np.array(robot.q_reference))
    mass = np.triu(upper) + np.triu(upper, 1).T
    size = np.sqrt(np.diag(mass))
    if (size > 0.0).all():
        values, vectors = np.linalg.eigh(mass / np.outer(size, size))
        if values[0] > LEAST_SHARE:
            return
        worst = int(np.abs(vectors[:, 0]).argmax())
    else:
        worst = int(size.argmin())
    joints = zip(robot.model.names, robot.model.joints, strict=True)
    name = next(str(name) for name, joint in list(joints)[1:] if joint.idx_v <= worst < joint.idx_v + joint.nv)
    raise UnsupportedRobotError(
        f"With the closures open, joint {name!r} moves (nearly) no mass, and MuJoCo divides by what it moves.",
        remedy="Give its link a mass (the 2-RPR: cylinder_mass and piston_mass), or use Exudyn.",
        joint=name,
    )


def _forces(robot: Robot, *, reflected: bool) -> tuple[dict[str, dict[str, float]], Array]:
    """Return the forces in each joint, as attributes of MuJoCo's, and the armature (nv,), rotors included."""
    forces: dict[str, dict[str, float]] = {}
    model, armature = robot.model, np.array(robot.model.armature)
    for load in robot.loads:
        if isinstance(load, Payload):  # the model has it
            continue
        if not isinstance(load, JointForces):
            raise UnsupportedRobotError(
                f"MJCF does not say {load!r}.", remedy="Write the robot without, and apply it as a force in MuJoCo."
            )
        index = find_joint_index(model, load.joint)
        if load.rotor_inertia and not reflected and _turns_with_its_rotor(model, index):
            raise UnsupportedRobotError(
                f"The rotor of joint {load.joint!r} is carried by a link that turns about its axis, and the "
                "armature of MJCF leaves out what the two do to each other (gear · inertia of the rotor, both ways).",
                remedy="Pass reflected=True to write gear² · inertia, which is right where the gear is high.",
                joint=load.joint,
            )
        armature[model.joints[index].idx_v] += load.gear**2 * load.rotor_inertia
        have = forces.setdefault(load.joint, {"damping": 0.0, "frictionloss": 0.0})
        have["damping"] += load.damping
        have["frictionloss"] += load.friction
        if load.stiffness:  # springs side by side are one
            before, rest = have.get("stiffness", 0.0), have.get("springref", 0.0)
            have["stiffness"] = before + load.stiffness
            have["springref"] = (before * rest + load.stiffness * load.rest) / have["stiffness"]
    return forces, armature


def _turns_with_its_rotor(model: pin.Model, index: int) -> bool:
    """Return whether what carries a joint can turn about the joint's axis."""
    data, rng = model.createData(), np.random.default_rng(0)
    for _ in range(_TRIALS):
        pin.computeJointJacobians(model, data, pin.integrate(model, pin.neutral(model), rng.uniform(-1, 1, model.nv)))
        own, carrying = (
            pin.getJointJacobian(model, data, int(k), pin.LOCAL_WORLD_ALIGNED) for k in (index, model.parents[index])
        )
        column = own[:, model.joints[index].idx_v]
        axis = column[3:] if column[3:].any() else column[:3]
        if np.abs(axis @ carrying[3:]).max() > _STILL:
            return True
    return False


def _least_inertia(robot: Robot) -> tuple[float, float]:
    """Return the least mass, kg, and moment of inertia, kg·m², to write."""
    mass = force_terms(robot).mass
    sizes = mass, mass * robot.characteristic_length**2
    if _SMALL * min(sizes) < _SMALLEST:
        raise UnsupportedRobotError(
            f"{robot.name} has {sizes[0]:.2g} kg and {sizes[1]:.2g} kg·m²; MuJoCo takes nothing below 1e-15.",
            remedy="Write it in other units, such as millimetres and grams.",
        )
    least, inertia = (max(_SMALLEST, LEAST_INERTIA * size) for size in sizes)
    return least, inertia


def _inertial(body: ElementTree.Element, inertia: pin.Inertia, least: tuple[float, float]) -> None:
    moments, axes = np.linalg.eigh(inertia.inertia)
    axes = axes * np.sign(np.linalg.det(axes))
    mass, moments = max(float(inertia.mass), least[0]), np.maximum(moments, least[1])
    moments[0] += 1e-12 * moments[2]  # flat bodies: two moments make the third, which rounding must not exceed
    _add(body, "inertial", pos=inertia.lever, quat=_quaternion(axes), mass=mass, diaginertia=moments)


def _site(bodies: list[ElementTree.Element], model: pin.Model, name: str, frame: str, offset: Array) -> None:
    entry = find_link(model, frame)
    place = entry.placement
    quat = _quaternion(place.rotation)
    _add(bodies[entry.parentJoint], "site", name=name, pos=place.act(offset), quat=quat)


def _position(model: pin.Model, q: Array) -> Array:
    """Return MuJoCo's qpos of a configuration (nq,)."""
    parts: list[Array] = []
    for joint in list(model.joints)[1:]:
        own = q[joint.idx_q : joint.idx_q + joint.nq]
        if joint.nq == 2:
            own = np.arctan2(own[1:], own[:1])
        elif joint.nq >= 4:  # w, x, y, z there
            own = np.concatenate([own[:-4], own[-1:], own[-4:-1]])
        parts.append(own)
    return np.concatenate(parts)


def _quaternion(rotation: Array) -> Array:
    """Return (w, x, y, z), MuJoCo's order."""
    x, y, z, w = pin.Quaternion(np.array(rotation)).coeffs()
    return np.array([w, x, y, z])


def _add(parent: ElementTree.Element, tag: str, **attributes: object) -> ElementTree.Element:
    return ElementTree.SubElement(parent, tag, {name: _text(value) for name, value in attributes.items()})


def _xml(root: ElementTree.Element) -> str:
    """Return the text of a model; InputError for names that no reader would take, which a model from code may have."""
    for element in root.iter():
        for key, value in element.attrib.items():
            if re.search(r"[\x00-\x1f\x7f-\x9f\ud800-\udfff\ufffe\uffff]", value):
                raise InputError(
                    f"{key} of a {element.tag} is {shown(value)}: control characters have no place in a file.",
                    remedy="Rename it in the model.",
                )
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def _text(value: object) -> str:
    if isinstance(value, Iterable) and not isinstance(value, str):
        return " ".join(repr(float(part)) for part in value)
    return repr(float(value)) if isinstance(value, float) else str(value)
