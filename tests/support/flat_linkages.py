"""Planar linkages with a flat pose, where their closures lose rank: rows of four-bars, and single ones of any sides.

The rows are benchmark A02 of the IFToMM library of multibody problems: N four-bars side by side, bars of 1 m and 1 kg
as uniform rods, released upright under gravity with B₀ at a speed in x. A user of the package declares them like any
robot, without carriers; `actuated` has to name a joint, whose effort is zero in a simulation without a drive.
"""

from __future__ import annotations

import functools
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from change_point_oracle import change_point, factor
from written import write_robot

from redundancy_pin import load_robot
from redundancy_pin.robot import Robot

GRAVITY = 9.81


def _rod(name: str, length: float, mass: float) -> str:
    inertia = mass * length**2 / 12.0
    return (
        f'<link name="{name}"><inertial><origin xyz="{length / 2.0!r} 0 0"/><mass value="{mass!r}"/>'
        f'<inertia ixx="1e-6" ixy="0" ixz="0" iyy="{inertia!r}" iyz="0" izz="{inertia!r}"/></inertial></link>'
    )


def _hinge(name: str, parent: str, child: str, x: float, y: float = 0.0) -> str:
    return (
        f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{x!r} {y!r} 0"/><axis xyz="0 0 1"/>'
        '<limit lower="-1e9" upper="1e9" velocity="1e9" effort="1e9"/></joint>'
    )


def _tip(link: str, length: float) -> str:
    return (
        f'<link name="{link}_tip"/><joint name="{link}_mount" type="fixed"><parent link="{link}"/>'
        f'<child link="{link}_tip"/><origin xyz="{length!r} 0 0"/></joint>'
    )


@functools.cache
def row_of_four_bars(
    count: int,
    crank: float = 1.0,
    coupler: float = 1.0,
    rocker: float | None = None,
    ground: float | None = None,
    mass: tuple[float, float, float] = (1.0, 1.0, 1.0),
    angles: tuple[float, float, float] = (np.pi / 2.0, -np.pi / 2.0, np.pi / 2.0),
    gravity: float = GRAVITY,
) -> Robot:
    """Return N four-bars in a row: joints crank_0 … crank_N from the ground, coupler_1 … coupler_N on the cranks.

    ``rocker`` and ``ground`` are the lengths of the last crank and of the base, those of crank and coupler when left
    out; ``mass`` of cranks, couplers, rocker; ``angles`` a guess of the reference: first crank, couplers, other cranks.
    """
    rocker, ground = crank if rocker is None else rocker, coupler if ground is None else ground
    lengths = [*[crank] * count, rocker]
    masses = [*[mass[0]] * count, mass[2]]
    parts = ['<robot name="row"><link name="base"/>']
    guess = {"crank_0": angles[0]}
    for i, (length, weight) in enumerate(zip(lengths, masses, strict=True)):
        parts += [
            _rod(f"c{i}", length, weight),
            _hinge(f"crank_{i}", "base", f"c{i}", i * ground),
            _tip(f"c{i}", length),
        ]
        guess |= {f"crank_{i}": angles[2]} if i else {}
    for i in range(1, count + 1):
        parts += [_rod(f"b{i}", coupler, mass[1]), _hinge(f"coupler_{i}", f"c{i - 1}", f"b{i}", lengths[i - 1])]
        parts += [_tip(f"b{i}", coupler)]
        guess[f"coupler_{i}"] = angles[1]
    declaration = {
        "gravity": [0.0, -gravity, 0.0],
        "closures": [{"frames": [f"b{i}_tip", f"c{i}_tip"], "axes": ["x", "y"]} for i in range(1, count + 1)],
        "actuated": ["crank_0"],
        "independent": {"joints": ["crank_0"]},
        "reference": {"joints": {"crank_0": angles[0]}, "guess": guess},
    }
    with tempfile.TemporaryDirectory() as folder:
        return load_robot(write_robot(Path(folder), "\n".join([*parts, "</robot>"]), declaration))


@functools.cache
def four_bar(lengths: tuple[float, float, float, float], angle: float, side: int) -> Robot:
    """Return a four-bar (crank, coupler, rocker, ground), rods of 1 kg a metre, at a crank angle.

    ``side`` ±1: on which side of the line from the crank's tip to the rocker's hinge coupler and rocker meet.
    """
    crank, coupler, rocker, ground = lengths
    rocker_angle, coupler_angle = rocker_and_coupler(lengths, angle, side)
    return row_of_four_bars(
        1,
        crank,
        coupler,
        rocker,
        ground,
        mass=(crank, coupler, rocker),
        angles=(angle, coupler_angle - angle, rocker_angle),
    )


def rocker_and_coupler(lengths: tuple[float, float, float, float], angle: float, side: int) -> tuple[float, float]:
    """Return the absolute angles of rocker and coupler by the law of cosines."""
    crank, coupler, rocker, ground = lengths
    tip, pivot = crank * np.exp(1j * angle), complex(ground)
    across = pivot - tip
    foot = (abs(across) ** 2 + coupler**2 - rocker**2) / (2.0 * abs(across))
    height = np.sqrt(max(coupler**2 - foot**2, 0.0))
    joint = tip + across / abs(across) * complex(foot, side * height)
    return float(np.angle(joint - pivot)), float(np.angle(joint - tip))


@functools.cache
def parallelogram(variant: str = "", incline: float | None = None) -> Robot:
    """Return cranks of 1 m, 2 m apart, at 1.2 rad; with joints "continuous", a "pendulum" on the middle of the coupler
    (a second freedom), a "second" one beside it that moves by itself, or a "carrier" on the second crank
    or on a "rail" of the base.

    ``incline``: a third crank, 2 m from the first at this angle, rad, moves with it by a coupler of its own: flat at
    that angle, where the other loop is not.
    """
    joint = "continuous" if variant == "continuous" else "revolute"
    parts = ['<robot name="parallelogram"><link name="base"/>', _rod("c0", 1.0, 1.0), _rod("c1", 1.0, 1.0)]
    parts += [_rod("b1", 2.0, 1.0), _hinge("crank_0", "base", "c0", 0.0), _hinge("coupler_1", "c0", "b1", 1.0)]
    parts += [_hinge("crank_1", "base", "c1", 2.0), _tip("b1", 2.0), _tip("c1", 1.0)]
    free, guess = {"crank_0": 1.2}, {"crank_0": 1.2, "crank_1": 1.2, "coupler_1": -1.2}
    declaration = {
        "gravity": [0.0, -GRAVITY, 0.0],
        "closures": [{"frames": ["b1_tip", "c1_tip"], "axes": ["x", "y"]}],
        "actuated": ["crank_0"],
    }
    if incline is not None:
        x, y = 2.0 * float(np.cos(incline)), 2.0 * float(np.sin(incline))
        parts += [_rod("c2", 1.0, 1.0), _rod("b2", 2.0, 1.0), _tip("c2", 1.0), _tip("b2", 2.0)]
        parts += [_hinge("crank_2", "base", "c2", x, y), _hinge("coupler_2", "c0", "b2", 1.0)]
        guess |= {"crank_2": 1.2, "coupler_2": incline - 1.2}
        declaration["closures"].append({"frames": ["b2_tip", "c2_tip"], "axes": ["x", "y"]})
    if variant == "pendulum":
        parts += [_rod("p", 0.7, 1.0), _hinge("pendulum", "b1", "p", 1.0)]
        free["pendulum"] = -1.0
    if variant == "second":
        parts += [_rod("d0", 1.0, 1.0), _rod("d1", 1.0, 1.0), _rod("e1", 2.0, 1.0), _tip("e1", 2.0), _tip("d1", 1.0)]
        parts += [_hinge("second_0", "base", "d0", 5.0), _hinge("beam", "d0", "e1", 1.0)]
        parts += [_hinge("second_1", "base", "d1", 7.0)]
        free["second_0"] = 1.2
        guess |= {"second_0": 1.2, "second_1": 1.2, "beam": -1.2}
        declaration["closures"].append({"frames": ["e1_tip", "d1_tip"], "axes": ["x", "y"]})
    if variant in ("carrier", "rail"):
        on = "c1" if variant == "carrier" else "base"
        parts.append(
            '<link name="m"><inertial><mass value="0.5"/><inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/>'
            f'</inertial></link><joint name="slide" type="prismatic"><parent link="{on}"/><child link="m"/>'
            '<origin xyz="0.5 0 0"/><axis xyz="1 0 0"/>'
            '<limit lower="-0.4" upper="0.4" velocity="10" effort="100"/></joint>'
        )
        declaration["carriers"] = [{"joint": "slide"}]
    declaration |= {
        "independent": {"joints": list(free)},
        "reference": {"joints": free, "guess": guess},
    }
    urdf = "\n".join([*parts, "</robot>"]).replace('"revolute"', f'"{joint}"')
    with tempfile.TemporaryDirectory() as folder:
        return load_robot(write_robot(Path(folder), urdf, declaration))


Loop = tuple[float, float, float, float, int]
"""Coupler, rocker and ground of a four-bar on a crank of 1 m, m; direction of its ground, rad; side of its branch."""


def several_on_one_crank(loops: Sequence[Loop], angle: float) -> Robot:
    """Return four-bars that share their crank, each flat where the crank is along its own ground; no gravity."""
    parts = ['<robot name="loops"><link name="base"/>', _rod("c0", 1.0, 1.0), _hinge("crank", "base", "c0", 0.0)]
    guess, closures = {"crank": angle}, []
    for i, (coupler, rocker, ground, towards, side) in enumerate(loops):
        ends = np.array(change_point((1.0, coupler, rocker, ground), side).angles(angle - towards)).ravel()
        rocker_angle, coupler_angle = np.angle((ends[::2] + 1j * ends[1::2]) * np.exp(1j * towards)).tolist()
        parts += [_rod(f"r{i}", rocker, rocker), _tip(f"r{i}", rocker), _rod(f"b{i}", coupler, coupler)]
        parts += [_tip(f"b{i}", coupler), _hinge(f"coupler_{i}", "c0", f"b{i}", 1.0)]
        place = ground * float(np.cos(towards)), ground * float(np.sin(towards))
        parts.append(_hinge(f"rocker_{i}", "base", f"r{i}", *place))
        guess |= {f"rocker_{i}": rocker_angle, f"coupler_{i}": coupler_angle - angle}
        closures.append({"frames": [f"b{i}_tip", f"r{i}_tip"], "axes": ["x", "y"]})
    declaration = {
        "closures": closures,
        "actuated": ["crank"],
        "independent": {"joints": ["crank"]},
        "reference": {"joints": {"crank": angle}, "guess": guess},
    }
    with tempfile.TemporaryDirectory() as folder:
        return load_robot(write_robot(Path(folder), "\n".join([*parts, "</robot>"]), declaration))


def random_loop(rng: np.random.Generator, towards: float) -> Loop:
    """Return a four-bar on a crank of 1 m that has a flat pose, and whose crank turns all the way round."""
    while True:
        b, c = rng.uniform(0.3, 1.2, 2).tolist()
        b, c, d = ((b, c, 1.0 + b - c), (b, c, b + c - 1.0), (b, c, 1.0 + c - b), (b, 1.0, b))[rng.integers(4)]
        factors = factor((1.0, b, c, d)) if d > 0.2 and abs(1.0 - d) > 0.03 else None
        if factors is not None and np.polynomial.Polynomial(factors[1])(np.linspace(-1.0, 1.0, 401)).min() > 1e-3:
            return b, c, d, towards, int(rng.choice([-1, 1]))
