"""Optima of whole trajectories and of least time against IPOPT on full models that share nothing with the planner.

The models (``symbolic_mechanisms``) have equations of motion of their own, which casadi differentiates, and conditions
at singular poses of their own (``symbolic_plans``).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import symbolic_mechanisms
import symbolic_plans
import zoo

import redundancy_pin as rp
from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.planners.plan import Plan
from redundancy_pin.robot import Robot
from redundancy_pin.status import ResultStatus
from redundancy_pin.trajectory import Line, SpeedProfile, Trajectory, reference

SAME = 1e-3
"""Relative difference of the objectives; found are 1e-6 or less."""

OF_TWO_RPR = {"speed": 2.5, "track": 0.2, "acceleration": 10.0}
OF_THREE_RRR = {"speed": 1.0, "track": 1.0, "acceleration": 7.0}
OF_FIVE_BAR = {"speed": 1.0, "track": 0.5, "acceleration": 7.0}
OF_ARMS = {"speed": 8.0, "track": 1.2, "acceleration": 60.0}
"""The machines' own."""

HEAVY = {"end_effector_mass": 0.5, "cylinder_mass": 0.3}


def straight(start: Any, end: Any, speed: float) -> Trajectory:
    path = Line(start, end)
    return Trajectory(path, SpeedProfile(path.length, speed, 0.2))


def backend(robot: Robot) -> Any:
    return rp.CompiledDynamics(robot) if robot.closed_form is None else rp.VirtualWork(robot)


def require_optimal(plan: Plan, machine: Any, trajectory: Trajectory, objective: str, limits: Any) -> None:
    assert plan.findings.optimal
    theirs, _ = symbolic_plans.solve(machine, trajectory, plan, objective, limits)
    np.testing.assert_allclose(plan.least_cost, theirs, rtol=SAME)


CIRCLE = reference.circle(0.5, 0.2, 0.05)
CASES: dict[str, tuple[Robot, Any, Trajectory, Any, float, int]] = {
    "circle": (zoo.robot_of("2rpr"), symbolic_mechanisms.two_rpr(), CIRCLE, OF_TWO_RPR, 0.04, 2),
    "with masses": (zoo.robot_of("2rpr", **HEAVY), symbolic_mechanisms.two_rpr(**HEAVY), CIRCLE, OF_TWO_RPR, 0.04, 2),
    "corner": (
        zoo.robot_of("3rrr"), symbolic_mechanisms.three_rrr(), reference.corner(0.013), OF_THREE_RRR, 0.09, 0,
    ),
    "wide corner": (
        zoo.robot_of("3rrr"), symbolic_mechanisms.three_rrr(), reference.corner(0.025), OF_THREE_RRR, 0.09, 0,
    ),
    "five-bar": (
        zoo.robot_of("five_bar"), symbolic_mechanisms.five_bar(), straight((0.25, 0.6), (0.32, 0.3), 0.3), OF_FIVE_BAR,
        0.07, 1,
    ),
    "turning": (
        zoo.robot_of("2rpr", arm_length=0.15, **HEAVY), symbolic_mechanisms.two_rpr(arm=0.15, **HEAVY),
        straight((0.1, 0.45), (0.4, 0.25), 0.5), OF_ARMS, 0.05, 0,
    ),
    "turning circle": (
        zoo.robot_of("2rpr", arm_length=0.15, **HEAVY), symbolic_mechanisms.two_rpr(arm=0.15, **HEAVY), CIRCLE, OF_ARMS,
        0.05, 2,
    ),
}  # fmt: skip
"""Robot, full model, motion, limits, step, s, and how many singular instants there are."""

QUICK = {("circle", "effort"), ("corner", "effort"), ("five-bar", "effort"), ("turning", "peak")}


@pytest.mark.parametrize(
    ("name", "objective"),
    [
        pytest.param(name, objective, marks=() if (name, objective) in QUICK else pytest.mark.long)
        for name in CASES
        for objective in ("effort", "peak")
    ],
)
def test_whole_trajectories(name: str, objective: str) -> None:
    robot, machine, trajectory, limits, dt, singular = CASES[name]
    plan = rp.plan_whole_trajectory(
        backend(robot),
        trajectory,
        objective=rp.Objective(objective, calm=0.0),
        mesh=rp.Mesh(dt=dt, refinements=0),
        solver=rp.Solver(starts=4 if name == "turning circle" else 1),
    )
    assert len(plan.findings.singular_instants) == singular
    if name == "turning circle":  # it has three optima; IPOPT ends at the second with the full model
        theirs, _ = symbolic_plans.solve(machine, trajectory, plan, objective, limits)
        assert plan.least_cost <= (1.0 + SAME) * theirs
        return
    require_optimal(plan, machine, trajectory, objective, limits)


@pytest.mark.long_for("free")
@pytest.mark.parametrize("end", ["free", "datum"])
def test_least_time_of_a_line_with_carriers(end: Any) -> None:
    """Nodes in time in place of nodes on the path."""
    first, last = (0.1, 0.45), (0.4, 0.25)
    plan = rp.plan_time_optimal(
        rp.VirtualWork(zoo.robot_of("2rpr", **HEAVY)),
        Line(first, last),
        limits=rp.Limits(effort=2.0),
        end=end,
        mesh=rp.Mesh(steps=40),
    )
    theirs = symbolic_plans.least_time(
        symbolic_mechanisms.two_rpr(**HEAVY), first, last, 2.0, OF_TWO_RPR, end == "datum", 40
    )
    assert plan.status is ResultStatus.OK
    np.testing.assert_allclose(plan.t[-1], theirs, rtol=SAME)


def random_two_rpr(rng: np.random.Generator) -> tuple[Any, Any, Trajectory, float]:
    masses = {
        "base_distance": rng.uniform(0.4, 0.6),
        "track_offset": rng.uniform(0.05, 0.15),
        "carrier_mass": rng.uniform(0.5, 2.0),
        "end_effector_mass": rng.uniform(0.0, 0.5),
        "cylinder_mass": rng.uniform(0.0, 0.4),
        "piston_mass": rng.uniform(0.0, 0.2),
    }
    start = rng.uniform((0.05, 0.25), (0.15, 0.5))
    low, high = ((0.05, -0.5), (0.45, -0.25)) if rng.random() < 0.5 else ((0.3, 0.25), (0.45, 0.5))
    trajectory = straight(start, rng.uniform(low, high), rng.uniform(0.2, 0.6))
    return backend(zoo.robot_of("2rpr", **masses)), symbolic_mechanisms.two_rpr(**masses), trajectory, 0.2


def random_five_bar(rng: np.random.Generator) -> tuple[Any, Any, Trajectory, float]:
    masses = {
        "proximal_mass": rng.uniform(0.2, 1.0),
        "distal_mass": rng.uniform(0.2, 1.0),
        "end_effector_mass": rng.uniform(0.0, 0.5),
        "carrier_mass": rng.uniform(0.5, 2.0),
    }
    trajectory = straight(
        rng.uniform((0.15, 0.5), (0.35, 0.65)), rng.uniform((0.15, 0.25), (0.35, 0.38)), rng.uniform(0.2, 0.5)
    )
    return backend(zoo.robot_of("five_bar", **masses)), symbolic_mechanisms.five_bar(**masses), trajectory, 0.5


def random_three_rrr(rng: np.random.Generator) -> tuple[Any, Any, Trajectory, float]:
    masses = {
        "proximal_mass": rng.uniform(0.5, 2.0),
        "distal_mass": rng.uniform(0.5, 2.0),
        "platform_mass": rng.uniform(0.2, 1.0),
        "carrier_mass": rng.uniform(1.0, 4.0),
    }
    mode = tuple(int(sign) for sign in rng.choice([-1, 1], 3))
    robot = zoo.robot_of("3rrr", working_mode=mode, **masses)
    trajectory = reference.corner(rng.uniform(0.015, 0.04), rng.uniform(0.15, 0.25), 0.3)
    return backend(robot), symbolic_mechanisms.three_rrr(mode, **masses), trajectory, 1.0


RANDOM = (random_two_rpr, random_five_bar, random_three_rrr)

WIDER = 5
"""Times that random limits of speed and acceleration are doubled where no motion keeps them."""


@pytest.mark.parametrize("seed", [pytest.param(s, marks=() if s == 3 else pytest.mark.long) for s in range(69)])
def test_random_machines_with_random_limits(seed: int) -> None:
    rng = np.random.default_rng(seed)
    dynamics, machine, trajectory, track = RANDOM[seed % 3](rng)
    limits = {
        "speed": rng.uniform(0.5, 1.5), "track": track * rng.uniform(0.4, 1.0), "acceleration": rng.uniform(5, 12)
    }  # fmt: skip
    objective, dt = ("effort", "peak")[seed // 3 % 2], trajectory.duration / (20 if seed < 9 else 60)
    for _ in range(WIDER):
        ends = (-limits["track"], limits["track"])
        try:
            plan = rp.plan_whole_trajectory(
                dynamics,
                trajectory,
                objective=rp.Objective(objective, calm=0.0),
                mesh=rp.Mesh(dt=dt, refinements=0),
                limits=rp.Limits(speed=limits["speed"], track=ends, acceleration=limits["acceleration"]),
            )
        except InfeasiblePlanError:
            limits["speed"], limits["acceleration"] = 2.0 * limits["speed"], 2.0 * limits["acceleration"]
            continue
        require_optimal(plan, machine, trajectory, objective, limits)
        return
    pytest.fail("infeasible however wide the limits")


@pytest.mark.parametrize("of", RANDOM)
def test_the_full_models_balance_as_the_backends_do(of: Any) -> None:
    """Both answer the same question: away from a plan, at a random carrier motion, W τ − f vanishes for W⁻¹ f."""
    rng = np.random.default_rng(1)
    dynamics, machine, trajectory, track = of(rng)
    motion = trajectory.sample(trajectory.duration / 7)
    carriers = rp.CarrierMotion(*(rng.uniform(-track, track, (len(motion), machine.k)) for _ in range(3)))
    tau = rp.distribute(dynamics.reduce(motion, carriers)).tau
    for i in range(len(motion)):
        parts = (motion.x, motion.xd, motion.xdd, carriers.s, carriers.sd, carriers.sdd, tau)
        left = np.asarray(machine.balance(*(part[i] for part in parts))).ravel()
        # the condition of W multiplies the rounding of both
        np.testing.assert_allclose(left, 0.0, atol=1e-8 * max(1.0, np.abs(tau[i]).max()))
