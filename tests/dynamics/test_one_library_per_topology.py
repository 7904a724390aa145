"""Robots that differ in numbers share compiled code: libraries are counted in an empty cache, no clock is read."""

from __future__ import annotations

import dataclasses
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import zoo
from spatial_chains import chain_of
from written import J, urdf_of, write_robot

import redundancy_pin as rp
from redundancy_pin.dynamics.compiled.parameters import topology_of
from redundancy_pin.errors import CompilerError
from redundancy_pin.kinematics.assembly import assemble
from redundancy_pin.kinematics.closure import ConstraintSystem
from redundancy_pin.machine_code import CACHE
from redundancy_pin.robot import Robot


@pytest.fixture(autouse=True)
def without_kinematics(monkeypatch: pytest.MonkeyPatch) -> None:
    """Regular motions are followed by generated code alone: asking the kinematics would hide its mistakes."""

    def refuse(*given: object, **named: object) -> None:
        raise AssertionError("generated code did not follow the motion")

    monkeypatch.setattr("redundancy_pin.dynamics.compiled.closing.inverse_kinematics", refuse)


def libraries(folder: Path) -> int:
    return len(list(folder.glob("*.so")))


def assert_backends_agree(dynamics: rp.CompiledDynamics) -> None:
    """Inverse and forward dynamics, at a motion about the robot's own reference."""
    robot, t = dynamics.robot, np.linspace(0.0, 1.0, 7)
    motion, carriers = zoo.smooth_motion(robot, 3).at(t), zoo.carriers_at(robot, t) if robot.k else None
    got, want = (of.along(motion) for of in (dynamics, rp.RneaDynamics(robot)))
    ours, theirs = got.reduce(carriers), want.reduce(carriers)
    for name in ("f", "W", "carrier_force"):
        expected = getattr(theirs, name)
        np.testing.assert_allclose(
            getattr(ours, name), expected, atol=1e-11 * (1.0 + np.abs(expected).max(initial=0.0))
        )
    for quantity in ("energy", "base_wrench"):
        expected = getattr(want, quantity)(carriers)
        np.testing.assert_allclose(
            getattr(got, quantity)(carriers), expected, atol=1e-11 * (1.0 + np.abs(expected).max())
        )


def changed_in_every_number(name: str) -> list[Robot]:
    """The robot with one number of its file changed each; a link of two halves stays symmetric (a structural zero)."""
    robot = rp.load_robot(name)
    numbers = {key: value for key, value in robot.parameters.items() if type(value) is float and value}
    halves = {key for key in numbers if key in ("distal_length", "tail_length")}
    changes = [{key: 1.03 * numbers[key] for key in (halves if one in halves else {one})} for one in numbers]
    return [rp.load_robot(name, **change) for change in changes]


def payloads(name: str) -> list[Robot]:
    """The robot with payloads on its platform, or on the first link that a closure joins."""
    robot = rp.load_robot(name)
    link = robot.platform.frame if robot.platform else robot.closures[0].frame_a
    return [
        robot.loaded(rp.Payload(link, mass, centre, inertia))
        for mass, centre, inertia in ((0.7, (0.01, 0.02, 0.03), 0.001), (0.2, (0.0, 0.0, 0.0), 0.0))
    ]


@pytest.mark.parametrize(("name", "loaded"), [("four_bar", 4), pytest.param("3rrr", 2, marks=pytest.mark.long)])
def test_another_number_is_not_another_library(
    name: str, loaded: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(CACHE, str(tmp_path))
    first = rp.CompiledDynamics(name)
    assert first.forward() is not None
    assert libraries(tmp_path) == 2  # inverse and forward dynamics
    robots = changed_in_every_number(name)
    assert len(robots) > 5
    for i, robot in enumerate(robots):
        dynamics = first.for_robot(robot) if i % 2 else rp.CompiledDynamics(robot)
        assert dynamics.forward() is not None
        assert_backends_agree(dynamics)
    assert_backends_agree(first)  # which none of the others has changed
    assert libraries(tmp_path) == 2
    assert len({topology_of(robot).text for robot in payloads(name)}) == 1
    for robot in payloads(name):  # a link that is no platform gets another topology, once
        dynamics = first.for_robot(robot)
        assert dynamics.forward() is not None
        assert_backends_agree(dynamics)
        assert libraries(tmp_path) == loaded


def test_robots_of_a_topology_share_one_object_that_is_looked_up_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither another object for a robot, nor one for another mass, looks for a compiler, reads a file or loads one."""
    robot = rp.load_robot("four_bar")
    first = rp.CompiledDynamics(robot)
    motion = zoo.smooth_motion(robot, 3).at(np.linspace(0.0, 1.0, 3))
    forward, force = first.forward(), first.reduce(motion).f
    assert forward is not None

    def refuse(*given: object) -> None:
        raise AssertionError("the library was not kept")

    monkeypatch.setattr("redundancy_pin.dynamics.compiled.build.built", refuse)
    for i in range(100):
        model = robot.model.copy()
        model.inertias[1].mass += 0.01 * i
        heavier = dataclasses.replace(robot, model=model)
        other = first.for_robot(heavier) if i % 2 else rp.CompiledDynamics(heavier)
        assert other.kernel.library is first.kernel.library
        own = other.forward()
        assert own is not None
        assert own.library is forward.library
        assert np.array_equal(other.reduce(motion).f, force) is (i == 0)


def test_another_folder_or_compiler_counts_from_when_it_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rp.CompiledDynamics("four_bar")
    monkeypatch.setenv(CACHE, str(tmp_path))
    rp.CompiledDynamics("four_bar")
    assert libraries(tmp_path) == 1
    monkeypatch.setenv("CC", "no such compiler")
    monkeypatch.setenv("PATH", "")
    with pytest.raises(CompilerError):
        rp.CompiledDynamics("four_bar")


def of_modes() -> list[Robot]:
    return [zoo.robot_of("five_bar", working_mode=mode) for mode in ((1, 1), (-1, -1), (1, -1))]


def of_loads() -> list[Robot]:
    """Loads of another size, and one of another kind."""
    robot = zoo.robot_of("four_bar")
    joint = str(robot.model.names[1])
    loads = [
        rp.JointForces(joint, size, size, 0.02 * size, size, 0.1 * size, 0.01 * size, -2.0 * size)
        for size in (1.0, 3.7)
    ]
    return [robot.loaded(load) for load in (*loads, rp.JointForces(joint, damping=1.0))]


def of_gravity() -> list[Robot]:
    """Structural zeros are compiled: gravity along y alone, and along x too."""
    directions = ((0.0, -9.81, 0.0), (0.0, -3.7, 0.0), (1.0, -9.81, 0.0))
    return [zoo.robot_of("four_bar", gravity=gravity) for gravity in directions]


@pytest.mark.parametrize(("robots", "last"), [(of_modes, 1), (of_loads, 2), (of_gravity, 2)])
def test_modes_and_numbers_share_a_library_and_kinds_do_not(
    robots: Callable[[], list[Robot]], last: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(CACHE, str(tmp_path))
    for robot, count in zip(robots(), (1, 1, last), strict=True):
        assert_backends_agree(rp.CompiledDynamics(robot))
        assert libraries(tmp_path) == count


@pytest.mark.parametrize(("size", "same"), [(1e-17, True), (1e-9, False)])
def test_rounding_makes_no_other_topology(size: float, same: bool) -> None:
    """Zero beside the characteristic length, the mass and the inertia, and beside 1 in a rotation."""
    robot = rp.load_robot("four_bar")
    body = robot.model.inertias[2]

    def moved(model: pin.Model) -> None:
        model.jointPlacements[2].translation = model.jointPlacements[2].translation + size * np.array([0.0, 0.0, 1.0])

    def turned(model: pin.Model) -> None:
        model.jointPlacements[2].rotation = model.jointPlacements[2].rotation @ pin.exp3(np.array([size, 0.0, 0.0]))

    def heavier(model: pin.Model) -> None:
        model.inertias[2] = pin.Inertia(body.mass, body.lever + size * np.array([0.0, 0.0, 1.0]), body.inertia)

    for change in (moved, turned, heavier):
        model = robot.model.copy()
        change(model)
        assert (topology_of(dataclasses.replace(robot, model=model)) == topology_of(robot)) is same


def test_lengths_of_rods_and_further_terms_of_couplings_are_numbers(tmp_path: Path) -> None:
    rod = chain_of("rod")
    joints = [J(name, "revolute", "base", name, rpy=(0.3, 0.2 * i, 0.0)) for i, name in enumerate(("a", "b", "c"))]
    coupling = {"joint": "c", "of": "a", "polynomial": [0.2, 1.5], "also": [["b", -0.7]]}
    roles = {
        "actuated": ["a", "b"],
        "independent": {"joints": ["a", "b"]},
        "reference": {"joints": {"a": 0.1, "b": 0.2}},
    }
    geared = rp.load_robot(
        write_robot(tmp_path, urdf_of(joints), {**roles, "couplings": [coupling]}), gravity=(1, 2, -9)
    )
    longer = dataclasses.replace(rod.closures[0], length=1.01 * rod.closures[0].length)
    other = dataclasses.replace(geared.couplings[0], also=(("b", 0.4),))
    for robot, changed in ((rod, {"closures": (longer,)}), (geared, {"couplings": (other,)})):
        assert_backends_agree(rp.CompiledDynamics(robot))
        new = closed_again(dataclasses.replace(robot, **changed))
        assert topology_of(new) == topology_of(robot)
        assert_backends_agree(rp.CompiledDynamics(new))


def closed_again(robot: Robot) -> Robot:
    """Return a robot with its reference closed, its independent joints as they were."""
    system = ConstraintSystem(robot)
    state = assemble(system, np.array(robot.q_reference)[None], zoo.home_of(robot)[None])
    assert state.closed.all()
    return dataclasses.replace(robot, q_reference=state.q[0])


def test_every_role_is_part_of_a_topology() -> None:
    """A library under the name of another topology would be loaded, and its answers would be wrong."""
    robot = rp.load_robot("3rrr")
    first, *rest = robot.closures
    platform, modes = robot.platform, robot.working_modes
    assert platform is not None
    assert modes is not None
    others = [
        {"closures": (dataclasses.replace(first, axes=first.axes[:1]), *rest)},
        {"closures": (dataclasses.replace(first, frame_a=first.frame_b, frame_b=first.frame_a), *rest)},
        {"platform": dataclasses.replace(platform, pointer=1)},
        {"platform": dataclasses.replace(platform, axes=platform.axes[:2])},
        {"actuated": robot.actuated[::-1]},
        {"carriers": robot.carriers[::-1]},
        {"working_modes": dataclasses.replace(modes, joints=modes.joints[::-1])},
        {"loads": (rp.JointForces(robot.actuated[0], damping=1.0),)},
        {"loads": (rp.Wrench(platform.frame, np.ones(6), "local"),)},
        {"loads": (rp.Wrench(platform.frame, np.ones(6), "world"),)},
    ]
    texts = [topology_of(dataclasses.replace(robot, **other)).text for other in others]
    assert len({topology_of(robot).text, *texts}) == len(others) + 1


def test_a_robot_with_other_numbers_does_not_import_casadi(tmp_path: Path) -> None:
    code = (
        "import sys, redundancy_pin as rp\n"
        "for length in {lengths}:\n"
        "    rp.CompiledDynamics(rp.load_robot('four_bar', coupler_length=length))\n"
        "print('casadi' in sys.modules)"
    )
    environment = {**os.environ, CACHE: str(tmp_path)}
    for lengths, imported in ("[0.35]", "True"), ("[0.36, 0.37]", "False"):
        run = subprocess.run(
            [sys.executable, "-c", code.replace("{lengths}", lengths)],
            capture_output=True, text=True, env=environment, check=True,
        )  # fmt: skip
        assert run.stdout.strip() == imported
    assert libraries(tmp_path) == 1


def test_derivatives_of_another_robot_are_not_written_again() -> None:
    """The expressions are those of the topology; their numbers are differences of the other backend's forces."""
    from redundancy_pin.dynamics.compiled.derivatives import _written

    names, h = ["coupler_length", "coupler_mass"], 1e-5
    _written.cache_clear()
    for length in (0.35, 0.36):
        robot = rp.load_robot("four_bar", coupler_length=length)
        motion = zoo.smooth_motion(robot, 5).at(np.linspace(0.0, 1.0, 5))
        got = rp.CompiledDynamics(robot).along(motion).derivatives(parameters=names).f.parameters
        for i, name in enumerate(names):
            up, down = (
                rp.RneaDynamics(rp.load_robot("four_bar", **{**robot.parameters, name: robot.parameters[name] + by}))
                for by in (h, -h)
            )
            expected = (up.reduce(motion).f - down.reduce(motion).f) / (2.0 * h)
            np.testing.assert_allclose(got[:, :, i], expected, rtol=1e-6, atol=1e-7)
    assert _written.cache_info().misses == 1
