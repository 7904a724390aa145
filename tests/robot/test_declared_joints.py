"""Joints that close loops, declared by their kinds: against what each kind means, differenced, and plain Pinocchio."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import yaml
from spatial_chains import RCCC_TWISTS, ball
from written import J, urdf_of, write_robot
from zoo import index, places_of

import redundancy_pin as rp
from redundancy_pin.arrays import Array
from redundancy_pin.errors import DeclarationError
from redundancy_pin.robot import Robot

CRANK, KNEE = J("crank", "revolute", "base", "crank"), J("knee", "revolute", "crank", "coupler", (0.1, 0, 0))
ROCKER = J("rocker", "revolute", "base", "rocker", (0.4, 0, 0))
SKEW_CRANK = J("crank", "revolute", "base", "crank", rpy=(0.2, -0.1, 0.0))
SKEW_ROCKER = J("rocker", "revolute", "base", "rocker", (0.5, 0.3, 0.0), (0.7, 0.3, 0.1))
FOUR_BAR = {"rocker": 1.9, "knee": -0.5}
TWIST_1, TWIST_2, TWIST_3, TWIST_4 = RCCC_TWISTS
RCC = [
    CRANK,
    J("turn_2", "revolute", "crank", "link_2a", (0.1, 0, 0), (TWIST_1, 0, 0)),
    J("slide_2", "prismatic", "link_2a", "link_2"),
    J("turn_3", "revolute", "link_2", "link_3a", (0.4, 0, 0), (TWIST_2, 0, 0)),
    J("slide_3", "prismatic", "link_3a", "link_3"),
]
ENDS = {"at": [[0.35, 0, 0], [0.25, 0, 0]]}

MACHINES: dict[str, tuple[list[J], dict[str, Any], dict[str, float]]] = {
    "hinge": ([CRANK, KNEE, ROCKER], {"hinge": ["coupler", "rocker"], **ENDS, "axis": "z"}, FOUR_BAR),
    "ball": ([CRANK, KNEE, ROCKER], {"ball": ["coupler", "rocker"], **ENDS}, FOUR_BAR),
    "universal": (
        [SKEW_CRANK, *ball("ball", "crank", "coupler", (0.2, 0, 0)), SKEW_ROCKER],
        {
            "universal": ["coupler", "rocker"],
            "at": [[0.6, 0, 0], [0.4, 0, 0]],
            "rpy": [[0.3, 0.2, -0.4], [0, 0, 0]],
            "axis": ["y", "x"],
        },
        {},
    ),
    "cylinder": (
        RCC,
        {"cylinder": ["base", "link_3"], "at": [[0.35, 0, 0], [0.3, 0, 0]], "rpy": [[TWIST_4, 0, 0], [TWIST_3, 0, 0]]},
        {},
    ),
    "weld": (
        [CRANK, KNEE, ROCKER, J("pin", "revolute", "rocker", "half", (0.25, 0, 0))],
        {"weld": ["coupler", "half"], "at": [[0.2, 0, 0], [-0.15, 0, 0]]},
        FOUR_BAR,
    ),
    "slider": (
        [CRANK, KNEE, J("wrist", "revolute", "coupler", "shoe", (0.35, 0, 0))],
        {"slider": ["base", "shoe"], "at": [[0, 0.03, 0], [0, 0, 0]], "axis": "x"},
        {"knee": -0.5, "wrist": -0.1},
    ),
    "planar": (
        [
            SKEW_CRANK,
            J("lift", "prismatic", "crank", "lift", (0.3, 0, 0)),
            *ball("ball", "lift", "plate", (0, 0, 0.1)),
        ],
        {"planar": ["base", "plate"], "at": [[0, 0, 0.25], [0, 0, 0.1]], "axis": "z"},
        {},
    ),
    "rod": (
        [SKEW_CRANK, SKEW_ROCKER],
        {"rod": ["crank", "rocker"], "at": [[0.2, 0, 0.02], [0.4, 0, 0]], "length": 0.6},
        {},
    ),
}


def held(kind: str, given: dict[str, Any], one: pin.SE3, other: pin.SE3) -> Array:
    """Return what a joint holds at zero, of its frames in the world: in words of its kind, redundant rows too."""
    axes = given.get("axis", "z")
    first, second = (np.eye(3)["xyz".index(axis)] for axis in (axes if isinstance(axes, list) else [axes] * 2))
    apart = one.rotation.T @ (other.translation - one.translation)
    turned = np.cross(one.rotation @ first, other.rotation @ second)
    angles = pin.log3(one.rotation.T @ other.rotation)
    across = np.cross(first, apart)
    return {
        "hinge": lambda: np.concatenate([apart, turned]),
        "ball": lambda: apart,
        "universal": lambda: np.append(apart, (one.rotation @ first) @ (other.rotation @ second)),
        "cylinder": lambda: np.concatenate([across, turned]),
        "slider": lambda: np.concatenate([across, angles]),
        "planar": lambda: np.append(turned, first @ apart),
        "weld": lambda: np.concatenate([apart, angles]),
        "rod": lambda: np.array([np.linalg.norm(apart) - given["length"]]),
    }[kind]()


def torque_by_differences(robot: Robot, kind: str, q: Array, xd: Array, xdd: Array) -> Array:
    """Return the efforts (m,) from differenced constraints: J v = 0, J a + J̇ v = 0, RNEA = S τ + Jᵀ λ."""
    given, model, step = MACHINES[kind][1], robot.model, 1e-4
    data, places = model.createData(), []
    for link, at, rpy in zip(given[kind], given["at"], given.get("rpy", [[0, 0, 0]] * 2), strict=True):
        frame = model.frames[model.getFrameId(link, pin.BODY)]
        places.append((frame.parentJoint, frame.placement * pin.SE3(pin.rpy.rpyToMatrix(*rpy), np.array(at))))

    def rows(q: Array) -> Array:
        pin.forwardKinematics(model, data, q)
        return held(kind, given, *(data.oMi[joint] * place for joint, place in places))

    def rate(q: Array, v: Array) -> Array:
        ahead = [rows(pin.integrate(model, q, sign * step * v)) for sign in (1.0, -1.0, 2.0, -2.0)]
        return (8.0 * (ahead[0] - ahead[1]) - (ahead[2] - ahead[3])) / (12.0 * step)

    np.testing.assert_allclose(rows(q), 0.0, atol=1e-9)
    free = [model.joints[model.getJointId(name)].idx_v for name in robot.independent_joints]
    jacobian = np.array([rate(q, unit) for unit in np.eye(model.nv)]).T
    system = np.vstack([jacobian, np.eye(model.nv)[free]])
    v = np.linalg.lstsq(system, np.append(np.zeros(len(jacobian)), xd), rcond=1e-7)[0]
    along = [rate(pin.integrate(model, q, sign * 10 * step * v), v) for sign in (1.0, -1.0)]
    bias = (along[0] - along[1]) / (20.0 * step)
    a = np.linalg.lstsq(system, np.append(-bias, xdd), rcond=1e-7)[0]
    forces = pin.rnea(model, data, q, v, a)
    driven = np.eye(model.nv)[:, robot.actuated_velocity]
    unknown: Array = np.linalg.lstsq(np.hstack([driven, jacobian.T]), forces, rcond=1e-7)[0]
    return unknown[: robot.m]


def declared(folder: Path, kind: str, **change: Any) -> Robot:
    joints, closure, guess = MACHINES[kind]
    free = {"crank": 0.6, "ball_z": 0.2} if kind == "planar" else {"crank": 0.6}
    declaration = {
        "gravity": [0.3, -9.0, 1.0],
        "closures": [{**closure, **change}],
        "actuated": list(free),
        "independent": {"joints": list(free)},
        "reference": {"joints": free, "guess": guess},
    }
    return rp.load_robot(write_robot(folder, urdf_of(joints), declaration))


@pytest.mark.parametrize("kind", MACHINES)
def test_efforts_are_those_of_the_joint_that_the_kind_names(kind: str, tmp_path: Path) -> None:
    robot = declared(tmp_path, kind)
    rng = np.random.default_rng(2)
    x = np.array([0.6, 0.2])[: robot.n] + rng.uniform(-0.1, 0.1, (3, robot.n))
    motion = rp.PlatformMotion(np.arange(3.0), x, *rng.normal(size=(2, 3, robot.n)), check_rates=False)
    tau = rp.distribute(rp.RneaDynamics(robot).reduce(motion)).tau
    for k, q in enumerate(rp.inverse_kinematics(robot, motion).q):
        expected = torque_by_differences(robot, kind, q, motion.xd[k], motion.xdd[k])
        np.testing.assert_allclose(tau[k], expected, rtol=1e-6, atol=1e-6 * np.abs(tau).max())


def test_a_length_that_is_left_out_is_measured_where_the_reference_puts_the_joints(tmp_path: Path) -> None:
    """And stays as it is where other lengths change."""
    robot = declared(tmp_path, "rod", length=None)
    q = pin.neutral(robot.model)
    q[index(robot, "crank")] = 0.6
    (rod,) = robot.closures
    one, other = (end.translation for end in places_of(robot.model, q, rod.frame_a, rod.frame_b))
    assert rod.length == pytest.approx(np.linalg.norm(other - one), rel=1e-14)
    assert f"The rod {rod.name!r} is {rod.length:.6g} m long, as its ends are apart at the reference." in robot.notes
    assert rp.with_parameters(robot, lengths={"rocker": 0.6}).closures == robot.closures


def test_a_closed_form_knows_no_rods(tmp_path: Path) -> None:
    folder = Path(rp.load_robot("3rrr").urdf_folder)
    data = yaml.safe_load((folder / "robot.yaml").read_text(encoding="utf-8"))
    data["urdf"] = str(folder / data["urdf"])
    data["closures"][0] = {"rod": data["closures"][0]["frames"], "length": 0.1}
    (tmp_path / "robot.yaml").write_text(yaml.safe_dump(data), encoding="utf-8")
    with pytest.raises(DeclarationError, match="`closed_form: 3rrr` knows no rods"):
        rp.load_robot(tmp_path)


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("angle", [0.6, 2.2, 2.6, 3.4, 3.8, 4.2])
def test_the_reference_is_on_the_branch_of_its_joints_and_its_guess(angle: float, side: float, tmp_path: Path) -> None:
    """A guess closed to 1e-3 rad, its crank under ``joints``; by circles of 0.35 and 0.25 m about tip and pivot."""
    upright = [replace(each, rpy=(np.pi / 2.0, 0.0, 0.0)) for each in (CRANK, ROCKER)]
    tip = 0.1 * np.array([np.cos(angle), np.sin(angle)])
    away = np.array([0.4, 0.0]) - tip
    length = float(np.linalg.norm(away))
    along = (0.35**2 - 0.25**2 + length**2) / (2.0 * length)
    bend = np.arctan2(side * np.sqrt(0.35**2 - along**2), along)
    bar = np.arctan2(away[1], away[0]) + bend
    pin_at = tip + 0.35 * np.array([np.cos(bar), np.sin(bar)])
    exact = {"knee": bar - angle, "rocker": np.arctan2(pin_at[1], pin_at[0] - 0.4)}
    exact = {name: float(np.arctan2(np.sin(value), np.cos(value))) for name, value in exact.items()}
    declaration = {
        "closures": [MACHINES["ball"][1]],
        "actuated": ["crank"],
        "independent": {"joints": ["crank"]},
        "reference": {
            "joints": {"crank": float(angle)},
            "guess": {name: round(value, 3) for name, value in exact.items()},
        },
    }
    robot = rp.load_robot(write_robot(tmp_path, urdf_of([*upright, KNEE]), declaration))
    for name, value in exact.items():
        joint = robot.model.joints[robot.model.getJointId(name)]
        q = robot.q_reference[joint.idx_q : joint.idx_q + joint.nq]
        reached = q[0] if joint.nq == 1 else np.arctan2(q[1], q[0])
        assert np.cos(reached - value) == pytest.approx(1.0, abs=1e-9)


def test_rods_between_the_same_two_links_are_numbered(tmp_path: Path) -> None:
    """As those of a parallelogram; each keeps the length of its own."""
    joints, closure, _ = MACHINES["rod"]
    slide = J("slide", "prismatic", "rocker", "shoe", (0.4, 0, 0))
    first = {**closure, "rod": ["crank", "shoe"], "length": None}
    second = {"rod": ["crank", "shoe"], "at": [[0.1, 0, 0], [0, 0, 0.01]]}
    declaration = {
        "closures": [first, second],
        "actuated": ["crank"],
        "independent": {"joints": ["crank"]},
        "reference": {"joints": {"crank": 0.6}},
    }
    robot = rp.load_robot(write_robot(tmp_path, urdf_of([*joints, slide]), declaration))
    one, other = robot.closures
    assert [one.name, other.name] == ["rod crank = shoe 1", "rod crank = shoe 2"]
    assert 0.0 < one.length != other.length > 0.0
    assert rp.with_parameters(robot, masses={"rocker": 2.0}).closures == robot.closures
