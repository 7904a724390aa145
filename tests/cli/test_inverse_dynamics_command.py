"""``redundancy-pin inverse-dynamics``: the same numbers as the Python API, and every mistake in one line."""

from __future__ import annotations

import csv
import json
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from command_line import call, refused, write_motion
from scipy.optimize import linprog
from scipy.spatial.transform import Rotation

from redundancy_pin import PlatformMotion, load_robot
from redundancy_pin.dynamics.compiled import CompiledDynamics
from redundancy_pin.dynamics.distribution import distribute
from redundancy_pin.dynamics.rnea import RneaDynamics
from redundancy_pin.dynamics.virtual_work import VirtualWork
from redundancy_pin.trajectory import carriers_from_csv, from_csv, reference


def _columns(path: Path) -> dict[str, np.ndarray]:
    """Return the columns of a file by their names, without units."""
    with path.open(newline="", encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    return {
        name.partition(" [")[0]: np.array([row[name] if name == "status" else float(row[name]) for row in rows])
        for name in rows[0]
    }


def _efforts(columns: dict[str, np.ndarray], robot: str) -> np.ndarray:
    return np.stack([columns[f"tau:{name}"] for name in load_robot(robot).actuated], axis=1)


@pytest.fixture
def corner(tmp_path: Path) -> Path:
    return write_motion(tmp_path / "motion.csv", reference.corner(), 0.05, carriers=3)


@pytest.mark.long_for("compiled-CompiledDynamics")
@pytest.mark.parametrize(
    ("name", "backend"), [("rnea", RneaDynamics), ("virtual-work", VirtualWork), ("compiled", CompiledDynamics)]
)
def test_output_is_that_of_the_python_api(corner: Path, tmp_path: Path, name: str, backend: type) -> None:
    out = tmp_path / "out.csv"
    result = call(
        "inverse-dynamics", "--robot", "3rrr", "--set", "carrier_mass=2.0", "--mode", "+++",
        "--gravity", "0,-9.81,0", "--backend", name, "--motion", str(corner), "--out", str(out),
    )  # fmt: skip
    assert result.exit_code == 0
    robot = load_robot("3rrr", carrier_mass=2.0, working_mode=(1, 1, 1), gravity=(0.0, -9.81, 0.0))
    reduced = backend(robot).reduce(from_csv(corner), carriers_from_csv(corner))
    expected = distribute(reduced)
    columns = _columns(out)
    with out.open(encoding="utf-8") as stream:
        assert next(stream).strip().split(",") == [
            "t [s]", "x [m]", "y [m]", "rz [rad]", "xd [m/s]", "yd [m/s]", "rzd [rad/s]",
            "xdd [m/s^2]", "ydd [m/s^2]", "rzdd [rad/s^2]",
            *(f"{name}:carrier_{k} [{unit}]" for name, unit in (("s", "m"), ("sd", "m/s"), ("sdd", "m/s^2"))
              for k in (1, 2, 3)),
            *(f"tau:base_{k} [N*m]" for k in (1, 2, 3)), *(f"tau:carrier_{k} [N]" for k in (1, 2, 3)),
            "status", "margin", "residual [N]",
        ]  # fmt: skip
    np.testing.assert_array_equal(_efforts(columns, "3rrr"), expected.tau)
    forces = np.stack([columns[f"tau:carrier_{i}"] for i in (1, 2, 3)], axis=1)
    np.testing.assert_array_equal(forces, reduced.carrier_force)
    np.testing.assert_array_equal(columns["margin"], expected.margin)
    assert set(columns["status"]) == {"ok"}


def test_json_is_pure_and_tells_what_was_written(corner: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.csv"
    result = call("inverse-dynamics", "--robot", "3rrr", "--motion", str(corner), "--out", str(out), "--json")
    facts = json.loads(result.stdout)
    assert result.stderr == ""
    columns = _columns(out)
    assert facts["samples"] == len(columns["t"])
    assert facts["statuses"] == {"ok": len(columns["t"])}
    assert facts["largest_tau"] == np.abs(_efforts(columns, "3rrr")).max(axis=0).tolist()


def test_carrier_columns_may_be_left_out(tmp_path: Path) -> None:
    motion = write_motion(tmp_path / "motion.csv", reference.corner(), 0.1)
    out = tmp_path / "out.csv"
    result = call("inverse-dynamics", "--robot", "3rrr", "--motion", motion, "--out", out)
    assert result.exit_code == 0
    assert "largest |tau| [N·m]" in result.stdout
    assert "largest |carrier force| [N]" in result.stdout
    parked = distribute(CompiledDynamics(load_robot("3rrr")).reduce(from_csv(motion)))
    np.testing.assert_array_equal(_columns(out)["tau:base_3"], parked.tau[:, 2])


def test_payload_wrench_squeeze_and_bounds(tmp_path: Path) -> None:
    """Two arms hold a bar at rest: what it weighs more is a force on it, and a squeeze does no work."""
    motion = tmp_path / "motion.csv"
    names = ["t", *(f"x{k}" for k in range(7)), *(f"xd{k}" for k in range(6)), *(f"xdd{k}" for k in range(6))]
    turned = Rotation.from_rotvec([0.3, 0.0, 0.1])  # axes of the bar are not those of the world
    rows = [[t, 0.511, 0.109, 0.2375, *turned.as_quat(), *np.zeros(12)] for t in (0.0, 1.0)]
    motion.write_text("\n".join(",".join(map(str, row)) for row in [names, *rows]))

    def efforts(*options: str, code: int = 0) -> dict[str, np.ndarray]:
        out = tmp_path / "out.csv"
        arguments = ("inverse-dynamics", "--robot", "two_arms", "--motion", str(motion), "--out", str(out), *options)
        assert call(*arguments).exit_code == code
        columns = _columns(out)
        return {"tau": _efforts(columns, "two_arms"), "status": columns["status"]}

    free = efforts()["tau"]
    carrying = efforts("--payload", "bar=2,0.1,0,0")["tau"]
    force, lever = np.array([0.0, 0.0, -2.0 * 9.81]), turned.apply([0.1, 0.0, 0.0])
    wrench = ",".join(map(str, [*force, *np.cross(lever, force)]))
    np.testing.assert_allclose(carrying, efforts("--wrench", f"bar={wrench}")["tau"], atol=1e-9)
    central = efforts("--payload", "bar=1.5", "--payload", "bar=0.5")["tau"]
    np.testing.assert_allclose(central, efforts("--wrench", "bar=0,0,-19.62")["tau"], atol=1e-9)
    assert min(np.abs(one - other).max() for one, other in combinations((free, carrying, central), 2)) > 1.0
    reduced = RneaDynamics(load_robot("two_arms")).reduce(from_csv(motion))
    W = reduced.W
    squeezed = efforts("--preferred", "0,0,5,0,0,0,0,0,-5,0,0,0")["tau"]
    np.testing.assert_allclose(np.einsum("Nij,Nj->Ni", W, squeezed - free), 0.0, atol=1e-9)
    assert np.abs(squeezed - free).max() > 1.0
    preloaded = efforts("--min-effort", "0.1" + 11 * ",-40", "--max-effort", "40")["tau"]
    assert preloaded[:, 0].min() >= 0.1 - 1e-9
    np.testing.assert_allclose(np.einsum("Nij,Nj->Ni", W, preloaded - free), 0.0, atol=1e-6)  # of a QP
    # the least bound within which efforts hold the bar, by a linear programme: those of least norm need a little more
    within = np.vstack([np.hstack([sign * np.eye(12), -np.ones((12, 1))]) for sign in (1.0, -1.0)])
    held = {"A_eq": np.hstack([reduced.W[0], np.zeros((6, 1))]), "b_eq": reduced.f[0]}
    least = linprog([*np.zeros(12), 1.0], within, np.zeros(24), **held, bounds=(None, None)).fun
    assert np.abs(free).max() > least * (1.0 + 2e-4)
    assert np.abs(efforts("--max-effort", f"{least * (1.0 + 1e-4)}")["tau"]).max() <= least * (1.0 + 1.01e-4)
    assert set(efforts("--max-effort", f"{least * (1.0 - 1e-4)}", code=3)["status"]) == {"bound_infeasible"}


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (("--payload", "end_effector"), "LINK=MASS[,X,Y,Z]"),
        (("--payload", "end_effector=1,2"), "LINK=MASS[,X,Y,Z]"),
        (("--wrench", "end_effector=1,2,x"), "LINK=FX,FY,FZ[,MX,MY,MZ]"),
        (("--payload", "end_efector=1"), "Did you mean 'end_effector'?"),
        (("--min-effort", "3", "--max-effort", "1"), "--min-effort is above"),
        (("--max-effort", "-1"), "--max-effort is -1"),
        (("--max-effort", "nan"), "--max-effort has"),
        (("--max-effort", "1,2,3"), "--max-effort has shape"),
        (("--preferred", "1,2,3"), "--preferred has shape (3,)"),
    ],
)
def test_loads_and_bounds_that_make_no_sense(options: tuple[str, ...], says: str, tmp_path: Path) -> None:
    motion = write_motion(tmp_path / "motion.csv", reference.circle(), 0.5)
    assert says in refused(
        "inverse-dynamics", "--robot", "2rpr", "--motion", str(motion), "--out", str(tmp_path / "o.csv"), *options
    )


def test_spatial_poses_are_position_and_quaternion(tmp_path: Path) -> None:
    turn = Rotation.from_rotvec([0.1, -0.05, 0.2])
    xyz, quaternion = [0.02, -0.01, 0.62], turn.as_quat()
    twist, rate = [0.1, 0.0, -0.1, 0.2, 0.3, -0.1], [1.0, 0.5, -0.5, 0.1, -0.2, 0.3]
    names = ["t"] + [f"x{i}" for i in range(7)] + [f"xd{i}" for i in range(6)] + [f"xdd{i}" for i in range(6)]
    row = [0.0, *xyz, *quaternion, *twist, *rate]
    motion, out = tmp_path / "pose.csv", tmp_path / "out.csv"
    motion.write_text(",".join(names) + "\n" + ",".join(repr(float(value)) for value in row) + "\n")
    assert call("inverse-dynamics", "--robot", "gough", "--motion", motion, "--out", out).exit_code == 0
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn.as_matrix(), xyz
    expected = distribute(RneaDynamics(load_robot("gough")).reduce(PlatformMotion([0.0], [pose], [twist], [rate])))
    columns = _columns(out)
    # the quaternion of the file is read back to a matrix: rounding of a rotation
    np.testing.assert_allclose(_efforts(columns, "gough")[0], expected.tau[0], rtol=1e-12)


def test_unreachable_samples_are_marked_on_request(tmp_path: Path) -> None:
    motion = tmp_path / "far.csv"
    motion.write_text("t,x0,x1,xd0,xd1,xdd0,xdd1\n0,0.25,0.7,0,0,0,0\n1,5.0,0,0,0,0,0\n2,0.3,0.7,0,0,0,0\n")
    out = tmp_path / "out.csv"
    arguments = ("inverse-dynamics", "--robot", "five_bar", "--motion", motion, "--out", out)
    assert "reach" in refused(*arguments)
    assert "Keep the motion inside the workspace, or write --unreachable mark." in refused(*arguments)
    assert call(*arguments, "--unreachable", "mark").exit_code == 3  # a sample without efforts
    columns = _columns(out)
    assert list(columns["status"]) == ["ok", "unreachable", "ok"]
    assert np.isnan(columns["tau:base_1"][1])
    assert np.isfinite(columns["tau:base_1"][[0, 2]]).all()


def test_singular_sample_has_a_status_and_no_effort(tmp_path: Path) -> None:
    """On the base line of the 2-RPR, moving across it, the carriers' inertia needs a force that no leg gives."""
    motion, out = tmp_path / "line.csv", tmp_path / "out.csv"
    motion.write_text("t,x0,x1,xd0,xd1,xdd0,xdd1\n0,0.2,0,0.3,-1,0,0\n")
    result = call("inverse-dynamics", "--robot", "2rpr", "--motion", motion, "--out", out)
    assert result.exit_code == 3
    columns = _columns(out)
    assert columns["status"][0] == "singular_inconsistent"
    assert np.isnan(columns["tau:slide_1"][0])
    assert "no finite main efforts at 1 of 1 samples, first at t = 0 s (singular_inconsistent)" in result.stderr
    # theta_dd = -2 d_dot theta_dot / d for zero acceleration; only L² theta_dd acts, and its force on the platform is
    # n h / d (Parsa 2014, eq. 2.17 collapsed); both legs push along y
    expected = 0.0
    for d, d_rate, n_rate in ((0.2, 0.3, -1.0), (0.3, -0.3, 1.0)):
        theta_rate = n_rate / d
        h = 0.1**2 * (-2.0 * d_rate * theta_rate / d)
        expected += h / d * (1.0 if n_rate < 0 else -1.0)
    assert columns["residual"][0] == pytest.approx(abs(expected), rel=1e-12)


BAD = {
    "missing file": (["--motion", "nowhere.csv"], "nowhere.csv"),
    "unknown robot": (["--robot", "4rrr"], "4rrr"),
    "unknown parameter": (["--set", "carrier_mas=2"], "carrier_mass"),
    "not a setting": (["--set", "carrier_mass"], "NAME=VALUE"),
    "parameter not finite": (["--set", "carrier_mass=inf"], "finite"),
    "gravity as a setting": (["--set", "gravity=1"], "--gravity"),
    "mode of letters": (["--mode", "abc"], "--mode"),
    "mode too short": (["--mode", "++"], "--mode is ++, but the robot has 3 legs"),
    "gravity of two": (["--gravity", "0,-9.81"], "three numbers"),
    "unknown backend": (["--backend", "lagrange"], "lagrange"),
    "unknown option": (["--bakend", "rnea"], "--bakend"),
    "no such folder": (["--out", "nowhere/out.csv"], "nowhere"),
    "efforts into this folder": (["--out", "."], "--out . does not end in .csv. Write --out result.csv."),
    "efforts into the root": (["--out", "/"], "--out / does not end in .csv. Write --out /result.csv."),
    "efforts into the folder above": (["--out", ".."], "--out .. does not end in .csv. Write --out ../result.csv."),
    "efforts of another kind": (["--out", "out.txt"], "--out out.txt does not end in .csv. Write --out out.csv."),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_one_line_and_nothing_is_written(
    case: str, corner: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    extra, says = BAD[case]
    before = sorted(tmp_path.iterdir())
    base = ["--robot", "3rrr", "--motion", str(corner), "--out", "out.csv"]
    assert says in refused("inverse-dynamics", *base, *extra)
    assert sorted(tmp_path.iterdir()) == before


def test_motion_of_another_robot_is_refused(tmp_path: Path) -> None:
    motion = write_motion(tmp_path / "motion.csv", reference.corner(), 0.1)
    assert "moves in 2 (x, y)" in refused(
        "inverse-dynamics", "--robot", "2rpr", "--motion", motion, "--out", tmp_path / "o.csv"
    )


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("t,x0,x1,xd0\n0,1,1,0\n", "xd1"),
        ("t,x0,x1,xd0,xd1,xdd0,xdd1\n0,1,one,0,0,0,0\n", "one"),
        ("t,x0,x1,xd0,xd1,xdd0,xdd1\n0,1,nan,0,0,0,0\n", "nan"),
        ("t,x0,x1,xd0,xd1,xdd0,xdd1\n1,0.2,0.3,0,0,0,0\n0,0.2,0.3,0,0,0,0\n", "increase"),
        ("t,x0,x1,xd0,xd1,xdd0,xdd1,s0,s1,sd0,sd1,sdd0,sdd1\n0,0.2,0.3,0,0,0,0,0.5,0,0,0,0,0\n", "track"),
        ("", "rows"),
    ],
)
def test_bad_motion_is_refused(text: str, says: str, tmp_path: Path) -> None:
    motion, out = tmp_path / "motion.csv", tmp_path / "out.csv"
    motion.write_text(text)
    assert says in refused("inverse-dynamics", "--robot", "2rpr", "--motion", motion, "--out", out)
    assert not out.exists()


def test_the_motion_is_not_overwritten(corner: Path) -> None:
    before = corner.read_bytes()
    assert "--out" in refused("inverse-dynamics", "--robot", "3rrr", "--motion", corner, "--out", corner)
    assert corner.read_bytes() == before


def test_virtual_work_of_a_robot_without_closed_form_is_refused(tmp_path: Path) -> None:
    motion = tmp_path / "motion.csv"
    motion.write_text("t,x0,x1,xd0,xd1,xdd0,xdd1\n0,0.5,1,0,0,0,0\n")
    assert "closed form" in refused(
        "inverse-dynamics",
        "--robot",
        "five_bar",
        "--backend",
        "virtual-work",
        "--motion",
        motion,
        "--out",
        tmp_path / "o.csv",
    )
