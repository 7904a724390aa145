"""Couplings of joints: against motions and efforts by hand, finite differences, and MuJoCo's equalities."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from command_line import call
from numpy.polynomial import Polynomial
from written import J, urdf_of, write_robot

import redundancy_pin as rp
from redundancy_pin.arrays import Array
from redundancy_pin.dynamics.compiled.parameters import topology_of
from redundancy_pin.errors import DeclarationError, InputError
from redundancy_pin.robot import Coupling, Robot
from redundancy_pin.simulation import inverse_derivatives
from redundancy_pin.simulation.forward import ForwardDynamics

JOINTS = [
    J("arm", "revolute", "base", "arm", axis=(0, 1, 0)),
    J("elbow", "revolute", "arm", "fore", (0.3, 0, 0.1), axis=(0, 1, 0)),
    J("slide", "prismatic", "fore", "tip", (0.2, 0, 0), axis=(0.6, 0, 0.8)),
    J("lid", "revolute", "tip", "lid", (0, 0.1, 0), axis=(1, 0, 0)),
    J("rotor", "revolute", "base", "rotor", (0, 0.4, 0), axis=(0, 0, 1)),
]
CAM = Polynomial([0.1, 0.2, -0.3, 0.05])
GEAR, FURTHER = 40.0, 3.0
DECLARATION = {
    "name": "geared",
    "gravity": [0, 0.3, -9.81],
    "couplings": [
        {"joint": "slide", "of": "arm", "polynomial": CAM.coef.tolist()},
        {"name": "gears", "joint": "rotor", "of": "lid", "polynomial": [0.5, GEAR], "also": [["elbow", FURTHER]]},
    ],
    "actuated": ["arm", "rotor"],
    "independent": {"joints": ["arm", "lid"]},
    "reference": {"joints": {"arm": 0.3, "lid": 0.2}},
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("geared")
    mimic = '<axis xyz="0.0 1.0 0.0"/><mimic joint="arm" multiplier="-2" offset="0.1"/>'
    urdf = urdf_of(JOINTS)
    at = urdf.index('<joint name="elbow"')
    urdf = urdf[:at] + urdf[at:].replace('<axis xyz="0.0 1.0 0.0"/>', mimic, 1)
    write_robot(folder, urdf, DECLARATION)
    return folder


@pytest.fixture(scope="module")
def robot(folder: Path) -> Robot:
    return rp.load_robot(folder)


def by_hand(x: Array) -> tuple[Array, Array, Array]:
    """Return q (5,), dq/dx (5, 2) and d²q/dx_0² (5,), written down from the couplings."""
    arm, lid = x
    elbow = 0.1 - 2.0 * arm
    q = np.array([arm, elbow, CAM(arm), lid, 0.5 + GEAR * lid + FURTHER * elbow])
    slope = np.array([[1, 0], [-2, 0], [CAM.deriv()(arm), 0], [0, 1], [-2 * FURTHER, GEAR]])
    return q, slope, np.array([0, 0, CAM.deriv(2)(arm), 0, 0])


@pytest.fixture(scope="module")
def motion() -> rp.PlatformMotion:
    t = np.linspace(0.0, 1.0, 12)
    wave, rate, amplitude = np.array([3.0, 2.0]), np.array([0.3, -0.2]), np.array([0.5, 0.4])
    x = rate + amplitude * np.sin(np.outer(t, wave))
    xd, xdd = amplitude * wave * np.cos(np.outer(t, wave)), -amplitude * wave**2 * np.sin(np.outer(t, wave))
    return rp.PlatformMotion(t, x, xd, xdd)


def test_where_couplings_come_from(robot: Robot) -> None:
    assert robot.couplings == (
        Coupling("slide of arm", "slide", "arm", tuple(CAM.coef)),
        Coupling("gears", "rotor", "lid", (0.5, GEAR), (("elbow", FURTHER),)),
        Coupling("elbow of arm", "elbow", "arm", (0.1, -2.0)),
    )
    assert robot.constraint_names == ("coupling slide of arm", "coupling gears", "coupling elbow of arm")
    np.testing.assert_allclose(robot.q_reference, by_hand(np.array([0.3, 0.2]))[0], atol=1e-13)
    other = replace(robot.couplings[1], polynomial=(0.3, 7.0), also=(("elbow", -1.0),))
    assert topology_of(replace(robot, couplings=(robot.couplings[0], other, robot.couplings[2]))) == topology_of(robot)


@pytest.mark.parametrize("backend", [rp.RneaDynamics, rp.CompiledDynamics])
def test_efforts_are_those_of_the_reduced_chain(backend, robot: Robot, motion: rp.PlatformMotion) -> None:
    reduced = backend(robot).reduce(motion)
    tau = rp.distribute(reduced).tau
    data = robot.model.createData()
    for k, (x, xd, xdd) in enumerate(zip(motion.x, motion.xd, motion.xdd, strict=True)):
        q, slope, bend = by_hand(x)
        f = slope.T @ pin.rnea(robot.model, data, q, slope @ xd, slope @ xdd + bend * xd[0] ** 2)
        np.testing.assert_allclose(reduced.f[k], f, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(slope[[0, 4]].T @ tau[k], f, rtol=1e-12, atol=1e-12)


def test_the_multiplier_is_the_effort_of_the_coupling(robot: Robot, motion: rp.PlatformMotion) -> None:
    along = rp.RneaDynamics(robot).along(motion)
    tau = rp.distribute(along.reduce()).tau
    reactions = rp.joint_reactions(along, tau)
    assert reactions.residual.max() < 1e-11
    data = robot.model.createData()
    for k, (x, xd, xdd) in enumerate(zip(motion.x, motion.xd, motion.xdd, strict=True)):
        q, slope, bend = by_hand(x)
        tree = pin.rnea(robot.model, data, q, slope @ xd, slope @ xdd + bend * xd[0] ** 2)
        # nothing but couplings acts in the slide and the elbow; the rotor's motor is beside its gears
        gears = tree[4] - tau[k, 1]
        expected = [tree[2], gears, tree[1] + FURTHER * gears]
        np.testing.assert_allclose(reactions.closure_force[k], expected, rtol=1e-10, atol=1e-10)


def test_forward_dynamics_and_derivatives(robot: Robot) -> None:
    rng, model = np.random.default_rng(4), robot.model
    x, xd, xdd, tau = rng.normal(size=(4, 2)) * 0.5
    data = model.createData()

    def force(x: Array, xd: Array, xdd: Array) -> Array:
        q, slope, bend = by_hand(x)
        effort: Array = slope.T @ pin.rnea(model, data, q, slope @ xd, slope @ xdd + bend * xd[0] ** 2)
        return effort

    q, slope, bend = by_hand(x)
    u = np.zeros(5)
    u[robot.actuated_velocity] = tau
    mass = np.array([force(x, xd, unit) - force(x, xd, np.zeros(2)) for unit in np.eye(2)]).T
    second = np.linalg.solve(mass, slope.T @ u - force(x, xd, np.zeros(2)))
    dynamics = ForwardDynamics(robot)
    dynamics.adapt(q)
    a = dynamics.acceleration(q, slope @ xd, u)
    np.testing.assert_allclose(a, slope @ second + bend * xd[0] ** 2, rtol=1e-9)
    derivatives = inverse_derivatives(robot, q, slope @ xd, slope @ xdd + bend * xd[0] ** 2)
    np.testing.assert_allclose(derivatives.mass, mass, rtol=1e-9)
    steps = 1e-5 * np.eye(2)
    by_x = np.array([force(x + h, xd, xdd) - force(x - h, xd, xdd) for h in steps]).T / 2e-5
    by_xd = np.array([force(x, xd + h, xdd) - force(x, xd - h, xdd) for h in steps]).T / 2e-5
    np.testing.assert_allclose(derivatives.force_y, by_x, atol=1e-6 * np.abs(by_x).max())
    np.testing.assert_allclose(derivatives.force_z, by_xd, atol=1e-6 * np.abs(by_xd).max())


def test_from_a_model_and_held_joints(robot: Robot) -> None:
    given = [("slide", "arm", CAM.coef), robot.couplings[1], {"joint": "elbow", "of": "arm", "polynomial": [0.1, -2.0]}]
    roles = {"actuated": ["arm", "rotor"], "independent": ["arm", "lid"]}
    made = rp.robot_from_model(robot.model, couplings=given, reference={"joints": {"arm": 0.3, "lid": 0.2}}, **roles)
    assert made.couplings == robot.couplings
    np.testing.assert_allclose(made.q_reference, robot.q_reference, atol=1e-12)
    fixed = rp.robot_from_model(robot.model, couplings=[*given, ("lid", "", [0.7])], actuated=["arm"])
    assert fixed.independent_joints == ("arm",)
    assert fixed.q_reference[3:] == pytest.approx([0.7, 0.5 + GEAR * 0.7 + FURTHER * fixed.q_reference[1]])
    with pytest.raises(InputError, match=r"couplings\[0\] is 'slide'"):
        rp.robot_from_model(robot.model, couplings=["slide"], **roles)
    twice = [*given, ("slide", "arm", CAM.coef)]
    with pytest.raises(DeclarationError, match=r"the coupling 'slide of arm'"):
        rp.robot_from_model(robot.model, couplings=twice, **roles)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"couplings": [{"joint": "slid", "of": "arm", "polynomial": [1]}]}, "no moving joint 'slid'.*'slide'"),
        ({"couplings": [{"joint": "slide", "of": "slide", "polynomial": [1]}]}, "'slide' is coupled to itself"),
        ({"couplings": [{"joint": "slide", "polynomial": [0, 1]}]}, "one number, where the joint is held"),
        ({"couplings": [{"joint": "slide", "of": "arm"}]}, r"couplings\[0\].polynomial"),
        ({"closed_form": "2rpr"}, "needs the xacro argument"),
        ({"carriers": [{"joint": "slide", "position": [-1, 1]}]}, "The carrier 'slide' is coupled"),
        (
            {"independent": {"joints": ["arm", "elbow"]}, "reference": {"joints": {"arm": 0.3, "elbow": -0.5}}},
            "type I singularity",
        ),
    ],
)
def test_mistakes_are_named(change: dict, message: str, folder: Path, tmp_path: Path) -> None:
    path = write_robot(tmp_path, (folder / "robot.urdf").read_text(), {**DECLARATION, **change})
    with pytest.raises(DeclarationError, match=message):
        rp.load_robot(path)


def test_a_coupled_continuous_joint_counts_its_turns(folder: Path, tmp_path: Path) -> None:
    """Of a URDF it is a revolute one; a model of Pinocchio stays as it is, which has cosine and sine."""
    text = (folder / "robot.urdf").read_text()
    urdf = text.replace('<joint name="rotor" type="revolute">', '<joint name="rotor" type="continuous">')
    assert urdf != text
    robot, plain = rp.load_robot(write_robot(tmp_path, urdf, DECLARATION)), rp.load_robot(folder / "robot.yaml")
    np.testing.assert_allclose(robot.q_reference, plain.q_reference, atol=1e-12)
    assert robot.couplings == plain.couplings
    model = pin.buildModelFromXML(urdf)
    with pytest.raises(DeclarationError, match=r"'rotor' is continuous.*wide"):
        rp.robot_from_model(model, actuated=["arm"], couplings=[("rotor", "lid", [0.5, GEAR])])


def test_the_command_line_shows_and_proposes_them(folder: Path, tmp_path: Path) -> None:
    facts = json.loads(call("info", "--robot", folder / "robot.yaml", "--json").stdout)
    gears = {"joint": "rotor", "of": "lid", "polynomial": [0.5, GEAR], "also": [["elbow", FURTHER]]}
    assert facts["couplings"][1] == gears
    assert "0.5 40" in call("info", "--robot", folder / "robot.yaml").stdout
    out = tmp_path / "own.yaml"
    assert call("new", folder / "robot.urdf", "--actuate", "arm", "--open", "--out", out).exit_code == 0
    robot = rp.load_robot(out)
    assert [(each.joint, each.of, each.polynomial) for each in robot.couplings] == [("elbow", "arm", (0.1, -2.0))]
