"""``--trajectory FILE``: points of one's own wherever a motion goes in."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from command_line import call, refused

import redundancy_pin as rp
from redundancy_pin.cli.map import problem_of
from redundancy_pin.cli.plan_problem import read_problem
from redundancy_pin.trajectory import from_points

WAY = np.array([[0.15, 0.3], [0.2, 0.1], [0.22, -0.1], [0.25, -0.3]])  # through the singular line y = 0 of the 2-RPR
TIMES = np.array([0.0, 0.6, 1.1, 1.8])


@pytest.fixture(autouse=True)
def files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for name, columns in (("timed.csv", np.column_stack([TIMES, WAY])), ("way.csv", WAY)):
        names = "t,x,y" if columns.shape[1] == 3 else "x,y"
        Path(name).write_text("\n".join([names, *(",".join(map(repr, row)) for row in columns.tolist())]) + "\n")
    rates = "t,x,y,xd,yd,xdd,ydd\n" + "".join(f"{t!r},{0.2 + t!r},0.3,1,0,0,0\n" for t in (0.0, 0.05, 0.1))
    Path("rates.csv").write_text(rates)
    Path("way.json").write_text(json.dumps({"points": WAY.tolist(), "t": TIMES.tolist()}))


@pytest.mark.long_for("flags1-arguments1", "flags3-arguments3", "flags0-arguments0")
@pytest.mark.parametrize(
    ("flags", "arguments"),
    [
        (("timed.csv",), {"times": TIMES}),
        (("way.json",), {"times": TIMES}),
        (("way.csv", "--speed", "0.5", "--ramp-time", "0.2"), {"speed": 0.5, "ramp_time": 0.2}),
        (("way.csv:speed=0 0.2 0.3 0",), {"speed": [0.0, 0.2, 0.3, 0.0]}),
        (
            ("way.csv:times=time-optimal,max_speed=0.5,max_acceleration=2 3",),
            None,
        ),
        (
            ("way.csv:times=time-optimal,max_speed=0.5 0.4,max_acceleration=2 3",),
            {"times": "time-optimal", "max_speed": [0.5, 0.4], "max_acceleration": [2.0, 3.0]},
        ),
    ],
)
def test_plans_and_singularities_are_those_of_from_points(flags: tuple[str, ...], arguments: dict | None) -> None:
    if arguments is None:
        assert "different numbers" in refused("singularities", "--robot", "2rpr", "--trajectory", *flags)
        return
    motion = from_points(WAY, **arguments)
    if len(flags) == 1:  # `singularities` has no flags of trajectories
        told = json.loads(call("singularities", "--robot", "2rpr", "--trajectory", *flags, "--json").stdout)
        expected = [crossing.t for crossing in rp.find_crossings("2rpr", motion)]
        assert [crossing["t"] for crossing in told["crossings"]] == pytest.approx(expected, rel=1e-12)
        assert len(expected) == 1
        return
    result = call(
        "plan", "switch-off", "--robot", "2rpr", "--trajectory", *flags, "--threshold", "20", "--dt", "0.05", "--out",
        "plan.npz",
    )  # fmt: skip
    assert result.exit_code in (0, 3), result.stderr
    plan = rp.plan_switch_off("2rpr", motion, threshold=20.0, mesh=rp.Mesh(dt=0.05))
    np.testing.assert_array_equal(rp.load_plan("plan.npz").tau, plan.tau)


def test_problem_files_name_them_from_their_own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = "planner: switch-off\nrobot: 2rpr\ntrajectory: {name: way.csv, speed: 0.2}\n"
    Path("problem.yaml").write_text(text, encoding="utf-8")
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir("elsewhere")
    motion = read_problem(tmp_path / "problem.yaml").motion
    np.testing.assert_array_equal(motion.sample(0.1).x, from_points(WAY, speed=0.2).sample(0.1).x)


def test_a_map_takes_the_points_and_not_the_file() -> None:
    """Its store would not notice that the file has changed."""
    given = dict.fromkeys(("mode", "gravity", "backend", "stroke", "max_speed", "max_acceleration", "max_jerk"))
    given |= dict.fromkeys(("max_effort", "max_carrier_force"))
    given |= {
        "robot": "2rpr", "settings": {}, "trust": False, "planners": (), "parameters": (),
        "trajectory": "way.csv:ramp_time=0.2", "x_text": "speed=0.1:0.3:3", "y_text": "carrier_mass=1:2:2",
    }  # fmt: skip
    problem = problem_of(given)
    assert problem.trajectory == "points"
    assert problem.options == {"points": WAY.tolist(), "ramp_time": 0.2}
    with pytest.raises(rp.errors.InputError, match="which a map varies"):
        problem_of({**given, "trajectory": "timed.csv"})


@pytest.mark.parametrize(
    ("trajectory", "says"),
    [
        ("nowhere.csv", "nowhere.csv"),
        ("way.csv", "Neither times nor speed"),
        ("way.csv:times=soon", "times of the trajectory way.csv is 'soon'"),
        ("way.csv:spead=1", "no key 'spead'. Did you mean 'speed'"),
        ("timed.csv:speed=1", "times of its own"),
        ("way.csv:speed=-1", "speed is -1 m/s"),
    ],
)
def test_mistakes_are_one_line(trajectory: str, says: str) -> None:
    assert says in refused("singularities", "--robot", "2rpr", "--trajectory", trajectory)


def test_efforts_along_a_trajectory_are_those_of_its_samples() -> None:
    result = call(
        "inverse-dynamics", "--robot", "2rpr", "--trajectory", "way.csv:speed=0.2", "--dt", "0.05", "--out", "out.csv",
        "--json",
    )  # fmt: skip
    assert result.exit_code == 3  # it crosses the singular line
    told = json.loads(result.stdout)
    assert told["motion"] == "a trajectory through the points of way.csv:speed=0.2"
    motion = from_points(WAY, speed=0.2).sample(0.05)
    rows = np.genfromtxt("out.csv", delimiter=",", names=True, dtype=None, encoding="utf-8")
    np.testing.assert_array_equal(rows["t_s"], motion.t)
    tau = rp.distribute(rp.RneaDynamics("2rpr").reduce(motion)).tau
    written = np.stack([rows["tauslide_1_N"], rows["tauslide_2_N"]], axis=1)
    np.testing.assert_allclose(written, tau, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(
    ("flags", "says"),
    [
        ((), "needs either --trajectory or --motion"),
        (("--trajectory", "timed.csv", "--motion", "timed.csv"), "needs either"),
        (("--trajectory", "timed.csv", "--dt", "0"), "--dt is 0 s"),
        (("--motion", "rates.csv", "--dt", "0.1"), "--dt does not apply"),
        (("--trajectory", "rates.csv", "--dt", "0.1"), "--dt does not apply"),
        (("--trajectory", "rates.csv:speed=0.1"), "--speed does not apply"),
    ],
)
def test_what_inverse_dynamics_cannot_follow(flags: tuple[str, ...], says: str) -> None:
    assert says in refused("inverse-dynamics", "--robot", "2rpr", *flags, "--out", "out.csv")
    assert not Path("out.csv").exists()


@pytest.mark.parametrize(
    ("file", "what"),
    [("timed.csv", "a trajectory through the points of"), ("way.json", "a trajectory through the points of"),
     ("rates.csv", "samples of")],
)  # fmt: skip
def test_either_option_takes_points_and_samples(file: str, what: str) -> None:
    written = []
    for flag in ("--motion", "--trajectory"):
        result = call("inverse-dynamics", "--robot", "2rpr", flag, file, "--out", "out.csv", "--json")
        assert json.loads(result.stdout)["motion"] == f"{what} {file}"
        written.append(Path("out.csv").read_text())
    assert written[0] == written[1]
    expected = from_points(file).sample(1e-3).t if file != "rates.csv" else [0.0, 0.05, 0.1]
    np.testing.assert_array_equal(np.genfromtxt("out.csv", delimiter=",", skip_header=1)[:, 0], expected)


def test_points_are_not_written_over() -> None:
    before = Path("timed.csv").read_bytes()
    arguments = ("inverse-dynamics", "--robot", "2rpr", "--trajectory", "timed.csv", "--out", "timed.csv")
    assert "file of the motion" in refused(*arguments)
    assert Path("timed.csv").read_bytes() == before


@pytest.mark.parametrize(
    ("flags", "ends", "says"),
    [
        (("circle.csv",), ["samples", "samples"], "starts with the rates of the samples and ends with the rates"),
        (("circle.csv", "--ends", "rest"), ["rest", "rest"], "starts at rest and ends at rest"),
        (("circle.csv:ends=rest samples",), ["rest", "samples"], "starts at rest and ends with the rates"),
        (("way.csv:speed=0.2",), None, None),
    ],
)
def test_the_ends_of_a_motion_are_printed(flags: tuple[str, ...], ends: list[str] | None, says: str | None) -> None:
    """At constant speed efforts are periodic: ends at rest make them ten times as large."""
    t = np.linspace(0.0, 2.0 * np.pi / 5.0, 51)
    rows = np.column_stack([t, 0.25 + 0.02 * np.cos(5.0 * t), 0.25 + 0.02 * np.sin(5.0 * t)])
    np.savetxt("circle.csv", rows, fmt="%.6g", delimiter=",", header="t,x,y", comments="")
    base = ("inverse-dynamics", "--robot", "2rpr", "--trajectory", *flags, "--dt", "0.01", "--out", "out.csv")
    told = json.loads(call(*base, "--json").stdout)
    assert told["ends"] == ends
    printed = call(*base).stdout
    assert ("motion through the points" in printed) == (ends is not None)
    if says:
        assert says in printed
    if ends and ends[0] == ends[1]:
        exact = rp.PlatformMotion(t, rows[:, 1:], *(
            0.02 * 5.0**k * np.column_stack([np.cos(5.0 * t + 0.5 * np.pi * k), np.sin(5.0 * t + 0.5 * np.pi * k)])
            for k in (1, 2)
        ))  # fmt: skip
        true = np.abs(rp.inverse_dynamics(rp.RneaDynamics("2rpr"), exact).efforts.tau).max(axis=0)
        ratio = np.max(np.array(told["largest_tau"]) / true)
        assert ratio == pytest.approx(1.0, rel=0.01) if ends[0] == "samples" else ratio > 3.0


@pytest.mark.parametrize("command", [("singularities",), ("plan", "switch-off"), ("plan", "stepwise")])
def test_every_command_says_the_ends(command: tuple[str, ...]) -> None:
    Path("above.csv").write_text("t,x,y\n0,0.15,0.3\n0.6,0.2,0.25\n1.1,0.22,0.25\n1.8,0.25,0.3\n")
    told = json.loads(call(*command, "--robot", "2rpr", "--trajectory", "above.csv", "--ends", "rest", "--json").stdout)
    assert told["ends"] == ["rest", "rest"]


def test_a_problem_file_names_the_ends() -> None:
    text = "planner: switch-off\nrobot: 2rpr\ntrajectory: {name: timed.csv, ends: [rest, samples]}\n"
    Path("problem.yaml").write_text(text, encoding="utf-8")
    assert read_problem("problem.yaml").motion.ends == ("rest", "samples")
    Path("problem.yaml").write_text(text.replace("[rest, samples]", "rest"), encoding="utf-8")
    assert read_problem("problem.yaml").motion.ends == ("rest", "rest")


def test_ends_go_with_points_that_have_times() -> None:
    base = ("singularities", "--robot", "2rpr", "--trajectory")
    assert "ends is given, and has no effect" in refused(*base, "way.csv:speed=0.2,ends=rest")
    assert "takes no --ends" in refused(*base, "circle", "--ends", "rest")
    assert "ends is 'soon'" in refused(*base, "timed.csv:ends=soon")
