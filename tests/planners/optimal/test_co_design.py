"""Machine and motion together: gradients of optima against plans made anew, machines against their neighbours."""

from __future__ import annotations

from functools import cache, partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import redundancy_pin as rp
import redundancy_pin.planners.optimal.co_design as studied
from redundancy_pin.errors import InputError
from redundancy_pin.planners.optimal.co_design import DesignTask, Search, co_design
from redundancy_pin.robot import Robot
from redundancy_pin.trajectory import reference

LIGHT = {"limits": rp.Limits(acceleration=20.0), "mesh": rp.Mesh(dt=0.02)}
WIDE = rp.Limits(acceleration=20.0, speed=5.0)


@cache
def circle() -> Any:
    return reference.circle(speed=0.5, ramp_time=0.2, ramp_length=0.05)


def crossing(**options: Any) -> DesignTask:
    return DesignTask(rp.VirtualWork(rp.load_robot("2rpr")), circle(), {**LIGHT, **options})


def heavy(**options: Any) -> DesignTask:
    """W τ = f with an f that the carriers have to make compatible: multipliers that are not small."""
    return DesignTask(rp.VirtualWork(rp.load_robot("2rpr", end_effector_mass=0.2)), circle(), {**LIGHT, **options})


def turning(**options: Any) -> DesignTask:
    return DesignTask(
        rp.VirtualWork(rp.load_robot("3rrr")), reference.corner(radius=0.025), {**LIGHT, "limits": WIDE, **options}
    )


def replanned(task: DesignTask, robot: Robot) -> float:
    plan = rp.plan_whole_trajectory(rp.VirtualWork(robot), task.motion, **task.options)
    assert plan.least_cost is not None
    return plan.least_cost


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "objective", "closeness"),
    [
        ("2rpr", "effort", {"track_offset": 1e-4, "base_distance": 1e-4, "track_half_length": 1e-4}),
        ("2rpr", "peak", {"track_offset": 1e-3, "track_half_length": 1e-3}),
        ("3rrr", "base_wrench", {"carrier_mass": 1e-4, "tail_length": 1e-4, "base_radius": 1e-3,
                                 "proximal_length": 8e-5}),
        ("3rrr", "effort", {"carrier_mass": 1e-4, "tail_length": 1e-4, "distal_length": 1e-4}),
        ("3rrr", "peak", {"carrier_mass": 1e-4, "tail_length": 1e-4, "proximal_length": 2e-3}),
    ],
    ids=["2rpr-effort", "2rpr-peak", "3rrr-base_wrench", "3rrr-effort", "3rrr-peak"],
)  # fmt: skip
def test_gradient_of_an_optimum(name: str, objective: str, closeness: dict[str, float]) -> None:
    """By the envelope theorem, through two type II singularities in the first ones; against plans made anew."""
    task = (turning if name == "3rrr" else heavy if objective == "effort" else crossing)(objective=objective)
    if objective == "base_wrench":
        task = turning(objective=rp.Objective(objective, base_point=(0.9, -0.4, 0.0)))
    robot = task.dynamics.robot
    values = {key: float(robot.parameters[key]) for key in closeness}
    search = Search((task,), {key: (0.5 * value, 2.0 * value) for key, value in values.items()})
    gradient = search.machine(search.start).gradients[0]
    for i, (key, close) in enumerate(closeness.items()):
        h = 1e-3 * values[key]
        up, down = (replanned(task, rp.with_parameters(robot, **{key: values[key] + by})) for by in (h, -h))  # type: ignore[arg-type]
        assert gradient[i] == pytest.approx((up - down) / (2.0 * h), rel=close), key


def test_gradient_of_the_least_energy() -> None:
    """The rates of the main actuators change with the machine too."""
    line = rp.trajectory.from_points([[0.15, 0.3], [0.2, -0.2]], speed=0.5, ramp_time=0.2)
    task = DesignTask(heavy().dynamics, line, {**LIGHT, "mesh": rp.Mesh(dt=0.1), "objective": "energy"})
    search = Search((task,), {"base_distance": (0.3, 0.7)})
    machines = (rp.with_parameters(task.dynamics.robot, base_distance=0.5 + by) for by in (1e-4, -1e-4))
    up, down = (replanned(task, robot) for robot in machines)
    assert search.machine(search.start).gradients[0, 0] == pytest.approx((up - down) / 2e-4, rel=1e-4)


@pytest.mark.long
@pytest.mark.parametrize("name", ["proximal_length", "distal_length"])
def test_gradient_where_the_singular_instant_moves(name: str) -> None:
    """Nodes move with it, so that both sides err by the first order of the step: their limits are compared."""
    across = rp.trajectory.from_points([[1.4, 0.4, 0.0], [1.6, 0.4, 0.0]], speed=0.2, ramp_time=0.4)
    steps = (0.02, 0.005)
    got, want = [], []
    for dt in steps:
        task = DesignTask(turning().dynamics, across, {"limits": WIDE, "mesh": rp.Mesh(dt=dt)})
        search = Search((task,), {name: (0.5, 1.5)})
        got.append(search.machine(search.start).gradients[0, 0])
        machines = (rp.with_parameters(task.dynamics.robot, **{name: 1.0 + by}) for by in (1e-3, -1e-3))  # type: ignore[arg-type]
        up, down = (replanned(task, robot) for robot in machines)
        want.append((up - down) / 2e-3)
    limits = [(4.0 * fine - coarse) / 3.0 for coarse, fine in (got, want)]
    assert limits[0] == pytest.approx(limits[1], rel=1e-2)


def test_massless_machines_in_closed_form() -> None:
    """Without other masses f is proportional to that of the carriers: effort to its square, and any less is better."""
    result = co_design([crossing(mesh=rp.Mesh(dt=0.06))], {"carrier_mass": (0.9, 2.0)}, iterations=2)
    assert result.parameters == {"carrier_mass": 0.9}
    assert result.values[0] == pytest.approx(0.81 * result.before[0], rel=1e-6)
    assert result.gradient[0, 0] == pytest.approx(2.0 * result.values[0] / 0.9, rel=1e-6)
    assert result.at_bounds == ("carrier_mass",)
    assert result.optimal
    assert result.plans[0].robot.arguments["carrier_mass"] == 0.9
    assert result.history[0]["cost"] == 1.0


@pytest.mark.long
def test_no_neighbour_is_better_and_two_tasks_share_a_machine() -> None:
    """At a kink of the least peaks, where neither task has a gradient of zero."""
    tasks = [turning(objective="peak"), turning(objective="effort")]
    bounds = {"carrier_mass": (0.2, 5.0), "tail_length": (0.2, 1.2)}
    result = co_design(tasks, bounds)
    assert result.optimal
    robot = tasks[0].dynamics.robot

    def cost(**numbers: float) -> float:
        machine = rp.with_parameters(robot, **{**result.parameters, **numbers})  # type: ignore[arg-type]
        values = [replanned(task, machine) for task in tasks]
        return float(np.mean(np.array(values) / result.before))

    here = cost()
    assert here == pytest.approx(result.history[-1]["cost"], rel=1e-4)
    assert here < 0.6
    for name, (low, high) in bounds.items():
        for by in (-0.02, 0.02):
            at = result.parameters[name] + by * (high - low)
            if low <= at <= high:
                assert cost(**{name: at}) > here * (1.0 - 5e-3), (name, by)


def test_a_search_stopped_by_machines_that_cannot_is_no_optimum(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first parameter can hardly grow, the second can: a trust region that shrank says nothing of it."""

    class Plane:
        start, names, rejected = np.array([0.5, 0.5]), ("first", "second"), 0
        slope = np.array([-0.1, -0.05])

        def machine(self, u: np.ndarray, near: object = None) -> Any:
            cost = 1.0 + float(self.slope @ u)
            return SimpleNamespace(u=u, cost=cost, slope=self.slope, values=[cost], gradients=self.slope[None],
                                   costs=(), at_bound=(False, False), parameters={})  # fmt: skip

        def machine_or_none(self, u: np.ndarray, near: object) -> Any:
            return self.machine(u) if u[0] <= self.most else None

        def record(self, machine: Any) -> dict[str, float]:
            return {"cost": machine.cost}

        def __init__(self, most: float) -> None:
            self.most = most

    for most, optimal in ((0.5001, False), (1.0, True)):
        monkeypatch.setattr(studied, "Search", lambda *_, most=most: Plane(most))
        assert co_design([crossing()], {"carrier_mass": (0.9, 2.0)}).optimal is optimal


def test_machines_that_cannot_are_passed_over() -> None:
    """The corner is out of reach of short proximal links."""
    search = Search((turning(),), {"proximal_length": (0.1, 1.0)})
    here = search.machine(search.start)
    assert search.machine_or_none(np.array([0.0]), here) is None
    assert search.rejected == 1


@pytest.mark.parametrize(
    ("tasks", "design", "message"),
    [
        (lambda: [], {"carrier_mass": (0.5, 2.0)}, "no task"),
        (lambda: [crossing()], {}, "Nothing is to be designed"),
        (lambda: [crossing()], {"carrier_mas": (0.5, 2.0)}, "carrier_mas"),
        (lambda: [crossing()], {"carriers": (0.0, 1.0)}, "no number"),
        (lambda: [crossing()], {"carrier_mass": (2.0, 0.5)}, "range of carrier_mass"),
        (lambda: [crossing()], {"carrier_mass": (2.0, 3.0)}, "has 1"),
        (lambda: [crossing(objectiv="peak")], {"carrier_mass": (0.5, 2.0)}, "objectiv"),
        (partial(list, [([], None)]), {"carrier_mass": (0.5, 2.0)}, "list was given"),
        (partial(list, [("2rpr",)]), {"carrier_mass": (0.5, 2.0)}, "1 entries"),
        (lambda: [crossing().dynamics], {"carrier_mass": (0.5, 2.0)}, "A task was expected"),
        (lambda: [(crossing().dynamics, circle(), None)], {"carrier_mass": (0.5, 2.0)}, "task's options"),
        (lambda: None, {"carrier_mass": (0.5, 2.0)}, "sequence of tasks"),
        (lambda: [crossing()], ["carrier_mass"], "parameters to ranges"),
    ],
)
def test_bad_input_is_named(tasks: Any, design: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        co_design(tasks(), design)


def test_twice_the_feed_round_the_corner_under_the_same_torque() -> None:
    """Carriers parked at both ends; the baseline's torque is that of its own dynamics along the same motion."""
    slow, fast = (reference.corner(radius=0.025, speed=speed, ramp_time=0.4) for speed in (0.2, 0.4))
    bare = rp.VirtualWork(rp.load_robot("3rrr", carriers=False, working_mode=(1, 1, 1)))
    limit, needed = (np.abs(rp.distribute(bare.reduce(m.sample(1e-3))).tau).max() for m in (slow, fast))
    robot = rp.load_robot("3rrr", carrier_mass=0.6, tail_length=0.56, working_mode=(1, 1, 1))
    plan = rp.plan_whole_trajectory(
        rp.VirtualWork(robot),
        fast,
        objective="peak",
        mesh=rp.Mesh(dt=0.02, refinements=1),
        limits=rp.Limits(acceleration=60.0, speed=5.0),
    )
    assert plan.status.value in ("ok", "unresolved")
    assert plan.peak_effort.max() < 0.75 * limit < 0.2 * needed
    np.testing.assert_allclose(plan.carriers.s[[0, -1]], 0.0, atol=1e-9)
    np.testing.assert_allclose(plan.carriers.sd[[0, -1]], 0.0, atol=1e-9)
    check = np.abs(rp.distribute(rp.RneaDynamics(robot).reduce(plan.motion, plan.carriers)).tau).max()
    assert check <= plan.peak_effort.max() * (1.0 + 1e-6)
    assert plan.carrier_energy > plan.main_energy  # the price
