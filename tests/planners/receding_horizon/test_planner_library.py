"""The library of the planner: compiled once, limits that change, systems without a compiler."""

from __future__ import annotations

import shlex
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import redundancy_pin as rp
from redundancy_pin.arrays import Array
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.errors import CompilerError
from redundancy_pin.machine_code import CACHE, find_compiler
from redundancy_pin.planners.options import Limits
from redundancy_pin.planners.receding_horizon import RecedingHorizon
from redundancy_pin.planners.registry import in_groups
from redundancy_pin.status import UpdateStatus
from redundancy_pin.trajectory import SpeedProfile, Trajectory
from redundancy_pin.trajectory.paths import circle_path

STEP, TICK = 0.02, 0.02
MASSES = {"end_effector_mass": 0.5, "cylinder_mass": 0.3}

_ARC = circle_path((0.25, 0.05), 0.09, start_angle=np.pi, sweep=np.pi)
ACROSS = Trajectory(_ARC, SpeedProfile(_ARC.length, 0.45, 0.2))
"""Over the singular line of the 2-RPR and back."""


@cache
def dynamics_of(name: str) -> Dynamics:
    return rp.CompiledDynamics(rp.load_robot(name, **MASSES))


HORIZON = 0.5

CHECKED = "-g", "-Wall", "-Wextra", "-Wshadow", "-Werror", "-Wno-psabi", "-fsanitize=undefined"
"""Flags of a compiler that checks; unoptimised: nothing is hidden, in a tenth of the time."""


def grid(count: int) -> Array:
    return TICK * np.arange(count)


def test_limits_that_change_between_ticks_hold() -> None:
    planner = RecedingHorizon(dynamics_of("2rpr"), step=STEP)
    for i in range(10):
        planner.update(TICK * i, ACROSS)
    fastest = 1.02 * np.abs(planner.update(TICK * 10, ACROSS).carriers.derivative()(np.linspace(0.2, 0.7, 400))).max()
    for changed in (
        Limits(acceleration=8.0),
        Limits(acceleration=8.0, jerk=600.0),
        Limits(speed=fastest),
        Limits(track=(-0.19, 0.19)),
        Limits(),
    ):
        planner.limits = changed
        t = planner.updates.last.command.t + TICK if planner.updates.last else 0.0
        command = planner.update(t, ACROSS)
        assert command.status is UpdateStatus.OK
        nodes = np.linspace(t + 1e-9, t + HORIZON, 400)
        resolved = planner.resolved
        _, sd, sdd = (np.array(part) for part in zip(*(command.motion_at(float(x)) for x in nodes), strict=True))
        later = nodes > t + STEP  # s̈ at the start is given
        assert (np.abs(sdd[later]) <= resolved.acceleration + 1e-6).all()
        assert (np.abs(sd[later]) <= resolved.speed + 1e-6).all()
        jerks = np.abs(command.carriers.derivative(3)(command.carriers.edges[command.carriers.edges < t + HORIZON]))
        assert (jerks <= resolved.jerk + 1e-3).all()


def test_without_a_compiler_it_says_what_to_install(request: pytest.FixtureRequest) -> None:
    dynamics = rp.RneaDynamics(rp.load_robot("2rpr", **MASSES))
    request.getfixturevalue("no_compiler")
    assert find_compiler() is None
    with pytest.raises(CompilerError, match=r"there is no C compiler.*pip install 'redundancy_pin\[compiler\]'"):
        RecedingHorizon(dynamics, step=STEP)


def test_its_c_has_no_warnings_and_no_undefined_behaviour(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """In first, ordinary and relaxed updates, over a singular instant: what the sanitizer finds it prints."""
    compiler, dynamics = find_compiler(), dynamics_of("2rpr")
    assert compiler is not None
    script = tmp_path / "cc"
    command = " ".join(shlex.quote(word) for word in compiler.command)
    script.write_text(f'#!/bin/sh\nexec {command} "$@" {" ".join(CHECKED)}\n')
    script.chmod(0o755)
    monkeypatch.setenv("CC", str(script))
    monkeypatch.setenv("LEVEL", "-O0")
    monkeypatch.setenv(CACHE, str(tmp_path / "kept"))
    statuses = set()
    for limits in ({}, {"effort": 0.5, "acceleration": 1.0, "jerk": 50.0, "carrier_force": 20.0}):
        planner = RecedingHorizon(dynamics, **in_groups(RecedingHorizon, {"horizon": 0.1, **limits}))
        statuses |= {planner.update(TICK * i, ACROSS).status for i in range(12)}
    assert statuses == {UpdateStatus.OK, UpdateStatus.RELAXED}
    assert "runtime error" not in capfd.readouterr().err


def test_a_library_is_compiled_once_and_kept(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    compiler, dynamics = find_compiler(), dynamics_of("2rpr")
    assert compiler is not None
    script, log, kept = tmp_path / "cc", tmp_path / "log", tmp_path / "kept"
    command = " ".join(shlex.quote(word) for word in compiler.command)
    script.write_text(f'#!/bin/sh\necho compiled >> {log}\nexec {command} "$@"\n')
    script.chmod(0o755)
    monkeypatch.setenv("CC", str(script))
    monkeypatch.setenv("LEVEL", "-O0")
    monkeypatch.setenv(CACHE, str(kept))
    for settings, times in (
        ({}, 1),
        ({"jerk": 100.0}, 1),
        ({"horizon": 0.04}, 2),
    ):
        RecedingHorizon(dynamics, **in_groups(RecedingHorizon, {"horizon": 0.08, **settings}))
        assert len(log.read_text().split()) == times
        assert len(list(kept.glob("*.so"))) == times
