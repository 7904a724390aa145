"""Newton and Euler for each link alone: efforts of a mechanism from its file, without a tree and without Pinocchio's.

A URDF or a model of SDF is read here a second time, by ElementTree. Every link is a free body, every joint (of the tree
or of a loop) a set of unknown wrenches between two of them. For each link, in the world,

    m (c̈ − g) = Σ F,    I ω̇ + ω × I ω = Σ (M + (p − c) × F),

where c is its centre of mass and p the point of a wrench. Solved by least squares for the wrenches and the efforts.
Poses of links come from the package, and are right where they close every joint of the file (``errors``).
"""

import math
import re
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

FREE = {
    "fixed": "",
    "revolute": "rz",
    "continuous": "rz",
    "prismatic": "z",
    "cylinder": "z rz",
    "ball": "rx ry rz",
    "planar": "x y rz",
    "floating": "x y z rx ry rz",
    "universal": "universal",
}
"""What each kind leaves free, about and along the axes of its frame, whose z axis is the joint's."""


DRAKE = "{http://drake.mit.edu}"


class NotJudgedError(Exception):
    """What this reading does not cover."""


@dataclass
class Link:
    mass: float
    centre: np.ndarray
    inertia: np.ndarray


@dataclass
class Joint:
    kind: str
    links: tuple
    places: tuple
    second: np.ndarray | None = None
    """(3,) of a universal joint: its other axis, in the frame of the second link."""


@dataclass
class File:
    links: dict = field(default_factory=dict)
    joints: dict = field(default_factory=dict)
    couplings: list = field(default_factory=list)
    """Pairs ({joint: factor}, offset): Σ factor · q = offset."""
    poses: dict = field(default_factory=dict)
    """SDF: where links are at zero."""
    gravity: np.ndarray = field(default_factory=lambda: np.array([0.0, 0.0, -9.81]))
    """m/s²; files without a world do not say it."""


def numbers(text, default):
    return np.array([float(each) for each in text.split()]) if text and text.strip() else np.array(default, float)


def placement(xyz, rpy):
    place = np.eye(4)
    place[:3, :3], place[:3, 3] = pin.rpy.rpyToMatrix(*rpy), xyz
    return place


def along(axis):
    """Return the rotation (4, 4) that takes z to an axis (3,)."""
    if not np.any(axis):
        return np.eye(4)
    turn, axis = np.eye(4), axis / np.linalg.norm(axis)
    helper = np.eye(3)[int(np.argmin(np.abs(axis)))]
    x = np.cross(helper, axis)
    x /= np.linalg.norm(x)
    turn[:3, :3] = np.column_stack([x, np.cross(axis, x), axis])
    return turn


# --- URDF -------------------------------------------------------------------------------------------------------------


def origin(element):
    found = None if element is None else element.find("origin")
    if found is None:
        return np.eye(4)
    return placement(numbers(found.get("xyz"), [0, 0, 0]), numbers(found.get("rpy"), [0, 0, 0]))


def read_urdf(path):
    root, file = ElementTree.parse(path).getroot(), File()
    for link in root.findall("link"):
        inertial = link.find("inertial")
        if inertial is None:
            file.links[link.get("name")] = Link(0.0, np.zeros(3), np.zeros((3, 3)))
            continue
        place, own = origin(inertial), inertial.find("inertia")
        i = {key: float(own.get(f"i{key}", 0)) for key in ("xx", "xy", "xz", "yy", "yz", "zz")}
        matrix = np.array([[i["xx"], i["xy"], i["xz"]], [i["xy"], i["yy"], i["yz"]], [i["xz"], i["yz"], i["zz"]]])
        turn = place[:3, :3]
        mass = float(inertial.find("mass").get("value"))
        file.links[link.get("name")] = Link(mass, place[:3, 3], turn @ matrix @ turn.T)
    for joint in root.findall("joint"):
        if joint.find("parent") is not None:
            _urdf_joint(file, joint)
    if any("world" in joint.links for joint in file.joints.values()):  # Drake has it without a word
        file.links.setdefault("world", Link(0.0, np.zeros(3), np.zeros((3, 3))))
    closing = {}
    for name in file.links:
        head, _, number = name.rpartition("_")
        if re.match(r"closing_|.*_cl\d", head) and number in ("1", "2"):
            closing.setdefault(head, []).append(name)
    for head, ends in closing.items():
        file.joints[head] = Joint("ball", tuple(ends), (np.eye(4), np.eye(4)))
    for loop in root.findall("loop"):
        ends = [loop.find(end) for end in ("predecessor", "successor")]
        turn = along(numbers(loop.find("axis").get("xyz"), [1, 0, 0]))
        places = tuple(origin(end) @ turn for end in ends)
        file.joints[f"loop {loop.get('name')}"] = Joint(loop.get("type"), tuple(e.get("link") for e in ends), places)
    for ball in root.iter(f"{DRAKE}ball_constraint"):
        ends = [ball.find(f"{DRAKE}ball_constraint_body_{end}").get("name") for end in "AB"]
        at = [numbers(ball.find(f"{DRAKE}ball_constraint_p_{end}").get("value"), [0, 0, 0]) for end in ("AP", "BQ")]
        places = tuple(placement(point, np.zeros(3)) for point in at)
        file.joints[f"ball {len(file.joints)}"] = Joint("ball", tuple(ends), places)
    for weld in root.findall("gazebo/joint"):  # as its links are when all joints are at zero
        if weld.get("type") != "fixed":
            raise NotJudgedError(f"a joint of Gazebo of type {weld.get('type')}")
        ends = weld.findtext("parent"), weld.findtext("child")
        one, other = (_at_zero(file, end) for end in ends)
        file.joints[f"weld {weld.get('name')}"] = Joint("fixed", ends, (np.linalg.inv(one) @ other, np.eye(4)))
    parents = {joint.links[1]: (name, joint.links[0]) for name, joint in reversed(file.joints.items())}
    for coupling in root.findall("coupling"):
        factors = {}
        for end, factor in (("successor", 1.0), ("predecessor", -float(coupling.find("ratio").get("value")))):
            link = coupling.find(end).get("link")
            while link in parents:
                name, link = parents[link]
                if file.joints[name].kind not in ("fixed", "floating"):
                    factors[name] = factors.get(name, 0.0) + factor
        shared = _shared(parents, *(coupling.find(end).get("link") for end in ("successor", "predecessor")))
        file.couplings.append(({name: factor for name, factor in factors.items() if name not in shared}, 0.0))
    for joint in root.findall("joint"):
        if (mimic := joint.find("mimic")) is not None:
            factors = {joint.get("name"): 1.0, mimic.get("joint"): -float(mimic.get("multiplier", 1))}
            file.couplings.append((factors, float(mimic.get("offset", 0))))
    return file


def _at_zero(file, link):
    """Return where a link is in the root, all joints at zero."""
    place = np.eye(4)
    while carrier := next((joint for joint in file.joints.values() if joint.links[1] == link), None):
        place = carrier.places[0] @ np.linalg.inv(carrier.places[1]) @ place
        link = carrier.links[0]
    return place


def _shared(parents, one, other):
    """Return the joints that are above both links."""
    above = []
    for link in (one, other):
        names = set()
        while link in parents:
            name, link = parents[link]
            names.add(name)
        above.append(names)
    return above[0] & above[1]


def _urdf_joint(file, joint):
    kind = joint.get("type")
    if kind not in FREE:
        raise NotJudgedError(f"a joint of type {kind}")
    axis = joint.find("axis")
    turn = along(numbers(None if axis is None else axis.get("xyz"), [1, 0, 0]))
    links = joint.find("parent").get("link"), joint.find("child").get("link")
    file.joints[joint.get("name")] = Joint(kind, links, (origin(joint) @ turn, turn))


def read_parallel(path):
    """Read the robot.yaml of example-parallel-robots and the URDF beside it."""
    import yaml

    declared = yaml.safe_load(path.read_text())
    file = read_urdf(next(path.parent.glob("*.urdf")))
    for number, (ends, kind) in enumerate(zip(declared["closed_loop"], declared["type"], strict=True)):
        children = tuple(file.joints[end].links[1] if end in file.joints else end for end in ends)
        file.joints[f"loop {number}"] = Joint({"3d": "ball", "6d": "fixed"}[kind], children, (np.eye(4), np.eye(4)))
    for name, kind in zip(declared.get("joint_name", []), declared.get("joint_type", []), strict=True):
        joint = file.joints.get(name)
        if joint is None:  # that file names joints which its URDF lacks
            continue
        if kind.startswith("UJOINT"):
            one, other = (np.eye(3)["XYZ".index(letter)] for letter in kind[-2:])
            child = [place @ np.linalg.inv(joint.places[1]) for place in joint.places]
            file.joints[name] = Joint("universal", joint.links, (child[0] @ along(one), np.eye(4)), other)
        else:
            file.joints[name] = Joint({"SPHERICAL": "ball", "FIXED": "fixed"}[kind], joint.links, joint.places)
    return file


# --- SDF --------------------------------------------------------------------------------------------------------------


def read_sdf(path):
    """Read a file of one model, without models in it."""
    root = ElementTree.parse(path).getroot()
    models = [each for each in root.iter("model") if each.find("joint") is not None]
    if len(models) != 1 or models[0].find("model") is not None or models[0].find("include") is not None:
        raise NotJudgedError("several models")
    (model,) = models
    if root.find("world") is not None and model not in list(root.find("world")):
        raise NotJudgedError("several models")
    raw = {each.get("name"): each for tag in ("joint", "frame", "link") for each in model.findall(tag)}
    old = float(root.get("version").replace("1.10", "1.91").replace("1.11", "1.92").replace("1.12", "1.93")) < 1.65

    def own(element):
        pose = None if element is None else element.find("pose")
        if pose is not None and pose.get("rotation_format", "euler_rpy") != "euler_rpy":
            raise NotJudgedError("quaternions")
        values = numbers(None if pose is None else pose.text, [0] * 6)
        degrees = pose is not None and pose.get("degrees") == "true"
        return placement(values[:3], np.deg2rad(values[3:]) if degrees else values[3:]), pose

    def at(name):
        """Where something is in the model's frame, at zero."""
        if name == "__model__":
            return np.eye(4)
        if name == "world":
            return np.linalg.inv(base)
        if name not in raw:
            raise NotJudgedError(f"the frame {name}")
        return of(raw[name])

    def of(element):
        place, pose = own(element)
        to = None if pose is None else pose.get("relative_to") or pose.get("frame")
        if not to:
            to = {"link": "__model__", "joint": element.findtext("child"), "frame": element.get("attached_to")}[
                element.tag
            ]
        return at(to or "__model__") @ place

    base, _ = own(model)
    file = File(links={"world": Link(0.0, np.zeros(3), np.zeros((3, 3)))}, poses={"world": np.eye(4)})
    if (world := root.find("world")) is not None:
        file.gravity = numbers(world.findtext("gravity"), [0, 0, -9.8])
    for link in model.findall("link"):
        name, inertial = link.get("name"), link.find("inertial")
        i = {key: float(d) for key, d in (("xx", 1), ("yy", 1), ("zz", 1), ("xy", 0), ("xz", 0), ("yz", 0))}
        place, mass = np.eye(4), 1.0
        if inertial is not None:
            place, mass = own(inertial)[0], float(inertial.findtext("mass", "1"))
            stated = inertial.find("inertia")
            i = {key: float(i[key] if stated is None else stated.findtext(f"i{key}", i[key])) for key in i}
        matrix = np.array([[i["xx"], i["xy"], i["xz"]], [i["xy"], i["yy"], i["yz"]], [i["xz"], i["yz"], i["zz"]]])
        file.links[name] = Link(mass, place[:3, 3], place[:3, :3] @ matrix @ place[:3, :3].T)
        file.poses[name] = base @ at(name)
    gears = []
    for joint in model.findall("joint"):
        name, kind, axis = joint.get("name"), joint.get("type"), joint.find("axis")
        if kind == "gearbox":
            gears.append(joint)
            continue
        if kind not in (*FREE, "revolute2"):
            raise NotJudgedError(f"a joint of type {kind}")
        ends = [joint.findtext(end).strip() for end in ("parent", "child")]
        for number, end in enumerate(ends):  # frames at the ends stand for the links that they are attached to
            while end in raw and raw[end].tag != "link":
                end = raw[end].get("attached_to") or raw[end].findtext("child")
            ends[number] = end
        place = base @ of(joint)
        direction = []
        for each in (axis, joint.find("axis2")):
            if each is None:
                continue
            xyz, own_frame = each.find("xyz"), place
            to = None if xyz is None else xyz.get("expressed_in")
            if to:
                own_frame = base @ at(to)
            if old and each.findtext("use_parent_model_frame", "0").strip() in ("1", "true"):
                own_frame = base
            direction.append(own_frame[:3, :3] @ numbers(None if xyz is None else xyz.text, [0, 0, 1]))
            if (mimic := each.find("mimic")) is not None:
                factor, reference = (float(mimic.findtext(key, "0")) for key in ("multiplier", "reference"))
                offset = float(mimic.findtext("offset", "0")) - factor * reference
                file.couplings.append(({name: 1.0, mimic.get("joint"): -factor}, offset))
        here = place.copy()
        here[:3, :3] = along(direction[0])[:3, :3] if direction else here[:3, :3]
        places = tuple(np.linalg.inv(file.poses[end]) @ here for end in ends)
        second = None
        if kind in ("universal", "revolute2"):
            kind, second = "universal", (np.linalg.inv(file.poses[ends[1]])[:3, :3] @ direction[1])
        file.joints[name] = Joint(kind, tuple(ends), places, second)
    for gear in gears:  # θ₂ = −ratio θ₁, from the reference body to the parent about axis, to the child about axis2
        body, angles = gear.findtext("gearbox_reference_body"), {}
        for end, axis, factor in (
            ("parent", "axis", float(gear.findtext("gearbox_ratio", "1"))),
            ("child", "axis2", 1.0),
        ):
            direction = (base @ of(gear))[:3, :3] @ numbers(gear.find(axis).findtext("xyz"), [0, 0, 1])
            link = gear.findtext(end)
            name = next(key for key, each in file.joints.items() if {*each.links} == {body, link})
            joint = file.joints[name]
            along_joint = (file.poses[joint.links[0]] @ joint.places[0])[:3, 2] * (1 if joint.links[1] == link else -1)
            angles[name] = factor * np.sign(along_joint @ direction)
        file.couplings.append((angles, 0.0))
    return file


# --- mechanics --------------------------------------------------------------------------------------------------------


def judge(file, robot, kinematics):
    """Return the generalised forces (n,) of one state, efforts (m,) or None, and the largest error of a joint.

    Args:
        file: what was read here.
        robot: of the package, for names, and the axes of joints that it made of others.
        kinematics: q, v, a of the state.
    """
    q, v, a = kinematics
    model = robot.model
    data = model.createData()
    pin.forwardKinematics(model, data, q, v, a)
    pin.updateFramePlacements(model, data)
    state = {}
    for name in file.links:
        if name == "world" and not model.existFrame(name, pin.BODY):
            state[name] = np.eye(4), np.zeros(6), np.zeros(6), 0
            continue
        frame, axes = model.getFrameId(name, pin.BODY), pin.LOCAL_WORLD_ALIGNED
        state[name] = (
            data.oMf[frame].homogeneous,
            pin.getFrameVelocity(model, data, frame, axes).vector,
            pin.getFrameClassicalAcceleration(model, data, frame, axes).vector,
            model.frames[frame].parentJoint,
        )
    row = {name: 6 * index for index, name in enumerate(file.links)}
    need, centres = np.zeros(6 * len(row)), {}
    for name, link in file.links.items():
        pose, speed, rate, _ = state[name]
        arm, turn = pose[:3, :3] @ link.centre, pose[:3, :3]
        inertia, w, dw = turn @ link.inertia @ turn.T, speed[3:], rate[3:]
        acceleration = rate[:3] + np.cross(dw, arm) + np.cross(w, np.cross(w, arm))
        need[row[name] : row[name] + 3] = link.mass * (acceleration - file.gravity)
        need[row[name] + 3 : row[name] + 6] = inertia @ dw + np.cross(w, inertia @ w)
        centres[name] = pose[:3, 3] + arm

    def column(links, point, force, moment):
        """A wrench on the second link, and its reaction on the first."""
        made = np.zeros(len(need))
        for name, sign in zip(links, (-1.0, 1.0), strict=True):
            made[row[name] : row[name] + 3] += sign * force
            made[row[name] + 3 : row[name] + 6] += sign * (moment + np.cross(point - centres[name], force))
        return made

    zero, held, errors, drives, angles = np.zeros(3), [], [0.0], {}, {}
    for name, (pose, _, _, carrier) in state.items():
        if carrier == 0:  # on the ground
            for unit in np.eye(6):
                made = np.zeros(len(need))
                made[row[name] : row[name] + 6] = unit
                held.append(made)
            if file.poses:
                errors.append(np.abs(pose - file.poses[name]).max())
    for name, joint in file.joints.items():
        one, other = (state[link][0] @ place for link, place in zip(joint.links, joint.places, strict=True))
        relative, turn, point = np.linalg.inv(one) @ other, one[:3, :3], other[:3, 3]
        free, angle = FREE[joint.kind].split(), pin.log3(relative[:3, :3])
        if joint.kind == "universal":
            first, second = turn[:, 2], state[joint.links[1]][0][:3, :3] @ joint.second
            normal = np.cross(first, second)
            held += [column(joint.links, point, unit, zero) for unit in np.eye(3)]
            held.append(column(joint.links, point, zero, normal / np.linalg.norm(normal)))
            errors += [np.abs(relative[:3, 3]).max(), abs(first @ second)]
            drives[f"{name}_1"] = column(joint.links, point, zero, first)
            drives[f"{name}_2"] = column(joint.links, point, zero, second)
            continue
        twist = dict(zip(("x", "y", "z"), relative[:3, 3], strict=True))
        spins = {"rx": angle[0], "ry": angle[1], "rz": angle[2]}
        if "rz" in free and "rx" not in free:  # the axes are parallel: no small angles
            spins = {"rx": relative[0, 2], "ry": relative[1, 2], "rz": math.atan2(relative[1, 0], relative[0, 0])}
            errors.append(max(0.0, -relative[2, 2]))
        for number, axis in enumerate(("x", "y", "z")):
            unit = turn[:, number]
            if axis not in free:
                held.append(column(joint.links, point, unit, zero))
                errors.append(abs(twist[axis]))
            if f"r{axis}" not in free:
                held.append(column(joint.links, point, zero, unit))
                errors.append(abs(spins[f"r{axis}"]))
        if free == ["rz"]:
            drives[name], angles[name] = column(joint.links, point, zero, turn[:, 2]), spins["rz"]
        elif free == ["z"]:
            drives[name], angles[name] = column(joint.links, point, turn[:, 2], zero), twist["z"]
        else:  # hinges and slides in a row, which the package makes of it
            made = {each: model.getJointId(f"{name}_{each}") for each in free if model.existJointName(f"{name}_{each}")}
            axes = {each: data.oMi[at].rotation[:, "xyz".index(each[-1])] for each, at in made.items()}
            for each in ("x", "y", "z"):
                if each in axes:
                    drives[f"{name}_{each}"] = column(joint.links, point, axes[each], zero)
            turning = [each for each in axes if each.startswith("r")]
            # all hinges carry one moment, whose component along each axis is that hinge's effort
            moments = np.linalg.pinv(np.array([axes[each] for each in turning])) if turning else np.zeros((3, 0))
            for each, moment in zip(turning, moments.T, strict=True):
                drives[f"{name}_{each}"] = column(joint.links, point, zero, moment)
    for name, measured in angles.items():
        if model.existJointName(name):
            own = model.joints[model.getJointId(name)]
            position = math.atan2(q[own.idx_q + 1], q[own.idx_q]) if own.nq == 2 else q[own.idx_q]
            off = position - measured
            errors.append(abs(math.remainder(off, math.tau)) if FREE[file.joints[name].kind] == "rz" else abs(off))
            if own.nq == 1:
                angles[name] = position  # with its turns
    for factors, offset in file.couplings:
        errors.append(abs(sum(factor * angles[name] for name, factor in factors.items()) - offset))
        held.append(sum(factor * drives[name] for name, factor in factors.items()))

    def efforts(names):
        if missing := [name for name in names if name not in drives]:
            raise NotJudgedError(f"the joint {missing[0]}")
        matrix = np.column_stack([*(drives[name] for name in names), *held])
        solution, *_ = np.linalg.lstsq(matrix, need, rcond=1e-10)
        left = np.abs(matrix @ solution - need).max() / max(1e-9, np.abs(need).max())
        return solution[: len(names)], left

    forces, left = efforts(robot.independent_joints)
    errors.append(left)
    tau = None
    if robot.m == robot.n:
        tau, left = efforts(robot.actuated)
    return forces, tau, max(errors)
