"""``redundancy-pin export``: the files of ``PlanTable.to_csv`` and its like, by the suffix of their names."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from command_line import call, refused
from scipy.io import loadmat

import redundancy_pin as rp
from redundancy_pin.planners.plan import Plan


@pytest.fixture(scope="module")
def made() -> Plan:
    dynamics = rp.VirtualWork(rp.load_robot("2rpr"))
    return rp.plan_switch_off(dynamics, rp.trajectory.reference.circle(), threshold=20.0, mesh=rp.Mesh(dt=0.05))


@pytest.fixture
def plan(made: Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Plan:
    monkeypatch.chdir(tmp_path)
    made.save("plan.npz")
    return made


@pytest.mark.parametrize(
    ("name", "method"), [("plan.csv", "to_csv"), ("plan.json", "to_json"), ("plan.yaml", "to_ros")]
)
def test_files_are_those_of_the_methods(name: str, method: str, plan: Plan) -> None:
    result = call("export", "plan.npz", "--to", name, "--rate", "100", "--json")
    assert result.exit_code == 0, result.stderr
    told = json.loads(result.stdout)
    assert told["rows"] == np.ceil(100 * plan.t[-1]) + 1
    assert told["joints"] == [*plan.robot.actuated, *plan.robot.carriers]
    getattr(rp.load_plan("plan.npz").table(100), method)("other" + name)
    assert Path(name).read_bytes() == Path("other" + name).read_bytes()


def test_samples_both_sides_and_messages_as_json(plan: Plan) -> None:
    assert call("export", "plan.npz", "--to", "plan.mat").exit_code == 0
    np.testing.assert_array_equal(loadmat("plan.mat")["t"][:, 0], plan.t)
    assert call("export", "plan.npz", "--to", "plan.mat", "--rate", "10", "--two-sided").exit_code == 0
    np.testing.assert_array_equal(loadmat("plan.mat")["t"][:, 0], plan.table(10, two_sided=True).t)
    assert call("export", "plan.npz", "--to", "plan.json", "--ros", "--rate", "10").exit_code == 0
    assert set(json.loads(Path("plan.json").read_text(encoding="utf-8"))) == {"header", "joint_names", "points"}


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("plan.npz", "--to", "plan.txt"), "plan.txt has no suffix that says what to write"),
        (("plan.npz", "--to", "plan.csv", "--rate", "0"), "--rate is 0 Hz"),
        (("plan.npz", "--to", "plan.csv", "--ros"), "--ros does not go with .csv"),
        (("plan.npz", "--to", "plan.yaml", "--two-sided"), "--two-sided"),
        (("nowhere.npz", "--to", "plan.csv"), "nowhere.npz"),
        (("plan.npz", "--to", "nowhere/plan.csv"), "nowhere"),
        (("plan.npz", "--to", "plan.csv", "--robot", "3rrr"), "3rrr"),
    ],
)
def test_mistakes_are_one_line_and_nothing_is_written(arguments: tuple[str, ...], says: str, plan: Plan) -> None:
    assert says in refused("export", *arguments)
    assert [path.name for path in Path().iterdir()] == ["plan.npz"]
