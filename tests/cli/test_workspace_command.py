"""``redundancy-pin workspace``: against the closed forms of two discs and of a pose's attitude."""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from command_line import call, refused

import redundancy_pin as rp

BOX = ("--bounds", "-0.6:1.1,-1:1", "--resolution", "8")


def test_nodes_and_counts_are_those_of_two_discs(tmp_path: Path) -> None:
    table, picture = tmp_path / "nodes.csv", tmp_path / "map.png"
    files = ("--out", str(table), "--plot", str(picture))
    told = json.loads(call("workspace", "--robot", "five_bar", *BOX, "--all-modes", *files, "--json").stdout)
    with table.open() as stream:
        rows = list(csv.DictReader(stream))
    x = np.array([[float(row["x [m]"]), float(row["y [m]"])] for row in rows])
    inside = (np.linalg.norm(x[:, None] - [[0.0, 0.0], [0.5, 0.0]], axis=2) < 1.0).all(axis=1)
    assert len(rows) == 4 * told["nodes"] == 4 * 64
    assert [row["reachable"] == "1" for row in rows] == inside.tolist()
    assert [row["margin"] != "nan" for row in rows] == inside.tolist()
    assert {row["island"] for row in rows} == {"0", "-1"}
    assert told["bounds"] == {"x": [-0.6, 1.1], "y": [-1.0, 1.0]}
    assert {mode: part["reachable"] for mode, part in told["modes"].items()} == dict.fromkeys(
        ("++", "+-", "-+", "--"), int(inside.sum()) // 4
    )
    cell = 1.7 * 2.0 / 7**2
    assert told["size"] == pytest.approx(cell * inside.sum() / 4)
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_a_slice_goes_through_a_pose(tmp_path: Path) -> None:
    """Turned about z by its margins of type II: rows of W⁻ᵀ are the Plücker coordinates of legs, by hand."""
    angle, z = 1.2, np.array([0.5, 0.7, 0.9])
    at = f"0,0,0.6,0,0,{math.sin(angle / 2)!r},{math.cos(angle / 2)!r}"
    out = tmp_path / "nodes.csv"
    flags = ("--robot", "gough", "--free", "z", "--at", at, "--bounds", "0.5:0.9", "--resolution", "3")
    assert "3 of 3 reachable" in call("workspace", *flags, "--out", str(out)).stdout
    with out.open() as stream:
        rows = list(csv.DictReader(stream))
    robot = rp.load_robot("gough")
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, np.array(robot.q_reference))
    middle = data.oMf[robot.model.getFrameId("platform")]
    turn = np.array([[math.cos(angle), -math.sin(angle), 0], [math.sin(angle), math.cos(angle), 0], [0, 0, 1]])
    for height, row in zip(z, rows, strict=True):
        legs = []
        for i in range(1, 7):
            base = data.oMi[robot.model.getJointId(f"swing_{i}")].translation
            tip = (
                data.oMf[robot.model.getFrameId(f"corner_{i}")]
                if i > 1
                else data.oMi[robot.model.getJointId("ball_1_x")]
            )
            arm = turn @ middle.actInv(tip).translation
            leg = arm + np.array([0.0, 0.0, height]) - base
            leg = leg / np.linalg.norm(leg)
            legs.append([*leg, *np.cross(arm, leg) / robot.characteristic_length])
        assert abs(float(row["margin"])) == pytest.approx(np.linalg.svd(np.array(legs))[1][-1], abs=1e-9)


def test_a_pose_has_seven_numbers() -> None:
    assert "Write seven" in refused("workspace", "--robot", "gough", "--at", "0,0,0.6")
    assert "norm" in refused("workspace", "--robot", "gough", "--at", "0,0,0.6,0,0,0,2")


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("--free", "x,q"), "--free is ('x', 'q'). Choose from x, y."),
        (("--free", ""), "--free"),
        (("--free", "x,x"), "Name each once."),
        (("--bounds", "0:1"), "--bounds"),
        (("--bounds", "0:1,a:b"), "LOW:HIGH"),
        (("--bounds", "0,1"), "LOW:HIGH"),
        (("--at", "0.1,b"), "--at has"),
        (("--at", "3,3"), "chains stay open"),
        (("--resolution", "2"), "--resolution is 2"),
        (("--out", "nodes.txt"), "--out nodes.csv"),
        (("--plot", "map.txt"), "picture format"),
    ],
)
def test_bad_input(arguments: tuple[str, ...], says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert says in refused("workspace", "--robot", "five_bar", *arguments)
    assert list(tmp_path.iterdir()) == []
