"""Forces at a singular pose that no carrier can take over: with their size and direction, by hand."""

import shutil

import numpy as np
import pytest
import zoo

from redundancy_pin import Mesh, RneaDynamics, VirtualWork, load_robot, plan_switch_off
from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.status import ResultStatus
from redundancy_pin.trajectory import Line, RestToRest, SpeedProfile, Trajectory, reference


def two_rpr(**arguments):
    return VirtualWork(zoo.robot_of("2rpr", **arguments))


def along(start, end, speed=0.3):
    path = Line(start, end)
    return Trajectory(path, SpeedProfile(path.length, speed, 0.2))


def first_crossing(trajectory):
    """Time at which the circle passes y = 0, by bisection of its own height."""
    low, high = 0.4, 0.6
    for _ in range(80):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if trajectory.evaluate(middle).x[1] > 0.0 else (low, middle)
    return high


@pytest.mark.long_for("0.001")
@pytest.mark.parametrize("mass", [1e-3, 0.3])
def test_end_effector_mass_needs_a_force_along_the_legs(mass):
    """m a·u, by hand: a the acceleration of the end-effector, u = (1, 0) the line of both legs."""
    trajectory = reference.circle()
    t = first_crossing(trajectory)
    needed = mass * abs(trajectory.evaluate(t).xdd[0])
    for backend in (VirtualWork, RneaDynamics):
        with pytest.raises(InfeasiblePlanError, match="nothing can carry the inertial force") as caught:
            plan_switch_off(backend(zoo.robot_of("2rpr", end_effector_mass=mass)), trajectory, mesh=Mesh(dt=0.02))
        details = caught.value.details
        assert details["constraint"] == "singular_pose"
        assert details["amount"] == pytest.approx(needed, rel=1e-8)
        assert details["time"] == pytest.approx(t, abs=1e-10)
        sign = np.sign(trajectory.evaluate(t).xdd[0])  # the force that has to act on the mass
        np.testing.assert_allclose(details["direction"], [sign, 0.0], atol=1e-9)
        assert details["main_actuators_could"] is True  # a leg pushes along itself; it is off, not powerless
        assert f"{needed:.6g} N" in caught.value.message


def test_piston_mass_needs_the_force_of_both_pistons():
    """Each piston is a rod that moves along its leg: m (d̈ − ρ θ̇²) along u, its centre at ρ = d − length / 2."""
    mass, length, trajectory = 0.2, 0.3, reference.circle()
    t = first_crossing(trajectory)
    x, xd, xdd = (np.asarray(part) for part in trajectory.evaluate(t))
    force = 0.0
    for hinge in (0.0, 0.5):
        along_leg = x - [hinge, 0.0]
        d = np.linalg.norm(along_leg)
        u = along_leg / d
        rate = (u[0] * xd[1] - u[1] * xd[0]) / d
        stretch = xdd @ u + d * rate**2
        force += mass * (stretch - (d - 0.5 * length) * rate**2) * u[0]
    with pytest.raises(InfeasiblePlanError) as caught:
        plan_switch_off(two_rpr(piston_mass=mass), trajectory)
    assert caught.value.details["amount"] == pytest.approx(abs(force), rel=1e-7)


def test_cylinder_mass_stays_solvable():
    """Cylinders turn about the hinges: they add to the angular momentum of the leg, which still is constant."""
    mass, length = 0.1, 0.3
    plan = plan_switch_off(two_rpr(cylinder_mass=mass), reference.circle(), threshold=10.0)
    legs = plan.motion.x[:, None, :] - np.array([[0.0, 0.0], [0.5, 0.0]])
    square = (legs**2).sum(axis=2)
    rate = (legs[..., 0] * plan.motion.xd[:, None, 1] - legs[..., 1] * plan.motion.xd[:, None, 0]) / square
    c = plan.carriers
    H = (0.01 + c.s**2) * rate + np.array([1.0, -1.0]) * 0.1 * c.sd + mass * length**2 / 3.0 * rate
    (window,) = plan.diagnostics["windows"]
    off = (plan.t >= window["entry"]) & (plan.t <= window["exit"])
    assert np.abs(H[off] - H[off][0]).max() < 1e-9 * np.abs(H[off][0]).max()
    assert np.isfinite(plan.tau).all()
    assert plan.status is not ResultStatus.UNBOUNDED


@pytest.mark.long_for("start0-end0-0.2", "start1-end1-0.5")
@pytest.mark.parametrize("speed", [0.2, 0.5])
@pytest.mark.parametrize(("start", "end"), [((0.25, 0.65), (0.25, 0.25)), ((0.3, 0.25), (0.3, 0.65))])
def test_five_bar_has_no_bounded_crossing(start, end, speed):
    """Its distal links and end-effector have mass: a force across them is left that the carriers cannot cancel."""
    with pytest.raises(InfeasiblePlanError, match="nothing can carry") as caught:
        plan_switch_off(RneaDynamics(zoo.robot_of("five_bar")), along(start, end, speed), threshold=10.0)
    assert caught.value.details["constraint"] == "singular_pose"
    assert caught.value.details["amount"] > 1e-3
    assert "brought there" in caught.value.message  # it depends on what the carriers have done until then
    t, direction = caught.value.details["time"], np.array(caught.value.details["direction"])
    motion = along(start, end, speed).sample_at([t])
    elbows = elbows_of(motion.x[0])
    line = elbows[1] - elbows[0]
    assert abs(direction @ line) < 1e-9  # across the distal links, which are one line there
    assert caught.value.details["main_actuators_could"] is False  # their torques act through the same links
    np.testing.assert_allclose(np.linalg.norm(line), 1.0, rtol=1e-9)  # both distal links, of 0.5 m, stretched out


def elbows_of(x):
    """Outward elbows of the five-bar: circles of 0.5 m about the hinges and about the end-effector meet there."""
    errors = []
    for hinge, side in ((np.zeros(2), 1.0), (np.array([0.5, 0.0]), -1.0)):
        chord = x - hinge
        half, normal = 0.5 * np.linalg.norm(chord), np.array([-chord[1], chord[0]]) / np.linalg.norm(chord)
        errors.append(hinge + 0.5 * chord + side * np.sqrt(0.25 - half**2) * normal)
    return np.array(errors)


def test_carriers_through_the_hinge_act_in_no_direction():
    """A track through the hinge: the force of the carrier has no moment about it. Parked there none is needed."""
    dynamics = two_rpr(track_offset=0.0)
    with pytest.raises(InfeasiblePlanError, match="has no effect") as caught:
        plan_switch_off(dynamics, reference.circle(), datum=0.05)
    assert caught.value.details["constraint"] == "carrier_effect"
    plan = plan_switch_off(dynamics, reference.circle())
    assert np.abs(plan.tau).max() < 1e-12
    assert (plan.carriers.s == 0.0).all()


def test_no_window():
    plan = plan_switch_off(two_rpr(), along((0.1, 0.3), (0.4, 0.3)), datum=0.05)
    assert plan.diagnostics["windows"] == []
    assert plan.diagnostics["worst_measure"] < 5.0
    assert (plan.phase == 0).all()
    assert (plan.carriers.s == 0.05).all()
    assert plan.status is ResultStatus.OK


def test_a_crossing_refused_away_from_the_singular_pose_says_so_and_in_which_phase(tmp_path):
    """A five-bar with tracks across its distal links: there the carriers lose their effect at another pose."""
    folder = tmp_path / "five_bar"
    shutil.copytree(zoo.robot_of("five_bar").urdf_folder, folder)
    file = folder / "five_bar.urdf.xacro"
    before, carrier = file.read_text().split('<joint name="carrier_${i}"')
    carrier = carrier.replace('<origin xyz="0 0 0"/>', '<origin xyz="${distal_length / 2} 0 0"/>', 1)
    carrier = carrier.replace('<axis xyz="1 0 0"/>', '<axis xyz="0 1 0"/>', 1)
    file.write_text(before + '<joint name="carrier_${i}"' + carrier)
    dynamics = RneaDynamics(load_robot(folder, carriers=True))
    path = Line((0.3, 0.65), (0.3, 0.25))
    motion = Trajectory(path, RestToRest(path.length, duration=2.0))
    for threshold, ramp_down, phase in ((3.0, 0.03, "off"), (5.0, 0.1, "ramping down")):
        with pytest.raises(InfeasiblePlanError, match=f"actuators are {phase} there") as caught:
            plan_switch_off(dynamics, motion, threshold=threshold, ramp_down=ramp_down, mesh=Mesh(dt=1e-2))
        assert caught.value.details["constraint"] == "carrier_effect"
        assert "ingular pose" not in caught.value.message
        assert np.linalg.cond(dynamics.reduce(motion.sample_at([caught.value.details["time"]])).W[0]) < 5.0
    # what the message offers: a shorter ramp leaves that pose out
    assert np.isfinite(plan_switch_off(dynamics, motion, threshold=5.0, ramp_down=0.03, mesh=Mesh(dt=1e-2)).tau).all()
