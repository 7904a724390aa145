"""``redundancy-pin plan``: every mistake in its flags is refused in one line, and nothing is written."""

from __future__ import annotations

from pathlib import Path

import pytest
from command_line import refused, write_motion
from plan_cases import CORNER, LINE, PROBLEM, write_problem

from redundancy_pin.trajectory import reference

BAD_FLAGS: dict[str, tuple[tuple[str, ...], str]] = {
    "two motions": (("--motion", "m.csv"), "either --trajectory or --motion"),
    "unknown trajectory": (("--trajectory", "lien"), "Did you mean 'line'"),
    "key of another trajectory": (("--radius", "0.1"), "takes no --radius. It takes speed"),
    "misspelt key": (("--trajectory", "line:sped=0.1"), "Did you mean 'speed'"),
    "key twice": (("--trajectory", "line:speed=0.1", "--speed", "0.2"), "Leave --speed or speed= out"),
    "pair that is none": (("--trajectory", "line:speed"), "KEY=VALUE"),
    "key that is text": (("--trajectory", "line:speed=a;b"), "neither a number nor rows"),
    "key of nothing": (("--trajectory", "line:speed="), "neither a number nor rows"),
    "speed that is text": (("--speed", "fast"), "fast"),
    "speed that is negative": (("--speed", "-1"), "--speed is -1 m/s"),
    "time that is negative": (("--ramp-time", "-1"), "--ramp-time is -1 s"),
    "trajectory of another robot": (("--trajectory", "corner"), "Choose the trajectory circle, line, points with 2"),
    "threshold that is text": (("--threshold", "high"), "--threshold is 'high'"),
    "threshold below one": (("--threshold", "0.5"), "--threshold is 0.5"),
    "threshold without end": (("--threshold", "inf"), "--threshold is inf, expected a positive number."),
    "unknown measure": (("--measure", "distance"), "--measure is 'distance'"),
    "unknown return": (("--return-time", "longest"), "--return-time is 'longest'"),
    "datum of three": (("--datum", "0,0,0"), "--datum is [0.0, 0.0, 0.0], expected 2 numbers"),
    "datum that is text": (("--datum", "abc"), "--datum is 'abc'"),
    "datum off the track": (("--datum", "1"), "--datum puts carrier_1 at 1 m"),
    "ramp of nothing": (("--ramp-down", "0"), "--ramp-down is 0 s"),
    "samples of nothing": (("--dt", "-1"), "--dt is -1 s"),
    "mode of another robot": (("--mode", "+++"), "--mode is +++, but the robot has 2 legs"),
    "gravity without end": (("--gravity", "0,inf,0"), "not three numbers"),
    "no such folder": (("--out", "nowhere/plan.npz"), "nowhere"),
    "plan of another kind": (("--out", "plan.txt"), "--out plan.txt does not end in .npz. Write --out plan.npz."),
    "plan of no kind": (("--out", "plan"), "Write --out plan.npz."),
    "picture of no format": (("--plot", "plan.txt"), "picture format"),
    "picture in no folder": (("--plot", "nowhere/plan.png"), "nowhere"),
    "unknown option": (("--treshold", "5"), "--treshold"),
    "unknown parameter": (("--set", "carrier_mas=2"), "carrier_mass"),
    "return that does not end": (("--return-time", "100"), "Shorten --return-time"),
    "mass that nothing carries": (("--set", "end_effector_mass=1", "--trajectory", "circle"), "nothing can carry"),
}


@pytest.mark.parametrize("case", BAD_FLAGS)
def test_bad_flags_are_refused_in_one_line(case: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    extra, says = BAD_FLAGS[case]
    assert says in refused(*LINE, "--out", "plan.npz", *extra)
    assert list(tmp_path.iterdir()) == []


STEPWISE_FLAGS: dict[str, tuple[tuple[str, ...], str]] = {
    "step of nothing": (("--step", "0"), "--step is 0 s"),
    "fraction of no baseline": (("--lam", "0.5"), "--lam 0.5 asks for a fraction"),
    "limits of another robot": (("--max-speed", "1,2"), "--max-speed is [1.0, 2.0], expected 3 numbers or one"),
    "limit of nothing": (("--max-acceleration", "0"), "--max-acceleration is 0.0, but limits must be positive"),
    "track the other way round": (("--track", "1,-1"), "--track is [1.0, -1.0], but the ends"),
    "tracks of another robot": (("--track", "1,2,3"), "two ends, or two for each of 3 carriers"),
    "start of another robot": (("--start", "0,0"), "--start is [0.0, 0.0], expected 3 numbers or one"),
    "start off the track": (("--start", "5"), "--start puts carrier_1 at 5 m"),
    "too near to a singularity": (("--least-margin", "2"), "`plan switch-off`"),
    "backend of another robot": (
        ("--robot", "five_bar", "--mode", "+-", "--backend", "virtual-work"),
        "--backend rnea",
    ),
    "workspace left": (("--radius", "10"), "Keep the motion inside the workspace."),
}


@pytest.mark.parametrize("case", STEPWISE_FLAGS)
def test_flags_are_named_as_they_were_written(case: str) -> None:
    extra, says = STEPWISE_FLAGS[case]
    assert says in refused(*CORNER, *extra)


def test_inputs_are_not_overwritten(tmp_path: Path) -> None:
    motion = write_motion(tmp_path / "motion.npz", reference.corner(), 0.05)
    before = motion.read_bytes()
    assert "--out is the file" in refused("plan", "stepwise", "--robot", "3rrr", "--motion", motion, "--out", motion)
    assert motion.read_bytes() == before
    problem = write_problem(tmp_path / "p.npz", **PROBLEM)
    before = problem.read_bytes()
    assert "--out is the file" in refused("plan", "--problem", problem, "--out", problem)
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
