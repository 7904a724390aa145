"""Power, energy and rms of plans, and what a plan says of efforts that do not balance and forces beyond a limit."""

from dataclasses import replace

import numpy as np
import pytest

import redundancy_pin as rp
from redundancy_pin.motion import CarrierMotion, PlatformMotion
from redundancy_pin.planners.check import finish_plan
from redundancy_pin.planners.intersample_check import PlannedMotion
from redundancy_pin.planners.options import Limits
from redundancy_pin.status import SampleStatus


@pytest.fixture(scope="module")
def crossing():
    robot = rp.load_robot("2rpr")
    return rp.plan_switch_off(
        rp.VirtualWork(robot), rp.trajectory.reference.circle(), threshold=10.0, return_time=0.4, mesh=rp.Mesh(dt=5e-4)
    )


def kinetic_energy(plan):
    """The two carriers of the massless 2-RPR, from their places: r = A + L u + side s n, differenced by hand."""
    t, x, xd = plan.t, plan.motion.x, plan.motion.xd
    offset, mass = 0.1, 1.0
    total = np.zeros(len(t))
    for leg, (anchor, side) in enumerate(((0.0, 1.0), (0.5, -1.0))):
        reach = x - np.array([anchor, 0.0])
        length = np.linalg.norm(reach, axis=1)
        u = reach / length[:, None]
        n = np.stack([-u[:, 1], u[:, 0]], axis=1)
        spin = (xd * n).sum(axis=1) / length
        s, sd = plan.carriers.s[:, leg], plan.carriers.sd[:, leg]
        along = -side * s * spin
        across = offset * spin + side * sd
        total += 0.5 * mass * (along**2 + across**2)
    return total


def test_all_actuators_together_do_the_work_that_becomes_kinetic_energy(crossing):
    power = crossing.main_power.sum(axis=1) + crossing.carrier_power.sum(axis=1)
    work = np.concatenate([[0.0], np.cumsum(0.5 * (power[1:] + power[:-1]) * np.diff(crossing.t))])
    energy = kinetic_energy(crossing)
    assert energy.max() > 0.1
    # trapezoids of 0.5 ms of a power of 10 W that changes within 50 ms
    np.testing.assert_allclose(work, energy - energy[0], atol=2e-5 * energy.max())
    # the signs of each side, not only of the sum
    np.testing.assert_allclose(crossing.main_power, crossing.tau * crossing.actuated_rate)
    legs = crossing.motion.x[:, None, :] - np.array([[0.0, 0.0], [0.5, 0.0]])
    rates = (legs * crossing.motion.xd[:, None, :]).sum(axis=2) / np.linalg.norm(legs, axis=2)
    np.testing.assert_allclose(crossing.actuated_rate, rates, atol=1e-12)


def by_hand(plan, t, tau, rate, force, sd):
    """A plan with efforts written down: uneven times, powers of both signs."""
    count = len(t)
    motion = PlatformMotion(t, np.zeros((count, 2)), np.zeros((count, 2)), np.zeros((count, 2)))
    carriers = CarrierMotion(np.zeros((count, 2)), sd, np.zeros((count, 2)))
    efforts = {"tau": tau, "actuated_rate": rate, "carrier_force": force}
    between = replace(plan.between, peak=np.nanmax(np.abs(tau), axis=0))
    return replace(plan, motion=motion, carriers=carriers, **efforts, between=between)


def test_energies_and_rms_of_a_plan_written_down(crossing):
    t = np.array([0.0, 1.0, 3.0])
    ones = np.ones((3, 2))
    tau = np.array([[2.0, 0.0], [-2.0, 0.0], [4.0, 0.0]])
    force = np.array([[0.0, 1.0], [0.0, -3.0], [0.0, 1.0]])
    plan = by_hand(crossing, t, tau, ones, force, 2 * ones)
    # |power| of the first motor: 2, 2, 4 W over 1 s and 2 s
    assert plan.main_energy == pytest.approx(2.0 * 1.0 + 3.0 * 2.0)
    # |power| of the second carrier: 2, 6, 2 W
    assert plan.carrier_energy == pytest.approx(4.0 * 1.0 + 4.0 * 2.0)
    # squares 4, 4, 16 over the same times, divided by 3 s
    np.testing.assert_allclose(plan.rms_effort, [np.sqrt((4.0 * 1.0 + 10.0 * 2.0) / 3.0), 0.0])
    np.testing.assert_allclose(plan.peak_effort, [4.0, 0.0])


def test_efforts_that_do_not_balance_are_said_to(crossing):
    dynamics = rp.VirtualWork(rp.load_robot("2rpr"))
    wrong = np.array(crossing.tau)
    wrong[100] += [1e-3, 0.0]
    limits = Limits().resolved(dynamics.robot)
    along = dynamics.along(crossing.motion)
    plan = finish_plan(
        PlannedMotion(dynamics, crossing.functions, along, crossing.carriers, limits, "by hand", prescribed=wrong)
    )
    assert plan.residual[100] == pytest.approx(1e-3, rel=1e-6)
    assert plan.sample_status[100] == SampleStatus.SINGULAR_INCONSISTENT
    assert plan.status is not crossing.status
    assert (np.delete(plan.sample_status, 100) == SampleStatus.OK).all()
