"""Robots without carriers designed: a slider-crank against Lagrange's equation and the balance of energy by hand,
gradients against robots that are made anew, optima against a search by brute force.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from doc_blocks import blocks_of
from scipy.optimize import minimize

import redundancy_pin as rp
from redundancy_pin.errors import InfeasiblePlanError, InputError
from redundancy_pin.planners.optimal import refine, transcription
from redundancy_pin.planners.optimal.co_design import DesignTask, Search, compare_machines
from redundancy_pin.trajectory import Line, RestToRest, Trajectory

ROOT = Path(__file__).parents[3]
CRANK = 0.1
ACROSS = [[0.15, 0.3], [0.15, 0.55]]
"""Points of the five-bar on both sides of a type II singularity, m."""
SLIDER_MASS, ROD_DENSITY, GRAVITY = 2.0, 6.0, 9.81
"""kg, kg/m, m/s²: those of the file on the page."""


@pytest.fixture(scope="module")
def crank_and_rod(tmp_path_factory: pytest.TempPathFactory) -> rp.Robot:
    """Return the slider-crank of docs/design.md."""
    folder = tmp_path_factory.mktemp("page")
    for block in blocks_of(ROOT / "docs" / "design.md", "docs/design.md"):
        if "file" in block.marks:
            path = folder / block.marks["file"]
            path.parent.mkdir(exist_ok=True)
            path.write_text(block.text, encoding="utf-8")
    return rp.load_robot(folder / "crank_and_rod")


def turn(duration: float = 1.0) -> Trajectory:
    return Trajectory(Line([0.0], [2.0 * np.pi]), RestToRest(2.0 * np.pi, duration=duration))


def torque(rod: float, counterweight: float, t: np.ndarray, duration: float = 1.0) -> np.ndarray:
    """Return the crank's torque by M(θ) θ̈ + ½ M'(θ) θ̇² + V'(θ), from the geometry of the slider-crank alone."""
    u, L = t / duration, 2.0 * np.pi
    th = L * (10.0 * u**3 - 15.0 * u**4 + 6.0 * u**5)
    w = L / duration * (30.0 * u**2 - 60.0 * u**3 + 30.0 * u**4)
    alpha = L / duration**2 * (60.0 * u - 180.0 * u**2 + 120.0 * u**3)
    r, m = CRANK, ROD_DENSITY * rod
    s, c = np.sin(th), np.cos(th)
    sin_b = r * s / rod  # of the rod against x
    cos_b = np.sqrt(1.0 - sin_b**2)
    b1 = r * c / (rod * cos_b)
    b2 = (-r * s / rod + sin_b * b1**2) / cos_b
    x1, x2 = -r * s - rod * sin_b * b1, -r * c - rod * (cos_b * b1**2 + sin_b * b2)
    gx1, gx2 = -r * s - rod / 2.0 * sin_b * b1, -r * c - rod / 2.0 * (cos_b * b1**2 + sin_b * b2)
    gy1, gy2 = rod / 2.0 * cos_b * b1, rod / 2.0 * (cos_b * b2 - sin_b * b1**2)
    inertia = m * rod**2 / 12.0
    M = counterweight * r**2 + inertia * b1**2 + m * (gx1**2 + gy1**2) + SLIDER_MASS * x1**2
    half_dM = inertia * b1 * b2 + m * (gx1 * gx2 + gy1 * gy2) + SLIDER_MASS * x1 * x2
    return M * alpha + half_dM * w**2 + GRAVITY * (m * gy1 - counterweight * r * c)


def peak(rod: float, counterweight: float, samples: int = 4001) -> float:
    return float(np.abs(torque(rod, counterweight, np.linspace(0.0, 1.0, samples))).max())


def least_time(rod: float, counterweight: float, most: float, samples: int = 4000) -> float:
    """Return the least time of a turn from rest to rest with a torque of at most ``most``, N·m.

    The motor pushes as much as it can, and then brakes as much. Its work is the energy of the mechanism:
    ½ M(θ) θ̇² + V(θ) = T θ before the change, T (2π − θ) after it.
    """
    phase = np.pi * (np.arange(samples) + 0.5) / samples
    th, step = np.pi * (1.0 - np.cos(phase)), np.pi * np.sin(phase) * np.pi / samples
    r, m = CRANK, ROD_DENSITY * rod
    s, c = np.sin(th), np.cos(th)
    sin_b = r * s / rod
    cos_b = np.sqrt(1.0 - sin_b**2)
    b1 = r * c / (rod * cos_b)
    x1, gx1, gy1 = -r * s - rod * sin_b * b1, -r * s - rod / 2.0 * sin_b * b1, rod / 2.0 * cos_b * b1
    M = counterweight * r**2 + m * rod**2 / 12.0 * b1**2 + m * (gx1**2 + gy1**2) + SLIDER_MASS * x1**2
    kinetic = most * np.minimum(th, 2.0 * np.pi - th) - GRAVITY * r * s * (m / 2.0 - counterweight)
    return float((step / np.sqrt(2.0 * kinetic / M)).sum()) if kinetic.min() > 0.0 else np.inf


def cost(task: DesignTask, robot: rp.Robot) -> float:
    """Return what a task costs by a robot that was made anew."""
    name = next(key for key, value in robot.parameters.items() if not isinstance(value, (bool, str)))
    value = float(robot.parameters[name])  # type: ignore[arg-type]
    search = Search((DesignTask(rp.CompiledDynamics(robot), task.motion, task.options),), {name: (value, value + 1.0)})
    return float(search.machine(search.start).values[0])


def test_least_peak_torque_of_a_slider_crank(crank_and_rod: rp.Robot) -> None:
    """The example of the page: before, after, and that no length and mass within the bounds is better."""
    bounds = {"rod_length": (0.2, 0.6), "counterweight": (0.0, 4.0)}
    result = rp.co_design([(crank_and_rod, turn(), {"objective": "peak"})], bounds)
    rod, counterweight = result.parameters["rod_length"], result.parameters["counterweight"]
    assert result.before[0] == pytest.approx(peak(0.4, 0.0), rel=1e-6)
    assert result.values[0] == pytest.approx(peak(rod, counterweight), rel=1e-6)
    grid = ((peak(a, b, 401), a, b) for a in np.linspace(0.2, 0.6, 21) for b in np.linspace(0.0, 4.0, 41))
    best = minimize(lambda z: peak(*z), min(grid)[1:], method="Nelder-Mead", options={"xatol": 1e-6, "fatol": 1e-8})
    assert best.fun < 0.75 * result.before[0]
    assert result.values[0] == pytest.approx(best.fun, rel=5e-4)
    assert result.optimal
    assert result.at_bounds == ()
    plan = result.plans[0]
    assert plan.status.value == "ok"
    assert plan.robot.arguments["rod_length"] == rod
    np.testing.assert_allclose(plan.tau[:, 0], torque(rod, counterweight, plan.t), atol=1e-9)
    assert plan.peak_effort[0] == pytest.approx(result.values[0], rel=1e-9)
    assert rp.check_plan(plan, rp.RneaDynamics(rp.load_robot_of(plan, crank_and_rod.source))).passed


TURN = Line([0.0], [2.0 * np.pi])


@pytest.mark.long
def test_least_time_of_a_slider_crank(crank_and_rod: rp.Robot) -> None:
    """A weak motor that gravity hinders: the rod as short as it may be, a counterweight between its bounds."""
    most, first = 0.5, {"rod_length": 0.3, "counterweight": 0.8}
    options = {"objective": "time", "limits": rp.Limits(effort=most), "mesh": rp.Mesh(steps=60)}
    task = (rp.with_parameters(crank_and_rod, **first), TURN, options)  # type: ignore[arg-type]
    result = rp.co_design([task], {"rod_length": (0.2, 0.6), "counterweight": (0.0, 4.0)})
    assert result.before[0] == pytest.approx(least_time(*first.values(), most), rel=5e-3)
    assert result.values[0] == result.plans[0].t[-1]
    assert result.plans[0].peak_effort[0] <= 1.001 * most
    assert result.optimal
    assert result.at_bounds == ("rod_length",)
    grid = ((least_time(a, b, most, 400), a, b) for a in np.linspace(0.2, 0.6, 21) for b in np.linspace(0.0, 4.0, 41))
    _, rod, counterweight = min(grid)
    assert rod == 0.2
    best = minimize(lambda z: least_time(rod, z[0], most), [counterweight], method="Nelder-Mead")
    assert result.parameters["rod_length"] == 0.2
    found = least_time(0.2, result.parameters["counterweight"], most)
    assert found == pytest.approx(best.fun, rel=1e-3)
    assert result.values[0] == pytest.approx(found, rel=5e-3)


@pytest.mark.long_for("counterweight")
@pytest.mark.parametrize("name", ["rod_length", "counterweight"])
def test_gradient_of_least_time_against_the_balance_of_energy(crank_and_rod: rp.Robot, name: str) -> None:
    values = {"rod_length": 0.4, "counterweight": 0.5}
    robot = rp.with_parameters(crank_and_rod, **values)  # type: ignore[arg-type]
    task = DesignTask(robot, TURN, {"objective": "time", "limits": rp.Limits(effort=3.0), "mesh": rp.Mesh(steps=150)})
    search = Search((task,), {name: (0.2, 0.8)})
    ends = [least_time(*{**values, name: values[name] + by}.values(), 3.0) for by in (1e-4, -1e-4)]
    found = search.machine(search.start)
    assert found.values[0] == pytest.approx(least_time(*values.values(), 3.0), rel=5e-3)
    assert found.gradients[0, 0] == pytest.approx((ends[0] - ends[1]) / 2e-4, rel=5e-3)


QUICK: dict[str, tuple[str, dict[str, Any], Any, tuple[str, ...], dict[str, Any]]] = {
    "speeds": (
        "delta",
        {},
        rp.trajectory.Line([0.1, 0.0, -0.5], [-0.1, 0.1, -0.45]),
        ("arm_length", "platform_mass"),
        {"limits": rp.Limits(effort=30.0, actuator_speed=1.5)},
    ),
    "carriers through a singularity": (
        "2rpr",
        {"end_effector_mass": 0.5},
        rp.trajectory.reference.line().path,
        ("base_distance", "end_effector_mass"),
        # the first motor is at its limit there
        {"limits": rp.Limits(effort=(0.2, 1.0), acceleration=3.0), "end": "free"},
    ),
}


@pytest.mark.parametrize("name", QUICK)
def test_gradient_of_least_time_against_robots_made_anew(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """On the same places, with the same limits there, and nothing beside the time."""
    monkeypatch.setattr(refine, "LOWERED", 0)
    monkeypatch.setattr(transcription, "REGULARISATION_OF_TIME", 1e-7)
    file, numbers, path, names, options = QUICK[name]
    robot, options = rp.load_robot(file, **numbers), {**options, "mesh": rp.Mesh(steps=16, refinements=0)}
    values = {key: float(robot.parameters[key]) for key in names}  # type: ignore[arg-type]
    ranges = {key: (0.5 * value, 2.0 * value) for key, value in values.items()}
    search = Search((DesignTask(robot, path, {"objective": "time", **options}),), ranges)
    gradient = search.machine(search.start).gradients[0]
    for i, (key, value) in enumerate(values.items()):
        machines = (rp.with_parameters(robot, **{key: value * (1.0 + by)}) for by in (1e-3, -1e-3))  # type: ignore[arg-type]
        up, down = (rp.plan_time_optimal(machine, path, **options).t[-1] for machine in machines)
        assert gradient[i] == pytest.approx((up - down) / (2e-3 * value), rel=1e-4), key


def test_least_time_is_that_of_a_path(crank_and_rod: rp.Robot) -> None:
    quick = {"objective": "time", "limits": rp.Limits(effort=3.0)}
    with pytest.raises(InputError, match="path was expected"):
        rp.co_design([(crank_and_rod, turn().sample(0.01), quick)], {"rod_length": (0.2, 0.6)})
    with pytest.raises(InputError, match="at_most") as raised:
        rp.co_design([(crank_and_rod, turn(), {**quick, "at_most": {"energy": 1.0}})], {"rod_length": (0.2, 0.6)})
    assert "plan_time_optimal" in raised.value.remedy


def four_bar(folder: Path, old: str, new: str) -> rp.Robot:
    """Return the four-bar with another line in its declaration."""
    for path in (ROOT / "models" / "four_bar").iterdir():
        (folder / path.name).write_text(path.read_text(encoding="utf-8").replace(old, new), encoding="utf-8")
    return rp.load_robot(folder)


def driven_twice(folder: Path) -> rp.Robot:
    """Return the four-bar with a second motor at its rocker: two efforts for one degree of freedom."""
    return four_bar(folder, "actuated: [crank]", "actuated: [crank, rocker]")


CASES: dict[str, tuple[tuple[str, ...], Any]] = {
    "four_bar": (("coupler_length", "rocker_length", "rocker_mass"), turn()),
    "two motors": (("coupler_length", "rocker_length", "rocker_mass"), turn()),
    "delta": (
        ("arm_length", "rod_length", "platform_mass"),
        rp.trajectory.from_points([[0.1, 0.0, -0.5], [-0.1, 0.1, -0.45]], speed=0.5, ramp_time=0.2),
    ),
}
"""Numbers that are designed, and a motion."""

QUICKEST = {
    ("four_bar", "energy"),
    ("two motors", "objective4"),
    ("delta", "base_wrench"),
    ("four_bar", "peak"),
    ("four_bar", "effort"),
}
"""Each objective once, and each machine: rows of the objectives and of the machines are written once for all."""


@pytest.mark.long_for(
    *(
        f"{name}-{of}"
        for name in ("four_bar", "two motors", "delta")
        for of in ("peak", "effort", "energy", "base_wrench", "objective4")
        if (name, of) not in QUICKEST
    )
)
@pytest.mark.parametrize("objective", ["peak", "effort", "energy", "base_wrench", {"peak": 1.0, "effort_rate": 0.01}])
@pytest.mark.parametrize("name", CASES)
def test_gradients_against_robots_made_anew(name: str, objective: str | Mapping[str, float], tmp_path: Path) -> None:
    """Lengths change the joint angles of the same motion; the last digits are those of the differences."""
    robot = driven_twice(tmp_path) if name == "two motors" else rp.load_robot(name)
    names, motion = CASES[name]
    task = DesignTask(rp.CompiledDynamics(robot), motion, {"objective": objective, "mesh": rp.Mesh(dt=0.05)})
    values = {key: float(robot.parameters[key]) for key in names}  # type: ignore[arg-type]
    search = Search((task,), {key: (0.5 * value, 2.0 * value) for key, value in values.items()})
    gradient = search.machine(search.start).gradients[0]
    size = float(np.abs(gradient * np.array(list(values.values()))).max())
    for i, (key, value) in enumerate(values.items()):
        h = 1e-4 * value
        ends = [cost(task, rp.with_parameters(robot, **{key: value + by})) for by in (h, -h)]  # type: ignore[arg-type]
        assert gradient[i] == pytest.approx((ends[0] - ends[1]) / (2.0 * h), rel=1e-5, abs=1e-6 * size / value), key


COARSE = {"mesh": rp.Mesh(dt=0.05), "limits": rp.Limits(effort=np.inf, actuator_speed=np.inf)}


@pytest.mark.long_for("0.001", "1000.0")
@pytest.mark.parametrize("size", [1e-6, 1e-3, 1e3])
def test_gradient_of_small_and_large_machines(size: float) -> None:
    """The objective has the characteristic length, which no kernel differentiates."""
    usual = rp.load_robot("four_bar").parameters
    lengths = {key: size * value for key, value in usual.items() if key.endswith("length")}  # type: ignore[operator]
    robot, value = rp.load_robot("four_bar", **lengths), lengths["rocker_length"]
    task = DesignTask(rp.CompiledDynamics(robot), turn(), {"objective": "base_wrench", **COARSE})
    search, h = Search((task,), {"rocker_length": (0.5 * value, 2.0 * value)}), 1e-4 * value
    ends = [cost(task, rp.with_parameters(robot, rocker_length=value + by)) for by in (h, -h)]
    gradient = search.machine(search.start).gradients[0, 0]
    assert gradient == pytest.approx((ends[0] - ends[1]) / (2.0 * h), rel=1e-6)


@pytest.mark.parametrize("objective", ["peak", "effort", "energy"])
def test_costs_against_inverse_dynamics(objective: str) -> None:
    """By another backend, at many samples, by numpy's trapezoidal rule."""
    robot = rp.load_robot("four_bar")
    result = Search(
        (DesignTask(rp.CompiledDynamics(robot), turn(), {"objective": objective}),), {"crank_mass": (0.1, 1.0)}
    )
    value = result.machine(result.start).values[0]
    motion = turn().sample(5e-3)  # integrals by the same rule
    reduced = rp.RneaDynamics(robot).reduce(motion)
    tau, rate = rp.distribute(reduced).tau, np.einsum("nim,ni->nm", reduced.W, motion.xd)
    near = motion.t[np.abs(tau).argmax()] + np.linspace(-5e-3, 5e-3, 101)
    peak_of = np.abs(rp.distribute(rp.RneaDynamics(robot).reduce(turn().sample_at(near))).tau).max()
    integrands = {"effort": (tau**2).sum(axis=1), "energy": np.abs(tau * rate).sum(axis=1)}
    want = peak_of if objective == "peak" else np.trapezoid(integrands[objective], motion.t)
    assert value == pytest.approx(want, rel=1e-6)


def test_least_norm_where_there_are_more_motors_than_degrees_of_freedom(tmp_path: Path) -> None:
    robot = driven_twice(tmp_path)
    result = rp.co_design([(robot, turn(), {"objective": "effort"})], {"rocker_mass": (0.3, 0.6)})
    plan = result.plans[0]
    designed = rp.with_parameters(robot, **result.parameters)  # type: ignore[arg-type]
    reduced = rp.RneaDynamics(designed).reduce(plan.motion)
    tau = np.array([np.linalg.pinv(W) @ f for W, f in zip(reduced.W, reduced.f, strict=True)])
    np.testing.assert_allclose(plan.tau, tau, atol=1e-9)
    assert result.parameters["rocker_mass"] == 0.3
    assert result.at_bounds == ("rocker_mass",)


@pytest.mark.parametrize(
    ("name", "motion", "options", "constraint"),
    [
        ("four_bar", turn(), {"limits": rp.Limits(effort=0.5)}, "effort"),
        ("four_bar", turn(), {"at_most": {"energy": 1.0}}, "at_most"),
        ("five_bar", None, {}, "effort"),
    ],
    ids=["effort", "at_most", "type II"],
)
def test_a_robot_that_cannot_carry_out_its_task(name: str, motion: Any, options: Any, constraint: str) -> None:
    robot = rp.load_robot(name)
    motion = motion or rp.trajectory.from_points(ACROSS, speed=0.2, ramp_time=0.1)
    with pytest.raises(InfeasiblePlanError) as raised:
        rp.co_design([(robot, motion, options)], {next(iter(robot.parameters)): (0.01, 10.0)})
    assert raised.value.details["constraint"] == constraint
    assert (name == "five_bar") == ("type II" in raised.value.message)


def test_of_two_singularities_the_first_is_named() -> None:
    """There and back in 2 s: the line of the base hinges is crossed on both ways."""
    there_and_back = rp.trajectory.from_points([*ACROSS, ACROSS[0]], [0.0, 1.0, 2.0])
    with pytest.raises(InfeasiblePlanError, match="type II") as raised:
        rp.co_design([("five_bar", there_and_back, {})], {"proximal_length": (0.01, 10.0)})
    assert 0.0 < raised.value.details["time"] < 1.0


def test_robots_that_do_not_close_are_passed_over(crank_and_rod: rp.Robot) -> None:
    """A rod that is shorter than the crank cannot turn with it."""
    task = DesignTask(rp.CompiledDynamics(crank_and_rod), turn(), {"objective": "peak"})
    search = Search((task,), {"rod_length": (0.05, 0.6)})
    here = search.machine(search.start)
    assert search.machine_or_none(np.array([0.0]), here) is None
    assert search.rejected == 1


@pytest.mark.parametrize(
    ("most", "range_of", "objective"),
    [(0.28, (0.2, 0.4), "peak"), (0.27, (0.2, 0.27), {"base_wrench": 1.0, "peak": 10.0})],
    ids=["within the range", "at its end"],
)
def test_a_condition_of_the_file_bounds_the_search(
    most: float, range_of: tuple[float, float], objective: Any, tmp_path: Path
) -> None:
    """Beyond it there is no machine; on it slopes are those of machines below."""
    robot = four_bar(tmp_path, "requires:\n", f"requires:\n  - rocker_length <= {most}\n")
    best = rp.co_design([(robot, turn(), {"objective": objective})], {"rocker_length": range_of}, iterations=6)
    assert best.values[0] < best.before[0]
    assert 0.25 < best.parameters["rocker_length"] <= most
    assert (best.rejected > 0, best.at_bounds) == ((True, ()) if range_of[1] > most else (False, ("rocker_length",)))


def test_what_costs_nothing_cannot_be_designed(crank_and_rod: rp.Robot) -> None:
    with pytest.raises(InputError, match="costs nothing"):
        rp.co_design([(crank_and_rod, turn(), {"objective": "carrier_force"})], {"rod_length": (0.2, 0.6)})


def test_a_machine_that_cannot_do_one_task_is_compared_in_the_others(crank_and_rod: rp.Robot) -> None:
    """A counterweight holds the rod, which a weak motor needs in a slow turn, and hinders a fast one."""
    balanced = rp.with_parameters(crank_and_rod, counterweight=1.2)
    fast = DesignTask(balanced, turn(0.4), {"objective": "effort"})
    slow = DesignTask(balanced, turn(3.0), {"objective": "effort", "limits": rp.Limits(effort=0.4)})
    assert np.abs(torque(0.4, 1.2, np.linspace(0.0, 3.0, 401), 3.0)).max() < 0.4
    records = compare_machines({"slow": slow, "fast": fast}, {"counterweight": (0.0, 2.0)}, iterations=1)
    made = {(record["machine"], record["task"]): record for record in records}
    assert len(made) == len(records) == 8
    assert "effort" in made["for fast", "slow"]["reason"]
    assert made["for fast", "slow"]["value"] is None
    assert made["for fast", "fast"]["value"] < made["to begin with", "fast"]["value"]
