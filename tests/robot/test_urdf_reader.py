"""URDFs: each mistake that urdfdom would pass over is one error with file, line and link; models are what files say."""

from __future__ import annotations

import resource
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import yaml
import yourdfpy
from hypothesis import given, settings
from hypothesis import strategies as st

from redundancy_pin import VirtualWork, load_robot
from redundancy_pin.errors import ModelFileError
from redundancy_pin.robot.declaration import CLOSED_FORMS
from redundancy_pin.robot.formats.mechanism import MOST_FREEDOMS, MOST_LINKS
from redundancy_pin.robot.formats.urdf import DEEPEST_CHAIN, read_urdf, urdf_mechanism
from redundancy_pin.robot.urdf import shipped_robots

INERTIAL = """<inertial><origin xyz="0.25 0 0"/><mass value="1.0"/>
    <inertia ixx="0" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial>"""
LIMIT = '<limit lower="-9" upper="9" velocity="9" effort="9"/>'


def body(name: str, parent: str, joint: str, kind: str = "revolute", x: float = 0.0, axis: str = "0 0 1") -> str:
    return f"""
  <link name="{name}">{INERTIAL}</link>
  <joint name="{joint}" type="{kind}"><parent link="{parent}"/><child link="{name}"/>
    <origin xyz="{x} 0 0"/><axis xyz="{axis}"/>{LIMIT}</joint>"""


FIVE_BAR = (
    '<?xml version="1.0"?>\n<robot name="bar">\n  <link name="base"/>'
    + body("l1", "base", "a1")
    + body("l2", "l1", "b1", x=0.5)
    + body("tip1", "l2", "m1", "fixed", 0.5)
    + body("r1", "base", "a2", x=0.5)
    + body("r2", "r1", "b2", x=0.5)
    + body("tip2", "r2", "m2", "fixed", 0.5)
    + body("bob", "l2", "slider", "prismatic", axis="1 0 0")
    + "\n</robot>\n"
)
DECLARATION: dict[str, Any] = {
    "urdf": "bar.urdf",
    "closures": [{"frames": ["tip1", "tip2"], "axes": ["x", "y"]}],
    "actuated": ["a1", "a2"],
    "carriers": [{"joint": "slider", "position": [-0.2, 0.4]}],
    "independent": {"platform": "tip1", "axes": ["x", "y"]},
    "reference": {"platform": [0.25, 0.7], "guess": {"a1": 2.0, "b1": -1.0, "a2": 1.0, "b2": 1.0}},
}


def write(folder: Path, tree: str, **changes: object) -> Path:
    (folder / "bar.urdf").write_text(tree, encoding="utf-8")
    (folder / "robot.yaml").write_text(yaml.safe_dump({**DECLARATION, **changes}, allow_unicode=True))
    return folder / "robot.yaml"


def once(old: str, new: str) -> Callable[[str], str]:
    """Return a change of a text at the first place of ``old``, which has to be there."""

    def change(text: str) -> str:
        assert old in text
        return text.replace(old, new, 1)

    return change


def appended(text: str) -> Callable[[str], str]:
    return once("</robot>", f"{text}</robot>")


ORIGIN, MASS, AXIS = '<origin xyz="0.25 0 0"/>', '<mass value="1.0"/>', '<axis xyz="1 0 0"/>'


def test_what_the_specification_leaves_out_has_its_default(tmp_path: Path) -> None:
    text = FIVE_BAR.replace(ORIGIN, "", 1).replace(AXIS, "", 1)
    robot = load_robot(write(tmp_path, text))
    assert robot.model.inertias[1].mass == 1.0
    np.testing.assert_array_equal(robot.model.inertias[1].lever, 0.0)
    turned = FIVE_BAR.replace(AXIS, '<axis xyz="0 3 4"/>')
    slider = load_robot(write(tmp_path, turned)).model
    joint = slider.joints[slider.getJointId("slider")]
    data = joint.createData()
    joint.calc(data, pin.neutral(slider), np.zeros(slider.nv))
    np.testing.assert_allclose(np.ravel(data.S), [0, 0.6, 0.8, 0, 0, 0], atol=1e-15)


def test_names_may_be_of_any_language(tmp_path: Path) -> None:
    text = FIVE_BAR.replace('"a1"', '"関節 ü [1]"')
    guess = {"関節 ü [1]": 2.0, "b1": -1.0, "a2": 1.0, "b2": 1.0}
    changes = {"actuated": ["関節 ü [1]", "a2"], "reference": {"platform": [0.25, 0.7], "guess": guess}}
    assert load_robot(write(tmp_path, text, **changes)).actuated == ("関節 ü [1]", "a2")


# ---- sizes --------------------


def _chain(count: int, kind: str = "fixed") -> Callable[[str], str]:
    links = [f'<link name="c{i}"/>' for i in range(count)]
    joints = [
        f'<joint name="k{i}" type="{kind}"><parent link="{f"c{i - 1}" if i else "base"}"/><child link="c{i}"/>'
        f"{LIMIT}</joint>"
        for i in range(count)
    ]
    return appended("".join(links + joints))


def _star(count: int, kind: str) -> Callable[[str], str]:
    return appended(
        "".join(
            f'<link name="c{i}"/><joint name="k{i}" type="{kind}"><parent link="base"/><child link="c{i}"/>{LIMIT}'
            "</joint>"
            for i in range(count)
        )
    )


SIZES: dict[str, tuple[Callable[[str], str], str]] = {
    "a comment of 50 MB": (appended(f"<!--{'x' * 50_000_000}-->"), "is too large"),
    "a chain of 30,000 links": (_chain(30_000), "too large"),
    "a chain of 12,000 links": (_chain(12_000), "elements"),
    "a chain of 2,500 links": (_chain(2500), f"more than the {MOST_LINKS}"),
    "a chain of 1,900 links": (_chain(1900), f"More than {DEEPEST_CHAIN} links follow"),
    "a chain one link too long": (_chain(DEEPEST_CHAIN + 1), f"More than {DEEPEST_CHAIN} links follow"),
    "joints of too many freedoms": (_star(MOST_FREEDOMS, "revolute"), f"more than the {MOST_FREEDOMS} of a model"),
    "elements in elements": (appended("<a>" * 30_000 + "</a>" * 30_000), "levels of elements"),
    "elements": (appended("<a/>" * 400_000), "elements"),
    "attributes": (appended("<a " + " ".join(f'a{i}=""' for i in range(130_000)) + "/>"), "attributes of one element"),
    "billion laughs": (
        once("<robot", '<!DOCTYPE r [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;">]>\n<robot'),
        "document type",
    ),
    "an entity from a file": (
        once("<robot", '<!DOCTYPE r [<!ENTITY a SYSTEM "file:///etc/passwd">]>\n<robot'),
        "document type",
    ),
    "attributes by default": (
        once("<robot", '<!DOCTYPE robot [<!ATTLIST link name CDATA "x">]>\n<robot'),
        "document type",
    ),
}


@pytest.mark.parametrize("name", SIZES)
def test_files_of_any_size_are_refused_at_once(tmp_path: Path, name: str) -> None:
    change, message = SIZES[name]
    path = write(tmp_path, change(FIVE_BAR))
    start, before = time.process_time(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(ModelFileError, match=message):
        load_robot(path)
    assert time.process_time() - start < 2.0
    unit = 1 if sys.platform == "darwin" else 1024
    assert (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * unit < 500e6


# ---- the model is what the file says --------------------


@pytest.mark.parametrize("name", shipped_robots())
def test_shipped_models_are_those_of_another_reader(name: str, tmp_path: Path) -> None:
    """Places of all links at random positions, masses and centres: yourdfpy reads the same text by itself."""
    robot = load_robot(name)
    model, data = robot.model, robot.model.createData()
    (tmp_path / "r.urdf").write_text(robot.urdf)
    other = yourdfpy.URDF.load(str(tmp_path / "r.urdf"), load_meshes=False)
    q = pin.randomConfiguration(model, -np.ones(model.nq), np.ones(model.nq))
    indices = {joint: model.joints[model.getJointId(joint)] for joint in other.actuated_joint_names}
    angles = {
        joint: np.arctan2(q[at.idx_q + 1], q[at.idx_q]) if at.nq == 2 else q[at.idx_q] for joint, at in indices.items()
    }
    other.update_cfg(angles)
    pin.framesForwardKinematics(model, data, q)
    carried = np.zeros(4)
    for link in other.robot.links:
        frame = model.getFrameId(link.name, pin.FrameType.BODY)
        place = data.oMf[frame].homogeneous
        np.testing.assert_allclose(other.get_transform(link.name), place, atol=1e-12)
        if link.inertial is not None and model.frames[frame].parentJoint:
            origin = np.eye(4) if link.inertial.origin is None else link.inertial.origin
            carried += link.inertial.mass * (place @ origin)[:, 3]
    mass = sum(inertia.mass for inertia in list(model.inertias)[1:])
    assert mass == pytest.approx(carried[3], rel=1e-12)
    np.testing.assert_allclose(pin.centerOfMass(model, data, q) * mass, carried[:3], atol=1e-12)
    for name, joint in other.joint_map.items():
        if name in indices and joint.type != "continuous":
            assert model.upperPositionLimit[indices[name].idx_q] == joint.limit.upper


def _numbers(row: list[float]) -> str:
    return " ".join(repr(value) for value in row)


TRIPLE = st.lists(st.floats(-3, 3, allow_subnormal=False), min_size=3, max_size=3)
JOINT = st.tuples(
    st.integers(0, 10**6),
    st.sampled_from(["fixed", "revolute", "continuous", "prismatic", "floating"]),
    TRIPLE,
    TRIPLE,
    TRIPLE.filter(lambda axis: np.linalg.norm(axis) > 1e-3),
    st.floats(0, 50),
    TRIPLE,
)


@settings(deadline=None)
@given(st.lists(JOINT, min_size=1, max_size=8))
def test_random_trees_are_those_of_pinocchio(joints: list[Any]) -> None:
    """By an open chain: its joints, its gravity terms at random positions, with the places of all links."""
    links = ['<link name="l0"/>']
    for index, (parent, kind, xyz, rpy, axis, mass, centre) in enumerate(joints):
        links.append(
            f'<link name="l{index + 1}"><inertial><origin xyz="{_numbers(centre)}" rpy="{_numbers(rpy)}"/>'
            f'<mass value="{mass!r}"/><inertia ixx="1" iyy="1.5" izz="2" ixy="0.1" ixz="0.2" iyz="0"/></inertial>'
            f'</link><joint name="j{index}" type="{kind}"><parent link="l{parent % (index + 1)}"/>'
            f'<child link="l{index + 1}"/>'
            f'<origin xyz="{_numbers(xyz)}" rpy="{_numbers(rpy)}"/><axis xyz="{_numbers(axis)}"/>'
            f'<limit lower="-{mass!r}" upper="2" effort="{mass!r}" velocity="3"/></joint>'
        )
    # one joint more, so that there is something to drive
    links.append('<link name="tip"/><joint name="tip" type="continuous"><parent link="l0"/><child link="tip"/></joint>')
    text = f'<robot name="r">{"".join(links)}</robot>'
    theirs = pin.buildModelFromXML(text)
    ours = urdf_mechanism(read_urdf(text, Path("r.urdf")), "r").model
    assert [str(name) for name in ours.names] == [str(name) for name in theirs.names]
    q = pin.integrate(theirs, pin.neutral(theirs), np.linspace(-1.0, 1.0, theirs.nv))
    for compute in (pin.crba, pin.computeGeneralizedGravity):
        np.testing.assert_array_equal(compute(ours, ours.createData(), q), compute(theirs, theirs.createData(), q))
    data = ours.createData(), theirs.createData()
    for model, own in zip((ours, theirs), data, strict=True):
        pin.framesForwardKinematics(model, own, q)
    for name in range(len(joints) + 1):
        one, other = (
            own.oMf[model.getFrameId(f"l{name}", pin.FrameType.BODY)]
            for model, own in zip((ours, theirs), data, strict=True)
        )
        np.testing.assert_array_equal(one.homogeneous, other.homogeneous)


# ---- closed forms --------------------


@pytest.mark.parametrize("form", ["2rpr", "3rrr"])
def test_the_arguments_of_a_closed_form_are_those_it_reads(form: str) -> None:
    read: set[str] = set()

    class Watched(dict[str, Any]):
        def __getitem__(self, name: str) -> Any:
            read.add(name)
            return super().__getitem__(name)

    robot = load_robot(form)
    object.__setattr__(robot, "parameters", Watched(robot.parameters))
    VirtualWork(robot)
    assert read == set(CLOSED_FORMS[form])


ARM = """<robot name="arm"><link name="base"/><link name="body">{inertial}</link>
  <joint name="turn" type="{kind}"><parent link="base"/><child link="body"/>{origin}<axis xyz="0 0 1"/>{limit}</joint>
  <transmission name="drive"><type>SimpleTransmission</type><joint name="turn"/></transmission></robot>"""
"""A body that a motor turns."""


@pytest.mark.parametrize(
    ("kind", "given", "expected"),
    [
        ("revolute", 'lower="-1" upper="2"', (-1.0, 2.0)),
        ("revolute", 'lower="0" upper="0"', (-np.inf, np.inf)),  # what urdfdom makes of no limits
        ("prismatic", "", (-np.inf, np.inf)),
        ("continuous", 'lower="-1" upper="2"', None),
    ],
)
def test_ranges_of_joints_are_those_of_the_file(kind: str, given: str, expected: Any, tmp_path: Path) -> None:
    limit = f'<limit {given} effort="3" velocity="4"/>'
    (tmp_path / "arm.urdf").write_text(ARM.format(origin="", limit=limit, kind=kind, inertial=INERTIAL))
    robot = load_robot(tmp_path / "arm.urdf")
    assert robot.effort_limits[1] == 3.0
    assert robot.model.upperVelocityLimit[0] == 4.0
    if expected:
        assert (robot.model.lowerPositionLimit[0], robot.model.upperPositionLimit[0]) == expected
    else:
        assert robot.model.nq == 2


def of_moments(*moments: float) -> str:
    """A single body with principal moments of inertia, kg·m²."""
    values = " ".join(f'{key}="{value!r}"' for key, value in zip(("ixx", "iyy", "izz"), moments, strict=True))
    inertial = f'<inertial><mass value="1"/><inertia {values} ixy="0" ixz="0" iyz="0"/></inertial>'
    return ARM.format(origin="", limit=LIMIT, kind="revolute", inertial=inertial)


@pytest.mark.parametrize("size", [1e-9, 1e-3, 1.0, 1e3])
def test_moments_may_miss_those_of_a_body_by_what_files_round(size: float, tmp_path: Path) -> None:
    """A millionth of the largest, or 1e-12 kg·m² where that is more; beyond it a note, and below zero a refusal."""
    path = tmp_path / "arm.urdf"
    for part, noted in ((-1e6, False), (0.0, False), (0.5, False), (2.0, True)):
        largest = 2.0 * size + part * (2e-6 * size + 1e-12) if part >= 0.0 else 0.5 * size
        path.write_text(of_moments(largest, size, size))
        assert any("no body can have" in note for note in load_robot(path).notes) == noted
    allowed = 1e-6 * size + 1e-12
    path.write_text(of_moments(size, size, -0.5 * allowed))
    assert load_robot(path).n == 1
    path.write_text(of_moments(size, size, -2.0 * allowed))
    with pytest.raises(ModelFileError, match="a negative one"):
        load_robot(path)
