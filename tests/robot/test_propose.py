"""What a URDF leaves open is right or asked, never guessed. Efforts are those of Pinocchio's tree and a KKT system."""

from __future__ import annotations

import re
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from examples import FACTOR
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from written import J, urdf_of

import redundancy_pin as rp
from redundancy_pin.arrays import Array
from redundancy_pin.errors import DeclarationError
from redundancy_pin.loading import propose_robot
from redundancy_pin.robot.model_files import open_model
from redundancy_pin.robot.propose import propose
from redundancy_pin.robot.shipped import shipped_robots


@dataclass(frozen=True)
class Loop:
    """A planar loop on the base, cut at its top, that is closed when all joints are at zero."""

    joints: tuple[J, ...]
    ends: tuple[str, str]
    motors: tuple[str, ...]


def loop(
    ends: tuple[str, str], motors: tuple[str, str], *, links: tuple[int, int] = (2, 2), tag: str = "", seed: int = 0
) -> Loop:
    """Return a loop of two chains; the first and, of four joints and more, the last joint on the ground are driven.

    Args:
        ends: names of the marks where both chains meet.
        motors: names of the joints on the ground.
        links: of each chain.
        tag: of the names of all other joints and links.
        seed: of lengths and angles.
    """
    rng = np.random.default_rng(seed)
    top, joints = np.array([0.2, 0.7]), list[J]()
    for side, (count, foot) in enumerate(zip(links, ([0.0, 0.0], [0.5, 0.1]), strict=True)):
        spread = rng.uniform(-0.15, 0.15, (count - 1, 2))
        points = [np.array(foot)]
        points += [foot + (top - foot) * (k + 1) / count + spread[k] for k in range(count - 1)]
        parent, heading, at = "base", 0.0, np.array(foot)
        for k, (start, end) in enumerate(zip(points, [*points[1:], top], strict=True)):
            angle = float(np.arctan2(*(end - start)[::-1]))
            name = motors[side] if k == 0 else f"pin{tag}_{'lr'[side]}{k}"
            child = f"link{tag}_{'lr'[side]}{k}"
            joints.append(J(name, "revolute", parent, child, (*at, 0.0), (0.0, 0.0, angle - heading)))
            parent, heading, at = child, angle, np.array([np.linalg.norm(end - start), 0.0])
        joints.append(J(f"at_{ends[side]}", "fixed", parent, ends[side], (*at, 0.0)))
    return Loop(tuple(joints), ends, motors[: sum(links) - 2])


def displaced(joints: tuple[J, ...], by: float) -> tuple[J, ...]:
    """Return joints whose zero configuration is elsewhere, so that loops are open there."""
    return tuple(
        joint if joint.kind == "fixed" else replace(joint, rpy=(0.0, 0.0, joint.rpy[2] + by * (k + 1)))
        for k, joint in enumerate(joints)
    )


def written(folder: Path, *joints: J) -> Path:
    path = folder / "robot.urdf"
    path.write_text(urdf_of(joints))
    return path


def holding(robot: rp.Robot) -> dict[str, float]:
    x = np.array(
        [[robot.q_reference[robot.model.joints[robot.model.getJointId(n)].idx_q] for n in robot.independent_joints]]
    )
    still = np.zeros_like(x)
    efforts = rp.distribute(rp.RneaDynamics(robot).reduce(rp.PlatformMotion([0.0], x, still, still)))
    assume(efforts.status_labels == ("ok",))  # of a random linkage that is not next to a singularity
    return dict(zip(robot.actuated, efforts.tau[0].tolist(), strict=True))


def holding_by_kkt(path: Path, q: Array, loops: list[Loop], gravity: Array) -> dict[str, float]:
    """Return the holding efforts of Pinocchio's tree: gravity = Sᵀ τ + Jᵀ λ, J of the points where ends meet."""
    model = pin.buildModelFromUrdf(str(path))
    model.gravity.linear = gravity
    data = model.createData()
    pin.computeJointJacobians(model, data, q)
    pin.updateFramePlacements(model, data)
    rows = []
    for each in loops:
        one, other = (model.getFrameId(end, pin.BODY) for end in each.ends)
        np.testing.assert_allclose(data.oMf[one].translation, data.oMf[other].translation, atol=1e-9)
        both = [pin.getFrameJacobian(model, data, end, pin.LOCAL_WORLD_ALIGNED)[:3] for end in (one, other)]
        rows.append(both[0] - both[1])
    motors = [name for each in loops for name in each.motors]
    selection = np.eye(model.nv)[:, [model.joints[model.getJointId(name)].idx_v for name in motors]]
    weight = pin.computeGeneralizedGravity(model, model.createData(), q)
    unknown, *_ = np.linalg.lstsq(np.column_stack([selection, np.concatenate(rows).T]), weight, rcond=None)
    return dict(zip(motors, unknown[: len(motors)].tolist(), strict=True))


ENDS = st.sampled_from(
    [
        ("closing_p{0}_1", "closing_p{0}_2"),
        ("p{0}_1", "p{0}_2"),
        ("left_tip{0}", "right_tip{0}"),
        ("rod_loop{0}", "rocker_loop{0}"),
        ("ltip{0}", "mark{0}"),
    ]
)
MOTORS = st.sampled_from(
    [("motor{0}_1", "motor{0}_2"), ("crank{0}", "passive{0}"), ("j{0}_1", "j{0}_2"), ("actuator{0}_1", "b{0}")]
)
GRAVITY = np.array([0.0, 0.0, -9.81])


@settings(max_examples=5 * FACTOR)
@given(
    ends=ENDS,
    motors=MOTORS,
    links=st.lists(st.sampled_from([(1, 2), (2, 1), (2, 2), (3, 1)]), min_size=1, max_size=2),
    away=st.sampled_from([0.0, 0.0, 0.01]),
    more=st.lists(
        st.sampled_from(["tool0", "end_effector", "spare", "left_tip9", "p9_1", "camera_frame"]),
        max_size=2,
        unique=True,
    ),
    seed=st.integers(0, 1000),
)
def test_linkages_with_marks_are_right_or_undecided(tmp_path_factory, ends, motors, links, away, more, seed) -> None:
    """One or two loops, closed at zero or nearly, among frames that close nothing; every answer names all or asks."""
    names = [tuple(text.format(k) for text in ends) for k in range(len(links))]
    driven = [tuple(text.format(k) for text in motors) for k in range(len(links))]
    loops = [loop(names[k], driven[k], links=each, tag=str(k), seed=seed + k) for k, each in enumerate(links)]
    tree = [joint for each in loops for joint in displaced(each.joints, away)]
    # the plane stands upright, and is not a coordinate plane: gravity acts in it
    tree = [replace(joint, parent="wall") if joint.parent == "base" else joint for joint in tree]
    tree.insert(0, J("wall", "fixed", "base", "wall", rpy=(np.pi / 2, 0.2, 0.3)))
    rng = np.random.default_rng(seed)
    places = [f"link{k}_l0" for k in range(len(links))]
    tree += [J(f"at_{name}", "fixed", str(rng.choice(places)), name, (*rng.uniform(-1, 1, 3),)) for name in more]
    path = written(tmp_path_factory.mktemp("linkage"), *tree)
    proposal, robot = propose_robot(path)
    if proposal.questions:
        with pytest.raises(DeclarationError, match="redundancy-pin new"):
            rp.load_robot(path)
    else:
        assert robot is not None
        expected = holding_by_kkt(path, np.array(robot.q_reference), loops, GRAVITY)
        assert holding(robot) == pytest.approx(expected, rel=1e-6, abs=1e-9)
    decided, robot = propose_robot(
        path,
        close=[",".join(each.ends) for each in loops],
        actuate=[name for each in loops for name in each.motors],
        is_open=True,
    )
    assert (decided.questions, robot.n) == ((), sum(len(each.motors) for each in loops))
    assert holding(robot) == pytest.approx(
        holding_by_kkt(path, np.array(robot.q_reference), loops, GRAVITY), rel=1e-6, abs=1e-9
    )


FIVE_BAR = loop(("left_tip", "right_tip"), ("motor_1", "motor_2"))


@pytest.mark.parametrize("tilt", [0.0, 0.3, -1.2])
def test_a_hinge_about_another_axis_than_the_loops_is_asked_about_with_its_angle(tilt: float, tmp_path: Path) -> None:
    """Both marks of a planar five-bar lean by one angle: their hinge would hold both links like a weld."""
    joints, heading = list(FIVE_BAR.joints), 0.0
    for number, joint in enumerate(joints):
        heading = joint.rpy[2] + (0.0 if joint.parent == "base" else heading)
        if joint.kind == "fixed":
            joints[number] = replace(joint, rpy=(tilt, 0.0, -heading))
    path = written(tmp_path, *joints)
    asked, robot = propose_robot(path, close=["left_tip,right_tip,hinge"], actuate=["motor_1", "motor_2"])
    assert robot is not None
    if tilt:
        off = rf"z of left_tip is {np.rad2deg(abs(tilt)):.3g}° off .*: --close left_tip,right_tip,ball"
        assert re.search(off, " ".join(asked.questions))
    else:
        assert (asked.questions, robot.n) == ((), 2)


@pytest.mark.parametrize("name", shipped_robots())
def test_shipped_urdfs_are_closed_as_declared_or_asked(name: str, tmp_path: Path) -> None:
    """Of each robot's URDF alone: no loop is found that its declaration does not close."""
    robot = rp.load_robot(name)
    path = tmp_path / "robot.urdf"
    path.write_text(robot.urdf)
    proposal = propose(open_model(path, {})[1](None, ()))
    declared = {frozenset((each.frame_a, each.frame_b)) for each in robot.all_closures or robot.closures}
    found = {frozenset(each.links) for each in proposal.mechanism.loop_joints}
    assert found <= declared
    assert found == declared or proposal.questions or not proposal.motors


def test_a_file_of_many_marks_is_asked_about_in_time(tmp_path: Path) -> None:
    """0.4 s of 800 marks; comparing them one by one took 8 s."""
    joints = [J("drive", "revolute", "base", "arm"), J("elbow", "revolute", "arm", "hand", (0.3, 0.0, 0.0))]
    marks = [J(f"to_{k}", "fixed", ("arm", "hand")[k % 2], f"tip_{k}", (0.01 * k, 0.1, 0.0)) for k in range(800)]
    path = tmp_path / "marks.urdf"
    path.write_text(urdf_of([*joints, *marks]))
    begun = time.process_time()
    with pytest.raises(DeclarationError, match=r"Where are loops cut\?.* tip_0, tip_2, "):
        rp.load_robot(path)
    assert time.process_time() - begun < 3.0
