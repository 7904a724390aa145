"""Stops that push back: impacts and rest by closed forms, the sign of their forces, and energy that never grows."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from flat_linkages import parallelogram, row_of_four_bars

import redundancy_pin as rp
from redundancy_pin.arrays import Array
from redundancy_pin.robot import Robot
from redundancy_pin.simulation import Sampling, Simulation, load_simulation
from redundancy_pin.simulation.events import Event
from redundancy_pin.simulation.state import State, closed_state, tree_state
from redundancy_pin.status import ResultStatus

G = 9.81
MASS, CENTRE, INERTIA, LENGTH = 2.0, 0.3, 0.02, 0.7
"""kg, m, kg·m² about the centre, m: of each link of the pendulums."""

BAR = f"""<link name="{{name}}"><inertial><mass value="{MASS}"/><origin xyz="{CENTRE} 0 0"/>
<inertia ixx="0.001" iyy="{INERTIA}" izz="{INERTIA}" ixy="0" ixz="0" iyz="0"/></inertial></link>"""
HINGE = """<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/><axis xyz="0 0 1"/>
<origin xyz="{at} 0 0"/><limit lower="{lower}" upper="{upper}" effort="10" velocity="10"/></joint>"""

inelastic = partial(rp.simulate, joint_stops="inelastic", dt=0.01)


def pendulum(folder: Path, *ranges: tuple[float, float]) -> Robot:
    """Return a chain of one or two hinges with limits, in a vertical plane; angles from the x axis."""
    parts, names = ["<robot name='pendulum'><link name='base'/>"], ["base", "upper", "lower"]
    for i, (low, high) in enumerate(ranges):
        parts.append(BAR.format(name=names[i + 1]))
        at = LENGTH if i else 0.0
        hinge = {"name": f"hinge_{i + 1}", "parent": names[i], "child": names[i + 1], "at": at}
        parts.append(HINGE.format(**hinge, lower=low, upper=high))
    path = folder / "pendulum.urdf"
    path.write_text("".join([*parts, "</robot>"]))
    joints = ",".join(f"hinge_{i + 1}" for i in range(len(ranges)))
    return rp.load_robot(path, gravity=(0, -G, 0), actuated=joints)


@pytest.fixture(scope="module")
def five_bar(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    """The shipped five-bar under gravity, with limits of ±2.2 rad on its elbows, which are passive."""
    folder = tmp_path_factory.mktemp("stops") / "five_bar"
    shutil.copytree(Path(rp.__file__).parents[1] / "models" / "five_bar", folder)
    model = folder / "five_bar.urdf.xacro"
    free = 'lower="-1000" upper="1000" velocity="100" effort="0"'
    assert free in model.read_text()
    model.write_text(model.read_text().replace(free, free.replace("1000", "2.2")))
    return rp.load_robot(folder / "robot.yaml", gravity=(0, -G, 0))


class Efforts:
    """A controller that gives efforts as a function of time."""

    def __init__(self, *slopes: float, at: Sequence[float] = ()) -> None:
        self._slopes, self.breaks = np.array(slopes), np.array(at)

    def effort(self, t: float, state: State) -> tuple[Array, Array]:
        return self._slopes * t, np.zeros(state.robot.k)


def of_kind(run: Simulation, kind: str) -> list[Event]:
    return [event for event in run.events if event.kind == kind]


def test_a_pendulum_falls_onto_its_stop_and_stays_there(tmp_path: Path) -> None:
    robot, start, stop = pendulum(tmp_path, (-0.5, 2.0)), 0.3, -0.5
    run = inelastic(robot, start=tree_state(robot, [start], [0.0]), duration=1.0)
    (hit,) = run.events
    about_pivot = INERTIA + MASS * CENTRE**2
    speed = np.sqrt(2.0 * MASS * G * CENTRE * (np.sin(start) - np.sin(stop)) / about_pivot)
    assert (hit.kind, hit.name, hit.terminal) == ("joint_limit", "hinge_1 lower", False)
    assert hit.impulse == pytest.approx(about_pivot * speed, rel=1e-9)
    after = run.t > hit.t
    np.testing.assert_allclose(run.q[after], stop, atol=1e-9)
    assert not run.v[after].any()
    np.testing.assert_allclose(run.stop_force[after], MASS * G * CENTRE * np.cos(stop), rtol=1e-9)
    assert not run.stop_force[~after].any()
    np.testing.assert_allclose(np.diff(run.energy[after]), 0.0, atol=1e-12)
    assert run.energy[-1] - run.energy[0] == pytest.approx(-0.5 * about_pivot * speed**2, rel=1e-9)
    assert run.status is ResultStatus.OK


def test_it_lets_go_when_it_would_have_to_pull(tmp_path: Path) -> None:
    robot, slope = pendulum(tmp_path, (-0.5, 2.0)), 8.0
    run = inelastic(robot, Efforts(slope), start=tree_state(robot, [-0.5], [0.0]), duration=1.2)
    (release,) = run.events
    weight = MASS * G * CENTRE * np.cos(0.5)
    assert (release.kind, release.name) == ("release", "hinge_1 lower")
    assert release.t == pytest.approx(weight / slope, rel=1e-9)
    held = run.t < release.t
    np.testing.assert_allclose(run.stop_force[held, 0], weight - slope * run.t[held], rtol=1e-9)
    assert run.q[-1, 0] > -0.4
    assert (run.stop_force[~held] == 0.0).all()


def test_an_impact_inside_a_chain_keeps_the_moment_of_momentum_about_its_pivot(tmp_path: Path) -> None:
    robot = pendulum(tmp_path, (-9.0, 9.0), (-1.0, 1.0))
    start = tree_state(robot, [0.2, 0.3], [0.5, 3.0])
    run = inelastic(robot, start=start, duration=0.6, dt=1e-4)
    hit = run.events[0]
    assert hit.name == "hinge_2 upper"
    last, first = (int(np.searchsorted(run.t, hit.t, side)) + by for side, by in (("left", -1), ("right", 0)))

    def momentum(i: int) -> tuple[float, float]:
        """Moment of momentum about the pivot, and inertia about it with the elbow rigid, written out."""
        (q1, q2), (v1, v2) = run.q[i], run.v[i]
        c1 = CENTRE * np.array([np.cos(q1), np.sin(q1)])
        arm = CENTRE * np.array([np.cos(q1 + q2), np.sin(q1 + q2)])
        c2 = LENGTH * np.array([np.cos(q1), np.sin(q1)]) + arm
        turned = lambda r: np.array([-r[1], r[0]])  # noqa: E731
        speeds = v1 * turned(c1), v1 * turned(c2) + v2 * turned(arm)
        spins = INERTIA * v1, INERTIA * (v1 + v2)
        total = sum(MASS * (r[0] * s[1] - r[1] * s[0]) for r, s in zip((c1, c2), speeds, strict=True)) + sum(spins)
        return float(total), float(MASS * (c1 @ c1 + c2 @ c2) + 2.0 * INERTIA)

    (before, _), (after, rigid) = momentum(last), momentum(first)
    weights = 2e-4 * 2.0 * MASS * G  # of gravity between the two samples, with arms below a metre
    assert abs(after - before) < weights
    assert run.v[first, 0] == pytest.approx(after / rigid, rel=1e-9)
    assert run.v[first, 1] == 0.0
    # what keeps the second link at the first: its rates of momentum about the elbow, written out
    q1, q2 = run.q[first]
    acceleration, rate = run.a[first, 0], run.v[first, 0]
    arm = CENTRE * np.array([np.cos(q1 + q2), np.sin(q1 + q2)])
    centre = LENGTH * np.array([np.cos(q1), np.sin(q1)]) + arm
    of_centre = acceleration * np.array([-centre[1], centre[0]]) - rate**2 * centre
    needed = INERTIA * acceleration + MASS * (arm[0] * (of_centre[1] + G) - arm[1] * of_centre[0])
    assert run.stop_force[first, 1] == pytest.approx(needed, rel=1e-9)
    assert run.stop_force[first, 0] == 0.0


def test_two_passive_stops_of_a_closed_chain_at_once(five_bar: Robot) -> None:
    run = inelastic(five_bar, duration=1.2)
    first, second = of_kind(run, "joint_limit")
    assert first.impulse == pytest.approx(second.impulse, rel=1e-9)  # the fall is symmetric
    assert first.t == second.t
    rest = run.t > first.t
    np.testing.assert_allclose(run.v[rest], 0.0, atol=1e-9)
    # the forces of the stops hold the weight: virtual work by differences of the potential energy along x and y
    x, step = run.x[-1], 1e-5
    for direction in np.eye(2):
        ends = [closed_state(five_bar, x + sign * step * direction) for sign in (1.0, -1.0)]
        potential = [rp.simulate(five_bar, start=end, duration=1e-9, dt=1e-9, stop_at=()).energy[0] for end in ends]
        moved = ends[0].q - ends[1].q
        slope = (potential[0] - potential[1]) / np.abs(2.0 * step)
        assert run.stop_force[-1] @ moved / (2.0 * step) == pytest.approx(slope, rel=1e-6, abs=1e-6)


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.long) for seed in range(1, 6))])
def test_stops_push_and_never_pull_and_energy_never_grows(five_bar: Robot, seed: int) -> None:
    dice = np.random.default_rng(seed)
    start = closed_state(five_bar, np.add([0.25, 0.7], dice.uniform(-0.03, 0.03, 2)), dice.uniform(-2.0, 2.0, 2))
    run = inelastic(five_bar, start=start, duration=1.5)
    assert run.status is ResultStatus.OK
    assert of_kind(run, "joint_limit")
    elbows = [1, 3]
    assert np.abs(run.q[:, elbows]).max() <= 2.2 + 1e-8
    at = np.abs(run.q[:, elbows]) >= 2.2 - 1e-8
    force = run.stop_force[:, elbows]
    assert (force * np.sign(run.q[:, elbows]) <= 0.0).all()
    assert not force[~at].any()
    assert (run.stop_force[:, [0, 2]] == 0.0).all()
    assert np.diff(run.energy).max() < 1e-8 * np.abs(run.energy).max()
    assert run.gap.max() < 1e-9
    # independent of the steps of the integrator
    finer = inelastic(five_bar, start=start, duration=1.5, max_step=0.005, integrator="RK45", rtol=1e-9)
    assert [event.name for event in finer.events] == [event.name for event in run.events]
    np.testing.assert_allclose(finer.q[-1], run.q[-1], atol=1e-5)


def test_generated_code_takes_the_steps_between_the_stops(five_bar: Robot) -> None:
    start = closed_state(five_bar, [0.28, 0.7], [0.8, 0.3])
    runs = [inelastic(five_bar, start=start, duration=1.0, dynamics=fast) for fast in (None, five_bar)]
    assert [event.name for event in runs[0].events] == [event.name for event in runs[1].events]
    np.testing.assert_allclose(runs[0].q, runs[1].q, atol=1e-8)
    np.testing.assert_allclose(runs[0].stop_force, runs[1].stop_force, atol=1e-5)


def test_generated_code_leaves_joints_that_stops_hold_to_the_solver(tmp_path: Path) -> None:
    """It holds no joints: one restart, at the start, and none per step."""
    robot = pendulum(tmp_path, (-0.5, 2.0))
    start = tree_state(robot, [-0.5], [0.0])
    for fast in (None, robot):
        run = inelastic(robot, start=start, duration=1e-3, dt=1e-4, max_step=1e-5, dynamics=fast)
        assert not run.v.any()
        np.testing.assert_allclose(run.stop_force, MASS * G * CENTRE * np.cos(0.5), rtol=1e-9)
        assert run.statistics.restarts == 1


def test_a_rank_loss_while_a_stop_holds_a_joint_fails_and_says_so() -> None:
    """Two parallelograms by themselves: one rests on its stop while the other one falls flat."""
    shipped = parallelogram("second")
    model = pin.Model(shipped.model)
    limits = np.array(model.lowerPositionLimit)
    limits[model.joints[model.getJointId("second_0")].idx_q] = 1.0
    model.lowerPositionLimit = limits
    robot = replace(shipped, model=model)
    run = inelastic(robot, start=closed_state(robot, [1.2, 1.0], [-3.0, 0.0]), duration=1.0)
    assert run.status is ResultStatus.NOT_CONVERGED
    assert "its closures lose rank while a joint is held by its stop" in run.reason
    crank = model.joints[model.getJointId("crank_0")].idx_q
    assert 0.0 < run.q[-1, crank] < 0.5
    assert not run.v[:, model.joints[model.getJointId("second_0")].idx_v].any()


def test_a_carrier_at_the_end_of_its_track() -> None:
    robot = rp.load_robot("2rpr", end_effector_mass=0.5, cylinder_mass=0.3)
    limits = robot.carrier_limits[0]
    start = closed_state(robot, s=0.9 * limits.upper, sd=[1.5, 0.0])
    run = inelastic(robot, start=start, duration=0.4)
    hit = of_kind(run, "track")[0]
    assert (hit.name, hit.terminal) == (f"{robot.carriers[0]} upper", False)
    assert run.t[-1] == 0.4
    assert hit.impulse > 0.0
    assert run.s[:, 0].max() <= limits.upper + 1e-8
    assert np.diff(run.energy).max() < 1e-9
    ended = rp.simulate(robot, start=start, duration=0.4)
    assert ended.status is ResultStatus.STOPPED
    assert ended.t[-1] == pytest.approx(hit.t, abs=1e-9)
    assert not ended.stop_force.any()


class Sliding:
    """No efforts; every carrier goes outward at a constant speed, m/s, from where it starts, m."""

    def __init__(self, start: Array, speed: float) -> None:
        self._start, self._speed = start, speed

    def effort(self, t: float, state: State) -> tuple[Array, Array]:
        return np.zeros(state.robot.m), np.zeros(state.robot.k)

    def carrier_motion(self, t: float) -> tuple[Array, Array, Array]:
        still = 0.0 * self._start
        return self._start + self._speed * t, still + self._speed, still


def test_carriers_driven_by_motion_have_no_stops_and_the_joints_keep_theirs() -> None:
    """The five-bar with carriers, its first elbow limited to the angle that it starts at."""
    shipped = rp.load_robot("five_bar", carriers=True, gravity=(0, -G, 0))
    speed = 0.5
    begin = np.array([one.upper for one in shipped.carrier_limits]) - 0.02
    start, drive = closed_state(shipped, [0.25, 0.7], [0.8, 0.3], begin, speed), Sliding(begin, speed)
    model = pin.Model(shipped.model)
    elbow = model.joints[model.getJointId("elbow_1")].idx_q
    limits = np.array(model.lowerPositionLimit), np.array(model.upperPositionLimit)
    limits[0][elbow], limits[1][elbow] = start.q[elbow] - 0.2, start.q[elbow] + 0.2
    model.lowerPositionLimit, model.upperPositionLimit = limits
    robot = replace(shipped, model=model)
    start = tree_state(robot, start.q, start.v)
    run = inelastic(robot, drive, start=start, duration=0.6, carriers="motion", stop_at=())
    assert run.status is ResultStatus.LIMIT_VIOLATED
    assert {(event.joint, event.quantity) for event in run.violated} == {(name, "track") for name in robot.carriers}
    np.testing.assert_allclose(run.s, begin + speed * run.t[:, None], rtol=0.0, atol=1e-12)
    assert not run.stop_force[:, robot.carrier_velocity].any()
    passed = of_kind(run, "track")
    assert {event.name for event in passed} == {f"{name} upper" for name in robot.carriers}
    for event in passed:
        assert (event.terminal, event.impulse) == (False, 0.0)
        assert event.t == pytest.approx(0.02 / speed, abs=1e-8)
    hits = of_kind(run, "joint_limit")
    assert hits
    assert min(event.impulse for event in hits) > 0.0
    assert np.abs(run.q[:, elbow] - start.q[elbow]).max() <= 0.2 + 1e-8
    ended = inelastic(robot, drive, start=start, duration=0.6, carriers="motion")
    assert (ended.status, ended.events[-1].kind) == (ResultStatus.STOPPED, "track")
    assert ended.t[-1] == pytest.approx(0.02 / speed, abs=1e-8)


def test_a_start_that_moves_into_its_stop_loses_its_speed_at_once(tmp_path: Path) -> None:
    robot = pendulum(tmp_path, (-0.5, 2.0))
    run = inelastic(robot, start=tree_state(robot, [-0.5], [-3.0]), duration=0.1)
    assert run.events[0].impulse == pytest.approx(3.0 * (INERTIA + MASS * CENTRE**2), rel=1e-12)
    assert not run.v.any()


def test_a_digital_controller_goes_on_in_its_own_time(tmp_path: Path) -> None:
    robot, slope, period = pendulum(tmp_path, (-0.5, 2.0)), 8.0, 0.02
    start = tree_state(robot, [-0.5], [0.0])
    run = inelastic(robot, Efforts(slope), start=start, duration=1.0, sampling=Sampling(period))
    (release,) = of_kind(run, "release")
    weight = MASS * G * CENTRE * np.cos(0.5)
    assert release.t == pytest.approx(period * np.ceil(weight / slope / period), abs=1e-9)


def test_a_file_keeps_forces_and_impulses(tmp_path: Path) -> None:
    robot = pendulum(tmp_path, (-0.5, 2.0))
    run = inelastic(robot, start=tree_state(robot, [0.3], [0.0]), duration=0.5)
    run.save(tmp_path / "run.npz")
    again = load_simulation(tmp_path / "run.npz")
    assert again.events == run.events
    np.testing.assert_array_equal(again.stop_force, run.stop_force)


@pytest.mark.parametrize("seed", [*range(20), *(pytest.param(seed, marks=pytest.mark.long) for seed in range(20, 40))])
def test_least_constraint_is_the_optimum(seed: int) -> None:
    from scipy.optimize import minimize

    from redundancy_pin.simulation.stops import least_constraint

    dice = np.random.default_rng(seed)
    d, count = int(dice.integers(1, 5)), int(dice.integers(1, 5))
    root = dice.normal(size=(d, d)) + 2.0 * np.eye(d)
    inertia, moves = 10.0 ** dice.uniform(-6, 6) * (root @ root.T), dice.normal(size=(count, d))
    rate = moves @ (10.0 ** dice.uniform(-6, 6) * dice.normal(size=d))  # rates of a motion: rest keeps all stops
    step, push = least_constraint(inertia, moves, rate)
    size = np.abs(rate).max()
    assert (rate + moves @ step >= -1e-9 * size).all()
    assert (push >= 0.0).all()
    assert (np.abs(push * (rate + moves @ step)) <= 1e-9 * push.max(initial=0.0) * size).all()
    np.testing.assert_allclose(inertia @ step, moves.T @ push, atol=1e-9 * np.abs(inertia).max() * np.abs(step).max())
    scale, unit = np.abs(inertia).max(), size
    cost = lambda x: 0.5 * x @ (inertia / scale) @ x  # noqa: E731
    bound = {"type": "ineq", "fun": lambda x: rate / unit + moves @ x}
    best = minimize(cost, np.zeros(d), constraints=bound, method="SLSQP", options={"ftol": 1e-14, "maxiter": 200})
    if best.success:
        assert cost(step / unit) <= cost(best.x) + 1e-8 * max(cost(best.x), 1e-6)


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.long) for seed in (1, 2))])
def test_loose_steps_meet_the_same_stops(five_bar: Robot, seed: int) -> None:
    """Off by 1e-6 rad a joint may be farther from its stop than the slack of its range when it meets it."""
    dice = np.random.default_rng(seed)
    start = closed_state(five_bar, np.add([0.25, 0.7], dice.uniform(-0.03, 0.03, 2)), dice.uniform(-2.0, 2.0, 2))
    loose, tight = (
        inelastic(five_bar, start=start, duration=0.6, rtol=rtol, atol=rtol, integrator="RK45")
        for rtol in (1e-5, 1e-10)
    )
    assert loose.status is ResultStatus.OK
    names = [event.name for event in tight.events]
    assert [event.name for event in loose.events][: len(names)] == names
    np.testing.assert_allclose(loose.q[-1], tight.q[-1], atol=2e-3)
    assert np.abs(loose.q[:, [1, 3]]).max() < 2.2 + 1e-4


@pytest.mark.parametrize("joint_stops", ["end", "inelastic"])
def test_a_joint_that_leaves_its_stop_and_comes_back_at_once_meets_it_then(tmp_path: Path, joint_stops: str) -> None:
    robot, speed = pendulum(tmp_path, (-0.5, 2.0)), 0.02
    start = tree_state(robot, [-0.5], [speed])
    run = rp.simulate(robot, start=start, duration=0.05, dt=0.01, joint_stops=joint_stops)
    falls = MASS * G * CENTRE * np.cos(0.5) / (INERTIA + MASS * CENTRE**2)
    assert run.events[0].t == pytest.approx(2.0 * speed / falls, rel=1e-4)
    assert run.status is (ResultStatus.STOPPED if joint_stops == "end" else ResultStatus.OK)


def test_a_stop_beside_a_rank_loss_of_the_closures_holds() -> None:
    """A four-bar of equal cranks falls flat: its stop, 0.1 rad behind that pose, is met on the branch across it."""
    shipped = row_of_four_bars(1)
    model = pin.Model(shipped.model)
    limits = np.array(model.lowerPositionLimit)
    limits[0] = -0.1
    model.lowerPositionLimit = limits
    robot = replace(shipped, model=model)
    run = inelastic(robot, start=closed_state(robot, [0.5 * np.pi], [-2.0]), duration=0.7)
    (hit,) = of_kind(run, "joint_limit")
    after = run.t > hit.t
    assert run.status is ResultStatus.OK
    np.testing.assert_allclose(run.q[after, 0], -0.1, atol=1e-9)
    np.testing.assert_allclose(run.v[after], 0.0, atol=1e-20)
    np.testing.assert_allclose(np.diff(run.energy[after]), 0.0, atol=1e-12)


@pytest.mark.parametrize("seed", [*range(8), *(pytest.param(seed, marks=pytest.mark.long) for seed in range(8, 25))])
def test_a_start_at_several_stops_with_speed(tmp_path_factory: pytest.TempPathFactory, seed: int) -> None:
    """Motors and elbows at limits from where they are, pushed and thrown any way."""
    dice = np.random.default_rng(seed)
    shipped = rp.load_robot("five_bar", gravity=(0, -G, 0))
    start = closed_state(shipped, np.add([0.25, 0.7], dice.uniform(-0.1, 0.1, 2)), dice.uniform(-1.0, 1.0, 2))
    model, at = pin.Model(shipped.model), dice.integers(0, 3, 4)
    model.lowerPositionLimit = np.where(at == 1, start.q, -10.0)
    model.upperPositionLimit = np.where(at == 2, start.q, 10.0)
    robot = replace(shipped, model=model)
    efforts = Efforts(*dice.uniform(-300.0, 300.0, 2))
    run = inelastic(robot, efforts, start=tree_state(robot, start.q, start.v), duration=0.2)
    assert run.status is ResultStatus.OK
    assert (run.q >= model.lowerPositionLimit - 2e-9).all()
    assert (run.q <= model.upperPositionLimit + 2e-9).all()
    assert (run.stop_force[:, at == 1] >= 0.0).all()
    assert (run.stop_force[:, at == 2] <= 0.0).all()
    assert (run.stop_force[:, at == 0] == 0.0).all()
    assert not any(0.0 < event.impulse < 1e-12 for event in run.events)  # rounding is no impact


def test_what_rests_does_not_depend_on_the_duration(tmp_path: Path) -> None:
    robot = pendulum(tmp_path, (-0.5, 2.0))
    start = tree_state(robot, [-0.5], [0.01])
    long, short = (inelastic(robot, start=start, duration=end, dt=1e-3) for end in (0.5, 0.001))
    np.testing.assert_allclose(short.q[-1], long.q[1], rtol=0.0, atol=1e-12)
    assert not short.stop_force[0].any()


@pytest.mark.parametrize("sampling", [None, Sampling(0.02, 0.01)])
def test_at_a_jump_of_efforts_the_stop_lets_go_that_would_pull(tmp_path: Path, sampling: Sampling | None) -> None:
    class Jump:
        breaks = np.array([0.1])

        def effort(self, t: float, state: State) -> tuple[Array, Array]:
            return np.full(2, -5.0 if t < 0.1 else 30.0), np.zeros(0)

    robot = pendulum(tmp_path, (-0.5, 2.0), (-1.0, 1.0))
    run = inelastic(robot, Jump(), start=tree_state(robot, [-0.5, -1.0], [0.0, 0.0]), duration=0.2, sampling=sampling)
    (release,) = run.events
    # hinge_2 lets go at once; the first link stays pressed on its stop by the reaction of the second
    assert (release.kind, release.name) == ("release", "hinge_2 lower")
    assert release.t == pytest.approx(0.1 if sampling is None else 0.11, abs=1e-9)
    assert (run.stop_force[run.t > release.t, 0] > 0.0).all()
