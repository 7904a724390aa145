"""The cross-check itself: it passes on what is right and fails on every fault put into a backend."""

import io
import json
from collections import Counter
from dataclasses import replace
from pathlib import Path

import cassie
import numpy as np
import pinocchio as pin
import pytest
from command_line import call
from examples import FACTOR
from mjcf_models import GEARED, write
from rich.console import Console
from spatial_chains import chain_of

from redundancy_pin import crosscheck
from redundancy_pin.arrays import NEAR_SINGULAR_MARGIN
from redundancy_pin.crosscheck import cases
from redundancy_pin.crosscheck import checks as physics
from redundancy_pin.crosscheck.cases import REASONS, Masses, RandomCase, Wave, random_case
from redundancy_pin.crosscheck.checks import CheckRow, CrossCheckReport, Deviation, checked_row, merged, relative
from redundancy_pin.crosscheck.closed_forward import ClosedForward, confined_to_planes
from redundancy_pin.dynamics import rnea as rnea_module
from redundancy_pin.dynamics import virtual_work
from redundancy_pin.dynamics.rnea import RneaAlongMotion, RneaDynamics
from redundancy_pin.errors import InputError, ModelFileError, UnreachablePoseError
from redundancy_pin.kinematics.branch import Follower, follower
from redundancy_pin.kinematics.closed_state import NEAR_RANK_LOSS, closed_around
from redundancy_pin.kinematics.closure import ConstraintSystem, constraint_system
from redundancy_pin.loading import load_robot
from redundancy_pin.robot import Closure, JointForces, Spring, Wrench
from redundancy_pin.simulation.system import ConstraintDynamics


def failed(report):
    return {row.check for row in report.rows if not row.passed}


@pytest.fixture(scope="module")
def report():
    return crosscheck.run(samples=25 * FACTOR if FACTOR > 1 else 2, seed=3)


@pytest.mark.property
def test_everything_agrees_on_random_robots(report):
    assert not failed(report)
    assert report.passed
    checks = {(row.robot, row.check) for row in report.rows}
    for robot in ("2rpr", "3rrr"):
        for check in ("parity: f", "parity: W", "parity: carrier force", "parity: f at type II poses"):
            assert (robot, check) in checks
    assert {row.robot for row in report.rows} == {"2rpr", "3rrr", "five_bar", "four_bar", "gough"}
    assert all(row.samples > 0 for row in report.rows)


@pytest.mark.long
def test_same_seed_same_numbers_other_seed_other_numbers():
    first, again, other = (crosscheck.run(["four_bar"], samples=20, seed=seed) for seed in (3, 3, 4))
    assert first == again
    assert [row.worst for row in first.rows] != [row.worst for row in other.rows]


def test_the_number_of_processes_does_not_change_the_report():
    one, two = (crosscheck.run(["four_bar"], samples=20, seed=5, jobs=jobs) for jobs in (1, 2))
    assert one == two


def test_progress_counts_every_state_of_every_batch():
    seen = []
    crosscheck.run(["four_bar"], samples=10, progress=lambda done, total: seen.append((done, total)))
    assert [total for _, total in seen] == [10] * len(seen)
    assert [done for done, _ in seen] == [0, 3, 6, 9, 10]


def test_a_million_states_leave_no_more_behind_than_ten(monkeypatch):
    """They come in 4000 batches; what is kept of them is one row a check."""
    kept, seen = [], []
    monkeypatch.setattr(crosscheck, "checked_batch", lambda name, index, samples, *_: [
        CheckRow(name, check, samples, 1e-12 * (index + 1), 1e-8, True) for check in ("power", "momentum")
    ])  # fmt: skip
    monkeypatch.setattr(crosscheck, "merged", lambda rows: kept.append(len(rows)) or merged(rows))
    report = crosscheck.run(["four_bar"], samples=1_000_000, progress=lambda done, total: seen.append(done))
    assert seen == list(range(0, 1_000_001, 250))
    assert max(kept) == 4
    assert [(row.samples, row.worst, row.passed) for row in report.rows] == [(1_000_000, 4e-9, True)] * 2


def test_power_of_the_fastest_state_of_the_long_run():
    """One state in 1e5 that differences along the motion, of sixth order with 0.5 ms, could not follow."""
    case = random_case("five_bar", 250, 2000, 101, masses=Masses.ALL)
    (_, deviation, tolerance, _), _ = physics.check_power(case, RneaDynamics(case.robot), "rnea")
    assert 0.0 < deviation.max() < 1e-11 < tolerance


LOADS = {
    "friction": lambda links, joint: JointForces(joint, damping=0.7, friction=0.4, friction_speed=0.5),
    "joint spring": lambda links, joint: JointForces(joint, stiffness=3.0, rest=0.2),
    "rotor": lambda links, joint: JointForces(joint, rotor_inertia=2e-3, gear=-12.0),
    "spring": lambda links, joint: Spring(links[1], links[-1], 40.0, 3.0, 0.1, (0.05, 0.02, 0.01), (0.0, 0.03, 0.2)),
    "wrench": lambda links, joint: Wrench(links[-1], [1.0, -2.0, 0.5, 0.3, 0.1, -0.4], "world", (0.1, 0.05, 0.02)),
    "local wrench": lambda links, joint: Wrench(links[1], [1.0, 2.0, 3.0, 0.1, 0.2, 0.3], "local", (0.1, 0.0, 0.3)),
}


@pytest.mark.long_for("local wrench-gough", "rotor-gough", "spring-five_bar")
@pytest.mark.parametrize(
    ("load", "robot"), [*((load, "five_bar") for load in LOADS), ("rotor", "gough"), ("local wrench", "gough")]
)
def test_power_and_round_trip_judge_what_loads_ask_of_joints(monkeypatch, load, robot):
    """They do not take their efforts from the function that they are to judge."""
    case = random_case(robot, 2, 0, masses=Masses.ALL)
    model = case.robot.model
    links = [frame.name for frame in model.frames if frame.type == pin.FrameType.BODY]
    case = replace(case, robot=case.robot.loaded(LOADS[load](links, model.names[2])))
    checks = physics.check_power, physics.check_round_trip

    def deviations():
        deviations = [next(iter(check(case, RneaDynamics(case.robot), "rnea"))) for check in checks]
        return np.array([deviation.max() / tolerance for _, deviation, tolerance, _ in deviations])

    assert (deviations() < 1.0).all()
    exaggerate_loads(monkeypatch, 1.001)
    assert (deviations() > 1.0).all()


def exaggerate_loads(monkeypatch, factor):
    """Multiply what loads require of the RNEA backend."""
    effort = rnea_module.tree_effort

    def exaggerated(robot, data, state):
        unloaded = pin.rnea(robot.model, data, state.q, state.v, state.a)
        return unloaded + factor * (effort(robot, data, state) - unloaded)

    monkeypatch.setattr(rnea_module, "tree_effort", exaggerated)


CASSIE = Path(pin.__file__).parents[4] / "share/example-robot-data/robots/cassie_description/robots"
needs_cassie = pytest.mark.skipif(not CASSIE.is_dir(), reason="example-robot-data is not installed")


@needs_cassie
def test_small_margins_throughout_are_no_rank_loss():
    """Cassie's margin is 3.6e-4 everywhere, an order below that of a rank loss."""
    path = CASSIE / "cassie_reduced.sdf"
    system = constraint_system(load_robot(path, actuated=cassie.drives(path)))
    margin = closed_around(system).margin
    assert margin.max() < 0.2 * NEAR_RANK_LOSS
    assert follower(system.robot).near < 0.2 * margin.min()
    five_bar = load_robot("five_bar")
    assert follower(five_bar).near == NEAR_RANK_LOSS
    # a reference at a rank loss does not make a rank loss usual
    flat = replace(five_bar, q_reference=np.zeros(five_bar.model.nq))
    assert follower(flat).near == NEAR_RANK_LOSS


@needs_cassie
@pytest.mark.parametrize(
    "name",
    [
        "cassie_reduced",
        *(pytest.param(f"cassie{more}", marks=pytest.mark.long) for more in ("_v2", "_simple", "_wo_gearbox_spring")),
    ],
)
def test_cassie_is_checked_in_bounded_time(monkeypatch, name):
    """Twenty draws at most, no rank loss crossed, and every check has states."""
    monkeypatch.setattr(Follower, "pass_through", lambda *_, **__: pytest.fail("a rank loss"))
    path = CASSIE / f"{name}.sdf"
    report = crosscheck.run([str(path)], samples=2, settings={"actuated": cassie.drives(path)})
    assert report.passed
    assert {row.check for row in report.rows if not row.note} == {
        "rates and accelerations of the joints",
        "power balance (rnea)",
        "energy (rnea)",
        "inverse -> forward (rnea)",
    }


@needs_cassie
def test_a_short_lever_neither_fails_nor_hides_a_fault(monkeypatch):
    """A pin of Cassie's plantar rod has a lever of 1e-4 m and carries 3e8 N: a case of the run as it comes, of 2000."""
    path = CASSIE / "cassie.sdf"
    case = random_case(str(path), 250, 0, vary=False, settings=(("actuated", cassie.drives(path)),))
    case = replace(case, t=case.t[::50])

    def deviations():
        rnea = RneaDynamics(case.robot)
        every = [
            *physics.check_motion(case),
            *physics.check_power(case, rnea, ""),
            *physics.check_round_trip(case, rnea, ""),
        ]
        return np.array([deviation.max() / tolerance for _, deviation, tolerance, _ in every])

    assert (deviations() < [0.1, 0.1, 0.1, 0.3]).all()
    exaggerate_loads(monkeypatch, 1.00001)
    assert (deviations()[[1, 3]] > 1.0).all()


@pytest.mark.parametrize(
    ("robot", "fault"),
    [("gough", "rates"), ("gough", "accelerations"), ("five_bar", "accelerations"), ("four_bar", "rates")],
)
def test_joints_that_do_not_move_with_the_platform_are_noticed(monkeypatch, robot, fault):
    """Rates of one joint, or what the acceleration has of them, off by a millionth."""
    case = random_case(robot, 2, 0, masses=Masses.ALL)
    tree_motion = RneaAlongMotion.tree_motion

    def moved(self, carriers=None):
        q, v, a = map(np.array, tree_motion(self, carriers))
        (v if fault == "rates" else a)[:, 0] *= 1.0 + 1e-6
        return q, v, a

    def worst():
        ((_, deviation, tolerance, _),) = physics.check_motion(case)
        return deviation.max() / tolerance

    assert worst() < 1e-3
    monkeypatch.setattr(RneaAlongMotion, "tree_motion", moved)
    assert worst() > 1.0


def test_as_many_motors_as_freedoms_may_leave_one_undriven(tmp_path):
    """Two motors on coupled hinges and a hinge that swings freely: the independent joints are driven to check it."""
    body = '<body name="{0}"><joint name="{0}" axis="0 1 0"/><geom size="0.1" pos="0.2 0 0.1"/></body>'
    text = "<mujoco><worldbody>" + "".join(map(body.format, "abc")) + "</worldbody>"
    text += '<equality><joint joint1="c" joint2="a" polycoef="0 2 0 0 0"/></equality>'
    path = write(tmp_path, text + '<actuator><motor joint="a"/><motor joint="c"/></actuator></mujoco>')
    robot = load_robot(path)
    assert (robot.n, robot.m) == (2, 2)
    report = crosscheck.run([str(path)], samples=8)
    assert report.passed
    assert {row.check: row.samples for row in report.rows}["inverse -> forward (rnea)"] == 8


def test_a_chain_without_loops_is_checked_too(tmp_path):
    """Its closures are no rows at all, which ended in a ValueError of numpy."""
    inner = '<body pos="0.3 0 0"><joint name="b" axis="0 1 0"/><geom size="0.1" pos="0.2 0 0"/></body>'
    text = f'<mujoco><worldbody><body><joint name="a" axis="0 1 0"/><geom size="0.1"/>{inner}</body></worldbody>'
    path = write(tmp_path, text + '<actuator><motor joint="a"/><motor joint="b"/></actuator></mujoco>')
    report = crosscheck.run([str(path)], samples=8)
    assert report.passed
    assert {row.check: row.samples for row in report.rows}["inverse -> forward (rnea)"] == 8


def test_what_could_not_be_checked_is_named_and_does_not_fail():
    note = CheckRow("robot", "inverse -> forward", 0, 0.0, 1.0, False, "a closure [red]is[/red] about one axis")
    good = CheckRow("robot", "power", 3, 0.1, 1.0, True)
    assert CrossCheckReport((good, note), 0).passed
    assert not CrossCheckReport((note,), 0).passed
    assert not CrossCheckReport((good, replace(note, robot="other")), 0).passed
    # two backends that agree may share a mistake of the declaration's
    agree = replace(good, check="parity: f")
    assert not CrossCheckReport((agree, note), 0).passed
    assert CrossCheckReport((agree, good, note), 0).passed
    shown = io.StringIO()
    Console(file=shown, width=150).print(CrossCheckReport((good, note), 0).table())
    assert "a closure [red]is[/red] about one axis" in shown.getvalue()
    assert "FAILED" not in shown.getvalue()
    # one batch with states makes it a check
    assert merged([note, replace(note, samples=2, worst=0.5, note="")])[0] == replace(
        note, samples=2, worst=0.5, passed=True, note=""
    )


@pytest.mark.parametrize("name", ["gough", "five_bar"])
def test_forward_dynamics_by_definition_is_pinocchios(name):
    """Points in space, and in a plane."""
    robot = random_case(name, 2, 0, masses=Masses.ALL).robot
    q, rng = np.array(robot.q_reference), np.random.default_rng(1)
    J, _ = ClosedForward(robot).rows(q, np.zeros(robot.model.nv))
    v = rng.normal(size=robot.model.nv)
    v -= np.linalg.pinv(J) @ (J @ v)  # a rate that keeps the closures
    force = rng.normal(size=robot.model.nv)
    (ours, rounding), theirs = ClosedForward(robot)(q, v, force), ConstraintDynamics(robot)(q, v, force)
    np.testing.assert_allclose(ours, theirs, atol=1e-7 * np.abs(theirs).max())
    assert rounding < 1e-11 * np.abs(theirs).max()
    assert confined_to_planes(robot, q, v)


@pytest.mark.parametrize("name", ["geared", "hinged", "universal", "rod"])
def test_rows_of_hinges_rods_and_couplings_are_derivatives_of_one_another(tmp_path, name):
    """J of a moving machine, differenced: d(J v) / dt = J a + J̇ v at any state, closed or not."""
    if name == "geared":
        robot = load_robot(write(tmp_path, GEARED))
        first, *others = robot.couplings
        robot = replace(robot, couplings=(replace(first, also=((others[0].joint, 0.7),)), *others))
    elif name == "rod":
        robot = chain_of("rod")
    else:
        robot = load_robot("gough")
        axes = ("x", "y", "z", "rx", "rz") if name == "hinged" else ("z", "ry")
        robot = replace(robot, closures=tuple(replace(each, axes=axes) for each in robot.closures))
    rng, step = np.random.default_rng(0), 1e-5
    q, v, a = (rng.normal(size=robot.model.nv) for _ in range(3))
    solve = ClosedForward(robot)
    J, bias = solve.rows(q, v)
    ahead, behind = (solve.rows(q + h * v + 0.5 * h * h * a, v + h * a)[0] @ (v + h * a) for h in (step, -step))
    np.testing.assert_allclose((ahead - behind) / (2 * step), J @ a + bias, atol=1e-6)
    if name in ("geared", "rod"):  # of open hinges the kinematics pair other axes
        np.testing.assert_allclose(J, ConstraintSystem(robot).evaluate(q[None]).Jc[0], atol=1e-12)


class Tampered:
    """Virtual work along a motion with one fault put in."""

    def __init__(self, inner, fault):
        self._inner, self._fault = inner, fault

    def __getattr__(self, name):
        return getattr(self._inner, name)

    def reduce(self, carriers=None):
        return self._fault(self._inner.reduce(carriers), carriers)


FAULTS = {
    "sign of f": (lambda r, c: replace(r, f=-r.f), {"parity: f", "power balance (virtual work)"}),
    "f off by a millionth": (lambda r, c: replace(r, f=r.f * (1 + 1e-6)), {"parity: f"}),
    "W transposed": (lambda r, c: replace(r, W=r.W.transpose(0, 2, 1)), {"parity: W"}),
    "legs swapped": (lambda r, c: replace(r, W=r.W[:, :, ::-1]), {"parity: W", "inverse -> forward (virtual work)"}),
    "carrier force dropped": (
        lambda r, c: replace(r, carrier_force=0 * r.carrier_force),
        {"parity: carrier force", "power balance (virtual work)"},
    ),
    "Coriolis force of the carriers forgotten": (
        lambda r, c: r if c is None or not c.sd.size else replace(r, f=r.f + 0.1 * c.sd[:, :1]),
        {"parity: f", "derivatives by s, s', s'' (virtual work)"},
    ),
    "NaN": (lambda r, c: replace(r, f=r.f * np.nan), {"parity: f"}),
}


@pytest.mark.long_for("f off by a millionth", "legs swapped", "Coriolis force of the carriers forgotten")
@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.long if name in ("sign of f", "W transposed", "NaN") else ())
        for name in FAULTS
    ],
)
def test_a_fault_in_one_backend_is_found(monkeypatch, name):
    fault, expected = FAULTS[name]
    along = virtual_work.VirtualWork.along
    monkeypatch.setattr(virtual_work.VirtualWork, "along", lambda self, *a, **k: Tampered(along(self, *a, **k), fault))
    report = crosscheck.run(["2rpr"], samples=4, seed=1)
    assert not report.passed
    assert expected <= failed(report)
    assert not any("rnea" in check for check in failed(report))


def test_a_report_without_rows_or_samples_does_not_pass():
    assert not CrossCheckReport((), 0).passed
    assert not CrossCheckReport((checked_row("robot", Deviation("check", np.zeros(0), 1.0, {})),), 0).passed


def test_the_worst_of_several_batches_counts_and_nan_stays():
    def row(check, *deviation):
        return checked_row("robot", Deviation(check, np.array(deviation), 2.5, {}))

    rows = [row("check", 1.0, 3.0), row("check", 2.0), row("other", 1.0)]
    assert [(r.check, r.samples, r.worst, r.passed) for r in merged(rows)] == [
        ("check", 3, 3.0, False),
        ("other", 1, 1.0, True),
    ]
    worst, other = merged([*rows, row("check", np.nan), row("check", 0.0)])
    assert np.isnan(worst.worst)
    assert (worst.samples, worst.passed, other.passed) == (5, False, True)


def test_relative_deviation_is_by_sample():
    first = np.array([[1.0, 100.0], [1e-3, 0.0]])
    second = np.array([[1.0, 101.0], [2e-3, 0.0]])
    # the second sample is small against the others: it is divided by a thousandth of the typical size at least
    np.testing.assert_allclose(relative(first, second), [1 / 101, 1e-3 / max(2e-3, 1e-3 * (101 + 2e-3) / 2)])


def test_waves_have_exact_derivatives():
    rng = np.random.default_rng(0)
    wave = Wave(rng.normal(size=2), rng.normal(size=(3, 2)), rng.normal(size=(3, 2)), np.array([1.0, 2.0, 5.0]))
    t, h = np.linspace(0, 1, 7), 1e-5
    for order in (0, 1):
        numeric = (wave(t + h, order) - wave(t - h, order)) / (2 * h)
        # truncation h^2 w^3, rounding 1e-16/h
        np.testing.assert_allclose(numeric, wave(t, order + 1), atol=1e-6)


def test_pose_motion_of_the_gough_platform_is_consistent():
    """Twists against finite differences of the poses they belong to."""
    case = random_case("gough", 5, 0, masses=Masses.ALL)
    h = 1e-5
    before, at, after = (case.motion(case.t + shift) for shift in (-h, 0.0, h))
    np.testing.assert_allclose((after.x[:, :3, 3] - before.x[:, :3, 3]) / (2 * h), at.xd[:, :3], atol=1e-7)
    spin = (after.x[:, :3, :3] - before.x[:, :3, :3]) / (2 * h) @ at.x[:, :3, :3].transpose(0, 2, 1)
    omega = np.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]], axis=1)
    np.testing.assert_allclose(omega, at.xd[:, 3:], atol=1e-7)
    np.testing.assert_allclose((after.xd - before.xd) / (2 * h), at.xdd, atol=1e-6)


def test_cases_vary_parameters_modes_and_gravity():
    cases = [random_case("3rrr", 3, seed, index) for seed in range(2) for index in range(2)]
    assert len({case.robot.working_mode for case in cases}) > 1
    assert len({case.robot.parameters["distal_length"] for case in cases}) == len(cases)
    assert all(np.linalg.norm(case.robot.gravity) > 0 for case in cases)


def test_bad_input_is_refused():
    with pytest.raises(InputError, match="samples is 0"):
        crosscheck.run(["2rpr"], samples=0)
    with pytest.raises(InputError, match="jobs is 0"):
        crosscheck.run(["2rpr"], samples=5, jobs=0)
    with pytest.raises(InputError, match="seed is -1"):
        crosscheck.run(["2rpr"], samples=5, seed=-1)
    with pytest.raises(ModelFileError, match="no robot"):
        crosscheck.run(["no_such_robot"], samples=5)


def test_a_robot_without_workspace_is_reported(monkeypatch):
    def never(*_, **__):
        raise UnreachablePoseError("too far")

    monkeypatch.setattr(cases, "inverse_kinematics", never)
    monkeypatch.setattr(cases, "TRIES", 2)
    with pytest.raises(UnreachablePoseError, match=r"motion of 2rpr .* in 2 draws .*do not close: 2"):
        crosscheck.run(["2rpr"], samples=5)


# --- what is skipped, and why -----------------------------------------------------------------------------------------

FIVE_BAR = str(Path(__file__).parents[2] / "models" / "five_bar" / "robot.yaml")
"""By its path it is taken as it is. Its hinges are at (0, 0) and (0.5, 0), the reach of each leg is 1 m."""


def test_every_state_is_counted_once(report):
    """Checked, or skipped for one reason."""
    states = 25 * FACTOR if FACTOR > 1 else 2
    for row in report.rows:
        assert row.total == row.samples + sum(row.skipped.values())
        assert all(count > 0 for count in row.skipped.values())
        assert set(row.skipped) <= set(REASONS)
        if "type II" not in row.check and not row.note:
            assert row.total == (max(1, states // 4) if "momentum" in row.check else states), row


def test_round_trips_skip_singular_states():
    """Where W is near a loss of rank, by the other backend."""
    skipped, singular = Counter(), 0
    for index in range(4):
        case = random_case("3rrr", 2, 1, index, masses=Masses.ALL)
        manual = virtual_work.VirtualWork(case.robot)
        values = np.linalg.svd(manual.along(case.motion(case.t)).reduce(case.carriers(case.t)).W, compute_uv=False)
        singular += int((values[:, -1] <= NEAR_SINGULAR_MARGIN * values[:, 0]).sum())
        (deviation,) = physics.check_round_trip(case, RneaDynamics(case.robot), "rnea")
        skipped += Counter({**deviation.skipped, "checked": len(deviation.values)})
    assert skipped == {"near_type_ii": singular, "checked": 8 - singular}
    assert 0 < singular < 8


def test_motions_that_are_not_used_are_counted_by_reason(monkeypatch):
    """A pose of the five-bar is out of reach more than 1 m from a hinge, and near full stretch a millimetre before."""
    drawn, draw = [], cases._random_motion

    def draw_motion(*arguments, **keywords):
        drawn.append(draw(*arguments, **keywords))
        return drawn[-1]

    monkeypatch.setattr(cases, "_random_motion", draw_motion)
    skipped, reach = Counter(), []
    for seed in (0, 8, 14, 16):
        drawn.clear()
        skipped += Counter(random_case(FIVE_BAR, 4, seed, vary=False).skipped)
        for refused in drawn[:-1]:
            x, y = refused.motion(np.linspace(0.0, refused.t[-1], 200)).x.T
            farthest = np.maximum(np.hypot(x, y), np.hypot(x - 0.5, y))
            reach.append(farthest[np.argmax(farthest > 0.999)])
    beyond = sum(distance > 1.0 for distance in reach)
    assert min(reach) > 0.999
    assert 0 < beyond < len(reach)
    assert skipped == {"unreachable": beyond, "near_type_i": len(reach) - beyond}


def test_states_near_a_stretched_leg_are_skipped_as_such():
    """Three states where both legs reach 0.8 m, and two 1e-5 m from full stretch."""
    low, high = (np.sqrt(reach**2 - 0.25**2) for reach in (0.8, 1.0 - 1e-5))
    middle, swing = 0.5 * (low + high), 0.5 * (high - low)
    path = Wave(np.array([0.25, middle]), np.array([[0.0, swing]]), np.array([[0.0, -0.5 * np.pi]]), np.ones(1))
    robot = load_robot("five_bar", carriers=False)
    case = RandomCase(robot, np.pi * np.arange(5.0), path, Wave(np.zeros(0), *np.zeros((2, 1, 0)), np.ones(1)))
    rnea = RneaDynamics(robot)
    for deviation in (*physics.check_motion(case), *physics.check_power(case, rnea, "rnea")):
        assert (len(deviation.values), deviation.skipped) == (3, {"near_type_i": 2}), deviation.check
    (trip,) = physics.check_round_trip(case, rnea, "rnea")
    assert trip.skipped["near_type_i"] == 2
    assert len(trip.values) + sum(trip.skipped.values()) == 5
    (derivatives,) = physics.check_derivatives(case, rnea.along(case.motion(case.t)), "rnea")
    assert (len(derivatives.values), derivatives.skipped) == (0, {"no_carriers": 5})


def test_states_that_the_other_checks_skip_are_counted(monkeypatch):
    case = random_case("2rpr", 3, 0, masses=Masses.ZERO_STAYS_ZERO, carriers=True)
    case = replace(case, t=np.array([0.1, 0.1001, 0.3]))  # the differences take 7 ms
    (momentum,) = physics.check_leg_momentum(case, RneaDynamics(case.robot), "rnea")
    assert (len(momentum.values), momentum.skipped) == (2, {"too_close": 1})
    assert all(len(parity.values) == 3 and not parity.skipped for parity in physics.check_parity(case))
    monkeypatch.setattr(physics, "AWAY_FROM_TYPE_ONE", np.inf)
    for parity in physics.check_parity(case):
        assert (len(parity.values), parity.skipped) == (0, {"near_type_i": 3}), parity.check


def test_a_machine_with_too_few_motors_has_no_round_trip():
    case = random_case("gough", 3, 0, masses=Masses.ALL)
    robot = case.robot
    weak = replace(robot, actuated=robot.actuated[:5])
    (deviation,) = physics.check_round_trip(replace(case, robot=weak), RneaDynamics(weak), "rnea")
    assert (len(deviation.values), deviation.skipped) == (0, {"underactuated": 3})


def test_a_state_is_skipped_for_the_first_reason_that_holds():
    first, second = np.array([True, True, False, False]), np.array([True, False, True, False])
    keep, skipped = physics.select(4, near_type_i=first, near_type_ii=second, not_finite=first)
    assert keep.tolist() == [3]
    assert skipped == {"near_type_i": 2, "near_type_ii": 1}


@pytest.mark.parametrize("axes", [("x", "y", "rz"), ("z", "rx", "ry"), ("rx", "ry", "rz")], ids=str)
def test_rows_by_definition_are_those_of_the_kinematics_where_these_are_closed(axes):
    """At the reference, where frames coincide: up to the sign and order of rows of turns the same space."""
    robot = load_robot("gough")
    model = robot.model.copy()
    data, q = model.createData(), np.array(robot.q_reference)
    pin.framesForwardKinematics(model, data, q)
    ends = []
    for frame in (robot.closures[0].frame_a, robot.closures[0].frame_b):
        entry = model.frames[model.getFrameId(frame)]
        place = data.oMi[entry.parentJoint].actInv(
            pin.SE3(pin.rpy.rpyToMatrix(0.3, 0.4, 0.5), np.array([0.1, 0.2, 0.3]))
        )
        model.addFrame(pin.Frame(f"{frame}'", entry.parentJoint, 0, place, pin.FrameType.BODY))
        ends.append(f"{frame}'")
    closed = replace(robot, model=model, closures=(Closure("tip", *ends, axes),))
    ours, _ = ClosedForward(closed).rows(q, np.zeros(model.nv))
    theirs = ConstraintSystem(closed).evaluate(q[None]).Jc[0]
    both = np.concatenate([ours, theirs])
    assert np.linalg.matrix_rank(ours) == np.linalg.matrix_rank(both) == np.linalg.matrix_rank(theirs) == len(axes)


def test_links_without_mass_are_skipped_with_their_reason(tmp_path: Path) -> None:
    """A rod that weighs nothing: no force says how fast the open tree turns it, so there is no round trip."""

    def link(name: str, mass: float) -> str:
        inertia = f'<inertia ixx="{0.01 * mass}" iyy="{0.01 * mass}" izz="{0.01 * mass}" ixy="0" ixz="0" iyz="0"/>'
        return f'<link name="{name}"><inertial><mass value="{mass}"/>{inertia}</inertial></link>'

    def joint(name: str, parent: str, child: str, x: float, kind: str = "revolute") -> str:
        limit = '<axis xyz="0 0 1"/><limit lower="-9" upper="9" effort="9" velocity="9"/>' if kind != "fixed" else ""
        ends = f'<parent link="{parent}"/><child link="{child}"/><origin xyz="{x} 0 0"/>'
        return f'<joint name="{name}" type="{kind}">{ends}{limit}</joint>'

    parts = ['<link name="base"/>', link("crank", 1.0), link("rod", 0.0), link("rocker", 1.0)]
    parts += [joint("drive", "base", "crank", 0.0), joint("knee", "crank", "rod", 0.2)]
    parts += [joint("pivot", "base", "rocker", 0.5)]
    for name, on, x in (("rod_end", "rod", 0.45), ("rocker_end", "rocker", 0.4)):
        parts += [f'<link name="{name}"/>', joint(f"to_{name}", on, name, x, "fixed")]
    (tmp_path / "bars.urdf").write_text(f'<robot name="bars">{"".join(parts)}</robot>')
    (tmp_path / "robot.yaml").write_text(
        "name: bars\nurdf: bars.urdf\nclosures: [{frames: [rod_end, rocker_end], axes: [x, y]}]\nactuated: [drive]\n"
        "gravity: [0, -9.81, 0]\nindependent: {joints: [drive]}\n"
        "reference: {joints: {drive: 1.0}, guess: {knee: -0.8, pivot: 1.8}}\n"
    )
    result = call("validate", "--robot", tmp_path / "robot.yaml", "--samples", "20", "--json", "--jobs", "1")
    assert result.exit_code == 0, result.stdout
    rows = json.loads(result.stdout)["rows"]
    (trip,) = [row for row in rows if row["check"].startswith("inverse -> forward (rnea")]
    assert trip["skipped"] == {"massless": trip["total"]}
    assert trip["samples"] == 0
