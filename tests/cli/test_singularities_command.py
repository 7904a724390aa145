"""``redundancy-pin singularities``: instants against closed forms, and the picture."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path

import pytest
from command_line import call, refused, write_motion

from redundancy_pin.trajectory import reference

CROSSINGS = [0.25 - math.sqrt(0.2**2 - 0.185**2), 0.25 + math.sqrt(0.2**2 - 0.185**2)]
"""Where the circle of radius 0.2 about (0.25, 0.185) meets the base line."""


def test_circle_meets_the_base_line() -> None:
    result = call("singularities", "--robot", "2rpr", "--trajectory", "circle:speed=0.75", "--json")
    assert result.stderr == ""
    facts = json.loads(result.stdout)["crossings"]
    assert [crossing["x"][0] for crossing in facts] == pytest.approx(CROSSINGS, abs=1e-10)
    for crossing in facts:
        assert crossing["kind"] == "type_ii"
        assert crossing["crosses"]
        assert [abs(value) for value in crossing["uncontrolled_twist"]] == pytest.approx([0.0, 1.0], abs=1e-9)
        assert crossing["lost_direction"] == [None, None]


def test_motion_from_a_file_gives_the_same_instants(tmp_path: Path) -> None:
    motion = write_motion(tmp_path / "motion.csv", reference.circle(0.5), 0.005)
    facts = json.loads(call("singularities", "--robot", "2rpr", "--motion", motion, "--json").stdout)["crossings"]
    # quintics between samples 5 ms apart: error of the order of the sixth power of the step
    assert [crossing["x"][0] for crossing in facts] == pytest.approx(CROSSINGS, abs=1e-8)


def test_table_shows_time_and_direction() -> None:
    text = call("singularities", "--robot", "2rpr", "--trajectory", "line").stdout
    assert "4.51649" in text  # sqrt(0.1² + 1.1²) · 4/11 / 0.1 + 0.5
    assert "type_ii" in text
    assert "crossed" in text


def test_no_singularity_is_an_empty_list() -> None:
    facts = json.loads(call("singularities", "--robot", "3rrr", "--trajectory", "corner:radius=0.013", "--json").stdout)
    assert facts["crossings"] == []


def test_plot_is_written(tmp_path: Path) -> None:
    picture = tmp_path / "locus.png"
    result = call("singularities", "--robot", "2rpr", "--plot", str(picture), "--trajectory", "circle")
    assert result.exit_code == 0
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert [path.name for path in tmp_path.iterdir()] == ["locus.png"]


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("--robot", "2rpr"), "nothing to do"),
        (("--robot", "2rpr", "--trajectory", "spiral"), "circle"),
        (("--robot", "2rpr", "--trajectory", "circle:sped=1"), "speed"),
        (("--robot", "2rpr", "--trajectory", "circle:speed=fast"), "fast"),
        (("--robot", "2rpr", "--trajectory", "circle:speed=-1"), "-1"),
        (("--robot", "2rpr", "--trajectory", "circle", "--motion", "m.csv"), "either --trajectory or --motion"),
        (("--robot", "2rpr", "--motion", "nowhere.csv"), "nowhere.csv"),
        (("--robot", "3rrr", "--trajectory", "circle"), "moves in 3 (x, y, rz)"),
        (("--robot", "2rpr", "--plot", "locus.txt"), "picture format"),
        (("--robot", "2rpr", "--plot", "nowhere/locus.png"), "nowhere"),
        (("--robot", "gough", "--plot", "locus.png"), "instants of a motion, with --motion,"),
    ],
)
def test_bad_input(arguments: tuple[str, ...], says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert says in refused("singularities", *arguments)
    assert list(tmp_path.iterdir()) == []


def test_without_matplotlib(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    assert "redundancy_pin[plot]" in refused("singularities", "--robot", "2rpr", "--plot", tmp_path / "locus.png")
