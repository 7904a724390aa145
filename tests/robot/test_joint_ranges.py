"""Ranges of joints: what is beyond them, at their very edge, by whole turns, and what is said of it."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

import redundancy_pin as rp
from redundancy_pin.errors import CarrierLimitError
from redundancy_pin.robot.joint_ranges import beyond_limits, is_in_range, joint_ranges, out_of_range, range_excess
from redundancy_pin.status import SampleStatus

ENDS = {"arm": (-1.0, 2.0), "slide": (-0.3, 0.4), "screw": (-5.0, 2.0), "free": (0.0, 0.0)}
"""rad and m; the screw's are a turn and 0.72 rad apart, so that its turns count; equal ones are none."""

SLACK = 1e-9
"""rad, and characteristic lengths of the robot."""


@pytest.fixture(scope="module")
def robot():
    """A chain of four joints, all driven."""
    model, parent = pin.Model(), 0
    for name, (low, high) in ENDS.items():
        joint = pin.JointModelPX() if name == "slide" else pin.JointModelRZ()
        bound = np.array([10.0])
        place = pin.SE3(np.eye(3), np.array([0.3, 0.0, 0.0]))
        parent = model.addJoint(parent, joint, place, name, bound, bound, np.array([low]), np.array([high]))
        model.appendBodyToJoint(parent, pin.Inertia.Random(), pin.SE3.Identity())
    return rp.robot_from_model(model, actuated=list(ENDS), independent={"joints": list(ENDS)})


def at(robot, **places):
    """Configurations (N, nq), zero but for those that are given."""
    count = max(len(np.atleast_1d(value)) for value in places.values())
    q = np.zeros((count, robot.model.nq))
    for name, value in places.items():
        q[:, robot.model.joints[robot.model.getJointId(name)].idx_q] = value
    return q


def column(robot, name):
    return robot.model.getJointId(name) - 1


@pytest.mark.parametrize(("name", "end"), [(name, end) for name in ("arm", "slide", "screw") for end in (0, 1)])
@pytest.mark.parametrize("motion", [True, False])
def test_a_joint_is_beyond_its_limit_by_the_difference(robot, name, end, motion):
    """1e-15 is rounding of numbers of about one; half and twice the slack are told apart."""
    limit, outwards = ENDS[name][end], (-1.0, 1.0)[end]
    slack = SLACK * (robot.characteristic_length if name == "slide" else 1.0)
    for beyond in (-0.1, 0.0, 0.5 * slack, 2.0 * slack, 0.1):
        q = at(robot, **{name: [limit + outwards * beyond]})
        excess = range_excess(robot, q, motion=motion)
        assert excess.shape == (1, len(ENDS))
        assert excess[0, column(robot, name)] == pytest.approx(beyond, abs=2e-15)
        assert excess[0, column(robot, "free")] == -np.inf
        assert out_of_range(robot, q, motion=motion).tolist() == [beyond > slack] == [not is_in_range(robot, q[0])]
        found = beyond_limits(robot, q, np.array([0.25]))
        assert len(found) == (beyond > slack)
        for one in found:
            assert (one.joint, one.t, one.worst, one.limit) == (name, 0.25, 0.25, limit)
            assert one.value == pytest.approx(limit + outwards * beyond, abs=2e-15)
            assert one.unit == ("m" if name == "slide" else "rad")
            assert f"its {('lower', 'upper')[end]} limit {limit:g}" in str(one)


@pytest.mark.parametrize("turns", [-3, -1, 0, 1, 2])
def test_whole_turns_are_taken_off_where_a_range_is_within_one(robot, turns):
    """A slide is nowhere else after 2 pi, and a screw knows its turns. 1e-14 is rounding of three turns."""
    wide = 2.0 * np.pi * turns
    values = 0.5 + np.linspace(-3.1, 3.1, 38)  # within half a turn of the middle of the range
    own = np.maximum(-1.0 - values, values - 2.0)
    q = at(robot, arm=values + wide)
    np.testing.assert_allclose(range_excess(robot, q, motion=False)[:, column(robot, "arm")], own, atol=1e-14)
    np.testing.assert_allclose(range_excess(robot, q)[:, column(robot, "arm")], own, atol=1e-14)
    assert [is_in_range(robot, one) for one in q] == (own <= SLACK).tolist()
    (arm,) = (joint for joint in joint_ranges(robot) if joint.name == "arm")
    np.testing.assert_allclose(arm.counted(values + wide, False), values, atol=1e-14)
    np.testing.assert_allclose(arm.counted(values + wide, True), values, atol=1e-14)
    for one, value in zip(q[::12], values[::12], strict=True):  # a motion of one sample
        assert range_excess(robot, one[None])[0, column(robot, "arm")] == pytest.approx(
            max(-1.0 - value, value - 2.0), abs=1e-14
        )
    for name, (low, high) in (("slide", ENDS["slide"]), ("screw", ENDS["screw"])):
        found = range_excess(robot, at(robot, **{name: [wide]}))[0, column(robot, name)]
        assert found == pytest.approx(max(low - wide, wide - high), abs=1e-14)


def test_a_motion_is_counted_from_one_turn_and_configurations_each_from_its_own(robot):
    q = at(robot, arm=[0.0, 2.0 * np.pi])
    single = range_excess(robot, q, motion=False)[:, column(robot, "arm")]
    np.testing.assert_allclose(single, [-1.0, -1.0], atol=1e-14)
    # the middle of the motion, pi, is nearer to that of the range, 0.5, than to the same a turn on
    whole = range_excess(robot, q)[:, column(robot, "arm")]
    np.testing.assert_allclose(whole, [-1.0, 2.0 * np.pi - 2.0], atol=1e-14)
    found = beyond_limits(robot, q, np.array([0.0, 1.0]))
    assert [(one.joint, one.t, one.value) for one in found] == [("arm", 1.0, 2.0 * np.pi)]


def test_a_motion_with_unknown_configurations_is_beyond_where_others_are(robot):
    q = at(robot, slide=[0.0, 0.5, 0.0])
    q[0] = np.nan
    assert out_of_range(robot, q).tolist() == [False, True, False]


def test_a_carrier_that_turns_is_off_its_track_a_whole_turn_away():
    robot = rp.load_robot("2rpr", arm_length=0.15, end_effector_mass=0.5, cylinder_mass=0.3)
    x, rest = (0.1, 0.4), (0.0, 0.0)
    for dynamics in (rp.RneaDynamics(robot), rp.CompiledDynamics(robot)):
        for s, status in ((0.1, SampleStatus.OK), (0.1 + 2.0 * np.pi, SampleStatus.OUT_OF_RANGE)):
            assert dynamics.torque(x, rest, rest, (s, 0.1), rest, rest).status == status
        samples = rp.PlatformMotion([0.0], [x], [rest], [rest])
        with pytest.raises(CarrierLimitError, match=r"\[-1\.2, 1\.2\] rad by 5\.18 rad"):
            dynamics.reduce(samples, rp.CarrierMotion.parked(1, 2, (0.1 + 2.0 * np.pi, 0.1)))
