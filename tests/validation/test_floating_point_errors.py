"""Kinematics, dynamics and singularities with numpy raising its floating-point errors, at singular poses too."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from folding import folding_four_bar

import redundancy_pin as rp
from redundancy_pin.motion import PlatformMotion


@pytest.fixture(autouse=True)
def errors_raised() -> Iterator[None]:
    with np.errstate(all="raise"):
        yield


def motion_between(start: list[float], end: list[float], samples: int) -> PlatformMotion:
    x = np.linspace(start, end, samples)
    return PlatformMotion(np.arange(samples) * 0.1, x, np.ones_like(x), np.zeros_like(x), check_rates=False)


@pytest.mark.parametrize("backend", [rp.RneaDynamics, rp.VirtualWork])
@pytest.mark.parametrize("name", ["2rpr", "3rrr"])
def test_dynamics_of_a_motion(name: str, backend: type) -> None:
    robot = rp.load_robot(name)
    path = rp.trajectory.reference.circle(speed=0.5) if name == "2rpr" else rp.trajectory.reference.corner(radius=0.025)
    along = backend(robot).along(path.sample(dt=0.02))
    reduced = along.reduce()
    efforts = rp.distribute(reduced)
    assert np.isfinite(efforts.tau[efforts.solved]).all()
    rp.distribute(reduced, lower=np.full(robot.m, -0.01), upper=np.full(robot.m, 0.01))
    rp.distribute(reduced, weights=np.arange(1.0, robot.m + 1.0))
    assert np.isfinite(along.carrier_derivatives().f_s).all()
    assert np.isfinite(along.base_wrench()).all()
    assert np.isfinite(along.energy()).all()


@pytest.mark.long_for(
    "3-RRR out of reach-RneaDynamics", "past the base hinge-RneaDynamics", "out of reach-RneaDynamics"
)
@pytest.mark.parametrize("backend", [rp.RneaDynamics, rp.VirtualWork])
@pytest.mark.parametrize(
    ("name", "start", "end", "samples"),
    [
        ("2rpr", [0.0, 0.0], [3.0, 3.0], 30),
        ("2rpr", [-0.2, -0.4], [0.2, 0.4], 30),
        ("2rpr", [-0.2, -0.4], [0.2, 0.4], 21),
        ("3rrr", [0.0, 0.0, 0.0], [3.0, 3.0, 1.0], 30),
    ],
    ids=["out of reach", "past the base hinge", "through the base hinge", "3-RRR out of reach"],
)
def test_poses_out_of_reach_and_singular_ones_are_marked(
    name: str, start: list[float], end: list[float], samples: int, backend: type
) -> None:
    reduced = backend(rp.load_robot(name)).reduce(motion_between(start, end, samples), unreachable="mark")
    efforts = rp.distribute(reduced)
    assert np.isnan(efforts.tau[~reduced.reachable]).all()


def test_flat_four_bar(tmp_path: Path) -> None:
    robot = folding_four_bar(tmp_path, (0.3, 0.2, 0.3, 0.2), (1.0, 1.0, 2.0))
    motion = motion_between([np.pi - 0.5], [np.pi + 0.5], 51)
    along = rp.RneaDynamics(robot).along(motion)
    rp.joint_reactions(along, rp.distribute(along.reduce()).tau)
    assert rp.classify_motion(along.tree, tolerance=1e-7).type_i[25]
    rp.find_crossings(robot, motion)


@pytest.mark.long
def test_crossings_and_loci() -> None:
    robot = rp.load_robot("2rpr")
    assert rp.find_crossings(robot, rp.trajectory.reference.circle(speed=0.5))
    for name in ("2rpr", "3rrr", "five_bar", "four_bar"):
        assert np.isfinite(rp.singular_locus(rp.load_robot(name), resolution=13).serial_margin).any()
