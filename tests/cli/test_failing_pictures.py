"""What is computed is on disk, and reported, before it is drawn: a picture that fails loses nothing else."""

from __future__ import annotations

import importlib
import json
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import pytest
from command_line import call
from plan_cases import LINE

import redundancy_pin as rp
from redundancy_pin.errors import OutputError
from redundancy_pin.simulation import load_simulation
from redundancy_pin.singularities.locus import singular_locus

Fails = Callable[..., None]


@pytest.fixture
def fails(monkeypatch: pytest.MonkeyPatch) -> Fails:
    """Make a function of a module raise: an error of a drawing library, or the one given, once files are on disk."""

    def fail(module: str, function: str, *written: Path, error: Exception | None = None) -> None:
        def draw(*_: object, **__: object) -> NoReturn:
            assert all(file.stat().st_size for file in written)
            raise error or ValueError("Expected end of text, found '$'")

        # by its name: the package has the command by the name of its module
        monkeypatch.setattr(importlib.import_module(f"redundancy_pin.{module}"), function, draw)

    return fail


def lost_nothing(*arguments: object, code: int = 2) -> dict[str, Any]:
    """Run a command whose picture fails: all facts are reported, and one line says what is missing."""
    result = call(*map(str, arguments), "--json")
    assert result.exit_code == code
    (line,) = result.stderr.splitlines()
    assert line.startswith("error: ")
    assert "found '$'" in line or "disk is full" in line
    facts: dict[str, Any] = json.loads(result.stdout)
    return facts


@pytest.mark.parametrize(("function", "error"), [("overview", None), ("save", OutputError("The disk is full."))])
def test_plan(function: str, error: Exception | None, fails: Fails, tmp_path: Path) -> None:
    out, plot = tmp_path / "plan.npz", tmp_path / "plan.png"
    fails("cli.plan", function, out, error=error)
    facts = lost_nothing(*LINE, "--dt", "0.05", "--out", out, "--plot", plot)
    assert (facts["out"], facts["plot"]) == (str(out), None)
    np.testing.assert_allclose(facts["peak_effort"], rp.load_plan(out).peak_effort)
    assert [path.name for path in tmp_path.iterdir()] == ["plan.npz"]


@pytest.fixture(scope="module")
def motion_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("motion") / "points.csv"
    path.write_text("t,x,y\n0,0.2,0.36\n0.05,0.21,0.36\n0.1,0.22,0.36\n")
    return path


@pytest.mark.parametrize(("flag", "function"), [("--plot", "overview"), ("--video", "save_video")])
def test_simulate(flag: str, function: str, fails: Fails, motion_file: Path, tmp_path: Path) -> None:
    out, picture = tmp_path / "run.npz", tmp_path / ("run.png" if flag == "--plot" else "run.gif")
    fails("cli.simulate", function, out)
    machine = ("--robot", "2rpr", "--set", "end_effector_mass=0.5")
    facts = lost_nothing("simulate", *machine, "--motion", motion_file, "--out", out, flag, picture)
    assert facts[flag[2:]] is None
    assert len(load_simulation(out).t) == facts["samples"]
    assert [path.name for path in tmp_path.iterdir()] == ["run.npz"]


def test_workspace(fails: Fails, tmp_path: Path) -> None:
    out = tmp_path / "nodes.csv"
    fails("cli.workspace", "plot_workspace", out)
    small = ("--bounds", "0.1:0.4,0.2:0.5", "--resolution", "5")
    facts = lost_nothing("workspace", "--robot", "five_bar", *small, "--out", out, "--plot", tmp_path / "map.svg")
    assert facts["nodes"] == 25
    assert facts["plot"] is None
    assert out.read_text().count("\n") == 26


def test_singularities(fails: Fails, motion_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fails("cli.singularities", "plot_workspace")
    monkeypatch.setattr(
        importlib.import_module("redundancy_pin.cli.singularities"),
        "singular_locus",
        partial(singular_locus, resolution=9),
    )
    motion = ("--robot", "2rpr", "--motion", motion_file)
    facts = lost_nothing("singularities", *motion, "--plot", tmp_path / "locus.png")
    assert facts["robot"] == "2rpr"
    assert facts["crossings"] == []
    assert facts["plot"] is None


@pytest.mark.long
def test_online(fails: Fails, tmp_path: Path) -> None:
    pytest.importorskip("casadi")
    points, out = tmp_path / "points.csv", tmp_path / "online.npz"
    fails("cli.online", "show", out)
    points.write_text("t,x,y\n0,0.2,0.06\n0.3,0.23,0.0\n0.6,0.28,-0.05\n")
    machine = ("--robot", "2rpr", "--set", "end_effector_mass=0.5", "--set", "cylinder_mass=0.3")
    facts = lost_nothing("online", *machine, "--motion", points, "--out", out, "--html", tmp_path / "online.html")
    np.testing.assert_allclose(facts["peak_effort"], rp.load_plan(out).peak_effort)
