"""``redundancy-pin design``: its records are those of the Python function; mistakes in one line."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from command_line import call, refused

MOTION = "circle:speed=0.5,ramp_time=0.2,ramp_length=0.05"
SHORT = ("design", "--robot", "2rpr", "--task", MOTION, "--vary", "carrier_mass=0.9:2", "--iterations", "1",
         "--parameter", "dt=0.03", "--parameter", "refinements=0", "--parameter", "acceleration=20")  # fmt: skip


def test_files_and_json(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    result = call(*SHORT, "--json")
    assert (result.exit_code, result.stderr) == (0, "")
    first, made = json.loads(result.stdout)["records"]
    assert (first["machine"], made["machine"], made["task"]) == ("to begin with", "for circle", "circle")
    # without other masses the effort goes with the square of the carriers' mass, and energies with the mass
    assert (first["carrier_mass"], made["carrier_mass"]) == (1.0, 0.9)
    assert made["value"] == pytest.approx(0.81 * first["value"], rel=1e-5)
    assert made["energy"] == pytest.approx(0.9 * first["energy"], rel=1e-3)
    assert (first["mass"], made["mass"]) == (pytest.approx(2.0), pytest.approx(1.8))
    # one step is not enough to see that no other is better
    assert [(each["optimal"], each["search"]) for each in (first, made)] == [(None, None), (False, "not_converged")]
    folder = tmp_path / "design-2rpr"
    assert "not_converged" in (folder / "design.md").read_text()
    assert {path.name for path in folder.iterdir()} == {"design.md", "design.csv", "design.json"}
    assert json.loads((folder / "design.json").read_text())["records"] == [first, made]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--task", "circle", "--vary", "carrier_mass"), "NAME=LOW:HIGH"),
        (("--task", "circle", "--vary", "carrier_mas=0.5:2"), "carrier_mas"),
        (("--task", "circel", "--vary", "carrier_mass=0.5:2"), "circel"),
        (("--task", "circle", "--vary", "carrier_mass=0.5:2", "--parameter", "objectiv=peak"), "objectiv"),
        (("--task", "circle", "--vary", "carrier_mass=0.5:2", "--iterations", "0"), "iterations"),
    ],
)
def test_mistakes(arguments: tuple[str, ...], message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert message in refused("design", "--robot", "2rpr", *arguments)
    assert not list(tmp_path.iterdir())
