"""Plans for other programs, read back by theirs: columns by joint name, efforts that the other backend agrees with."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from parked_plans import parked_plan
from scipy.io import loadmat
from scipy.spatial.transform import Rotation

import redundancy_pin as rp
from redundancy_pin.arrays import Array
from redundancy_pin.errors import InfeasiblePlanError, InputError, OutputError
from redundancy_pin.planners.plan import Plan
from redundancy_pin.robot import Robot
from redundancy_pin.status import ResultStatus
from redundancy_pin.trajectory.csv_file import motion_columns

BASES = np.array([[0.0, 0.0], [0.5, 0.0]])  # of the 2-RPR's legs, m


@pytest.fixture(scope="module")
def plan(tmp_path_factory: pytest.TempPathFactory) -> Plan:
    """Through a singularity with the motors on, and from a file: no robot is at hand."""
    pytest.importorskip("casadi")
    path = tmp_path_factory.mktemp("plan") / "plan.npz"
    line = rp.trajectory.reference.line(speed=0.2)
    rp.plan_whole_trajectory(rp.RneaDynamics(rp.load_robot("2rpr")), line, mesh=rp.Mesh(dt=0.1)).save(path)
    return rp.load_plan(path)


@pytest.fixture(scope="module")
def corner(turning: Robot) -> Plan:
    """With efforts that jump where straights meet the arc."""
    dynamics = rp.RneaDynamics(turning)
    motion = rp.trajectory.reference.corner().sample(dt=0.02)
    return rp.plan_stepwise(dynamics, motion, limits=rp.Limits(speed=1e-3, acceleration=1e-2))  # carriers hardly move


@pytest.fixture(scope="module")
def turning() -> Robot:
    return rp.load_robot("3rrr")


def read(path: Path) -> dict[str, Array]:
    """Read a CSV file by the names of its columns, units included."""
    with path.open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    return {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}


def test_rows_at_a_rate_are_the_plan_between_its_samples(plan: Plan, tmp_path: Path) -> None:
    plan.table(400).to_csv(tmp_path / "plan.csv")
    table = read(tmp_path / "plan.csv")
    t = table["t [s]"]
    assert len(t) == np.ceil(400 * plan.t[-1]) + 1
    np.testing.assert_allclose(t[:-1], np.arange(len(t) - 1) / 400)
    assert t[-1] == plan.t[-1]

    platform, carriers = plan.platform_at(t), plan.carriers_at(t)
    np.testing.assert_allclose(np.stack([table["x [m]"], table["y [m]"]], 1), platform.x, atol=1e-12)
    for i, name in enumerate(plan.robot.carriers):
        np.testing.assert_allclose(table[f"s:{name} [m]"], carriers.s[:, i], atol=1e-9)
        np.testing.assert_allclose(table[f"sd:{name} [m/s]"], carriers.sd[:, i], atol=1e-9)
        np.testing.assert_allclose(table[f"sdd:{name} [m/s^2]"], carriers.sdd[:, i], atol=1e-8)
    # the legs by plane geometry: what slides out is their length, but for a constant
    legs = platform.x[:, None] - BASES
    lengths = np.linalg.norm(legs, axis=2)
    along = legs / lengths[:, :, None]
    rates = np.einsum("nli,ni->nl", along, platform.xd)
    across = np.einsum("ni,ni->n", platform.xd, platform.xd)[:, None] - rates**2
    accelerations = np.einsum("nli,ni->nl", along, platform.xdd) + across / lengths
    for i, name in enumerate(plan.robot.actuated):
        slid = table[f"q:{name} [m]"] - lengths[:, i]
        np.testing.assert_allclose(slid, slid[0], atol=1e-10)
        np.testing.assert_allclose(table[f"qd:{name} [m/s]"], rates[:, i], atol=1e-9)
        np.testing.assert_allclose(table[f"qdd:{name} [m/s^2]"], accelerations[:, i], atol=1e-7)


@pytest.mark.parametrize("backend", [rp.VirtualWork, rp.RneaDynamics])
def test_efforts_are_those_of_the_motion_by_either_backend(plan: Plan, backend: Any) -> None:
    """Across the singularity, where W⁻¹ f would be rounding."""
    table = plan.table(500)
    reduced = backend(rp.load_robot("2rpr")).reduce(plan.platform_at(table.t), plan.carriers_at(table.t))
    scale = np.abs(reduced.f).max()
    left = np.einsum("nij,nj->ni", reduced.W, table.effort[:, :2]) - reduced.f
    assert np.abs(left).max() < 1e-7 * scale
    np.testing.assert_allclose(table.effort[:, 2:], reduced.carrier_force, atol=1e-7 * scale)
    assert np.abs(table.effort[:, :2]).max() == pytest.approx(plan.peak_effort.max(), rel=0.05)


def test_without_a_rate_rows_are_the_samples(plan: Plan, corner: Plan, tmp_path: Path) -> None:
    for each in (plan, corner):
        each.table().to_csv(tmp_path / "plan.csv")
        table = read(tmp_path / "plan.csv")
        np.testing.assert_array_equal(table["t [s]"], each.t)
        for i, name in enumerate(each.robot.actuated):
            unit = "N" if each is plan else "N*m"
            np.testing.assert_array_equal(table[f"tau:{name} [{unit}]"], each.tau[:, i])
        for i, name in enumerate(each.robot.carriers):
            for values, unit in (("s", "m"), ("sd", "m/s"), ("sdd", "m/s^2")):
                np.testing.assert_array_equal(table[f"{values}:{name} [{unit}]"], getattr(each.carriers, values)[:, i])
    rates = np.stack([table[f"qd:{name} [rad/s]"] for name in corner.robot.actuated], axis=1)
    np.testing.assert_allclose(rates, corner.actuated_rate, atol=1e-9)
    np.testing.assert_allclose(table["rz [rad]"], corner.motion.x[:, 2], atol=1e-12)


def test_where_efforts_jump_there_are_two_rows_or_the_one_after(corner: Plan, turning: Robot) -> None:
    after = np.flatnonzero(corner.motion.jumps)
    assert len(after) == 2  # the arc begins and ends
    both = corner.table(300, two_sided=True, robot=turning)
    once = corner.table(300, robot=turning)
    assert (np.diff(once.t) > 0.0).all()
    for k in after:
        change = corner.tau[k] - corner.tau[k - 1]
        assert np.abs(change).max() > 1.0
        (i,) = np.flatnonzero((both.t[1:] == both.t[:-1]) & (np.abs(both.t[1:] - corner.t[k]) < 1e-9))
        np.testing.assert_allclose(
            both.effort[i + 1, :3] - both.effort[i, :3], change, atol=0.01 * np.abs(change).max()
        )
        np.testing.assert_array_equal(both.position[i], both.position[i + 1])
        np.testing.assert_array_equal(both.rate[i], both.rate[i + 1])
    samples = corner.table(two_sided=False, robot=turning)
    np.testing.assert_array_equal(samples.t, np.unique(corner.t))
    np.testing.assert_array_equal(samples.effort[np.searchsorted(samples.t, corner.t[after]), :3], corner.tau[after])


def test_a_row_on_a_jump_has_what_comes_after(corner: Plan, turning: Robot) -> None:
    first = int(np.flatnonzero(corner.motion.jumps)[0])
    table = corner.table(1.0 / corner.t[first], robot=turning)  # its second row is on the jump, give or take rounding
    np.testing.assert_allclose(table.effort[1, :3], corner.tau[first], atol=0.02)
    assert np.abs(table.effort[1, :3] - corner.tau[first - 1]).max() > 1.0


def test_json_holds_the_same_columns_with_their_units(plan: Plan, tmp_path: Path) -> None:
    plan.table(50).to_csv(tmp_path / "plan.csv")
    plan.table(50).to_json(tmp_path / "plan.json")
    data = json.loads((tmp_path / "plan.json").read_text(encoding="utf-8"))
    for title, values in read(tmp_path / "plan.csv").items():
        name, unit = title.removesuffix("]").split(" [")
        assert data["units"].pop(name) == unit
        np.testing.assert_array_equal(data["columns"].pop(name), values)
    assert data["units"] == data["columns"] == {}
    assert (data["robot"], data["planner"], data["status"]) == ("2rpr", "whole_trajectory", plan.status.value)
    assert data["joints"] == ["slide_1", "slide_2", "carrier_1", "carrier_2"]


def test_a_mat_file_holds_matrices_by_joint(plan: Plan, tmp_path: Path) -> None:
    plan.table(50).to_mat(tmp_path / "plan.mat")
    table, matlab = plan.table(50), loadmat(tmp_path / "plan.mat", simplify_cells=True)
    assert list(matlab["joints"]) == list(table.joints)
    for name in ("t", "position", "rate", "acceleration", "effort"):
        np.testing.assert_array_equal(matlab[name], getattr(table, name))
    assert list(matlab["coordinates"]) == ["x", "y", "xd", "yd", "xdd", "ydd"]
    for name, column in zip(matlab["coordinates"], matlab["x"].T, strict=True):
        np.testing.assert_array_equal(column, table.columns()[name][1])
    assert list(matlab["units"]["effort"]) == ["N"] * 4
    assert matlab["robot"] == "2rpr"


@pytest.mark.parametrize("suffix", [".yaml", ".json"])
def test_a_joint_trajectory_has_the_fields_of_the_message(
    corner: Plan, turning: Robot, suffix: str, tmp_path: Path
) -> None:
    path = tmp_path / f"trajectory{suffix}"
    corner.table(100, robot=turning).to_ros(path)
    text = path.read_text(encoding="utf-8")
    message = json.loads(text) if suffix == ".json" else yaml.safe_load(text)  # to YAML 1e-16 is no number
    assert set(message) == {"header", "joint_names", "points"}
    assert message["header"] == {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""}
    assert tuple(message["joint_names"]) == (*corner.robot.actuated, *corner.robot.carriers)
    points = message["points"]
    assert set(points[0]) == {"positions", "velocities", "accelerations", "effort", "time_from_start"}
    times = np.array([p["time_from_start"]["sec"] + 1e-9 * p["time_from_start"]["nanosec"] for p in points])
    assert all(0 <= p["time_from_start"]["nanosec"] < 10**9 for p in points)
    np.testing.assert_allclose(times[:-1], 0.01 * np.arange(len(times) - 1), atol=1e-9)
    assert times[-1] > 1.0  # seconds are counted too
    q, v, a = (np.array([p[key] for p in points]) for key in ("positions", "velocities", "accelerations"))
    # each is the rate of the one before: integrals of the mean rate, but for what the trapezoid misses
    dt = np.diff(times)[:, None]
    jumps = corner.t[corner.motion.jumps]
    smooth = ~((times[:-1, None] <= jumps) & (jumps <= times[1:, None])).any(axis=1)
    for values, rates in ((q, v), (v, a)):
        missed = np.diff(values, axis=0) - 0.5 * dt * (rates[1:] + rates[:-1])
        assert np.abs(missed)[smooth].max() < 0.05 * np.abs(np.diff(values, axis=0)).max()


def test_a_data_frame_has_the_columns(plan: Plan) -> None:
    frame, table = plan.table(20).to_dataframe(), plan.table(20)
    np.testing.assert_array_equal(frame.index, table.t)
    np.testing.assert_array_equal(frame["tau:slide_2"], table.effort[:, 1])
    assert frame.attrs["units"]["tau:slide_2"] == "N"


def test_samples_without_efforts_say_so_in_every_format(corner: Plan, turning: Robot, tmp_path: Path) -> None:
    tau = np.array(corner.tau)
    tau[3] = np.nan
    broken = replace(corner, tau=tau, status=ResultStatus.UNBOUNDED)
    broken.table(robot=turning).to_csv(tmp_path / "plan.csv")
    name = corner.robot.actuated[0]
    assert np.isnan(read(tmp_path / "plan.csv")[f"tau:{name} [N*m]"][3])
    broken.table(robot=turning).to_json(tmp_path / "plan.json")
    assert json.loads((tmp_path / "plan.json").read_text(encoding="utf-8"))["columns"][f"tau:{name}"][3] is None
    with pytest.raises(InputError, match="no finite efforts at t = "):
        broken.table(robot=turning).to_ros(tmp_path / "plan.yaml")
    assert not (tmp_path / "plan.yaml").exists()


def test_a_motion_without_finite_efforts_has_no_rows_between_its_samples(tmp_path: Path) -> None:
    parked = rp.VirtualWork(rp.load_robot("2rpr"))
    circle = rp.trajectory.reference.circle().sample(0.01)
    plan = parked_plan(parked, circle)
    with pytest.raises(InfeasiblePlanError, match="no finite efforts"):
        plan.table(100).to_csv(tmp_path / "plan.csv")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("rate", [0.0, -1.0, np.nan, 1e12, "fast"])
def test_rates_that_are_none_are_refused(rate: Any, plan: Plan, tmp_path: Path) -> None:
    with pytest.raises(InputError):
        plan.table(rate).to_csv(tmp_path / "plan.csv")
    assert list(tmp_path.iterdir()) == []


def test_a_message_has_the_suffix_of_its_format(corner: Plan, turning: Robot, tmp_path: Path) -> None:
    with pytest.raises(OutputError, match=r"\.yaml"):
        corner.table(robot=turning).to_ros(tmp_path / "trajectory.csv")


def test_positions_of_a_pose_come_with_a_quaternion_that_does_not_flip() -> None:
    turned = Rotation.from_rotvec(np.linspace(0.0, 3.0 * np.pi, 50)[:, None] * [0.0, 0.0, 1.0])
    x = np.tile(np.eye(4), (50, 1, 1))
    x[:, :3, :3], x[:, 0, 3] = turned.as_matrix(), np.arange(50.0)
    still = np.zeros((50, 6))
    motion = rp.PlatformMotion(np.arange(50.0), x, still, still)
    columns = motion_columns(rp.load_robot("gough"), motion)
    assert list(columns)[1:8] == ["x", "y", "z", "qx", "qy", "qz", "qw"]
    assert [unit for unit, _ in columns.values()][1:8] == ["m", "m", "m", "1", "1", "1", "1"]
    values = np.stack([values for _, values in columns.values()][1:8], axis=1)
    np.testing.assert_array_equal(values[:, :3], x[:, :3, 3])
    np.testing.assert_allclose(Rotation.from_quat(values[:, 3:]).as_matrix(), x[:, :3, :3], atol=1e-12)
    assert np.abs(np.diff(values[:, 3:], axis=0)).max() < 0.2
