"""``redundancy-pin study``: files and JSON of a small study, mistakes in one line, and stores that survive."""

from __future__ import annotations

import csv
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from command_line import call, refused

from redundancy_pin.studies import robustness as study
from redundancy_pin.studies.robustness import SCENARIOS, Scenario, Trial, robustness_study

SHORT = Scenario(SCENARIOS[0].case, 2.48, 2.53)
"""s; the singular pose at 2.508 s, and little else."""

FILES = ["store.sqlite", "study.md", "summary.json", "trials.csv"]


@pytest.fixture(autouse=True)
def _small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(robustness_study.__kwdefaults__, "scenarios", (SHORT,))
    monkeypatch.setitem(robustness_study.__kwdefaults__, "drives", ("open loop", "computed torque"))


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, int]]:
    """Put a quick stand-in for simulations, whose numbers depend on drive, seed and draw; return what was run."""
    done: list[tuple[str, int]] = []

    def quick(scenario, drive, bounds, seed, number):
        done.append((drive, number))
        largest = 1e-3 * (1.0 + number) if drive == "computed torque" else 0.05 + 1e-3 * number + 1e-4 * seed
        return Trial(scenario.name, drive, number, "ok", "", largest, 0.5 * largest, 1.0, 2.0, 0.0)

    monkeypatch.setattr(study, "run_trial", quick)
    return done


def test_help_says_what_the_options_are() -> None:
    text = call("study", "--help").stdout
    for name in ("--draws", "--seed", "--severity", "--jobs", "--out", "--json"):
        assert name in text
    assert "\n  Example:\n    redundancy-pin study" in text


@pytest.mark.long
def test_a_tiny_study_is_simulated_and_written(tmp_path: Path) -> None:
    folder = tmp_path / "a" / "study"
    result = call("study", "--draws", "2", "--jobs", "1", "--out", folder)
    assert (result.exit_code, result.stderr) == (0, "")
    assert sorted(path.name for path in folder.iterdir()) == FILES
    assert "Seed 0, severity 1, 2 draws a cell." in result.stdout
    assert "| ---" not in result.stdout  # a table as the other commands print them, not its Markdown
    with (folder / "trials.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [(row["drive"], row["number"]) for row in rows] == [
        ("open loop", "0"), ("open loop", "1"), ("computed torque", "0"), ("computed torque", "1")]  # fmt: skip
    away = [float(row["largest"]) for row in rows]
    assert len(set(away)) == 4  # every draw is a machine of its own
    assert min(away) > 0.0
    assert max(away) < 2e-3
    cells = json.loads((folder / "summary.json").read_text())["cells"]
    assert [cell["worst"] for cell in cells] == pytest.approx([max(away[:2]), max(away[2:])], rel=1e-9)
    assert [cell["statuses"] for cell in cells] == [{"ok": 2}] * 2


def test_json_is_the_summary(tmp_path: Path, run: list[tuple[str, int]]) -> None:
    options = ("--draws", "3", "--seed", "7", "--severity", "2.5", "--jobs", "1", "--out", tmp_path, "--json")
    facts = json.loads(call("study", *options).stdout)
    assert facts == json.loads((tmp_path / "summary.json").read_text())
    assert (facts["seed"], facts["severity"]) == (7, 2.5)
    assert (facts["imperfections"]["mass"], facts["imperfections"]["period"]) == (0.125, 1e-3)
    assert [cell["success"]["value"] for cell in facts["cells"]] == [0.0, 1.0]
    assert facts["cells"][1]["largest"]["value"] == pytest.approx(2e-3)


def test_one_draw_has_no_interval_and_says_so(tmp_path: Path, run: list[tuple[str, int]]) -> None:
    result = call("study", "--draws", "1", "--jobs", "1", "--out", tmp_path)
    assert "1.00 [–]" in result.stdout
    assert "an interval of a mean takes two simulated draws or more" in (tmp_path / "study.md").read_text()
    assert "nan" not in result.stdout.lower()
    assert "NaN" not in (tmp_path / "summary.json").read_text()
    two = call("study", "--draws", "2", "--jobs", "1", "--out", tmp_path).stdout
    assert "1.50 [1.00, 2.00]" in two
    assert "–" not in two


def test_a_study_in_which_nothing_could_be_simulated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    none = float("nan")
    monkeypatch.setattr(
        study,
        "run_trial",
        lambda scenario, drive, bounds, seed, number: Trial(
            scenario.name, drive, number, "error", "no closure", none, none, none, none, none
        ),
    )
    result = call("study", "--draws", "2", "--jobs", "1", "--out", tmp_path)
    assert "nan" not in result.stdout.lower()
    assert "error 2" in result.stdout
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["cells"][0]["worst"] is None
    again = call("study", "--draws", "2", "--jobs", "1", "--out", tmp_path)  # NaN in the store is read back
    assert again.stdout == result.stdout


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--draws", "0"), "draws is 0"),
        (("--draws", "many"), "'many' is not a valid integer"),
        (("--jobs", "0"), "jobs is 0"),
        (("--seed", "-1"), "seed is -1"),
        (("--severity", "-0.5"), "severity is -0.5"),
        (("--severity", "20"), "severity is 20"),
        (("--severity", "nan"), "severity is nan"),
        (("--sevrity", "2"), "No such option"),
    ],
)
def test_bad_options_leave_nothing_behind(tmp_path: Path, run: list, options: tuple[str, str], message: str) -> None:
    assert message in refused("study", "--jobs", "1", "--out", tmp_path / "study", *options)
    assert run == []
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_is_a_file(tmp_path: Path, run: list[tuple[str, int]]) -> None:
    (tmp_path / "study").write_text("mine")
    assert "Cannot make the folder" in refused("study", "--draws", "1", "--jobs", "1", "--out", tmp_path / "study")
    assert run == []
    assert (tmp_path / "study").read_text() == "mine"


def test_the_same_command_computes_nothing_anew(tmp_path: Path, run: list[tuple[str, int]]) -> None:
    options = ("study", "--jobs", "1", "--out", tmp_path)
    first = call(*options, "--draws", "2")
    assert len(run) == 4
    files = {name: (tmp_path / name).read_bytes() for name in FILES}
    assert call(*options, "--draws", "2").stdout == first.stdout
    assert len(run) == 4
    assert {name: (tmp_path / name).read_bytes() for name in FILES} == files
    call(*options, "--draws", "3")
    assert run[4:] == [("open loop", 2), ("computed torque", 2)]
    assert call(*options, "--draws", "2").stdout == first.stdout  # fewer: the first ones
    assert len(run) == 6


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--seed", "1"), "for seed it has 0, now it is 1"),
        (("--severity", "3"), "for imperfections.mass it has 0.05, now it is 0.15"),
    ],
)
def test_another_study_does_not_mix_with_a_store(
    tmp_path: Path, run: list, options: tuple[str, str], message: str
) -> None:
    call("study", "--draws", "1", "--jobs", "1", "--out", tmp_path)
    files = {name: (tmp_path / name).read_bytes() for name in FILES}
    assert message in refused("study", "--draws", "2", "--jobs", "1", "--out", tmp_path, *options)
    assert len(run) == 2
    assert {name: (tmp_path / name).read_bytes() for name in FILES} == files


def test_ctrl_c_says_what_is_kept(tmp_path: Path, run: list, monkeypatch: pytest.MonkeyPatch) -> None:
    quick = study.run_trial

    def interrupted(*given):
        if len(run) == 3:
            raise KeyboardInterrupt
        return quick(*given)

    options = ("study", "--draws", "2", "--jobs", "1", "--out", tmp_path)
    with monkeypatch.context() as patched:
        patched.setattr(study, "run_trial", interrupted)
        result = call(*options)
    assert result.exit_code == 130
    assert result.stdout == ""
    assert "3 of 4 trials are in" in result.stderr
    assert len(result.stderr.splitlines()) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["store.sqlite"]
    assert call(*options).exit_code == 0
    assert run[3:] == [("computed torque", 1)]


KILLED = """
import sys, time
from redundancy_pin.cli import main
from redundancy_pin.studies import robustness as study
from redundancy_pin.studies.robustness import robustness_study
from redundancy_pin.studies.robustness import SCENARIOS, Scenario, Trial

def quick(scenario, drive, bounds, seed, number):
    if number == 1:
        print("two are finished", flush=True)
        time.sleep(120.0)
    return Trial(scenario.name, drive, number, "ok", "", 1e-3, 5e-4, 1.0, 2.0, 0.0)

study.run_trial = quick
robustness_study.__kwdefaults__["scenarios"] = (Scenario(SCENARIOS[0].case, 2.48, 2.53),)
robustness_study.__kwdefaults__["drives"] = ("open loop", "computed torque")
main(["study", "--draws", "2", "--jobs", "1", "--out", sys.argv[1]])
"""


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
def test_a_killed_study_goes_on_from_its_store(tmp_path: Path, run: list[tuple[str, int]]) -> None:
    options = ("study", "--draws", "2", "--jobs", "1", "--out", tmp_path)
    with subprocess.Popen([sys.executable, "-c", KILLED, str(tmp_path)], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"two are finished\n"
        assert "in use by another run" in refused(*options)
        process.kill()
    assert process.returncode == -signal.SIGKILL
    assert not [path for path in tmp_path.iterdir() if not path.name.startswith("store.sqlite")]
    assert call(*options).exit_code == 0
    assert run == [("open loop", 1), ("computed torque", 1)]
    assert sorted(path.name for path in tmp_path.iterdir()) == FILES
