"""Cassie's SDF read by hand, to judge the package's reading: places at the file's pose, and a model of MuJoCo."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from redundancy_pin.loading import propose_robot


@dataclass(frozen=True)
class Hinge:
    """A joint at the file's pose, in the frame of the model: point (3,), m; axis (3,), of a ball whatever it says."""

    kind: str
    parent: str
    child: str
    point: np.ndarray
    axis: np.ndarray
    damping: float


def _pose(element: ElementTree.Element) -> np.ndarray:
    values = [float(part) for part in element.findtext("pose", "0 0 0 0 0 0").split()]
    place = np.eye(4)
    place[:3, 3], place[:3, :3] = values[:3], Rotation.from_euler("xyz", values[3:]).as_matrix()
    return place


def read(path: Path) -> tuple[dict[str, np.ndarray], dict[str, Hinge], ElementTree.Element]:
    """Return placements (4, 4) of links in the model, joints by name, and the model."""
    model = ElementTree.parse(path).getroot().find("model")
    assert model is not None
    links = {str(link.get("name")): _pose(link) for link in model.iter("link")}
    joints = {}
    for joint in model.iter("joint"):
        parent, child = (joint.findtext(role, "") for role in ("parent", "child"))
        place = links[child] @ _pose(joint)
        axis = np.array([float(part) for part in joint.findtext("axis/xyz", "0 0 1").split()])
        if joint.findtext("axis/use_parent_model_frame") != "1":
            axis = place[:3, :3] @ axis
        damping = float(joint.findtext("axis/dynamics/damping", "0"))
        kind = str(joint.get("type"))
        joints[str(joint.get("name"))] = Hinge(kind, parent, child, place[:3, 3], axis / np.linalg.norm(axis), damping)
    return links, joints, model


def drives(path: Path) -> str:
    """Return as many joints as there are degrees of freedom, with commas between, as the file does not name its motors.

    Those with a range come first, as motors have, springs after all others.
    """
    proposal, _ = propose_robot(path)
    moving = set(proposal.mechanism.model.names)
    ranged = [
        str(joint.get("name"))
        for joint in read(path)[2].iter("joint")
        if joint.find("axis/limit/upper") is not None and joint.find("axis/dynamics/spring_stiffness") is None
    ]
    _, robot = propose_robot(path, actuate=[name for name in ranged if name in moving])
    assert robot is not None
    return ",".join(robot.independent_joints)


def turned(hinge: Hinge, angle: float) -> np.ndarray:
    """Return the displacement (4, 4) of what lies beyond a hinge."""
    place = np.eye(4)
    place[:3, :3] = Rotation.from_rotvec(hinge.axis * angle).as_matrix()
    place[:3, 3] = hinge.point - place[:3, :3] @ hinge.point
    return place


def in_mujoco(path: Path, tips: dict[str, tuple[str, Any, Any]], fixed: tuple[str, ...]) -> Any:
    """Return the machine as a model of MuJoCo, pelvis free: bodies and joints by their names in the file.

    Args:
        path: of the SDF; what joins a link that has a parent already is a ``connect``.
        tips: points of links that stay where they are, by name: link, point in its axes and place in the world, (3,) m.
        held: joints that do not move.
    """
    import mujoco

    links, joints, model = read(path)
    equalities, sites, taken = [], dict.fromkeys(links, ""), set()

    def text(values: Any) -> str:
        return " ".join(repr(float(value)) for value in values)

    for name, (link, point, place) in tips.items():
        sites[link] += f'<site name="{name}" pos="{text(point)}"/>'
        sites.setdefault("", "")
        sites[""] += f'<site name="ground {name}" pos="{text(place)}"/>'
        equalities.append(f'<connect name="{name}" site1="{name}" site2="ground {name}"/>')
    equalities += [f'<joint joint1="{name}"/>' for name in fixed]
    tree: dict[str, list[str]] = {name: [] for name in links}
    for name, joint in joints.items():
        if joint.child in taken:  # a loop: the second parent
            point = np.linalg.inv(links[joint.parent])[:3] @ np.append(joint.point, 1.0)
            equalities.append(f'<connect body1="{joint.parent}" body2="{joint.child}" anchor="{text(point)}"/>')
        else:
            taken.add(joint.child)
            tree[joint.parent].append(name)

    def body(name: str, before: np.ndarray, joint: str) -> str:
        place, element = np.linalg.inv(before) @ links[name], model.find(f"link[@name='{name}']")
        assert element is not None
        quaternion = Rotation.from_matrix(place[:3, :3]).as_quat(scalar_first=True)
        inertial, own = element.find("inertial"), links[name][:3, :3].T
        assert inertial is not None
        assert not _pose(inertial)[:3, :3].any() or np.array_equal(_pose(inertial)[:3, :3], np.eye(3))
        moments = [inertial.findtext(f"inertia/{key}", "0") for key in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")]
        lines = f'<body name="{name}" pos="{text(place[:3, 3])}" quat="{text(quaternion)}">{sites[name]}'
        lines += f'<inertial pos="{text(_pose(inertial)[:3, 3])}" mass="{inertial.findtext("mass")}" '
        lines += f'fullinertia="{" ".join(moments)}"/>'
        if joint:
            given, at = joints[joint], np.linalg.inv(links[name])[:3] @ np.append(joints[joint].point, 1.0)
            kind = "ball" if given.kind == "ball" else "hinge"
            lines += f'<joint name="{joint}" type="{kind}" pos="{text(at)}" axis="{text(own @ given.axis)}" '
            lines += f'damping="{given.damping if kind == "hinge" else 0.0}"/>'
        else:
            lines += "<freejoint/>"
        return lines + "".join(body(joints[each].child, links[name], each) for each in tree[name]) + "</body>"

    # nearly rigid, and in no hurry to close what rounding leaves open
    return mujoco.MjModel.from_xml_string(
        f"""<mujoco><compiler angle="radian"/><option gravity="0 0 -9.81" tolerance="0" iterations="200"
        jacobian="dense"/>
        <default><equality solref="1 1" solimp="0.9999 0.9999 0.001"/></default>
        <worldbody>{sites.get("", "")}{body("pelvis", np.eye(4), "")}</worldbody>
        <equality>{"".join(equalities)}</equality></mujoco>"""
    )
