"""``redundancy-pin online``."""

import json

import numpy as np
from command_line import call, refused

import redundancy_pin as rp

MASSES = ("--set", "end_effector_mass=0.5", "--set", "cylinder_mass=0.3")
LINE = ("--trajectory", "line:speed=0.4,ramp_time=0.2")


def test_a_motion_is_planned_tick_by_tick(tmp_path):
    out = tmp_path / "online.npz"
    points = tmp_path / "points.csv"
    points.write_text("t,x,y\n0,0.2,0.06\n0.3,0.23,0.0\n0.6,0.28,-0.05\n")
    page = tmp_path / "online.html"
    files = ("--out", str(out), "--html", str(page), "--json")
    result = call("online", "--robot", "2rpr", *MASSES, "--trajectory", str(points), *files)
    facts = json.loads(result.stdout)
    plan = rp.load_plan(out)
    assert result.exit_code in (0, 4), result.stderr
    assert facts["ticks"]["ok"] == sum(facts["ticks"].values()) == 30
    assert len(facts["findings"]["singular_instants"]) == 1
    np.testing.assert_allclose(facts["peak_effort"], plan.peak_effort)
    assert facts["html"] == str(page)
    assert "2rpr" in page.read_text(encoding="utf-8").partition("<script>")[0]
    assert 0.0 < facts["milliseconds"]["p50"] <= facts["milliseconds"]["p99"]


def test_weak_carriers_are_given_more_time(tmp_path):
    circle = (
        "online",
        "--robot",
        "2rpr",
        *MASSES,
        "--trajectory",
        "circle",
        "--speed",
        "0.5",
        "--max-acceleration",
        "2",
    )
    late = call(*circle, "--slow-down", "--json", "--out", str(tmp_path / "late.npz"))
    assert late.exit_code == 0, late.stderr
    facts, plan = json.loads(late.stdout), rp.load_plan(tmp_path / "late.npz")
    assert facts["ticks"]["time_scaled"] > 0
    assert facts["ticks"]["relaxed"] == 0
    assert facts["diagnostics"]["delay"] > 0.02
    duration = rp.trajectory.reference.circle(speed=0.5).duration
    np.testing.assert_allclose(plan.t[-1], duration + facts["diagnostics"]["delay"], atol=1e-9)
    assert call(*circle, "--full-speed").exit_code != 0


def test_mistakes_are_one_line():
    assert "--horizon" in refused("online", "--robot", "2rpr", *MASSES, "--trajectory", "circle", "--horizon", "soon")
    assert "no carriers" in refused("online", "--robot", "four_bar", "--trajectory", "circle")
    assert "objective is" in refused("online", "--robot", "2rpr", "--trajectory", "circle", "--objective", "beauty")
    mistaken = ("online", "--robot", "2rpr", *MASSES, "--trajectory", "circle")
    assert "does not end in .html" in refused(*mistaken, "--html", "online.pdf")
    assert "--tick is -1 s" in refused(*mistaken, "--tick", "-1")
    assert "--start is [0.0, 0.0, 0.0]" in refused(*mistaken, "--start", "0,0,0")
