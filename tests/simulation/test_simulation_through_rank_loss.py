"""Motions through poses where the closures lose rank: flat parallelograms and other change-point linkages.

They are judged by closed forms and Lagrange's equation of the branch that the motion is on (``flat_linkages``,
``change_point_oracle``), which know nothing of closures.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi
import numpy as np
import pytest
from change_point_oracle import change_point, factor
from flat_linkages import GRAVITY, four_bar, parallelogram, rocker_and_coupler, row_of_four_bars
from scipy.integrate import solve_ivp

import redundancy_pin as rp
from redundancy_pin.arrays import Array
from redundancy_pin.errors import SingularPoseError
from redundancy_pin.robot import Robot
from redundancy_pin.simulation import Sampling, Simulation, State, closed_state, tree_state
from redundancy_pin.simulation import integrator as integration
from redundancy_pin.simulation.rank_loss import Sheet, sheet_ahead
from redundancy_pin.simulation.system import Machine
from redundancy_pin.status import ResultStatus

EXACT = 1e-7
"""rad; steps of 1e-11 through up to ten seconds of falling, where errors grow a thousandfold."""

TIGHT = {"rtol": 1e-9, "atol": 1e-10}
ALL: Mapping[str, Mapping[str, Any]] = {
    "DOP853": {},
    "RK45": {"integrator": "RK45", **TIGHT},
}


def upright(count: int, speed: float) -> State:
    return closed_state(row_of_four_bars(count), [0.5 * np.pi], [-speed])


def falling(count: int, speed: float, times: Array) -> tuple[Array, Array]:
    """Return the angle of all cranks of benchmark A02 at times, and when it passes 0 and −π, from one pendulum."""
    inertia, moment = (count + 1) / 3.0 + count, ((count + 1) / 2.0 + count) * GRAVITY

    def flat(t: float, y: Array) -> float:
        return float(np.sin(y[0]))

    run = solve_ivp(
        lambda t, y: [y[1], -moment / inertia * np.cos(y[0])],
        (0.0, times[-1]),
        [0.5 * np.pi, -speed],
        "DOP853",
        times,
        events=flat,
        rtol=1e-12,
        atol=1e-13,
    )
    return run.y[0], run.t_events[0]


def of_kind(run: Simulation, kind: str) -> list[float]:
    return [event.t for event in run.events if event.kind == kind]


def require_a02(count: int, speed: float, duration: float, options: Mapping[str, Any], within: float) -> None:
    run = rp.simulate(row_of_four_bars(count), start=upright(count, speed), duration=duration, dt=0.02, **options)
    angle, flat = falling(count, speed, run.t)
    assert run.status is ResultStatus.OK
    cranks, couplers = run.q[:, [0, *range(2, 2 * count + 1, 2)]], run.q[:, 1::2]
    np.testing.assert_allclose(cranks, np.tile(angle[:, None], (1, count + 1)), atol=within)
    np.testing.assert_allclose(couplers, np.tile(-angle[:, None], (1, count)), atol=within)
    np.testing.assert_allclose(run.energy, run.energy[0], rtol=within)
    np.testing.assert_allclose(of_kind(run, "closure_rank"), flat, atol=within)
    assert len(flat) >= 2
    assert run.gap.max() < 1e-12


ROWS = [(1, 1.0), (2, 4.0), (3, 0.5)]
FALLS = {f"{count}-{speed}-{options}" for count, speed in ROWS for options in ALL}


@pytest.mark.long_for(*sorted(FALLS - {"2-4.0-DOP853"}))
@pytest.mark.parametrize("options", ALL)
@pytest.mark.parametrize(("count", "speed"), ROWS)
def test_rows_of_four_bars_fall_through_their_flat_pose(count: int, speed: float, options: str) -> None:
    within = EXACT if "RK45" not in options else 1e-5
    require_a02(count, speed, 2.0, ALL[options], within)


@pytest.mark.long
@pytest.mark.parametrize("speed", np.linspace(0.25, 6.0, 24))
@pytest.mark.parametrize("count", [1, 2, 3])
def test_all_start_speeds_of_benchmark_a02(count: int, speed: float) -> None:
    require_a02(count, speed, 10.0, {}, EXACT)


@pytest.mark.long
def test_the_four_bar_of_pinocchios_example_falls_through_too() -> None:
    """Sides of 0.6 and 1 m, links of 5 and 10 kg, from rest: it stopped at its first flat pose, after half a second."""
    robot = row_of_four_bars(1, 0.6, 1.0, mass=(5.0, 10.0, 5.0))
    run = rp.simulate(robot, start=closed_state(robot, [1.2]), duration=3.0, dt=0.02)
    assert run.status is ResultStatus.OK
    inertia, moment = (2.0 / 3.0 * 5.0 + 10.0) * 0.36, (5.0 + 10.0) * 0.6 * GRAVITY
    swing = solve_ivp(
        lambda t, y: [y[1], -moment / inertia * np.cos(y[0])],
        (0.0, 3.0),
        [1.2, 0.0],
        "DOP853",
        run.t,
        rtol=1e-12,
        atol=1e-13,
    )
    np.testing.assert_allclose(run.q[:, 0], swing.y[0], atol=EXACT)
    np.testing.assert_allclose(run.q[:, 1], -swing.y[0], atol=EXACT)
    assert len(of_kind(run, "closure_rank")) == 4  # down, up at the other side, and back again


def random_linkage(rng: np.random.Generator) -> tuple[float, float, float, float]:
    """Return sides (crank, coupler, rocker, ground) with a flat pose, whose crank turns all the way round."""
    while True:
        a, b, c = rng.uniform(0.3, 1.2, 3).tolist()
        lengths = (
            (a, b, c, a + b - c),
            (a, b, c, b + c - a),
            (a, b, c, a + c - b),
            (a, b, a, b),
        )[rng.integers(4)]
        factors = factor(lengths) if lengths[3] > 0.2 and abs(a - lengths[3]) > 0.03 else None
        if factors is not None and np.polynomial.Polynomial(factors[1])(np.linspace(-1.0, 1.0, 401)).min() > 1e-3:
            return lengths


def require_change_point(seed: int, options: Mapping[str, Any], within: float) -> int:
    rng = np.random.default_rng(seed)
    lengths, side = random_linkage(rng), int(rng.choice([-1, 1]))
    angle, rate = float(rng.uniform(0.6, 2.4)), float(rng.uniform(-8.0, 8.0))
    rocker, coupler = np.exp(1j * np.array(rocker_and_coupler(lengths, angle, side)))
    branches = [change_point(lengths, sign) for sign in (1, -1)]
    starts = [np.array(branch.angles(angle)).ravel() @ [1.0, 1j, 0.0, 0.0] for branch in branches]
    oracle = branches[int(np.argmin(np.abs(np.array(starts) - rocker)))]
    robot = four_bar(lengths, angle, side)
    run = rp.simulate(robot, start=closed_state(robot, [angle], [rate]), duration=2.0, dt=0.05, **options)
    assert run.status is ResultStatus.OK, run.reason
    angles, _ = oracle.motion(angle, rate, run.t)
    np.testing.assert_allclose(run.q[:, 0], angles, atol=within)
    ends = np.array([np.array(oracle.angles(one)).ravel() for one in angles])
    np.testing.assert_allclose(np.exp(1j * run.q[:, 2]), ends[:, 0] + 1j * ends[:, 1], atol=within)
    angle_sum = run.q[:, 0] + run.q[:, 1]
    np.testing.assert_allclose(np.exp(1j * angle_sum), ends[:, 2] + 1j * ends[:, 3], atol=within)
    assert abs(coupler - (ends[0, 2] + 1j * ends[0, 3])) < 1e-8
    return len(of_kind(run, "closure_rank"))


@pytest.mark.long
@pytest.mark.parametrize("options", ALL)
def test_random_change_point_linkages_stay_on_their_branch(options: str) -> None:
    within = EXACT if "RK45" not in options else 1e-5
    first = 2 * list(ALL).index(options)
    assert sum(require_change_point(seed, ALL[options], within) for seed in (first, first + 1)) > 1


@pytest.mark.long
@pytest.mark.parametrize("seed", range(100, 200))
def test_a_hundred_random_change_point_linkages(seed: int) -> None:
    require_change_point(seed, list(ALL.values())[seed % len(ALL)], 1e-4)


def flat(rate: list[float], at: float = 0.0) -> State:
    return tree_state(row_of_four_bars(1), [at, -at, at], rate)


def test_a_start_at_the_flat_pose_goes_on_along_its_velocity() -> None:
    robot = row_of_four_bars(1)
    parallel = rp.simulate(robot, start=flat([-1.0, 1.0, -1.0]), duration=0.3, dt=0.05)
    np.testing.assert_allclose(parallel.q[:, 0], -parallel.q[:, 1], atol=1e-12)
    # with B₀ on A₁ coupler and second crank turn as one, and the first crank stands still
    folded = rp.simulate(robot, start=flat([0.0, 1.0, 1.0]), duration=0.3, dt=0.05)
    np.testing.assert_allclose(folded.q[:, 0], 0.0, atol=1e-12)
    np.testing.assert_allclose(folded.q[:, 1], folded.q[:, 2], atol=1e-12)
    for run in (parallel, folded):
        assert run.status is ResultStatus.OK
        assert min(of_kind(run, "closure_rank"), default=1.0) > 0.1  # what starts there has not come to it
        np.testing.assert_allclose(run.energy, run.energy[0], atol=1e-8)
        # the closures do not determine their forces there, and do beside it
        assert np.isnan(run.closure_force[0]).all()
        assert np.isfinite(run.closure_force[1:]).all()
    # two rods as one about A₁: inertia 2/3, moment of gravity 1
    swing = solve_ivp(
        lambda t, y: [y[1], -1.5 * GRAVITY * np.cos(y[0])],
        (0.0, 0.3),
        [0.0, 1.0],
        t_eval=folded.t,
        rtol=1e-11,
        atol=1e-12,
    )
    np.testing.assert_allclose(folded.q[:, 2], swing.y[0], atol=1e-8)


@pytest.mark.parametrize("at", [-1e-9, 1e-9])
def test_a_start_at_the_flat_pose_has_not_come_to_it_whichever_way_it_is_rounded(at: float) -> None:
    run = rp.simulate(row_of_four_bars(1), start=flat([1.0, -1.0, 1.0], at), duration=0.05, dt=0.01)
    assert run.status is ResultStatus.OK
    assert run.q[-1, 0] > 0.03
    assert run.events == ()


@pytest.mark.parametrize("beyond", [1e-3, 1e-5, 1e-7])
def test_a_start_just_beyond_the_flat_pose_leaves_it_behind(beyond: float) -> None:
    lengths = (0.5, 0.9, 0.7, 0.3)
    robot, oracle = four_bar(lengths, 0.05, 1), change_point(lengths, 1)
    start = closed_state(robot, [0.05], [1.0])
    rocker, coupler = np.array(oracle.rates(beyond)).ravel()
    c, s, cc, ss = np.array(oracle.angles(beyond)).ravel()
    q = np.array([beyond, np.angle(complex(cc, ss)) - beyond, np.angle(complex(c, s))])
    assert np.abs(np.sin(0.5 * (q - start.q))).max() < 0.2  # on the branch of the robot's reference
    start = tree_state(robot, q, 2.0 * np.array([1.0, coupler - 1.0, rocker]))
    run = rp.simulate(robot, start=start, duration=0.3, dt=0.02)
    assert run.status is ResultStatus.OK
    assert not of_kind(run, "closure_rank")
    np.testing.assert_allclose(run.q[:, 0], oracle.motion(beyond, 2.0, run.t)[0], atol=EXACT)


def test_a_start_at_the_flat_pose_that_does_not_say_where_to_is_refused_with_the_pose() -> None:
    robot = row_of_four_bars(1)
    with pytest.raises(SingularPoseError, match=r"lost rank.*q = \[0\.0, 0\.0, 0\.0\]"):
        rp.simulate(robot, start=flat([0.0, 0.0, 0.0]), duration=0.1)
    with pytest.raises(SingularPoseError, match="rank"):  # J_c v = 0, but along neither motion
        rp.simulate(robot, start=flat([-1.0, 2.0, 0.0]), duration=0.1)
    with pytest.raises(SingularPoseError, match=r"is 0\.00[12] 1/s from that of the nearest smooth motion"):
        rp.simulate(robot, start=flat([-1.0, 1.001, -0.999]), duration=0.1)


def thrown_to(height: float) -> Simulation:
    """Throw the row up from θ = −0.5 so that it turns back at an angle beyond its flat pose (θ = 0), or before it."""
    rate = np.sqrt(2.0 * 2.0 * GRAVITY / (5.0 / 3.0) * (np.sin(height) - np.sin(-0.5)))
    robot = row_of_four_bars(1)
    return rp.simulate(robot, start=closed_state(robot, [-0.5], [rate]), duration=0.6, dt=0.01)


@pytest.mark.parametrize("height", [1e-2, 1e-4, -1e-4])
def test_turning_back_just_beyond_or_before_the_flat_pose(height: float) -> None:
    run = thrown_to(height)
    assert run.status is ResultStatus.OK
    assert len(of_kind(run, "closure_rank")) == (2 if height > 0.0 else 0)
    np.testing.assert_allclose(run.q[:, 0], -run.q[:, 1], atol=1e-10)
    np.testing.assert_allclose(run.energy, run.energy[0], atol=1e-8)


@pytest.mark.parametrize("beside", [-1e-4, 1e-4])
def test_a_start_beside_the_flat_pose_moves_away_exactly(beside: float) -> None:
    """The couplers do not turn: one pendulum, of inertia 5/3 and moment 2 g."""
    robot = row_of_four_bars(1)
    run = rp.simulate(robot, start=closed_state(robot, [beside], [np.copysign(1.0, beside)]), duration=0.2, dt=0.01)
    swing = solve_ivp(
        lambda t, y: [y[1], -1.2 * GRAVITY * np.cos(y[0])],
        (0.0, 0.2),
        [beside, np.copysign(1.0, beside)],
        "DOP853",
        run.t,
        rtol=1e-12,
        atol=1e-13,
    )
    assert run.status is ResultStatus.OK
    np.testing.assert_allclose(run.q[:, 0], swing.y[0], atol=1e-9)
    np.testing.assert_allclose(run.v[:, 1], -swing.y[1], atol=1e-8)


def test_rest_at_the_flat_pose_leaves_the_motion_undetermined_and_says_so() -> None:
    run = thrown_to(0.0)
    assert run.status is ResultStatus.NOT_CONVERGED
    assert "undetermined" in run.reason
    assert "q = [" in run.reason
    assert abs(run.q[-1, 0]) < 1e-7
    assert run.t[-1] < 0.4


def test_a_motion_that_settles_at_the_flat_pose_without_turning_back_says_so_too() -> None:
    """Critically damped: θ = 0.3 (1 + 20 t) exp(−20 t); rounding that crosses the pose is no event."""
    robot, inertia, rate = row_of_four_bars(1, gravity=0.0), 5.0 / 3.0, 20.0

    def settling(state: State) -> Array:
        return np.array([-inertia * (rate**2 * state.q[0] + 2.0 * rate * state.v[0]), 0.0, 0.0])

    run = rp.simulate(robot, start=closed_state(robot, [0.3]), duration=3.0, dt=0.05, external=settling)
    assert run.status is ResultStatus.NOT_CONVERGED
    assert "undetermined" in run.reason
    assert run.events == ()
    assert 1.0 < run.t[-1] < 1.8  # θ is 1e-7 and 1e-13
    np.testing.assert_allclose(run.q[:, 0], 0.3 * (1.0 + rate * run.t) * np.exp(-rate * run.t), atol=1e-9)


@pytest.mark.long
@pytest.mark.parametrize("longer", [1e-4, -1e-4])
def test_sides_a_little_unequal_have_no_flat_pose_and_the_motion_turns_sharply_instead(longer: float) -> None:
    robot = row_of_four_bars(1, 1.0, 1.0, 1.0, 1.0 + longer)
    run = rp.simulate(robot, start=closed_state(robot, [0.5 * np.pi], [-1.0]), duration=0.85, dt=2e-3, max_step=0.02)
    assert run.status is ResultStatus.OK
    assert not of_kind(run, "closure_rank")
    np.testing.assert_allclose(run.energy, run.energy[0], atol=1e-6)
    # coupler and rocker come into line nowhere: their branch is that of the start for ever
    in_line = np.sin(run.q[:, 0] + run.q[:, 1] - run.q[:, 2])
    assert (in_line * in_line[0] > 0.0).all()
    assert np.abs(run.q[:, 0] + run.q[:, 1]).max() > 0.5  # which is no parallelogram's


def test_what_is_neither_a_crossing_nor_resolved_is_refused_with_time_and_pose() -> None:
    robot = row_of_four_bars(1, 1.0, 1.0, 1.0, 1.0 + 1e-9)
    run = rp.simulate(robot, start=closed_state(robot, [0.5 * np.pi], [-1.0]), duration=1.0, dt=0.01)
    assert run.status is ResultStatus.NOT_CONVERGED
    assert "lose rank just ahead" in run.reason
    assert "q = [" in run.reason
    assert run.t[-1] == pytest.approx(falling(1, 1.0, np.linspace(0.0, 1.0, 9))[1][0], abs=1e-3)


LOOSE: Mapping[str, Mapping[str, Any]] = {
    "DOP853": {"rtol": 1e-4, "atol": 1e-5},
    "RK45": {"integrator": "RK45", "rtol": 1e-3, "atol": 1e-3},
}


@pytest.mark.long_for("RK45")
@pytest.mark.parametrize("options", LOOSE)
def test_no_step_is_so_long_that_a_rank_loss_within_it_is_missed(options: str) -> None:
    """Without gravity it turns evenly, and loose tolerances allow steps of more than a turn."""
    for count, rate in ((1, 20.0), (2, 0.3)):
        robot = row_of_four_bars(count, gravity=0.0)
        start = closed_state(robot, [1.2], [rate])
        run = rp.simulate(robot, start=start, duration=7.0 / rate, dt=0.05 / rate, **LOOSE[options])
        assert run.status is ResultStatus.OK
        np.testing.assert_allclose(run.q[:, 0], 1.2 + rate * run.t, atol=1e-9)
        np.testing.assert_allclose(run.q[:, 1], -run.q[:, 0], atol=1e-9)
        expected = (np.pi * np.arange(1.0, 3.0) - 1.2) / rate
        np.testing.assert_allclose(of_kind(run, "closure_rank"), expected, rtol=1e-9)


def test_a_velocity_that_jumps_is_refused_with_joint_and_speeds(monkeypatch: pytest.MonkeyPatch) -> None:
    """A projection that turns the first crank back, as one onto another branch would."""
    project = Machine.project

    def turned(machine: Machine, t: float, y: Array, sheet: Sheet | None = None) -> tuple[Array, float, float]:
        state, before, left = project(machine, t, y, sheet)
        if t > 0.2:
            state[3] = -state[3]
        return state, before, left

    monkeypatch.setattr(Machine, "project", turned)
    run = rp.simulate(row_of_four_bars(1), start=upright(1, 1.0), duration=0.5, dt=0.01)
    assert run.status is ResultStatus.NOT_CONVERGED
    assert "velocity of crank_0 would jump from -" in run.reason
    assert run.t[-1] <= 0.21


@pytest.mark.long
def test_a_step_to_another_branch_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where nothing looks ahead, a step may end on another branch: its end velocity gives it away."""
    monkeypatch.setattr(integration, "retry_at_rank_loss", lambda *_: None)
    for count in (1, 2):
        for speed in (1.0, 5.0):
            start = upright(count, speed)
            run = rp.simulate(row_of_four_bars(count), start=start, duration=1.5, dt=0.01, rtol=1e-6, atol=1e-7)
            angle, _ = falling(count, speed, run.t)
            right = np.abs(run.q[:, 0] - angle).max() < 1e-3
            assert right or run.status is ResultStatus.NOT_CONVERGED


def test_determinants_with_roots_of_any_multiplicity_are_events_at_a_rank_loss() -> None:
    for count in (2, 3):  # det [J_c; S] has a root of order N there
        run = rp.simulate(row_of_four_bars(count), start=upright(count, 1.0), duration=1.4, dt=0.1)
        times = of_kind(run, "closure_rank")
        assert len(times) == 2
        assert of_kind(run, "type_II") == times == of_kind(run, "type_I")
        stopped = rp.simulate(
            row_of_four_bars(count), start=upright(count, 1.0), duration=1.4, dt=0.1, stop_at=["type_II"]
        )
        assert stopped.status is ResultStatus.STOPPED
        assert stopped.t[-1] == pytest.approx(times[0], abs=1e-9)
        assert abs(stopped.q[-1, 0]) < 1e-9


SIDES = (0.5, 0.9, 0.7, 0.3)
"""Crank, coupler, rocker, ground: flat with the coupler turned back over the crank."""


def sheet_through(robot: Robot, angles: list[float], rates: list[float]) -> Sheet:
    state = closed_state(robot, angles, rates)
    sheet = sheet_ahead(state.chain, np.array(state.q), np.array(state.v), 0.3)
    assert isinstance(sheet, Sheet)
    return sheet


def test_a_sheet_is_the_closed_form_through_the_flat_pose() -> None:
    robot, branch = four_bar(SIDES, 0.05, 1), change_point(SIDES, 1)

    def place(crank: float) -> Array:
        """Return q (3,), continued from the reference: crank, coupler from the crank, rocker."""
        c, s, cc, ss = np.array(branch.angles(crank)).ravel()
        coupler = np.angle(complex(cc, ss)) - crank
        q = np.array([crank, coupler, np.angle(complex(c, s))])
        return q + 2.0 * np.pi * np.round((robot.q_reference - q) / (2.0 * np.pi))

    def rate(crank: float) -> Array:
        rocker, coupler = np.array(branch.rates(crank)).ravel()
        return np.array([1.0, coupler - 1.0, rocker])

    if np.abs(place(0.05) - robot.q_reference).max() > 1e-6:
        branch = change_point(SIDES, -1)
    sheet = sheet_through(robot, [0.05], [-2.0])
    kept = np.isin(np.arange(3), sheet.independent)
    for crank in (0.04, 1e-3, 1e-9, -1e-6, -0.03):
        q, slope = place(crank), rate(crank)
        off = np.where(kept, 0.0, 1e-2)  # z and ż are what counts
        motion = sheet.at(q + off, -2.0 * slope + off)
        assert motion is not None
        np.testing.assert_allclose(motion.q, q, atol=1e-12)
        np.testing.assert_allclose(motion.v, -2.0 * slope, atol=1e-10)
        np.testing.assert_allclose(motion.basis[:, 0], slope / slope[kept], atol=1e-10)
        h = 1e-5
        bend = (rate(crank + h) - rate(crank - h)) / (2.0 * h) * 4.0
        # q̈ along the branch where the crank does not accelerate, less what the acceleration of z adds
        expected = bend - slope / slope[kept] * bend[kept]
        np.testing.assert_allclose(motion.particular, expected, rtol=1e-5, atol=1e-6)


def test_a_sheet_of_two_freedoms_is_closed_beside_its_line_too() -> None:
    robot, rng = parallelogram("pendulum"), np.random.default_rng(3)
    sheet = sheet_through(robot, [0.1, 0.4], [-2.0, 0.3])
    chain = sheet.passage.solver.chain
    for crank in (0.05, 1e-3, 0.0, -0.1):
        q, v = np.array([crank, -crank, 0.9, crank]), rng.uniform(-3.0, 3.0, robot.model.nv)
        off = np.where(np.isin(np.arange(4), sheet.independent), 0.0, 0.2)
        motion = sheet.at(q + off, v)
        assert motion is not None
        np.testing.assert_allclose(motion.q, q, atol=1e-12)
        chain.update(motion.q, motion.v)
        np.testing.assert_allclose(chain.jacobian() @ motion.v, 0.0, atol=1e-12)


class Driven:
    """Pushes the first crank, and the carrier where there is one."""

    def effort(self, t: float, state: State) -> tuple[Array, Array]:
        return np.array([3.0 * np.sin(5.0 * t)]), -20.0 * np.array(state.s) - 2.0 * np.array(state.sd)

    def carrier_motion(self, t: float) -> tuple[Array, Array, Array]:
        s = np.array([np.sin(5.0 * t), 5.0 * np.cos(5.0 * t), -25.0 * np.sin(5.0 * t)])
        return tuple(0.2 * s[:, None])


@pytest.mark.long_for("force", "motion")
@pytest.mark.parametrize("drive", ["force", "motion", "sampled"])
def test_work_is_energy_through_flat_poses_with_carriers_and_sampled_controllers(drive: str) -> None:
    robot = parallelogram("carrier")
    options = {"sampling": Sampling(5e-3, 2e-3)} if drive == "sampled" else {}
    moving = {"carriers": "motion"} if drive == "motion" else {}
    start = closed_state(robot, [1.2], [-3.0], 0.0, 1.0)
    run = rp.simulate(robot, Driven(), start=start, duration=0.6, dt=1e-3, stop_at=(), **options, **moving)
    assert run.t[-1] == 0.6
    off = np.abs(run.s).max() > 0.4  # the track; nothing stops the carrier at its end
    assert run.status is (ResultStatus.LIMIT_VIOLATED if off else ResultStatus.OK)
    flat = np.flatnonzero(np.diff(np.sign(np.sin(run.q[:, 0]))))
    assert len(flat) >= 1
    np.testing.assert_allclose(of_kind(run, "closure_rank"), run.t[flat] + 5e-4, atol=5e-4)
    # trapezoids of 1 ms over efforts and speeds of order 10. Each change of a held effort is half in the wrong one:
    # half a millisecond times 3 rad/s times changes of 60 N·m together
    np.testing.assert_allclose(run.energy - run.energy[0], run.work, atol=0.1 if drive == "sampled" else 1e-3)
    np.testing.assert_allclose(run.q[:, 0], -run.q[:, 1], atol=1e-10)


def test_joints_without_end_are_carried_across_too() -> None:
    bounded, endless = parallelogram(), parallelogram("continuous")
    runs = [
        rp.simulate(one, start=closed_state(one, [1.2], [-3.0]), duration=2.0, dt=0.02) for one in (bounded, endless)
    ]
    np.testing.assert_allclose(runs[0].x, runs[1].x, atol=1e-8)
    np.testing.assert_allclose(of_kind(runs[0], "closure_rank"), of_kind(runs[1], "closure_rank"), atol=1e-8)
    assert len(of_kind(runs[0], "closure_rank")) == 3


@pytest.mark.long_for("0.2", "0.03", "0.1")
@pytest.mark.parametrize("apart", [0.2, 0.1, 0.03, 1e-3])
def test_two_loops_that_are_flat_one_soon_after_the_other(apart: float) -> None:
    robot = parallelogram(incline=apart)
    run = rp.simulate(robot, start=closed_state(robot, [1.2], [-3.0]), duration=1.0, dt=0.02)
    assert run.status is ResultStatus.OK
    angles = dict(zip(list(robot.model.names)[1:], run.q.T, strict=True))
    # three cranks and two couplers that do not turn
    swing = solve_ivp(
        lambda t, y: [y[1], -3.5 / 3.0 * GRAVITY * np.cos(y[0])],
        (0.0, 1.0),
        [1.2, -3.0],
        "DOP853",
        run.t,
        events=[lambda t, y, flat=flat: np.sin(y[0] - flat) for flat in (0.0, apart)],
        rtol=1e-12,
        atol=1e-12,
    )
    for name, expected in (
        *((f"crank_{i}", swing.y[0]) for i in range(3)),
        *((f"coupler_{i + 1}", at - swing.y[0]) for i, at in enumerate((0.0, apart))),
    ):
        np.testing.assert_allclose(angles[name], expected, atol=EXACT)
    np.testing.assert_allclose(of_kind(run, "closure_rank"), np.sort(np.concatenate(swing.t_events)), atol=EXACT)


def with_pendulum(times: Array, start: tuple[float, float], rate: tuple[float, float]) -> Array:
    """Return the angles of cranks and of a pendulum on the middle of the coupler, (N, 2), by Lagrange's equation.

    The coupler does not turn, so that the pendulum's joint has its angle in the world.
    """
    y, yd = casadi.SX.sym("y", 2), casadi.SX.sym("yd", 2)
    crank, rod = (casadi.vertcat(casadi.cos(angle), casadi.sin(angle)) for angle in casadi.vertsplit(y))
    centre = crank + 0.35 * rod
    speed = casadi.jtimes(centre, y, yd)
    kinetic = (1.0 / 3.0 + 0.5) * yd[0] ** 2 + 0.5 * (casadi.dot(speed, speed) + 0.7**2 / 12.0 * yd[1] ** 2)
    potential = GRAVITY * (2.0 * crank[1] + centre[1])
    momentum = casadi.gradient(kinetic, yd)
    mass = casadi.jacobian(momentum, yd)
    rest = casadi.gradient(kinetic - potential, y) - casadi.jtimes(momentum, y, yd)
    f = casadi.Function("f", [y, yd], [casadi.solve(mass, rest)])

    def rates(t: float, state: Array) -> Array:
        return np.concatenate([state[2:], np.array(f(state[:2], state[2:])).ravel()])

    run = solve_ivp(rates, (0.0, times[-1]), [*start, *rate], "DOP853", times, rtol=1e-12, atol=1e-12)
    return run.y[:2].T


@pytest.mark.long
@pytest.mark.parametrize("options", ALL)
def test_with_two_freedoms_the_sheet_is_a_surface(options: str) -> None:
    robot: Robot = parallelogram("pendulum")
    start, rate = (1.2, -1.0), (-2.0, 1.0)
    run = rp.simulate(robot, start=closed_state(robot, start, rate), duration=1.2, dt=0.02, **ALL[options])
    assert run.status is ResultStatus.OK
    times = of_kind(run, "closure_rank")
    assert len(times) == 2
    expected = with_pendulum(run.t, start, rate)
    np.testing.assert_allclose(run.x, expected, atol=EXACT if options != "RK45" else 1e-5)
    crossing = np.interp(times, run.t, run.q[:, 0])
    np.testing.assert_allclose(np.sin(crossing), 0.0, atol=5e-3)  # 20 ms between samples


@pytest.mark.parametrize("behind", [1e-3, 6e-3, 4e-2])
def test_a_start_shortly_behind_a_flat_pose_with_two_freedoms_goes_on(behind: float) -> None:
    robot: Robot = parallelogram("pendulum")
    start, rate = (-behind, 0.4), (-0.1, 0.3)
    run = rp.simulate(robot, start=closed_state(robot, start, rate), duration=0.2, dt=0.02)
    assert run.status is ResultStatus.OK
    np.testing.assert_allclose(run.x, with_pendulum(run.t, start, rate), atol=EXACT)


@pytest.mark.long_for("rates0", "rates2")
@pytest.mark.parametrize("rates", [(-3.0, -2.9), (-3.0, -3.001), (-3.0, 1.0)])
def test_loops_that_move_by_themselves_are_flat_while_another_one_is(rates: tuple[float, float]) -> None:
    """The second comes to its rank loss on the sheet of the first, whose line does not lead there."""
    robot = parallelogram("second")
    run = rp.simulate(robot, start=closed_state(robot, [1.2, 1.2], rates), duration=1.0, dt=0.02)
    assert run.status is ResultStatus.OK
    times = []
    for first, last, rate in (("crank_0", "coupler_1", rates[0]), ("second_0", "beam", rates[1])):
        swing = solve_ivp(
            lambda t, y: [y[1], -1.2 * GRAVITY * np.cos(y[0])],  # moment 2 g, inertia 5/3
            (0.0, 1.0),
            [1.2, rate],
            "DOP853",
            run.t,
            events=lambda t, y: np.sin(y[0]),
            rtol=1e-12,
            atol=1e-12,
        )
        for name, expected in ((first, swing.y[0]), (last, -swing.y[0])):
            at = robot.model.joints[robot.model.getJointId(name)].idx_q
            np.testing.assert_allclose(run.q[:, at], expected, atol=EXACT)
        times += swing.t_events[0].tolist()
    np.testing.assert_allclose(of_kind(run, "closure_rank"), np.sort(times), atol=1e-6)
