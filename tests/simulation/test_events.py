"""Events: found where they are, once, on the right side; singular poses judged by closed forms."""

from __future__ import annotations

import itertools
from dataclasses import replace

import moving
import numpy as np
import pytest
import zoo
from scipy.optimize import brentq

import redundancy_pin as rp
from redundancy_pin.arrays import Array
from redundancy_pin.simulation.controllers.base import Constant
from redundancy_pin.simulation.events import Event, EventFunctions
from redundancy_pin.simulation.result import Simulation
from redundancy_pin.simulation.state import State, closed_state
from redundancy_pin.status import ResultStatus

TIMES = 1e-8
"""s: the interpolant of a step is of order 7, and its position off by 1e-10 or less at speeds of order 1."""


def of_kind(run: Simulation, kind: str) -> list[Event]:
    return [event for event in run.events if event.kind == kind]


def test_type_two_poses_on_the_way_are_reported_and_passed() -> None:
    # B on the line A1 A2: y changes sign
    robot = moving.massive("2rpr")
    start = closed_state(robot, [0.2, 0.1], [0.1, -1.0])
    run = rp.simulate(robot, start=start, duration=0.25, dt=0.001)
    assert run.status is ResultStatus.OK
    (event,) = of_kind(run, "type_II")
    y = lambda t: float(run.at([t])[0][0, 1])  # noqa: E731
    assert event.t == pytest.approx(brentq(y, 0.05, 0.2), abs=TIMES)
    assert not event.terminal


def test_a_stretched_leg_is_reported_with_its_number_and_the_motion_goes_on() -> None:
    # a five-bar thrown outward: a leg is stretched where its two hinges and the end are in one line
    robot = moving.massive("five_bar")
    start = closed_state(robot, xd=[0.0, 1.2])
    run = rp.simulate(robot, start=start, duration=1.5, dt=0.001, stop_at=())
    stretched = of_kind(run, "type_I")
    assert stretched
    for event in stretched:
        leg = int(event.name.removeprefix("leg "))
        column = robot.model.joints[robot.model.getJointId(f"elbow_{leg}")].idx_q
        after = int(np.searchsorted(run.t, event.t))
        assert np.sin(run.q[after - 1, column]) * np.sin(run.q[after, column]) < 0.0
    assert run.t[-1] == 1.5
    assert np.ptp(run.energy) < 1e-9 * run.energy[0]  # regular there: nothing is lost
    stopped = rp.simulate(robot, start=start, duration=1.5, stop_at=("type_I",))
    assert stopped.status is ResultStatus.STOPPED
    assert stopped.t[-1] == stopped.events[-1].t == pytest.approx(stretched[0].t, abs=TIMES)


class Returning:
    """Pushes a carrier to its end and back: s = 0.2 + depth − 15 (t − 0.1)² m, which passes the end for a moment."""

    def __init__(self, depth: float) -> None:
        self.depth = depth
        self.end = 0.2

    def effort(self, t: float, state: State) -> tuple[Array, Array]:
        return np.zeros(2), np.zeros(2)

    def carrier_motion(self, t: float) -> tuple[Array, Array, Array]:
        s = 0.2 + self.depth - 15.0 * (t - 0.1) ** 2
        return np.array([s, 0.0]), np.array([-30.0 * (t - 0.1), 0.0]), np.array([-30.0, 0.0])


@pytest.mark.parametrize("depth", [1e-2, 1e-3, 1e-5, 1e-7])
def test_an_end_stop_passed_for_a_moment_within_a_step_is_not_missed(depth: float) -> None:
    robot = moving.massive("2rpr")
    drive = Returning(depth)
    s, sd, _ = drive.carrier_motion(0.0)
    start = closed_state(robot, s=s, sd=sd)
    run = rp.simulate(robot, drive, start=start, carriers="motion")
    assert run.status is ResultStatus.STOPPED
    assert run.events[-1].name == "carrier_1 upper"
    assert run.events[-1].t == pytest.approx(0.1 - np.sqrt(depth / 15.0), abs=TIMES)
    assert (
        of_kind(
            rp.simulate(
                robot,
                Returning(-depth),
                start=closed_state(robot, s=Returning(-depth).carrier_motion(0.0)[0], sd=sd),
                carriers="motion",
            ),
            "track",
        )
        == []
    )


def test_ends_of_both_sides_and_limits_of_other_joints_are_told_apart() -> None:
    robot = moving.massive("2rpr")
    for sign, name in ((1.0, "carrier_1 upper"), (-1.0, "carrier_1 lower")):
        drive = Constant(np.zeros(2), np.array([20.0 * sign, 0.0]))
        run = rp.simulate(robot, drive, duration=2.0)
        assert run.events[-1].name == name
        assert abs(run.s[-1, 0] - 0.2 * sign) < 1e-9
    model = robot.model.copy()
    index = model.joints[model.getJointId("slide_1")].idx_q
    limits = np.array(model.upperPositionLimit)
    limits[index] = float(robot.q_reference[index]) + 0.05
    model.upperPositionLimit = limits
    from dataclasses import replace

    limited = replace(robot, model=model)
    run = rp.simulate(limited, Constant(np.array([5.0, 0.0]), np.zeros(2)), duration=2.0)
    assert run.events[-1].kind == "joint_limit"
    assert run.events[-1].name == "slide_1 upper"
    assert abs(run.q[-1, index] - limits[index]) < 1e-9


SOON = 1e-5
"""s; 5 N move 1 kg by nine tenths of 1e-9 characteristic lengths, 0.24 nm, in 9.6e-6 s."""


@pytest.mark.parametrize("part_of_slack", [0.0, 0.95])
def test_a_carrier_that_starts_at_its_end_may_leave_inward_only(part_of_slack: float) -> None:
    robot = moving.massive("2rpr")
    at_end = closed_state(robot, s=[0.2 + part_of_slack * 1e-9 * robot.characteristic_length, 0.0])
    inward = rp.simulate(robot, Constant(np.zeros(2), np.array([-5.0, 0.0])), start=at_end, duration=0.1)
    assert inward.status is ResultStatus.OK
    outward = rp.simulate(robot, Constant(np.zeros(2), np.array([5.0, 0.0])), start=at_end, duration=0.1)
    assert outward.status is ResultStatus.STOPPED
    assert outward.t[-1] == pytest.approx(0.0, abs=SOON)


@pytest.mark.parametrize("beyond", [0.0, 3e-17, -3e-17, 5e-13])
def test_a_start_at_an_end_stops_whichever_way_it_was_rounded(beyond: float) -> None:
    # as the last state of a run that was stopped there, on either side of the end by rounding
    robot = moving.massive("2rpr")
    at_end = closed_state(robot, s=[0.2 + beyond, 0.0])
    run = rp.simulate(robot, Constant(np.zeros(2), np.array([5.0, 0.0])), start=at_end, duration=0.3)
    assert run.status is ResultStatus.STOPPED
    assert [event.name for event in run.events] == ["carrier_1 upper"]
    assert run.t[-1] < SOON
    # from rest at a constant acceleration, s = v t / 2: nine tenths of the slack, less what it was beyond
    slack = 1e-9 * robot.characteristic_length
    assert 0.5 * run.sd[-1, 0] * run.t[-1] == pytest.approx(0.9 * slack - beyond, rel=1e-3)
    again = rp.simulate(
        robot,
        Constant(np.zeros(2), np.array([5.0, 0.0])),
        start=replace(at_end, q=run.q[-1], v=run.v[-1]),
        duration=0.3,
    )
    assert again.t[-1] < SOON
    assert again.s[-1, 0] - 0.2 < slack


def test_a_function_that_comes_to_zero_exactly_is_seen_once_from_either_side() -> None:
    robot = moving.massive("2rpr")
    functions = EventFunctions(closed_state(robot).chain, (), closed_state(robot).q)
    i = functions.kinds.index("type_II")
    for sign in (1.0, -1.0):
        values = np.ones((4, len(functions.kinds)))
        values[:, i] = sign * np.array([1.0, 0.0, -1.0, -2.0])
        seen = [functions.sign_changes(before, after) for before, after in itertools.pairwise(values)]
        assert np.flatnonzero(np.any(seen, axis=0)).tolist() == [i]
        assert [changes[i] for changes in seen] == [True, False, False]


def test_a_start_at_a_type_two_pose_is_no_event_whichever_way_it_leaves() -> None:
    robot = moving.massive("2rpr")
    for speed in (0.3, -0.3):
        run = rp.simulate(robot, start=closed_state(robot, [0.2, 0.0], [0.0, speed]), duration=0.05)
        assert of_kind(run, "type_II") == []


def test_a_type_two_pose_that_a_machine_started_from_is_an_event_when_it_comes_back() -> None:
    robot = moving.massive("2rpr")
    pull = Constant(np.array([-40.0, -40.0]), np.zeros(2))  # towards the line of the bases
    start = closed_state(robot, [0.2, 0.0], [0.0, 0.3])
    run = rp.simulate(robot, pull, start=start, duration=0.25, dt=0.001, max_step=2e-3)
    (event,) = of_kind(run, "type_II")
    y = lambda t: float(run.at([t])[0][0, 1])  # noqa: E731
    assert event.t == pytest.approx(brentq(y, 0.02, 0.25), abs=TIMES)


def test_a_robot_without_declared_modes_reports_type_one_by_its_rows() -> None:
    from dataclasses import replace

    robot = zoo.robot_of("four_bar", ground_length=0.5, crank_length=0.3, coupler_length=0.4, rocker_length=0.3)
    bare = replace(robot, working_modes=None, working_mode=())
    both = [
        rp.simulate(machine, start=closed_state(machine, [1.0], [8.0]), duration=0.4, stop_at=("type_I",))
        for machine in (robot, bare)
    ]
    assert both[0].events[-1].name == "leg 1"
    assert both[1].events[-1].name == "type_I"
    assert both[0].t[-1] == pytest.approx(both[1].t[-1], abs=TIMES)


def test_limits_of_zero_are_none() -> None:
    """A URDF writes lower = upper = 0 where it knows no limits: a joint that passes zero meets no stop."""
    robot = rp.load_robot("four_bar")
    crank = robot.model.joints[robot.model.getJointId("crank")].idx_q
    for bound, expected in ((0.0, set()), (0.02, {"crank lower"})):
        model = robot.model.copy()
        model.lowerPositionLimit[crank], model.upperPositionLimit[crank] = -bound, bound
        limited = replace(robot, model=model)
        run = rp.simulate(limited, start=closed_state(limited, [0.01], xd=[-2.0]), duration=0.05, stop_at=())
        assert run.q[-1, crank] < -0.03
        assert {event.name for event in run.events if event.kind == "joint_limit"} == expected
