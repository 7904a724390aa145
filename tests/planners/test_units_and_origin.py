"""A plan is the same whatever it is measured in, and whenever it begins.

Lengths, masses and times of the whole problem are multiplied by powers of two, large ones. What is homogeneous in them
does the same operations on numbers of other exponents, so that plans agree to rounding, iterations and refinements
included. A product in the place of a quotient shows here, in whatever tolerance, size of an unknown or stopping rule.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

import redundancy_pin as rp
from redundancy_pin.arrays import Array
from redundancy_pin.planners.options import Limits
from redundancy_pin.planners.plan import Plan
from redundancy_pin.planners.receding_horizon import run_online
from redundancy_pin.trajectory import Line, SpeedProfile, Trajectory, circle_path

ROUNDED = 1e-10
"""Relative; 1e-12 is reached."""

SAMPLED = 1e-6
"""Of what comes from samples of the motion, and of plans on line, whose ticks start from each other."""

LENGTHS = ("base_distance", "track_offset", "track_half_length", "cylinder_length", "piston_length")
MASSES = {"carrier_mass": 1.0, "end_effector_mass": 0.5, "cylinder_mass": 0.3, "piston_mass": 0.2}


@dataclass(frozen=True)
class Units:
    """How many new units of length, mass and time an old one is."""

    length: float = 1.0
    mass: float = 1.0
    time: float = 1.0
    origin: float = 0.0

    @property
    def force(self) -> float:
        """Of a force."""
        return self.mass * self.length / self.time**2


SI, OTHER = Units(), Units(length=2.0, mass=2.0**100, time=2.0**16)


@functools.cache
def dynamics_in(units: Units, only: str = "") -> rp.RneaDynamics:
    """Return those of the 2-RPR with masses everywhere, or with one kind of them."""
    shipped = rp.load_robot("2rpr")
    lengths = {name: float(shipped.parameters[name]) * units.length for name in LENGTHS}
    masses = {name: mass * units.mass for name, mass in MASSES.items() if only in ("", name)}
    return rp.RneaDynamics(rp.load_robot("2rpr", **lengths, **masses))


def timed(path: Any, speed: float, ramp: float, units: Units) -> Trajectory:
    return Trajectory(path, SpeedProfile(path.length, speed * units.length / units.time, ramp * units.time))


def circle(units: Units) -> Trajectory:
    centre = units.length * np.array([0.25, 0.185])
    return timed(circle_path(centre, 0.2 * units.length, start_angle=np.pi), 0.5, 0.25, units)


def line(units: Units, *, singular: bool = True) -> Trajectory:
    start, end = (0.1, 0.4), (0.42, -0.4 if singular else 0.2)
    return timed(Line(units.length * np.array(start), units.length * np.array(end)), 0.5, 0.25, units)


def limits(units: Units, *, forces: bool = True) -> Limits:
    every = Limits(
        speed=2.5 * units.length / units.time,
        acceleration=10.0 * units.length / units.time**2,
        track=(-0.15 * units.length, 0.15 * units.length),
    )
    return replace(every, carrier_force=100.0 * units.force, effort=200.0 * units.force) if forces else every


STEP = 2.0**-6
"""s: of samples whose times are exact, wherever they begin."""


def moving(trajectory: Trajectory, units: Units) -> Any:
    """Return the trajectory; at another origin of time its samples."""
    if not units.origin:
        return trajectory
    t = np.append(np.arange(0.0, trajectory.duration, STEP), trajectory.duration)
    sampled = trajectory.sample_at(t)
    return replace(sampled, t=max(units.origin, 0.0) + t)


def switch_off(units: Units) -> Plan:
    return rp.plan_switch_off(
        dynamics_in(units, "carrier_mass"), moving(circle(units), units), threshold=10.0,
        mesh=rp.Mesh(dt=0.02 * units.time), return_time=0.5 * units.time, ramp_down=0.05 * units.time,
    )  # fmt: skip


def stepwise(units: Units) -> Plan:
    motion = moving(line(units, singular=False), units)
    return rp.plan_stepwise(
        dynamics_in(units),
        motion,
        mesh=None if units.origin else rp.Mesh(dt=0.01 * units.time),
        limits=limits(units, forces=False),
        return_time=0.5 * units.time,
        brake_time=0.5 * units.time,
    )


def whole(objective: str, units: Units) -> Plan:
    motion = moving(line(units), units)
    return rp.plan_whole_trajectory(
        dynamics_in(units), motion, mesh=rp.Mesh(dt=0.06 * units.time), limits=limits(units), objective=objective
    )


def least_time(units: Units) -> Plan:
    path = line(units).path
    return rp.plan_time_optimal(dynamics_in(units), path, mesh=rp.Mesh(steps=16), limits=limits(units))


def online(units: Units) -> Plan:
    planner = rp.RecedingHorizon(
        dynamics_in(units), horizon=0.4 * units.time, step=0.04 * units.time, limits=limits(units)
    )
    return run_online(planner, moving(line(units), units), tick=0.16 * units.time).plan


PLANNERS: Mapping[str, tuple[Callable[[Units], Plan], float]] = {
    "switch_off": (switch_off, ROUNDED),
    "stepwise": (stepwise, ROUNDED),
    "effort": (functools.partial(whole, "effort"), ROUNDED),
    "peak": (functools.partial(whole, "peak"), ROUNDED),
    "least time": (least_time, ROUNDED),
    "online": (online, SAMPLED),
}


def same(values: Array, expected: Array, share: float) -> None:
    np.testing.assert_allclose(values, expected, atol=share * np.abs(expected).max(), rtol=0.0)


def require_same(plan: Plan, expected: Plan, units: Units, share: float) -> None:
    if plan.planner not in (
        "switch_off",
        "stepwise",
    ):  # which take no limit of force, and are judged by the robot's own
        assert plan.status is expected.status
    if plan.planner == "receding_horizon":  # sampled every 2.5 ms, whatever the unit
        t = np.linspace(0.0, expected.motion.t[-1], 301)
        same(plan.carriers_at(units.origin + units.time * t).s, units.length * expected.carriers_at(t).s, share)
        return
    assert len(plan.motion.t) == len(expected.motion.t)
    same(plan.motion.t - units.origin, units.time * expected.motion.t, share)
    same(plan.carriers.s, units.length * expected.carriers.s, share)
    same(plan.tau, units.force * expected.tau, share)
    same(plan.carrier_force, units.force * expected.carrier_force, share)
    same(plan.margin, expected.margin, share)
    assert plan.sample_status.tolist() == expected.sample_status.tolist()
    assert plan.phase.tolist() == expected.phase.tolist()
    counts = {name: value for name, value in expected.diagnostics.items() if isinstance(value, (int, str))}
    assert {name: plan.diagnostics[name] for name in counts} == counts
    assert (plan.findings.optimal, plan.findings.solver) == (expected.findings.optimal, expected.findings.solver)


@functools.cache
def plain(name: str) -> Plan:
    """Return the plan in SI units."""
    return PLANNERS[name][0](SI)


@pytest.mark.parametrize("name", PLANNERS)
def test_a_plan_does_not_depend_on_units(name: str) -> None:
    planner, share = PLANNERS[name]
    # least time begins with one of a row of speeds, per second; a plan on line is sampled every 2.5 ms; that step by
    # step knows accelerations to 1e-11 m/s²
    other = replace(OTHER, time={"least time": 1.0, "online": 2.0, "stepwise": 8.0}.get(name, OTHER.time))
    require_same(planner(other), plain(name), other, share)


@pytest.mark.long_for("peak")
@pytest.mark.parametrize("name", [name for name in PLANNERS if name != "least time"])
def test_a_plan_does_not_depend_on_when_it_begins(name: str) -> None:
    planner, _ = PLANNERS[name]
    later = Units(origin=64.0)
    require_same(planner(later), planner(Units(origin=-1.0)), later, SAMPLED)


LENGTHS_3RRR = ("base_radius", "platform_radius", "proximal_length", "distal_length", "tail_length")
MASSES_3RRR = ("proximal_mass", "distal_mass", "platform_mass", "carrier_mass")


def turning(units: Units) -> Plan:
    """Return a plan of the 3-RRR, whose platform turns: its third equation is one of moments."""
    shipped, L, T = rp.load_robot("3rrr").parameters, units.length, units.time
    numbers = {name: float(shipped[name]) * L for name in LENGTHS_3RRR}
    numbers |= {name: float(shipped[name]) * units.mass for name in MASSES_3RRR}
    corner, sizes = rp.trajectory.reference.corner(radius=0.025).sample(0.06, two_sided=False), np.array([L, L, 1.0])
    motion = rp.PlatformMotion(T * corner.t, corner.x * sizes, corner.xd * sizes / T, corner.xdd * sizes / T**2)
    return rp.plan_whole_trajectory(
        rp.RneaDynamics(rp.load_robot("3rrr", **numbers)),
        motion,
        objective=rp.Objective("effort", calm=0.0),
        mesh=rp.Mesh(dt=0.06 * T, refinements=0),
        limits=Limits(
            track=(-0.3 * L, 0.3 * L), speed=5.0 * L / T, acceleration=20.0 * L / T**2, carrier_force=np.inf,
            effort=np.inf, actuator_speed=np.inf,
        ),
    )  # fmt: skip


def test_a_plan_of_a_platform_that_turns_does_not_depend_on_units() -> None:
    units = Units(length=2.0**10, mass=2.0**20, time=2.0**4)
    plan, expected = turning(units), turning(SI)
    assert (plan.status, plan.diagnostics["iterations"]) == (expected.status, expected.diagnostics["iterations"])
    same(plan.carriers.s, units.length * expected.carriers.s, ROUNDED)
    same(plan.tau, units.force * units.length * expected.tau, ROUNDED)
    same(plan.carrier_force, units.force * expected.carrier_force, ROUNDED)


SMALL, SLOW = Units(2.0**-20, 2.0**-30, 1.0), Units(2.0**-20, 2.0**-20, 2.0**20)
"""A machine of a micrometre and a nanogram, and a slow one."""


@pytest.mark.long_for("small-peak", "small-stepwise", "slow-effort")
@pytest.mark.parametrize(
    ("units", "name"),
    # the other planners have tolerances with units yet
    [
        pytest.param(units, name, id=f"{label}-{name}")
        for units, label, names in (
            (SMALL, "small", ("stepwise", "effort", "peak", "least time")),
            (SLOW, "slow", ("effort", "peak")),
        )
        for name in names
    ],
)
def test_a_plan_is_the_same_for_machines_of_any_size(units: Units, name: str) -> None:
    planner, share = PLANNERS[name]
    require_same(planner(units), plain(name), units, share)
