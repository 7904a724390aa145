"""Cassie's leg against its geometry: distances and angles of points that the tests' own reader finds in the SDF."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, files
from pathlib import Path

import cassie
import numpy as np
import pytest
from doc_blocks import example_script
from scipy.optimize import brentq, minimize

import redundancy_pin as rp
from redundancy_pin.kinematics.closure import ConstraintSystem

example = example_script(Path(__file__).resolve().parents[2] / "docs" / "examples" / "cassie_leg.py")
try:
    FILES = {file.name: file.locate() for file in files("example-robot-data") or () if file.name.endswith(".sdf")}
except PackageNotFoundError:
    pytest.skip("example-robot-data is not installed: pip install 'redundancy_pin[examples]'", allow_module_level=True)

LENGTHS = {"achilles": 0.5012, "plantar": 0.35012}
"""m, of the rods, as MuJoCo's model of the machine has them."""


class Leg:
    """The left leg as points and axes, no closed chain: what the file's pose becomes by angles of hinges."""

    def __init__(self, path: Path) -> None:
        self.links, joints, _ = cassie.read(path)
        self.joints = {name.removeprefix("left-"): joint for name, joint in joints.items()}
        self.hip, self.tip = (self.joints[f"{name}-joint"].point for name in ("pitch-rod", "achilles-spring"))
        self.sole = (self.links["left-foot"] @ np.append(example.BLADE, 1.0))[:3]

    def at(self, point: np.ndarray, **angles: float) -> np.ndarray:
        """Return where a point of the file's pose is behind turned hinges, from the hip outward."""
        place = np.eye(4)
        for name, angle in angles.items():
            place = place @ cassie.turned(self.joints[name.replace("_", "-")], angle)
        return (place @ np.append(point, 1.0))[:3]

    def chain(self, knee: float, shin: float, tarsus: float, spring: float) -> dict[str, float]:
        return {"knee_op": knee, "knee_shin_joint": shin, "shin_tarsus_joint": tarsus, "tarsus_spring_joint": spring}

    def rod(self, *angles: float) -> tuple[float, float]:
        """Return how much too long the rod is, m, and how its angle to the hinge of the file has changed, rad."""
        start, chain = self.tip - self.hip, self.chain(*angles)
        rod, axis = self.at(self.tip, **chain) - self.hip, self.joints["achilles-spring-joint"].axis
        hinge = self.at(self.tip + axis, **chain) - self.at(self.tip, **chain)
        length = np.linalg.norm(start)
        return np.linalg.norm(rod) - length, np.arccos(rod @ hinge / np.linalg.norm(rod)) - np.arccos(
            start @ axis / length
        )

    def tarsus(self, knee: float) -> float:
        return brentq(lambda x: self.rod(knee, 0.0, x, 0.0)[0], -knee - 0.2, -knee + 0.2, xtol=1e-14)

    def foot(self, crank: float) -> float:
        """Return the foot's angle for the crank's: the plantar rod keeps its length."""
        end, start = self.joints["plantar-foot-joint"].point, self.joints["crank-rod-joint"].point
        length = np.linalg.norm(end - start)

        def stretch(x: float) -> float:
            rod = self.at(end, foot_op=x) - self.at(start, tarsus_crank_joint=crank)
            return float(np.linalg.norm(rod) - length)

        return brentq(stretch, crank - 0.2, crank + 0.2, xtol=1e-14)

    def blade(self, pitch: float, knee: float, crank: float) -> np.ndarray:
        chain = {"pitch_op": pitch, **self.chain(knee, 0.0, self.tarsus(knee), 0.0), "foot_op": self.foot(crank)}
        return self.at(self.sole, **{name: angle for name, angle in chain.items() if name != "tarsus_spring_joint"})


@pytest.mark.long_for("cassie_wo_gearbox_spring.sdf")
@pytest.mark.parametrize("name", ["cassie_v2.sdf", "cassie_wo_gearbox_spring.sdf"])
def test_it_is_the_file_that_bends_springs(name: str) -> None:
    """Rods of the machine's length, hinged askew: with balls the leg folds and springs stay relaxed; as it is, not."""
    leg = Leg(FILES[name])
    assert np.linalg.norm(leg.tip - leg.hip) == pytest.approx(LENGTHS["achilles"], abs=5e-5)
    plantar = leg.joints["plantar-foot-joint"].point - leg.joints["crank-rod-joint"].point
    assert np.linalg.norm(plantar) == pytest.approx(LENGTHS["plantar"], abs=5e-5)
    knees = np.linspace(0.13, -2.0, 9)
    sums = np.array([knee + leg.tarsus(knee) for knee in knees])
    assert np.abs(sums).max() < 3e-4  # a parallelogram: the shin's tarsus turns as the knee, the other way
    off = [np.degrees(leg.rod(knee, 0.0, leg.tarsus(knee), 0.0)[1]) for knee in (-0.77, -2.0)]
    assert off == pytest.approx([-0.79, 2.77], abs=0.01)  # what the hinge forbids

    def energy(x: np.ndarray) -> float:
        return float(750.0 * x[0] ** 2 + 625.0 * x[2] ** 2)

    closed = {"type": "eq", "fun": lambda x: leg.rod(-0.77, *x)}
    least = minimize(energy, [0.01, 0.77, 0.01], constraints=closed, options={"ftol": 1e-12, "maxiter": 300})
    assert np.abs(leg.rod(-0.77, *least.x)).max() < 1e-10
    assert np.degrees(np.abs(least.x[[0, 2]]).max()) > 16.0  # of 20 that the shin's stop allows: 430 N·m and more


def test_we_read_what_the_file_says() -> None:
    """As it is, hinge and all: the springs that the package bends are those that geometry bends."""
    robot = rp.load_robot(FILES["cassie_v2.sdf"], actuated=cassie.drives(FILES["cassie_v2.sdf"]))
    row = dict(zip(robot.independent_joints, np.eye(robot.n), strict=True))
    x = (-0.3 * row["left-knee-op"] + 0.13 * row["left-tarsus-spring-joint"])[None]
    q = rp.inverse_kinematics(robot, rp.PlatformMotion([0.0], x, 0 * x, 0 * x)).q[0]
    names = ("knee-op", "knee-shin-joint", "shin-tarsus-joint", "tarsus-spring-joint")
    angles = [q[robot.model.joints[robot.model.getJointId(f"left-{name}")].idx_q] for name in names]
    assert abs(angles[1]) > 0.1
    assert np.abs(Leg(FILES["cassie_v2.sdf"]).rod(*angles)).max() < 1e-9


def test_corrected_it_bends_and_carries_as_geometry_says(tmp_path: Path) -> None:
    robot = example.load(tmp_path)
    leg, motion = Leg(tmp_path / "cassie.sdf"), example.bend(robot)
    at = {name: robot.independent_joints.index(f"left-{name}") for name in example.MOTORS}
    q = rp.inverse_kinematics(robot, motion).q
    pose = motion.x[:, [at["pitch-op"], at["knee-op"], at["tarsus-crank-joint"]]]
    for name, wanted in (("shin-tarsus-joint", leg.tarsus), ("foot-op", leg.foot)):
        column = robot.model.joints[robot.model.getJointId(f"left-{name}")].idx_q
        given = pose[:, 1 if name == "shin-tarsus-joint" else 2]
        np.testing.assert_allclose(q[:, column], [wanted(x) for x in given], atol=1e-8)
    loaded = example.torques(robot, motion).tau
    bare = rp.distribute(rp.RneaDynamics(robot).reduce(motion)).tau
    for k, angles in enumerate(pose):  # virtual work of what the ground carries
        step = 1e-5 * np.eye(3)
        climb = [(leg.blade(*(angles + h))[2] - leg.blade(*(angles - h))[2]) / 2e-5 for h in step]
        share = [robot.actuated.index(f"left-{name}") for name in ("pitch-op", "knee-op", "tarsus-crank-joint")]
        np.testing.assert_allclose((loaded - bare)[k, share], -example.CARRIED * np.array(climb), atol=1e-5)
    assert np.abs(loaded - bare).max() > 40.0


def _standing(folder: Path) -> rp.robot.Robot:
    """Return the robot with the cranks at zero, beside the angle where parallel and crossed rod nearly meet."""
    example.cassie_sdf(folder)
    given, _, _ = example.DECLARATION.partition("  guess:")
    (folder / "cassie.yaml").write_text(
        given.replace(f"crank-joint: {example.FOLDED}", "crank-joint: 0"), encoding="utf-8"
    )
    return rp.load_robot(folder / "cassie.yaml")


def test_loops_that_stand_beside_a_rank_loss_take_no_digits_from_those_that_move(tmp_path: Path) -> None:
    """The right foot's loop stands at a margin of 3e-5 and the left knee bends: as it does where that loop is away."""
    robot, margins, tau = _standing(tmp_path), [], []
    left = [robot.actuated.index(f"left-{name}") for name in example.MOTORS]
    for right in (0.0, 0.5):
        start = right * (np.arange(robot.n) == robot.independent_joints.index("right-tarsus-crank-joint"))
        end = start - 0.5 * (np.arange(robot.n) == robot.independent_joints.index("left-knee-op"))
        motion = rp.trajectory.from_points([start, end], [0.0, 1.0], ends="rest").sample(0.2)
        along = rp.RneaDynamics(robot).along(motion)
        margins.append(along.tree.serial_margin_bound.max())
        tau.append(rp.distribute(along.reduce()).tau[:, left])
    assert margins[0] < 1e-4 < margins[1]
    np.testing.assert_allclose(*tau, rtol=0.0, atol=1e-7)


@pytest.mark.long
def test_a_search_between_samples_takes_no_longer_than_the_samples(tmp_path: Path, monkeypatch) -> None:
    """The other leg stands beside a rank loss all along, which is nothing to be carried through for positions."""
    robot = _standing(tmp_path)
    row = dict(zip(robot.independent_joints, np.eye(robot.n), strict=True))
    motion = rp.trajectory.from_points(
        [0.0 * row["left-knee-op"], -0.5 * row["left-knee-op"]], [0.0, 1.0], ends="rest"
    ).sample(0.1)
    rp.RneaDynamics(robot).reduce(motion)  # what is asked once of a robot is not counted
    calls, evaluate = [], ConstraintSystem.evaluate
    monkeypatch.setattr(ConstraintSystem, "evaluate", lambda *given: (calls.append(len(given[1])), evaluate(*given))[1])
    rp.RneaDynamics(robot).reduce(motion)
    alone = len(calls)
    result = rp.inverse_dynamics(rp.RneaDynamics(robot), motion)
    assert (result.status.value, result.instants) == ("ok", ())
    assert alone < len(calls) - alone < 1.1 * alone
