"""The mission, end to end: models from xacro, three backends that agree, plans, pictures, and a user's own robot.

Everything enters by ``rp`` and by the command line, so that rooms may be rebuilt beneath it. The oracle is Pinocchio
itself, called here on what the library xacro makes of the shipped files: no line of the package takes part.
"""

from __future__ import annotations

import base64
import functools
import json
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import umsgpack
import xacro
from command_line import call

import redundancy_pin as rp
from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.planners.registry import in_groups

ROOT = Path(__file__).parents[1]
reference = rp.trajectory.reference

BACKENDS: Mapping[str, Callable[..., Any]] = {
    "rnea": rp.RneaDynamics,
    "virtual work": rp.VirtualWork,
    "generated code": rp.CompiledDynamics,
}
QUANTITIES = ("W", "f", "carrier_force")

PARITY = 1e-13
"""Relative to the size of the terms before they cancel. Rounding alone leaves 3e-16 of f and 2e-15 of W here; generated
code stops at a Newton step of 1e-13 rad or characteristic lengths. W is a block of K⁻¹, K the rows of closures and
platform, so that a relative error of K comes into it times the condition number of K: that times W is its size."""

GRAVITY = (0.0, -9.81, 0.0)
"""m/s²: the planar machines stood upright, so that weights take part."""

Mode = tuple[int, ...]


# --- the machines of the thesis ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Machine:
    """One machine of the thesis: its shipped file, and where its random poses lie.

    Attributes:
        name: of the shipped robot.
        arguments: of its xacro file; masses that the thesis leaves out take part.
        closures: pairs of links whose origins coincide in the plane.
        platform: link whose x, y (and angle, if ``turns``) are the coordinates.
        turns: whether the platform turns.
        actuated: driven joints.
        middle, spread: (n,) of the poses, m and rad: a convex set without type I singularities.
        singular: ends of a straight path, (n,) each, m and rad, that crosses type II in every working mode.
        mass: of all that moves, kg.
    """

    name: str
    arguments: Mapping[str, object]
    closures: tuple[tuple[str, str], ...]
    platform: str
    turns: bool
    actuated: tuple[str, ...]
    middle: tuple[float, ...]
    spread: tuple[float, ...]
    singular: tuple[tuple[float, ...], tuple[float, ...]]
    mass: float

    @property
    def carriers(self) -> tuple[str, ...]:
        """Joints of the carriers, one for each leg."""
        count = len(self.actuated) if self.arguments["carriers"] else 0
        return tuple(f"carrier_{i + 1}" for i in range(count))

    @property
    def modes(self) -> list[Mode]:
        """All working modes."""
        return list(product((1, -1), repeat=len(self.actuated)))

    def load(self, mode: Mode) -> Any:
        """Load the robot, upright."""
        return rp.load_robot(self.name, working_mode=mode, gravity=GRAVITY, **self.arguments)

    def backends(self, mode: Mode) -> dict[str, Any]:
        """Return the three backends of the robot."""
        robot = self.load(mode)
        return {name: backend(robot) for name, backend in BACKENDS.items()}


TWO_RPR = Machine(
    "2rpr", {"carriers": True, "end_effector_mass": 0.5, "cylinder_mass": 0.3, "piston_mass": 0.2},
    (("end_effector", "piston_2"),), "end_effector", False, ("slide_1", "slide_2"),
    (0.25, 0.0), (0.12, 0.5), ((0.15, 0.4), (0.25, -0.7)), 3.5,
)  # fmt: skip
TWO_RPR_BARE = Machine(**{**vars(TWO_RPR), "arguments": {**TWO_RPR.arguments, "carriers": False}, "mass": 1.5})
THREE_RRR = Machine(
    "3rrr", {"carriers": True}, (("tip_2", "corner_2"), ("tip_3", "corner_3")), "platform", True,
    ("base_1", "base_2", "base_3"), (0.866, 0.5, 0.0), (0.3, 0.3, 0.5),
    ((0.9, 0.5, -1.45), (0.8, 0.55, 1.45)), 15.5,
)  # fmt: skip
THREE_RRR_BARE = Machine(**{**vars(THREE_RRR), "arguments": {"carriers": False}, "mass": 6.5})
MACHINES = {"2rpr": TWO_RPR, "2rpr bare": TWO_RPR_BARE, "3rrr": THREE_RRR, "3rrr bare": THREE_RRR_BARE}
EVERY_MODE = {f"{name} {mode}": (name, mode) for name, machine in MACHINES.items() for mode in machine.modes}
each_mode = pytest.mark.parametrize(("name", "mode"), EVERY_MODE.values(), ids=EVERY_MODE)
BARE = [each for each, (name, mode) in EVERY_MODE.items() if "bare" in name and mode[:2] != (1, -1)]
"""Without carriers; ``make test`` takes all modes with carriers, and one or two without."""


@dataclass(frozen=True)
class States:
    """N states of a machine: platform and carriers. Rates and accelerations are not those of one motion."""

    motion: Any
    carriers: Any

    @property
    def sizes(self) -> np.ndarray:
        """(N,) acceleration, m/s², that forces have the size of before they cancel; the shortest length is 0.1 m."""
        motion, carriers = self.motion, self.carriers
        speed = np.abs(motion.xd).sum(axis=1) + np.abs(carriers.sd).sum(axis=1)
        acceleration = np.abs(motion.xdd).sum(axis=1) + np.abs(carriers.sdd).sum(axis=1)
        return 9.81 + acceleration + speed**2 / 0.1


def random_states(machine: Machine, poses: np.ndarray, seed: int) -> States:
    """Return random rates and accelerations at poses (N, n), with random carriers on their tracks."""
    rng = np.random.default_rng(seed)
    count, n, k = *poses.shape, len(machine.carriers)
    velocity, acceleration = rng.uniform(-1.0, 1.0, (2, count, n)) * [[[1.0]], [[5.0]]]
    motion = rp.PlatformMotion(np.arange(float(count)), poses, velocity, acceleration, check_rates=False)
    return States(motion, rp.CarrierMotion(*(rng.uniform(-a, a, (count, k)) for a in (0.19, 1.0, 7.0))))


def regular_states(machine: Machine, mode: Mode, count: int = 20) -> States:
    """Return random states."""
    seed = 2014 + machine.modes.index(mode)
    draw = np.random.default_rng(seed).uniform(-1.0, 1.0, (count, len(machine.middle)))
    return random_states(machine, np.array(machine.middle) + np.array(machine.spread) * draw, seed)


def singular_state(machine: Machine, mode: Mode) -> States:
    """Return a state at a pose where the machine meets type II on its path."""
    path = rp.trajectory.Line(*machine.singular)
    trajectory = rp.trajectory.Trajectory(path, rp.trajectory.RestToRest(path.length, duration=1.0))
    crossing = rp.find_crossings(machine.load(mode), trajectory)[0]
    return random_states(machine, np.array(crossing.x)[None], 7)


# --- Pinocchio by itself -------------------------------------------------------------------------------------------


@functools.cache
def bare_model(name: str, arguments: tuple[tuple[str, object], ...]) -> pin.Model:
    """Return the upright tree that Pinocchio makes of a shipped file, expanded by the library xacro."""
    source = ROOT / "models" / name / f"{name}.urdf.xacro"
    mappings = {argument: str(value).lower() for argument, value in arguments}
    model = pin.buildModelFromXML(xacro.process_file(str(source), mappings=mappings).toxml())
    model.gravity.linear = np.array(GRAVITY)
    return model


class BarePinocchio:
    """W, f and carrier forces by Pinocchio alone: RNEA on the cut tree, its Jacobians, its frame accelerations.

    v = K⁻¹ (0, ẋ, ṡ) with K the rows of closures, platform and carriers; Γ are the columns of K⁻¹ that belong to ẋ, so
    that J_c Γ = 0, and f = Γᵀ rnea(q, v, a).
    """

    def __init__(self, machine: Machine) -> None:
        self.model = bare_model(machine.name, tuple(machine.arguments.items()))
        self.data, self.machine = self.model.createData(), machine
        model = self.model
        self.loops = [tuple(model.getFrameId(link) for link in pair) for pair in machine.closures]
        self.platform = model.getFrameId(machine.platform)
        self.driven, self.sliding = (
            [model.joints[model.getJointId(name)].idx_v for name in names]
            for names in (machine.actuated, machine.carriers)
        )
        # a link that has closures of its own cuts the tree: the platform hangs on the first leg
        self.axes = [0, 1, 5] if machine.turns else [0, 1]

    def _rows(self) -> np.ndarray:
        """(nv, nv) rows of closures, platform coordinates and carriers, at the configuration of ``data``."""
        jacobian = functools.partial(pin.getFrameJacobian, self.model, self.data)
        world = pin.LOCAL_WORLD_ALIGNED
        closing = [(jacobian(a, world) - jacobian(b, world))[:2] for a, b in self.loops]
        return np.vstack([*closing, jacobian(self.platform, world)[self.axes], np.eye(self.model.nv)[self.sliding]])

    def _errors(self, x: np.ndarray) -> np.ndarray:
        """(nv − k,) what closures and platform coordinates are off, m and rad."""
        places = self.data.oMf
        closing = [(places[a].translation - places[b].translation)[:2] for a, b in self.loops]
        here = places[self.platform]
        pose = [*here.translation[:2], pin.log3(here.rotation)[2]][: len(self.axes)]
        return np.concatenate([*closing, np.array(pose) - x])

    def evaluate(self, guess: Mapping[str, float], states: States, i: int) -> dict[str, np.ndarray]:
        """Return the quantities of one state; Newton's method closes the loops from a guess, joint by joint."""
        model, data, motion, carriers = self.model, self.data, states.motion, states.carriers
        q = np.array([guess[name] for name in model.names[1:]])
        n, k = motion.xd.shape[1], carriers.s.shape[1]
        for _ in range(4):
            q[self.sliding] = carriers.s[i]
            pin.computeJointJacobians(model, data, q)
            pin.updateFramePlacements(model, data)
            q -= np.linalg.solve(self._rows(), np.append(self._errors(motion.x[i]), np.zeros(k)))
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacements(model, data)
        assert np.abs(self._errors(motion.x[i])).max() < 1e-14
        rows = self._rows()
        loose = np.zeros(len(rows) - n - k)
        v = np.linalg.solve(rows, np.concatenate([loose, motion.xd[i], carriers.sd[i]]))
        pin.forwardKinematics(model, data, q, v, np.zeros(model.nv))

        def bias(frame: int) -> np.ndarray:
            part: np.ndarray = pin.getFrameClassicalAcceleration(model, data, frame, pin.LOCAL_WORLD_ALIGNED).vector
            return part

        drift = [(bias(a) - bias(b))[:2] for a, b in self.loops]
        wanted = np.concatenate([loose, motion.xdd[i], carriers.sdd[i]])
        a = np.linalg.solve(rows, wanted - np.concatenate([*drift, bias(self.platform)[self.axes], np.zeros(k)]))
        gamma = np.linalg.inv(rows)[:, len(loose) : len(loose) + n]
        efforts = pin.rnea(model, data, q, v, a)
        return {"W": gamma.T[:, self.driven], "f": gamma.T @ efforts, "carrier_force": efforts[self.sliding],
                "condition": np.linalg.cond(rows)}  # fmt: skip


def configurations(robot: Any, states: States) -> list[dict[str, float]]:
    """Return the joint coordinates of each state on the branch of the robot's working mode, by name."""
    q = rp.inverse_kinematics(robot, states.motion).q
    return [dict(zip(robot.model.names[1:], row, strict=True)) for row in q]


def assert_backends_agree(machine: Machine, mode: Mode, states: States, reduced: Mapping[str, Any]) -> None:
    """Compare W, f and carrier forces of the backends with those of bare Pinocchio."""
    oracle = BarePinocchio(machine)
    branch = configurations(machine.load(mode), states)
    expected = [oracle.evaluate(guess, states, i) for i, guess in enumerate(branch)]
    condition = np.array([sample["condition"] for sample in expected])
    for quantity in QUANTITIES:
        truth = np.array([sample[quantity] for sample in expected])
        # forces and moments, about arms of 1 m, are made of masses times accelerations
        size = condition * np.abs(truth).max(axis=(1, 2)) if quantity == "W" else machine.mass * states.sizes
        for name, result in reduced.items():
            off = np.abs(getattr(result, quantity) - truth).reshape(len(truth), -1).max(axis=1, initial=0.0)
            assert (off <= PARITY * size).all(), (name, quantity, float((off / size).max()))


@pytest.mark.long_for(*BARE)
@each_mode
def test_backends_and_bare_pinocchio_agree_on_random_states(name: str, mode: Mode) -> None:
    machine = MACHINES[name]
    states = regular_states(machine, mode)
    backends = machine.backends(mode)
    reduced = {by: dynamics.reduce(states.motion, states.carriers) for by, dynamics in backends.items()}
    assert_backends_agree(machine, mode, states, reduced)
    assert min(np.abs(result.f).max() for result in reduced.values()) > 1.0  # N: masses took part


@pytest.mark.long_for(*BARE)
@each_mode
def test_backends_and_bare_pinocchio_agree_at_singular_poses(name: str, mode: Mode) -> None:
    """W and f stay finite where W loses rank; there no backend returns efforts, and all say why."""
    machine = MACHINES[name]
    states = singular_state(machine, mode)
    backends = machine.backends(mode)
    reduced = {by: dynamics.reduce(states.motion, states.carriers) for by, dynamics in backends.items()}
    assert_backends_agree(machine, mode, states, reduced)
    for result in reduced.values():
        singular_values = np.linalg.svd(result.W[0], compute_uv=False)
        assert singular_values[-1] < 1e-10 * singular_values[0]
        efforts = rp.distribute(result)
        assert efforts.status_labels[0] == "singular_inconsistent"
        assert np.isnan(efforts.tau).all()


# --- every case of the thesis, by every planner that takes it ------------------------------------------------------


@dataclass(frozen=True)
class Motion:
    """A motion of the thesis.

    Attributes:
        robot: shipped robot that carries it out.
        make: makes its trajectory; keywords change its ramps.
        smooth: keywords of ramps that whole-trajectory planners are given: on the circle those without overshoot.
    """

    robot: str
    make: Callable[..., Any]
    smooth: Mapping[str, float] = field(default_factory=dict)


MOTIONS = {
    "circle 0.5": Motion("2rpr", functools.partial(reference.circle, 0.5), {"ramp_time": 0.2, "ramp_length": 0.05}),
    "circle 0.75": Motion("2rpr", functools.partial(reference.circle, 0.75), {"ramp_time": 0.2, "ramp_length": 0.075}),
    "line 0.1": Motion("2rpr", functools.partial(reference.line, 0.1)),
    "line 0.2": Motion("2rpr", functools.partial(reference.line, 0.2)),
    "corner 0.025": Motion("3rrr", functools.partial(reference.corner, 0.025)),
    "corner 0.013": Motion("3rrr", functools.partial(reference.corner, 0.013)),
    "square": Motion("3rrr", reference.square),
}


@functools.cache
def dynamics_of(backend: str, robot: str, carriers: bool = True) -> Any:
    """Return a backend of a machine of the thesis, as the thesis has it: flat on the table."""
    return BACKENDS[backend](rp.load_robot(robot, carriers=carriers))


@functools.cache
def switch_off(backend: str, name: str, threshold: float, ramp_down: float) -> Any:
    """Plan a crossing; several tests look at the same plans."""
    dynamics = dynamics_of(backend, MOTIONS[name].robot)
    trajectory = MOTIONS[name].make()
    mesh = rp.Mesh(dt={"line 0.1": 2e-2, "line 0.2": 1e-2}.get(name, 5e-3))  # s; the lines last 12 and 6 s
    return rp.plan_switch_off(
        dynamics, trajectory, threshold=threshold, ramp_down=ramp_down, return_time=0.4, mesh=mesh
    )


def stepwise(backend: str, motion: Motion, lam: float, active: str = "always") -> Any:
    baseline = dynamics_of(backend, motion.robot, carriers=False)
    samples = motion.make().sample(1e-2, two_sided=True)
    options = {"lam": lam, "baseline": baseline, "active": active, "return_time": 0.6}
    return rp.plan_stepwise(dynamics_of(backend, motion.robot), samples, **in_groups(rp.plan_stepwise, options))


def whole_trajectory(backend: str, motion: Motion, objective: str, dt: float) -> Any:
    dynamics = dynamics_of(backend, motion.robot)
    return rp.plan_whole_trajectory(dynamics, motion.make(**motion.smooth), objective=objective, mesh=rp.Mesh(dt=dt))


def least_time(backend: str, motion: Motion, mesh: rp.Mesh) -> Any:
    # limits of the motors, N and N·m, of the size of those that the thesis's motions need
    effort = 0.5 if motion.robot == "2rpr" else 2.0
    return rp.plan_time_optimal(
        dynamics_of(backend, motion.robot), motion.make(), limits=rp.Limits(effort=effort), mesh=mesh
    )


SEARCHED = 1e-6
"""Relative to the largest value: solvers stop at 1e-8 of their own residuals; where exactly, depends on rounding."""

INTEGRATED = 1e-8
"""Relative to the largest value: carriers are integrated with error control, whose steps rounding steers."""

STEPPED = 1e-10
"""Relative to the largest value: a hundred and more least-squares problems, each of which starts from the last one."""

Plan = Callable[[str], Any]
CROSSINGS = (
    ("circle 0.5", 5.0, 0.03),
    ("circle 0.5", 10.0, 0.03),
    ("circle 0.5", 20.0, 0.03),
    ("circle 0.75", 5.0, 0.03),
    ("line 0.1", 4.0, 0.36),
    ("line 0.2", 4.0, 0.36),
    ("line 0.2", 15.0, 0.36),
)
CASES: dict[str, tuple[Plan, float]] = {
    f"switch-off, {name}, CN {threshold:g}": (
        functools.partial(switch_off, name=name, threshold=threshold, ramp_down=ramp_down), INTEGRATED
    )
    for name, threshold, ramp_down in CROSSINGS
}  # fmt: skip
for _name in ("corner 0.025", "corner 0.013", "square"):
    _active = {"active": "accelerating"} if _name == "square" else {}
    for _lam in (0.0, 0.5):
        _plan = functools.partial(stepwise, motion=MOTIONS[_name], lam=_lam, **_active)
        CASES[f"stepwise, {_name}, lam {_lam:g}"] = (_plan, STEPPED)
for _name, _motion in MOTIONS.items():
    _dt = 1e-1 if _name.startswith("line") else 2e-2  # s
    for _objective in ("effort", "peak"):
        _plan = functools.partial(whole_trajectory, motion=_motion, objective=_objective, dt=_dt)
        CASES[f"whole trajectory, {_name}, {_objective}"] = (_plan, SEARCHED)
    _mesh = rp.Mesh(steps=6, refinements=0) if _name == "line 0.2" else rp.Mesh(steps=20)
    CASES[f"least time, {_name}"] = (functools.partial(least_time, motion=_motion, mesh=_mesh), SEARCHED)
TRIED = {
    "switch-off, circle 0.5, CN 5",
    "switch-off, line 0.2, CN 15",
    "stepwise, corner 0.025, lam 0",
    "stepwise, square, lam 0.5",
    "whole trajectory, line 0.2, effort",
    "whole trajectory, line 0.2, peak",
    "whole trajectory, corner 0.025, effort",
    "whole trajectory, corner 0.025, peak",
    "least time, line 0.2",
}
"""By ``make test``: each planner, and of those that take both machines all but the slowest on each."""


def values_of(plan: Any) -> dict[str, np.ndarray]:
    """Return what makes a plan: times, platform, carriers, efforts and carrier forces."""
    motion, carriers = plan.motion, plan.carriers
    return {"t": plan.t, "x": motion.x, "xd": motion.xd, "xdd": motion.xdd, "s": carriers.s, "sd": carriers.sd,
            "sdd": carriers.sdd, "tau": plan.tau, "carrier_force": plan.carrier_force}  # fmt: skip


@pytest.mark.long_for(*sorted(CASES.keys() - TRIED))
@pytest.mark.parametrize("case", CASES)
def test_each_backend_plans_each_case_of_the_thesis_alike(case: str) -> None:
    """Same samples, same status, same phases and statuses of samples, and the same numbers to the case's tolerance."""
    make, tolerance = CASES[case]
    plans = {backend: make(backend) for backend in BACKENDS}
    first = plans.pop("virtual work")
    largest = {name: np.abs(value).max() for name, value in values_of(first).items()}
    assert np.isfinite(first.tau).all()
    assert largest["s"] > 1e-4  # m: the carriers move
    for backend, plan in plans.items():
        assert plan.status is first.status, backend
        np.testing.assert_array_equal(plan.phase, first.phase, err_msg=backend)
        np.testing.assert_array_equal(plan.sample_status, first.sample_status, err_msg=backend)
        for name, value in values_of(plan).items():
            expected = values_of(first)[name]
            np.testing.assert_allclose(
                value, expected, rtol=0.0, atol=tolerance * largest[name], err_msg=f"{backend}: {name}"
            )


@pytest.mark.parametrize("name", [name for name, motion in MOTIONS.items() if motion.robot == "2rpr"])
@pytest.mark.parametrize("backend", BACKENDS)
def test_the_stepwise_planner_refuses_to_cross(backend: str, name: str) -> None:
    """It needs the inverse of W at every step; the error says so, and when."""
    with pytest.raises(InfeasiblePlanError, match="type II singularity") as refused:
        rp.plan_stepwise(dynamics_of(backend, "2rpr"), MOTIONS[name].make().sample(2e-2))
    assert "plan_whole_trajectory" in str(refused.value)


# --- the numbers of the thesis -------------------------------------------------------------------------------------

REBUILT = {
    ("circle 0.5", 5.0, 0.03): (("0.382", "0.967"), ("2.37", "2.74")),
    ("circle 0.5", 10.0, 0.03): (("0.435", "0.915"), ("5.3", "5.6")),
    ("circle 0.5", 20.0, 0.03): (("0.47", "0.88"), ("7.6", "7.8")),
    ("circle 0.75", 5.0, 0.03): (("0.27", "0.66"), ("3.5", "4.3")),
    ("line 0.1", 4.0, 0.36): (None, ("0.012", "0.014")),
    ("line 0.2", 4.0, 0.36): (None, ("0.030", "0.045")),
    ("line 0.2", 15.0, 0.36): (None, ("0.049", "0.060")),
}
"""Motors off and on again, s, and efforts as they begin to fall, N: as a rebuild of chapter 3 that shares no code with
the package prints them."""

CORNER_JUMPS = np.array([0.8, 0.8 + 0.5 * np.pi * 0.025 / 0.2])
"""Times at which the wide corner begins and ends, s: the acceleration of the platform jumps there."""

GRID = 1e-3
"""Step of the rebuild, s: it notices an instant up to one step late."""


def half_a_digit(printed: str) -> float:
    """Return half a unit of the last digit of a printed number."""
    return 0.5 * 10.0 ** -len(printed.partition(".")[2])


@pytest.mark.parametrize("crossing", REBUILT, ids=str)
def test_crossings_of_the_thesis(crossing: tuple[str, float, float]) -> None:
    name, threshold, ramp_down = crossing
    times, efforts = REBUILT[crossing]
    plan = switch_off("rnea", name=name, threshold=threshold, ramp_down=ramp_down)
    (window,) = plan.diagnostics["windows"]
    for key, printed in zip(("entry", "exit"), times or (), strict=False):
        assert window[key] == pytest.approx(float(printed), abs=half_a_digit(printed) + GRID)
    begin, end = (np.abs(window[key]) for key in ("effort_at_ramp_start", "parked_effort_at_entry"))
    late = GRID * np.abs(end - begin) / ramp_down
    for effort, printed, change in zip(begin, efforts, late, strict=True):
        assert effort == pytest.approx(float(printed), abs=half_a_digit(printed) + change)
    motors_off = (plan.t > window["entry"] + 1e-9) & (plan.t < window["exit"] - 1e-9)
    assert motors_off.sum() > 10
    np.testing.assert_allclose(plan.tau[motors_off], 0.0, atol=1e-9)
    condition = np.linalg.cond(dynamics_of("rnea", "2rpr").reduce(plan.motion).W)
    assert (condition[~motors_off & (np.abs(plan.t - window["entry"]) > GRID)] < 1.01 * threshold).sum() > 10
    assert np.interp(window["entry"], plan.t, condition) == pytest.approx(threshold, rel=1e-3)


def test_the_track_is_left_as_the_thesis_does_not_say() -> None:
    """With CN 5 carrier 1 is beyond its 0.2 m when the motors come back, with CN 10 and 20 it is not."""
    farthest = {}
    for name, threshold, ramp_down in CROSSINGS[:4]:
        plan = switch_off("rnea", name=name, threshold=threshold, ramp_down=ramp_down)
        (window,) = plan.diagnostics["windows"]
        farthest[name, threshold] = abs(window["carriers_at_exit"]["s"][0])
    expected = {("circle 0.5", 5.0): 0.247, ("circle 0.5", 10.0): 0.134, ("circle 0.5", 20.0): 0.084,
                ("circle 0.75", 5.0): 0.260}  # fmt: skip
    assert farthest == pytest.approx(expected, abs=half_a_digit("0.247") + 1e-5)  # the last step of the rebuild


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize(("name", "bare"), [("corner 0.025", (2.3, 3.0, 2.9)), ("corner 0.013", (4.6, 5.9, 5.6))])
def test_corners_of_the_thesis(name: str, bare: tuple[float, ...], backend: str) -> None:
    """Peaks of the baseline, N·m, every 10 ms; carriers that are parked cost a multiple of it."""
    samples = MOTIONS[name].make().sample(0.01)
    peaks = {}
    for carriers in (False, True):
        efforts = rp.distribute(dynamics_of(backend, "3rrr", carriers=carriers).reduce(samples))
        peaks[carriers] = np.abs(efforts.tau).max(axis=0)
    np.testing.assert_allclose(peaks[False], bare, atol=0.055)  # half the last printed digit
    if name == "corner 0.025":
        assert (peaks[True] > 7.5).all()
        assert (peaks[True] < 13.0).all()


@pytest.mark.parametrize("lam", [pytest.param(0.0, marks=pytest.mark.long), 0.5])
def test_three_of_eight_working_modes_meet_no_limit(lam: float) -> None:
    """Round the wide corner, in the thesis's steps, which see each jump of the acceleration from one side.

    In those modes the torque is λ times that of the baseline, except in the steps across the jumps.
    """
    free = []
    for mode in THREE_RRR.modes:
        moving, bare = (
            rp.VirtualWork(rp.load_robot("3rrr", working_mode=mode, carriers=carriers)) for carriers in (True, False)
        )
        samples = reference.corner(0.025).sample(0.01, two_sided=False)
        plan = rp.plan_stepwise(moving, samples, objective=rp.Objective(lam=lam, baseline=bare))
        if plan.diagnostics["bounds"]:
            continue
        free.append(mode)
        aim = lam * rp.distribute(bare.reduce(samples)).tau
        settled = np.abs(samples.t[:, None] - CORNER_JUMPS).min(axis=1) > 0.011
        np.testing.assert_allclose(plan.tau[: len(aim)][settled], aim[settled], atol=1e-6)
    assert free == [(1, -1, 1), (1, -1, -1), (-1, -1, -1)]


# --- pictures ------------------------------------------------------------------------------------------------------


def test_a_plan_is_animated_without_a_display(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """``rp.show`` as in the notebooks: what the browser is sent moves the end-effector along the planned path."""
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    plan = switch_off("virtual work", name="circle 0.5", threshold=5.0, ramp_down=0.03)
    view = rp.show(plan)
    assert view._repr_html_().startswith("<iframe")
    view.save(tmp_path / "plan.html")
    page = (tmp_path / "plan.html").read_text(encoding="utf-8")
    assert not re.findall(r"<(?:script|link|img)[^>]*(?:src|href)=\"(?!data:)", page)  # it plays offline
    packed = json.loads(max(re.findall(r"\[(?:\"[A-Za-z0-9+/=]+\"(?:, )?)+\]", page), key=len))
    messages = [umsgpack.unpackb(base64.b64decode(text)) for text in packed]
    (animation,) = [message for message in messages if message.get("type") == "set_animation"]
    clips = {entry["path"]: entry["clip"]["tracks"] for entry in animation["animations"]}

    def positions(joint: str) -> tuple[np.ndarray, np.ndarray]:
        """Return the times (K,), s, and the positions (K, 3), m, of the key frames of a body."""
        (tracks,) = [tracks for path, tracks in clips.items() if path.endswith(f"joint_{joint}")]
        (keys,) = [track["keys"] for track in tracks if track["name"] == ".position"]
        return np.array([key["time"] for key in keys]), np.array([key["value"] for key in keys])

    t, place = positions("slide_1")  # body of the piston: the end-effector is its origin
    assert t[0] == 0.0
    assert t[-1] == pytest.approx(plan.t[-1])
    path = np.column_stack([np.interp(t, plan.t, plan.motion.x[:, i]) for i in range(2)])
    np.testing.assert_allclose(place[:, :2], path, atol=1e-4)
    # carrier 1 sits s across the leg, on its track 0.1 m from the hinge at the origin
    t, place = positions("carrier_1")
    s = np.interp(t, plan.t, plan.carriers.s[:, 0])
    np.testing.assert_allclose(np.hypot(place[:, 0], place[:, 1]), np.hypot(0.1, s), atol=1e-4)


# --- a user's own robot --------------------------------------------------------------------------------------------

USERS_URDF = """\
<robot name="hoist">
  <link name="ground"/>
  <link name="barrel">{barrel}</link>
  <joint name="trunnion" type="revolute">
    <parent link="ground"/><child link="barrel"/><axis xyz="0 0 1"/>
    <limit lower="-3" upper="3" velocity="10" effort="0"/>
  </joint>
  <link name="rod">{rod}</link>
  <joint name="piston" type="prismatic">
    <parent link="barrel"/><child link="rod"/><axis xyz="1 0 0"/>
    <limit lower="0.1" upper="2" velocity="2" effort="500"/>
  </joint>
  <link name="hook">{hook}</link>
  <joint name="hook_mount" type="fixed"><parent link="rod"/><child link="hook"/></joint>
  <link name="crank">{crank}</link>
  <joint name="motor" type="revolute">
    <parent link="ground"/><child link="crank"/><origin xyz="0.9 0.1 0"/><axis xyz="0 0 1"/>
    <limit lower="-3" upper="4" velocity="10" effort="80"/>
  </joint>
  <link name="coupler">{coupler}</link>
  <joint name="elbow" type="revolute">
    <parent link="crank"/><child link="coupler"/><origin xyz="0.5 0 0"/><axis xyz="0 0 1"/>
    <limit lower="-3" upper="3" velocity="10" effort="0"/>
  </joint>
  <link name="coupler_end"/>
  <joint name="coupler_end_mount" type="fixed">
    <parent link="coupler"/><child link="coupler_end"/><origin xyz="0.7 0 0"/>
  </joint>
  <link name="weight">{weight}</link>
  <joint name="ballast" type="prismatic">
    <parent link="coupler"/><child link="weight"/><origin xyz="0.35 0 0"/><axis xyz="1 0 0"/>
    <limit lower="-0.2" upper="0.2" velocity="1" effort="100"/>
  </joint>
</robot>
"""
USERS_DECLARATION = """\
name: hoist
urdf: hoist.urdf
gravity: [0, -9.81, 0]
closures:
  - {frames: [hook, coupler_end], axes: [x, y]}
actuated: [piston, motor]
carriers:
  - {joint: ballast, acceleration: 5.0}
independent: {platform: hook, axes: [x, y]}
reference:
  platform: [0.5, 0.8]
  guess: {trunnion: 1.0, piston: 0.94, motor: 1.0, elbow: 1.6}
"""


def solid(mass: float, x: float, izz: float) -> str:
    """Return the inertial of a body with its centre of mass at x along the link, m; kg and kg·m²."""
    return (
        f'<inertial><origin xyz="{x} 0.01 0"/><mass value="{mass}"/>'
        f'<inertia ixx="{izz}" iyy="{izz}" izz="{izz}" ixy="0" ixz="0" iyz="0"/></inertial>'
    )


@pytest.fixture
def hoist(tmp_path: Path) -> Path:
    """A cylinder and a crank that carry a hook between them, with a weight that slides on the coupler."""
    bodies = {
        "barrel": solid(2.0, 0.2, 0.02),
        "rod": solid(1.0, -0.2, 0.01),
        "hook": solid(0.7, 0.0, 0.002),
        "crank": solid(1.5, 0.25, 0.03),
        "coupler": solid(1.2, 0.35, 0.05),
        "weight": solid(1.0, 0.0, 0.001),
    }
    (tmp_path / "hoist.urdf").write_text(USERS_URDF.format(**bodies), encoding="utf-8")
    (tmp_path / "robot.yaml").write_text(USERS_DECLARATION, encoding="utf-8")
    return tmp_path / "robot.yaml"


def test_the_validation_suite_takes_a_users_robot(hoist: Path) -> None:
    done = call("validate", "--robot", hoist, "--samples", 10, "--seed", 1, "--json")
    assert done.exit_code == 0, done.stderr
    report = json.loads(done.stdout)
    assert report["passed"]
    checks = {row["check"]: row for row in report["rows"]}
    assert {"power balance (rnea)", "inverse -> forward (rnea)"} <= set(checks), sorted(checks)
    assert all(row["samples"] > 0 for row in checks.values())


def test_a_users_robot_is_planned_alike_by_each_backend_it_has(hoist: Path) -> None:
    """Virtual work is for the machines of the thesis; the other two take any robot, and what they plan saves work."""
    robot = rp.load_robot(hoist)
    path = rp.trajectory.Line((0.45, 0.75), (0.6, 0.85))
    lift = rp.trajectory.Trajectory(path, rp.trajectory.RestToRest(path.length, duration=0.6))
    plans = [
        rp.plan_whole_trajectory(by(robot), lift, mesh=rp.Mesh(dt=2e-2))
        for by in (rp.RneaDynamics, rp.CompiledDynamics)
    ]
    one, other = map(values_of, plans)
    for name in one:
        np.testing.assert_allclose(other[name], one[name], rtol=0.0, atol=SEARCHED * np.abs(one[name]).max())
    parked = rp.distribute(rp.RneaDynamics(robot).reduce(plans[0].motion)).tau
    squares = [(tau**2).sum(axis=1) for tau in (one["tau"], parked)]
    planned, still = (np.trapezoid(square, one["t"]) for square in squares)
    assert planned < still
