"""Every command gives what the call in Python gives: the same numbers, files, statuses and exit codes."""

from __future__ import annotations

import csv
import importlib
import json
import math
import shlex
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import call, write_motion
from generated_c import COMPILERS, compiled, run
from plan_cases import same
from scipy.io import loadmat
from scipy.spatial.transform import Rotation

import redundancy_pin as rp
from redundancy_pin.dynamics.backends import BACKENDS
from redundancy_pin.io.json_data import json_data
from redundancy_pin.planners.optimal import OBJECTIVES
from redundancy_pin.planners.plan import Plan
from redundancy_pin.robot import Payload, Wrench
from redundancy_pin.simulation import Sampling, closed_state, load_simulation, plan_reference
from redundancy_pin.simulation.controllers import ComputedTorque, Encoders, JointFriction
from redundancy_pin.singularities.locus import singular_locus
from redundancy_pin.status import ResultStatus
from redundancy_pin.trajectory import carriers_from_csv, from_csv, from_points, reference

WAY = np.array([[0.15, 0.3], [0.18, 0.12], [0.2, -0.05], [0.25, -0.2]])
TIMES = np.array([0.0, 0.5, 0.9, 1.4])


@pytest.fixture(autouse=True)
def files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Work in a folder with files of motions and of points."""
    monkeypatch.chdir(tmp_path)
    write_motion(Path("corner.csv"), reference.corner(), 0.05, carriers=3)
    write_motion(Path("parked.csv"), reference.corner(), 0.05)
    for name, columns in (("t,x,y", np.column_stack([TIMES, WAY])), ("x,y", WAY)):
        np.savetxt("timed.csv" if "t" in name else "way.csv", columns, delimiter=",", header=name, comments="")


def facts_of(line: str, code: int = 0) -> dict[str, Any]:
    """Run a command with ``--json``; return the facts that it prints."""
    result = call(*shlex.split(line), "--json")
    assert result.exit_code == code, result.stderr
    facts: dict[str, Any] = json.loads(result.stdout)
    return facts


def corner_robot(**arguments: Any) -> rp.VirtualWork:
    return rp.VirtualWork(rp.load_robot("3rrr", working_mode=(1, 1, 1), **arguments))


# --- plans -----------------------------------------------------------------------------------------------------------

CORNER = "plan stepwise --robot 3rrr --working-mode +++ --motion corner:radius=0.03 --dt 0.02"
PLANS: dict[str, tuple[str, Callable[[], Plan]]] = {
    "switch-off": (
        "plan switch-off --robot 2rpr --set carrier_mass=2.0 --backend virtual-work --motion circle:speed=0.6 "
        "--threshold 7 --return-time 0.5 --ramp-down 0.02 --dt 0.02 --datum 0.01,-0.01 --plot plan.png",
        lambda: rp.plan_switch_off(
            rp.VirtualWork(rp.load_robot("2rpr", carrier_mass=2.0)), reference.circle(speed=0.6), threshold=7.0,
            return_time=0.5, ramp_down=0.02, mesh=rp.Mesh(dt=0.02), datum=[0.01, -0.01],
        ),
    ),
    "stepwise": (
        f"{CORNER} --backend virtual-work --lam 0.5 --baseline carriers=false --speed 0.8 --acceleration 6,7,8 "
        "--track -0.9,0.9 --brake-time 0.4 --no-anticipate",
        lambda: rp.plan_stepwise(
            corner_robot(), reference.corner(radius=0.03), mesh=rp.Mesh(dt=0.02), brake_time=0.4, anticipate=False,
            objective=rp.Objective(lam=0.5, baseline=corner_robot(carriers=False)),
            limits=rp.Limits(speed=0.8, acceleration=[6.0, 7.0, 8.0], track=[-0.9, 0.9]),
        ),
    ),
    "samples": (
        "plan stepwise --robot 3rrr --motion parked.csv",
        lambda: rp.plan_stepwise("3rrr", from_csv("parked.csv")),
    ),
    "way": (
        "plan switch-off --robot 2rpr --motion way.csv:speed=0.5,ramp_time=0.2 --threshold 20 --dt 0.05",
        lambda: rp.plan_switch_off("2rpr", from_points(WAY, speed=0.5, ramp_time=0.2), threshold=20.0,
                                   mesh=rp.Mesh(dt=0.05)),
    ),
    "points": (
        "plan stepwise --robot 3rrr --dt 0.02 --motion "
        "'points:points=1.0 0.4;1.02 0.5;0.95 0.6,speed=0.1,ramp_time=0.2,alpha=0.1'",
        lambda: rp.plan_stepwise(
            "3rrr", reference.points([[1.0, 0.4], [1.02, 0.5], [0.95, 0.6]], speed=0.1, ramp_time=0.2, alpha=0.1),
            mesh=rp.Mesh(dt=0.02),
        ),
    ),
    "whole-trajectory": (
        "plan whole-trajectory --robot 3rrr --working-mode +++ --backend virtual-work --motion corner --dt 0.03 "
        "--objective effort --objective peak=0.5 --objective tracking=2 --lam 0.3 --calm 0.02 "
        "--baseline carriers=false --start 0.01,0,-0.01 --start-speed 0.02 --end rest --datum 0.001 --track -0.5,0.6 "
        "--speed 0.9,0.8,0.7 "
        "--acceleration 6 --jerk 3000 --effort 20,30,40 --carrier-force 60 --starts 2 --seconds 30 --refinements 1",
        lambda: rp.plan_whole_trajectory(
            corner_robot(), reference.corner(), start=[0.01, 0.0, -0.01], start_speed=0.02, end="rest", datum=0.001,
            objective=rp.Objective({"effort": 1.0, "peak": 0.5, "tracking": 2.0}, lam=0.3, calm=0.02,
                                   baseline=corner_robot(carriers=False)),
            limits=rp.Limits(track=[-0.5, 0.6], speed=[0.9, 0.8, 0.7], acceleration=6.0, jerk=3000.0,
                             effort=[20.0, 30.0, 40.0], carrier_force=60.0),
            mesh=rp.Mesh(dt=0.03, refinements=1), solver=rp.Solver(starts=2, seconds=30.0),
        ),
    ),
    "time-optimal": (
        "plan time-optimal --robot 3rrr --working-mode +++ --set carriers=false --motion corner --effort 3 "
        "--actuator-speed 0.5 --steps 15 --backend rnea",
        lambda: rp.plan_time_optimal(
            rp.RneaDynamics(rp.load_robot("3rrr", carriers=False, working_mode=(1, 1, 1))), reference.corner().path,
            limits=rp.Limits(effort=3.0, actuator_speed=0.5), mesh=rp.Mesh(steps=15),
        ),
    ),
}  # fmt: skip
CODES = {ResultStatus.OK: 0, ResultStatus.LIMIT_VIOLATED: 3, ResultStatus.UNBOUNDED: 3, ResultStatus.UNRESOLVED: 4}


@pytest.mark.parametrize("case", PLANS)
def test_plans(case: str) -> None:
    line, expected = PLANS[case][0], PLANS[case][1]()
    result = call(*shlex.split(line), "--out", "plan.npz", "--json")
    plan, facts = rp.load_plan("plan.npz"), json.loads(result.stdout)
    same(plan, expected)
    assert plan.parameters == expected.parameters
    # how it is: by the exit code, and in a line on stderr where anything is wrong
    assert result.exit_code == CODES[expected.status]
    assert bool(result.stderr) == (expected.status is not ResultStatus.OK)
    assert (facts["status"], facts["out"]) == (expected.status.value, "plan.npz")
    assert facts["peak_effort"] == expected.peak_effort.tolist()
    assert facts["main_energy"] == expected.main_energy
    assert len(facts["limits"]["violated"]) == len(expected.limits.violated)
    if expected.findings.singular_instants:
        assert facts["smallest_margin"] == 0.0  # whether a sample lies on one is chance
    if facts["plot"]:
        assert Path("plan.png").read_bytes().startswith(b"\x89PNG")
    # validated again it is what it says, and as a table it is that of its methods
    assert call("check", "plan.npz").exit_code == result.exit_code
    checked = facts_of("check plan.npz", result.exit_code)
    assert (checked["passed"], checked["saved_status"]) == (True, expected.status.value)
    np.testing.assert_allclose(checked["peak_effort"], expected.peak_effort, rtol=1e-3)


def test_a_table_says_what_the_plan_holds() -> None:
    result = call(*shlex.split(CORNER), "--out", "PLAN.NPZ")  # the case of a suffix is free
    plan = rp.load_plan("PLAN.NPZ")
    lines = result.stdout.splitlines()
    assert lines[0].strip() == "3rrr, stepwise, compiled"  # the backend as --backend names it
    rows = [[cell.strip() for cell in line.strip("│").split("│")] for line in lines if line.startswith("│")]
    assert (rows[1], rows[-1]) == (["motion", "corner:radius=0.03"], ["plan written to", "PLAN.NPZ"])
    assert any("speed of carrier_2 at its limit 1 m/s" in line for line in lines)
    assert f"{plan.peak_effort[0]:.6g}" in result.stdout
    assert f"{plan.carrier_energy:.6g}" in result.stdout
    (reversals,) = [line for line in lines if "reversals above 5 % of the peak" in line]
    assert ", ".join(map(str, plan.reversals)) in reversals


def test_least_time_keeps_its_limit_and_names_it() -> None:
    """The five-bar without carriers on a circle, its efforts at 5000 instants by W τ = f."""
    task = "plan time-optimal --robot five_bar --set carriers=false --motion circle --effort 12"
    result = call(*task.split(), "--out", "fast.npz")
    assert (result.exit_code, result.stderr) == (0, "")
    assert "effort of base_1 at its limit 12 N·m" in " ".join(result.stdout.split())
    plan = rp.load_plan("fast.npz")
    t = np.linspace(0.0, plan.t[-1], 5001)[1:-1]
    reduced = rp.CompiledDynamics(rp.load_robot("five_bar", carriers=False)).along(plan.platform_at(t)).reduce()
    tau = np.linalg.solve(reduced.W, np.asarray(reduced.f)[..., None])[..., 0]
    assert 0.999 * 12.0 < np.abs(tau).max() <= 1.001 * 12.0
    coarse = call(*task.split(), "--steps", "4", "--refinements", "0", "--json")
    assert coarse.exit_code == 3
    assert "limits broken: effort of base_" in coarse.stderr


@pytest.mark.parametrize(
    ("objective", "calm", "advised"),
    [("--objective effort", "0", True), ("--objective effort --objective effort_rate=0.01", "0", False),
     ("--objective effort", "0.01", False)],
)  # fmt: skip
def test_efforts_that_oscillate_are_calmed_by_what_the_plan_proposes(objective: str, calm: str, advised: bool) -> None:
    circle = "plan whole-trajectory --robot 2rpr --backend virtual-work --motion circle:ramp_length=0.05 --dt 0.01"
    facts = facts_of(f"{circle} {objective} --calm {calm}")
    assert (max(facts["reversals"]) > 20) == advised
    assert ("effort_rate=0.01" in (facts["advice"] or "")) == advised


def test_balancing_makes_the_base_feel_nothing() -> None:
    facts = facts_of(
        "plan whole-trajectory --robot 3rrr --working-mode +++ --backend virtual-work --motion corner --dt 0.03 "
        "--set carrier_mass=3 --speed 5 --acceleration 20 --track=-1,1 --end free --objective base_wrench "
        "--base-point 0.866,0.5,0"
    )
    assert facts["base_point"] == [0.866, 0.5, 0.0]
    assert max(facts["peak_base_force"], facts["peak_base_moment"]) < 1e-3


def test_help_of_a_planner_is_that_of_its_function() -> None:
    """Each keyword has a flag with a text; the objectives are named; the example keeps its lines."""
    for name in ("switch-off", "stepwise", "whole-trajectory", "time-optimal"):
        text = call("plan", name, "--help").stdout
        lines = [line.strip() for line in text.splitlines()]
        assert any(line.startswith(f"redundancy-pin plan {name}") and line.endswith("\\") for line in lines)
    text = " ".join(call("plan", "whole-trajectory", "--help").stdout.split())
    assert "largest speed |ṡ| of the carriers, m/s" in text
    assert "free|rest|datum|periodic" in text
    assert "[default: 60.0]" in text
    assert all(name in text for name in OBJECTIVES)


# --- torques ---------------------------------------------------------------------------------------------------------


def columns_of(path: str) -> dict[str, np.ndarray]:
    """Return the columns of a file by their names, without units."""
    with Path(path).open(newline="", encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    return {
        name.partition(" [")[0]: np.array([row[name] if name == "status" else float(row[name]) for row in rows])
        for name in rows[0]
    }


HOLD = [[t, 0.511, 0.109, 0.2375, *Rotation.from_rotvec([0.3, 0.0, 0.1]).as_quat(), *np.zeros(12)] for t in (0.0, 1.0)]
"""Two arms hold a bar at rest, whose axes are not those of the world."""

BENT = {"carrier_mass": 2.0, "working_mode": (1, 1, 1), "gravity": (0.0, -9.81, 0.0)}
AT = np.block([[Rotation.from_rotvec([0.0, 0.0, 0.7]).as_matrix(), np.array([[0.0], [0.0], [0.6]])], [np.eye(4)[3]]])

RESULTS: dict[str, tuple[str, Callable[[], Any], int]] = {
    **{
        name: (
            "inverse-dynamics --robot 3rrr --set carrier_mass=2.0 --working-mode +++ --gravity 0,-9.81,0 "
            f"--backend {name} --motion corner.csv --plot efforts.png",
            lambda backend=backend: rp.inverse_dynamics(
                backend(rp.load_robot("3rrr", **BENT)), from_csv("corner.csv"), carriers_from_csv("corner.csv")
            ),
            0,
        )
        for name, backend in BACKENDS.items()
    },
    "loads, bounds and a squeeze": (
        "inverse-dynamics --robot two_arms --backend rnea --motion hold.csv --payload bar=2,0.1,0,0 --payload bar=0.5 "
        "--wrench bar=1,2,3 --wrench bar=0,0,1,0.1,0.2,0.3 --preferred 0,0,5,0,0,0,0,0,-5,0,0,0 "
        f"--lower 0.1{11 * ',-40'} --upper 40",
        lambda: rp.inverse_dynamics(
            rp.RneaDynamics(rp.load_robot("two_arms").loaded(
                Payload("bar", 2.0, (0.1, 0.0, 0.0)), Payload("bar", 0.5),
                Wrench("bar", [1.0, 2.0, 3.0, 0.0, 0.0, 0.0]), Wrench("bar", [0.0, 0.0, 1.0, 0.1, 0.2, 0.3]),
            )),
            from_csv("hold.csv"), preferred=[0.0, 0.0, 5.0, *np.zeros(5), -5.0, *np.zeros(3)],
            lower=[0.1, *np.full(11, -40.0)], upper=40.0,
        ),
        0,
    ),
    "bounds that bind": (
        "inverse-dynamics --robot two_arms --backend rnea --motion hold.csv --upper 0.3",
        lambda: rp.inverse_dynamics(rp.RneaDynamics("two_arms"), from_csv("hold.csv"), upper=0.3),
        0,
    ),
    "a circle of one's own": (
        "inverse-dynamics --robot 2rpr --motion 'circle:centre=0.3 0.4,radius=0.1' --dt 0.01",
        lambda: rp.inverse_dynamics("2rpr", reference.circle(centre=[0.3, 0.4], radius=0.1).sample(0.01)),
        0,
    ),
    "workspace": (
        "workspace --robot five_bar --bounds -0.6:1.1,-1:1 --resolution 8 --all-modes --plot w.png",
        lambda: rp.workspace("five_bar", bounds=[(-0.6, 1.1), (-1.0, 1.0)], resolution=8, modes="all"),
        0,
    ),
    "a slice through a pose": (
        f"workspace --robot gough --free z --at 0,0,0.6,0,0,{math.sin(0.35)!r},{math.cos(0.35)!r} --bounds 0.5:0.9 "
        "--resolution 3",
        lambda: rp.workspace("gough", ["z"], at=AT, bounds=[(0.5, 0.9)], resolution=3),
        0,
    ),
}  # fmt: skip


@pytest.mark.long_for("compiled")
@pytest.mark.parametrize("case", RESULTS)
def test_facts_and_files_are_those_of_the_call(case: str) -> None:
    """What these numbers should be is the business of tests/dynamics and tests/singularities."""
    names = ["t", *(f"x{k}" for k in range(7)), *(f"xd{k}" for k in range(6)), *(f"xdd{k}" for k in range(6))]
    Path("hold.csv").write_text("\n".join(",".join(map(str, row)) for row in [names, *HOLD]))
    line, compute, code = RESULTS[case]
    facts, result = facts_of(f"{line} --out out.csv", code), compute()
    expected = json.loads(json.dumps(json_data(result.summary())))
    assert {key: facts[key] for key in expected} == expected
    result.to_csv("expected.csv")
    assert Path("out.csv").read_bytes() == Path("expected.csv").read_bytes()
    if facts["plot"]:
        assert Path(facts["plot"]).read_bytes().startswith(b"\x89PNG")
    if case == "virtual-work":
        assert facts["backend"] == "virtual-work"
        assert Path("out.csv").read_text(encoding="utf-8").splitlines()[0].split(",") == [
            "t [s]", "x [m]", "y [m]", "rz [rad]", "xd [m/s]", "yd [m/s]", "rzd [rad/s]",
            "xdd [m/s^2]", "ydd [m/s^2]", "rzdd [rad/s^2]",
            *(f"{name}:carrier_{k} [{unit}]" for name, unit in (("s", "m"), ("sd", "m/s"), ("sdd", "m/s^2"))
              for k in (1, 2, 3)),
            *(f"tau:base_{k} [N*m]" for k in (1, 2, 3)), *(f"tau:carrier_{k} [N]" for k in (1, 2, 3)),
            "status", "margin", "residual [N]",
        ]  # fmt: skip


def test_bounds_that_no_effort_keeps_are_limits_and_no_singularity() -> None:
    """The five-bar without carriers meets none on the circle."""
    line = "inverse-dynamics --robot five_bar --set carriers=false --motion circle --dt 0.02 --out out.csv"
    assert facts_of(line)["status"] == "ok"
    facts = facts_of(f"{line} --lower=-0.3 --upper 0.3", 3)
    assert (facts["status"], set(facts["statuses"])) == ("limit_violated", {"ok", "bound_infeasible"})


def test_a_picture_of_bounded_efforts_has_two_hatches() -> None:
    """What is beyond the bound, and where no efforts keep it."""
    for bound, hatches in (("", 0), ("--upper 3", 2)):
        line = f"inverse-dynamics --robot 2rpr --motion circle --dt 0.01 --out out.csv --plot efforts.svg {bound}"
        facts_of(line, code=3)
        assert Path("efforts.svg").read_text(encoding="utf-8").count("<pattern") == hatches


def test_samples_without_efforts_are_marked_and_said() -> None:
    """On the base line of the 2-RPR, moving across it, the carriers' inertia needs a force that no leg gives."""
    head = "t,x0,x1,xd0,xd1,xdd0,xdd1"
    Path("far.csv").write_text(f"{head}\n0,0.25,0.7,0,0,0,0\n1,5.0,0,0,0,0,0\n2,0.3,0.7,0,0,0,0\n")
    facts = facts_of("inverse-dynamics --robot five_bar --motion far.csv --unreachable mark --out out.csv", 3)
    assert facts["statuses"] == {"ok": 2, "unreachable": 1}
    assert np.isnan(columns_of("out.csv")["tau:base_1"]).tolist() == [False, True, False]
    Path("line.csv").write_text(f"{head}\n0,0.2,0,0.3,-1,0,0\n")
    drawn = call("inverse-dynamics", "--robot", "2rpr", "--motion", "line.csv", "--plot", "alone.png")
    assert Path("alone.png").read_bytes().startswith(b"\x89PNG")
    result = call("inverse-dynamics", "--robot", "2rpr", "--motion", "line.csv", "--out", "out.csv")
    assert drawn.exit_code == result.exit_code
    assert result.exit_code == 3
    assert "no finite main efforts at 1 of 1 samples, first at t = 0 s (singular_inconsistent)" in result.stderr
    # theta_dd = -2 d_dot theta_dot / d for zero acceleration; only L² theta_dd acts, and its force on the platform is
    # n h / d (Parsa 2014, eq. 2.17 collapsed); both legs push along y
    expected = 0.0
    for d, d_rate, n_rate in ((0.2, 0.3, -1.0), (0.3, -0.3, 1.0)):
        h = 0.1**2 * (-2.0 * d_rate * (n_rate / d) / d)
        expected += h / d * (1.0 if n_rate < 0 else -1.0)
    assert columns_of("out.csv")["residual"][0] == pytest.approx(abs(expected), rel=1e-12)


@pytest.mark.parametrize(
    ("file", "what"), [("timed.csv", "a trajectory through the points"), ("parked.csv", "samples")]
)
def test_a_motion_is_points_or_samples_as_its_columns_say(file: str, what: str) -> None:
    robot = "2rpr" if file == "timed.csv" else "3rrr"
    facts = facts_of(f"inverse-dynamics --robot {robot} --motion {file} --out out.csv", 3 if robot == "2rpr" else 0)
    assert facts["motion"] == f"{what} of {file}"
    expected = from_points(file).sample(1e-3).t if robot == "2rpr" else from_csv(file).t
    np.testing.assert_array_equal(columns_of("out.csv")["t"], expected)


@pytest.mark.parametrize(
    ("command", "ends"),
    [("singularities", ""), ("singularities", "rest samples"), ("plan switch-off --dt 0.05", "rest"),
     ("plan stepwise --dt 0.05", "rest")],
)  # fmt: skip
def test_every_command_says_the_ends_of_a_motion_through_points(command: str, ends: str) -> None:
    Path("above.csv").write_text("t,x,y\n0,0.15,0.3\n0.6,0.2,0.25\n1.1,0.22,0.25\n1.8,0.25,0.3\n")
    line = f"{command} --robot 2rpr --motion 'above.csv{f':ends={ends}' if ends else ''}'"
    facts = json.loads(call(*shlex.split(line), "--json").stdout)
    expected = from_points("above.csv", **({"ends": ends.split() if " " in ends else ends} if ends else {})).ends
    assert facts["ends"] == list(expected)
    assert "The motion through the points starts" in call(*shlex.split(line)).stdout


# --- singularities, workspace, code ----------------------------------------------------------------------------------


def test_singular_instants(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the circle of radius 0.2 about (0.25, 0.185) meets the base line; way.csv as in Python."""
    coarse = partial(singular_locus, resolution=15)  # of the picture, which is not looked at
    monkeypatch.setattr(importlib.import_module("redundancy_pin.cli.singularities"), "singular_locus", coarse)
    half = np.sqrt(0.2**2 - 0.185**2)
    facts = facts_of("singularities --robot 2rpr --motion circle:speed=0.75 --plot locus.png")
    found, summary = facts["crossings"], coarse("2rpr").summary()
    assert facts["locus"] == json.loads(json.dumps(json_data(summary)))
    assert str(summary) in call("singularities", "--robot", "2rpr", "--plot", "locus.png").stdout
    assert [one["x"][0] for one in found] == pytest.approx([0.25 - half, 0.25 + half], abs=1e-10)
    for one in found:
        assert (one["kind"], one["crosses"], one["lost_direction"]) == ("type_ii", True, [None, None])
        assert np.abs(one["uncontrolled_twist"]) == pytest.approx([0.0, 1.0], abs=1e-9)
    assert Path("locus.png").read_bytes().startswith(b"\x89PNG")
    text = call("singularities", "--robot", "2rpr", "--motion", "line").stdout
    assert "4.51649" in text  # sqrt(0.1² + 1.1²) · 4/11 / 0.1 + 0.5
    assert "crossed" in text
    law = "times=time-optimal,max_speed=0.5 0.4,max_acceleration=2 3"
    found = facts_of(f"singularities --robot 2rpr --motion 'way.csv:{law}'")["crossings"]
    fast = from_points(WAY, times="time-optimal", max_speed=[0.5, 0.4], max_acceleration=[2.0, 3.0])
    assert [one["t"] for one in found] == pytest.approx([one.t for one in rp.find_crossings("2rpr", fast)], rel=1e-12)
    assert len(found) == 1


@pytest.mark.skipif(not COMPILERS, reason="there is no C compiler")
def test_c_for_a_controller() -> None:
    write_motion(Path("circle.csv"), reference.circle(), 0.02, carriers=2)
    facts = facts_of("codegen --robot 2rpr --set carrier_mass=2.0 --prefix leg --motion circle.csv --out code")
    assert (facts["prefix"], facts["folder"]) == ("leg", "code")
    assert set(facts["files"]) == {path.name for path in Path("code").iterdir()}
    assert "| carrier_mass | 2.0 |" in Path("code/README.md").read_text(encoding="utf-8")
    done = run(
        compiled([Path("code/leg.c"), Path("code/test_leg.c")], Path("program").resolve(), compiler=COMPILERS[0])
    )
    assert done.stdout.startswith("0 failures"), done.stdout


# --- saved plans, simulations, on line -------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("plan") / "plan.npz"
    rp.plan_stepwise("3rrr", reference.corner(radius=0.025).sample(0.02)).save(path)
    return path


@pytest.mark.parametrize(
    ("name", "method"), [("p.csv", "to_csv"), ("p.json", "to_json"), ("p.yaml", "to_ros"), ("p.mat", "to_mat")]
)
def test_a_plan_for_other_programs(name: str, method: str, saved: Path) -> None:
    plan = rp.load_plan(saved)
    facts = facts_of(f"export {saved} --to {name} --rate 20")
    assert facts["rows"] == np.ceil(20 * plan.t[-1]) + 1
    assert facts["joints"] == [*plan.robot.actuated, *plan.robot.carriers]
    getattr(plan.table(20), method)(f"other_{name}")
    if method != "to_mat":  # with the time of writing in it
        assert Path(name).read_bytes() == Path(f"other_{name}").read_bytes()
        return
    facts_of(f"export {saved} --to {name} --two-sided --rate 10")
    np.testing.assert_array_equal(loadmat(name)["t"][:, 0], plan.table(10, two_sided=True).t)
    facts_of(f"export {saved} --to ros.json --ros --rate 10")
    assert set(json.loads(Path("ros.json").read_text(encoding="utf-8"))) == {"header", "joint_names", "points"}


class Noisy:
    """The same noise as the command's, written down once more."""

    def __init__(self, controller: Encoders, seed: int, noise: float) -> None:
        self._controller, self._random, self._noise = controller, np.random.default_rng(seed), noise

    def effort(self, t: float, state: object) -> tuple[np.ndarray, np.ndarray]:
        tau, force = self._controller.effort(t, state)  # type: ignore[arg-type]
        return tuple(part + self._noise * self._random.standard_normal(3) for part in (tau, force))  # type: ignore[return-value]


def digital(plan: Plan) -> Any:
    """Simulate with encoders, noise, friction and a sampled controller, put together by hand."""
    robot, planned, sampling = rp.load_robot("3rrr"), plan_reference(plan), Sampling(0.004, 0.002)
    controller = Encoders(ComputedTorque(planned, sampling=sampling, effort_limit=1.5), planned, period=0.004)
    point = planned.at(0.0)
    sliding = np.array([name.startswith("carrier") for name in list(robot.model.names)[1:]])
    friction = JointFriction(np.where(sliding, 0.0, 0.3), np.where(sliding, 2.0, 0.0), np.where(sliding, 0.01, 0.05))
    return rp.simulate(
        robot, Noisy(controller, 5, 0.2), duration=0.05, dt=0.004, sampling=sampling, effort_limit=1.5,
        start=closed_state(robot, point.x, point.xd, point.s, point.sd), external=friction, rtol=1e-7, atol=1e-9,
        integrator="RK45",
    )  # fmt: skip


SIMULATIONS: dict[str, tuple[str, Callable[[Plan], Any]]] = {
    "other mass": (
        "--machine carrier_mass=2.0 --duration 0.05 --plot run.png",
        lambda plan: rp.simulate(rp.load_robot("3rrr", carrier_mass=2.0), plan, duration=0.05),
    ),
    "digital": (
        "--controller computed-torque --period 0.004 --delay 0.002 --noise 0.2 --seed 5 --encoders --friction "
        "revolute_coulomb=0.3 --friction prismatic_viscous=2 --effort-limit 1.5 --duration 0.05",
        digital,
    ),
}


@pytest.mark.parametrize("case", SIMULATIONS)
def test_simulations(case: str, saved: Path) -> None:
    flags, expected = SIMULATIONS[case][0], SIMULATIONS[case][1](rp.load_plan(saved))
    facts = facts_of(f"simulate --plan {saved} {flags} --out run.npz")
    run_ = load_simulation("run.npz")
    for name in ("t", "q", "v", "a", "x", "tau", "carrier_force"):  # starts that are closed anew differ by rounding
        np.testing.assert_allclose(getattr(run_, name), getattr(expected, name), rtol=1e-9, atol=1e-9, err_msg=name)
    apart = run_.x - reference.corner(radius=0.025).evaluate(run_.t).x
    away = np.linalg.norm(apart * [1.0, 1.0, rp.load_robot("3rrr").characteristic_length], axis=1)
    assert facts["largest_distance"] == pytest.approx(away.max(), rel=1e-9)
    assert facts["last_distance"] == pytest.approx(away[-1], rel=1e-9)
    assert facts["peak_effort"] == pytest.approx(np.abs(expected.tau).max(axis=0))
    facts_of(f"simulate --plan {saved} {flags} --out run.csv")
    np.testing.assert_allclose(columns_of("run.csv")["tau:base_2"], expected.tau[:, 1], rtol=1e-9, atol=1e-9)


def test_how_a_simulation_ends_is_its_exit_code(saved: Path) -> None:
    result = call("simulate", "--plan", saved, "--machine", "carrier_mass=0.5", "--out", "run.npz")
    last = load_simulation("run.npz").events[-1]
    assert (result.exit_code, last.kind, last.terminal) == (3, "track", True)
    # it is far off its path by then, from which a narrower track does not keep it
    assert result.stderr.startswith(
        f"warning: stopped at t = {last.t:.6g} s: track ({last.name})\nwarning: limits broken: "
    )
    lighter = f"simulate --plan {saved} --machine carrier_mass=0.5 --duration {last.t + 0.01}"
    for event in facts_of(f"{lighter} --stop-at never", 3)["limits"]["violated"]:
        assert event["amount"] == pytest.approx(abs(event["value"]) - abs(event["limit"]))
    pushed = facts_of(f"{lighter} --joint-stops inelastic", 3)
    longer = call("simulate", "--plan", saved, "--duration", "2.5")
    ends = rp.load_plan(saved).t[-1]
    assert (
        f"warning: the motion to follow ends at t = {ends:.6g} s, and the simulation goes on to 2.5 s" in longer.stderr
    )
    (hit,) = (event for event in pushed["events"] if event["name"] == last.name)
    assert (hit["t"], hit["terminal"], hit["impulse"] > 0.0) == (pytest.approx(last.t, abs=1e-9), False, True)
    lengths = facts_of(f"simulate --plan {saved} --machine distal_length=1.003 --duration 0.02")
    assert (lengths["largest_closure_residual"] < 1e-9, lengths["largest_distance"] < 1e-4) == (True, True)
    rp.plan_switch_off(rp.RneaDynamics("2rpr"), reference.circle(speed=1.0), mesh=rp.Mesh(dt=0.01)).save("off.npz")
    result = call("simulate", "--plan", "off.npz", "--carriers", "motion", "--stop-at", "never", "--out", "run.npz")
    run_ = load_simulation("run.npz")
    assert (result.exit_code, run_.status.value) == (4, "not_converged")
    assert result.stderr.startswith(f"warning: could not go on at t = {run_.t[-1]:.6g} s: ")


def test_a_plan_that_uses_the_whole_track_leaves_no_room_and_the_remedy_makes_some() -> None:
    machine = "--robot 2rpr --set end_effector_mass=0.5 --set cylinder_mass=0.3 --set track_half_length=0.03"
    line = f"plan whole-trajectory {machine} --motion circle:speed=0.8 --dt 0.04 --objective peak --out plan.npz"
    for remedy, code in (("", 3), ("--track=-0.029,0.029", 0)):
        facts_of(f"{line} {remedy}")
        result = call("simulate", "--plan", "plan.npz", "--machine", "carrier_mass=1.001", "--out", f"{code}.npz")
        assert (result.exit_code, "--track" in result.stderr) == (code, code == 3)
    # it is no remedy where the platform or the carriers are elsewhere than planned
    stopped, motion = load_simulation("3.npz"), plan_reference(rp.load_plan("plan.npz"))
    for other in (replace(stopped, x=stopped.x + 0.05), replace(stopped, s=0.5 * stopped.s)):
        warning = other.summary(motion, motion.robot).warnings[0]
        assert ("stopped at" in warning, "--track" in warning) == (True, False)


def test_a_motion_is_simulated_with_its_carriers_or_parked_ones() -> None:
    moving = facts_of("simulate --robot 3rrr --duration 0.2 --motion corner.csv")
    parked = facts_of("simulate --robot 3rrr --duration 0.2 --motion corner:radius=0.05 --park 0.1")
    assert moving["largest_distance"] < 1e-6  # between samples that are 0.05 s apart
    motion, carriers = from_csv("corner.csv"), carriers_from_csv("corner.csv")
    forces = rp.RneaDynamics("3rrr").along(motion).reduce(carriers).carrier_force[motion.t <= 0.2]
    peak = np.abs(forces).max(axis=0)  # of the samples alone
    assert (moving["peak_carrier_force"] >= (1.0 - 1e-6) * peak).all()
    np.testing.assert_allclose(moving["peak_carrier_force"], peak, rtol=0.05)
    assert parked["largest_distance"] < 1e-9
    assert not np.allclose(parked["peak_carrier_force"], moving["peak_carrier_force"], rtol=0.1)


def test_on_line() -> None:
    Path("points.csv").write_text("t,x,y\n0,0.2,0.06\n0.3,0.23,0.0\n0.6,0.28,-0.05\n")
    machine = "online --robot 2rpr --set end_effector_mass=0.5 --set cylinder_mass=0.3"
    facts = facts_of(f"{machine} --motion points.csv --out online.npz --html online.html")
    plan = rp.load_plan("online.npz")
    assert facts["ticks"]["ok"] == sum(facts["ticks"].values()) == 30
    assert len(facts["findings"]["singular_instants"]) == 1
    np.testing.assert_allclose(facts["peak_effort"], plan.peak_effort)
    assert "2rpr" in Path("online.html").read_text(encoding="utf-8").partition("<script>")[0]
    assert 0.0 < facts["milliseconds"]["p50"] <= facts["milliseconds"]["p99"]
    weak = f"{machine} --motion circle:speed=0.5 --acceleration 2"
    late = facts_of(f"{weak} --slow-down --out late.npz")
    assert late["ticks"]["time_scaled"] > 0
    assert late["ticks"]["relaxed"] == 0
    duration = reference.circle(speed=0.5).duration + late["diagnostics"]["delay"]
    np.testing.assert_allclose(rp.load_plan("late.npz").t[-1], duration, atol=1e-9)
    result = call(*weak.split())
    # the remedy is the one that was found to help above
    assert (result.exit_code, "--slow-down" in result.stderr, "shorter step" in result.stderr) == (3, True, False)
    # where efforts alone are too small it makes them larger
    result = call(*f"{machine} --motion circle:speed=0.5 --effort 0.05".split())
    assert (result.exit_code, "--slow-down" in result.stderr) == (3, False)
    assert "ticks had no plan within every limit" in result.stderr
