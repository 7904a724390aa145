"""Every way in which a stepwise plan is refused."""

from __future__ import annotations

import functools

import numpy as np
import pytest

from redundancy_pin import PlatformMotion, RneaDynamics, VirtualWork, load_robot
from redundancy_pin.errors import InfeasiblePlanError, InputError, UnsupportedRobotError
from redundancy_pin.planners.options import Limits, Objective
from redundancy_pin.planners.stepwise.planner import plan_stepwise
from redundancy_pin.status import ResultStatus
from redundancy_pin.studies.case import in_groups
from redundancy_pin.trajectory import reference


@functools.cache
def dynamics_of(name="3rrr", **arguments):
    return VirtualWork(load_robot(name, **arguments))


@functools.cache
def motion_of(radius=0.025):
    return reference.corner(radius=radius).sample(0.01, two_sided=False)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"lam": -0.1}, "lam"),
        ({"lam": 1.1}, "lam"),
        ({"lam": float("nan")}, "lam"),
        ({"lam": "half"}, "lam"),
        ({"lam": 0.5}, "no baseline"),
        ({"lam": 0.5, "baseline": np.zeros((3, 3))}, "baseline"),
        ({"active": "never"}, "active"),
        ({"anticipate": "no"}, "anticipate"),
        ({"stop": "never"}, "stop"),
        ({"return_time": "quick"}, "return_time"),
        ({"return_time": 0.0}, "return_time"),
        ({"brake_time": -1.0}, "brake_time"),
        ({"least_margin": 0.0}, "least_margin"),
        ({"start": (0.0, 0.0)}, "start"),
        ({"datum": "middle"}, "datum"),
        ({"speed": 0.0}, "speed"),
        ({"speed": (1.0, 1.0)}, "speed"),
        ({"acceleration": -7.0}, "acceleration"),
        ({"acceleration": float("nan")}, "acceleration"),
        ({"track": (1.0, -1.0)}, "track"),
        ({"track": 1.0}, "track"),
        ({"acceleration": np.inf, "stop": "within"}, "acceleration"),
    ],
)
def test_settings_out_of_their_domain(settings, message):
    with pytest.raises(InputError, match=message):
        plan_stepwise(dynamics_of(), motion_of(), **in_groups(plan_stepwise, settings))


def test_a_single_instant_is_no_motion():
    with pytest.raises(InputError, match="1 samples, too few"):
        plan_stepwise(dynamics_of(), motion_of()[:1])


def test_a_baseline_of_another_mechanism():
    with pytest.raises(InputError, match="baseline"):
        plan_stepwise(dynamics_of(), motion_of(), objective=Objective(lam=0.5, baseline=dynamics_of("2rpr")))


@pytest.mark.parametrize("name", ["start", "datum"])
def test_a_place_off_the_track(name):
    with pytest.raises(InfeasiblePlanError, match="off its track") as caught:
        plan_stepwise(dynamics_of(), motion_of(), **in_groups(plan_stepwise, {name: (0.0, 1.2, 0.0)}))
    assert caught.value.details["carrier"] == "carrier_2"
    assert caught.value.details["amount"] == pytest.approx(0.2)


def test_a_robot_without_carriers():
    with pytest.raises(UnsupportedRobotError, match="no carriers"):
        plan_stepwise(dynamics_of(carriers=False), motion_of())


def test_a_motion_across_a_type_ii_singularity():
    motion = reference.circle().sample(0.01, two_sided=False)
    with pytest.raises(InfeasiblePlanError, match="type II") as caught:
        plan_stepwise(dynamics_of("2rpr"), motion)
    assert caught.value.details["constraint"] == "margin"
    assert 0.40 < caught.value.details["time"] < 0.95


def test_a_spatial_singularity_is_refused_and_the_planner_that_crosses_it_named():
    poses = np.tile(np.eye(4), (2, 1, 1))
    poses[:, 2, 3] = 0.6
    for pose, yaw in zip(poses, np.radians([70.0, 110.0]), strict=True):
        pose[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
    with pytest.raises(InfeasiblePlanError, match="plan_whole_trajectory") as caught:
        plan_stepwise(RneaDynamics(load_robot("gough", carriers=True)), reference.pose(*poses, 1.0), dt=0.05)
    assert caught.value.details["time"] == pytest.approx(0.5)  # half way, at 90 degrees of yaw


def test_a_crossing_between_samples_with_margins_on_both_sides():
    motion = reference.line(speed=0.2).sample(0.5, two_sided=False)
    with pytest.raises(InfeasiblePlanError, match="crosses a type II singularity between") as caught:
        plan_stepwise(dynamics_of("2rpr"), motion)
    time = caught.value.details["time"]
    y = np.interp([time, time + 0.5], motion.t, motion.x[:, 1])
    assert y[0] > 0.0 > y[1]  # the line between the two bases is y = 0


def test_a_margin_below_the_wanted_one():
    with pytest.raises(InfeasiblePlanError, match="too close") as caught:
        plan_stepwise(dynamics_of(), motion_of(), least_margin=0.9)
    assert caught.value.details["margin"] < 0.9


def test_the_small_corner_of_the_thesis_ends_with_a_carrier_that_cannot_stop():
    plan = plan_stepwise(dynamics_of(), motion_of(0.013), anticipate=False)
    assert plan.status is ResultStatus.LIMIT_VIOLATED
    (event,) = plan.limits.violated
    assert (event.carrier, event.quantity) == ("carrier_2", "track")
    assert event.worst > motion_of(0.013).t[-1]
    assert 0.01 < event.amount < 0.1
    plan_stepwise(dynamics_of(), motion_of(0.013))  # with anticipation it stops


def test_without_anticipation_a_short_track_empties_the_box():
    with pytest.raises(InfeasiblePlanError, match="beyond the end of its track") as caught:
        plan_stepwise(dynamics_of(), motion_of(), anticipate=False, limits=Limits(track=(-0.1, 0.1)))
    details = caught.value.details
    assert details["constraint"] == "track"
    assert 0.0 < details["time"] < 0.8
    assert details["amount"] > 0.0


def test_a_return_that_cannot_keep_the_limits():
    # it starts at the speed limit with the carriers still accelerating outwards
    with pytest.raises(InfeasiblePlanError, match="No return") as caught:
        plan_stepwise(
            dynamics_of(),
            motion_of(),
            active="accelerating",
            return_time="shortest",
            limits=Limits(track=(-0.16, 0.16)),
        )
    assert caught.value.details["amount"] > 0.0


def test_carriers_that_move_when_a_platform_does_not_come_to_rest():
    whole = motion_of()
    motion = PlatformMotion(whole.t[:70], whole.x[:70], whole.xd[:70], whole.xdd[:70])
    with pytest.raises(InfeasiblePlanError, match="platform moves on") as caught:
        plan_stepwise(dynamics_of(), motion)
    assert caught.value.details["constraint"] == "rest"
    plan = plan_stepwise(dynamics_of(), motion, stop="within")
    assert np.abs(plan.carriers.sd[-1]).max() < 1e-12


def test_an_unfinished_return_at_the_end_of_a_motion():
    whole = motion_of()
    motion = PlatformMotion(whole.t[:50], whole.x[:50], whole.xd[:50], whole.xdd[:50])
    for stop in ("after", "within"):
        with pytest.raises(InfeasiblePlanError, match="must be stopped"):
            plan_stepwise(dynamics_of(), motion, active="accelerating", return_time=0.5, stop=stop)


@pytest.mark.parametrize("planner", ["plan_stepwise", "plan_switch_off"])
def test_arguments_that_are_likely_slips(planner):
    import redundancy_pin as rp

    plan = getattr(rp, planner)
    robot = rp.load_robot("2rpr")
    with pytest.raises(InputError, match="Trajectory was given for the dynamics"):
        plan(rp.trajectory.reference.circle(), robot)
    for motion in (None, "circle", np.zeros((3, 2)), 5):
        with pytest.raises(InputError, match="for the motion"):
            plan(rp.VirtualWork(robot), motion)


def test_the_baseline_is_on_record():
    import redundancy_pin as rp

    bare = rp.VirtualWork(rp.load_robot("3rrr", carriers=False))
    corner = rp.trajectory.reference.corner()
    plan = rp.plan_stepwise(
        rp.VirtualWork(rp.load_robot("3rrr")), corner, objective=Objective(lam=0.5, baseline=bare), dt=0.02
    )
    assert "carriers=False" in plan.parameters["baseline"]
