"""Why there is no plan: the named limit, when and how much, checked by planning again with what is said to suffice."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import zoo

import redundancy_pin as rp
from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.planners.optimal import infeasible, nlp, refine, solve
from redundancy_pin.status import ResultStatus
from redundancy_pin.trajectory import SpeedProfile, Trajectory, reference
from redundancy_pin.trajectory.paths import Line

WIDER = 1.02
"""Limits are widened by a fiftieth more than what is said to suffice; the least relaxation itself leaves no room."""

NARROWER = 0.98
"""... and with a fiftieth of the relaxation missing there must be no plan."""

ROUNDING = 1e-6
"""Relative excess of an effort over its limit that the planner counts as rounding."""

SECONDS = 20.0
"""Time bound; the search for a plan and that for an explanation have as much each."""

ROOM = (9,)
"""Problems in which a plan needs less than is said to suffice: limits that give way are held between the nodes by hulls
in every step, those of a plan only in steps that leave them, and with speeds at their limit that is a fifth of 0.19."""

NAMES = {"force": "carrier_force"}
UNITS = {"track": "m", "speed": "m/s", "acceleration": "m/s²", "jerk": "m/s³", "force": "N"}


def straight(start: Any, end: Any, speed: float) -> Trajectory:
    path = Line(start, end)
    return Trajectory(path, SpeedProfile(path.length, speed, 0.2))


def planned(
    dynamics: Any, trajectory: Trajectory, limits: dict[str, float], steps: int, objective: str = "effort"
) -> Any:
    """Plan within limits by name; a track of half that length to both sides."""
    track = limits.get("track")
    return rp.plan_whole_trajectory(
        dynamics,
        trajectory,
        objective=objective,
        mesh=rp.Mesh(dt=trajectory.duration / steps, refinements=0),
        solver=rp.Solver(seconds=SECONDS),
        limits=rp.Limits(
            track=None if track is None else (-track, track),
            speed=limits.get("speed"),
            acceleration=limits.get("acceleration"),
            jerk=limits.get("jerk"),
            carrier_force=limits.get("carrier_force"),
            effort=limits.get("effort"),
        ),
    )


def random_problem(seed: int, steps: int) -> tuple[Any, Trajectory, dict[str, float]]:
    """A robot and motion, and limits that no plan keeps: efforts below the least peak within the other limits."""
    rng = np.random.default_rng(seed)
    masses = {"end_effector_mass": float(rng.uniform(0.2, 0.5)), "cylinder_mass": float(rng.uniform(0.1, 0.3))}
    heavy, bar = rp.VirtualWork(zoo.robot_of("2rpr", **masses)), rp.CompiledDynamics(zoo.robot_of("five_bar"))
    line = straight(rng.uniform((0.1, 0.25), (0.4, 0.5)), rng.uniform((0.1, -0.5), (0.4, -0.25)), 0.5)
    across = straight((0.25, 0.6), rng.uniform((0.2, 0.25), (0.35, 0.35)), 0.4)
    circle = reference.circle(float(rng.uniform(0.4, 0.7)), 0.2)
    corner = reference.corner(float(rng.uniform(0.013, 0.03)))
    dynamics, trajectory, limits = (
        (rp.VirtualWork(zoo.robot_of("2rpr")), circle, {}),
        (heavy, line, {"speed": float(rng.uniform(0.1, 0.3))}),
        (heavy, line, {"acceleration": float(rng.uniform(1.0, 3.0))}),
        (heavy, circle, {"jerk": float(rng.uniform(50.0, 100.0))}),
        (bar, across, {"track": float(rng.uniform(0.05, 0.1))}),
        (rp.VirtualWork(zoo.robot_of("3rrr")), corner, {}),
        (bar, across, {"carrier_force": float(rng.uniform(0.1, 0.3)), "effort": 1.0}),
        (bar, across, {"speed": float(rng.uniform(0.05, 0.1)), "acceleration": float(rng.uniform(1.0, 2.0))}),
    )[seed % 8]
    if seed % 8 < 6:
        least = planned(dynamics, trajectory, limits, steps, "peak")
        limits["effort"] = float(rng.uniform(0.7, 0.9)) * float(least.peak_effort_at_samples.max())
    return dynamics, trajectory, limits


def own_limit(robot: Any, name: str) -> float:
    own = robot.carrier_limits[0]
    return {"track": own.upper, "carrier_force": own.force}.get(name) or float(getattr(own, name))


def relaxed(dynamics: Any, limits: dict[str, float], details: Any, factor: float) -> dict[str, float]:
    """Limits let out by ``factor`` times the fraction that is said to suffice: one kind, or all named together.

    (That a freer end would do instead is not tried: it is not a limit that can be let out.)
    """
    merged = dict(limits)
    events = [event for event in details["relaxations"] if event["constraint"] != "end"]
    for event in events if details["together"] else events[:1]:
        name = NAMES.get(event["constraint"], event["constraint"])
        given = merged[name] if name in merged else own_limit(dynamics.robot, name)
        merged[name] = given * (1.0 + factor * event["fraction"])
    return merged


QUICK = (6, 7)


@pytest.mark.parametrize("seed", [pytest.param(s, marks=() if s in QUICK else pytest.mark.long) for s in range(16)])
def test_what_is_said_to_suffice_suffices_and_less_does_not(seed: int) -> None:
    steps = 16 if seed in QUICK else 30
    dynamics, trajectory, limits = random_problem(seed, steps)
    began = time.perf_counter()
    with pytest.raises(InfeasiblePlanError) as caught:
        planned(dynamics, trajectory, limits, steps)
    assert time.perf_counter() - began < 2.0 * SECONDS
    details = caught.value.details
    assert 0.0 <= details["time"] <= trajectory.duration
    assert details["amount"] > 0.0
    fractions = [event["fraction"] for event in details["relaxations"] if "fraction" in event]
    assert fractions == sorted(fractions)  # the least comes first
    for event in details["relaxations"]:
        if event["constraint"] == "end":
            continue
        name = NAMES.get(event["constraint"], event["constraint"])
        given = limits[name] if name in limits else own_limit(dynamics.robot, name)
        assert abs(event["limit"]) - given == pytest.approx(event["amount"], rel=1e-6)
        assert event["amount"] <= (1.0 + ROUNDING) * event["fraction"] * given
        owners = dynamics.robot.actuated if name == "effort" else dynamics.robot.carriers
        assert event["joint"] in owners
        assert event["unit"] == UNITS.get(event["constraint"], "N" if dynamics.robot.name == "2rpr" else "N·m")
        assert f"{event['limit']:.6g} {event['unit']}" in caught.value.message
    enough = relaxed(dynamics, limits, details, WIDER)
    plan = planned(dynamics, trajectory, enough, steps)
    # a statement about the nodes; without refinements efforts may exceed their limit between them, as the status says
    assert plan.findings.optimal
    assert np.abs(plan.tau).max() <= enough.get("effort", np.inf) * (1.0 + ROUNDING)
    if plan.status is not ResultStatus.OK:
        assert {event.quantity for event in plan.limits.violated} == {"effort"}
    if seed not in ROOM:
        with pytest.raises(InfeasiblePlanError):
            planned(dynamics, trajectory, relaxed(dynamics, limits, details, NARROWER), steps)


def test_bounds_that_have_to_be_wider_together_are_all_named() -> None:
    """Two costs in conflict: each bound can be kept by itself, and to let out one of them is not enough."""
    dynamics = rp.CompiledDynamics(zoo.robot_of("five_bar", carriers=True))
    line = rp.trajectory.from_points([[0.15, 0.62], [0.35, 0.25]], speed=0.5, ramp_time=0.2)

    def plan_within(**bounds: float) -> rp.Plan:
        return rp.plan_whole_trajectory(dynamics, line, at_most=bounds, mesh=rp.Mesh(dt=0.02, refinements=0))

    tight = {"peak": 1.409, "carrier_force": 0.844}
    with pytest.raises(InfeasiblePlanError) as caught:
        plan_within(**tight)
    event = caught.value.details["relaxations"][0]
    wider = event["limits"]
    assert set(wider) == set(tight)
    assert event["limit"] == wider[event["objective"]]
    for name, limit in wider.items():
        assert limit > tight[name]
        assert f"{name} at most, from {tight[name]:.6g} to {limit:.6g}" in caught.value.message
    plan_within(**{name: tight[name] + WIDER * (limit - tight[name]) for name, limit in wider.items()})
    for name, limit in wider.items():
        with pytest.raises(InfeasiblePlanError):
            plan_within(**{**tight, name: tight[name] + WIDER * (limit - tight[name])})


@pytest.mark.parametrize("sense", [1.0, pytest.param(-1.0, marks=pytest.mark.long)])
def test_the_end_of_a_track_is_a_place_with_its_sign(sense: float) -> None:
    """A start with a speed that no acceleration stops before the end of the track: v² / 2a is needed."""
    speed, room = 2.0, 0.1
    with pytest.raises(InfeasiblePlanError) as caught:
        rp.plan_whole_trajectory(
            rp.VirtualWork(zoo.robot_of("2rpr")),
            reference.circle(0.5, 0.2, 0.05),
            start=(sense * 0.1, 0.0),
            start_speed=(sense * speed, 0.0),
            mesh=rp.Mesh(dt=0.08, refinements=0),
            end="free",
        )
    details = caught.value.details
    assert speed**2 / (2.0 * 10.0) > room
    enough = {relaxed["constraint"]: relaxed["limit"] for relaxed in details["relaxations"]}
    assert set(enough) <= {"track", "acceleration"}
    assert sense * enough["track"] > 0.2
    assert enough.get("acceleration", np.inf) > 10.0
    assert details["joint"] == "carrier_1"
    assert details["time"] < 0.3


def test_the_jerk_that_two_singular_poses_take_is_named_in_its_unit() -> None:
    """What a limit gives way by is used somewhere; with it there is a plan."""
    dynamics, circle = (
        rp.VirtualWork(zoo.robot_of("2rpr", end_effector_mass=0.5, cylinder_mass=0.3)),
        reference.circle(),
    )
    with pytest.raises(InfeasiblePlanError) as caught:
        rp.plan_whole_trajectory(dynamics, circle, limits=rp.Limits(jerk=10.0), mesh=rp.Mesh(dt=0.08, refinements=0))
    event = caught.value.details["relaxations"][0]
    assert (event["constraint"], event["unit"]) == ("jerk", "m/s³")
    assert event["amount"] == pytest.approx(10.0 * event["fraction"], rel=1e-6)
    assert event["limit"] == pytest.approx(10.0 + event["amount"], rel=1e-9)
    enough = rp.plan_whole_trajectory(
        dynamics, circle, limits=rp.Limits(jerk=1.02 * event["limit"]), mesh=rp.Mesh(dt=0.08, refinements=0)
    )
    assert enough.findings.optimal


def test_what_suffices_suffices_where_the_reference_acceleration_jumps() -> None:
    """A limit of the jerk keeps s̈ from jumping with it, however wide it is: then it is not said to be enough."""
    dynamics, corner = rp.VirtualWork(zoo.robot_of("3rrr")), reference.corner(0.025)
    mesh, limits = rp.Mesh(dt=0.05, refinements=0), {"jerk": 2.0, "effort": 2.0}
    with pytest.raises(InfeasiblePlanError) as caught:
        rp.plan_whole_trajectory(dynamics, corner, limits=rp.Limits(**limits), mesh=mesh)
    assert not caught.value.details["together"]
    for event in caught.value.details["relaxations"]:
        enough = rp.Limits(**{**limits, event["constraint"]: WIDER * event["limit"]})
        plan = rp.plan_whole_trajectory(dynamics, corner, limits=enough, mesh=mesh)
        assert plan.findings.optimal
        assert "jerk" not in {event.quantity for event in plan.limits.violated}


def test_a_track_is_as_long_as_is_needed_between_the_nodes() -> None:
    """Where the carriers turn back between two nodes these show less: 0.6 mm here, with which there is no plan."""

    def plan(half: float) -> Any:
        limits, mesh = rp.Limits(track=(-half, half), effort=2.5), rp.Mesh(dt=0.1, refinements=0)
        return rp.plan_whole_trajectory(rp.VirtualWork(zoo.robot_of("3rrr")), corner, limits=limits, mesh=mesh)

    corner = reference.corner(0.025)
    with pytest.raises(InfeasiblePlanError) as caught:
        plan(0.05)
    (track,) = (event for event in caught.value.details["relaxations"] if event["constraint"] == "track")
    assert plan(abs(track["limit"]) + 5e-5).findings.optimal
    with pytest.raises(InfeasiblePlanError):
        plan(abs(track["limit"]) - 2e-4)


@pytest.mark.long_for("1e-18")
@pytest.mark.parametrize("effort", [1e-8, 1e-18, 1e-60])
def test_a_limit_below_rounding_is_one_like_others(effort: float) -> None:
    """IPOPT ended the process: at once, or where limits at the nodes were lowered for what is between them."""
    line = straight((0.15, 0.4), (0.25, 0.3), 0.2)

    def plan(effort: float, mesh: rp.Mesh) -> Any:
        limits = rp.Limits(effort=effort)
        return rp.plan_whole_trajectory(zoo.robot_of("2rpr"), line, limits=limits, mesh=mesh, end="free")

    assert plan(effort, rp.Mesh(dt=0.04, refinements=0)).status is ResultStatus.LIMIT_VIOLATED
    with pytest.raises(InfeasiblePlanError, match="What would suffice: every effort limit by"):
        plan(effort, rp.Mesh(dt=0.02))


def test_what_would_suffice_for_efforts_is_the_least_peak() -> None:
    """Which the peak objective finds by itself."""
    dynamics, circle = rp.VirtualWork(zoo.robot_of("2rpr")), reference.circle(0.75, 0.2, 0.075)
    with pytest.raises(InfeasiblePlanError) as caught:
        rp.plan_whole_trajectory(dynamics, circle, limits=rp.Limits(effort=0.05), mesh=rp.Mesh(dt=0.1, refinements=0))
    (effort,) = (event for event in caught.value.details["relaxations"] if event["constraint"] == "effort")
    least = rp.plan_whole_trajectory(
        dynamics, circle, objective=rp.Objective("peak", calm=0.0), mesh=rp.Mesh(dt=0.1, refinements=0)
    ).least_cost
    assert effort["limit"] == pytest.approx(least, rel=1e-3)
    enough = rp.plan_whole_trajectory(
        dynamics, circle, limits=rp.Limits(effort=1.001 * least), mesh=rp.Mesh(dt=0.1, refinements=0)
    )
    # steps of 100 ms, not refined: between the nodes the limit is far exceeded, and the plan says so
    assert enough.peak_effort_at_samples.max() <= 1.001 * least * (1.0 + ROUNDING)
    assert enough.status is ResultStatus.LIMIT_VIOLATED
    assert {event.quantity for event in enough.limits.violated} == {"effort"}
    # finer nodes show that no plan keeps it there
    with pytest.raises(InfeasiblePlanError, match="every effort limit by"):
        rp.plan_whole_trajectory(
            dynamics, circle, limits=rp.Limits(effort=1.05 * least), mesh=rp.Mesh(dt=0.1, refinements=1)
        )


@pytest.mark.long_for("0.0-0.15")
@pytest.mark.parametrize(("start", "datum"), [(0.15, 0.0), (0.0, 0.15)])
def test_carriers_that_cannot_return_say_by_how_much_they_miss_their_end(start: float, datum: float) -> None:
    """By 0.15 m less what 0.5 m/s² takes them in the time of the motion."""
    line = straight((0.25, 0.45), (0.31, 0.45), 0.2)
    with pytest.raises(InfeasiblePlanError, match="from the datum") as caught:
        rp.plan_whole_trajectory(
            rp.VirtualWork(zoo.robot_of("2rpr")),
            line,
            start=start,
            datum=datum,
            limits=rp.Limits(acceleration=0.5),
            mesh=rp.Mesh(dt=0.1, refinements=0),
        )
    (end,) = (event for event in caught.value.details["relaxations"] if event["constraint"] == "end")
    assert end["amount"] == pytest.approx(0.15 - 0.25 * line.duration**2, rel=1e-6)
    assert end["time"] == line.duration


def test_what_was_not_tried_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a limit that does not do by itself this takes ten times as long to see as of one that does."""
    monkeypatch.setattr(infeasible, "SPARED", 0)
    monkeypatch.setattr(infeasible, "AGAIN", 0)
    dynamics, trajectory, limits = random_problem(6, 16)
    with pytest.raises(InfeasiblePlanError, match="Not tried to the end: ") as caught:
        planned(dynamics, trajectory, limits, 16)
    assert set(caught.value.details["untried"]) >= {"effort"}
    assert caught.value.details["together"]


def test_what_suffices_is_not_read_off_a_point_that_breaks_the_equations(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the last solution, at all nodes and between them, does not keep the rest, the one before is explained."""
    dynamics, trajectory, limits = random_problem(6, 16)
    solve, says = infeasible.solve, []

    def doubled(*arguments: Any, **options: Any) -> Any:
        found = solve(*arguments, **options)
        if options["first"] is not nlp.ON_FINER_NODES:
            return found
        more = {name: 2.0 * value for name, value in found.values.items() if name.startswith("slack")}
        return replace(found, values={**found.values, **more}, feasible=False, optimal=False)

    for patched in (solve, doubled):
        monkeypatch.setattr(infeasible, "solve", patched)
        with pytest.raises(InfeasiblePlanError, match="What would suffice") as caught:
            planned(dynamics, trajectory, limits, 16)
        says.append([event["limit"] for event in caught.value.details["relaxations"]])
    np.testing.assert_allclose(says[0], says[1], rtol=1e-3)


REFUSED = {
    "circle": (lambda: zoo.robot_of("2rpr"), reference.circle(0.5, 0.2, 0.05), {"effort": 0.05}),
    "corner": (lambda: zoo.robot_of("3rrr"), reference.corner(0.025), {"effort": 1.0}),
    "speeds": (
        lambda: zoo.robot_of("five_bar"), straight((0.25, 0.6), (0.3, 0.3), 0.4), {"speed": 0.07, "acceleration": 1.5},
    ),
    "forces": (
        lambda: zoo.robot_of("five_bar"), straight((0.25, 0.6), (0.3, 0.3), 0.4), {"carrier_force": 0.2, "effort": 1.0},
    ),
}  # fmt: skip
"""Robot, motion and limits, on the planner's own mesh: up to 664 nodes. The speeds took 50 s."""

IN_TIME = 6.0
"""Seconds of the processor for a refusal: 1 to 3 on an idle machine."""


@pytest.mark.long_for("circle", "corner", "speeds")
@pytest.mark.parametrize("name", REFUSED)
def test_a_refusal_on_the_planners_own_mesh_comes_in_time_and_what_it_names_suffices(name: str) -> None:
    make, motion, limits = REFUSED[name]
    robot = make()

    def plan(limits: dict[str, Any], **mesh: int) -> Any:
        track = limits.get("track")
        given = rp.Limits(**{**limits, "track": None if track is None else (-track, track)})
        return rp.plan_whole_trajectory(robot, motion, limits=given, mesh=rp.Mesh(**mesh))

    began = time.process_time()
    with pytest.raises(InfeasiblePlanError, match="What would suffice") as caught:
        plan(limits)
    assert time.process_time() - began < IN_TIME
    details = caught.value.details
    assert not details["together"]
    for event in details["relaxations"]:
        if event["constraint"] == "end":
            continue
        quantity = NAMES.get(event["constraint"], event["constraint"])
        given = limits[quantity] if quantity in limits else own_limit(robot, quantity)
        assert event["limit"] == pytest.approx(given * (1.0 + event["fraction"]), rel=1e-6)
        # at all nodes, not at the few that told which limits are in the way
        assert plan({**limits, quantity: given * (1.0 + 1.001 * event["fraction"])}, refinements=0).findings.optimal
        found = plan({**limits, quantity: given * (1.0 + WIDER * event["fraction"])})
        assert found.status is ResultStatus.OK
        # by the finer mesh of the refused plan less would do, by 1 % at most
        with pytest.raises(InfeasiblePlanError):
            plan({**limits, quantity: given * (1.0 + 0.95 * event["fraction"])})


def test_a_bound_below_the_least_there_is_names_that_least_without_a_search(monkeypatch: pytest.MonkeyPatch) -> None:
    dynamics, trajectory = rp.CompiledDynamics(zoo.robot_of("five_bar")), straight((0.25, 0.6), (0.3, 0.3), 0.4)
    dt = trajectory.duration / 16
    least = rp.plan_whole_trajectory(
        dynamics, trajectory, objective=rp.Objective("energy", calm=0.0), mesh=rp.Mesh(dt=dt, refinements=0)
    ).least_cost
    monkeypatch.setattr(refine, "relax", None)
    with pytest.raises(InfeasiblePlanError, match="What would suffice: energy at most") as caught:
        rp.plan_whole_trajectory(
            dynamics, trajectory, objective="peak", at_most={"energy": 0.5 * least}, mesh=rp.Mesh(dt=dt, refinements=0)
        )
    assert caught.value.details["limit"] == pytest.approx(least, rel=1e-6)
    assert caught.value.details["constraint"] == "at_most"
    kept = rp.plan_whole_trajectory(
        dynamics, trajectory, objective="peak", at_most={"energy": 1.01 * least}, mesh=rp.Mesh(dt=dt, refinements=0)
    )
    assert kept.diagnostics["objective"]["energy"] <= 1.01 * least * (1.0 + ROUNDING)


@pytest.mark.long_for("carrier_force-effort-0.05")
@pytest.mark.parametrize(("x", "y", "weight"), [("base_force", "effort", 0.02), ("carrier_force", "effort", 0.05)])
def test_a_bound_finds_what_a_weight_finds(x: str, y: str, weight: float) -> None:
    """Of a convex front: the least y under the x of a weighted sum is the y of that sum."""
    dynamics, corner = rp.VirtualWork(zoo.robot_of("3rrr", carrier_mass=3.0)), reference.corner(radius=0.025)

    def values(objective: Any, at_most: Any = None) -> Any:
        plan = rp.plan_whole_trajectory(
            dynamics,
            corner,
            objective=objective,
            at_most=at_most,
            limits=rp.Limits(acceleration=20.0, speed=5.0),
            mesh=rp.Mesh(dt=0.03, refinements=0),
        )
        return plan.diagnostics["objective"]

    weighted = values({y: 1.0, x: weight})
    bounded = values(y, {x: weighted[x]})
    assert bounded[y] == pytest.approx(weighted[y], rel=1e-4)
    assert bounded[x] <= weighted[x] * (1.0 + 1e-8)
    # the bound is what holds it back
    assert values(y)[y] < 0.99 * weighted[y]


def test_a_plan_whose_search_was_ended_too_early_is_found_all_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    """A search that is ended at once begins again where limits that give way need not."""
    dynamics, motion = rp.CompiledDynamics(zoo.robot_of("five_bar")), straight((0.25, 0.6), (0.3, 0.3), 0.4)
    usual = planned(dynamics, motion, {}, 16)
    patience = [0]  # of the first search alone

    def solve_nlp(*given: Any) -> nlp.Solution:
        return nlp.solve_nlp(*given[:5], patience.pop() if patience else np.inf)

    monkeypatch.setattr(solve, "solve_nlp", solve_nlp)
    monkeypatch.setattr(nlp, "FAR", 0.0)
    plan = planned(dynamics, motion, {}, 16)
    assert plan.diagnostics["starts"]["messages"][0] == nlp.STALLED
    assert plan.status is usual.status
    assert plan.least_cost == pytest.approx(usual.least_cost, rel=1e-6)


DOWN = (0.0, -9.81, 0.0)


def raised(robot: rp.Robot) -> Any:
    """A path from the home pose: a spatial platform is lifted, others move by a third of their reach."""
    home = zoo.home_of(robot)
    if home.ndim == 1:
        return Line(home, home + 0.3 * zoo.reach_of(robot))
    goal = np.array(home)
    goal[:3, 3] += [0.05, 0.03, 0.05]
    return reference.pose(home, goal).path


HELD = {
    "five_bar": (lambda: zoo.robot_of("five_bar", gravity=DOWN, carriers=False), lambda robot: raised(robot), {}),
    "carriers": (
        lambda: zoo.robot_of("3rrr", gravity=DOWN),
        lambda robot: reference.corner().path,
        {"mesh": rp.Mesh(steps=40)},
    ),
    "gough": (lambda: zoo.robot_of("gough"), lambda robot: raised(robot), {}),
    "four_bar": (lambda: zoo.robot_of("four_bar"), lambda robot: Line((1.0,), (2.0,)), {}),
    "redundant": (lambda: zoo.robot_of("two_arms"), lambda robot: raised(robot), {}),
}


@pytest.mark.long_for("carriers", "redundant", "four_bar", "gough")
@pytest.mark.parametrize("name", HELD)
def test_a_timing_under_efforts_that_do_not_hold_the_robot_names_those_that_would(name: str) -> None:
    """What holding takes, by the statics of the platform on the way, suffices for a slow motion; less may do.

    As for a throw, or where carriers are not parked.
    """
    make, path_of, options = HELD[name]
    robot = make()
    dynamics, path = rp.CompiledDynamics(robot), path_of(robot)
    slow = Trajectory(path, SpeedProfile(path.length, 1e-4 * path.length, 1.0))
    hold = rp.distribute(dynamics.reduce(slow.sample_at(np.linspace(0.0, slow.duration, 41)))).tau
    parked = float(np.abs(hold).max())

    def planned(effort: float) -> Any:
        solver = rp.Solver(seconds=SECONDS)
        return rp.plan_time_optimal(dynamics, path, limits=rp.Limits(effort=effort), solver=solver, **options)

    given, began = 0.4 * parked, time.perf_counter()
    with pytest.raises(InfeasiblePlanError) as caught:
        planned(given)
    assert time.perf_counter() - began < 2.0 * SECONDS
    details = caught.value.details
    assert "No timing keeps every limit. What would suffice: every effort limit by" in caught.value.message
    assert f"{details['limit']:.6g} {details['unit']}" in caught.value.message
    assert details["constraint"] == "effort"
    assert details["joint"] in robot.actuated
    assert details["limit"] == pytest.approx((1.0 + details["fraction"]) * given, rel=1e-6)
    assert details["limit"] < 1.01 * parked
    assert planned(WIDER * details["limit"]).status is ResultStatus.OK
    with pytest.raises(InfeasiblePlanError):
        planned(NARROWER * details["limit"])


@pytest.mark.long_for("0.2")
@pytest.mark.parametrize("dt", [0.2, 10.0])
def test_a_handful_of_nodes_is_planned_and_refused_as_many_are(dt: float) -> None:
    motion, mesh = straight((0.15, 0.4), (0.25, 0.3), 0.2), rp.Mesh(dt=dt)
    robot = rp.load_robot("2rpr")
    assert rp.plan_whole_trajectory(robot, motion, mesh=mesh, objective="peak").status.value in ("ok", "unresolved")
    with pytest.raises(InfeasiblePlanError, match="What would suffice"):
        rp.plan_whole_trajectory(robot, motion, mesh=mesh, limits=rp.Limits(effort=1e-3))


@pytest.mark.long
def test_limits_that_give_way_by_the_rounding_of_a_rough_solution_are_not_named() -> None:
    """The track and the end state take 1.4e-8 % there, beside a force that has to be four times as large."""
    motion = straight((0.186, 0.401), (0.333, -0.321), 0.4746)
    limits = rp.Limits(track=(-0.027, 0.027), carrier_force=0.05)
    with pytest.raises(InfeasiblePlanError) as refused:
        rp.plan_whole_trajectory("2rpr", motion, end="rest", limits=limits, mesh=rp.Mesh(refinements=0))
    assert [event["constraint"] for event in refused.value.details["relaxations"]] == ["force"]
    enough = rp.Limits(track=(-0.027, 0.027), carrier_force=1.02 * refused.value.details["limit"])
    plan = rp.plan_whole_trajectory("2rpr", motion, end="rest", limits=enough, mesh=rp.Mesh(refinements=0))
    assert np.abs(plan.carrier_force).max() <= 1.03 * refused.value.details["limit"]


def test_a_limit_that_is_reached_is_named_beside_others_and_one_end_of_a_track_has_its_share() -> None:
    limits = rp.Limits(track=(-1e-4, np.inf), effort=0.05)
    with pytest.raises(InfeasiblePlanError) as refused:
        rp.plan_whole_trajectory("2rpr", straight((0.15, 0.4), (0.25, 0.3), 0.2), mesh=rp.Mesh(dt=0.02), limits=limits)
    events = {event["constraint"]: event for event in refused.value.details["relaxations"]}
    assert set(events) == {"end", "track", "effort"}
    assert events["track"]["fraction"] > 0.0
