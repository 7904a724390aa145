"""Small closed chains that no shipped model covers: universal, hinge, cylindrical closures; rods; endless joints."""

from __future__ import annotations

import functools
import tempfile
from pathlib import Path
from typing import Any

from written import J, urdf_of, write_robot

from redundancy_pin import load_robot
from redundancy_pin.robot import Robot


def ball(name: str, parent: str, child: str, xyz: tuple[float, float, float]) -> list[J]:
    return [
        J(f"{name}_x", "revolute", parent, f"{name}_cross", xyz, axis=(1, 0, 0)),
        J(f"{name}_y", "revolute", f"{name}_cross", f"{name}_ring", axis=(0, 1, 0)),
        J(f"{name}_z", "revolute", f"{name}_ring", child, axis=(0, 0, 1)),
    ]


CRANK = J("crank", "revolute", "base", "crank_link", rpy=(0.2, -0.1, 0.0))
RCCC_TWISTS = (0.5, 1.2, 1.4, 1.3)

CHAINS: dict[str, tuple[list[J], dict[str, Any]]] = {
    # crank (R), coupler on a ball (S), universal closure to a rocker (R): 1 + 3 + 1 - 4 = 1 freedom
    "universal": (
        [
            CRANK,
            *ball("ball", "crank_link", "coupler", (0.2, 0, 0)),
            J("coupler_mount", "fixed", "coupler", "coupler_tip", (0.6, 0, 0), (0.3, 0.2, -0.4)),
            J("rocker", "revolute", "base", "rocker_link", (0.5, 0.3, 0.0), (0.7, 0.3, 0.1)),
            J("rocker_mount", "fixed", "rocker_link", "rocker_tip", (0.4, 0, 0)),
        ],
        {"closures": [{"frames": ["coupler_tip", "rocker_tip"], "axes": ["x", "y", "z", "rz"]}]},
    ),
    # the same linkage, opened at the rocker's base hinge instead: 1 + 3 + 2 - 5 = 1
    "hinge": (
        [
            CRANK,
            *ball("ball", "crank_link", "coupler", (0.2, 0, 0)),
            J("cross_1", "revolute", "coupler", "cross", (0.6, 0, 0), (0.3, 0.2, -0.4), (0, 1, 0)),
            J("cross_2", "revolute", "cross", "rocker_link", axis=(1, 0, 0)),
            J("rocker_mount", "fixed", "rocker_link", "rocker_foot", (-0.4, 0, 0)),
            J("pivot_mount", "fixed", "base", "pivot", (0.5, 0.3, 0.0), (0.7, 0.3, 0.1)),
        ],
        {"closures": [{"frames": ["pivot", "rocker_foot"], "axes": ["x", "y", "z", "rx", "ry"]}]},
    ),
    # RCCC: one hinge and three cylindrical joints, the last of them the closure: 1 + 2 + 2 - 4 = 1
    "cylindrical": (
        [
            J("crank", "revolute", "base", "link_1"),
            J("turn_2", "revolute", "link_1", "link_2a", (0.1, 0, 0), (RCCC_TWISTS[0], 0, 0)),
            J("slide_2", "prismatic", "link_2a", "link_2"),
            J("turn_3", "revolute", "link_2", "link_3a", (0.4, 0, 0), (RCCC_TWISTS[1], 0, 0)),
            J("slide_3", "prismatic", "link_3a", "link_3"),
            J("tip_mount", "fixed", "link_3", "tip", (0.3, 0, 0), (RCCC_TWISTS[2], 0, 0)),
            J("pivot_mount", "fixed", "base", "pivot", (0.35, 0, 0), (RCCC_TWISTS[3], 0, 0)),
        ],
        {"closures": [{"frames": ["pivot", "tip"], "axes": ["x", "y", "rx", "ry"]}]},
    ),
    # crank and rocker on skew axes, and a rod of constant length between them: 1 + 1 - 1 = 1
    "rod": (
        [CRANK, J("rocker", "revolute", "base", "rocker_link", (0.5, 0.3, 0.0), (0.7, 0.3, 0.1))],
        {"closures": [{"rod": ["crank_link", "rocker_link"], "at": [[0.2, 0, 0.05], [0.4, 0, 0]], "length": 0.6}]},
    ),
    # the shipped four-bar's dimensions, with joints that turn without end (nq = 2 each)
    "continuous": (
        [
            J("crank", "continuous", "base", "crank_link"),
            J("crank_mount", "fixed", "crank_link", "crank_tip", (0.1, 0, 0)),
            J("rocker", "continuous", "base", "rocker_link", (0.4, 0, 0)),
            J("coupler", "continuous", "rocker_link", "coupler_link", (0.25, 0, 0)),
            J("coupler_mount", "fixed", "coupler_link", "coupler_tip", (0.35, 0, 0)),
        ],
        {
            "closures": [{"frames": ["crank_tip", "coupler_tip"], "axes": ["x", "y"]}],
            "working_modes": {"joints": ["coupler"], "signs": [1]},
            "reference": {"joints": {"crank": 1.0}, "guess": {"rocker": 1.9, "coupler": 2.0}},
        },
    ),
}


@functools.cache
def chain_of(name: str) -> Robot:
    """Return one of the chains, driven and described by its crank."""
    joints, declaration = CHAINS[name]
    common = {"actuated": ["crank"], "independent": {"joints": ["crank"]}, "reference": {"joints": {"crank": 0.6}}}
    with tempfile.TemporaryDirectory() as folder:
        return load_robot(write_robot(Path(folder), urdf_of(joints), {**common, **declaration}))
