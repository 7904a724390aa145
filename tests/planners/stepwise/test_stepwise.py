"""The stepwise planner against solvers and dynamics that are not its own."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest
import zoo
from examples import examples
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import lsq_linear, minimize

from redundancy_pin import (
    CarrierMotion,
    CompiledDynamics,
    RneaDynamics,
    VirtualWork,
    distribute,
    load_robot,
    plan_stepwise,
)
from redundancy_pin.kinematics.coordinates import all_working_modes
from redundancy_pin.planners.intersample_check import ALLOWED
from redundancy_pin.planners.options import Limits, Mesh, Objective
from redundancy_pin.status import ResultStatus
from redundancy_pin.trajectory import Line, RestToRest, Trajectory, reference

# scipy of Python 3.10 rounds out of its own bounds on the way, says so, and steps back inside
pytestmark = pytest.mark.filterwarnings("ignore:Values in x were outside bounds:RuntimeWarning")

MODES = all_working_modes(zoo.robot_of("3rrr"))

VALUE = 1e-8
"""Relative, of the sum of squares of a step."""

PLACE = 1e-7
"""m, of a carrier after one step."""

TORQUE_FREE = 3e-8
"""N·m: the steps are solved to 1e-9 of the largest effort, up to 30 N·m."""

LIMIT = 1e-9
"""Relative excess over a limit that is rounding."""

BETWEEN = 1e-2
"""Relative, of the largest effort inside the steps, which is sampled here."""


@functools.cache
def dynamics_of(mode=(1, 1, 1), *, carriers=True, backend=VirtualWork, **arguments):
    return backend(load_robot("3rrr", working_mode=mode, carriers=carriers, **arguments))


def corner(dt=0.01, **settings):
    return reference.corner(**settings).sample(dt, two_sided=False)


def steps_of(plan, phase="optimise"):
    """Samples at the ends of steps of a phase, two-sided duplicates left out."""
    at = np.flatnonzero((plan.phase == plan.phases.index(phase)) & ~np.asarray(plan.motion.jumps))
    return at[at > 0]


def box_of(plan, j, limits):
    """The three limits of a step as bounds of the position at its end (eqs. 4.2 to 4.4), and h, s, ṡ before."""
    h = plan.t[j] - plan.t[j - 1]
    s, sd = plan.carriers.s[j - 1], plan.carriers.sd[j - 1]
    lower, upper, speed, acceleration = np.array([(b.lower, b.upper, b.speed, b.acceleration) for b in limits]).T
    low = np.max([lower, s - speed * h, s + sd * h - acceleration * h**2], axis=0)
    high = np.min([upper, s + speed * h, s + sd * h + acceleration * h**2], axis=0)
    return h, s, sd, low, high


def efforts_by_position(dynamics, motion, j, h, s, sd):
    """τ as a function of the position at the end of a step, from the backend alone."""
    along = dynamics.along(motion[j : j + 1])

    def tau(place):
        rate = (place - s) / h
        return distribute(along.reduce(CarrierMotion(place[None], rate[None], ((rate - sd) / h)[None]))).tau[0]

    return tau


def require_true_minimum(plan, dynamics, motion, limits, target, at):
    """Repeat single steps of a plan by other solvers on the efforts of a backend."""
    for j in at:
        h, s, sd, low, high = box_of(plan, j, limits)
        tau = efforts_by_position(dynamics, motion, j, h, s, sd)
        unit = 7.0 * h * h  # m in a step at 7 m/s²: makes the problem one of order one
        a, b = (low - s - h * sd) / unit, (high - s - h * sd) / unit

        def residual(x, tau=tau, s=s, sd=sd, h=h, unit=unit, j=j):
            return tau(s + h * sd + unit * x) - target[j]

        # exact for a quadratic without mixed terms; that it is one is checked at another point
        base = residual(np.zeros(len(s)))
        ahead, back = (np.column_stack([residual(sign * e) - base for e in np.eye(len(s))]) for sign in (1.0, -1.0))
        J, C = 0.5 * (ahead - back), 0.5 * (ahead + back)
        probe = np.linspace(-0.7, 0.8, len(s))
        np.testing.assert_allclose(base + J @ probe + C @ probe**2, residual(probe), atol=1e-10)

        def cost(x, base=base, J=J, C=C):
            r = base + J @ x + C @ (x * x)
            return r @ r, 2.0 * r @ (J + 2.0 * C * x)

        def value(place, residual=residual, s=s, sd=sd, h=h, unit=unit):
            return float(np.sum(residual((place - s - h * sd) / unit) ** 2))

        affine = lsq_linear(J, -base, (a - 1e-12, b + 1e-12), method="bvls", tol=1e-15).x
        places = [affine]
        for start in (a, b, affine):
            bounds = list(zip(a, b, strict=True))
            places.append(minimize(cost, start, jac=True, bounds=bounds, method="SLSQP", tol=1e-15).x)
        others = [s + h * sd + unit * np.clip(x, a, b) for x in places]
        best = min(value(place) for place in others)
        assert value(plan.carriers.s[j]) <= best + VALUE * best + TORQUE_FREE**2, j
        nearest = min(others, key=value)
        np.testing.assert_allclose(plan.carriers.s[j], nearest, atol=PLACE, rtol=0)


@pytest.mark.long_for("0.5-0.025")
@pytest.mark.parametrize(("lam", "radius"), [(0.5, 0.025), (1.0, 0.013)])
def test_each_step_is_the_true_minimum(lam, radius):
    dynamics = dynamics_of(backend=RneaDynamics)  # the plan from one backend, the check from the other
    motion = corner(radius=radius)
    baseline = distribute(dynamics_of(carriers=False).reduce(motion)).tau
    # long tracks: on the thesis's own one of the carriers cannot be stopped in one of these cases (see the errors)
    plan = plan_stepwise(
        dynamics,
        motion,
        objective=Objective(lam=lam, baseline=baseline),
        anticipate=False,
        limits=Limits(track=(-1.5, 1.5)),
    )
    limits = [replace(limit, lower=-1.5, upper=1.5) for limit in dynamics.robot.carrier_limits]
    require_true_minimum(plan, dynamics_of(), motion, limits, lam * baseline, steps_of(plan)[::10])


def test_steps_of_fast_carriers_far_out_are_true_minima():
    """Where the terms with s² and s ṡ matter, and a carrier at its speed limit leaves efforts to be traded."""
    dynamics, speed, a = dynamics_of(), (0.3, 2.0, 2.0), 20.0
    motion = corner(0.02, radius=0.06, speed=0.5, ramp_time=0.2)
    plan = plan_stepwise(
        dynamics,
        motion,
        anticipate=False,
        limits=Limits(track=(-1.5, 1.5), speed=speed, acceleration=a),
        start=(0.3, -0.3, 0.3),
    )
    own = zip(dynamics.robot.carrier_limits, speed, strict=True)
    limits = [replace(limit, lower=-1.5, upper=1.5, speed=most, acceleration=a) for limit, most in own]
    assert "speed" in {event["bound"] for event in plan.diagnostics["bounds"]}
    require_true_minimum(plan, dynamics, motion, limits, np.zeros_like(plan.tau), steps_of(plan)[::4])


def test_a_step_in_which_no_carrier_has_an_effect_is_a_minimum(tmp_path):
    """A mass that slides along a hinged rod has none while the rod rests, as at the end of the motion."""
    inertia = '<inertia ixx="1e-3" iyy="1e-3" izz="1e-3" ixy="0" ixz="0" iyz="0"/>'
    (tmp_path / "arm.urdf").write_text(
        f"""<robot name="arm"><link name="world"/>
        <link name="rod"><inertial><origin xyz="0.25 0 0"/><mass value="1"/>{inertia}</inertial></link>
        <link name="block"><inertial><mass value="0.5"/>{inertia}</inertial></link>
        <joint name="hinge" type="revolute"><parent link="world"/><child link="rod"/><axis xyz="0 0 1"/>
        <limit lower="-7" upper="7" effort="100" velocity="100"/></joint>
        <joint name="slide" type="prismatic"><parent link="rod"/><child link="block"/><origin xyz="0.3 0 0"/>
        <axis xyz="1 0 0"/><limit lower="-0.2" upper="0.2" effort="100" velocity="3"/></joint></robot>"""
    )
    (tmp_path / "robot.yaml").write_text(
        "name: arm\nurdf: arm.urdf\ngravity: [0, 0, 0]\nactuated: [hinge]\n"
        "carriers: [{joint: slide, acceleration: 20}]\nindependent: {joints: [hinge]}\n"
    )
    robot, path = load_robot(tmp_path), Line((0.0,), (1.0,))
    plan = plan_stepwise(RneaDynamics(robot), Trajectory(path, RestToRest(path.length, 1.0)), mesh=Mesh(dt=0.02))
    assert plan.status is ResultStatus.OK
    assert plan.findings.optimal
    require_limits(plan, robot.carrier_limits)


@examples(3)
@given(
    lam=st.floats(0.0, 1.0),
    mode=st.sampled_from(MODES),
    mass=st.floats(0.5, 6.0),
    radius=st.floats(0.012, 0.06),
    speed=st.floats(0.1, 0.3),
    dt=st.sampled_from([0.02, 0.01, 0.005]),
)
def test_random_plans_are_minimal_within_limits_and_end_at_rest(lam, mode, mass, radius, speed, dt):
    dynamics = dynamics_of(mode, carrier_mass=mass)
    motion = corner(dt, radius=radius, speed=speed)
    baseline = distribute(dynamics_of(mode, carriers=False).reduce(motion)).tau
    plan = plan_stepwise(dynamics, motion, objective=Objective(lam=lam, baseline=baseline))
    limits = dynamics.robot.carrier_limits
    require_limits(plan, limits)
    # between single samples, the step into a jump of ẍ has the efforts of the jump, which no sample need show
    at_samples = np.abs(plan.tau).max(axis=0)
    grown = largest_inside_steps(plan, CompiledDynamics(dynamics.robot)) - at_samples
    ratio = 1.0 + max(float(grown.max()), 0.0) / at_samples.max()
    assert plan.status in (ResultStatus.OK, ResultStatus.UNRESOLVED)
    assert plan.between.ratio >= ratio * (1.0 - BETWEEN)
    assert plan.status is ResultStatus.UNRESOLVED or ratio <= ALLOWED * (1.0 + BETWEEN)
    assert plan.status is ResultStatus.OK or ratio > ALLOWED * (1.0 - BETWEEN)
    assert (plan.carriers.sd[-1] == 0.0).all()
    assert plan.findings.optimal
    assert plan.diagnostics["largest_gradient"] < 1e-6
    narrowed = {event["joint"] for event in plan.diagnostics["bounds"] if event["bound"] == "stop"}
    if not narrowed:
        require_true_minimum(plan, dynamics, motion, limits, lam * baseline, steps_of(plan)[7::80])


def largest_inside_steps(plan, dynamics):
    """(m,) The largest effort of each actuator at times inside the steps, their ends almost included."""
    inside = np.concatenate([[1e-6, 1.0 - 1e-6], np.linspace(0.05, 0.95, 19)])
    t = np.unique(plan.t)
    times = np.unique(t[:-1, None] + np.diff(t)[:, None] * inside)
    return np.abs(plan.efforts_at(times, dynamics)).max(axis=0)


def require_limits(plan, limits):
    """Track, speed and acceleration at every sample, and that ṡ, s̈ are the backward differences of s, ṡ."""
    s, sd, sdd = (np.asarray(part) for part in (plan.carriers.s, plan.carriers.sd, plan.carriers.sdd))
    lower, upper, speed, acceleration = np.array([(b.lower, b.upper, b.speed, b.acceleration) for b in limits]).T
    assert (s >= lower - LIMIT).all()
    assert (s <= upper + LIMIT).all()
    assert (np.abs(sd) <= speed * (1.0 + LIMIT)).all()
    assert (np.abs(sdd) <= acceleration * (1.0 + LIMIT)).all()
    stepped = np.concatenate([steps_of(plan), steps_of(plan, "brake")])
    h = (plan.t[stepped] - plan.t[stepped - 1])[:, None]
    np.testing.assert_allclose(s[stepped], s[stepped - 1] + h * sd[stepped], atol=1e-14)
    np.testing.assert_allclose(sd[stepped], sd[stepped - 1] + h * sdd[stepped], atol=1e-13)


@pytest.mark.long_for(*(f"mode{i}" for i in range(1, 7)))
@pytest.mark.parametrize("mode", MODES)
def test_no_torque_until_a_limit_binds(mode):
    dynamics = dynamics_of(mode)
    plan = plan_stepwise(dynamics, corner(), objective=Objective(lam=0.0))
    first = min((event["start"] for event in plan.diagnostics["bounds"]), default=np.inf)
    free = steps_of(plan)
    free = free[plan.t[free] < first - 1e-9]
    assert len(free) > 10
    assert np.abs(plan.tau[free]).max() < TORQUE_FREE
    bound = steps_of(plan)[plan.t[steps_of(plan)] >= first]
    if len(bound):
        assert np.abs(plan.tau[bound]).max() > 1e-3


def test_a_fraction_of_the_baseline_is_met_until_a_limit_binds():
    motion = corner()
    base = dynamics_of(carriers=False)
    baseline = distribute(base.reduce(motion)).tau
    plan = plan_stepwise(dynamics_of(), motion, objective=Objective(lam=0.5, baseline=base))
    first = min(event["start"] for event in plan.diagnostics["bounds"])
    free = steps_of(plan)
    free = free[plan.t[free] < first - 1e-9]
    np.testing.assert_allclose(plan.tau[free], 0.5 * baseline[free], atol=TORQUE_FREE, rtol=0)


# --- which bound is met ----------------------------------------------------------------------------------------------


def events_of(plan):
    """Each event with its carrier's number, sign of the side, and the samples at the ends of its steps."""
    optimised = steps_of(plan)
    for event in plan.diagnostics["bounds"]:
        during = optimised[(plan.t[optimised] >= event["start"]) & (plan.t[optimised] <= event["end"])]
        yield event["bound"], int(event["joint"][-1]) - 1, 1.0 if event["side"] == "upper" else -1.0, during


@pytest.mark.parametrize("radius", [0.013, 0.025])
def test_a_bound_is_named_by_what_binds(radius):
    """Closed forms of every bound: the speed, the acceleration, the end of the track, or h v + v²/(2a) = distance.

    The last is the largest speed from which a carrier can still stop; a faster one is braked by a.
    """
    track, speed, a = (-0.03, 0.05), 0.3, 3.0
    motion = reference.corner(radius=radius).sample(0.01)
    plan = plan_stepwise(dynamics_of(), motion, limits=Limits(track=track, speed=speed, acceleration=a))
    kinds = set()
    for bound, j, sign, during in events_of(plan):
        s, sd, sdd = (sign * getattr(plan.carriers, part)[during, j] for part in ("s", "sd", "sdd"))
        end = max(sign * np.array(track))
        h = plan.t[during] - plan.t[during - 1]
        distance = end - (s - h * sd)
        reached = {
            "speed": np.abs(sd - speed) < LIMIT,
            "acceleration": np.abs(sdd - a) < LIMIT,
            "track": np.abs(s - end) < LIMIT * 0.08,  # of its length
            "stop": np.abs(h * sd + sd**2 / (2.0 * a) - distance) < LIMIT,
        }
        assert (reached[bound] | ((bound == "stop") & (np.abs(sdd + a) < LIMIT))).all(), bound
        if bound == "stop":
            assert not (reached["speed"] | reached["acceleration"] | reached["track"]).any()
        kinds.add((bound, sign))
    assert {("speed", 1.0), ("speed", -1.0), ("acceleration", 1.0), ("stop", 1.0), ("stop", -1.0)} <= kinds


def test_every_step_can_still_stop_before_the_end_of_its_track():
    """Where it ends, braking by a in steps of any length stays on the track: s + v²/(2a) within the ends."""
    lower, upper, a = -0.03, 0.05, 3.0
    motion = reference.corner(radius=0.013)
    times = np.concatenate([[0.0], np.cumsum(np.resize([0.004, 0.017, 0.009], 200))])
    times = np.append(times[times < motion.duration], motion.duration)
    plan = plan_stepwise(dynamics_of(), motion.sample(times=times), limits=Limits(track=(lower, upper), acceleration=a))
    s, sd = plan.carriers.s, plan.carriers.sd
    braking = sd * np.abs(sd) / (2.0 * a)
    assert (s + braking).max() <= upper + LIMIT
    assert (s + braking).min() >= lower - LIMIT
    assert (s + braking).max() > upper - 1e-6  # it uses the track
    require_limits(
        plan, [replace(one, lower=lower, upper=upper, acceleration=a) for one in plan.limits.judged_by.of_carriers]
    )


def test_without_limits_nothing_binds_and_no_torque_is_left():
    plan = plan_stepwise(
        dynamics_of(), corner(), limits=Limits(track=(-np.inf, np.inf), speed=np.inf, acceleration=np.inf)
    )
    assert plan.diagnostics["bounds"] == ()
    assert np.abs(plan.tau[steps_of(plan)]).max() < TORQUE_FREE


def test_steps_that_do_not_reach_their_minimum_are_a_status():
    """Steps of 0.2 s towards 100 N·m: carriers hundreds of metres out, where efforts are no longer nearly affine."""
    motion = reference.corner().sample(times=np.linspace(0.0, reference.corner().duration, 10), two_sided=False)
    plan = plan_stepwise(
        dynamics_of(),
        motion,
        objective=Objective(lam=1.0, baseline=np.full((10, 3), 100.0)),
        limits=Limits(track=(-np.inf, np.inf), speed=np.inf, acceleration=np.inf),
    )
    assert plan.findings.optimal is False
    assert plan.diagnostics["largest_gradient"] > 1.0
    assert plan.status is not ResultStatus.OK
    assert np.isfinite(plan.carriers.s).all()


def test_the_thesis_corner_in_its_mode():
    """Mode (+,+,+), r = 0.025, 5 ms: carrier 2 meets its speed, then its acceleration limit (Parsa 2014, fig. 4.9)."""
    plan = plan_stepwise(dynamics_of(), corner(0.005))
    bounds = {(event["joint"], event["bound"]) for event in plan.diagnostics["bounds"]}
    assert bounds == {("carrier_2", "speed"), ("carrier_2", "acceleration")}
    assert not plan.limits.violated
    assert plan.status is ResultStatus.UNRESOLVED  # single samples
    both = plan_stepwise(dynamics_of(), reference.corner(), mesh=Mesh(dt=0.005))
    assert both.status is ResultStatus.OK
