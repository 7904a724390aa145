"""What every backend promises: shapes, marks, refusals, ranges of joints; and the backend that a robot gets."""

from __future__ import annotations

import functools
import json
import warnings
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zoo
from click.testing import CliRunner
from machines import machine

import redundancy_pin as rp
from redundancy_pin.arrays import Array
from redundancy_pin.cli import main
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.dynamics.default import as_dynamics
from redundancy_pin.dynamics.results import ReducedDynamics
from redundancy_pin.errors import (
    CarrierLimitError,
    CompilerError,
    InputError,
    ModelFileError,
    SingularPoseError,
    UnreachablePoseError,
)
from redundancy_pin.planners.optimal.co_design import DesignTask
from redundancy_pin.planners.plan import Plan
from redundancy_pin.simulation import motion_reference
from redundancy_pin.simulation.controllers import controller_by_name
from redundancy_pin.status import ResultStatus, SampleStatus
from redundancy_pin.trajectory import reference

BACKENDS = [rp.RneaDynamics, rp.VirtualWork, rp.CompiledDynamics]
EVERY = pytest.mark.parametrize("backend", BACKENDS)
WITH_LOOPS = pytest.mark.parametrize("backend", [rp.RneaDynamics, rp.CompiledDynamics])
Backend = Callable[[rp.Robot], Dynamics]


def motion_of(robot: rp.Robot, samples: int = 5, seed: int = 11) -> tuple[rp.PlatformMotion, rp.CarrierMotion]:
    t = np.linspace(0.0, 1.0, samples)
    return zoo.smooth_motion(robot, seed).at(t), zoo.carriers_at(robot, t, seed)


def still_at(*x: Array) -> rp.PlatformMotion:
    rest = np.zeros((len(x), np.size(x[0])))
    return rp.PlatformMotion(np.arange(float(len(x))), np.array(x), rest, rest, check_rates=False)


# --- what every backend returns

RETURNED = [(rp.RneaDynamics, name) for name in zoo.SHIPPED]
RETURNED += [(backend, name) for backend in BACKENDS[1:] for name in ("2rpr", "3rrr")]


@pytest.mark.parametrize(("backend", "name"), RETURNED)
def test_results_are_read_only_and_of_the_stated_shapes(backend: Backend, name: str) -> None:
    robot, N = machine(name), 5
    n, m, k, L = robot.n, robot.m, robot.k, robot.characteristic_length
    motion, carriers = motion_of(robot)
    along = backend(robot).along(motion)
    assert along.robot is robot
    assert along.motion is motion
    reduced = along.reduce(carriers)
    shapes = {"t": (N,), "f": (N, n), "W": (N, n, m), "carrier_force": (N, k), "reachable": (N,), "residual": (N,)}
    shapes |= {"row_scale": (n,), "column_scale": (m,), "out_of_range": (N,), "force_size": (N,)}
    results = {field.name: getattr(reduced, field.name) for field in fields(reduced)}
    assert {part: array.shape for part, array in results.items()} == shapes
    derivatives = along.carrier_derivatives(carriers)
    for part in derivatives.__dataclass_fields__:
        results[part] = getattr(derivatives, part)
        assert results[part].shape == ((N, n, k) if part.startswith("f_") else (N, k, k))
    results |= {"wrench": along.base_wrench(carriers), "energy": along.energy(carriers)}
    assert (results["wrench"].shape, results["energy"].shape) == ((N, 6), (N,))
    for array in results.values():
        assert not array.flags.writeable
    assert isinstance(replace(reduced, f=reduced.f * 2), ReducedDynamics)
    if name in ("2rpr", "3rrr"):  # moments and torques count as forces at the characteristic length
        rows, columns = ([1, 1], [1, 1]) if name == "2rpr" else ([1, 1, L], [L, L, L])
        np.testing.assert_array_equal(reduced.row_scale, rows)
        np.testing.assert_array_equal(reduced.column_scale, columns)


# --- what every backend refuses


@EVERY
def test_motions_and_carriers_that_do_not_fit_are_refused(backend: Backend) -> None:
    robot = zoo.robot_of("3rrr")
    dynamics, (motion, _) = backend(robot), motion_of(robot)
    wrong = rp.PlatformMotion(motion.t, *np.zeros((3, 5, 4)))
    poses = rp.PlatformMotion(motion.t, np.tile(np.eye(4), (5, 1, 1)), *np.zeros((2, 5, 3)))
    for bad in (wrong, poses):
        with pytest.raises(InputError, match=r"3rrr moves in 3 \(x, y, rz\)") as caught:
            dynamics.along(bad)
        assert "xd, xdd as (N, 3)" in caught.value.remedy
    with pytest.raises(InputError, match="unreachable is 'ignore'"):
        dynamics.reduce(motion, unreachable="ignore")  # type: ignore[arg-type]
    for samples, count in ((4, 3), (5, 2), (5, 0)):
        carriers = rp.CarrierMotion.parked(samples, count)
        for call in (dynamics.reduce, lambda *given: rp.inverse_dynamics(dynamics, *given)):
            with pytest.raises(InputError, match=r"expected \(5, 3\)"):
                call(motion, carriers)
        with pytest.raises(InputError, match="carrier motion"):
            dynamics.along(motion).energy(carriers)


@EVERY
def test_a_carrier_off_its_track_is_named_unless_the_check_is_off(backend: Backend) -> None:
    robot = zoo.robot_of("3rrr")
    dynamics, (motion, _) = backend(robot), motion_of(robot)
    s = np.zeros((5, 3))
    s[3, 1] = 1.25
    carriers = rp.CarrierMotion(s, np.zeros((5, 3)), np.zeros((5, 3)))
    message = r"'carrier_2' leaves its track \[-1, 1\] m by 0.25 m at sample 3"
    with pytest.raises(CarrierLimitError, match=message) as caught:
        dynamics.reduce(motion, carriers)
    assert (caught.value.details["carrier"], caught.value.details["sample"]) == ("carrier_2", 3)
    assert caught.value.details["amount"] == pytest.approx(0.25)
    assert np.isfinite(dynamics.reduce(motion, carriers, check_track=False).f).all()


# --- out of reach, singular, another mode


def line(first: list[float], last: list[float], samples: int = 30) -> rp.PlatformMotion:
    t = np.linspace(0.0, 1.0, samples)
    a, b = np.array(first), np.array(last)
    x = a + t[:, None] * (b - a)
    return rp.PlatformMotion(t, x, np.repeat((b - a)[None], samples, axis=0), np.zeros_like(x))


LEAVING = {
    "out of the workspace": ("3rrr", line([0.9, 0.5, 0.0], [2.9, 0.5, 0.0]), UnreachablePoseError),
    "begins out of it": ("3rrr", line([9.0, 0.5, 0.0], [9.1, 0.5, 0.0]), UnreachablePoseError),
    "through a stretched leg of no length": ("2rpr", line([0.25, 0.3], [0.0, 0.0], 11), SingularPoseError),
    "five-bar stretched": ("five_bar", line([0.0, 0.5], [0.0, 5.0]), UnreachablePoseError),
}


@pytest.mark.parametrize("what", LEAVING)
def test_a_motion_that_cannot_be_is_refused_as_by_rnea(what: str) -> None:
    name, motion, expected = LEAVING[what]
    robot = machine(name)
    with pytest.raises(expected) as theirs:
        rp.RneaDynamics(robot).along(motion)
    with pytest.raises(expected) as mine:
        rp.CompiledDynamics(robot).along(motion)
    assert mine.value.details["sample"] == theirs.value.details["sample"]
    if expected is UnreachablePoseError:
        # the smallest gap from another start may be another local one, of the same size
        assert 0.3 < mine.value.details["residual"] / theirs.value.details["residual"] < 3.0  # type: ignore[operator]
    if name == "3rrr":
        with pytest.raises(expected) as legs:
            rp.VirtualWork(robot).along(motion)
        assert f"leg {legs.value.details['leg'] + 1} " in str(legs.value)  # type: ignore[operator]


@WITH_LOOPS
@pytest.mark.parametrize("first", [0, 15])
def test_unreachable_samples_are_marked_and_the_others_unharmed(backend: Backend, first: int) -> None:
    """Of the five-bar straight up its axis and back, those beyond 0.968 m, where both legs are stretched."""
    robot = zoo.robot_of("five_bar")
    x = np.stack([np.full(41, 0.25), 0.76 + 0.6 * np.sin(np.linspace(0.0, np.pi, 41))], axis=1)[first:]
    motion = rp.PlatformMotion(np.arange(float(len(x))), x, np.ones_like(x), np.ones_like(x), check_rates=False)
    carriers, dynamics = zoo.carriers_at(robot, motion.t), backend(robot)
    with pytest.raises(UnreachablePoseError):
        dynamics.reduce(motion, carriers)
    marked = dynamics.reduce(motion, carriers, unreachable="mark")
    within = x[:, 1] < np.sqrt(1 - 0.25**2)
    np.testing.assert_array_equal(marked.reachable, within)
    for array in (marked.f, marked.W, marked.carrier_force):
        assert np.isnan(array[~within]).all()
        assert np.isfinite(array[within]).all()
    assert np.all(marked.residual[~within] > 1e-3)
    back = rp.RneaDynamics(robot).reduce(motion[-5:], carriers[-5:])
    np.testing.assert_allclose(marked.f[-5:], back.f, rtol=0.0, atol=1e-11 * np.abs(back.f).max())


UP = np.array([np.cos(np.pi / 6), np.sin(np.pi / 6)])
STRETCHED = {"2rpr": [0.0, 0.0], "3rrr": [*(2.25 * UP), 0.0]}
"""Type I: leg 1 of the 2-RPR has no length; leg 1 of the 3-RRR is straight."""


@pytest.mark.parametrize("name", STRETCHED)
def test_closed_forms_name_the_leg_and_mark_samples_that_leave_the_others_alone(name: str) -> None:
    robot, good = zoo.robot_of(name), np.arange(7) != 2
    motion, carriers = motion_of(robot, 7)
    dynamics, x = rp.VirtualWork(robot), motion.x.copy()

    def with_pose(sample: int, pose: Any) -> rp.PlatformMotion:
        x[sample] = pose
        return rp.PlatformMotion(motion.t, x.copy(), motion.xd, motion.xdd, check_rates=False)

    with pytest.raises(SingularPoseError, match="leg 1") as refusal:
        dynamics.along(with_pose(2, STRETCHED[name]))
    assert (refusal.value.details["leg"], refusal.value.details["sample"]) == (0, 2)
    assert abs(refusal.value.details["margin"]) < 1e-5
    broken = with_pose(2, STRETCHED[name])
    if name == "3rrr":  # the other one reaches everything
        with pytest.raises(UnreachablePoseError) as refusal:
            dynamics.reduce(still_at(motion.x[0], [*(2.5 * UP), 0.0]))  # leg 1 is 0.25 m short
        assert refusal.value.details["sample"] == 1
        assert refusal.value.details["residual"] == pytest.approx(0.25)
        broken, good[5] = with_pose(5, [5.0, 0.0, 0.0]), False
    along, intact = dynamics.along(broken, unreachable="mark"), dynamics.along(motion)
    reduced = along.reduce(carriers)
    np.testing.assert_array_equal(reduced.reachable, good)
    assert np.isfinite(reduced.residual).all()
    assert reduced.residual[good].max() < 1e-11
    if name == "3rrr":
        # the largest distance of a corner from its base hinge, less the 2 m a leg reaches
        corners = np.array([5.0, 0.0]) - 0.25 * np.array([UP, [-UP[0], UP[1]], [0.0, -1.0]])
        base = np.array([[0, 0], [np.sqrt(3), 0], [np.sqrt(3) / 2, 1.5]])
        assert reduced.residual[5] == pytest.approx(np.hypot(*(corners - base).T).max() - 2.0)
    first, second = (each.carrier_derivatives(carriers) for each in (along, intact))
    pairs = [(getattr(first, part), getattr(second, part)) for part in first.__dataclass_fields__]
    whole = intact.reduce(carriers)
    pairs += [(getattr(reduced, part), getattr(whole, part)) for part in ("f", "W", "carrier_force")]
    pairs += [(getattr(along, part)(carriers), getattr(intact, part)(carriers)) for part in ("base_wrench", "energy")]
    for marked, expected in pairs:
        assert np.isnan(marked[~good]).all()
        np.testing.assert_array_equal(marked[good], expected[good])


# --- joints beyond their range

LINE = reference.line().sample(0.05)

RANGE = {"lower": 0.05, "upper": 1.1}  # rad; the first swivel of the 2-RPR goes from 1.2 to −1.2 on the line


def beyond(motion: rp.PlatformMotion) -> Array:
    """Return (N,) whether the first leg of the shipped 2-RPR is turned too far: its hinge is the origin."""
    angle = np.arctan2(motion.x[:, 1], motion.x[:, 0])
    return (angle > RANGE["upper"]) | (angle < RANGE["lower"])


@pytest.fixture(scope="module")
def robot() -> rp.Robot:
    return rp.with_limits(zoo.robot_of("2rpr"), {"swivel_1": RANGE})


@EVERY
def test_passive_joints_beyond_their_range_are_a_status(robot: rp.Robot, backend: Backend) -> None:
    unlimited = rp.distribute(backend(zoo.robot_of("2rpr")).reduce(LINE))
    distribution = rp.distribute(backend(robot).reduce(LINE))
    out = beyond(LINE) & unlimited.solved
    assert out.any()
    assert (~beyond(LINE)).any()
    assert (distribution.status == np.where(out, SampleStatus.OUT_OF_RANGE, unlimited.status)).all()
    assert (distribution.solved == unlimited.solved).all()
    np.testing.assert_array_equal(distribution.tau, unlimited.tau)
    assert (rp.inverse_kinematics(robot, LINE).out_of_range == beyond(LINE)).all()


def test_statuses_without_a_solution_come_first(robot: rp.Robot) -> None:
    reduced = rp.RneaDynamics(robot).reduce(LINE)
    out = np.ones(len(LINE), dtype=bool)
    W, reachable = np.array(reduced.W), np.array(reduced.reachable)
    W[0], reachable[1] = 0.0, False
    given = replace(reduced, W=W, reachable=reachable, f=reduced.f + 1.0, out_of_range=out)
    distribution = rp.distribute(given, lower=np.where(np.arange(len(LINE)) == 2, 1e6, -np.inf)[:, None].repeat(2, 1))
    assert distribution.status[:3].tolist() == [
        SampleStatus.SINGULAR_INCONSISTENT,
        SampleStatus.UNREACHABLE,
        SampleStatus.BOUND_INFEASIBLE,
    ]
    assert (distribution.status[3:] == SampleStatus.OUT_OF_RANGE).all()
    assert SampleStatus.OUT_OF_RANGE.solved
    assert not SampleStatus.UNREACHABLE.solved


@pytest.mark.parametrize("ends", [(0.0, 0.0), (1.0, -1.0)])
def test_limits_that_are_none_are_none(ends: tuple[float, float]) -> None:
    free = zoo.robot_of("2rpr")
    model = free.model.copy()
    at = model.joints[model.getJointId("swivel_1")].idx_q
    model.lowerPositionLimit[at], model.upperPositionLimit[at] = ends
    assert not rp.inverse_kinematics(replace(free, model=model), LINE).out_of_range.any()


def test_plans_that_leave_a_range_violate_limits_and_say_it_of_samples(robot: rp.Robot) -> None:
    both = zoo.robot_of("2rpr"), robot
    plans = [
        rp.plan_switch_off(rp.VirtualWork(one), reference.line(), threshold=4.0, mesh=rp.Mesh(dt=0.05)) for one in both
    ]
    unlimited, marked = plans
    assert (unlimited.status, marked.status) == (ResultStatus.OK, ResultStatus.LIMIT_VIOLATED)
    left = [event for event in marked.limits.violated if event.quantity == "range"]
    assert {event.limit for event in left} == set(RANGE.values())
    assert {event.joint for event in left} == {"swivel_1"}
    assert marked.robot.limit_unit("range", "swivel_1") == "rad"
    assert rp.plot.overview(marked).get_suptitle().endswith("(range of swivel_1)")
    np.testing.assert_array_equal(marked.tau, unlimited.tau)
    out = marked.sample_status == SampleStatus.OUT_OF_RANGE
    assert (out == (beyond(unlimited.motion) & (unlimited.sample_status <= SampleStatus.SINGULAR_CONSISTENT))).all()
    assert rp.check_plan(marked, rp.VirtualWork(robot)).deviations == ()


def test_singular_instants_out_of_range_are_not_unbounded_for_that(robot: rp.Robot) -> None:
    unlimited = rp.inverse_dynamics(rp.VirtualWork(zoo.robot_of("2rpr")), LINE)
    result = rp.inverse_dynamics(rp.VirtualWork(robot), LINE)
    assert result.status is unlimited.status
    assert [one.unbounded for one in result.instants] == [one.unbounded for one in unlimited.instants]
    assert [one.limit for one in result.joint_limits] == [RANGE["lower"], RANGE["upper"]]


# --- the backend that a robot gets: generated code, and RNEA with a note where no compiler is


CIRCLE = reference.circle(speed=0.5)
MOTION = CIRCLE.sample(dt=0.05)
AWAY = reference.polygon([[0.2, 0.3], [0.25, 0.35], [0.3, 0.35]], radius=0.02, speed=0.3, ramp_time=0.2)
"""A path without singular poses."""
REMEDY = r"pip install 'redundancy_pin\[compiler\]'"
MODELS = Path(rp.__file__).parents[1] / "models"


@functools.cache
def plan() -> Plan:
    return rp.plan_switch_off(rp.VirtualWork(zoo.robot_of("2rpr")), CIRCLE, threshold=20.0, mesh=rp.Mesh(dt=0.05))


TAKERS: dict[str, Callable[[Any], Any]] = {
    "inverse_dynamics": lambda dynamics: rp.inverse_dynamics(dynamics, MOTION).efforts.tau,
    "plan_switch_off": lambda dynamics: rp.plan_switch_off(dynamics, CIRCLE, threshold=20.0, mesh=rp.Mesh(dt=0.05)).tau,
    "plan_stepwise": lambda dynamics: rp.plan_stepwise(dynamics, AWAY, mesh=rp.Mesh(dt=0.05)).tau,
    "plan_stepwise, baseline": lambda dynamics: (
        rp.plan_stepwise("2rpr", AWAY, mesh=rp.Mesh(dt=0.05), objective=rp.Objective(lam=0.5, baseline=dynamics)).tau
    ),
    "plan_whole_trajectory, baseline": lambda dynamics: (
        rp.plan_whole_trajectory(
            "2rpr", AWAY, mesh=rp.Mesh(dt=0.05), objective=rp.Objective("tracking", lam=0.5, baseline=dynamics)
        ).tau
    ),
    "plan_whole_trajectory": lambda dynamics: rp.plan_whole_trajectory(dynamics, AWAY, mesh=rp.Mesh(dt=0.05)).tau,
    "plan_time_optimal": lambda dynamics: rp.plan_time_optimal(dynamics, AWAY, limits=rp.Limits(effort=50.0)).t,
    "RecedingHorizon": lambda dynamics: rp.RecedingHorizon(dynamics).dynamics.reduce(MOTION).f,
    "check_plan": lambda dynamics: rp.check_plan(plan(), dynamics).peak_effort,
    "efforts_at": lambda dynamics: plan().efforts_at([0.1, 0.2], dynamics),
    "base_wrench": lambda dynamics: plan().base_wrench(dynamics),
    "DesignTask": lambda dynamics: DesignTask(dynamics, CIRCLE).dynamics.reduce(MOTION).f,
}
"""Whatever takes dynamics, and something that depends on the robot."""


@pytest.mark.parametrize("name", TAKERS)
def test_a_robot_is_as_good_as_its_generated_code(name: str) -> None:
    robot = zoo.robot_of("2rpr")
    expected = TAKERS[name](rp.CompiledDynamics(robot))
    assert np.asarray(expected).size
    np.testing.assert_array_equal(TAKERS[name](robot), expected)
    np.testing.assert_array_equal(TAKERS[name]("2rpr"), expected)
    for wrong in (5, rp.RneaDynamics, MOTION) if name != "plan_stepwise, baseline" else ():  # which may be efforts
        with pytest.raises(InputError, match=f"{type(wrong).__name__} was given for the dynamics. Pass a robot"):
            TAKERS[name](wrong)
    with pytest.raises(ModelFileError, match="2rp"):
        TAKERS[name]("2rp")


def test_simulations_and_controllers_take_a_robot_for_its_generated_code() -> None:
    robot = zoo.robot_of("five_bar", carriers=False)
    motion = zoo.smooth_motion(robot, 0).at(np.linspace(0.0, 0.05, 51))

    def run(dynamics: Any) -> Any:
        controller = controller_by_name("computed torque", motion_reference(robot, motion), dynamics=dynamics)
        return rp.simulate(robot, controller, duration=0.02, dynamics=dynamics)

    named, given, plain = run("five_bar"), run(rp.CompiledDynamics(robot)), run(None)
    np.testing.assert_array_equal(named.q, given.q)
    assert named.statistics != plain.statistics or (named.q != plain.q).any()  # other code has run
    np.testing.assert_allclose(named.q, plain.q, atol=1e-7)
    with pytest.raises(InputError, match="int was given for the dynamics"):
        run(5)


def test_a_backend_stays_the_one_that_was_given() -> None:
    robot = zoo.robot_of("2rpr")
    for given in (rp.RneaDynamics(robot), rp.VirtualWork(robot), rp.CompiledDynamics(robot)):
        assert as_dynamics(given) is given
    for named in (robot, "2rpr", MODELS / "2rpr"):
        assert isinstance(as_dynamics(named), rp.CompiledDynamics)
    assert as_dynamics(robot).robot is robot


@pytest.mark.usefixtures("no_compiler")
def test_without_a_compiler_rnea_takes_its_place_and_a_note_says_so_once() -> None:
    robot = zoo.robot_of("3rrr")
    motion = zoo.smooth_motion(robot, 0).at(np.linspace(0.0, 1.0, 5))
    with pytest.raises(CompilerError, match=rf"no C compiler .*{REMEDY}"):
        rp.CompiledDynamics(robot)
    with pytest.warns(RuntimeWarning, match=rf"no C compiler .*RNEA is used.*{REMEDY}"):
        found = rp.inverse_dynamics(robot, motion)
    np.testing.assert_array_equal(found.efforts.tau, rp.inverse_dynamics(rp.RneaDynamics(robot), motion).efforts.tau)
    with warnings.catch_warnings(record=True) as notes:
        warnings.simplefilter("default")  # as Python has it
        assert isinstance(as_dynamics("five_bar"), rp.RneaDynamics)
        assert isinstance(as_dynamics("2rpr"), rp.RneaDynamics)  # from another line
    assert len(notes) == 1


def judged_by(folder: Path, *arguments: str) -> tuple[dict[str, Any], str]:
    plan().save(folder / "plan.npz")
    done = CliRunner().invoke(main, ["check", str(folder / "plan.npz"), "--json", *arguments])
    return json.loads(done.stdout), done.stderr


def test_commands_use_generated_code_unless_a_backend_is_named(tmp_path: Path) -> None:
    by_default, _ = judged_by(tmp_path)
    assert by_default["backend"] == "compiled"
    for name in ("rnea", "virtual-work", "compiled"):
        named, _ = judged_by(tmp_path, "--backend", name)
        assert named["backend"] == name
        np.testing.assert_allclose(named["peak_effort"], by_default["peak_effort"], rtol=1e-9)


@pytest.mark.usefixtures("no_compiler")
def test_commands_say_what_to_install(tmp_path: Path) -> None:
    facts, said = judged_by(tmp_path)
    assert facts["backend"] == "rnea"
    assert facts["passed"]
    assert said.startswith("warning: ")
    assert "pip install 'redundancy_pin[compiler]'" in said
