"""``redundancy-pin check``: exit codes, JSON, and a plan that was edited."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import call

import redundancy_pin as rp
from redundancy_pin.planners.plan import Plan
from redundancy_pin.trajectory import reference


@pytest.fixture(scope="module")
def plans() -> dict[int, Plan]:
    """Plans by the exit code of ``plan``."""
    dynamics, corner = rp.VirtualWork(rp.load_robot("3rrr")), reference.corner()
    return {
        0: rp.plan_stepwise(dynamics, corner, mesh=rp.Mesh(dt=0.02)),
        3: rp.plan_switch_off(rp.VirtualWork(rp.load_robot("2rpr")), reference.circle(), mesh=rp.Mesh(dt=0.01)),
        4: rp.plan_stepwise(dynamics, corner.sample(dt=0.02, two_sided=False)),
    }


@pytest.mark.long_for("3")
@pytest.mark.parametrize("code", [0, 3, 4])
def test_a_plan_that_is_what_it_says_has_the_code_it_was_planned_with(code: int, plans, tmp_path: Path) -> None:
    path = tmp_path / "plan.npz"
    plans[code].save(path)
    result = call("check", str(path), "--json")
    assert result.exit_code == code
    facts = json.loads(result.stdout)
    assert facts["passed"]
    assert facts["status"] == facts["saved_status"] == plans[code].status.value
    np.testing.assert_allclose(facts["peak_effort"], plans[code].peak_effort, rtol=1e-3)
    table = call("check", str(path), "--backend", "virtual-work")
    assert table.exit_code == code
    assert "yes" in table.stdout


def test_limits_wider_than_the_robots_are_in_table_and_json(plans, tmp_path: Path) -> None:
    path, limits = tmp_path / "plan.npz", plans[0].limits
    wide = replace(limits.judged_by, speed=np.full(3, 99.0))
    replace(plans[0], limits=replace(limits, judged_by=wide)).save(path)
    result = call("check", str(path))
    assert result.exit_code == 0
    assert "wider limit" in result.stdout
    assert len(json.loads(call("check", str(path), "--json").stdout)["wider_limits"]) == 3


def test_an_edited_plan_is_a_failed_check(plans, tmp_path: Path) -> None:
    path = tmp_path / "plan.npz"
    replace(plans[0], tau=np.array(plans[0].tau) * 1.01).save(path)
    result = call("check", str(path))
    assert result.exit_code == 1
    assert "do not balance the motion" in result.stderr
    assert "NO" in result.stdout
    assert json.loads(call("check", str(path), "--json").stdout)["deviations"][0]["quantity"] == "main efforts"


def test_what_is_no_plan_is_bad_input(tmp_path: Path) -> None:
    result = call("check", str(tmp_path / "nowhere.npz"))
    assert result.exit_code == 2
    assert "does not exist" in result.stderr
