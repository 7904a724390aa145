"""A machine is the same machine whatever it is measured in: statuses, singular instants and efforts follow its units.

Lengths, masses and times of a random machine and motion are multiplied by anything from 1e-6 to 1e6. Powers of two
change no mantissa, so that efforts agree to rounding; other factors round every number of the machine anew.
"""

from __future__ import annotations

import ctypes
import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from examples import FACTOR
from generated_c import COMPILERS, Code, compiled, folder_of
from random_robots import RandomCase, random_case
from scaled import Units, coordinate_units, effort_units, scaled_carriers, scaled_motion, scaled_robot

import redundancy_pin as rp
from redundancy_pin.arrays import Array
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.kinematics.assembly import assemble
from redundancy_pin.kinematics.branch import follower
from redundancy_pin.kinematics.closure import constraint_system
from redundancy_pin.kinematics.coordinates import coordinates
from redundancy_pin.motion import CarrierMotion, PlatformMotion
from redundancy_pin.robot import Robot
from redundancy_pin.robot.loads import JointForces, Spring, Wrench
from redundancy_pin.robot.scales import force_sizes, force_terms, position_unit, turning_velocities, velocity_unit
from redundancy_pin.singularities.crossings import Crossing
from redundancy_pin.status import SampleStatus
from redundancy_pin.trajectory import Line, SpeedProfile, Trajectory

EXACT, ROUNDED = 1e-12, 1e-9
"""Relative, of efforts in units that are powers of two, times the condition number of W; and in others, times that over
1e6: lengths are rounded anew, and a pose next to a singularity moves with them."""

MACHINES = ("2rpr", "3rrr", "five_bar", "four_bar", "delta", "gough")
BACKENDS = (rp.RneaDynamics, rp.CompiledDynamics)

CHOICES = ((1e-3, 1e-9, 1.0), (1e-4, 1e-8, 1.0), (1e-6, 1e-9, 1e-3), (1e-6, 1e-12, 1.0), (1.0, 1e-9, 1.0))
"""Lengths, masses and times that were wrong once: forces are small in them."""

CORNERS = (*CHOICES, (1e6, 1e6, 1e-6), (1e-6, 1e-6, 1e6), (1e6, 1e-6, 1.0), (1.0, 1.0, 1e6), (1.0, 1.0, 1e-6))
TRIED = CORNERS[::3]
"""By ``make test``, where each takes long."""


def units_of(seed: int, *, powers_of_two: bool) -> Units:
    """Return random factors from 1e-6 to 1e6."""
    exponents = np.random.default_rng(seed).uniform(-6.0, 6.0, 3)
    if powers_of_two:
        return Units(*(2.0 ** np.round(exponents * np.log2(10.0))).tolist())
    return Units(*(10.0**exponents).tolist())


@functools.cache
def case_of(name: str, index: int) -> RandomCase:
    return random_case(name, 15, 11, index)


def solved(backend: Callable[[Robot], Dynamics], case: RandomCase, units: Units) -> rp.Distribution:
    """Distribute the random motion of a machine in other units; efforts are returned in the machine's own."""
    robot = scaled_robot(case.robot, units)
    motion, carriers = case.motion(case.t), case.carriers(case.t)
    reduced = backend(robot).reduce(
        scaled_motion(case.robot, motion, units), scaled_carriers(carriers, units), check_track=False
    )
    return rp.distribute(reduced)


def require_same(got: rp.Distribution, want: rp.Distribution, unit: Array, share: Array) -> None:
    np.testing.assert_array_equal(got.status, want.status)
    np.testing.assert_array_equal(got.rank, want.rank)
    np.testing.assert_allclose(got.margin, want.margin, rtol=1e-9, atol=1e-12)
    size = np.nanmax(np.abs(want.tau), axis=1, initial=0.0)
    off = np.abs(got.tau / unit - want.tau).max(axis=1)
    assert (off[want.solved] <= (share * size)[want.solved]).all()


@pytest.mark.property
@pytest.mark.long_for(*(f"{name}-CompiledDynamics" for name in MACHINES[1:]))
@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("name", MACHINES)
def test_random_machines_have_the_same_efforts_in_all_units(name: str, backend: Callable[[Robot], Dynamics]) -> None:
    case = case_of(name, 0)
    want, unit = solved(backend, case, Units()), functools.partial(effort_units, case.robot)
    for seed in range(1 if backend is rp.CompiledDynamics else FACTOR):  # each is compiled anew
        units = units_of(seed, powers_of_two=True)
        require_same(solved(backend, case, units), want, unit(units), EXACT * want.condition)
        units = units_of(seed, powers_of_two=False)
        require_same(solved(backend, case, units), want, unit(units), ROUNDED * np.maximum(1.0, want.condition / 1e6))


@pytest.mark.parametrize("choice", TRIED)
@pytest.mark.parametrize("name", ["2rpr", "3rrr"])
def test_virtual_work_has_the_same_efforts_in_all_units(name: str, choice: tuple[float, float, float]) -> None:
    """The closed forms take their lengths from the arguments of the model."""
    units, robot = Units(*choice), rp.load_robot(name, end_effector_mass=0.3) if name == "2rpr" else rp.load_robot(name)
    changed = {
        key: value * (units.mass if key.endswith("_mass") else units.length)
        for key, value in robot.parameters.items()
        if isinstance(value, float)
    }
    other = rp.load_robot(name, **changed)
    t = np.linspace(0.0, 0.5, 20)
    motion = case_of(name, 1).motion(t)
    still = CarrierMotion.parked(len(t), robot.k)
    want, got = (
        rp.distribute(rp.VirtualWork(one).reduce(moved, still, unreachable="mark"))
        for one, moved in ((robot, motion), (other, scaled_motion(robot, motion, units)))
    )
    assert want.solved.any()
    require_same(got, want, effort_units(robot, units), ROUNDED * np.maximum(1.0, want.condition / 1e6))


@pytest.mark.parametrize("choice", CORNERS)
def test_loads_are_the_same_in_all_units(choice: tuple[float, float, float]) -> None:
    units = Units(*choice)
    plain = rp.load_robot("2rpr", end_effector_mass=0.5, gravity=(0.0, -9.81, 0.0)).loaded(
        JointForces("slide_1", damping=3.0, friction=2.0, friction_speed=0.05, stiffness=50.0, rest=0.1),
        JointForces("swivel_2", damping=0.3, friction=0.1, rotor_inertia=1e-3, gear=10.0),
        Spring("base", "end_effector", stiffness=20.0, damping=2.0, length=0.2),
    )
    case = case_of("2rpr", 0)
    case = RandomCase(plain, case.t, case.path, case.tracks)
    want, got = (solved(rp.RneaDynamics, case, each) for each in (Units(), units))
    share = ROUNDED * np.maximum(1.0, want.condition / 1e6)
    require_same(got, want, effort_units(plain, units), share)


# --- singular poses -------------------------------------------------------------------------------------------------


def straight_down(units: Units) -> tuple[Robot, PlatformMotion]:
    """A five-bar whose distal links are in line at the middle one of three samples, where f has a part across them."""
    plain = rp.load_robot("five_bar", carriers=False)
    robot = scaled_robot(plain, units)
    t = np.linspace(-0.1, 0.1, 3)
    # the elbows are at the same height: distal links of one length meet in line between them
    low = singular_height()
    x = np.stack([np.full(3, 0.25), low - 0.3 * t], axis=1)
    motion = PlatformMotion(t + 0.1, x, np.tile([0.0, -0.3], (3, 1)), np.zeros((3, 2)))
    return robot, scaled_motion(plain, motion, units)


@functools.cache
def singular_height() -> float:
    plain = rp.load_robot("five_bar", carriers=False)
    line = Trajectory(Line((0.25, 0.7), (0.25, 0.05)), SpeedProfile(0.65, 0.3, 0.1))
    (crossing,) = rp.find_crossings(plain, line)
    return float(crossing.x[1])


@pytest.mark.parametrize("choice", CORNERS)
@pytest.mark.parametrize("backend", BACKENDS)
def test_a_force_that_no_motor_balances_is_never_called_none(
    backend: Callable[[Robot], Dynamics], choice: tuple[float, float, float]
) -> None:
    robot, motion = straight_down(Units(*choice))
    d = rp.distribute(backend(robot).reduce(motion))
    assert d.status[1] == SampleStatus.SINGULAR_INCONSISTENT
    assert np.isnan(d.tau[1]).all()
    assert d.solved[[0, 2]].all()


@pytest.mark.skipif("gcc" not in COMPILERS, reason="gcc is not installed")
@pytest.mark.parametrize("choice", [(1e-3, 1e-9, 1.0), pytest.param((1e6, 1e6, 1e-6), marks=pytest.mark.long)])
def test_generated_c_has_the_statuses_and_efforts_of_python_in_all_units(choice: tuple[float, float, float]) -> None:
    robot, motion = straight_down(Units(*choice))
    code, want = Code(robot), rp.distribute(rp.RneaDynamics(robot).reduce(motion))
    state = code.start()
    for k in range(3):
        assert code.go_to(state, motion.x[k]) == 0
        got = code.efforts(state, motion.x[k], motion.xd[k], motion.xdd[k])
        assert got.status == want.status[k]
        if want.solved[k]:
            np.testing.assert_allclose(got.tau, want.tau[k], rtol=1e-9)


PROBE = """
#include "unit.c"
double probe(const double *in);
double probe(const double *in) { return unit_own_force_size_of(UNIT_OWN_NUMBERS, in); }
"""


@pytest.mark.skipif("gcc" not in COMPILERS, reason="gcc is not installed")
def test_generated_c_has_the_same_sizes_of_forces(tmp_path: Path) -> None:
    robot = rp.load_robot("2rpr", end_effector_mass=0.5, gravity=(0.0, -9.81, 0.0)).loaded(
        JointForces("slide_1", damping=3.0, friction=2.0, stiffness=50.0, rest=0.1),
        Spring("base", "end_effector", stiffness=20.0, damping=2.0, length=0.2),
    )
    (tmp_path / "probe.c").write_text(PROBE)
    flags = f"-I{folder_of(robot)}", "-O1", "-shared", "-fPIC"
    probe = ctypes.CDLL(str(compiled([tmp_path / "probe.c"], tmp_path / "probe.so", *flags))).probe
    probe.restype = ctypes.c_double
    random = np.random.default_rng(5)
    for moving in (1, 2, 3, 4):  # one part alone is seen, too
        xd, xdd, sd, sdd = (random.normal(size=(1, 2)) * (k + 1 == moving) for k in range(4))
        given = np.concatenate([[0.2, 0.3], xd[0], xdd[0], np.zeros(2), sd[0], sdd[0]])
        want = force_sizes(robot, xd, xdd, sd, sdd)[0]
        assert probe(ctypes.c_void_p(given.ctypes.data)) == pytest.approx(want, rel=1e-14)


def free_rod(length: float) -> Robot:
    """A planar four-bar whose coupler is a free body, hinged to crank and rocker by closures."""
    model = pin.Model()
    model.gravity = pin.Motion(np.array([0.0, -9.81, 0.0]) * length, np.zeros(3))
    about_z = pin.JointModelRZ()
    crank = model.addJoint(0, about_z, pin.SE3.Identity(), "crank")
    rocker = model.addJoint(0, about_z, pin.SE3(np.eye(3), np.array([0.5, 0.0, 0.0]) * length), "rocker")
    rod = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "rod")
    bars = {crank: 0.2, rocker: 0.4, rod: 0.45}
    for joint, bar in bars.items():
        box = pin.Inertia.FromBox(1.0, bar * length, 0.05 * length, 0.04 * length)
        model.appendBodyToJoint(joint, box, pin.SE3(np.eye(3), np.array([0.5 * bar * length, 0.0, 0.0])))
    for name, joint, x in (
        ("crank_tip", crank, 0.2), ("rocker_tip", rocker, 0.4), ("rod_start", rod, 0.0), ("rod_end", rod, 0.45)
    ):  # fmt: skip
        place = pin.SE3(np.eye(3), np.array([x * length, 0.0, 0.0]))
        model.addFrame(pin.Frame(name, joint, place, pin.FrameType.BODY))
    q = pin.neutral(model)
    q[:2] = 1.0, 1.8
    tip = 0.2 * np.array([np.cos(1.0), np.sin(1.0)])
    q[2:4] = tip * length
    q[7:9] = np.sin(0.15), np.cos(0.15)
    return rp.robot_from_model(
        model, actuated=["rocker"], independent=["crank"], reference=q,
        closures=[("crank_tip", "rod_start", ["x", "y", "z", "rx", "ry"]), ("rod_end", "rocker_tip", ["x", "y"])],
    )  # fmt: skip


def test_free_bodies_have_lengths_too() -> None:
    """The crank goes round: the rocker, which drives, is at rest twice in a turn, whatever the metres."""
    t = np.linspace(0.0, 1.0, 101)
    found = []
    for length in (1.0, 1e-6, 1e6):
        robot = free_rod(length)
        x = (1.0 + 6.0 * t)[:, None]
        motion = PlatformMotion(t, x, np.full_like(x, 6.0), np.zeros_like(x))
        crossings = rp.find_crossings(robot, motion)
        found.append([crossing.t for crossing in crossings])
        status = rp.distribute(rp.RneaDynamics(robot).reduce(motion)).status
        assert (status <= SampleStatus.NEAR_SINGULAR).all()
    # crank and rod in line: |rod ± crank| from pivot to tip (cosine rule at the ground)
    want = []
    for reach, flip in ((0.45 + 0.2, 0.0), (0.45 - 0.2, np.pi)):
        angle = np.arccos((0.5**2 + reach**2 - 0.4**2) / (2.0 * 0.5 * reach)) + flip
        want += [(angle + 2.0 * np.pi * k - 1.0) / 6.0 for k in range(2)]
    want = [instant for instant in want if 0.0 < instant < 1.0]
    for instants in found:
        np.testing.assert_allclose(instants, sorted(want), rtol=1e-8)


@pytest.mark.parametrize("choice", [(1.0, 1.0, 1.0), *CORNERS])
@pytest.mark.parametrize("backend", BACKENDS)
def test_forces_that_carriers_cancel_are_none_in_all_units(
    backend: Callable[[Robot], Dynamics], choice: tuple[float, float, float]
) -> None:
    """On the line between its base hinges a 2-RPR's motors are in line; carriers can take all of f, or what is across.

    h of each leg is linear in its carrier's s̈ (Parsa 2014, eq. 2.17): where both vanish f is rounding.
    """
    units, plain = Units(*choice), rp.load_robot("2rpr")
    robot = scaled_robot(plain, units)
    x, xd, xdd = np.array([[0.2, 0.0]]), np.array([[0.3, -0.4]]), np.array([[0.5, 1.5]])
    offset, s, sd = 0.1, np.array([0.05, -0.07]), np.array([0.4, 0.2])
    d = np.array([0.2, 0.3])
    # legs at angles 0 and π: u = (±1, 0), n = (0, ±1); θ̇ = n·v/d, θ̈ = (n·a − 2 ḋ θ̇)/d
    u, normal = np.array([[1.0, 0.0], [-1.0, 0.0]]), np.array([[0.0, 1.0], [0.0, -1.0]])
    rate = normal @ xd[0] / d
    acceleration = (normal @ xdd[0] - 2.0 * (u @ xd[0]) * rate) / d
    sign = np.array([1.0, -1.0])
    sdd = -sign * ((offset**2 + s**2) * acceleration + 2.0 * s * sd * rate) / offset
    motion, cancelled = PlatformMotion([0.0], x, xd, xdd), CarrierMotion(s[None], sd[None], sdd[None])
    parked = CarrierMotion(s[None], sd[None], np.zeros((1, 2)))
    for carriers, status in (
        (cancelled, SampleStatus.SINGULAR_CONSISTENT),
        (parked, SampleStatus.SINGULAR_INCONSISTENT),
    ):
        reduced = backend(robot).reduce(
            scaled_motion(plain, motion, units), scaled_carriers(carriers, units), check_track=False
        )
        assert rp.distribute(reduced).status[0] == status
    assert plain.parameters["track_offset"] == offset


# --- singular instants, poses, loci ---------------------------------------------------------------------------------


def singular_line(name: str, units: Units) -> tuple[Robot, Trajectory]:
    ends = {"2rpr": ((0.1, 0.4), (0.42, -0.4)), "five_bar": ((0.25, 0.7), (0.25, 0.05))}[name]
    plain = rp.load_robot(name, carriers=False) if name == "five_bar" else rp.load_robot(name)
    L, T = units.length, units.time
    path = Line(*(tuple(L * np.array(end)) for end in ends))
    return scaled_robot(plain, units), Trajectory(path, SpeedProfile(path.length, 0.5 * L / T, 0.25 * T))


@functools.cache
def instants_of(name: str, units: Units) -> tuple[Crossing, ...]:
    return rp.find_crossings(*singular_line(name, units))


@pytest.mark.long_for(*(f"{choice}-{name}" for name in ("2rpr", "five_bar") for choice in set(CORNERS) - set(TRIED)))
@pytest.mark.parametrize("name", ["2rpr", "five_bar"])
@pytest.mark.parametrize("choice", CORNERS, ids=str)
def test_singular_instants_scale_with_the_time(name: str, choice: tuple[float, float, float]) -> None:
    units = Units(*choice)
    want, got = (instants_of(name, each) for each in (Units(), units))
    assert want
    assert [each.kind for each in got] == [each.kind for each in want]
    np.testing.assert_allclose([each.t / units.time for each in got], [each.t for each in want], rtol=1e-9)
    np.testing.assert_allclose([each.slope for each in got], [each.slope for each in want], rtol=1e-5)


@pytest.mark.parametrize("length", [2.0**-10, 1.0])
def test_a_path_is_searched_as_densely_in_all_units(length: float) -> None:
    """A 2-RPR rests, crosses the line between its base hinges four times within 2.5 ms and 0.3 m, and rests again."""
    plain, units = rp.load_robot("2rpr"), Units(length=length)
    s, duration = np.linspace(0.0, 1.0, 41), 1.0 / 400.0
    parts = []
    for order in range(3):  # x = 0.25 − 0.15 cos πs, y = 0.01 cos 4πs
        shift = 0.5 * np.pi * order
        across, along = np.cos(4.0 * np.pi * s + shift), np.cos(np.pi * s + shift)
        moving = np.stack([-0.15 * np.pi**order * along, 0.01 * (4.0 * np.pi) ** order * across], axis=1)
        rest = np.array([[-0.15, 0.01], [0.15, 0.01]]) * (order == 0)
        parts.append(np.concatenate([rest[[0, 0]], moving, rest[[1, 1]]]) / duration**order)
    parts[0] = parts[0] + [0.25, 0.0]
    parts[1][[2, -3]] = 0.0  # without rounding, as at rest
    t = np.concatenate([[0.0, 0.5], 0.5 + duration * s, [0.5 + duration, 1.0]])  # accelerations jump at both rests
    motion = scaled_motion(plain, PlatformMotion(t, *parts), units)
    crossings = rp.find_crossings(scaled_robot(plain, units), motion)
    want = 0.5 + duration * np.array([1.0, 3.0, 5.0, 7.0]) / 8.0
    np.testing.assert_allclose([crossing.t for crossing in crossings], want, rtol=0.0, atol=1e-3 * duration)


@functools.cache
def found_in(units: Units) -> tuple[Any, Any, Any, Any]:
    """Return assembly modes, forward kinematics, workspace and singular locus of a five-bar in other units."""
    robot = scaled_robot(rp.load_robot("five_bar", carriers=False), units)
    u = robot.q_reference[[robot.model.joints[robot.model.getJointId(name)].idx_q for name in robot.actuated]] + 0.1
    return (
        rp.assembly_modes(robot, u),
        rp.forward_kinematics(robot, [u]),
        rp.workspace(robot, resolution=15),
        rp.singular_locus(robot, resolution=20),
    )


@pytest.mark.parametrize("choice", [(1e-6, 1.0, 1.0), (1e6, 1.0, 1.0)])
def test_poses_modes_and_workspaces_scale_with_the_length(choice: tuple[float, float, float]) -> None:
    units = Units(*choice)
    (modes, forward, workspace, locus), other = (found_in(each) for each in (Units(), units))
    np.testing.assert_allclose(other[0].x / units.length, modes.x, atol=1e-9)
    np.testing.assert_array_equal(other[1].status, forward.status)
    np.testing.assert_allclose(other[1].x / units.length, forward.x, atol=1e-9)
    np.testing.assert_array_equal(other[2].reachable, workspace.reachable)
    assert [curve.kind for curve in other[3].curves] == [curve.kind for curve in locus.curves]


@pytest.mark.parametrize("length", [1e-6, 1.0, 1e6])
def test_an_angle_counts_beside_slides_of_any_length(length: float) -> None:
    """A step follows where each joint moves as Γ says, whatever the metres of the slides are."""
    robot = scaled_robot(rp.load_robot("2rpr"), Units(length=length))
    unit, solver = velocity_unit(robot), follower(robot)
    gamma, increment = unit[:, None], np.full(1, 0.1)
    for k in range(len(unit)):
        step = 0.1 * unit
        assert solver.is_continuous(step, gamma, gamma, increment)
        step[k] *= 1.5
        assert not solver.is_continuous(step, gamma, gamma, increment)


@pytest.mark.parametrize("length", [2.0**-10, 2.0**10])
@pytest.mark.parametrize("name", ["2rpr", "3rrr"])
def test_newton_takes_the_same_steps_in_all_units(name: str, length: float) -> None:
    """Iterates from far away, before they are closed: steps are cut at a radian, or at a characteristic length."""
    plain = rp.load_robot(name)
    robot, unit = scaled_robot(plain, Units(length=length)), np.where(turning_velocities(plain), 1.0, length)
    guess = plain.q_reference + np.random.default_rng(5).uniform(-1.5, 1.5, (30, plain.model.nq)) * position_unit(plain)
    x = coordinates(plain, constraint_system(plain).evaluate(plain.q_reference[None])).repeat(30, axis=0)
    want, got = (
        assemble(constraint_system(one), guess * u, x * v, max_iterations=3)
        for one, u, v in ((plain, 1.0, 1.0), (robot, unit, coordinate_units(plain, Units(length=length))))
    )
    np.testing.assert_allclose(got.q / unit, want.q, rtol=0.0, atol=1e-8)
    assert not want.closed.all()


def test_slides_that_are_long_in_metres_are_followed_as_short_ones() -> None:
    plain = rp.load_robot("2rpr")
    box = (0.05, 0.45), (0.05, 0.4)
    want = rp.workspace(plain, bounds=box, resolution=8)
    assert want.reachable.any()
    for length in (1e-6, 1e6):
        scaled = tuple(tuple(length * end for end in ends) for ends in box)
        got = rp.workspace(scaled_robot(plain, Units(length=length)), bounds=scaled, resolution=8)
        np.testing.assert_array_equal(got.reachable, want.reachable)


@pytest.mark.parametrize("choice", [(1e-3, 1e-9, 1.0), (1e3, 1e9, 1.0)])
def test_one_sample_calls_have_the_same_statuses_in_all_units(choice: tuple[float, float, float]) -> None:
    """A 2-RPR in mm and in km: regular, near and on the line between its base hinges, across it, and out of reach."""
    units, plain = Units(*choice), rp.load_robot("2rpr", end_effector_mass=0.5)
    robot, L = scaled_robot(plain, units), units.length
    one, other = rp.CompiledDynamics(plain), rp.CompiledDynamics(robot)
    xd, xdd = np.array([0.1, 0.2]), np.array([1.0, -2.0])
    heights, met = (0.3, 1e-4, 0.0, -0.3), set()
    for x in [np.array([0.2, height]) for height in heights]:
        want = one.torque(x, xd, xdd, start=plain.q_reference)
        got = other.torque(L * x, L * xd, L * xdd, start=robot.q_reference)
        assert got.status is want.status
        np.testing.assert_allclose(got.tau / effort_units(plain, units), want.tau, rtol=1e-6)
        np.testing.assert_allclose(got.margin, want.margin, rtol=1e-9, atol=1e-12)
        met.add(want.status)
    bases = np.array([[0.0, 0.0], [plain.parameters["base_distance"], 0.0]])
    for legs in [*(np.linalg.norm([0.2, height] - bases, axis=1) for height in heights[:3]), np.array([0.05, 0.05])]:
        want = one.joint_state(legs, start=plain.q_reference)
        got = other.joint_state(L * legs, start=robot.q_reference)
        assert got.status is want.status
        np.testing.assert_allclose(got.x / L, want.x, atol=1e-9)
        if not want.status.solved:
            np.testing.assert_allclose(got.residual / L, want.residual, rtol=1e-3, atol=1e-9)
        met.add(want.status)
    expected = (SampleStatus.OK, SampleStatus.NEAR_SINGULAR, SampleStatus.TYPE_II, SampleStatus.UNREACHABLE)
    assert met.issuperset(expected)
    plain = rp.load_robot("five_bar", carriers=False)
    far = []
    for robot, length in ((plain, 1.0), (scaled_robot(plain, units), L)):
        dynamics, still = rp.CompiledDynamics(robot), np.zeros(2)
        home = follower(robot).home.x
        assert dynamics.torque(home, still, still).status is SampleStatus.OK
        refused = dynamics.torque(home + 3.0 * length, still, still)
        assert refused.status is SampleStatus.UNREACHABLE
        far.append(refused.residual / length)
    assert far[1] == pytest.approx(far[0], rel=1e-6)
    assert far[0] > 0.1


@pytest.mark.parametrize("length", [2.0**-10, 2.0**10])
def test_configurations_that_are_open_by_noise_have_states_in_all_units(length: float) -> None:
    plain = rp.load_robot("2rpr")
    robot, unit = scaled_robot(plain, Units(length=length)), np.where(turning_velocities(plain), 1.0, length)
    noise = np.random.default_rng(7).normal(size=(60, plain.model.nq)) * np.geomspace(1e-3, 1.0, 60)[:, None]
    found = 0
    for q in plain.q_reference + noise * position_unit(plain):
        want, got = follower(plain).state_at(q), follower(robot).state_at(q * unit)
        assert (got is None) == (want is None)
        if got is not None and want is not None:
            found += 1
            np.testing.assert_allclose(got.q / unit, want.q, atol=1e-9)
            assert got.margin == pytest.approx(want.margin, rel=1e-9)
    assert 10 < found < 50


# --- the sizes themselves -------------------------------------------------------------------------------------------


def test_sizes_of_forces_are_those_of_a_mass_that_moves() -> None:
    """mass (g + L (r² + r')) + viscous r + static, by hand for a 2-RPR with springs and friction in a joint."""
    robot = rp.load_robot("2rpr", end_effector_mass=0.5, gravity=(0.0, -9.81, 0.0)).loaded(
        JointForces("slide_1", damping=3.0, friction=2.0, stiffness=50.0, rest=0.1),
        JointForces("swivel_2", damping=0.3, rotor_inertia=1e-3, gear=10.0),
        Spring("base", "end_effector", stiffness=20.0, length=0.2),
        Wrench("end_effector", [3.0, -4.0, 0.0, 0.0, 0.0, 0.0]),
    )
    L = robot.characteristic_length
    size = force_terms(robot)
    assert size.mass == pytest.approx(2.5 + 1e-3 * 100.0 / L**2)  # two carriers, the end-effector, and the rotor
    assert size.viscous == pytest.approx(3.0 * L + 0.3 / L)
    assert size.static == pytest.approx(2.0 + 1e-3 * (50.0 * (L + 0.1) + 20.0 * (L + 0.2)))
    xd, xdd = np.array([[0.3, -0.6]]), np.array([[1.0, 2.0]])
    sd, sdd = np.array([[0.1, 0.0]]), np.array([[5.0, 0.0]])
    sizes = force_sizes(robot, xd, xdd, sd, sdd, (np.array([[3.0, -4.0, 0.0, 0.0, 0.0, 0.0]]),))
    rate, change = 0.6 / L, 5.0 / L
    force = size.mass * (9.81 + L * (rate**2 + change)) + size.viscous * rate + size.static + 4.0
    np.testing.assert_allclose(sizes, force)
    assert size.time(rate) == pytest.approx(1.0 / np.sqrt(9.81 / L + rate**2))
    reduced = rp.RneaDynamics(robot).reduce(
        PlatformMotion([0.0], [[0.2, 0.3]], xd, xdd), CarrierMotion(0.0 * sd, sd, sdd)
    )
    np.testing.assert_allclose(reduced.force_size, force)


def test_coordinates_are_over_the_length_and_angles_over_a_radian() -> None:
    robot = rp.load_robot("3rrr")
    np.testing.assert_allclose(coordinate_units(robot, Units(length=3.0)), [3.0, 3.0, 1.0])
    other = scaled_robot(robot, Units(length=3.0))
    assert other.characteristic_length == pytest.approx(3.0 * robot.characteristic_length)
