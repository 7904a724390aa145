"""``redundancy-pin plan time-optimal``: the plan of the Python API, from flags and from a problem file."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from command_line import call, refused

import redundancy_pin as rp
from redundancy_pin.trajectory import reference

pytest.importorskip("casadi")

CORNER = ("plan", "time-optimal", "--robot", "3rrr", "--mode", "+++", "--trajectory", "corner")
BARE = (*CORNER, "--set", "carriers=false")


def test_flags_and_problem_files_give_the_plan_of_the_function(tmp_path: Path) -> None:
    flags = ("--max-effort", "3", "--actuator-speed", "0.5", "--steps", "40", "--out", str(tmp_path / "flags.npz"))
    told = json.loads(call(*BARE, *flags, "--json").stdout)
    robot = rp.load_robot("3rrr", carriers=False, working_mode=(1, 1, 1))
    mine = rp.plan_time_optimal(
        rp.RneaDynamics(robot),
        reference.corner().path,
        limits=rp.Limits(effort=3.0, actuator_speed=0.5),
        mesh=rp.Mesh(steps=40),
    )
    assert told["end"] == pytest.approx(mine.t[-1], rel=1e-9)
    problem = {
        "planner": "time-optimal", "robot": "3rrr", "mode": "+++", "set": {"carriers": False},
        "trajectory": {"name": "corner", "speed": 0.1},  # how fast it is there does not matter
        "parameters": {"effort": 3, "actuator_speed": 0.5, "steps": 40, "lap": False},
    }  # fmt: skip
    path = tmp_path / "problem.yaml"
    path.write_text(yaml.safe_dump(problem), encoding="utf-8")
    again = json.loads(call("plan", "--problem", path, "--json").stdout)
    assert again["end"] == pytest.approx(mine.t[-1], rel=1e-9)
    assert again["planner"] == "time_optimal"


def test_least_time_keeps_its_limit_and_names_it(tmp_path: Path) -> None:
    """The five-bar without carriers on a circle: 12.6 of 12 N·m between the nodes were within limits, none touched."""
    task = ("plan", "time-optimal", "--robot", "five_bar", "--set", "carriers=false", "--trajectory", "circle")
    result = call(*task, "--max-effort", "12", "--out", str(tmp_path / "fast.npz"))
    assert (result.exit_code, result.stderr) == (0, "")
    told = " ".join(result.stdout.split())
    assert "effort of base_1 at its limit 12 N·m" in told
    assert "effort of base_2 at its limit 12 N·m" in told
    plan = rp.load_plan(tmp_path / "fast.npz")
    t = np.linspace(0.0, plan.t[-1], 5001)[1:-1]
    reduced = rp.CompiledDynamics(rp.load_robot("five_bar", carriers=False)).along(plan.platform_at(t)).reduce()
    tau = np.linalg.solve(reduced.W, np.asarray(reduced.f)[..., None])[..., 0]
    assert 0.999 * 12.0 < np.abs(tau).max() <= 1.001 * 12.0
    # where nothing lowers the efforts between few nodes the exit code is another, and the line says which and how much
    coarse = call(*task, "--max-effort", "12", "--steps", "4", "--refinements", "0", "--json")
    assert coarse.exit_code == 3
    assert "limits broken: effort of base_" in coarse.stderr
    assert {event["quantity"] for event in json.loads(coarse.stdout)["limits"]["violated"]} == {"effort"}


def test_mistakes_end_with_one_line(tmp_path: Path) -> None:
    said = refused(*BARE, "--max-effort", "inf", "--actuator-speed", "inf")
    assert "Nothing limits the time. Limit the efforts, as by --max-effort 2.0, or" in said
    assert "as by --actuator-speed 1.0." in said
    assert "closed path" in refused(*BARE, "--max-effort", "3", "--lap")
    assert "--begin" in refused(*CORNER, "--max-effort", "3", "--begin", "somehow")
    motion = tmp_path / "motion.csv"
    rows = "\n".join(f"{0.1 * i},1.0,0.4,0,0,0,0,0,0,0" for i in range(12))
    motion.write_text("t,x0,x1,x2,xd0,xd1,xd2,xdd0,xdd1,xdd2\n" + rows + "\n", encoding="utf-8")
    sampled = (*CORNER[:6], "--motion", str(motion), "--max-effort", "3")
    assert "path" in refused(*sampled)
