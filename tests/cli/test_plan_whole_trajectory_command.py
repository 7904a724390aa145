"""``redundancy-pin plan whole-trajectory``: the plans of the Python API; one that is no optimum never passes as one."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from command_line import call, refused

import redundancy_pin as rp
from redundancy_pin.cli.plan_problem import weights
from redundancy_pin.errors import InputError
from redundancy_pin.planners.optimal import nlp as whole_trajectory_solver
from redundancy_pin.planners.plan import Plan
from redundancy_pin.status import ResultStatus
from redundancy_pin.trajectory import reference

pytest.importorskip("casadi")

CIRCLE = (
    "plan", "whole-trajectory", "--robot", "2rpr", "--backend", "virtual-work",
    "--trajectory", "circle", "--ramp-length", "0.05", "--dt", "0.02",
)  # fmt: skip
CORNER = (
    "plan", "whole-trajectory", "--robot", "3rrr", "--mode", "+++", "--backend", "virtual-work",
    "--trajectory", "corner", "--dt", "0.03",
)  # fmt: skip


def _corner_robot(**arguments: Any) -> rp.VirtualWork:
    return rp.VirtualWork(rp.load_robot("3rrr", working_mode=(1, 1, 1), **arguments))


def _same(ours: Plan, theirs: Plan) -> None:
    """The same computation on the same input: equal to the last bit."""
    for name in ("tau", "carrier_force", "sample_status"):
        np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name), err_msg=name)
    np.testing.assert_array_equal(ours.motion.t, theirs.motion.t)
    np.testing.assert_array_equal(ours.carriers.sdd, theirs.carriers.sdd)
    assert ours.status is theirs.status
    assert ours.limits == theirs.limits


def test_every_flag_reaches_the_planner(tmp_path: Path) -> None:
    out, plot = tmp_path / "plan.npz", tmp_path / "plan.svg"
    result = call(
        *CORNER, "--objective", "effort", "--objective", "peak=0.5", "--objective", "tracking=2", "--lam", "0.3",
        "--calm", "0.02", "--baseline", "carriers=false", "--start", "0.01,0,-0.01", "--start-speed", "0.02",
        "--end", "rest", "--datum", "0.001", "--track", "-0.5,0.6", "--max-speed", "0.9,0.8,0.7",
        "--max-acceleration", "6", "--max-jerk", "3000", "--max-effort", "20,30,40", "--max-carrier-force", "60",
        "--starts", "2", "--seconds", "30", "--refinements", "1", "--out", out, "--plot", plot,
    )  # fmt: skip
    assert result.exit_code == 0, result.stderr
    expected = rp.plan_whole_trajectory(
        _corner_robot(),
        reference.corner(),
        objective=rp.Objective(
            {"effort": 1.0, "peak": 0.5, "tracking": 2.0}, lam=0.3, calm=0.02, baseline=_corner_robot(carriers=False)
        ),
        start=[0.01, 0.0, -0.01],
        start_speed=0.02,
        end="rest",
        datum=0.001,
        limits=rp.Limits(
            track=[-0.5, 0.6],
            speed=[0.9, 0.8, 0.7],
            acceleration=6.0,
            jerk=3000.0,
            effort=[20.0, 30.0, 40.0],
            carrier_force=60.0,
        ),
        mesh=rp.Mesh(dt=0.03, refinements=1),
        solver=rp.Solver(starts=2, seconds=30.0),
    )
    plan = rp.load_plan(out)
    _same(plan, expected)
    assert plan.parameters == expected.parameters
    assert plan.diagnostics["starts"] == expected.diagnostics["starts"]
    assert plot.read_text(encoding="utf-8").startswith("<?xml")
    assert "effort, 0.5 peak, 2 tracking" in result.stdout
    assert "local optimum in" in result.stdout
    assert f"{plan.least_cost:.6g}" in result.stdout


def test_a_plan_through_a_singularity_is_saved_and_told(tmp_path: Path) -> None:
    out = tmp_path / "plan.npz"
    result = call(*CIRCLE, "--objective", "effort", "--json", "--out", out)
    assert (result.exit_code, result.stderr) == (0, "")
    told, plan = json.loads(result.stdout), rp.load_plan(out)
    assert plan.status is ResultStatus.OK
    assert told["status"] == "ok"
    assert told["optimal"] is True
    assert told["smallest_margin"] == 0.0
    assert told["peak_effort"] == plan.peak_effort.tolist()
    assert told["findings"]["singular_instants"] == list(plan.findings.singular_instants)
    assert len(told["findings"]["singular_instants"]) == 2


@pytest.mark.long
def test_a_problem_file_gives_the_plan_of_the_flags(tmp_path: Path) -> None:
    one, other, problem = tmp_path / "one.npz", tmp_path / "other.npz", tmp_path / "p.yaml"
    data = {
        "planner": "whole-trajectory",
        "robot": "2rpr",
        "backend": "virtual-work",
        "trajectory": {"name": "circle", "ramp_length": 0.05},
        "parameters": {"objective": {"effort": 1, "peak": 2e-1}, "track": [[-0.1, 0.1], [-0.15, 0.15]], "dt": 0.04},
    }
    problem.write_text(yaml.safe_dump(data), encoding="utf-8")
    assert call("plan", "--problem", problem, "--out", one).exit_code == 0
    data["parameters"] = {**data["parameters"], "objective": "peak"}  # type: ignore[dict-item]
    problem.write_text(yaml.safe_dump(data), encoding="utf-8")
    assert call("plan", "--problem", problem, "--out", other).exit_code == 0
    first, second = rp.load_plan(one), rp.load_plan(other)
    assert first.parameters["objective"] == {"effort": 1.0, "peak": 0.2}
    assert second.parameters["objective"] == {"peak": 1.0}
    assert first.limits.judged_by.track.tolist() == [[-0.1, 0.1], [-0.15, 0.15]]
    assert np.abs(first.carriers.s).max(axis=0)[0] <= 0.1


@pytest.fixture
def restless(monkeypatch: pytest.MonkeyPatch) -> None:
    """A tolerance that no solver can meet: it ends at a point that keeps every limit and is proved no optimum."""
    monkeypatch.setattr(whole_trajectory_solver, "TOLERANCE", 1e-30)


@pytest.mark.long
@pytest.mark.usefixtures("restless")
def test_a_plan_that_stopped_early_is_never_an_optimum(tmp_path: Path) -> None:
    out = tmp_path / "plan.npz"
    coarse = (*CIRCLE, "--dt", "0.08", "--refinements", "0")
    result = call(*coarse, "--out", out)
    assert result.exit_code == 4
    (line,) = result.stderr.splitlines()
    assert line.startswith("warning: this is no optimum")
    assert "not converged" in result.stdout
    assert "NOT an optimum" in result.stdout
    assert "local optimum" not in result.stdout
    plan = rp.load_plan(out)
    assert plan.status is ResultStatus.NOT_CONVERGED
    assert plan.findings.optimal is False
    # every limit holds all the same: that is what separates exit code 4 from 3
    assert not plan.limits.violated
    told = json.loads(call(*coarse, "--json").stdout)
    assert (told["status"], told["optimal"]) == ("not_converged", False)


@pytest.mark.long
@pytest.mark.usefixtures("restless")
def test_the_picture_of_a_plan_that_stopped_early_says_so() -> None:
    pytest.importorskip("matplotlib")
    from redundancy_pin.visualisation.figures.curves import plan_title

    dynamics = rp.VirtualWork(rp.load_robot("2rpr"))
    plan = rp.plan_whole_trajectory(dynamics, reference.circle(ramp_length=0.05), mesh=rp.Mesh(dt=0.05))
    assert plan_title(plan) == "2rpr: whole trajectory, not converged, NOT an optimum"


@pytest.mark.long
def test_an_impossible_task_names_the_limit_and_what_would_suffice(tmp_path: Path) -> None:
    task = (*CORNER, "--max-effort", "1", "--end", "free")
    message = refused(*task, "--out", tmp_path / "plan.npz")
    assert "What would suffice" in message
    match = re.search(r"the acceleration of carrier_\d, from 7 to (\S+) m", message)
    assert match, message
    assert list(tmp_path.iterdir()) == []
    # what would suffice does, and less does not; the nodes are refined meanwhile, which moves it by a percent at most
    assert call(*task, "--max-acceleration", f"{1.01 * float(match[1])}").exit_code == 0
    assert call(*task, "--max-acceleration", f"{0.99 * float(match[1])}").exit_code == 2


def test_efforts_between_the_nodes_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("redundancy_pin.planners.intersample_check.ALLOWED", 0.5)  # any plan exceeds it
    result = call(*CIRCLE, "--refinements", "0")
    assert result.exit_code == 4
    assert "unresolved" in result.stdout
    assert "warning: between the samples the efforts are" in result.stderr


BAD_FLAGS: dict[str, tuple[tuple[str, ...], str]] = {
    "unknown objective": (("--objective", "efort"), "efort"),
    "objective twice": (("--objective", "peak=1", "--objective", "peak=2"), "twice"),
    "weight that is text": (("--objective", "peak=high"), "the weight of peak is 'high'"),
    "weight below zero": (("--objective", "peak=-1"), "-1"),
    "no weight at all": (("--objective", "peak=0"), "every weight is zero"),
    "fraction of no baseline": (("--objective", "tracking", "--lam", "0.5"), "--baseline"),
    "unknown end": (("--end", "resting"), "resting"),
    "half a guess": (("--starts", "1.5"), "whole number"),
    "no guess": (("--starts", "0"), "starts"),
    "refinements below zero": (("--refinements", "-1"), "refinements"),
    "no time": (("--seconds", "0"), "seconds"),
    "datum off the track": (("--datum", "0.5"), "datum"),
    "limits of another robot": (("--max-effort", "1,2,3"), "effort"),
    "limit of nothing": (("--max-jerk", "0"), "jerk"),
    "force that is text": (("--max-carrier-force", "big"), "--max-carrier-force is 'big'"),
    "flag of another planner": (("--threshold", "5"), "--threshold"),
}


@pytest.mark.parametrize("case", BAD_FLAGS)
def test_bad_flags_are_refused_in_one_line(case: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    extra, says = BAD_FLAGS[case]
    assert says in refused(*CIRCLE, "--out", "plan.npz", *extra)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"step": 0.01}, "takes no step"),
        ({"parameters": {"objective": 3}}, "objective is 3"),
        ({"parameters": {"objective": {"peak": "high"}}}, "the weight of peak"),
        ({"parameters": {"objektive": "peak"}}, "Did you mean 'objective'"),
    ],
)
def test_bad_problems_are_refused_in_one_line(changes: dict[str, Any], says: str, tmp_path: Path) -> None:
    problem = tmp_path / "p.yaml"
    data = {"planner": "whole-trajectory", "robot": "2rpr", "trajectory": {"name": "circle"}, **changes}
    problem.write_text(yaml.safe_dump(data), encoding="utf-8")
    assert says in refused("plan", "--problem", problem)


def test_weights_as_users_write_them() -> None:
    assert weights("objective", ("effort",)) == "effort"
    assert weights("objective", "effort") == "effort"
    assert weights("objective", ("effort", "peak=2")) == {"effort": 1.0, "peak": 2.0}
    assert weights("objective", {"peak": "1e-1"}) == {"peak": 0.1}
    for value in (None, 1, [1], ("peak=", "effort")):
        with pytest.raises(InputError):
            weights("objective", value)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ("1,2", "--max-effort is [1.0, 2.0], expected 3 numbers or one."),
        ("1,-2,3", "--max-effort is [1.0, -2.0, 3.0], but limits must be positive. Pass inf for no limit."),
    ],
)
def test_wrong_limits_are_said_as_they_were_typed(given: str, said: str) -> None:
    assert refused("plan", "whole-trajectory", "--robot", "3rrr", "--trajectory", "corner", "--max-effort", given) == (
        f"error: {said}"
    )


@pytest.mark.long_for("objective1-0-False")
@pytest.mark.parametrize(
    ("objective", "calm", "advised"),
    [(("effort",), "0", True), (("effort", "effort_rate=0.01"), "0", False), (("effort",), "0.01", False)],
)
def test_efforts_that_swing_beside_singularities_are_calmed_by_what_the_plan_proposes(
    objective: tuple[str, ...], calm: str, advised: bool
) -> None:
    flags = [part for entry in objective for part in ("--objective", entry)]
    told = json.loads(call(*CIRCLE, "--dt", "0.01", *flags, "--calm", calm, "--json").stdout)
    assert told["backend"] == "virtual-work"  # as --backend writes it, not by its class
    if advised:
        assert "--objective effort --objective effort_rate=0.01" in told["advice"]
        assert max(told["reversals"]) > 20
    else:
        assert told["advice"] is None
        assert max(told["reversals"]) < 10


def test_balancing_from_flags_says_what_the_base_feels() -> None:
    flags = ("--set", "carrier_mass=3", "--max-speed", "5", "--max-acceleration", "20", "--track=-1,1", "--end", "free")
    told = json.loads(
        call(*CORNER, *flags, "--objective", "base_wrench", "--base-point", "0.866,0.5,0", "--json").stdout
    )
    assert told["base_point"] == [0.866, 0.5, 0.0]
    assert max(told["peak_base_force"], told["peak_base_moment"]) < 1e-3
