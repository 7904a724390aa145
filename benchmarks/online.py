"""On-line planning on random paths: ticks by status, limits, peak against the least one known off line, time of a tick.

``python benchmarks/online.py [machine] [paths] [off line] [file]``; machines: 2rpr, thesis (the 2-RPR whose carriers
alone have masses), five_bar, 3rrr. Paths are random and numbered; of those that the file has already nothing is
computed. Off line is ``plan_whole_trajectory``, objective "peak", from the same start and free at the end, for the
first paths and for those that are not planned at every tick. Times are those of the processor, by ``time.thread_time``.

    python benchmarks/online.py compare [machine] [paths]   off line, switched off and on line, on the same paths
    python benchmarks/online.py preview [paths]             which preview the 2-RPR needs, by masses and acceleration
    python benchmarks/online.py ticks [paths] [period]      how long a tick takes
    python benchmarks/online.py endless [ticks]             one planner along a path without end: statuses and memory
    python benchmarks/online.py loop [machines] [times]     in closed loop, imperfections of docs/validation.md by times

print tables of docs/online.md.
"""

import json
import resource
import sys
import time
from collections import Counter
from dataclasses import replace
from itertools import islice, product
from pathlib import Path

import numpy as np
from imperfect import MASSES, Imperfections, draw

import redundancy_pin as rp
from redundancy_pin.errors import InfeasiblePlanError, SingularPoseError, UnreachablePoseError, WorkingModeError
from redundancy_pin.planners.receding_horizon import Preview, RecedingHorizon, run_online
from redundancy_pin.planners.registry import in_groups
from redundancy_pin.simulation.controllers import Encoders, NoisyAmplifier, OnlinePlanning, Sampling, joint_friction
from redundancy_pin.simulation.state import closed_state
from redundancy_pin.trajectory import SpeedProfile, Trajectory
from redundancy_pin.trajectory.paths import circle_path
from redundancy_pin.trajectory.waypoints import through_points

MACHINES = {
    "2rpr": ("2rpr", {"end_effector_mass": 0.5, "cylinder_mass": 0.3}),
    "thesis": ("2rpr", {}),
    "five_bar": ("five_bar", {"carriers": True}),
    "3rrr": ("3rrr", {}),
}

REACH = {"five_bar": (0.35, 0.45), "3rrr": (0.1, 0.1, 1.2)}
"""Half the box around home in which points are drawn, m and rad."""

CALM = 20.0
"""Largest acceleration of a path, m/s²: a spline through random points has turns of a millisecond and hundreds of m/s²,
which no machine follows."""


OFF_LINE = {"calm": 0.0, "end": "free", "start": 0.0, "dt": 0.02, "refinements": 1, "seconds": 20}
"""From the start that it has on line, and free where that is free. On-line plans are compared with least costs."""

THRESHOLDS = 4.0, 7.0, 10.0
"""Condition numbers from which the switch-off has its actuators off, those of the thesis; the least peak counts."""

HORIZONS = 0.2, 0.3, 0.4, 0.5, 0.7
HEAVIER = 0.5, 1.0, 2.0
"""Masses over those of the 2-RPR above; carriers keep theirs."""

ACCELERATIONS = 2.5, 5.0, 10.0, 20.0
"""Limits of its carriers, m/s²; 10 is its own."""

LOOP = Trajectory(
    circle_path((0.25, 0.05), 0.09, start_angle=np.pi, sweep=np.pi), SpeedProfile(0.09 * np.pi, 0.45, 0.2)
)
"""Over the line and back."""

LOOPS = {}, {"integral": 10.0}, {"bandwidth": 45.0, "integral": 10.0}
FRICTION = "prismatic_coulomb", "prismatic_viscous", "revolute_coulomb", "revolute_viscous"


def machine(name, heavier=1.0):
    model, masses = MACHINES[name]
    own = {key: given if given is True else heavier * given for key, given in masses.items()}
    return rp.CompiledDynamics(rp.load_robot(model, **own))


def over_and_over(number):
    """A path of the 2-RPR that goes round a point near the singular line: 0.24 to 0.79 m/s."""
    rng = np.random.default_rng([7, number])
    count = int(rng.integers(12, 18))
    angle = rng.uniform(0, 6.28) + rng.choice([-1, 1]) * np.cumsum(rng.uniform(0.8, 1.3, count))
    radius = rng.uniform(0.09, 0.2, count)
    centre = np.array([0.25, rng.uniform(-0.02, 0.02)])
    path = through_points(centre + np.c_[0.7 * radius * np.cos(angle), radius * np.sin(angle)])
    return Trajectory(path, SpeedProfile(path.length, min(rng.uniform(0.24, 0.79), 0.8 * path.length / 0.3), 0.3))


def random_paths(name, dynamics):
    """Give paths through type II poses, without end."""
    if MACHINES[name][0] == "2rpr":
        yield from map(over_and_over, range(10**6))
    home, rng = closed_state(dynamics.robot).x, np.random.default_rng(4)
    reach = np.array(REACH[name])
    while True:
        points = home + rng.uniform(-1.0, 1.0, (4, len(home))) * reach
        points[0] = home + 0.1 * rng.uniform(-1.0, 1.0, len(home)) * reach
        path = through_points(points)
        trajectory = Trajectory(path, SpeedProfile(path.length, min(0.5, 0.8 * path.length / 0.4), 0.4))
        if is_calm(trajectory) and crosses(dynamics, trajectory):
            yield trajectory


def is_calm(trajectory):
    """Return whether the acceleration stays below ``CALM``; most paths are told by a coarse grid that is not."""
    times = np.linspace(0.0, trajectory.duration, 20001)
    return all(np.abs(trajectory.sample_at(grid).xdd).max() < CALM for grid in (times[::100], times))


def crosses(dynamics, trajectory):
    """Return whether all of a trajectory can be reached, through type II poses."""
    motion = trajectory.sample_at(np.linspace(0.0, trajectory.duration, 200))
    try:
        W = dynamics.along(motion).reduce().W
    except (SingularPoseError, UnreachablePoseError, WorkingModeError):
        return False
    side = np.linalg.slogdet(W)[0]
    return bool((side[1:] != side[:-1]).any())


def off_line(dynamics, trajectory, **limits):
    """Return the least peak known, None where nothing keeps the limits."""
    try:
        plan = rp.plan_whole_trajectory(
            dynamics, trajectory, **in_groups(rp.plan_whole_trajectory, dict(objective="peak", **OFF_LINE, **limits))
        )
    except InfeasiblePlanError:
        return None
    return float(plan.peak_effort.max())


def judged(name, dynamics, number, trajectory, least):
    """Plan one path; return a record of it, with the peak over the least known off line where that is asked for."""
    planner, began = RecedingHorizon(dynamics), time.thread_time()
    record = {"machine": name, "path": number, "duration": trajectory.duration, "ratio": None}
    spent, iterations = [], []
    update = planner.update

    def timed(*given):
        before = time.thread_time()
        command = update(*given)
        spent.append(1e3 * (time.thread_time() - before))
        iterations.append(planner.updates.last.iterations)
        return command

    planner.update = timed
    try:
        run = run_online(planner, trajectory)
    except InfeasiblePlanError as error:
        return {**record, "status": "refused", "reason": str(error)}
    plan = run.plan
    failed = plan.status.value != "ok" or run.counts["ok"] < len(run.commands)
    best = off_line(dynamics, trajectory) if least or failed else None
    return {
        **record,
        "status": plan.status.value,
        "ticks": run.counts,
        "crossings": len(plan.findings.singular_instants),
        "peak": float(plan.peak_effort.max()),
        "ratio": None if best is None else float(plan.peak_effort.max()) / best,
        "off_line": best is not None if least or failed else None,
        "missing": plan.diagnostics["missing_force"],
        "outside": outside(plan, dynamics.robot),
        "slowed": slowed(dynamics, trajectory) if failed else None,
        "milliseconds": [round(x, 3) for x in spent[1:]],
        "iterations": iterations[1:],
        "cpu": time.thread_time() - began,
    }


def slowed(dynamics, trajectory):
    """Plan it by a planner that may slow down: ticks, whether it keeps the limits, by how much later it ends, s."""
    try:
        run = run_online(RecedingHorizon(dynamics, slow_down=True), trajectory)
    except InfeasiblePlanError as error:
        return {"status": "refused", "reason": str(error)}
    plan = run.plan
    return {
        "status": plan.status.value,
        "ticks": run.counts,
        "outside": outside(plan, dynamics.robot),
        "missing": plan.diagnostics["missing_force"],
        "delay": plan.diagnostics["delay"],
        "slowest": 1e3 * max(plan.diagnostics["seconds"][1:]),
    }


def outside(plan, robot):
    """By how much the carriers are beyond a limit, as a fraction of it, on a grid of a tenth of a millisecond."""
    carriers, worst = plan.carriers_at(np.linspace(plan.t[0], plan.t[-1], int(1e4 * (plan.t[-1] - plan.t[0])))), 0.0
    for limit, s, sd, sdd in zip(robot.carrier_limits, carriers.s.T, carriers.sd.T, carriers.sdd.T, strict=True):
        half = 0.5 * (limit.upper - limit.lower)
        beyond = (limit.lower - s.min()) / half, (s.max() - limit.upper) / half
        rates = np.abs(sd).max() / limit.speed - 1.0, np.abs(sdd).max() / limit.acceleration - 1.0
        worst = max(worst, *beyond, *rates)
    return float(worst)


def on_line(dynamics, trajectory, **settings):
    return run_online(RecedingHorizon(dynamics, **in_groups(RecedingHorizon, settings)), trajectory).plan


def switched_off(dynamics, trajectory):
    """Return the plan of the thesis's chapter 3 that has the least peak; one within limits where there is any."""
    plans, error = [], None
    for threshold in THRESHOLDS:
        try:
            plans.append(rp.plan_switch_off(dynamics, trajectory, threshold=threshold, return_time="shortest"))
        except InfeasiblePlanError as this:
            error = this
    if not plans:
        raise error
    return min(plans, key=lambda plan: (plan.status.value != "ok", plan.peak_effort.max()))


METHODS = {
    "off line, least peak": lambda *given: rp.plan_whole_trajectory(
        *given, **in_groups(rp.plan_whole_trajectory, dict(objective="peak", **OFF_LINE))
    ),
    "off line, least effort": lambda *given: rp.plan_whole_trajectory(
        *given, **in_groups(rp.plan_whole_trajectory, dict(objective="effort", **OFF_LINE))
    ),
    "switch-off": switched_off,
    "on line, peak": lambda *given: on_line(*given, objective="peak"),
    "on line, effort": lambda *given: on_line(*given, objective="effort"),
}


def plans_of(dynamics, trajectory):
    """Return the plan of each method, or why there is none, and its time, s."""
    plans = {}
    for method, plan in METHODS.items():
        began = time.thread_time()
        try:
            made = plan(dynamics, trajectory)
        except InfeasiblePlanError as error:
            constraint = str(error.details.get("constraint", "")).replace("_", " ")
            made = f"none ({constraint})" if constraint else "none"
        plans[method] = made, time.thread_time() - began
    return plans


def effort_cost(plan):
    """Return ∫ τᵀ τ dt, N² s or N² m² s."""
    return float(np.trapezoid((plan.tau**2).sum(axis=1), plan.t))


def compare(name="2rpr", count=12):
    """Print the table of one machine."""
    dynamics, paths = machine(name), [*islice(random_paths(name, machine(name)), int(count))]
    plans = [plans_of(dynamics, path) for path in paths]
    best = [plan["off line, least peak"][0] for plan in plans]
    for method in METHODS:
        made = [
            (one[method][0], first)
            for one, first in zip(plans, best, strict=True)
            if isinstance(one[method][0], rp.Plan)
        ]
        statuses = Counter(plan.status.value.replace("_", " ") for plan, _ in made)
        why = Counter(one[method][0] for one in plans if isinstance(one[method][0], str))
        told = ", ".join(f"{number} {text}" for text, number in (*statuses.most_common(), *why.most_common()))
        peaks = [plan.peak_effort.max() for plan, _ in made]
        over = [plan.peak_effort.max() / first.peak_effort.max() for plan, first in made if isinstance(first, rp.Plan)]
        costs = [effort_cost(plan) for plan, _ in made]
        seconds = [one[method][1] / path.duration for one, path in zip(plans, paths, strict=True)]
        figures = [f"{np.median(part):.3g}" if part else "–" for part in (peaks, over, costs, seconds)]
        print(f"| {name} | {method} | {told} | {' | '.join(figures)} |", flush=True)


def preview(count=8):
    """Print which preview is enough, a row for masses and a limit of the carriers' acceleration."""
    for heavier, most in product(HEAVIER, ACCELERATIONS):
        dynamics, cells = machine("2rpr", heavier), []
        paths = [*islice(random_paths("2rpr", dynamics), int(count))]
        best = [off_line(dynamics, path, acceleration=most) for path in paths]
        for horizon in HORIZONS:
            planned, ticks, whole, over = 0, 0, 0, []
            for path, least in zip(paths, best, strict=True):
                try:
                    run = run_online(
                        RecedingHorizon(dynamics, horizon=horizon, limits=rp.Limits(acceleration=most)), path
                    )
                except InfeasiblePlanError:
                    continue
                planned, ticks = planned + run.counts["ok"], ticks + len(run.commands)
                whole += run.counts["ok"] == len(run.commands)
                if least:
                    over.append(run.plan.peak_effort.max() / least)
            cells.append(f"{whole}, {100 * planned / ticks:.1f} %, {np.median(over) if over else np.nan:.2f}")
        known = [least for least in best if least is not None]
        off = f"{len(known)} of {len(paths)}, {np.median(known) if known else np.nan:.2f} N"
        print(f"| {heavier:g} | {most:g} | {off} | {' | '.join(cells)} |", flush=True)


def milliseconds(dynamics, paths, period, **settings):
    """Return what each tick but the first took of the processor, ms, and how many were not planned."""
    spent, unplanned = [], 0
    for path in paths:
        planner = RecedingHorizon(dynamics, **in_groups(RecedingHorizon, settings))
        planner.update(0.0, path, 0.0, 0.0)
        for t in np.arange(period, path.duration, period).tolist():
            before = time.thread_time()
            command = planner.update(t, path)
            spent.append(1e3 * (time.thread_time() - before))
            unplanned += command.status.value != "ok"
    return np.array(spent), unplanned


def ticks(count=6, period=0.005):
    """Print a row a machine: ticks, median and 99th percentile, that over the period."""
    for name in MACHINES:
        dynamics, period = machine(name), float(period)
        paths = [*islice(random_paths(name, dynamics), int(count))]
        spent, unplanned = milliseconds(dynamics, paths, period)
        figures = [*np.percentile(spent, [50, 99]), 1e-3 * np.percentile(spent, 99) / period]
        told = " | ".join(f"{figure:.2f}" for figure in figures)
        print(f"| {name} | {len(spent)}, {unplanned} of them not planned | {told} |", flush=True)


def without_end(times):
    """A motion of the 2-RPR that never repeats itself, over the singular line once a second: up to 0.6 m/s."""
    rates, sizes = np.array([[1.3, 2.1], [1.9, 3.1]]), np.array([[0.08, 0.03], [0.12, 0.05]])  # rad/s and m, of x and y
    rates = rates * np.array([[1.0, np.sqrt(1.1)], [np.sqrt(0.9), np.pi / 3.0]])
    angle = rates * times[:, None, None] + np.array([[0.3, 1.0], [2.0, 0.5]])
    value, rate = sizes * np.sin(angle), sizes * rates * np.cos(angle)
    x, xd, xdd = (part.sum(axis=2) for part in (value, rate, -(rates**2) * value))
    return rp.PlatformMotion(times, x + np.array([0.25, 0.0]), xd, xdd)


def endless(ticks=100000):
    """Print, at every tenth of so many ticks of one planner: statuses, memory, iterations and times so far."""
    planner, counts, tenth = RecedingHorizon(machine("2rpr")), Counter(), max(int(ticks) // 10, 1)
    path, crossings, sign = Preview(without_end, 0.0, 1e9), 0, 0.0
    iterations, spent = Counter(), Counter()  # how often each, so that what is measured takes no memory
    for i in range(int(ticks)):
        before = time.thread_time()
        command = planner.update(planner.step * i, path)
        if i:
            spent[round(1e3 * (time.thread_time() - before), 2)] += 1
            iterations[planner.updates.last.iterations] += 1
        counts[command.status.value] += 1
        y = np.sign(without_end(np.array([planner.step * i])).x[0, 1])
        crossings, sign = crossings + (y != sign), y
        if (i + 1) % tenth == 0:
            size = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
            told = f"{i + 1} ticks: {dict(counts)}, {crossings - 1} times over y = 0, {size:.0f} MiB"
            print(f"{told}; iterations {spread(iterations)}; ms {spread(spent)}", flush=True)


def spread(counts):
    """Return the median, some percentiles and the largest of counted numbers, and how many times the median that is."""
    numbers = np.array(sorted(counts))
    up_to = np.cumsum([counts[number] for number in numbers.tolist()])
    median, *more = numbers[np.searchsorted(up_to, np.array([0.5, 0.99, 0.999, 1.0]) * up_to[-1])]
    told = ", ".join(f"{number:.3g}" for number in (median, *more))
    return f"(median, 99 %, 99.9 %, largest) {told}: {more[-1] / median:.2g} times"


def imperfect(number, times, **settings):
    """Return how far the platform of an imperfect machine is from its circle over two crossings, m, and the ticks."""
    known, sampling = rp.load_robot("2rpr", **MASSES), Sampling(1e-3, 1e-3)
    one, dynamics = Imperfections(), rp.CompiledDynamics(known)
    wrong = ("mass", "length", "start_position", "start_speed", "noise", *FRICTION)
    bounds = replace(one, **{name: times * getattr(one, name) for name in wrong})
    drawn, limits = draw(known, bounds, 0, number), {"effort_limit": 20.0, "carrier_force_limit": 40.0}
    planner = RecedingHorizon(dynamics, limits=rp.Limits(track=(-0.16, 0.16)))
    control = OnlinePlanning(planner, LOOP, sampling, effort_scale=2.0, dynamics=dynamics, **limits, **settings)
    true, point = rp.load_robot("2rpr", **{**MASSES, **drawn.arguments}), control.reference.at(0.0)
    home = closed_state(true, point.x, point.xd, point.s, point.sd).q - point.q
    beside = (point.x + drawn.x, point.xd + drawn.xd, point.s + drawn.s, point.sd + drawn.sd)
    factors = {"coulomb_factor": drawn.coulomb, "viscous_factor": drawn.viscous}
    run = rp.simulate(
        true,
        NoisyAmplifier(
            Encoders(control, control.reference, period=1e-3, time_constant=5e-3, phase=drawn.phase, home=home),
            drawn.random,
            bounds.noise,
        ),
        start=closed_state(true, *beside),
        duration=LOOP.duration,
        dt=1e-3,
        sampling=sampling,
        external=joint_friction(true, **{name: getattr(bounds, name) for name in FRICTION}, **factors),
        rtol=1e-6,
        atol=1e-8,
        integrator="RK45",
        **limits,
    )
    planned = np.array([control.reference.platform(float(t))[0] for t in run.t])
    return np.linalg.norm(run.x - planned, axis=1).max() if run.status.value == "ok" else np.inf, control.counts


def loop(count=10, times=1.0):
    """Print a row for each setting of the controller: machines within 2 mm, largest deviations, ticks."""
    for settings in LOOPS:
        runs = [imperfect(number, float(times), **settings) for number in range(int(count))]
        ticks, away = sum((Counter(run[1]) for run in runs), Counter()), 1e3 * np.array([run[0] for run in runs])
        told = f"{(away < 2.0).sum()} of {len(runs)}, {np.median(away):.2f} mm median, {away.max():.2f} mm at worst"
        print(f"{times} times, {settings}: {told}; {dict(ticks)}", flush=True)


def main(name="2rpr", count=10, least=10, file="build/online.jsonl"):
    """Go on where a file ends: ``least`` of the paths are planned off line too."""
    file = Path(file)
    file.parent.mkdir(parents=True, exist_ok=True)
    lines = file.read_text().splitlines() if file.exists() else []
    records = [record for record in map(json.loads, lines) if record["machine"] == name]
    done, dynamics = {record["path"] for record in records}, machine(name)
    for number, trajectory in zip(range(int(count)), random_paths(name, dynamics)):  # noqa: B905
        if number in done:
            continue
        records.append(judged(name, dynamics, number, trajectory, number < int(least)))
        with file.open("a") as out:
            out.write(json.dumps(records[-1]) + "\n")
        shown = {key: value for key, value in records[-1].items() if key not in ("milliseconds", "iterations")}
        print(shown, flush=True)
    planned = [record for record in records if "ticks" in record]
    whole = sum(record["ticks"]["ok"] == sum(record["ticks"].values()) for record in planned)
    kept = sum(record["status"] == "ok" for record in planned)
    hopeless = sum(record["off_line"] is False for record in planned)
    ratios = [record["ratio"] for record in planned[: int(least)] if record["ratio"]]
    times = np.percentile(np.concatenate([record["milliseconds"] for record in planned]), [50, 99])
    ticks = Counter()
    for record in planned:
        ticks.update(record["ticks"])
    print(
        f"{name}: {len(records)} paths, {hopeless} without a plan off line either; every tick planned on {whole}, "
        f"limits kept on {kept}; {dict(ticks)}; carriers beyond limits by {max(r['outside'] for r in planned):.1e} of "
        f"them; a tick {times[0]:.2f} ms p50, {times[1]:.2f} ms p99"
    )
    if ratios:
        print(f"peak over off line, {len(ratios)} paths: {np.median(ratios):.2f} median, {max(ratios):.2f} at worst")


if __name__ == "__main__":
    commands = {
        "compare": compare,
        "preview": preview,
        "ticks": ticks,
        "endless": endless,
        "loop": loop,
    }
    if sys.argv[1:2] and sys.argv[1] in commands:
        commands[sys.argv[1]](*sys.argv[2:])
    else:
        main(*sys.argv[1:])
