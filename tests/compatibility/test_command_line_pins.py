"""Programs that run ``redundancy-pin``: the keys that ``--json`` prints, and exit codes, are those of version 0.1.0."""

from __future__ import annotations

import csv
import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import call, refused
from compatibility_cases import BACKENDS, COMMANDS, DATA, EFFORTS, REPRODUCE
from interfaces import differences, structure

import redundancy_pin as rp

KEYS = json.loads((DATA / "command_line.json").read_text(encoding="utf-8"))
NEEDS = {"plan whole-trajectory": "casadi", "map": "joblib", "show": "meshcat", "study": "joblib"}


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a motion and a plan to work on."""
    shutil.copy(DATA / "motion.csv", tmp_path / "motion.csv")
    shutil.copy(DATA / "whole-line.npz", tmp_path / "plan.npz")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.long if command.slow else ()) for name, command in COMMANDS.items()]
)
def test_json_has_its_keys(name: str) -> None:
    if name in NEEDS:
        pytest.importorskip(NEEDS[name])
    command = COMMANDS[name]
    result = call(*command.arguments, "--json")
    assert result.exit_code == command.code, result.stderr
    assert differences(KEYS[name], structure(json.loads(result.stdout)), name) == []


@pytest.mark.parametrize("backend", BACKENDS)
def test_efforts_along_a_motion_are_what_they_were(backend: str) -> None:
    result = call(*EFFORTS, "--backend", backend, "--motion", "motion.csv", "--out", "efforts.csv")
    assert result.exit_code == 3, result.stderr  # no finite efforts at two instants between the samples
    with Path("efforts.csv").open() as ours, (DATA / f"efforts-{backend}.csv").open() as theirs:
        now, then = list(csv.DictReader(ours)), list(csv.DictReader(theirs))
    assert list(now[0]) == list(then[0])
    assert [row.pop("status") for row in now] == [row.pop("status") for row in then]
    for name in then[0]:
        # both backends agree to 1e-10 of the largest in the cross-check; next to a singularity efforts are large
        one, other = (np.array([float(row[name]) for row in rows]) for rows in (now, then))
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9, err_msg=name)


@pytest.mark.long
def test_json_of_the_whole_job_has_its_keys() -> None:
    """What was recorded is a job with less of everything, so that the types of its values are not all there are."""
    for package in ("matplotlib", "casadi"):
        pytest.importorskip(package)
    result = call("reproduce", "--out", "results", "--json")
    assert result.exit_code == 0, result.stderr
    facts = json.loads(result.stdout)
    assert differences(KEYS[REPRODUCE], structure(facts), REPRODUCE, types=False) == []
    assert facts == json.loads(Path("results/summary.json").read_text(encoding="utf-8"))


# ---------------------------------------------------------------------------------------------------------- exit codes

CROSSING = ("plan", "switch-off", "--robot", "2rpr", "--trajectory", "circle", "--dt", "0.02")
LIMITED = ("plan", "whole-trajectory", "--robot", "3rrr", "--trajectory", "corner", "--dt", "0.04", "--end", "free")


def test_0_when_done(folder: Path) -> None:
    assert call("info").exit_code == 0
    assert call(*CROSSING, "--threshold", "20", "--return-time", "shortest", "--out", "made.npz").exit_code == 0
    assert rp.load_plan("made.npz").status.value == "within_limits"


def test_1_when_a_check_failed(monkeypatch: pytest.MonkeyPatch) -> None:
    """One backend lies: the cross-check sees it, and the job stops before it has written anything."""
    kind = type(rp.VirtualWork(rp.load_robot("2rpr")).along(rp.trajectory.reference.circle().sample(dt=0.1)))
    honest = kind.reduce

    def lying(self: Any, *arguments: Any, **settings: Any) -> Any:
        right = honest(self, *arguments, **settings)
        return replace(right, f=-right.f)

    monkeypatch.setattr(kind, "reduce", lying)
    result = call("validate", "--robot", "2rpr", "--samples", "5", "--json")
    assert result.exit_code == 1
    assert result.stderr.startswith("error: ")
    told = json.loads(result.stdout)
    assert told["passed"] is False
    assert differences(KEYS["validate"], structure(told), "validate") == []


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("plam",), "plam"),
        (("info", "--robot", "3rr"), "3rrr"),
        (("inverse-dynamics", "--robot", "2rpr", "--motion", "nowhere.csv", "--out", "o.csv"), "nowhere.csv"),
        (("show", "--plan", "motion.csv", "--html", "seen.html"), "motion.csv"),
        ((*CROSSING, "--threshold", "-1", "--out", "made.npz"), "-1"),
    ],
)
def test_2_for_bad_input_in_one_line_and_nothing_is_written(
    arguments: tuple[str, ...], says: str, folder: Path
) -> None:
    before = sorted(folder.iterdir())
    assert says in refused(*arguments, code=2)
    assert sorted(folder.iterdir()) == before


@pytest.mark.long_for("arguments1-effort")
@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ((*CROSSING, "--set", "end_effector_mass=0.3"), "nothing can carry"),
        ((*LIMITED, "--max-effort", "0.5"), "effort"),
    ],
)
def test_2_where_no_plan_exists(arguments: tuple[str, ...], says: str, folder: Path) -> None:
    before = sorted(folder.iterdir())
    assert says in refused(*arguments, "--out", "made.npz", code=2)
    assert sorted(folder.iterdir()) == before


def test_3_where_a_plan_breaks_limits(folder: Path) -> None:
    result = call(*CROSSING, "--threshold", "5", "--out", "made.npz")
    assert result.exit_code == 3
    assert len(result.stderr.splitlines()) == 1
    assert rp.load_plan("made.npz").status.value == "violates_limits"


def test_4_where_a_plan_is_no_optimum(monkeypatch: pytest.MonkeyPatch, folder: Path) -> None:
    """A tolerance that no solver meets: it ends at a point that keeps every limit and is not proved to be the best."""
    casadi = pytest.importorskip("casadi")
    usual = casadi.nlpsol

    def restless(name: str, solver: str, problem: Any, settings: dict[str, Any]) -> Any:
        return usual(name, solver, problem, {**settings, "ipopt.tol": 1e-30})

    monkeypatch.setattr(casadi, "nlpsol", restless)
    circle = COMMANDS["plan whole-trajectory"].arguments
    result = call(*circle, "--out", "made.npz", "--json")
    assert result.exit_code == 4
    assert len(result.stderr.splitlines()) == 1
    assert json.loads(result.stdout)["status"] == "stopped_early"
    plan = rp.load_plan("made.npz")
    assert (plan.status.value, plan.diagnostics["optimal"], plan.limits.violated) == ("stopped_early", False, ())
