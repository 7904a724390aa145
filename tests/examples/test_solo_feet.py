"""The example with Solo, against motion and torques worked out without this package.

Positions come from yourdfpy's forward kinematics and Newton's method, rates and accelerations from differences of them;
the torques from the plain open-tree ``pin.rnea`` and a KKT system, the energy from yourdfpy's masses alone.
"""

from __future__ import annotations

import io
import sys
from importlib.metadata import PackageNotFoundError
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import yourdfpy
from doc_blocks import example_script

import redundancy_pin as rp
from redundancy_pin.robot import Robot

SCRIPT = Path(__file__).resolve().parents[2] / "docs" / "examples" / "solo_feet.py"

TIMES = (0.1, 0.2, 0.37)
STEP = 1e-3
"""Of the differences, s: their error is STEP² times a ratio of derivatives of about 100/s², that is 1e-4."""

CLOSED = 1e-14
"""m; rounding of forward kinematics of links of 0.16 m. Divided by STEP² it is 1e-8 rad/s²."""

DIFFERENCED = 5e-4
"""Of torques of up to 0.1 N·m and powers of up to 0.1 W, relative to the largest."""


example = example_script(SCRIPT)
try:
    URDF = example.solo_urdf().read_text(encoding="utf-8")
except PackageNotFoundError:
    pytest.skip("example-robot-data is not installed: pip install 'redundancy_pin[examples]'", allow_module_level=True)


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return example.load(tmp_path_factory.mktemp("solo"))


class Reader:
    """Solo through yourdfpy: no Pinocchio, no declaration."""

    def __init__(self) -> None:
        self.urdf = yourdfpy.URDF.load(io.BytesIO(URDF.encode()), load_meshes=False)
        self.names = list(self.urdf.actuated_joint_names)
        self.hips = [self.names.index(name) for name in ("FL_HFE", "FR_HFE", "HL_HFE", "HR_HFE")]
        self.knees = [self.names.index(name) for name in ("FL_KFE", "FR_KFE", "HL_KFE", "HR_KFE")]

    def transform(self, q: np.ndarray, link: str) -> np.ndarray:
        self.urdf.update_cfg(q)
        return self.urdf.get_transform(link)

    def gaps(self, q: np.ndarray) -> np.ndarray:
        """Return x and z of the distance between the feet of either side, m."""
        self.urdf.update_cfg(q)
        at = {foot: self.urdf.get_transform(foot)[:3, 3] for foot in ("FL_FOOT", "HL_FOOT", "FR_FOOT", "HR_FOOT")}
        return np.concatenate([(at["FL_FOOT"] - at["HL_FOOT"])[[0, 2]], (at["FR_FOOT"] - at["HR_FOOT"])[[0, 2]]])

    def closed(self, t: float) -> np.ndarray:
        """Return the joint angles at a time, feet below the knees."""
        q = np.zeros(len(self.names))
        q[self.hips] = example.swing().evaluate(t).x

        q[self.knees] = 0.4, 0.4, -0.4, -0.4
        for _ in range(8):  # Newton
            q[self.knees] -= np.linalg.solve(self.jacobian(q)[:, self.knees], self.gaps(q))
        assert np.abs(self.gaps(q)).max() < CLOSED
        return q

    def motion(self, t: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return q, q̇, q̈ by differences."""
        before, q, after = (self.closed(t + shift) for shift in (-STEP, 0.0, STEP))
        return q, (after - before) / (2.0 * STEP), (after - 2.0 * q + before) / STEP**2

    def jacobian(self, q: np.ndarray) -> np.ndarray:
        """Return (4, 8) the derivative of the gaps."""
        step = 1e-6 * np.eye(len(q))
        return np.array([(self.gaps(q + d) - self.gaps(q - d)) / 2e-6 for d in step]).T

    def energy(self, t: float) -> float:
        """Return kinetic plus potential energy, J, from masses, inertias and differences of transforms."""
        total = 0.0
        states = [self.closed(t + shift) for shift in (-STEP, 0.0, STEP)]
        for name, link in self.urdf.link_map.items():
            if link.inertial is None or name == "base_link":
                continue
            inside = link.inertial.origin if link.inertial.origin is not None else np.eye(4)
            before, here, after = (self.transform(q, name) @ inside for q in states)
            velocity = (after - before)[:3, 3] / (2.0 * STEP)
            spin = (after - before)[:3, :3] @ here[:3, :3].T / (2.0 * STEP)
            omega = 0.5 * np.array([spin[2, 1] - spin[1, 2], spin[0, 2] - spin[2, 0], spin[1, 0] - spin[0, 1]])
            inertia = here[:3, :3] @ link.inertial.inertia @ here[:3, :3].T
            mass = link.inertial.mass
            total += 0.5 * mass * velocity @ velocity + 0.5 * omega @ inertia @ omega + mass * 9.81 * here[2, 3]
        return float(total)


@pytest.fixture(scope="module")
def reader() -> Reader:
    return Reader()


def _torques(robot: Robot, t: float) -> np.ndarray:
    motion = example.swing().sample_at([t])
    efforts = rp.distribute(rp.RneaDynamics(robot).reduce(motion))
    assert efforts.status_labels[0] == "ok"
    return efforts.tau[0]


def test_the_ties_leave_four_freedoms_to_eight_motors(robot: Robot) -> None:
    assert (robot.n, robot.m, robot.model.nv) == (4, 8, 8)


@pytest.mark.long_for("0.1", "0.37")
@pytest.mark.parametrize("t", TIMES)
def test_torques_are_the_least_that_solve_the_equations_of_motion(robot: Robot, reader: Reader, t: float) -> None:
    """min ‖τ‖² subject to τ + Jᵀ λ = rnea(q, q̇, q̈): its KKT system in τ, λ and the multipliers of the constraint."""
    q, v, a = reader.motion(t)
    model = pin.buildModelFromXML(URDF)
    order = [model.joints[model.getJointId(name)].idx_v for name in reader.names]
    needed = pin.rnea(model, model.createData(), *(_placed(values, order) for values in (q, v, a)))[order]
    J, eye = reader.jacobian(q), np.eye(8)
    kkt = np.block([
        [eye, np.zeros((8, 4)), eye],
        [np.zeros((4, 8)), np.zeros((4, 4)), J],
        [eye, J.T, np.zeros((8, 8))],
    ])  # fmt: skip
    tau = np.linalg.solve(kkt, np.concatenate([np.zeros(12), needed]))[:8]
    wanted = np.array([tau[reader.names.index(name)] for name in robot.actuated])
    np.testing.assert_allclose(_torques(robot, t), wanted, atol=DIFFERENCED * np.abs(wanted).max())
    # the ties carry something: without them the torques would differ
    assert np.abs(needed - tau).max() > 0.1 * np.abs(wanted).max()


def _placed(values: np.ndarray, order: list[int]) -> np.ndarray:
    placed = np.zeros(len(values))
    placed[order] = values
    return placed


@pytest.mark.long
@pytest.mark.parametrize("t", TIMES)
def test_the_motors_supply_the_change_of_energy(robot: Robot, reader: Reader, t: float) -> None:
    _, v, _ = reader.motion(t)
    rates = np.array([v[reader.names.index(name)] for name in robot.actuated])
    gained = (reader.energy(t + STEP) - reader.energy(t - STEP)) / (2.0 * STEP)
    supplied = _torques(robot, t) * rates
    np.testing.assert_allclose(supplied.sum(), gained, atol=DIFFERENCED * np.abs(supplied).sum())


@pytest.mark.long
def test_every_mesh_of_the_urdf_is_drawn(robot: Robot) -> None:
    """The folder it was declared in is gone; its meshes are in a package of example-robot-data."""
    scene = rp.show(robot, example.swing().sample(dt=0.05)).scene
    meshes = [solid for solid in scene.solids if solid.shape == "mesh"]
    visuals = [visual for link in yourdfpy.URDF.load(io.BytesIO(URDF.encode()), load_meshes=False).robot.links
               for visual in link.visuals]  # fmt: skip
    assert len(meshes) == len(visuals) == 13


@pytest.mark.long
def test_the_script_runs_as_the_documentation_says(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    page = tmp_path / "solo.html"
    monkeypatch.setattr(sys, "argv", ["solo_feet.py", "--html", str(page)])
    example.main()
    printed = capsys.readouterr().out
    assert printed.count("N·m") == 8
    assert "smallest margin" in printed
    assert page.stat().st_size > 5e5
