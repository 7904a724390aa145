"""The columns of CSV files: every bit comes back, units are read, and what one command writes another reads."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import zoo
from command_line import call, refused
from scipy.spatial.transform import Rotation

import redundancy_pin as rp
from redundancy_pin import CarrierMotion, PlatformMotion
from redundancy_pin.errors import InputError
from redundancy_pin.kinematics.closure import ConstraintSystem
from redundancy_pin.kinematics.coordinates import coordinates, moved
from redundancy_pin.robot import Robot
from redundancy_pin.trajectory import carriers_from_csv, from_csv, from_points, reference
from redundancy_pin.trajectory.csv_file import csv_rows, motion_columns

ROUNDING = 2e-15
"""A quaternion of a rotation, and the rotation that it makes, numbers up to one: nine roundings."""

EFFORTS = 1e-6
"""Efforts along a motion that was integrated or interpolated, relative to the largest."""


def random_motion(robot: Robot, seed: int, samples: int = 20) -> tuple[PlatformMotion, CarrierMotion]:
    """Return states that have nothing to do with one another, of all sizes, negative zeros and denormals among them."""
    dice = np.random.default_rng(seed)

    def numbers(*shape: int) -> np.ndarray:
        values = dice.normal(size=shape) * 10.0 ** dice.integers(-12, 12, size=shape)
        flat = values.reshape(-1)
        flat[dice.integers(0, flat.size, 3 if flat.size else 0)] = [-0.0, 5e-324, 1.0 / 3.0][: 3 if flat.size else 0]
        return values

    x = numbers(samples, robot.n)
    if robot.platform is not None and robot.platform.is_pose:
        x = np.tile(np.eye(4), (samples, 1, 1))
        x[:, :3, 3], x[:, :3, :3] = numbers(samples, 3), Rotation.random(samples, random_state=seed).as_matrix()
    t = np.cumsum(dice.uniform(1e-6, 1.0, samples)) - 3.0
    motion = PlatformMotion(t, x, numbers(samples, robot.n), numbers(samples, robot.n), check_rates=False)
    return motion, CarrierMotion(*(numbers(samples, robot.k) for _ in range(3)), check_rates=False)


def written(path: Path, robot: Robot, motion: PlatformMotion, carriers: CarrierMotion | None = None) -> Path:
    efforts = {f"tau:{name}": ("N", np.full(len(motion), np.nan)) for name in robot.actuated}
    status = {"status": ("", np.array(["ok"] * len(motion)))}
    path.write_text(csv_rows({**efforts, **motion_columns(robot, motion, carriers), **status}), encoding="utf-8")
    return path


def rewritten(path: Path, change: dict[str, tuple[str, float]]) -> Path:
    """Return a file with other headings, and columns times a factor."""
    with path.open(encoding="utf-8", newline="") as stream:
        names, *rows = list(csv.reader(stream))
    other = path.with_name("rewritten.csv")
    with other.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow([change.get(name, (name, 1.0))[0] for name in names])
        for row in rows:
            factors = [change.get(name, (name, 1.0))[1] for name in names]
            writer.writerow([c if f == 1.0 else repr(float(c) * f) for c, f in zip(row, factors, strict=True)])
    return other


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("name", ["2rpr", "3rrr", "five_bar", "four_bar", "gough", "delta"])
def test_every_bit_comes_back(name: str, seed: int, tmp_path: Path) -> None:
    robot = zoo.robot_of(name)
    motion, carriers = random_motion(robot, seed)
    path = written(tmp_path / "m.csv", robot, motion, carriers)
    for given in (None, robot):
        read = from_csv(path, given, check_rates=False)
        for part in ("t", "xd", "xdd", *(() if motion.is_pose else ("x",))):
            assert getattr(read, part).tobytes() == getattr(motion, part).tobytes()
        if motion.is_pose:
            assert read.x[:, :3, 3].tobytes() == motion.x[:, :3, 3].tobytes()
            np.testing.assert_allclose(read.x[:, :3, :3], motion.x[:, :3, :3], rtol=0.0, atol=ROUNDING)
        moved = carriers_from_csv(path, given, check_rates=False)
        assert (moved is None) == (robot.k == 0)
        for part in ("s", "sd", "sdd") if moved else ():
            assert getattr(moved, part).tobytes() == getattr(carriers, part).tobytes()


NAMES = ["=1+1", "+a,b", '-"quoted"', "@x\ny", "a[1]", " blank ", "s:x", "\ttab", "m]"]


@pytest.mark.parametrize(("first", "second"), [(a, b) for a, b in zip(NAMES, NAMES[1:] + NAMES[:1], strict=True)])
def test_joints_of_any_name_are_columns_and_no_formulas(first: str, second: str, tmp_path: Path) -> None:
    plain = rp.load_robot("2rpr")
    model = plain.model.copy()
    for old, new in (("carrier_1", first), ("carrier_2", second)):
        model.names[model.getJointId(old)] = new
    robot = replace(plain, model=model, carriers=(first, second))
    motion, carriers = random_motion(robot, 5)
    path = written(tmp_path / "m.csv", robot, motion, carriers)
    with path.open(encoding="utf-8", newline="") as stream:
        cells = next(csv.reader(stream))
    assert {f"s:{first} [m]", f"sdd:{second} [m/s^2]"} < set(cells)
    assert not [cell for cell in cells if cell[:1] in "=+-@\t\r\n"]
    read = carriers_from_csv(path, robot, check_rates=False)
    assert read.s.tobytes() == carriers.s.tobytes()
    assert read.sdd.tobytes() == carriers.sdd.tobytes()


def test_columns_go_to_the_carriers_that_they_name(tmp_path: Path) -> None:
    robot = rp.load_robot("3rrr")
    motion, carriers = random_motion(robot, 1)
    other = replace(robot, carriers=robot.carriers[::-1])
    path = written(tmp_path / "m.csv", other, motion, carriers)
    np.testing.assert_array_equal(carriers_from_csv(path, check_rates=False).s, carriers.s)  # as they come
    np.testing.assert_array_equal(carriers_from_csv(path, robot, check_rates=False).s, carriers.s[:, ::-1])
    named = {f"{s}:carrier_2 [{u}]": (f"{s}:carrier_5", 1.0) for s, u in (("s", "m"), ("sd", "m/s"), ("sdd", "m/s^2"))}
    with pytest.raises(InputError, match=r"s:carrier_5.*3rrr has s:carrier_1, s:carrier_2, s:carrier_3"):
        from_csv(rewritten(path, named), robot, check_rates=False)
    bare = rp.load_robot("3rrr", carriers=False)
    with pytest.raises(InputError, match=r"carriers s:carrier_3.*3rrr has none.*Leave these columns out"):
        carriers_from_csv(path, bare, check_rates=False)


def test_coordinates_are_those_of_the_robot(tmp_path: Path) -> None:
    robot = rp.load_robot("3rrr")
    motion, _ = random_motion(robot, 2)
    path = written(tmp_path / "m.csv", robot, motion)
    angle = {f"rz{d} [rad{u}]": (f"phi{d} [rad{u}]", 1.0) for d, u in (("", ""), ("d", "/s"), ("dd", "/s^2"))}
    read = from_csv(rewritten(path, angle), robot, check_rates=False)
    np.testing.assert_array_equal(read.x, motion.x)
    upright = {f"rz{d} [rad{u}]": (f"z{d} [m{u}]", 1.0) for d, u in (("", ""), ("d", "/s"), ("dd", "/s^2"))}
    with pytest.raises(InputError, match=r"coordinates x, y, z; 3rrr has x, y, rz"):
        from_csv(rewritten(path, upright), robot, check_rates=False)


@pytest.mark.parametrize(
    ("heading", "unit", "factor"),
    [
        ("t [s]", "ms", 1e3), ("t [s]", "min", 1.0 / 60.0), ("x [m]", "mm", 1e3), ("y [m]", "cm", 1e2),
        ("rz [rad]", "deg", 180.0 / np.pi), ("rz [rad]", "°", 180.0 / np.pi), ("xd [m/s]", "mm/s", 1e3),
        ("yd [m/s]", "m/min", 60.0), ("rzd [rad/s]", "deg/s", 180.0 / np.pi), ("xdd [m/s^2]", "mm/s²", 1e3),
        ("ydd [m/s^2]", "m/ms^2", 1e-6), ("rzdd [rad/s^2]", "deg/s2", 180.0 / np.pi), ("x [m]", None, 1.0),
        ("s:carrier_1 [m]", "µm", 1e6), ("sd:carrier_2 [m/s]", "cm/s", 1e2), ("sdd:carrier_3 [m/s^2]", "mm/s^2", 1e3),
    ],
)  # fmt: skip
def test_units_are_converted(heading: str, unit: str | None, factor: float, tmp_path: Path) -> None:
    robot = rp.load_robot("3rrr")
    motion, carriers = random_motion(robot, 3)
    path = written(tmp_path / "m.csv", robot, motion, carriers)
    name = heading.partition(" [")[0]
    other = rewritten(path, {heading: (name if unit is None else f"{name} [{unit}]", factor)})
    read, moved = from_csv(other, robot, check_rates=False), carriers_from_csv(other, robot, check_rates=False)
    for part in ("t", "x", "xd", "xdd"):
        np.testing.assert_allclose(getattr(read, part), getattr(motion, part), rtol=1e-15)
    for part in ("s", "sd", "sdd"):
        np.testing.assert_allclose(getattr(moved, part), getattr(carriers, part), rtol=1e-15)


@pytest.mark.parametrize(
    ("heading", "other", "says"),
    [
        (
            "x [m]",
            "x [inch]",
            r"column 'x': 'inch' is no unit that is known; .* Give one of m, mm, cm, .*no unit for SI",
        ),
        ("x [m]", "x [rad]", r"column 'x': 'rad' is no unit of length\. Give one of m, mm"),
        ("rz [rad]", "rz [mm]", r"column 'rz': 'mm' is no unit of angle\. Give one of rad"),
        ("xd [m/s]", "xd [m]", r"column 'xd': 'm' is no unit of length by time\. Give one of m/s, mm/s"),
        ("xd [m/s]", "xd [inch/s]", r"column 'xd': 'inch/s' is no unit that is known; .* Give one of m/s, mm/s"),
        ("xd [m/s]", "xd [m/h]", r"column 'xd': 'm/h' is no unit that is known; .* Give one of m/s, mm/s"),
        ("xdd [m/s^2]", "xdd [m/s]", r"'m/s' is no unit of length by time squared\. Give one of m/s\^2"),
        ("t [s]", "t [m]", r"column 't': 'm' is no unit of time\. Give one of s, ms"),
        (
            "s:carrier_1 [m]",
            "s:carrier_1 [deg]",
            r"'s:carrier_1': its unit is one of angle.*is one of length\. Give m, mm",
        ),
        ("sd:carrier_1 [m/s]", "sd:carrier_1 [deg/s]", r"'sd:carrier_1': its unit is one of angle"),
        ("sd:carrier_1 [m/s]", "sd:carrier_1 [s]", r"'sd:carrier_1': 's' is no unit of length or angle by time"),
    ],
)
def test_units_of_another_quantity_are_refused(heading: str, other: str, says: str, tmp_path: Path) -> None:
    robot = rp.load_robot("3rrr")
    path = written(tmp_path / "m.csv", robot, *random_motion(robot, 4))
    for read in (from_csv, carriers_from_csv):
        with pytest.raises(InputError, match=says):
            read(rewritten(path, {heading: (other, 1.0)}), robot, check_rates=False)


def test_points_have_units_too(tmp_path: Path) -> None:
    (tmp_path / "mm.csv").write_text("t [ms],x [mm],y [cm],rz [deg]\n0,100,20,0\n500,150,25,45\n1500,200,20,90\n")
    (tmp_path / "si.csv").write_text(
        f"t,x,y,rz\n0,0.1,0.2,0\n0.5,0.15,0.25,{np.pi / 4!r}\n1.5,0.2,0.2,{np.pi / 2!r}\n", encoding="utf-8"
    )
    one, other = (from_points(tmp_path / name).sample(0.1) for name in ("mm.csv", "si.csv"))
    np.testing.assert_allclose(one.x, other.x, rtol=1e-14)
    np.testing.assert_allclose(one.t, other.t, rtol=1e-14)
    (tmp_path / "slow.csv").write_text("x [mm],y [mm],speed [mm/s]\n100,200,0\n150,250,100\n200,200,0\n")
    (tmp_path / "same.csv").write_text("x,y,speed\n0.1,0.2,0\n0.15,0.25,0.1\n0.2,0.2,0\n")
    one, other = (from_points(tmp_path / name) for name in ("slow.csv", "same.csv"))
    assert one.duration == pytest.approx(other.duration, rel=1e-14)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("t,x,y,xd,xdd\n0,0,0,0,0\n", "has no column 'yd'"),
        ("t,x,y,xd,yd,xdd\n0,0,0,0,0,0\n", "has no column 'xdd'|has no column 'ydd'"),
        ("t,x,xd,yd,xdd,ydd\n0,0,0,0,0,0\n", "has no column 'y'"),
        ("x,y,xd,yd,xdd,ydd\n0,0,0,0,0,0\n", "has no column 't'"),
        ("t,time,x,xd,xdd\n0,0,0,0,0\n", "'t' more than once: 't', 'time'"),
        ("t,x,x [mm],xd,xdd\n0,0,0,0,0\n", "'x' more than once"),
        ("t,x,y\n0,0,0\n", r"positions \(x, y\) and no rates.*add xd, yd, xdd, ydd"),
        ("t,x,s:a,sd:a,sdd:a\n0,0,0,0,0\n", "has no column 'xd'"),
        ("t,x,xd,xdd,s:a,sd:a\n0,0,0,0,0,0\n", "has no column 'sdd:a'"),
        ("t,x,xd,xdd,sd:a,sdd:a\n0,0,0,0,0,0\n", "has no column 's:a'"),
        ("t,x0,y,xd0,yd,xdd0,ydd\n0,0,0,0,0,0,0\n", "names columns in two ways: x0 and y"),
        ("t,x,y,qx,qy,qz,qw,xd\n0,0,0,0,0,0,1,0\n", "has no column 'z'"),
    ],
)
def test_motions_that_lack_a_column(text: str, says: str, tmp_path: Path) -> None:
    (tmp_path / "m.csv").write_text(text)
    with pytest.raises(InputError, match=says):
        from_csv(tmp_path / "m.csv")


# --- commands ---


def efforts_of(path: Path, robot: str) -> np.ndarray:
    with path.open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    names = [name for name in rows[0] if name.startswith("tau:")]
    assert [name.partition(" [")[0] for name in names[: rp.load_robot(robot).m]] == [
        f"tau:{joint}" for joint in rp.load_robot(robot).actuated
    ]
    return np.array([[float(row[name]) for name in names] for row in rows])


def along(tmp_path: Path, robot: str, motion: Path, *more: str) -> np.ndarray:
    out = tmp_path / "efforts.csv"
    done = call("inverse-dynamics", "--robot", robot, "--motion", motion, "--out", out, *more)
    assert done.exit_code == 0, done.stderr
    assert "samples of" in done.stdout
    return efforts_of(out, robot)


@pytest.mark.parametrize("name", ["3rrr", "gough", "four_bar"])
def test_what_inverse_dynamics_writes_it_reads(name: str, tmp_path: Path) -> None:
    robot = rp.load_robot(name)
    q = np.array(robot.q_reference)[None]
    start = coordinates(robot, ConstraintSystem(robot).evaluate(q))
    wave = np.sin(np.linspace(0.0, 1.0, 4))[:, None] * 0.02
    points = moved(robot, np.repeat(start, 4, axis=0), np.repeat(wave, robot.n, axis=1))
    motion = from_points(points, [0.0, 0.3, 0.6, 1.0]).sample(0.02)
    first = tmp_path / "first.csv"
    expected = along(tmp_path, name, written(tmp_path / "m.csv", robot, motion))
    (tmp_path / "efforts.csv").rename(first)
    tau = rp.inverse_dynamics(rp.RneaDynamics(robot), motion).efforts.tau
    scale = np.abs(tau).max()
    np.testing.assert_allclose(expected[:, : robot.m], tau, rtol=0.0, atol=1e-9 * scale)
    np.testing.assert_allclose(along(tmp_path, name, first), expected, rtol=0.0, atol=1e-9 * scale)


def test_exported_plans_and_simulations_are_motions(tmp_path: Path) -> None:
    """Carriers that move, a turning platform, jumps of the acceleration: efforts are those that the files say."""
    robot = rp.load_robot("3rrr", working_mode=(1, 1, 1))
    motion = reference.corner().sample(0.02)
    plan = rp.plan_stepwise(rp.RneaDynamics(robot), motion)
    plan.save(tmp_path / "plan.npz")
    for name, flags in (("samples.csv", ()), ("rate.csv", ("--rate", "100", "--two-sided"))):
        done = call("export", tmp_path / "plan.npz", "--to", tmp_path / name, *flags)
        assert done.exit_code == 0, done.stderr
    run = ["simulate", "--plan", tmp_path / "plan.npz", "--duration", "0.1", "--dt", "0.01", "--stop-at", "never"]
    done = call(*run, "--out", tmp_path / "run.csv")
    assert done.exit_code == 0, done.stderr
    for name in ("samples.csv", "rate.csv", "run.csv"):
        own = efforts_of(tmp_path / name, "3rrr")
        moved = carriers_from_csv(tmp_path / name, robot)
        assert np.abs(moved.s).max() > 1e-3  # they move
        np.testing.assert_allclose(along(tmp_path, "3rrr", tmp_path / name, "--working-mode", "+++"), own, rtol=0.0,
                                   atol=EFFORTS * np.abs(own).max())  # fmt: skip


@pytest.mark.long_for("show", "simulate")
@pytest.mark.parametrize("command", ["singularities", "show", "simulate", "plan"])
def test_every_command_reads_the_file(command: str, tmp_path: Path) -> None:
    robot = rp.load_robot("3rrr")
    motion = reference.corner().sample(0.005)
    path = written(tmp_path / "m.csv", robot, motion)
    millimetres = {f"x{d} [m{u}]": (f"x{d} [mm{u}]", 1e3) for d, u in (("", ""), ("d", "/s"), ("dd", "/s^2"))}
    more = {
        "show": ["--html", tmp_path / "a.html"], "simulate": ["--stop-at", "never", "--duration", "0.05"],
        "plan": ["stepwise", "--lam", "0"], "singularities": [],
    }  # fmt: skip
    arguments = [command, *more[command], "--robot", "3rrr", "--working-mode", "+++"]
    answers = []
    for file in (path, rewritten(path, millimetres)):
        done = call(*arguments, "--motion", file, "--json")
        assert done.exit_code in (0, 3), done.stderr
        answers.append(json.loads(done.stdout))
    if command != "show":
        assert answers[0].pop("motion") == f"samples of {path}"
    assert "m.csv" not in json.dumps(answers)
    upright = {f"y{d} [m{u}]": (f"z{d} [m{u}]", 1.0) for d, u in (("", ""), ("d", "/s"), ("dd", "/s^2"))}
    other = rewritten(path, upright)
    assert "coordinates x, z, rz; 3rrr has x, y, rz" in refused(*arguments, "--motion", other)
    wrong = rewritten(path, {"x [m]": ("x [furlong]", 1.0)})
    assert "'furlong' is no unit that is known" in refused(*arguments, "--motion", wrong)
