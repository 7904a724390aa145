"""The gallery: from file to torque in ten lines at most, each block by itself; and its machines in MuJoCo."""

from __future__ import annotations

import re
from importlib.metadata import PackageNotFoundError
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from doc_blocks import Block, blocks_of, example_script
from test_writers import MOTION_TOLERANCE, run
from zoo import SHIPPED, robot_of

from redundancy_pin.robot.shipped import shipped_robots

PAGE = Path(__file__).resolve().parents[1] / "docs" / "gallery.md"
BLOCKS = [block for block in blocks_of(PAGE, "gallery") if block.language == "python"]
MOST = 10
SWUNG = sorted(set(shipped_robots()) - set(SHIPPED) - {"two_arms"})
"""Robots of the gallery that MuJoCo swings; those whose coordinates are poses have tests in tests/examples."""


def _name(block: Block) -> str:
    match = re.search(r'\w\("(\w+)"', block.text) or re.search(r'load_robot\("([\w.]+)"', block.text)
    assert match, block.where
    return match[1]


def test_every_shipped_machine_is_there_in_ten_lines() -> None:
    assert {_name(block) for block in BLOCKS if block.runs} == set(shipped_robots())
    for block in BLOCKS:
        assert len([line for line in block.text.splitlines() if line.strip()]) <= MOST, block.where
        assert ";" not in block.text, block.where


@pytest.mark.long_for(*(name for name in shipped_robots() if name != "excavator"))
@pytest.mark.parametrize("block", [each for each in BLOCKS if each.runs], ids=_name)
def test_a_block_ends_with_torques(block: Block) -> None:
    session: dict[str, Any] = {}
    exec(compile(block.text, block.where, "exec"), session)
    robot = robot_of(_name(block))
    assert session["tau"].ndim == 2
    assert session["tau"].shape[1] == robot.m
    assert len(session["tau"]) > 10
    assert np.isfinite(session["tau"]).all()
    assert np.ptp(session["tau"]) > 0.1


@pytest.mark.long
def test_the_block_of_cassie(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    example = example_script(PAGE.parent / "examples" / "cassie_leg.py")
    try:
        example.load(tmp_path)
    except PackageNotFoundError:
        pytest.skip("example-robot-data is not installed: pip install 'redundancy_pin[examples]'")
    monkeypatch.chdir(tmp_path)
    (block,) = [each for each in BLOCKS if not each.runs]
    session: dict[str, Any] = {}
    exec(compile(block.text, block.where, "exec"), session)
    assert session["tau"].shape == (11, 10)
    assert session["robot"].actuated[3] == "left-knee-op"  # the fourth joint is the one that the block bends
    assert 40.0 < session["tau"][:, 3].max() < 80.0


@pytest.mark.long_for(*(name for name in SWUNG if name != "walking_leg"))
@pytest.mark.parametrize("name", SWUNG)
def test_mujoco_makes_their_motions(name: str, tmp_path: Path) -> None:
    assert run(robot_of(name), tmp_path / "robot.xml") < MOTION_TOLERANCE
