"""The cross-check itself: it passes on what is right and fails on every fault put into a backend."""

import io
import json
import sys
from dataclasses import replace
from pathlib import Path

import cassie
import numpy as np
import pinocchio as pin
import pytest
import zoo
from closed_forward import ClosedForward
from command_line import call
from examples import FACTOR
from mjcf_models import GEARED, write
from random_robots import random_case
from rich.console import Console
from spatial_chains import chain_of

import redundancy_pin as rp
from redundancy_pin import CarrierMotion, PlatformMotion, crosscheck
from redundancy_pin.crosscheck import checks, states
from redundancy_pin.crosscheck.closures import largest_miss
from redundancy_pin.crosscheck.report import PARITY_SCALE, SCOPE, CheckRow, CrossCheckReport, checked_row, merged
from redundancy_pin.crosscheck.states import REASONS, RandomStates, random_states, walk
from redundancy_pin.dynamics import rnea as rnea_module
from redundancy_pin.dynamics import virtual_work
from redundancy_pin.dynamics.compiled import CompiledDynamics
from redundancy_pin.dynamics.rnea import RneaAlongMotion, RneaDynamics
from redundancy_pin.errors import (
    CompilerError,
    InputError,
    ModelFileError,
    RedundancyPinError,
    SingularPoseError,
    UnreachablePoseError,
)
from redundancy_pin.kinematics.assembly_modes import assembly_modes
from redundancy_pin.kinematics.branch import Follower, follower
from redundancy_pin.kinematics.closed_state import NEAR_RANK_LOSS, closed_around
from redundancy_pin.kinematics.closure import constraint_system
from redundancy_pin.kinematics.coordinates import coordinates
from redundancy_pin.loading import load_robot
from redundancy_pin.robot import Closure, JointForces, Payload, Spring, Wrench
from redundancy_pin.robot.loads import wrench_values
from redundancy_pin.robot.shipped import shipped_robots
from redundancy_pin.simulation.forward import ForwardDynamics


def rows_of(drawn):
    """Return the rows of all checks on states, by name."""
    return {row.check: row for row in checks.check_states(drawn)}


def row_of(drawn, name):
    """Return the row of the check whose name begins so, of those without generated code."""
    with pytest.MonkeyPatch.context() as patched:
        patched.delitem(checks.BACKENDS, "compiled")
        return next(row for check, row in rows_of(drawn).items() if check.startswith(name))


@pytest.fixture
def no_generated_code(monkeypatch):
    """Code that is compiled for one machine takes most of the time of a test that asks for something else."""
    monkeypatch.delitem(checks.BACKENDS, "compiled")


def failed(report):
    return {row.check for row in report.rows if not row.passed}


@pytest.fixture(scope="module")
def report():
    return crosscheck.run(samples=25 * FACTOR if FACTOR > 1 else 2, seed=3)


@pytest.mark.property
def test_everything_agrees(report):
    assert not failed(report)
    assert report.passed
    assert {row.robot for row in report.rows} == {"2rpr", "3rrr", "five_bar", "four_bar", "gough"}
    for robot in {row.robot for row in report.rows}:
        checks = {row.check: row for row in report.rows if row.robot == robot}
        assert all(row.samples > 0 for row in checks.values())
        assert all(row.does_not_show for row in checks.values() if not row.note)
        assert {"rates and accelerations of the joints", "power balance (rnea)", "inverse -> forward (rnea)"} <= set(
            checks
        )
        for backend in ("compiled", *(("virtual work",) if robot in ("2rpr", "3rrr") else ())):
            for quantity in ("f", "W", "carrier force", "base wrench"):
                assert f"parity: {quantity} ({backend})" in checks


@pytest.mark.long_for("3rps", "walking_leg")
@pytest.mark.parametrize("name", sorted(set(shipped_robots()) - set(shipped_robots(gallery=False))))
def test_the_gallery_passes(name):
    """Hinges, couplings, rods, angles among the coordinates, an open chain of two arms."""
    report = crosscheck.run([name], samples=4)
    assert report.passed
    assert all(row.samples > 0 for row in report.rows)


def test_the_seed_decides_the_report_and_the_number_of_processes_does_not():
    one, two, other = (
        crosscheck.run(["four_bar"], samples=8, seed=seed, jobs=jobs) for seed, jobs in ((5, 1), (5, 2), (6, 1))
    )
    assert one == two
    assert [row.worst for row in one.rows] != [row.worst for row in other.rows]


def test_progress_counts_every_state_of_every_batch():
    seen = []
    crosscheck.run(["four_bar"], samples=10, progress=lambda done, total: seen.append((done, total)))
    assert [total for _, total in seen] == [10] * len(seen)
    assert [done for done, _ in seen] == [0, 3, 6, 9, 10]


def test_a_million_states_leave_no_more_behind_than_ten(monkeypatch):
    """They come in 4000 batches; what is kept of them is one row a check."""
    kept, seen = [], []
    monkeypatch.setattr(crosscheck, "checked_batch", lambda name, samples, seed, index, *_: [
        CheckRow(name, check, samples, 1e-12 * (index + 1), 1e-8, True) for check in ("power", "momentum")
    ])  # fmt: skip
    monkeypatch.setattr(crosscheck, "merged", lambda rows: kept.append(len(rows)) or merged(rows))
    report = crosscheck.run(["four_bar"], samples=1_000_000, progress=lambda done, total: seen.append(done))
    assert seen == list(range(0, 1_000_001, 250))
    assert max(kept) == 4
    assert [(row.samples, row.worst, row.passed) for row in report.rows] == [(1_000_000, 4e-9, True)] * 2


LOADS = {
    "friction": lambda links, joint: JointForces(joint, damping=0.7, friction=0.4, friction_speed=0.5),
    "joint spring": lambda links, joint: JointForces(joint, stiffness=3.0, rest=0.2),
    "rotor": lambda links, joint: JointForces(joint, rotor_inertia=2e-3, gear=-12.0),
    "spring": lambda links, joint: Spring(links[1], links[-1], 40.0, 3.0, 0.1, (0.05, 0.02, 0.01), (0.0, 0.03, 0.2)),
    "wrench": lambda links, joint: Wrench(links[-1], [1.0, -2.0, 0.5, 0.3, 0.1, -0.4], "world", (0.1, 0.05, 0.02)),
    "local wrench": lambda links, joint: Wrench(links[1], [1.0, 2.0, 3.0, 0.1, 0.2, 0.3], "local", (0.1, 0.0, 0.3)),
}


@pytest.mark.parametrize("robot", ["five_bar", pytest.param("gough", marks=pytest.mark.long)])
def test_power_and_generated_code_judge_what_loads_ask_of_joints(robot):
    """They do not take their efforts from the function that they are to judge: each of all loads at once is noticed."""
    plain = load_robot(robot)
    links = [frame.name for frame in plain.model.frames if frame.type == pin.FrameType.BODY]
    loads = {name: load(links, plain.model.names[2]) for name, load in LOADS.items()}
    drawn = walk(plain.loaded(*loads.values()), 3, np.random.default_rng(0))
    assert all(row.passed for row in rows_of(drawn).values())
    for name, load in loads.items():
        with pytest.MonkeyPatch.context() as patched:
            exaggerate_loads(patched, 1.001, plain.loaded(load))
            rows = rows_of(drawn)
        assert not rows["power balance (rnea)"].passed, name
        assert not rows["parity: f (compiled)"].passed, name


def exaggerate_loads(monkeypatch, factor, only=None):
    """Multiply what loads, or only those of another robot, require of the RNEA backend."""
    effort = rnea_module.tree_effort

    def exaggerated(robot, data, state):
        required = effort(robot, data, state)
        unloaded = pin.rnea(robot.model, data, state.q, state.v, state.a)
        own = required
        if only is not None:
            rest = np.zeros((1, only.n))  # the wrenches are constant
            values = wrench_values(only.loads, np.zeros(1), rest, rest)
            own = effort(only, data, state._replace(wrenches=[value[0] for value in values]))
        return required + (factor - 1.0) * (own - unloaded)

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
    ("name", "generated"),
    [
        ("cassie_reduced", False),
        *(
            pytest.param(f"cassie{more}", True, marks=pytest.mark.long)
            for more in ("_reduced", "_v2", "_simple", "_wo_gearbox_spring")
        ),
    ],
)
def test_cassie_is_checked_in_bounded_time(monkeypatch, name, generated):
    """No rank loss is crossed, and every check has states; its generated code takes ten seconds to compile."""
    if not generated:
        monkeypatch.delitem(checks.BACKENDS, "compiled")
    monkeypatch.setattr(Follower, "pass_through", lambda *_, **__: pytest.fail("a rank loss"))
    path = CASSIE / f"{name}.sdf"
    report = crosscheck.run([str(path)], samples=2, settings={"actuated": cassie.drives(path)})
    assert report.passed
    assert {row.check for row in report.rows if not row.note and not row.check.startswith("parity")} == {
        "rates and accelerations of the joints",
        "power balance (rnea)",
        "inverse -> forward (rnea)",
    }


@needs_cassie
@pytest.mark.usefixtures("no_generated_code")
def test_a_short_lever_neither_fails_nor_hides_a_fault(monkeypatch):
    """A pin of Cassie's plantar rod has a lever of 1e-4 m and carries 3e8 N."""
    path = CASSIE / "cassie.sdf"
    drawn = random_states(str(path), 5, 0, settings=(("actuated", cassie.drives(path)),))

    def deviations():
        rows = checks.check_states(drawn)
        return np.array([row.worst / row.tolerance for row in rows if not row.is_parity])

    assert (deviations() < [0.1, 0.1, 0.3]).all()
    exaggerate_loads(monkeypatch, 1.00001)
    assert deviations()[1] > 1.0


@pytest.mark.parametrize(
    ("robot", "fault"),
    [("gough", "rates"), ("gough", "accelerations"), ("five_bar", "accelerations"), ("four_bar", "rates")],
)
def test_joints_that_do_not_move_with_the_platform_are_noticed(monkeypatch, robot, fault):
    """Rates of one joint, or what the acceleration has of them, off by a millionth."""
    drawn = random_states(robot, 2, 0)
    tree_motion = RneaAlongMotion.tree_motion

    def moved(self, carriers=None):
        q, v, a = map(np.array, tree_motion(self, carriers))
        (v if fault == "rates" else a)[:, 0] *= 1.0 + 1e-6
        return q, v, a

    def worst():
        row = row_of(drawn, "rates")
        return row.worst / row.tolerance

    assert worst() < 1e-3
    monkeypatch.setattr(RneaAlongMotion, "tree_motion", moved)
    assert worst() > 1.0


@pytest.mark.usefixtures("no_generated_code")
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


@pytest.mark.usefixtures("no_generated_code")
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
    Console(file=shown, width=150).print(CrossCheckReport((good, note), 0).table().terminal())
    assert "a closure [red]is[/red] about one axis" in shown.getvalue()
    assert "FAILED" not in shown.getvalue()
    assert SCOPE.split(".")[0] in " ".join(shown.getvalue().split())
    assert "below 0.05" not in shown.getvalue()
    Console(file=shown, width=150).print(CrossCheckReport((good, agree), 0).table().terminal())
    assert "is multiplied by the margin over 0.05" in " ".join(shown.getvalue().split())
    assert CrossCheckReport((good, agree), 0).as_dict()["notes"] == [SCOPE, PARITY_SCALE]
    blind = replace(good, does_not_show="Wrong masses pass.")
    assert CrossCheckReport((blind, replace(blind, robot="other"), agree), 0).notes == (
        SCOPE,
        "Power: Wrong masses pass.",
        PARITY_SCALE,
    )
    # one batch with states makes it a check
    assert merged([note, replace(note, samples=2, worst=0.5, note="")])[0] == replace(
        note, samples=2, worst=0.5, passed=True, note=""
    )


def closed_at_reference(robot, axes):
    """Return a robot with one closure, between frames of two bodies that coincide at the reference."""
    model, q = robot.model.copy(), np.array(robot.q_reference)
    data, ends = model.createData(), []
    pin.framesForwardKinematics(model, data, q)
    for frame in (robot.closures[0].frame_a, robot.closures[0].frame_b):
        joint = model.frames[model.getFrameId(frame)].parentJoint
        here = pin.SE3(pin.rpy.rpyToMatrix(0.3, 0.4, 0.5), np.array([0.1, 0.2, 0.3]))
        model.addFrame(pin.Frame(f"{frame}'", joint, 0, data.oMi[joint].actInv(here), pin.FrameType.BODY))
        ends.append(f"{frame}'")
    return replace(robot, model=model, closures=(Closure("tip", *ends, axes),))


@pytest.mark.parametrize("name", ["geared", "hinged", "universal", "welded", "rod"])
def test_what_keeps_each_kind_of_closure_is_what_its_rows_by_definition_say(tmp_path, name):
    """Rates and accelerations of J v = 0 and J a = −J̇ v pass; off by a thousandth in any direction they do not."""
    if name == "geared":
        robot = load_robot(write(tmp_path, GEARED))
        first, *others = robot.couplings
        robot = replace(robot, couplings=(replace(first, also=((others[0].joint, 0.7),)), *others))
    elif name == "rod":
        robot = chain_of("rod")
    else:
        axes = {"hinged": "x y z rx rz", "universal": "z ry", "welded": "x y z rx ry rz"}[name]
        robot = closed_at_reference(load_robot("gough"), tuple(axes.split()))
    robot = replace(robot, platform=None, independent_joints=(robot.model.names[1],))
    rng, q = np.random.default_rng(0), np.array(robot.q_reference)
    defined, (v, a) = ClosedForward(robot), rng.normal(size=(2, robot.model.nv))
    J, _ = defined.rows(q, v)
    v -= np.linalg.pinv(J) @ (J @ v)
    J, bias = defined.rows(q, v)
    a -= np.linalg.pinv(J) @ (J @ a + bias)
    assert largest_miss(robot, q, v, a, v[:1], a[:1]) < 1e-12
    assert largest_miss(robot, q, v, a, v[:1] + 1e-6, a[:1]) > 1e-9
    assert largest_miss(robot, q, v, a, v[:1], a[:1] + 1e-6) > 1e-9
    for row in J:
        push = 1e-3 * row / np.linalg.norm(row)
        assert largest_miss(robot, q, v + push, a, (v + push)[:1], a[:1]) > 1e-6
        assert largest_miss(robot, q, v, a + push, v[:1], (a + push)[:1]) > 1e-6


class Tampered:
    """Virtual work along a motion with one fault put in."""

    def __init__(self, inner, fault):
        self._inner, self._fault = inner, fault

    def __getattr__(self, name):
        return getattr(self._inner, name)

    def reduce(self, carriers=None):
        return self._fault(self._inner.reduce(carriers), carriers)


FAULTS = {
    "sign of f": (lambda r, c: replace(r, f=-r.f), {"parity: f (virtual work)"}),
    "f off by a millionth": (lambda r, c: replace(r, f=r.f * (1 + 1e-6)), {"parity: f (virtual work)"}),
    "W transposed": (lambda r, c: replace(r, W=r.W.transpose(0, 2, 1)), {"parity: W (virtual work)"}),
    "legs swapped": (lambda r, c: replace(r, W=r.W[:, :, ::-1]), {"parity: W (virtual work)"}),
    "carrier force dropped": (
        lambda r, c: replace(r, carrier_force=0 * r.carrier_force),
        {"parity: carrier force (virtual work)"},
    ),
    "Coriolis force of the carriers forgotten": (
        lambda r, c: r if c is None or not c.sd.size else replace(r, f=r.f + 0.1 * c.sd[:, :1]),
        {"parity: f (virtual work)"},
    ),
    "NaN": (lambda r, c: replace(r, f=r.f * np.nan), {"parity: f (virtual work)"}),
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
    assert expected == failed(report)


@pytest.mark.parametrize("name", ["3rrr", "gough"])
def test_a_device_is_compared_too(name):
    plain = crosscheck.run([name], samples=12, seed=2)
    report = crosscheck.run([name], samples=12, seed=2, device="cpu")
    own = [row for row in report.rows if "GpuDynamics, cpu" in row.check]
    assert [row.check.split(" (")[0] for row in own] == ["parity: f", "parity: W", "parity: carrier force"]
    assert all(row.passed and row.samples == 12 for row in own)
    assert [row for row in report.rows if row not in own] == list(plain.rows)


def test_states_that_the_straight_way_does_not_reach_are_judged_on_a_device():
    drawn = random_states("gough", 40, 2, 2)  # of eight of them the way from the reference ends
    straight = rp.GpuDynamics(drawn.robot, device="cpu").torque(drawn.motion.x, 0.0, 0.0)
    assert np.isnan(straight.tau).any()
    rows = [row for row in checks.check_states(drawn, "cpu") if "GpuDynamics" in row.check]
    assert len(rows) == 3
    assert all(row.passed for row in rows)


@pytest.mark.parametrize(("part", "fault"), [("f", 1.0 + 1e-9), ("W", -1.0), ("carrier_force", np.nan)])
def test_a_fault_on_a_device_is_found(monkeypatch, part, fault):
    torque = rp.GpuDynamics.torque

    def wrong(self, *args, **settings):
        found = torque(self, *args, **settings)
        return replace(found, **{part: fault * getattr(found, part)})

    monkeypatch.setattr(rp.GpuDynamics, "torque", wrong)
    report = crosscheck.run(["2rpr"], samples=4, seed=1, device="cpu")
    assert failed(report) == {f"parity: {part.replace('_', ' ')} (GpuDynamics, cpu)"}


def test_a_robot_that_a_device_does_not_take_is_left_out():
    changing = replace(zoo.robot_of("2rpr"), loads=(Wrench("end_effector", lambda t, x, xd: np.zeros((len(t), 6))),))
    drawn = states.walk(changing, 4, np.random.default_rng(0))
    (row,) = (row for row in checks.check_states(drawn, "cpu") if "GpuDynamics" in row.check)
    assert (row.verdict, row.skipped) == ("left out", {"no_backend": 4})
    assert "changes with time" in row.note


def test_without_a_gpu_the_error_is_one(monkeypatch):
    monkeypatch.setitem(sys.modules, "cupy", None)
    with pytest.raises(RedundancyPinError, match=r"redundancy_pin\[gpu\]"):
        crosscheck.run(["2rpr"], samples=4, device="gpu")
    with pytest.raises(InputError, match="device"):
        crosscheck.run(["2rpr"], samples=4, device="tpu")


RNEA_FAULTS = {
    "sign of f": (lambda r, c: replace(r, f=-r.f), {"power balance (rnea)", "inverse -> forward (rnea)"}),
    "f off by a millionth": (lambda r, c: replace(r, f=r.f * (1 + 1e-6)), {"power balance (rnea)"}),
    "legs swapped": (lambda r, c: replace(r, W=r.W[:, :, ::-1]), {"inverse -> forward (rnea)"}),
    "carrier force dropped": (
        lambda r, c: replace(r, carrier_force=0 * r.carrier_force),
        {"power balance (rnea)", "inverse -> forward (rnea)"},
    ),
}


@pytest.mark.parametrize("name", RNEA_FAULTS)
def test_a_fault_in_rnea_is_found_by_physics(monkeypatch, name):
    fault, expected = RNEA_FAULTS[name]
    reduce = RneaAlongMotion.reduce
    monkeypatch.setattr(RneaAlongMotion, "reduce", lambda self, c=None: fault(reduce(self, c), c))
    report = crosscheck.run(["five_bar"], samples=4, seed=1, settings={"carriers": True})
    assert expected <= failed(report)


WRONG_MODELS = {
    "link length": ({"crank_length": 0.13}, None),
    "payload": ({}, Payload("coupler_link", 1.0, (0.1, 0.0, 0.0))),
}


@pytest.mark.parametrize("wrong", WRONG_MODELS)
def test_a_wrong_model_passes_as_every_check_says(wrong):
    """A four-bar with another crank, or another mass, is a machine of its own: no check can tell."""
    settings, load = WRONG_MODELS[wrong]
    robot = load_robot("four_bar", **settings)
    robot = robot if load is None else robot.loaded(load)
    rows = rows_of(walk(robot, 3, np.random.default_rng(0)))
    assert all(row.passed for row in rows.values())
    assert len({row.does_not_show for row in rows.values()}) == len(checks.CHECKS)


def test_a_report_without_rows_or_samples_does_not_pass():
    assert not CrossCheckReport((), 0).passed
    assert not CrossCheckReport((checked_row("robot", "check", np.zeros(0), 1.0, {}),), 0).passed


def test_the_worst_of_several_batches_counts_and_nan_stays():
    def row(check, *deviation):
        return checked_row("robot", check, np.array(deviation), 2.5, {})

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
    np.testing.assert_allclose(checks.relative(first, second), [1 / 101, 1e-3 / max(2e-3, 1e-3 * (101 + 2e-3) / 2)])


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
    monkeypatch.setattr(states, "_unusable", lambda *_: "branch_lost")
    with pytest.raises(UnreachablePoseError, match=r"state of 2rpr .* in 60 draws .*another working mode: 60"):
        crosscheck.run(["2rpr"], samples=5)


@pytest.mark.parametrize("name", ["2rpr", "gough"])
def test_states_are_those_that_were_asked_for(name):
    """Carriers on their tracks, poses reached, everything drawn anew for another index."""
    first, second = (random_states(name, 20, 1, index) for index in (0, 2))
    assert len(first.motion) == len(first.carriers) == 20
    assert not np.array_equal(first.motion.x, second.motion.x)
    for drawn in (first, second):
        for k, limit in enumerate(drawn.robot.carrier_limits):
            assert ((limit.lower <= drawn.carriers.s[:, k]) & (drawn.carriers.s[:, k] <= limit.upper)).all()
            assert np.ptp(drawn.carriers.s[:, k]) > 0.5 * (limit.upper - limit.lower)
        along = RneaDynamics(drawn.robot).along(drawn.motion)
        assert along.tree.serial_margin_bound.min() > 0.0


# --- what is skipped, and why -----------------------------------------------------------------------------------------


def test_every_state_is_counted_once(report):
    """Checked, or skipped for one reason."""
    samples = 25 * FACTOR if FACTOR > 1 else 2
    for row in report.rows:
        assert row.total == row.samples + sum(row.skipped.values())
        assert all(count > 0 for count in row.skipped.values())
        assert set(row.skipped) <= set(REASONS)
        assert row.total == samples or row.check == "random states", row


def test_round_trips_skip_singular_states():
    """Where W is near a loss of rank, by the other backend."""
    drawn = random_case("3rrr", 8, 1).states
    manual = virtual_work.VirtualWork(drawn.robot).along(drawn.motion).reduce(drawn.carriers)
    values = np.linalg.svd(manual.W, compute_uv=False)
    # between the least and the most singular of them
    near = np.median(values[:, -1] / values[:, 0])
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(checks, "NEAR_SINGULAR_MARGIN", near)
        patched.setattr(checks, "_regular", lambda along: np.ones(8, dtype=bool))
        row = row_of(drawn, "inverse")
    assert (row.samples, row.skipped) == (4, {"near_type_ii": 4})


def test_coordinates_that_are_not_used_are_counted_by_reason(monkeypatch):
    """A pose of the five-bar is out of reach more than 1 m from a hinge, and near full stretch a millimetre before."""
    robot, tried, advance = load_robot("five_bar", carriers=False), [], Follower.advance
    monkeypatch.setattr(Follower, "advance", lambda self, here, x: tried.append(x) or advance(self, here, x))
    monkeypatch.setattr(states, "_STEP", 0.5)
    drawn = walk(robot, 50, np.random.default_rng(0))
    farthest = [max(np.hypot(x, y), np.hypot(x - 0.5, y)) for x, y in tried]
    assert len(tried) == 50 + sum(drawn.skipped.values())
    beyond = sum(distance > 1.0 for distance in farthest)
    assert 0 < beyond <= drawn.skipped["unreachable"]
    reached = np.maximum(*(np.hypot(drawn.motion.x[:, 0] - hinge, drawn.motion.x[:, 1]) for hinge in (0.0, 0.5)))
    assert reached.max() < 1.0


def test_states_near_a_stretched_leg_are_skipped_as_such():
    """Three states where both legs reach 0.8 m, and two 1e-5 m from full stretch."""
    low, high = (np.sqrt(reach**2 - 0.25**2) for reach in (0.8, 1.0 - 1e-5))
    x = np.stack([np.full(5, 0.25), [low, high, low, high, low]], axis=1)
    robot = load_robot("five_bar", carriers=False)
    motion = PlatformMotion(np.arange(5.0), x, np.ones((5, 2)), np.ones((5, 2)), check_rates=False)
    rows = rows_of(RandomStates(robot, motion, CarrierMotion.parked(5, 0)))
    for row in rows.values():
        assert (row.samples, row.skipped["near_type_i"]) == (3, 2), row.check
        assert row.total == 5


def test_a_machine_with_too_few_motors_has_no_round_trip():
    drawn = random_states("gough", 3, 0)
    weak = replace(drawn.robot, actuated=drawn.robot.actuated[:5])
    row = row_of(replace(drawn, robot=weak), "inverse")
    assert (row.samples, row.skipped, row.note) == (0, {"underactuated": 3}, "every state is skipped")


def test_a_backend_on_another_branch_is_skipped_and_one_that_does_not_close_is_not():
    """The elbow of a four-bar the other way round, and joints that are off by a thousandth."""
    drawn = random_states("four_bar", 4, 0)
    along = RneaDynamics(replace(drawn.robot, working_modes=None, working_mode=())).along(drawn.motion)
    mirrored = np.array([folded(drawn.robot, q) for q in along.q])
    assert np.abs(mirrored - along.q).max() > 0.1
    assert checks._elsewhere(along, mirrored).all()
    assert not checks._elsewhere(along, np.array(along.q)).any()
    assert not checks._elsewhere(along, np.array(along.q) + 1e-3).any()
    assert not checks._elsewhere(along, None).any()


def folded(robot, q):
    """Return the other configuration of a four-bar at the same crank angle."""
    modes = assembly_modes(robot, coordinates(robot, constraint_system(robot).evaluate(q[None]))[0])
    return max(modes.q, key=lambda other: np.abs(other - q).max())


def test_without_a_compiler_the_comparison_is_left_out_with_its_reason(monkeypatch):
    def refuse(robot):
        raise CompilerError("There is no C compiler.", remedy="Install one.")

    monkeypatch.setitem(checks.BACKENDS, "compiled", refuse)
    report = crosscheck.run(["four_bar"], samples=4)
    assert report.passed
    (row,) = [row for row in report.rows if "compiled" in row.check]
    assert (row.note, row.samples, row.skipped) == ("There is no C compiler. Install one.", 0, {"no_backend": 4})


def test_a_state_is_skipped_for_the_first_reason_that_holds():
    first, second = np.array([True, True, False, False]), np.array([True, False, True, False])
    keep, skipped = checks.select(4, near_type_i=first, near_type_ii=second, not_finite=first)
    assert keep.tolist() == [3]
    assert skipped == {"near_type_i": 2, "near_type_ii": 1}


def test_links_without_mass_are_checked_too(tmp_path: Path) -> None:
    """A rod that weighs nothing: no force says how fast the open tree turns it, but the closures do."""

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
    assert (trip["samples"], trip["skipped"], trip["passed"]) == (20, {}, True)


def test_a_motion_without_inertia_is_skipped_with_its_reason():
    """The 2-RPR of the thesis with its carriers taken off has no mass at all."""
    drawn = random_states("2rpr", 3, 0, settings=(("carriers", False),))
    row = row_of(drawn, "inverse")
    assert (row.samples, row.skipped) == (0, {"massless": 3})


def test_a_state_where_closure_rows_lose_rank_is_skipped_with_its_reason(monkeypatch):
    drawn, acceleration, calls = random_states("five_bar", 3, 0), ForwardDynamics.acceleration, []

    def refuse_the_second(self, *state):
        calls.append(state)
        if len(calls) == 2:
            raise SingularPoseError("The closure rows lose rank.", remedy="None.")
        return acceleration(self, *state)

    monkeypatch.setattr(ForwardDynamics, "acceleration", refuse_the_second)
    row = row_of(drawn, "inverse")
    assert (row.samples, row.skipped, row.passed) == (2, {"rank_loss": 1}, True)


@pytest.mark.parametrize(("density", "massless"), [(1e3, False), (1e-4, True)])
def test_a_motion_of_hardly_any_mass_is_skipped_with_its_reason(tmp_path, density, massless):
    """The outer link of an open chain is ten million times lighter than the inner one, or as heavy."""
    inner = f'<joint name="b" axis="0 1 0"/><geom size="0.1" pos="0.2 0 0" density="{density}"/>'
    text = f'<mujoco><worldbody><body><joint name="a" axis="0 1 0"/><geom size="0.1"/><body pos="0.3 0 0">{inner}'
    text += '</body></body></worldbody><actuator><motor joint="a"/><motor joint="b"/></actuator></mujoco>'
    row = row_of(random_states(str(write(tmp_path, text)), 3, 0), "inverse")
    assert (row.samples, row.skipped) == ((0, {"massless": 3}) if massless else (3, {}))


@pytest.mark.parametrize("name", ["2rpr", "3rrr"])
def test_a_backend_in_another_working_mode_fails(monkeypatch, name: str) -> None:
    def flipped(robot):
        return CompiledDynamics(load_robot(name, working_mode=tuple(-sign for sign in robot.working_mode)))

    monkeypatch.setitem(checks.BACKENDS, "compiled", flipped)
    report = crosscheck.run([name], samples=4)
    assert not report.passed
    assert not all(row.passed for row in report.rows if row.check == "parity: W (compiled)")


def test_a_check_whose_every_state_is_on_another_branch_fails() -> None:
    row = checked_row("machine", "parity", np.zeros(0), 1e-10, {"other_branch": 5})
    assert (row.passed, row.note) == (False, "")
    assert not CrossCheckReport((row,), 0).passed
