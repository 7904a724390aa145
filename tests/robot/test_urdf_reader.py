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
from examples import examples
from hypothesis import given
from hypothesis import strategies as st

from redundancy_pin import load_robot
from redundancy_pin.errors import ModelFileError
from redundancy_pin.loading import propose_robot
from redundancy_pin.robot.formats.mechanism import MOST_FREEDOMS, MOST_LINKS
from redundancy_pin.robot.formats.urdf import DEEPEST_CHAIN, read_urdf, urdf_mechanism
from redundancy_pin.robot.formats.xml_files import MOST_BYTES

INERTIAL = """<inertial><origin xyz="0.25 0 0"/><mass value="1.0"/>
    <inertia ixx="0" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial>"""
LIMIT = '<limit lower="-9" upper="9" velocity="9" effort="9"/>'
ARM = """<robot name="arm"><link name="base"/><link name="body">{inertial}</link>
  <joint name="{name}" type="{kind}"><parent link="base"/><child link="body"/>{axis}{limit}</joint>
  <transmission name="drive"><type>SimpleTransmission</type><joint name="{name}"/></transmission></robot>"""
"""A body that a motor turns or slides."""


def arm(folder: Path, more: str = "", **given: str) -> Path:
    """Write an arm, with more elements at its end."""
    parts = {"name": "turn", "kind": "revolute", "axis": '<axis xyz="0 0 1"/>', "limit": LIMIT, "inertial": INERTIAL}
    path = folder / "arm.urdf"
    path.write_text(ARM.format(**parts | given).replace("</robot>", f"{more}</robot>"), encoding="utf-8")
    return path


# ---- sizes --------------------


def links(count: int, parent: str, kind: str = "fixed") -> str:
    """Return links that hang on a parent, or each on the one before it where its name is ``c{}``."""
    return "".join(
        f'<link name="c{i}"/><joint name="k{i}" type="{kind}"><parent link="{parent.format(i - 1) if i else "base"}"/>'
        f'<child link="c{i}"/>{LIMIT}</joint>'
        for i in range(count)
    )


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: f"<!--{'x' * 50_000_000}-->", "is too large"),
        (lambda: links(30_000, "c{}"), "too large"),
        (lambda: links(12_000, "c{}"), "elements"),
        (lambda: links(2_500, "c{}"), f"more than the {MOST_LINKS}"),
        (lambda: links(DEEPEST_CHAIN + 1, "c{}"), f"More than {DEEPEST_CHAIN} links follow"),
        (lambda: links(MOST_FREEDOMS, "base", "revolute"), f"more than the {MOST_FREEDOMS} of a model"),
        (lambda: "<a>" * 30_000 + "</a>" * 30_000, "levels of elements"),
        (lambda: "<a/>" * 400_000, "elements"),
        (lambda: "<a " + " ".join(f'a{i}=""' for i in range(130_000)) + "/>", "attributes of one element"),
    ],
)
def test_files_of_any_size_are_refused_at_once(make: Callable[[], str], message: str, tmp_path: Path) -> None:
    path = arm(tmp_path, make())
    start, before = time.process_time(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(ModelFileError, match=message):
        load_robot(path)
    assert time.process_time() - start < 2.0
    unit = 1 if sys.platform == "darwin" else 1024
    assert (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * unit < 500e6


def test_large_robots_within_the_limits_are_read(tmp_path: Path) -> None:
    path = arm(tmp_path, links(DEEPEST_CHAIN - 5, "c{}") + f"<!--{'x' * (MOST_BYTES - 100_000)}-->")
    assert propose_robot(path, is_open=True)[1].n == 1


# ---- the model is what the file says --------------------


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


@examples(12)
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


@pytest.mark.parametrize("size", [1e-9, 1e-3, 1.0, 1e3])
def test_moments_may_miss_those_of_a_body_by_what_files_round(size: float, tmp_path: Path) -> None:
    """A millionth of the largest, or 1e-12 kg·m² where that is more; beyond it a note, and below zero a refusal."""

    def of_moments(*moments: float) -> Path:
        values = " ".join(f'{key}="{value!r}"' for key, value in zip(("ixx", "iyy", "izz"), moments, strict=True))
        inertia = f'<inertia {values} ixy="0" ixz="0" iyz="0"/>'
        return arm(tmp_path, inertial=f'<inertial><mass value="1"/>{inertia}</inertial>')

    for part, noted in ((-1e6, False), (0.0, False), (0.5, False), (2.0, True)):
        largest = 2.0 * size + part * (2e-6 * size + 1e-12) if part >= 0.0 else 0.5 * size
        robot = load_robot(of_moments(largest, size, size))
        assert any("no body can have" in note for note in robot.notes) == noted
    allowed = 1e-6 * size + 1e-12
    assert load_robot(of_moments(size, size, -0.5 * allowed)).n == 1
    with pytest.raises(ModelFileError, match="a negative one"):
        load_robot(of_moments(size, size, -2.0 * allowed))
