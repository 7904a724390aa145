"""``simulate`` from outside: what it accepts, what it reports, what it refuses."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import moving
import numpy as np
import pytest
import zoo
from spatial_chains import chain_of

import redundancy_pin as rp
from redundancy_pin.arrays import Array
from redundancy_pin.errors import IllPosedModelError, InputError
from redundancy_pin.robot import Robot
from redundancy_pin.simulation import Simulation
from redundancy_pin.simulation.controllers.base import Constant, Controller, Sampling
from redundancy_pin.simulation.controllers.lqr import TimeVaryingLqr
from redundancy_pin.simulation.state import State, closed_state, tree_state
from redundancy_pin.status import ResultStatus

SAME = 1e-9
"""Two ways through the same motion of a second, each accurate to some 1e-11."""


@dataclass
class Spring:
    """Pulls the platform to a point; counts how often it is asked."""

    centre: Array
    stiffness: float = 20.0
    asked: list[float] = field(default_factory=list)

    def effort(self, t: float, state: State) -> tuple[Array, Array]:
        self.asked.append(t)
        # Wᵀ maps ẋ to the actuated rates: with three of each, τ = W⁻¹ f
        chain = state.chain
        chain.update(state.q, state.v)
        pose = chain.pose_columns
        rows = np.concatenate([chain.jacobian(), chain.platform_jacobian()])[:, pose]
        gamma = np.linalg.inv(rows)[:, chain.rows :]
        at = [int(np.flatnonzero(pose == column)[0]) for column in state.robot.actuated_velocity]
        force = self.stiffness * (self.centre - state.x) - 8.0 * state.xd
        return np.linalg.solve(gamma[at].T, force), -3.0 * state.sd


def home(robot: Robot) -> Array:
    return np.array(zoo.home_of(robot))


def test_a_machine_at_rest_without_gravity_stays_where_it_is() -> None:
    robot = zoo.robot_of("3rrr")
    run = rp.simulate(robot, duration=0.1, dt=0.03)
    assert run.status is ResultStatus.OK
    np.testing.assert_array_equal(run.t, [0.0, 0.03, 0.06, 0.09, 0.1])
    np.testing.assert_allclose(run.q, np.tile(robot.q_reference, (5, 1)), atol=1e-12)
    assert not run.tau.any()
    assert run.x.shape == (5, 3)
    assert run.closure_force.shape == (5, 4)


def test_the_arrays_of_a_result_are_read_only_and_fit_each_other() -> None:
    robot = moving.massive("five_bar")
    drive = Constant(np.array([0.3, -0.2]), np.array([0.5, -0.4]))
    run = rp.simulate(robot, drive, duration=0.2, dt=0.02, start=closed_state(robot, sd=0.1))
    assert len(run) == len(run.t) == 11
    for name in (
        "t",
        "q",
        "v",
        "a",
        "x",
        "xd",
        "s",
        "sd",
        "sdd",
        "tau",
        "carrier_force",
        "closure_force",
        "gap",
        "energy",
    ):
        assert not getattr(run, name).flags.writeable, name
    np.testing.assert_array_equal(run.s, run.q[:, robot.carrier_position])
    np.testing.assert_array_equal(run.actuated_rate, run.v[:, robot.actuated_velocity])
    np.testing.assert_array_equal(run.tau, np.tile(drive.tau, (11, 1)))
    np.testing.assert_array_equal(run.carriers.sdd, run.a[:, robot.carrier_velocity])
    # rates are rates: central differences of second order over 20 ms, third derivatives of order 1
    np.testing.assert_allclose((run.x[2:] - run.x[:-2]) / 0.04, run.xd[1:-1], atol=3e-3)
    np.testing.assert_allclose((run.v[2:] - run.v[:-2]) / 0.04, run.a[1:-1], atol=3e-2)


def test_resampled_platform_motion_is_that_of_a_finer_run() -> None:
    robot = moving.massive("3rrr")
    drive = Constant(np.array([0.3, -0.2, 0.4]), np.zeros(3))
    coarse, fine = (rp.simulate(robot, drive, duration=0.5, dt=dt) for dt in (0.02, 0.005))
    x, xd = coarse.at(fine.t)
    # dt⁴ / 384 of a fourth derivative of order 100
    np.testing.assert_allclose(x, fine.x, atol=1e-7)
    np.testing.assert_allclose(xd, fine.xd, atol=1e-5)
    with pytest.raises(InputError, match=r"lasts from 0 to 0\.5 s"):
        coarse.at([0.6])


def test_both_explicit_integrators_give_the_same_motion() -> None:
    robot = moving.massive("3rrr")
    start = closed_state(robot, xd=[0.2, -0.3, 0.4], sd=0.2)
    run, other = (
        rp.simulate(robot, Spring(home(robot)), start=start, duration=0.25, **options)
        for options in ({}, {"integrator": "RK45", "rtol": 1e-12})
    )
    np.testing.assert_allclose(other.q, run.q, atol=SAME)
    np.testing.assert_allclose(other.closure_force, run.closure_force, atol=100 * SAME)


def test_carriers_by_motion_and_by_the_forces_this_takes_give_the_same_motion() -> None:
    robot = moving.massive("3rrr")

    class Swinging(Spring):
        def carrier_motion(self, t: float) -> tuple[Array, Array, Array]:
            w, size = 4.0, np.array([0.1, -0.2, 0.15])
            return size * np.sin(w * t), size * w * np.cos(w * t), -size * w**2 * np.sin(w * t)

    swinging = Swinging(home(robot))
    s, sd, _ = swinging.carrier_motion(0.0)
    start = closed_state(robot, xd=[0.2, -0.3, 0.4], s=s, sd=sd)
    given = rp.simulate(robot, swinging, start=start, duration=0.2, dt=0.001, carriers="motion")
    expected = np.array([swinging.carrier_motion(t)[0] for t in given.t])
    np.testing.assert_array_equal(given.s, expected)

    class Forced(Spring):
        def effort(self, t: float, state: State) -> tuple[Array, Array]:
            tau, _ = super().effort(t, state)
            return tau, np.array([np.interp(t, given.t, column) for column in given.carrier_force.T])

    forced = rp.simulate(robot, Forced(home(robot)), start=start, duration=0.2, rtol=1e-8, atol=1e-8)
    # linear interpolation of the forces over 1 ms is off by 1e-6 of them
    np.testing.assert_allclose(forced.x[-1], given.x[-1], atol=1e-6)
    np.testing.assert_allclose(forced.s[-1], given.s[-1], atol=1e-6)


def test_friction_takes_energy_and_limits_cap_efforts() -> None:
    robot = moving.massive("3rrr")
    start = closed_state(robot, xd=[0.2, -0.3, 0.4])
    run = rp.simulate(robot, start=start, duration=0.5, external=lambda state: -2.0 * state.v)
    assert (np.diff(run.energy) < 0.0).all()
    assert run.energy[-1] < 0.5 * run.energy[0]
    far = home(robot) + np.array([0.2, 0.1, 0.0])
    capped = rp.simulate(robot, Spring(far), duration=0.2, effort_limit=0.5)
    assert np.abs(capped.tau).max() == 0.5
    pushed = rp.simulate(
        robot, Constant(np.zeros(3), np.full(3, -5.0)), duration=0.1, carrier_force_limit=[0.1, 0.2, 9.0]
    )
    np.testing.assert_array_equal(pushed.carrier_force, np.tile([-0.1, -0.2, -5.0], (len(pushed), 1)))


def test_forces_of_the_carriers_actuators_are_told_without_what_else_acts_on_the_carriers() -> None:
    robot = moving.massive("3rrr")
    drive = Constant(np.zeros(3), np.array([2.0, -1.0, 0.5]))
    run = rp.simulate(robot, drive, duration=0.1, external=lambda state: -3.0 * state.v)
    np.testing.assert_array_equal(run.carrier_force, np.tile(drive.carrier_force, (len(run), 1)))
    # and driven by motion, the actuators overcome the friction
    still = closed_state(robot, sd=0.5)

    class Sliding(Constant):
        def carrier_motion(self, t: float) -> tuple[Array, Array, Array]:
            return np.full(3, 0.5 * t), np.full(3, 0.5), np.zeros(3)

    sliding = Sliding(np.zeros(3), np.zeros(3))
    free, rubbed = (
        rp.simulate(robot, sliding, start=still, duration=1e-3, carriers="motion", external=external)
        for external in (
            None,
            lambda state: np.where(np.isin(np.arange(len(state.v)), robot.carrier_velocity), -3.0 * state.v, 0.0),
        )
    )
    np.testing.assert_allclose(rubbed.carrier_force[0] - free.carrier_force[0], 1.5, rtol=1e-9)


def test_a_limit_of_forces_is_refused_where_motion_drives_the_carriers() -> None:
    robot = moving.massive("3rrr")

    class Parked(Constant):
        def carrier_motion(self, t: float) -> tuple[Array, Array, Array]:
            return np.zeros(3), np.zeros(3), np.zeros(3)

    with pytest.raises(InputError, match="carrier_force_limit"):
        rp.simulate(robot, Parked(np.zeros(3), np.zeros(3)), duration=0.01, carriers="motion", carrier_force_limit=1.0)


@pytest.mark.long
def test_turns_are_counted_between_samples_far_apart() -> None:
    robot = chain_of("continuous")
    start = closed_state(robot, [1.0], [9.0])
    fine, coarse = (rp.simulate(robot, start=start, duration=2.0, dt=dt) for dt in (0.005, 0.5))
    assert np.diff(coarse.x[:, 0]).max() > np.pi
    np.testing.assert_allclose(coarse.x, fine.x[::100], atol=SAME)


@pytest.mark.parametrize("name", ["four_bar", "continuous"])
def test_angles_run_on_past_half_a_turn(name: str) -> None:
    # the crank as a revolute joint, which counts its turns, and as a continuous one (cos, sin), which does not
    robot = chain_of(name) if name == "continuous" else zoo.robot_of(name, gravity=(0.0, 0.0, 0.0))
    run = rp.simulate(robot, start=closed_state(robot, [1.0], [9.0]), duration=1.0)
    assert run.x[-1, 0] > 2.5 * np.pi
    assert np.abs(np.diff(run.x[:, 0])).max() < 0.1
    np.testing.assert_allclose((run.x[2:] - run.x[:-2]) / 0.01, run.xd[1:-1], rtol=0.02)


class Constantly:
    """A controller that returns whatever it was given."""

    def __init__(self, answer: object) -> None:
        self.answer = answer

    def effort(self, t: float, state: State) -> object:
        return self.answer


def open_state(robot: Robot) -> State:
    q = np.array(robot.q_reference)
    q[0] += 0.01
    return tree_state(robot, q, np.zeros(robot.model.nv))


def parting_state(robot: Robot) -> State:
    v = np.zeros(robot.model.nv)
    v[0] = 0.5
    return tree_state(robot, robot.q_reference, v)


REFUSED = {
    "no duration": ({}, "how long"),
    "negative duration": ({"duration": -1.0}, "duration is -1 s"),
    "infinite duration": ({"duration": np.inf}, "duration is inf s"),
    "zero step": ({"duration": 1.0, "dt": 0.0}, "dt is 0"),
    "tolerance": ({"duration": 1.0, "rtol": 0.0}, "rtol is 0"),
    "tolerance in words": ({"duration": 1.0, "rtol": "x"}, "rtol is .x"),
    "absolute tolerance": ({"duration": 1.0, "atol": -1.0}, "atol is -1"),
    "integrator": ({"duration": 1.0, "integrator": "Euler"}, "DOP853, RK45, Radau"),
    "duration in words": ({"duration": "long"}, "duration is .long"),
    "sampling": ({"duration": 1.0, "sampling": 1e-3}, r"A Sampling was expected, not float.*Sampling\(period"),
    "max_steps": ({"duration": 1.0, "max_steps": 0}, "max_steps is 0"),
    "part of a step": ({"duration": 1.0, "max_steps": 0.5}, "max_steps is 0.5"),
    "max_step": ({"duration": 1.0, "max_step": np.nan}, "max_step is nan"),
    "a step of text": ({"duration": 1.0, "max_step": "x"}, "max_step is 'x'"),
    "a number to start from": ({"duration": 1.0, "start": 0.3}, "state to start from was expected, not float"),
    "carriers": ({"duration": 1.0, "carriers": "glued"}, "Use one of force, motion"),
    "no law": ({"duration": 1.0, "carriers": "motion"}, "carrier_motion"),
    "stop_at": ({"duration": 1.0, "stop_at": ["lunch"]}, "joint_limit"),
    "limit": ({"duration": 1.0, "effort_limit": -1.0}, "effort_limit is -1.0"),
    "limits": ({"duration": 1.0, "carrier_force_limit": [1.0, 2.0]}, "expected 3 numbers or one"),
    "drive": ({"duration": 1.0, "drive": 3.0}, "given float for the drive"),
    "one answer": ({"duration": 1.0, "drive": Constantly(np.zeros(3))}, "Constantly.effort returned"),
    "short answer": ({"duration": 1.0, "drive": Constantly((np.zeros(2), np.zeros(3)))}, r"main efforts \(3,\)"),
    "nan answer": ({"duration": 1.0, "drive": Constantly((np.full(3, np.nan), np.zeros(3)))}, "finite"),
}


def test_a_motion_is_no_drive_and_the_message_says_what_makes_one() -> None:
    robot, corner = zoo.robot_of("3rrr"), rp.trajectory.reference.corner(radius=0.025)
    for motion in (corner, corner.sample(0.1)):
        with pytest.raises(InputError, match=r"A motion has no efforts yet: pass FeedForward\(motion_reference"):
            rp.simulate(robot, motion)
    with pytest.raises(InputError, match=r"MotionReference for the drive. Pass FeedForward\(reference\)"):
        rp.simulate(robot, rp.simulation.motion_reference(robot, corner))


@pytest.mark.parametrize("case", REFUSED)
def test_bad_settings_are_refused_by_name(case: str) -> None:
    options, message = REFUSED[case]
    with pytest.raises(InputError, match=message):
        rp.simulate(zoo.robot_of("3rrr"), **options)


def test_bad_starts_are_refused_by_name() -> None:
    robot = zoo.robot_of("3rrr")
    for start, message in (
        (open_state(robot), "not closed: a gap"),
        (parting_state(robot), "opening at"),
        (closed_state(robot, s=[0.0, 1.5, 0.0]), "carrier_2 upper"),
        (closed_state(zoo.robot_of("five_bar")), r"nq = 10"),
    ):
        with pytest.raises(InputError, match=message):
            rp.simulate(robot, start=start, duration=1.0)
    with pytest.raises(InputError, match="A robot was expected, not list"):
        rp.simulate(["3rrr"], duration=1.0)  # type: ignore[arg-type]
    with pytest.raises(InputError, match=r"s is .0.1, 0.2., expected 3 numbers or one"):
        closed_state(robot, s=[0.1, 0.2])
    assert rp.simulate(robot, start=closed_state(robot, s=[0.0, 1.5, 0.0]), duration=0.01, stop_at=()).s[0, 1] == 1.5


def test_an_object_with_the_attributes_of_a_controller_is_one() -> None:
    robot = moving.massive("3rrr")

    def jolt(self: object, t: float, state: State) -> tuple[Array, Array]:
        return np.full(3, 5.0 if t < 0.02 else -5.0), np.zeros(3)

    def pushed(self: object, machine: Robot) -> State:
        return closed_state(machine, xd=[0.2, -0.3, 0.4])

    members = {"effort": jolt, "start_state": pushed, "breaks": [0.02], "end": 0.05}
    runs = [rp.simulate(robot, type("Jolt", bases, members)()) for bases in ((), (Controller,))]
    np.testing.assert_array_equal(runs[0].v, runs[1].v)
    assert [run.parameters["drive"] for run in runs] == ["Jolt", "Jolt"]
    assert [run.statistics.restarts for run in runs] == [2, 2]
    assert runs[0].statistics.steps < 10  # the last stage before a jump does not see the efforts after it
    assert runs[0].t[-1] == 0.05


def test_wrong_words_are_refused_before_a_plan_is_read() -> None:
    class Slow(Controller):
        def effort(self, t: float, state: State) -> tuple[Array, Array]:
            return np.zeros(3), np.zeros(3)

        def start_state(self, robot: Robot) -> State:
            raise AssertionError("asked for its start")

    wrong = {
        "carriers": "glued",
        "duration": -1.0,
        "dt": 0.0,
        "stop_at": ("lunch",),
        "joint_stops": "rubber",
        "restart_at": "noon",
        "effort_limit": -1.0,
        "carrier_force_limit": -1.0,
        "integrator": "Euler",
    }
    for name, value in wrong.items():
        with pytest.raises(InputError, match=name):
            rp.simulate(zoo.robot_of("3rrr"), Slow(), **{"duration": 1.0, name: value})  # type: ignore[arg-type]


def test_a_plan_anew_for_the_robot_with_mass_is_what_a_massless_one_needs() -> None:
    """The 2-RPR across the line of its legs, where nothing of a massless one has inertia along them."""
    path = rp.trajectory.Line((0.17, 0.06), (0.2, -0.06))
    motion = rp.trajectory.Trajectory(path, rp.trajectory.RestToRest(path.length, duration=1.0))

    def controlled(**masses: float) -> Simulation:
        robot = rp.load_robot("2rpr", **masses)
        controller = TimeVaryingLqr(rp.plan_whole_trajectory(robot, motion, mesh=rp.Mesh(dt=0.04)), motion=motion)
        return rp.simulate(robot, controller, rtol=1e-7, atol=1e-8)

    with pytest.raises(IllPosedModelError, match=r"mass=0\.1\), or --set .*, and make plans and controllers anew"):
        controlled()
    run = controlled(end_effector_mass=0.1)
    assert (run.status, run.t[-1]) == (ResultStatus.OK, 1.0)
    np.testing.assert_allclose(run.x[-1], (0.2, -0.06), atol=1e-5)
    np.testing.assert_allclose(run.x @ (0.12, 0.03), 0.17 * 0.12 + 0.06 * 0.03, atol=1e-6)  # on its line
    assert run.x[0, 1] > 0.0 > run.x[-1, 1]


def test_an_ill_posed_start_is_an_error_and_an_ill_posed_pose_on_the_way_a_failure() -> None:
    robot = zoo.robot_of("2rpr")
    with pytest.raises(IllPosedModelError, match="end_effector_mass"):
        rp.simulate(robot, duration=1.0)  # carriers at s = 0: their legs have inertia about one axis only
    # a carrier on its way through s = 0
    start = closed_state(robot, [0.25, 0.4], [0.2, -0.1], s=[0.1, 0.15], sd=[0.3, -0.6])
    run = rp.simulate(robot, start=start, duration=1.0, stop_at=())
    assert run.status is ResultStatus.NOT_CONVERGED
    assert "inertia" in run.reason
    assert "end_effector_mass" in run.reason
    assert 0.1 < run.t[-1] < 0.5
    assert np.isfinite(run.x).all()
    assert abs(run.s[-1, 1]) < 1e-3
    assert run.statistics.steps < 2000


def test_a_controller_that_blows_up_is_a_failure_with_its_reason() -> None:
    robot = moving.massive("five_bar")

    class Explosive:
        def effort(self, t: float, state: State) -> tuple[Array, Array]:
            return 1e3 * np.exp(np.minimum(40.0 * np.abs(state.xd), 300.0)), np.zeros(2)

    run = rp.simulate(robot, Explosive(), duration=1.0, stop_at=())
    assert run.status is ResultStatus.NOT_CONVERGED
    assert run.reason.startswith("At t = ")
    assert "controller" in run.reason or "step" in run.reason
    few = rp.simulate(robot, Constant(np.ones(2), np.zeros(2)), duration=1.0, max_steps=2, max_step=0.01)
    assert few.status is ResultStatus.NOT_CONVERGED
    assert "2 steps did not reach the end" in few.reason
    assert few.t[-1] <= 0.02


@pytest.mark.parametrize("driven", [True, False])
def test_what_runs_away_is_named_and_a_controller_is_blamed_only_where_there_is_one(driven: bool) -> None:
    """Efforts, or external forces, that grow with the third power of the speed: infinite in finite time."""
    robot = rp.load_robot("four_bar")

    class Cubic:
        def effort(self, t: float, state: State) -> tuple[Array, Array]:
            return 50.0 * state.xd**3, np.zeros(0)

    if driven:
        run = rp.simulate(robot, Cubic(), duration=1.0)
    else:
        run = rp.simulate(robot, duration=1.0, external=lambda state: 50.0 * state.v**3)
    assert run.status is ResultStatus.NOT_CONVERGED
    assert "joint 'crank' runs away at -18" in run.reason
    assert "ratio of singular values 0.41" in run.reason
    assert ("controller" in run.reason) is driven
    assert ("no actuator gives any effort" in run.reason) is not driven


def test_external_forces_that_are_no_numbers_from_a_time_on_end_the_simulation_there() -> None:
    robot, last = rp.load_robot("four_bar"), 0.05

    class Idle(Constant):
        breaks = np.array([last])

    def broken(state: State) -> Array:
        return np.full(len(state.v), np.nan if state.t > last else 0.0)

    run = rp.simulate(robot, Idle(np.zeros(1), np.zeros(0)), duration=0.2, external=broken)
    assert run.status is ResultStatus.NOT_CONVERGED
    assert run.reason.startswith("At t = 0.05 s no step is short enough")
    assert run.t[-1] == last
    assert np.isfinite(run.q).all()


class From:
    """Efforts that a spring gives, and from a time on something else."""

    def __init__(self, start: float, answer: object) -> None:
        self.start, self.answer = start, answer

    def effort(self, t: float, state: State) -> object:
        return (-0.5 * state.actuated_rate, np.zeros(2)) if t < self.start else self.answer


@pytest.mark.parametrize(
    "answer",
    [
        (np.array([1.0, np.nan]), np.zeros(2)),
        (np.zeros(2), np.array([0.0, -np.inf])),
        pytest.param((np.array([np.inf, -np.inf]), np.zeros(2)), marks=pytest.mark.long),
        pytest.param((np.zeros(3), np.zeros(2)), marks=pytest.mark.long),
        (np.zeros((2, 1)), np.zeros(2)),
        (np.zeros(2), 0.0),
        pytest.param(np.zeros(4), marks=pytest.mark.long),
        None,
        ("many", "few"),
    ],
    ids=str,
)
@pytest.mark.parametrize("sampling", [None, Sampling(0.01)])
def test_efforts_are_checked_whenever_they_are_asked_for(answer: object, sampling: Sampling | None) -> None:
    """Also where the amplifiers would clip an infinity; the time is that from which on the controller goes wrong."""
    robot = moving.massive("five_bar")
    with pytest.raises(InputError, match=r"From\.effort returned .* at t = 0\.07.*main efforts \(2,\)") as caught:
        rp.simulate(
            robot, From(0.07, answer), duration=0.2, sampling=sampling, effort_limit=5.0, carrier_force_limit=5.0
        )
    assert caught.value.details["time"] == pytest.approx(0.07, abs=1e-9)


def test_a_controller_without_an_answer_to_a_trial_step_alone_does_no_harm() -> None:
    """As a square root that is real along the motion: the integrator tries a shorter step."""
    robot = moving.massive("five_bar")

    class Real(Constant):
        misses = 0

        def effort(self, t: float, state: State) -> tuple[Array, Array]:
            if calls and 0.02 < t < 0.05 and len(calls) < 3:
                calls.append(t)
                return np.full(2, np.nan), np.zeros(2)
            return super().effort(t, state)

    calls = [0.0]
    drive = Real(np.array([0.3, -0.2]), np.zeros(2))
    run = rp.simulate(robot, drive, duration=0.1)
    assert len(calls) == 3
    constant = rp.simulate(robot, Constant(drive.tau, drive.carrier_force), duration=0.1)
    assert run.status is ResultStatus.OK
    np.testing.assert_allclose(run.q, constant.q, atol=SAME)


def test_it_tells_how_far_it_is() -> None:
    """With generated code and without: times that never fall, to the end."""
    robot = rp.load_robot("five_bar", carriers=True)
    for dynamics in (None, rp.CompiledDynamics(robot)):
        told: list[tuple[float, ...]] = []
        run = rp.simulate(
            robot, duration=0.3, dynamics=dynamics, progress=lambda t, end, told=told: told.append((t, end))
        )
        times = np.array(told)
        assert run.status.value == "ok"
        assert (np.diff(times[:, 0]) >= 0.0).all()
        assert times[-1, 0] == pytest.approx(0.3)
        assert (times[:, 1] == times[-1, 0]).all()


def test_generated_code_reports_during_a_long_stretch_of_steps() -> None:
    """One interval without events, 3,000 steps: reports at least every 1,000."""
    robot = rp.load_robot("five_bar", carriers=True)
    told: list[float] = []
    drive = Constant(np.full(2, 1e-3), np.zeros(2))
    run = rp.simulate(
        robot, drive, duration=0.3, max_step=1e-4, dt=0.1, dynamics=robot, progress=lambda t, end: told.append(t)
    )
    assert run.statistics.steps >= 3000
    assert np.diff([0.0, *told]).max() < 0.11


@dataclass
class Swinging:
    """Both carriers along A sin ωt, the motors off."""

    amplitude: float
    rate: float

    def effort(self, t: float, state: State) -> tuple[Array, Array]:
        return np.zeros(state.robot.m), np.zeros(state.robot.k)

    def carrier_motion(self, t: float) -> tuple[Array, Array, Array]:
        sine, cosine = np.sin(self.rate * t), np.cos(self.rate * t)
        parts = (sine, self.rate * cosine, -(self.rate**2) * sine)
        first, second, third = (np.full(2, self.amplitude * part) for part in parts)
        return first, second, third


@pytest.mark.parametrize(("speed", "acceleration"), [(0.49, 2.4), (0.51, 2.4), (0.49, 2.6)])
def test_a_run_that_exceeds_a_limit_of_a_carrier_says_which_by_how_much_and_when(
    speed: float, acceleration: float
) -> None:
    """By hand: A sin ωt of speed Aω = 0.5 m/s at its start and acceleration Aω² = 2.5 m/s² after a quarter."""
    robot = moving.massive("2rpr")
    limited = [
        replace(one, speed=0.5 * 0.5 / speed, acceleration=2.5 * 2.5 / acceleration) for one in robot.carrier_limits
    ]
    machine = replace(robot, carrier_limits=tuple(limited))
    start = closed_state(machine, sd=0.5)
    quarter = 0.1 * np.pi
    run = rp.simulate(machine, Swinging(0.1, 5.0), start=start, duration=quarter, dt=quarter / 8, carriers="motion")
    worst = {(event.quantity, event.worst) for event in run.violated}
    assert {event.joint for event in run.violated} in (set(), set(machine.carriers))
    if speed > 0.5:
        assert worst == {("speed", 0.0)}
        assert run.violated[0].amount == pytest.approx(0.5 - 0.25 / speed)
    elif acceleration > 2.5:
        assert worst == {("acceleration", run.t[-1])}
    ok = max(speed / 0.5, acceleration / 2.5) < 1.0
    assert run.status is (ResultStatus.OK if ok else ResultStatus.LIMIT_VIOLATED)
    summary = run.summary()
    assert summary["limits"]["violated"] == [vars(event) for event in run.violated]
    assert [text.startswith("limits broken: ") for text in summary.warnings] == [True] * (not ok)


def test_efforts_and_ranges_beyond_the_robots_own_are_said() -> None:
    """Motors of 5 and 3 N, the first declared for 4 N; a base hinge that swings out of its range."""
    robot = moving.massive("2rpr")
    hinge = next(name for name in list(robot.model.names)[1:] if name not in (*robot.actuated, *robot.carriers))
    at = float(robot.q_reference[zoo.index(robot, hinge)])
    limits = {robot.actuated[0]: {"effort": 4.0}, hinge: {"lower": at - 1e-3, "upper": at + 1e-3}}
    limited = rp.with_limits(robot, limits)
    run = rp.simulate(limited, Constant(np.array([5.0, 3.0]), np.zeros(robot.k)), duration=0.3, dt=0.01, stop_at=())
    worst = {(event.joint, event.quantity): event for event in run.violated}
    assert worst[robot.actuated[0], "effort"].amount == pytest.approx(1.0)
    assert (robot.actuated[1], "effort") not in worst
    angle = run.q[:, zoo.index(robot, hinge)] - at
    assert worst[hinge, "range"].amount == pytest.approx(np.abs(angle).max() - 1e-3)
    assert run.status is ResultStatus.LIMIT_VIOLATED
