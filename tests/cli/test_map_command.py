"""``redundancy-pin map``: tables, pictures and store of a sweep, resumed, with every mistake in one line."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import pytest
from command_line import call, refused

from redundancy_pin.cli.map import problem_of
from redundancy_pin.errors import RedundancyPinError
from redundancy_pin.status import ResultStatus
from redundancy_pin.studies import feasibility
from redundancy_pin.studies.feasibility import STEPWISE, SWITCH_OFF, WHOLE, Cell, MapProblem, feasibility_map

pytest.importorskip("matplotlib")

FILES = {"store.sqlite", "map.csv", "map.json", "map.svg", "map.png"}

# one process: what the tests replace is then replaced where the cells are computed
CORNER = ("map", "--robot", "3rrr", "--x", "speed=0.1:0.3:3", "--y", "stroke=0.5,2.0", "--jobs", "1", "--refine", "0")


@pytest.fixture(autouse=True)
def in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def computed(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, float, float]]:
    """Cells at once, pictures empty: the whole-trajectory planner does all, the other what is slower than 0.25 m/s."""
    keys: list[tuple[str, float, float]] = []

    def compute(problem: MapProblem, planner: str, x: float, y: float) -> Cell:
        keys.append((planner, x, y))
        possible = planner == WHOLE or x < 0.25
        verdict, limits = (ResultStatus.OK, ("track",)) if possible else (ResultStatus.INFEASIBLE, ("effort",))
        return Cell(planner, x, y, verdict, limits, peak_effort=x if possible else None)

    monkeypatch.setattr(feasibility, "compute", compute)
    _no_pictures(monkeypatch)
    return keys


def _no_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Empty ones: the command draws some where its keys are pinned."""
    monkeypatch.setattr(feasibility, "draw", lambda found: None)
    monkeypatch.setattr(feasibility, "save", lambda figure, *paths: [path.write_bytes(b"") for path in paths])


def test_a_map_is_that_of_the_python_api(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _no_pictures(monkeypatch)
    corner = (*CORNER[:4], "speed=0.1,0.3", *CORNER[5:])
    result = call(*corner, "--planner", "stepwise", "--max-effort", "8", "--out", "here", "--json")
    assert (result.exit_code, result.stderr) == (0, "")
    assert {path.name for path in (tmp_path / "here").iterdir()} == FILES
    told = json.loads(result.stdout)
    from redundancy_pin.studies.feasibility import Axis

    problem = MapProblem(
        "3rrr",
        Axis("speed", (0.1, 0.3)),
        Axis("stroke", (0.5, 2.0)),
        "corner",
        limits={"max_effort": 8.0},
        planners=(STEPWISE,),
    )
    expected = feasibility_map(problem, jobs=1)
    assert told["planners"][STEPWISE]["counts"] == expected.counts(STEPWISE)
    assert told["planners"][STEPWISE]["border"] == [vars(crossing) for crossing in expected.border(STEPWISE)]
    assert told["problem"] == json.loads(json.dumps(problem.identity()))
    rows = list(csv.DictReader((tmp_path / "here" / "map.csv").read_text(encoding="utf-8").splitlines()))
    cells = json.loads((tmp_path / "here" / "map.json").read_text(encoding="utf-8"))["cells"]
    assert len(rows) == len(cells) == 4
    for row, cell, ours in zip(rows, cells, expected.cells, strict=True):
        assert (row["planner"], float(row["speed"]), float(row["stroke"])) == ours.key
        assert row["verdict"] == cell["verdict"] == ours.verdict.value
        assert row["limits"].split() == cell["limits"] == list(ours.limits)
        assert float(row["peak_effort"]) == cell["peak_effort"] == ours.peak_effort


@pytest.mark.long
def test_what_is_finished_is_not_computed_again(computed: list[Any]) -> None:
    assert call(*CORNER).exit_code == 0
    assert len(computed) == 12
    first = {path.name: path.read_bytes() for path in Path("map-3rrr").iterdir()}
    computed.clear()
    assert call(*CORNER).exit_code == 0
    assert computed == []
    assert {path.name: path.read_bytes() for path in Path("map-3rrr").iterdir()} == first


def test_tables_tell_counts_and_border(computed: list[Any]) -> None:
    text = call(*CORNER, "--refine", "2").stdout
    assert "3rrr, corner: cells" in text
    assert "effort 4" in text
    assert "0.225 … 0.25" in text  # 0.2 to 0.3, bisected twice
    assert "all possible" in text
    assert "map-3rrr" in text


def test_an_interruption_tells_where_to_go_on(monkeypatch: pytest.MonkeyPatch, computed: list[Any]) -> None:
    usual = feasibility.compute

    def interrupted(problem: MapProblem, planner: str, x: float, y: float) -> Cell:
        if len(computed) == 5:
            raise KeyboardInterrupt
        return usual(problem, planner, x, y)

    monkeypatch.setattr(feasibility, "compute", interrupted)
    result = call(*CORNER)
    assert result.exit_code == 130
    assert result.stderr.strip() == (
        "interrupted: 5 of 12 cells are in map-3rrr/store.sqlite; the same command goes on from there."
    )
    assert {path.name for path in Path("map-3rrr").iterdir()} == {"store.sqlite"}
    monkeypatch.setattr(feasibility, "compute", usual)
    assert call(*CORNER).exit_code == 0
    assert len(computed) == 12


def test_another_map_in_the_same_folder_is_refused(computed: list[Any]) -> None:
    call(*CORNER)
    before = {path.name: path.read_bytes() for path in Path("map-3rrr").iterdir()}
    assert "another feasibility map: for limits" in refused(*CORNER, "--max-effort", "4")
    assert {path.name: path.read_bytes() for path in Path("map-3rrr").iterdir()} == before


@pytest.mark.long
def test_failed_cells_are_told_and_nothing_but_them_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    def compute(problem: MapProblem, planner: str, x: float, y: float) -> Cell:
        failed = planner == STEPWISE and x > 0.25
        return Cell(
            planner, x, y, ResultStatus.UNRESOLVED if failed else ResultStatus.OK, message="Burst." if failed else ""
        )

    monkeypatch.setattr(feasibility, "compute", compute)
    result = call(*CORNER)
    assert result.exit_code == 0
    assert result.stderr.splitlines() == [
        "warning: stepwise failed in 2 cell(s), in the first (speed 0.3, stroke 0.5) with: Burst."
    ]
    monkeypatch.setattr(
        feasibility, "compute", lambda problem, *key: Cell(*key, ResultStatus.UNRESOLVED, message="Burst.")
    )
    assert call(*CORNER, "--out", "other").exit_code == 1


def test_matplotlib_is_asked_for_before_the_work(monkeypatch: pytest.MonkeyPatch, computed: list[Any]) -> None:
    from redundancy_pin.cli import map as module

    def missing() -> None:
        raise RedundancyPinError("Plots need matplotlib.")

    monkeypatch.setattr(module, "require_matplotlib", missing)
    assert "matplotlib" in refused(*CORNER)
    assert computed == []
    assert list(Path().iterdir()) == []


# ------------------------------------------------------------------------------------------------- what is asked for


def _problem(*arguments: str) -> MapProblem:
    from redundancy_pin.cli.map import map as command

    return problem_of(command.make_context("map", list(arguments)).params)


def test_a_robot_of_the_thesis_has_a_map_of_its_own() -> None:
    flat, turning = _problem("--robot", "2rpr"), _problem("--robot", "3rrr")
    for problem, trajectory, thesis in ((flat, "circle", SWITCH_OFF), (turning, "corner", STEPWISE)):
        assert (problem.x.name, problem.y.name) == ("speed", "stroke")
        assert problem.trajectory == trajectory
        assert problem.planners == (thesis, WHOLE)
        assert problem.backend == "virtual-work"
    assert turning.limits == {"max_effort": 5.0}


def test_what_is_given_replaces_what_is_usual() -> None:
    problem = _problem(
        "--robot", "3rrr", "--set", "carrier_mass=2", "--mode", "+-+", "--gravity", "0,-9.81,0", "--backend", "rnea",
        "--trajectory", "square:side=0.2,ramp_time=0.3", "--x", "radius=0.01:0.1:4:log", "--y", "max-effort=1,2",
        "--max-jerk", "100", "--max-speed", "inf", "--planner", "whole-trajectory",
        "--parameter", "whole-trajectory:objective=effort", "--parameter", "whole-trajectory:objective=peak=2",
        "--parameter", "whole-trajectory:datum=0.1,0,0", "--parameter", "stepwise:dt=0.01",
    )  # fmt: skip
    assert problem.settings == {"carrier_mass": 2.0}
    assert problem.mode == (1, -1, 1)
    assert problem.gravity == (0.0, -9.81, 0.0)
    assert problem.backend == "rnea"
    assert problem.options == {"side": 0.2, "ramp_time": 0.3}
    assert problem.x.scale == "log"
    assert problem.x.values == pytest.approx((0.01, 0.01 * 10 ** (1 / 3), 0.01 * 10 ** (2 / 3), 0.1))
    assert (problem.y.name, problem.y.values) == ("max_effort", (1.0, 2.0))
    assert problem.limits == {"max_jerk": 100.0}
    assert problem.planners == (WHOLE,)
    assert problem.parameters == {
        WHOLE: {"objective": {"effort": 1.0, "peak": 2.0}, "datum": [0.1, 0.0, 0.0]},
        STEPWISE: {"dt": 0.01},
    }


def test_a_path_of_ones_own(computed: list[Any]) -> None:
    path = "points:points=1.0 0.4;1.02 0.5;0.95 0.6,ramp_time=0.2,alpha=0.1"
    problem = _problem("--robot", "3rrr", "--trajectory", path)
    assert problem.options == {"points": [[1.0, 0.4], [1.02, 0.5], [0.95, 0.6]], "ramp_time": 0.2, "alpha": 0.1}
    call("map", "--robot", "3rrr", "--trajectory", path, "--x", "speed=0.1,0.2", "--jobs", "1", "--refine", "0")
    assert {x for _, x, _ in computed} == {0.1, 0.2}
    x = problem.case(WHOLE, 0.1, 1.0, {}).trajectory().sample(0.01).x
    assert x[0].tolist() == pytest.approx([1.0, 0.4, 0.1])
    assert x[-1].tolist() == pytest.approx([0.95, 0.6, 0.1])


def test_a_usual_limit_gives_way_to_an_axis_and_to_none() -> None:
    assert _problem("--robot", "3rrr", "--y", "max_effort=1:5:3").limits == {}
    assert _problem("--robot", "3rrr", "--max-effort", "inf").limits == {}
    assert _problem("--robot", "3rrr", "--trajectory", "square").limits == {}


BAD: dict[str, tuple[tuple[str, ...], str]] = {
    "axis without values": (("--x", "speed"), "no axis"),
    "axis of words": (("--x", "speed=slow:fast:3"), "no axis"),
    "axis of another form": (("--x", "speed=1:2:3:4"), "no axis"),
    "axis of half a value": (("--x", "speed=1:2:1.5"), "no axis"),
    "axis of one value": (("--x", "speed=1:2:1"), "at least two"),
    "axis upside down": (("--x", "speed=2:1:3"), "do not increase"),
    "unknown axis": (("--x", "sped=1:2:3"), "Did you mean 'speed'"),
    "same axis twice": (("--x", "stroke=1:2:3"), "Both axes are stroke"),
    "axis that is fixed": (("--stroke", "1"), "has the fixed value 1.0"),
    "axis fixed in the trajectory": (("--trajectory", "corner:speed=1"), "has the fixed value"),
    "unknown trajectory": (("--trajectory", "coner"), "Did you mean 'corner'"),
    "key that is text": (("--trajectory", "corner:radius=big"), "radius of the trajectory corner is 'big'"),
    "points that are none": (("--trajectory", "points:points=1 2;3,ramp_time=1"), "points"),
    "option that is missing": (("--trajectory", "points:points=1 2;3 4"), "lacks the option 'ramp_time'"),
    "pair that is none": (("--trajectory", "corner:radius"), "KEY=VALUE"),
    "trajectory of another robot": (("--trajectory", "circle"), "moves in 3 (x, y, rz)"),
    "mode of another robot": (("--mode", "++"), "--mode is ++, but the robot has 3 legs"),
    "planner twice": (("--planner", "stepwise", "--planner", "stepwise"), "The planners are stepwise, stepwise."),
    "limit that is text": (("--max-effort", "big"), "big"),
    "limit below zero": (("--max-effort", "-1"), "positive"),
    "no number at all": (("--max-effort", "nan"), "positive"),
    "parameter of no planner": (("--parameter", "objective=peak"), "PLANNER:NAME=VALUE"),
    "parameter of an unknown planner": (("--parameter", "step-wise:lam=0"), "Did you mean 'stepwise'"),
    "unknown parameter": (("--parameter", "stepwise:lamb=0"), "Did you mean 'lam'"),
    "parameter that is the map's": (("--parameter", "whole-trajectory:effort=1"), "Limits are those of the map"),
    "unknown planner": (("--planner", "best"), "best"),
    "no processes": (("--jobs", "0"), "jobs is 0"),
    "half a bisection": (("--refine", "0.5"), "0.5"),
    "bisection backwards": (("--refine", "-1"), "refine is -1"),
    "unknown robot": (("--robot", "4rrr"), "4rrr"),
    "robot without a usual motion": (("--robot", "five_bar"), "--trajectory"),
    "mode of letters": (("--mode", "abc"), "row of + and -"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_flags_are_refused_in_one_line(case: str, computed: list[Any]) -> None:
    extra, says = BAD[case]
    assert says in refused(*CORNER, *extra)
    assert computed == []
    assert list(Path().iterdir()) == []


def test_a_file_in_the_place_of_the_folder(computed: list[Any]) -> None:
    Path("map-3rrr").write_text("mine", encoding="utf-8")
    assert "Cannot make the folder" in refused(*CORNER)
    assert Path("map-3rrr").read_text(encoding="utf-8") == "mine"
