"""What an update makes of a plan: its largest effort, and limits between its nodes."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

import redundancy_pin as rp
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.planners.options import Limits
from redundancy_pin.planners.receding_horizon import RecedingHorizon
from redundancy_pin.planners.receding_horizon.command import extended
from redundancy_pin.planners.registry import in_groups
from redundancy_pin.status import UpdateStatus
from redundancy_pin.trajectory import SpeedProfile, Trajectory
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial
from redundancy_pin.trajectory.paths import circle_path

_ARC = circle_path((0.25, 0.05), 0.09, start_angle=np.pi, sweep=np.pi)
ACROSS = Trajectory(_ARC, SpeedProfile(_ARC.length, 0.45, 0.2))
"""Over the singular line and back."""

STEP = 0.02
NEAR, SETTLED, CONVERGED = 0.25, 2.0, 2.5
"""Steps before a singular instant in which a plan begins there, goes on from the last one, has several rounds."""

FINER = 1e-4
"""s, between samples of what is integrated by trapezia."""


CORNER = rp.trajectory.reference.corner(radius=0.025)
MOTIONS = {"2rpr": ACROSS, "3rrr": CORNER, "driven elbow": CORNER}


@cache
def backends(name: str = "2rpr") -> tuple[Dynamics, Dynamics]:
    """What plans, and what judges.

    Of platforms that turn moments count over a characteristic length; with one more motor than coordinates many
    efforts do as well.
    """
    if name == "2rpr":
        robot = rp.load_robot("2rpr", end_effector_mass=0.5, cylinder_mass=0.3)
        return rp.CompiledDynamics(robot), rp.VirtualWork(robot)
    robot = replace(rp.load_robot("3rrr"), characteristic_length=0.2)
    if name == "3rrr":
        return rp.CompiledDynamics(robot), rp.VirtualWork(robot)
    driven = replace(robot, actuated=(*robot.actuated, "elbow_1"))
    return rp.RneaDynamics(driven), rp.RneaDynamics(driven)


def planner_of(name: str = "2rpr", **settings: Any) -> RecedingHorizon:
    return RecedingHorizon(backends(name)[0], step=STEP, **in_groups(RecedingHorizon, settings))


OK, RELAXED = UpdateStatus.OK, UpdateStatus.RELAXED


def test_the_largest_effort_of_a_plan_is_that_of_its_command_up_to_the_next_tick() -> None:
    """Across a singular instant, where a part of the command is that of the last plan, and not behind the step."""
    planner, later = RecedingHorizon(backends()[0], step=STEP), 0
    for i in range(26):
        t = 0.06 + STEP * i
        efforts = planner.update(t, ACROSS).efforts
        made = planner.ticks.last
        assert made is not None
        ends = efforts.edges[efforts.edges < t + STEP]
        at_fifths, everywhere = (
            np.abs(efforts(times)).max()
            for times in (t + STEP * np.linspace(0.0, 1.0, 5), np.append(ends[ends >= t], [t, t + STEP]))
        )
        assert made.largest == pytest.approx(at_fifths, rel=1e-9)
        assert made.largest <= everywhere * (1.0 + 1e-9)
        later += made.largest < 0.9 * np.abs(efforts(efforts.edges)).max()
    assert later > 5


# the efforts up to the next node


@pytest.mark.parametrize("name", ["2rpr", "3rrr"])
@pytest.mark.parametrize("known", [True, False])
def test_what_limits_cut_off_until_the_next_node_is_looked_at_where_they_are_met(name: str, known: bool) -> None:
    """By the other backend: in a step, at the instants where an effort is at its limit, or later than that."""
    other, motion, t = backends(name)[1], MOTIONS[name], 0.06
    planner = planner_of(name)
    plan = planner.update(t, motion)
    sizes = planner.ticks.sizes
    assert sizes is not None
    end = t + STEP if known else t
    plan = replace(plan, known_until=t + 0.4 if known else t)
    instants = t + STEP / 8.0 * np.arange(9)
    efforts = plan.efforts(np.append(instants, instants[-1] + STEP))
    for most in (0.6, 0.97, 1.0 - 1e-5, 1.5):  # of the largest efforts of this step: too little, nearly enough
        limit = most * np.abs(efforts[:9]).max(axis=0)
        planner.limits = Limits(effort=limit)
        cut = np.clip(efforts, -limit, limit)
        command = replace(
            plan, efforts=PiecewisePolynomial.linear(np.append(instants, instants[-1] + STEP), cut), residual=1e-9
        )
        carriers = rp.CarrierMotion(*extended(command.carriers, instants), check_rates=False)
        reduced = other.reduce(motion.sample_at(instants), carriers, check_track=False)
        W, f = reduced.W / reduced.row_scale[:, None], reduced.f / reduced.row_scale
        missing = np.abs(np.einsum("nij,nj->ni", W, cut[:9]) - f).max(axis=1)
        meets = (np.abs(cut[:9]) >= limit * (1.0 - 1e-12)).any(axis=1) & (instants <= end + 1e-9)
        worst = missing[meets].max(initial=0.0)
        found = planner.ticks.checked_between(t, command)
        assert found.residual == pytest.approx(max(worst, 1e-9), rel=1e-5, abs=1e-7)
        softened = worst > 1e-3 * sizes.row.max()
        assert found.status is (RELAXED if softened else OK)
        assert bool(found.reason) == softened
        if worst > 1e-4:  # a thousandth of the size of f, and that alone, decides
            for part, elastic in ((1.1, False), (0.9, True)):
                planner.ticks.sizes = replace(sizes, row=part * 1e3 * worst * np.array([0.1, 1.0]))
                assert (planner.ticks.checked_between(t, command).status is RELAXED) == elastic
            planner.ticks.sizes = sizes


def test_a_moment_that_limits_cut_off_counts_over_the_characteristic_length() -> None:
    planner, other, t = planner_of("3rrr"), backends("3rrr")[1], 0.06
    plan = planner.update(t, CORNER)
    instants = t + STEP / 8.0 * np.arange(9)
    carriers = rp.CarrierMotion(*extended(plan.carriers, instants), check_rates=False)
    reduced = other.reduce(CORNER.sample_at(instants), carriers, check_track=False)
    efforts = np.linalg.solve(reduced.W, (reduced.f + np.array([0.3, 0.0, 0.9]))[..., None])[..., 0]
    planner.limits = Limits(effort=1e-3 * np.abs(efforts).max())
    found = planner.ticks.checked_between(t, replace(plan, efforts=PiecewisePolynomial.linear(instants, efforts)))
    assert found.residual == pytest.approx(0.9 / 0.2, rel=1e-5)
