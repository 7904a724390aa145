"""``redundancy-pin plan``: every mistake in its flags is refused in one line, and nothing is written."""

from __future__ import annotations

from pathlib import Path

import pytest
from command_line import refused, write_motion
from plan_cases import LINE, PROBLEM, write_problem

from redundancy_pin.trajectory import reference

BAD_FLAGS: dict[str, tuple[tuple[str, ...], str]] = {
    "two motions": (("--motion", "m.csv"), "either --trajectory or --motion"),
    "unknown trajectory": (("--trajectory", "lien"), "Did you mean 'line'"),
    "key of another trajectory": (("--radius", "0.1"), "no key 'radius'"),
    "key twice": (("--trajectory", "line:speed=0.1", "--speed", "0.2"), "given twice"),
    "pair that is none": (("--trajectory", "line:speed"), "KEY=VALUE"),
    "speed that is text": (("--speed", "fast"), "fast"),
    "threshold that is text": (("--threshold", "high"), "threshold is 'high'"),
    "threshold below one": (("--threshold", "0.5"), "threshold"),
    "unknown measure": (("--measure", "distance"), "distance"),
    "unknown scheme": (("--scheme", "euler"), "euler"),
    "unknown return": (("--return-time", "longest"), "longest"),
    "datum of three": (("--datum", "0,0,0"), "datum"),
    "datum that is text": (("--datum", "abc"), "datum"),
    "ramp of nothing": (("--ramp-down", "0"), "ramp_down"),
    "samples of nothing": (("--dt", "-1"), "dt"),
    "no such folder": (("--out", "nowhere/plan.npz"), "nowhere"),
    "picture of no format": (("--plot", "plan.txt"), "picture format"),
    "picture in no folder": (("--plot", "nowhere/plan.png"), "nowhere"),
    "both in one file": (("--out", "a.png", "--plot", "a.png"), "same file"),
    "unknown option": (("--treshold", "5"), "--treshold"),
    "unknown parameter": (("--set", "carrier_mas=2"), "carrier_mass"),
    "return that does not end": (("--return-time", "100"), "return"),
    "mass that nothing carries": (("--set", "end_effector_mass=1", "--trajectory", "circle"), "nothing can carry"),
}


@pytest.mark.parametrize("case", BAD_FLAGS)
def test_bad_flags_are_refused_in_one_line(case: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    extra, says = BAD_FLAGS[case]
    assert says in refused(*LINE, "--out", "plan.npz", *extra)
    assert list(tmp_path.iterdir()) == []


def test_inputs_are_not_overwritten(tmp_path: Path) -> None:
    motion = write_motion(tmp_path / "motion.csv", reference.corner(), 0.05)
    before = motion.read_bytes()
    assert "--out" in refused("plan", "stepwise", "--robot", "3rrr", "--motion", motion, "--out", motion)
    assert motion.read_bytes() == before
    problem = write_problem(tmp_path / "p.yaml", **PROBLEM)
    before = problem.read_bytes()
    assert "--out" in refused("plan", "--problem", problem, "--out", problem)
    assert problem.read_bytes() == before


def test_flags_do_not_apply_to_a_motion_from_a_file(tmp_path: Path) -> None:
    motion = write_motion(tmp_path / "motion.csv", reference.corner(), 0.05)
    base = ("plan", "stepwise", "--robot", "3rrr", "--motion", motion)
    assert "--ramp-time" in refused(*base, "--ramp-time", "0.2")
    assert "own steps" in refused(*base, "--step", "0.2")


def test_a_robot_without_carriers_has_nothing_to_plan() -> None:
    assert "carrier" in refused(
        "plan", "stepwise", "--robot", "3rrr", "--set", "carriers=false", "--trajectory", "corner"
    )


def test_plan_alone_and_options_in_the_wrong_place(tmp_path: Path) -> None:
    assert "--problem" in refused("plan")
    assert "--problem" in refused("plan", "--out", tmp_path / "a.npz", *LINE[1:])


def test_a_picture_that_fails_leaves_no_plan(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from redundancy_pin.cli import plan_output
    from redundancy_pin.errors import OutputError

    def fail(*_: object) -> None:
        raise OutputError("The disk is full.")

    monkeypatch.setattr(plan_output, "save", fail)
    assert "full" in refused(*LINE, "--out", tmp_path / "plan.npz", "--plot", tmp_path / "plan.png")
    assert list(tmp_path.iterdir()) == []
