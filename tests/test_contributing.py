"""The page for contributors is right: what it names is there, and folders are no larger than a reader can hold."""

from __future__ import annotations

import ast
import importlib
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from doc_blocks import blocks_of

import redundancy_pin
import redundancy_pin as rp
from redundancy_pin.errors import InfeasiblePlanError, InputError
from redundancy_pin.planners.limits import QUANTITIES
from redundancy_pin.planners.optimal.objectives import OBJECTIVES

PACKAGE = Path(redundancy_pin.__file__).parent
PAGE = (Path(__file__).parents[1] / "CONTRIBUTING.md").read_text(encoding="utf-8")
MOST_MODULES = 20


def test_the_walks_lead_through_functions_that_are_there() -> None:
    walks = PAGE.partition("walks, to read along")[2].partition("Where new things go")[0]
    stops = re.findall(r"`([a-z_/]+\.py)`\s+((?:`\w+`(?:,\s+)?)+)", walks)
    assert len(stops) > 15
    for file, names in stops:
        text = (PACKAGE / file).read_text(encoding="utf-8")
        for name in re.findall(r"\w+", names):
            assert re.search(rf"(def|class) {name}\b", text), f"{file} has no {name}"


def test_every_room_of_the_table_is_there_and_every_room_is_in_it() -> None:
    rows = re.findall(r"^\| (`.*?) \|", PAGE.partition("| room |")[2].partition("Three walls")[0], re.MULTILINE)
    named = {name.rstrip("/") for row in rows for name in re.findall(r"`([a-z_/.]+)`", row)}
    own = {"__init__.py", "__init__.pyi", "__main__.py", "py.typed", "__pycache__", "models"}
    assert named == {path.name for path in PACKAGE.iterdir()} - own


def test_no_folder_has_more_modules_than_a_reader_can_hold() -> None:
    for folder in (PACKAGE, *(path for path in PACKAGE.rglob("*") if path.is_dir())):
        assert len(list(folder.glob("*.py"))) <= MOST_MODULES, folder


TESTS = Path(__file__).parent
FOREIGN = {"_asdict", "_dash_pattern", "_exit", "_fields", "_fields_", "_parallel_backends", "_replace", "_repr_html_",
           "_repr_png_", "_suptitle"}  # fmt: skip
"""Of ctypes, joblib, matplotlib, os and tuples, and what notebooks ask for."""


def test_benchmarks_and_scripts_of_documents_import_what_is_there() -> None:
    """They take longer than the tests and run apart; what moves must not leave them behind."""
    root = TESTS.parent
    files = [*(root / "benchmarks").rglob("*.py"), *(root / "docs").rglob("*.py")]
    wanted = [
        (path.name, node.module, alias.name)
        for path in files
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("redundancy_pin")
        for alias in node.names
    ]
    assert len(wanted) > 50
    gone = [row for row in wanted if not hasattr(importlib.import_module(row[1]), row[2])]
    assert gone == []


def test_tests_of_a_room_enter_the_others_by_modules_that_rooms_import_or_documents_name() -> None:
    documents = "".join(path.read_text(encoding="utf-8") for path in (TESTS.parent / "docs").rglob("*.md")) + PAGE
    entered = set(re.findall(r"redundancy_pin(?:\.\w+)+", documents)) | {
        f"redundancy_pin.{path.replace('/', '.')}" for path in re.findall(r"`(\w+/[\w/]+)\.py`", PAGE)
    }
    for path in (*PACKAGE.rglob("*.py"), PACKAGE / "__init__.pyi"):
        own = path.relative_to(PACKAGE).parts[0]
        entered |= {module for module in _imported(path) if module.split(".")[1] != own}
    inner = {
        f"{path.relative_to(TESTS)}: {module}"
        for folder in TESTS.iterdir()
        if (PACKAGE / folder.name).is_dir()
        for path in folder.rglob("*.py")
        for module in _imported(path) - entered
        if module.count(".") > 1 and module.split(".")[1] != folder.name
    }
    assert inner == set()


def _imported(path: Path) -> set[str]:
    """Return the modules of the package, below its top, that names are imported from."""
    return set(re.findall(r"^ *from (redundancy_pin\.[\w.]+) import", path.read_text(encoding="utf-8"), re.MULTILINE))


def require_limit_on_power(session: dict[str, Any]) -> None:
    """A limit of one entry is checked between samples, in refusals and, with the timing planned, kept at any speed."""
    robot, line, mesh, limited = (session[name] for name in ("robot", "line", "mesh", "limited"))
    assert {event.quantity for event in limited.limits.binding} == {"power"}
    free = rp.plan_whole_trajectory(robot, line, mesh=mesh)
    most = largest_power(free, robot)
    assert most > 1.01 * np.abs(free.main_power).max()  # between the samples
    judged = rp.Limits(further={"power": 0.8 * most}).resolved(robot)
    claimed = replace(free, limits=replace(free.limits, judged_by=judged))
    found = rp.check_plan(claimed, rp.RneaDynamics(robot))
    assert found.status.value == "limit_violated"
    event = found.violated[0]
    assert event.quantity == "power"
    assert event.amount == pytest.approx(0.2 * most, rel=2e-3)
    with pytest.raises(
        InfeasiblePlanError, match=r"every power limit by .* needed by slide_\d, from [\d.]+ to [\d.]+ W"
    ):
        rp.plan_whole_trajectory(robot, line, limits=rp.Limits(further={"power": 0.2 * most}), mesh=mesh)
    with pytest.raises(InputError, match="'powr', which is no quantity"):
        rp.plan_whole_trajectory(robot, line, limits=rp.Limits(further={"powr": 1.0}), mesh=mesh)
    three, corner = rp.load_robot("3rrr"), rp.trajectory.reference.corner()
    kept = rp.Limits(effort=3.0, further={"power": 2.0})
    least = rp.plan_time_optimal(three, corner, limits=kept, end="free", mesh=rp.Mesh(steps=20))
    assert least.status.value == "ok"
    assert 1.99 < largest_power(least, three) <= 2.0 * 1.0011


def largest_power(plan: rp.Plan, robot: rp.Robot) -> float:
    """The largest |τ q̇| of the continuous motion by RNEA, W."""
    motion = plan.platform_at(np.linspace(plan.t[0], plan.t[-1], 1001))
    reduced = rp.RneaDynamics(robot).reduce(motion, plan.carriers_at(motion.t))
    rate = np.einsum("nim,ni->nm", reduced.W, motion.xd)
    return float(np.abs(rp.distribute(reduced).tau * rate).max())


def test_recipes_work_as_they_are_written() -> None:
    """A stranger's objective, limit and planner, judged by RNEA and by numpy."""
    shipped, quantities, session = set(OBJECTIVES), set(QUANTITIES), dict[str, Any]()
    try:
        for block in blocks_of(TESTS.parent / "CONTRIBUTING.md", "CONTRIBUTING.md"):
            if block.language == "python":
                exec(compile(block.text, block.where, "exec"), session)
        require_limit_on_power(session)
    finally:
        for key in set(QUANTITIES) - quantities:
            del QUANTITIES[key]
        for name in set(OBJECTIVES) - shipped:
            del OBJECTIVES[name]
    gentle, limited, parked, robot = (session[name] for name in ("gentle", "limited", "parked", "robot"))

    def power(plan: rp.Plan) -> Any:
        reduced = rp.RneaDynamics(robot).reduce(plan.motion, plan.carriers)
        tau = np.linalg.solve(reduced.W, reduced.f[..., None])[..., 0]
        np.testing.assert_allclose(plan.tau, tau, atol=1e-6 * np.abs(tau).max())
        return tau * np.einsum("nim,ni->nm", reduced.W, plan.motion.xd)

    value = gentle.diagnostics["objective"]["power"]
    assert value == pytest.approx(np.trapezoid((power(gentle) ** 2).sum(axis=1), gentle.t), rel=1e-6)
    least_effort = rp.plan_whole_trajectory(robot, session["line"], mesh=session["mesh"])
    assert value < np.trapezoid((power(least_effort) ** 2).sum(axis=1), least_effort.t)
    bound = session["bound"]
    assert 0.9 * bound < largest_power(limited, robot) <= 1.0011 * bound
    assert np.abs(power(least_effort)).max() > bound
    assert (parked.carriers.s == 0.1).all()
    assert np.abs(power(parked)).max() > 0.0
    assert 0.0025 < np.diff(parked.t).min() <= np.diff(parked.t).max() < 0.005 + 1e-9  # even steps, of at most dt
