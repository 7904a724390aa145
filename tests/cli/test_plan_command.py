"""``redundancy-pin plan``: the plans of the Python API, limits told by the exit code."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import call, write_motion
from plan_cases import CORNER, LINE, same

import redundancy_pin as rp
from redundancy_pin.cli.plan import warn
from redundancy_pin.cli.plan_problem import number, numbers
from redundancy_pin.errors import InputError
from redundancy_pin.planners.stepwise.planner import plan_stepwise
from redundancy_pin.planners.switch_off.planner import plan_switch_off
from redundancy_pin.status import ResultStatus
from redundancy_pin.trajectory import from_csv, reference


def test_switch_off_is_that_of_the_python_api(tmp_path: Path) -> None:
    out, plot = tmp_path / "plan.npz", tmp_path / "plan.png"
    result = call(
        "plan", "switch-off", "--robot", "2rpr", "--set", "carrier_mass=2.0", "--backend", "virtual-work",
        "--trajectory", "circle", "--speed", "0.6", "--threshold", "7", "--return-time", "0.5", "--ramp-down", "0.02",
        "--dt", "0.02", "--datum", "0.01,-0.01", "--out", str(out), "--plot", str(plot),
    )  # fmt: skip
    robot = rp.load_robot("2rpr", carrier_mass=2.0)
    expected = plan_switch_off(
        rp.VirtualWork(robot),
        reference.circle(speed=0.6),
        threshold=7.0,
        return_time=0.5,
        ramp_down=0.02,
        mesh=rp.Mesh(dt=0.02),
        datum=[0.01, -0.01],
    )
    plan = rp.load_plan(out)
    same(plan, expected)
    assert plan.parameters["datum"] == [0.01, -0.01]
    assert plot.read_bytes().startswith(b"\x89PNG")
    # this crossing breaks limits: said by the exit code, in one line, and in the table
    assert expected.status is ResultStatus.LIMIT_VIOLATED
    assert result.exit_code == 3
    assert len(result.stderr.splitlines()) == 1
    worst = max(expected.limits.violated, key=lambda event: (event.quantity == "track", event.amount))
    assert f"{worst.quantity} of {worst.joint} by {worst.amount:.3g}" in result.stderr
    assert "limit violated" in result.stdout
    assert f"{expected.peak_effort[0]:.6g}" in result.stdout
    assert f"{expected.carrier_energy:.6g}" in result.stdout


@pytest.mark.long
def test_a_plan_within_limits_is_silent_on_stderr(tmp_path: Path) -> None:
    out = tmp_path / "plan.npz"
    result = call(*LINE, "--out", out)
    assert (result.exit_code, result.stderr) == (0, "")
    expected = plan_switch_off(
        rp.RneaDynamics(rp.load_robot("2rpr")), reference.line(), threshold=4.0, mesh=rp.Mesh(dt=0.01)
    )
    assert expected.status is ResultStatus.OK
    same(rp.load_plan(out), expected)


def test_stepwise_is_that_of_the_python_api(tmp_path: Path) -> None:
    out = tmp_path / "plan.npz"
    result = call(
        *CORNER, "--radius", "0.03", "--lam", "0.5", "--baseline", "carriers=false", "--max-speed", "0.8",
        "--max-acceleration", "6,7,8", "--track", "-0.9,0.9", "--brake-time", "0.4", "--no-anticipate", "--out", out,
    )  # fmt: skip
    assert result.exit_code == 4, result.stderr  # steps of 20 ms do not show the efforts between them
    assert "between the samples" in result.stderr
    expected = plan_stepwise(
        rp.load_robot("3rrr", working_mode=(1, 1, 1)),
        reference.corner(radius=0.03).sample(0.02),
        objective=rp.Objective(
            lam=0.5, baseline=rp.CompiledDynamics(rp.load_robot("3rrr", working_mode=(1, 1, 1), carriers=False))
        ),
        limits=rp.Limits(speed=0.8, acceleration=[6.0, 7.0, 8.0], track=[-0.9, 0.9]),
        brake_time=0.4,
        anticipate=False,
    )
    same(rp.load_plan(out), expected)


def test_a_motion_from_a_file(tmp_path: Path) -> None:
    motion, out = write_motion(tmp_path / "motion.csv", reference.corner(), 0.02), tmp_path / "plan.npz"
    result = call("plan", "stepwise", "--robot", "3rrr", "--motion", motion, "--out", out)
    assert result.exit_code == 0, result.stderr
    same(rp.load_plan(out), plan_stepwise("3rrr", from_csv(motion)))


def test_flags_and_keys_of_a_trajectory_are_thesame(tmp_path: Path) -> None:
    one, other = tmp_path / "one.npz", tmp_path / "other.npz"
    base = ("plan", "stepwise", "--robot", "3rrr", "--step", "0.02")
    call(*base, "--trajectory", "square", "--speed", "0.15", "--side", "0.1", "--out", one)
    call(*base, "--trajectory", "square:speed=0.15,side=0.1", "--out", other)
    assert one.read_bytes() == other.read_bytes()
    t = rp.load_plan(one).motion.t
    assert t[-1] >= reference.square(speed=0.15, side=0.1).duration


def test_json_is_pure_and_tells_what_the_plan_holds(tmp_path: Path) -> None:
    out = tmp_path / "plan.npz"
    result = call(*CORNER, "--json", "--out", out)
    facts, plan = json.loads(result.stdout), rp.load_plan(out)
    assert facts["status"] == plan.status.value
    assert facts["peak_effort"] == plan.peak_effort.tolist()
    assert facts["main_energy"] == plan.main_energy
    assert len(facts["limits"]["binding"]) == len(plan.limits.binding)
    assert facts["parameters"]["lam"] == 0.0
    assert facts["out"] == str(out)


def test_points_of_the_command_line(tmp_path: Path) -> None:
    out = tmp_path / "plan.npz"
    path = "points:points=1.0 0.4;1.02 0.5;0.95 0.6,speed=0.1,ramp_time=0.2,alpha=0.1"
    assert (
        call("plan", "stepwise", "--robot", "3rrr", "--dt", "0.02", "--trajectory", path, "--out", out).exit_code == 4
    )
    x = rp.load_plan(out).motion.x
    np.testing.assert_allclose(x[0], [1.0, 0.4, 0.1], atol=1e-12)
    np.testing.assert_allclose(x[-1], [0.95, 0.6, 0.1], atol=1e-12)
    at = call(
        "plan", "stepwise", "--robot", "3rrr", "--step", "0.02", "--trajectory", "corner:start=1.0 0.45", "--json"
    )
    assert json.loads(at.stdout)["status"] == "ok"


def test_the_table_has_what_the_plan_says(tmp_path: Path) -> None:
    out = tmp_path / "plan.npz"
    lines = call(*CORNER, "--out", out).stdout.splitlines()
    plan = rp.load_plan(out)
    assert lines[0].strip() == "3rrr, stepwise, compiled"  # the backend as --backend names it
    # a limit of the size: the carrier meets it in its negative sense
    assert plan.limits.binding[0].limit == -1.0
    assert any("speed of carrier_2 at its limit 1 m/s" in line for line in lines)
    (turns,) = [line for line in lines if "reversals above 5 % of the peak" in line]
    assert [int(number) for number in re.findall(r"\d+", turns.partition("peak")[2])] == counted(plan.tau)


def counted(tau: np.ndarray) -> list[int]:
    """How often each column turns round and moves back by more than a twentieth of the largest magnitude."""
    least, by_joint = 0.05 * np.abs(tau).max(), []
    for effort in tau.T:
        turns, sense, low, high = 0, 0, effort[0], effort[0]
        for value in effort:
            low, high = min(low, value), max(high, value)
            back = -1 if high - value > least else 1 if value - low > least else 0
            if back and back != sense:
                turns, sense = turns + (sense != 0), back
            if back:
                low = high = value
        by_joint.append(turns)
    return by_joint


def test_the_case_of_a_suffix_is_free(tmp_path: Path) -> None:
    out = tmp_path / "PLAN.NPZ"
    assert call(*CORNER, "--out", out).exit_code == 0
    assert rp.load_plan(out).status is ResultStatus.OK


def test_nothing_need_be_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert call(*CORNER).exit_code == 0
    assert list(tmp_path.iterdir()) == []


def test_examples_in_the_help_keep_their_lines() -> None:
    for command in ((), ("switch-off",), ("stepwise",), ("whole-trajectory",)):
        lines = [line.strip() for line in call("plan", *command, "--help").stdout.splitlines()]
        assert any(line.startswith("redundancy-pin plan") and line.endswith("\\") for line in lines)
        assert not any("\\b" in line for line in lines)


def test_numbers_as_users_write_them() -> None:
    assert number("x", "1e-3") == 1e-3
    assert numbers("x", "0.1, -0.2").tolist() == [0.1, -0.2]
    assert numbers("x", [[1, 2], ["3e0", 4]]).tolist() == [[1.0, 2.0], [3.0, 4.0]]
    for value in ("", None, {}, True, [None], [1, [2]], 10**400):
        with pytest.raises(InputError, match="x is"):
            numbers("x", value)


def test_a_plan_through_a_singularity_has_no_margin_left() -> None:
    """Whether a sample lies on the singular instant is chance: the plan crosses it all the same."""
    result = call("plan", "switch-off", "--robot", "2rpr", "--trajectory", "circle", "--threshold", "20",
                  "--dt", "0.01", "--json")  # fmt: skip
    assert json.loads(result.stdout)["smallest_margin"] == 0.0


def test_efforts_without_bound_between_the_samples_are_one_warning(capsys: pytest.CaptureFixture[str]) -> None:
    plan = plan_stepwise(rp.VirtualWork(rp.load_robot("3rrr")), reference.corner(), mesh=rp.Mesh(dt=0.02))
    between = replace(plan.between, peak=np.array([1.0, np.inf, 2.0]), time=np.array([0.1, 0.2, 0.3]), ratio=np.inf)
    warn(replace(plan, status=ResultStatus.UNBOUNDED, between=between))
    assert capsys.readouterr().err == (
        "warning: no finite main efforts: between the samples, at t = 0.2 s, where W is singular.\n"
    )


def test_no_optimum_is_warned_of_whatever_the_status(capsys: pytest.CaptureFixture[str]) -> None:
    plan = plan_stepwise(rp.VirtualWork(rp.load_robot("3rrr")), reference.corner(), mesh=rp.Mesh(dt=0.02))
    findings = replace(plan.findings, optimal=False, solver="Time_Exceeded")
    for status in (ResultStatus.NOT_CONVERGED, ResultStatus.UNRESOLVED, ResultStatus.UNBOUNDED):
        warn(replace(plan, status=status, findings=findings))
        assert "this is no optimum: the optimiser stopped early (Time_Exceeded)" in capsys.readouterr().err
    warn(plan)
    assert capsys.readouterr().err == ""
