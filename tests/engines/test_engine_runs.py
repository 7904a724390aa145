"""The planned efforts in Exudyn and MuJoCo: the planned motion comes out, with the order the methods promise."""

import dataclasses
import functools
import xml.etree.ElementTree as ElementTree

import engines.run
import numpy as np
import pinocchio as pin
import pytest
import zoo
from engine_oracles import Timed, integrated, random_state, random_tree
from engines import (
    Task,
    commanded,
    deviation,
    drive_of_motion,
    drive_of_plan,
    open_loop_growth,
    run_exudyn,
    run_mujoco,
)
from engines.cases import MOVING_TURN, SHORT, prepare
from engines.links import link_tree
from spatial_chains import CHAINS, chain_of

import redundancy_pin as rp
from redundancy_pin.errors import InputError, RedundancyPinError, UnsupportedRobotError
from redundancy_pin.planners.receding_horizon import run_online
from redundancy_pin.robot import AXES
from redundancy_pin.status import ResultStatus
from redundancy_pin.writers import constraint_of, mjcf

MOTION_TOLERANCE = 1e-5
"""m and rad: what the comparison with outside engines asks for, without control over the whole motion."""

BALANCE_TOLERANCE = 1e-6
"""Of the largest f: what a plan may leave of it next to a singular instant, where efforts are linear in time."""

COMMANDS_TOLERANCE = 1e-4
"""m and rad. Commands are linear over 2.5 ms, and those of a tick do not know what the next one corrects: 8e-6 here."""

EXUDYN = pytest.param(run_exudyn, id="exudyn")
MUJOCO = pytest.param(run_mujoco, id="mujoco")
EXTRA = "is not installed: pip install 'redundancy_pin[engines]'"


@pytest.fixture(params=[EXUDYN, MUJOCO])
def engine(request):
    name = request.param.__name__.removeprefix("run_")
    pytest.importorskip(name, reason=f"{name} {EXTRA}")
    return request.param


@pytest.fixture
def exudyn():
    return pytest.importorskip("exudyn", reason=f"exudyn {EXTRA}")


@pytest.fixture
def mujoco():
    return pytest.importorskip("mujoco", reason=f"mujoco {EXTRA}")


@pytest.fixture(scope="module")
def short():
    return prepare(SHORT, rp.VirtualWork)


@pytest.fixture(scope="module")
def smooth():
    robot = zoo.robot_of("3rrr")
    return drive_of_motion(rp.VirtualWork(robot), Timed(robot, 0.3), lambda t: zoo.carriers_at(robot, t))


def test_a_plan_through_a_type_ii_pose_makes_the_planned_motion(engine, short):
    run = engine(short.task, step=1e-3)
    assert run.status == ResultStatus.OK
    assert run.t[-1] == short.task.end
    off = deviation(short, run)
    assert off.largest < MOTION_TOLERANCE
    assert len(off.t) == run.steps + 1
    assert (np.diff(run.t) > 0.0).all()
    assert run.x[-1] == pytest.approx((0.2, -0.1), abs=MOTION_TOLERANCE)


@functools.cache
def planned_on_line(name, tick):
    """A run planned with compiled dynamics, its robot, its motion and its drive."""
    case = {"2rpr": SHORT, "3rrr": MOVING_TURN}[name]
    robot, motion = rp.load_robot(case.robot, **case.arguments), case.trajectory(None)
    run = run_online(rp.RecedingHorizon(rp.CompiledDynamics(robot)), motion, tick=tick)
    assert run.counts["ok"] == len(run.commands)
    assert len(run.plan.findings.singular_instants) == case.crossings
    return run, robot, motion, drive_of_plan(rp.RneaDynamics(robot), run.plan, motion)


@pytest.fixture(scope="module", params=[pytest.param("2rpr", marks=pytest.mark.long), "3rrr"])
def on_line(request):
    return planned_on_line(request.param, 0.005)


@pytest.mark.parametrize("backend", [rp.VirtualWork, rp.RneaDynamics], ids=["virtual work", "rnea"])
def test_efforts_planned_on_line_balance_by_either_of_the_other_backends(backend, on_line):
    run, robot, motion, _ = on_line
    times = np.sort(np.random.default_rng(5).uniform(0.0, motion.duration, 300))
    for t, tau in ((run.plan.t, run.plan.tau), (times, run.plan.efforts_at(times, rp.CompiledDynamics(robot)))):
        reduced = backend(robot).reduce(motion.sample_at(t), run.plan.carriers_at(t))
        missing = np.einsum("nij,nj->ni", reduced.W, tau) - reduced.f
        assert np.abs(missing).max() < BALANCE_TOLERANCE * np.abs(reduced.f).max()


def test_a_plan_made_on_line_makes_the_planned_motion_through_a_type_ii_pose(engine, on_line):
    *_, drive = on_line
    replayed = engine(drive.task, step=2e-3)
    assert replayed.status == ResultStatus.OK
    assert deviation(drive, replayed).largest < MOTION_TOLERANCE


def test_so_do_its_commands_with_efforts_that_are_linear_over_milliseconds(engine, on_line):
    run, *_, drive = on_line
    replayed = engine(commanded(drive.task, run.commands), step=2e-3)
    assert replayed.status == ResultStatus.OK
    assert deviation(drive, replayed).largest < COMMANDS_TOLERANCE


@pytest.mark.long_for("0.01", "0.02")
@pytest.mark.parametrize("tick", [0.005, 0.01, 0.02])
def test_commands_are_the_plan_next_to_a_singular_instant_too(tick):
    """A plan that begins within a quarter of a step of one, before or behind it, has its first piece from the last."""
    run, *_, drive = planned_on_line("3rrr", tick)
    (root,) = run.plan.findings.singular_instants
    t = np.linspace(root - 0.02, root + 0.02, 400)
    efforts = drive.task.efforts(t)
    atol = 5e-3 * np.abs(efforts).max()  # linear over 2.5 ms where they turn; with another first piece 0.84 of it
    np.testing.assert_allclose(commanded(drive.task, run.commands).efforts(t), efforts, atol=atol)


@pytest.mark.parametrize("which", range(4), ids=["slide_1", "slide_2", "carrier_1", "carrier_2"])
def test_an_effort_turned_round_misses_it(engine, short, which):
    def turned(t, side="right"):
        efforts = short.task.efforts(t, side).copy()
        efforts[:, which] *= -1.0
        return efforts

    given = short.task
    task = Task(given.robot, given.start, given.end, given.q, given.v, turned, given.breaks)
    assert deviation(short, engine(task, step=2e-3)).largest > 100 * MOTION_TOLERANCE


@pytest.mark.parametrize("parameter", ["end_effector_mass", "cylinder_mass", "piston_mass", "carrier_mass"])
def test_a_mass_off_by_a_hundredth_misses_it(engine, short, parameter):
    masses = {**SHORT.arguments, "carrier_mass": 1.0}
    masses[parameter] *= 1.01
    other = zoo.robot_of("2rpr", **masses)
    given = short.task
    task = Task(other, given.start, given.end, given.q, given.v, given.efforts, given.breaks)
    assert deviation(short, engine(task, step=2e-3)).largest > 10 * MOTION_TOLERANCE


def test_both_engines_are_of_second_order(engine, smooth):
    # MuJoCo's Runge-Kutta holds the efforts over a step
    errors = [deviation(smooth, engine(smooth.task, step=step)).largest for step in (2e-3, 1e-3, 5e-4)]
    ratios = np.divide(errors[:-1], errors[1:])
    np.testing.assert_allclose(ratios, 4.0, rtol=0.1)


@pytest.mark.parametrize("seed", range(3))
def test_a_tree_with_skew_axes_falls_as_pinocchio_says(engine, seed):
    robot = random_tree(seed, joints=6, ordered=seed > 0)
    q, v = random_state(robot, seed)
    model = robot.model

    def effort(t):
        return np.sin(3.0 * np.atleast_1d(t)[:, None] + np.arange(model.nv))

    task = Task(robot, 0.0, 0.2, q, v, lambda t, side="right": effort(t))
    expected = integrated(robot, q, v, lambda t: effort(t)[0], 0.2)
    run = engine(task, step=1e-4)
    np.testing.assert_allclose(run.q[-1], expected, atol=2e-6)
    assert np.abs(expected - q).max() > 0.1


@pytest.mark.parametrize("name", ["four_bar", "five_bar", "gough"])
def test_other_robots_follow_too(engine, name):
    robot = zoo.robot_of(name)
    carriers = (lambda t: zoo.carriers_at(robot, t)) if robot.k else None
    drive = drive_of_motion(rp.RneaDynamics(robot), Timed(robot, 0.1), carriers)
    run = engine(drive.task, step=1e-3)
    assert run.status == ResultStatus.OK
    assert deviation(drive, run).largest < MOTION_TOLERANCE
    assert np.abs(run.x[-1] - run.x[0]).max() > 100 * MOTION_TOLERANCE


def test_a_deviation_sees_platform_turn_and_carriers(exudyn, smooth):
    run = run_exudyn(smooth.task, step=1e-2)
    base = deviation(smooth, run)
    x, s = run.x.copy(), run.s.copy()
    x[5, 1] += 1.0
    x[6, 2] += 2.0 * np.pi + 0.5
    s[7, 2] -= 2.0
    off = deviation(smooth, dataclasses.replace(run, x=x, s=s))
    assert off.platform[5] == pytest.approx(1.0, abs=1e-2)
    assert off.turn[6] == pytest.approx(0.5, abs=1e-2)
    assert off.carriers[7, 2] == pytest.approx(2.0, abs=1e-2)
    assert off.largest == pytest.approx(2.0, abs=1e-2)
    assert base.largest < 1e-2
    stopped = deviation(smooth, dataclasses.replace(run, status=ResultStatus.NOT_CONVERGED))
    assert stopped.largest == np.inf


def test_exudyn_holds_the_closures_to_rounding(exudyn, short):
    assert run_exudyn(short.task, step=2e-3).gap.max() < 1e-12


def test_exudyn_stands_links_without_mass(exudyn):
    robot = zoo.robot_of("2rpr", end_effector_mass=0.5)
    drive = drive_of_motion(rp.VirtualWork(robot), Timed(robot, 0.2), lambda t: zoo.carriers_at(robot, t))
    assert deviation(drive, run_exudyn(drive.task, step=1e-3)).largest < MOTION_TOLERANCE


def test_exudyn_says_where_it_gave_up(exudyn, smooth, capfd):
    def huge(t, side="right"):
        return np.where(np.asarray(t)[:, None] > 0.1, 1e9, 0.0) * np.ones(6)

    given = smooth.task
    run = run_exudyn(Task(given.robot, given.start, given.end, given.q, given.v, huge), step=1e-2)
    assert run.status == ResultStatus.NOT_CONVERGED
    assert run.message.startswith(f"Exudyn stopped at {run.t[-1]:.6g} s: ")
    assert 0.1 <= run.t[-1] < 0.3
    assert len(run.t) == len(run.x) == run.steps + 1
    assert "FAILED" not in capfd.readouterr().out


def test_mujoco_says_where_it_started_over(mujoco, smooth, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)  # where MuJoCo would write MUJOCO_LOG.TXT
    given = smooth.task
    task = Task(
        given.robot, given.start, given.end, given.q, given.v, lambda t, side="right": np.full((len(t), 6), 1e12)
    )
    run = run_mujoco(task, step=1e-2)
    assert run.status == ResultStatus.NOT_CONVERGED
    assert "started over" in run.message
    assert run.t[-1] < given.end
    assert not list(tmp_path.iterdir())
    assert capfd.readouterr() == ("", "")


def test_the_gap_of_soft_constraints_grows_with_the_square_of_their_time_constant(mujoco, smooth):
    gaps = [run_mujoco(smooth.task, step=5e-4, time_constant=c).gap.max() for c in (2e-3, 4e-3, 8e-3)]
    np.testing.assert_allclose(np.divide(gaps[1:], gaps[:-1]), 4.0, rtol=0.1)
    softer = run_mujoco(smooth.task, step=5e-4, time_constant=2e-3, impedance=0.99)
    assert softer.gap.max() > 10 * gaps[0]


@pytest.mark.parametrize("integrator", ["Euler", "implicitfast"])
def test_the_other_integrators_of_mujoco_are_of_first_order(mujoco, smooth, integrator):
    errors = [
        deviation(smooth, run_mujoco(smooth.task, step=step, integrator=integrator)).largest for step in (1e-3, 5e-4)
    ]
    assert errors[0] / errors[1] == pytest.approx(2.0, rel=0.1)


@pytest.mark.parametrize("seed", range(3))
def test_the_mjcf_has_pinocchios_mass_matrix_and_gravity(mujoco, seed):
    robot = random_tree(seed, joints=6)
    tree = link_tree(robot)
    model = mujoco.MjModel.from_xml_string(ElementTree.tostring(mjcf(robot, 1e-3, 0.01), encoding="unicode"))
    data = mujoco.MjData(model)
    q, v = random_state(robot, seed)
    at = [int(model.joint(link.name).qposadr[0]) for link in tree.links]
    data.qpos[at], data.qvel[at] = tree.from_q(q), tree.from_v(v)
    mujoco.mj_forward(model, data)
    mass = np.zeros((model.nv, model.nv))
    for column, unit in enumerate(np.eye(model.nv)):
        product = np.zeros(model.nv)
        mujoco.mj_mulM(model, data, product, unit)
        mass[:, column] = product
    order = [link.velocity for link in tree.links]
    upper = pin.crba(robot.model, robot.model.createData(), q)
    expected = (np.triu(upper) + np.triu(upper, 1).T)[np.ix_(order, order)]
    np.testing.assert_allclose(mass[np.ix_(at, at)], expected, atol=1e-10)
    bias = pin.nonLinearEffects(robot.model, robot.model.createData(), q, v)[order]
    np.testing.assert_allclose(data.qfrc_bias[at], bias, atol=1e-10)


def closed_along(robot, axes):
    return dataclasses.replace(
        robot, closures=tuple(dataclasses.replace(closure, axes=axes) for closure in robot.closures)
    )


def test_masks_become_the_constraints_mujoco_has():
    def kinds(robot):
        return [(kind, len(places)) for kind, places in (constraint_of(robot, closure) for closure in robot.closures)]

    planar, spatial = zoo.robot_of("four_bar"), zoo.robot_of("gough")
    assert kinds(planar) == [("connect", 1)]
    assert kinds(closed_along(planar, ("x", "y", "rz"))) == [("weld", 1)]
    assert set(kinds(spatial)) == {("connect", 1)}
    assert set(kinds(closed_along(spatial, ("x", "y", "z", "rx", "ry")))) == {("connect", 2)}
    assert set(kinds(closed_along(spatial, ("x", "y", "z", "rx", "ry", "rz")))) == {("weld", 1)}
    for axes in (("x", "y"), ("x", "y", "rx", "ry"), ("x", "y", "z", "rx")):
        with pytest.raises(UnsupportedRobotError, match=rf"holds {', '.join(axes)}, which no constraint of MuJoCo"):
            kinds(closed_along(spatial, axes))


def test_the_second_point_of_a_hinge_lies_on_its_axis():
    robot = closed_along(zoo.robot_of("gough"), ("x", "y", "z", "ry", "rz"))
    _, (first, second) = constraint_of(robot, robot.closures[0])
    assert not first.any()
    assert second[0] > 0.0
    assert not second[1:].any()


def test_mujoco_refuses_an_open_tree_without_inertia():
    with pytest.raises(UnsupportedRobotError, match="joint 'slide_2' moves") as caught:
        mjcf(zoo.robot_of("2rpr", end_effector_mass=0.5), 1e-3, 0.01)
    assert "piston_mass" in caught.value.remedy


CYCLES = {"x": (2, 0, 1), "y": (1, 2, 0), "z": (0, 1, 2)}
"""For each axis that takes the place of z: the old axes that become x, y, z."""


def remounted(robot, axis):
    """The same machine: both closure frames turned so that ``axis`` takes the place of z, and the mask with them."""
    cycle = CYCLES[axis]
    turn = pin.SE3(np.eye(3)[:, cycle], np.zeros(3))
    model = pin.Model(robot.model)
    (closure,) = robot.closures
    for name in (closure.frame_a, closure.frame_b):
        frame = model.frames[model.getFrameId(name, pin.FrameType.BODY)]
        frame.placement = frame.placement * turn
    turned = (name[:-1] + "xyz"[cycle.index("xyz".index(name[-1]))] for name in closure.axes if name in AXES)
    axes = tuple(sorted(turned)) or closure.axes  # a rod has none
    return dataclasses.replace(robot, model=model, closures=(dataclasses.replace(closure, axes=axes),))


class Swing:
    """The crank of a small chain swings about its reference."""

    duration = 0.2
    breaks = np.empty(0)

    def __init__(self, robot):
        self._home = zoo.home_of(robot)[0]

    def sample_at(self, times):
        t = np.asarray(times, dtype=float)
        angle = self._home + 0.4 * np.sin(5 * t)
        return rp.PlatformMotion(t, angle[:, None], 2 * np.cos(5 * t)[:, None], -10 * np.sin(5 * t)[:, None])


@pytest.mark.parametrize("axis", "xyz")
@pytest.mark.parametrize("name", CHAINS)
def test_universal_hinge_and_cylindrical_closures_and_continuous_joints(engine, name, axis):
    robot = chain_of(name)
    drive = drive_of_motion(rp.RneaDynamics(robot), Swing(robot))
    given = drive.task
    task = Task(remounted(robot, axis), given.start, given.end, given.q, given.v, given.efforts, given.breaks)
    if engine is run_mujoco and name in ("universal", "cylindrical"):
        with pytest.raises(UnsupportedRobotError, match="no constraint of MuJoCo"):
            engine(task, step=1e-3)
        return
    run = engine(task, step=1e-3)
    assert run.status == ResultStatus.OK
    assert deviation(drive, run).largest < MOTION_TOLERANCE
    assert np.abs(run.x - run.x[0]).max() > 0.3


def test_the_growth_of_an_error_is_time_for_a_body_that_is_free(exudyn):
    """A carrier on a parked machine without gravity slides freely; the rest hardly feels an error of a millionth."""
    robot = random_tree(1, joints=1)
    robot.model.gravity.linear = np.zeros(3)
    q = pin.neutral(robot.model)
    task = Task(robot, 0.0, 0.5, q, np.zeros(1), lambda t, side="right": np.zeros((len(t), 1)))
    t, growth = open_loop_growth(task, lambda one: run_exudyn(one, step=0.05))
    np.testing.assert_allclose(growth, t, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"spectral_radius": 1.5}, "spectral_radius is 1.5"),
        ({"tolerance": 0.0}, "tolerance is 0.0"),
        ({"step": -1.0}, "The step is -1.0 s"),
    ],
)
def test_settings_of_exudyn_out_of_their_domain(smooth, settings, message):
    with pytest.raises(InputError, match=message):
        run_exudyn(smooth.task, **{"step": 1e-3, **settings})


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"time_constant": 1e-3}, "The time constant is 0.001 s with steps of 0.001 s"),
        ({"impedance": 1.0}, "The impedance is 1.0"),
        ({"integrator": "leapfrog"}, "integrator is 'leapfrog'"),
    ],
)
def test_settings_of_mujoco_out_of_their_domain(smooth, settings, message):
    with pytest.raises(InputError, match=message):
        run_mujoco(smooth.task, **{"step": 1e-3, **settings})


@pytest.mark.parametrize("name", ["exudyn", "mujoco"])
def test_an_engine_that_is_not_installed_is_named_with_its_extra(monkeypatch, smooth, name):
    def absent(module):
        raise ImportError(module)

    monkeypatch.setattr(engines.run.importlib, "import_module", absent)
    with pytest.raises(RedundancyPinError, match=f"needs the engine {name}, which is not installed") as caught:
        {"exudyn": run_exudyn, "mujoco": run_mujoco}[name](smooth.task, step=1e-3)
    assert "redundancy_pin[engines]" in caught.value.remedy
