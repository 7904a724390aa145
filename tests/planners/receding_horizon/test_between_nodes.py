"""What an update makes of a plan: its largest effort, and limits between its nodes."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

import redundancy_pin as rp
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.planners.receding_horizon import RecedingHorizon
from redundancy_pin.planners.receding_horizon.command import extended
from redundancy_pin.planners.receding_horizon.preview import Preview
from redundancy_pin.planners.registry import in_groups
from redundancy_pin.status import UpdateStatus
from redundancy_pin.trajectory import SpeedProfile, Trajectory
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
        made = planner.updates.last
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


@pytest.mark.parametrize("name", ["2rpr", "3rrr", "driven elbow"])
def test_what_limits_cut_off_until_the_next_node_is_told_as_the_other_backend_has_it(name: str) -> None:
    """At the instants of a step where an effort is at its limit; a thousandth of the size of f decides.

    Of a preview that ends at the update nothing is told of what comes.
    """
    other, motion, cut = backends(name)[1], MOTIONS[name], 0
    free = planner_of(name)
    for i, most in ((i, most) for i in range(3, 20, 4) for most in (0.8, 0.97, 1.0 - 1e-5)):
        t = STEP * i
        instants = t + STEP / 8.0 * np.arange(9)
        limit = most * np.abs(free.update(t, motion).efforts(instants)).max(axis=0)
        planner = planner_of(name, effort=np.maximum(limit, 1e-3))
        command = planner.update(t, motion)
        if "force is missing" in command.reason or "every limit" in command.reason:
            continue
        carriers = rp.CarrierMotion(*extended(command.carriers, instants), check_rates=False)
        reduced = other.reduce(motion.sample_at(instants), carriers, check_track=False)
        efforts = command.efforts(instants)
        missing = np.abs(np.einsum("nij,nj->ni", reduced.W, efforts) - reduced.f) / reduced.row_scale
        meets = (np.abs(efforts) >= planner.resolved.effort * (1.0 - 1e-12)).any(axis=1)
        worst = missing[meets].max(initial=0.0)
        assert command.residual == pytest.approx(worst, rel=1e-5, abs=1e-9)
        size = planner.updates.last.row.max()
        if abs(worst / size - 1e-3) > 1e-5:
            assert (command.status is RELAXED) == (worst > 1e-3 * size)
            assert ("the efforts exceed their limits" in command.reason) == (worst > 1e-3 * size)
        cut += worst > 1e-3 * size
        ended = planner_of(name, effort=planner.resolved.effort).update(t, replace(Preview.of(motion), end=t))
        assert "between the nodes" not in ended.reason
        assert ended.residual < 1e-9 or "no plan" in ended.reason
    assert cut


@pytest.mark.parametrize("start", [0.0, 0.3])
def test_where_a_plan_begins_at_a_singular_instant_the_command_goes_on_from_the_last_one(start: float) -> None:
    """Up to there all is the last one's; efforts are linear from there to the first exact ones."""
    planner = planner_of()
    root = float(rp.find_crossings(planner.robot, ACROSS)[0].t)
    for part in (-4.0, -3.0, -2.0, -1.0):
        last = planner.update(root + STEP * part, ACROSS)
    for part in (-0.22, -0.22 + 0.5 * start, -0.05):
        t = root + STEP * part
        command = planner.update(t, ACROSS)
        assert planner.updates.last.nodes[0] == pytest.approx(root, abs=1e-8)
        begins = float(planner.updates.last.nodes[0])
        times = np.linspace(t, begins, 12)[:-1]
        for own, before in zip(
            (command.carriers, command.efforts, command.forces), (last.carriers, last.efforts, last.forces), strict=True
        ):
            np.testing.assert_allclose(own(times), before(times), rtol=1e-9, atol=1e-9)
            assert (np.diff(own.edges) > 0.0).all()
        between = command.efforts.edges[command.efforts.edges > begins][0]
        thirds = command.efforts(np.linspace(begins, between - 1e-12, 4))
        np.testing.assert_allclose(np.diff(thirds, 2, axis=0), 0.0, atol=1e-9)
        edges = command.efforts.edges
        assert planner.updates.last.largest >= np.abs(command.efforts(edges[edges <= begins])).max()
        last = command


@pytest.mark.parametrize(("step", "before", "t"), [(STEP, 0.068, 0.214), (0.0215, 0.125, 0.2135)])
def test_where_the_last_plan_ends_before_a_singular_instant_it_is_held_up_to_there(
    step: float, before: float, t: float
) -> None:
    """After missed updates: efforts and forces are its last ones, whether it ends before the update or behind it."""
    planner = RecedingHorizon(backends()[0], step=step, horizon=0.1)
    root = float(rp.find_crossings(planner.robot, ACROSS)[0].t)
    slow = Trajectory(_ARC, SpeedProfile(_ARC.length, 0.3, 0.2))  # it is not at the singular line yet
    last = planner.update(before, slow)
    command = planner.update(t, ACROSS)
    assert planner.updates.last.nodes[0] == pytest.approx(root, abs=1e-8)
    for own, old in ((command.efforts, last.efforts), (command.forces, last.forces)):
        assert (np.diff(own.edges) > 0.0).all()
        times = np.linspace(t, root - 1e-9, 30)
        expected = old(np.minimum(times, old.end))
        np.testing.assert_allclose(own(times), expected, rtol=1e-9, atol=1e-9)
    assert (last.efforts.end < t) == (step == STEP)
    assert last.efforts.end < root - 1e-4


@pytest.mark.parametrize("name", ["2rpr", "3rrr"])
def test_a_preview_that_is_given_anew_at_every_update_makes_the_same_plans(name: str) -> None:
    """Sharp turns are those of the motion, however often it is looked at."""
    one, anew = planner_of(name), planner_of(name)
    for t in (STEP * np.arange(40)).tolist():
        own, other = one.update(t, MOTIONS[name]), anew.update(t, Preview.of(MOTIONS[name]))
        assert other.status is own.status
        np.testing.assert_allclose(anew.updates.last.nodes, one.updates.last.nodes, atol=1e-9)
        np.testing.assert_allclose(other.tau, own.tau, rtol=1e-6, atol=1e-6 * np.abs(own.tau).max())
