"""The on-line planner as C for a controller: ``receding_horizon``'s own text, its settings, and what a caller sees."""

from __future__ import annotations

import importlib.resources
from dataclasses import dataclass
from typing import Any

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.codegen.names import as_initialiser
from redundancy_pin.codegen.stack import stack_bytes
from redundancy_pin.dynamics.compiled import CompiledDynamics
from redundancy_pin.dynamics.compiled.build import NEIGHBOURS
from redundancy_pin.errors import InputError, UnreachablePoseError, UnsupportedRobotError
from redundancy_pin.kinematics.branch import follower
from redundancy_pin.kinematics.coordinates import moved
from redundancy_pin.kinematics.inverse_kinematics import inverse_kinematics
from redundancy_pin.machine_code import NEEDS_INFINITY
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.planners.receding_horizon import RecedingHorizon
from redundancy_pin.planners.receding_horizon.command import UpdatePlan
from redundancy_pin.planners.receding_horizon.compiled import (
    STATUSES,
    planner_library,
    planner_source,
    settings_of,
    sizes_of,
)
from redundancy_pin.planners.receding_horizon.constants import (
    BATCH,
    INSTANTS,
    ITERATIONS,
    MOST_ROOTS,
    MOST_ROUNDS,
    MOST_SINGULAR,
    PARTS,
    RELAXED_ITERATIONS,
    SLOWER,
)
from redundancy_pin.planners.receding_horizon.preview import Preview
from redundancy_pin.robot import Robot
from redundancy_pin.robot.checks import is_pose
from redundancy_pin.robot.scales import row_scale, turning_velocities

UPDATES = 100
"""Recorded updates, at most."""

TERMS = 5
"""Of carriers on straight tracks, which generated code has."""


@dataclass(frozen=True, eq=False)
class RecordedPlan:
    """Updates of a planner along a preview.

    Attributes:
        preview: the platform's motion.
        plans: the plan of each update.
    """

    preview: Preview
    plans: tuple[UpdatePlan, ...]


def record_plan(planner: RecedingHorizon, motion: PlatformMotion | None) -> RecordedPlan:
    """Return what a planner of the same settings does along a motion, or a smooth one about the reference.

    Raises:
        InputError: a motion that is none, or at whose start there is no plan.
        UnsupportedRobotError: carriers that turn: f is no sum of the terms that generated code has.
    """
    robot = planner.robot
    if turning_velocities(robot)[robot.carrier_velocity].any():
        raise UnsupportedRobotError(
            f"{robot.name} has carriers that turn, which the on-line planner for a controller does not take.",
            remedy="Use RecedingHorizon from Python, or carriers on straight tracks.",
        )
    again = RecedingHorizon(
        CompiledDynamics(robot),
        horizon=planner.horizon,
        step=planner.step,
        objective=planner.weights,
        limits=planner.limits,
        slow_down=planner.slows_down,
    )
    preview = Preview.of(_smooth_motion(robot) if motion is None else motion)
    if preview.polynomials is None:
        raise InputError("The preview is no polynomials.", remedy="Pass samples of the motion.")
    last = float(preview.polynomials.end)
    times = np.arange(preview.start, last, max(planner.step, (last - preview.start) / UPDATES))
    plans = []
    for t in times.tolist():
        again.update(t, preview)
        if again.updates.last is not None:
            plans.append(again.updates.last)
    return RecordedPlan(preview, tuple(plans))


def _smooth_motion(robot: Robot) -> PlatformMotion:
    """Return a closed path about the reference in two seconds, as far out as the robot can follow."""
    t = np.linspace(0.0, 2.0, 201)
    random, turning = np.random.default_rng(0), is_pose(robot)
    size = robot.characteristic_length / row_scale(robot) * random.uniform(0.3, 1.0, robot.n)
    if turning:
        size[3:] = 0.0  # the platform of a pose only moves
    phase = np.outer(t, np.full(robot.n, np.pi)) + random.uniform(0.0, np.pi, robot.n)
    home, reach = np.repeat(follower(robot).home.x[None], len(t), axis=0), 0.15
    while True:
        a = reach * size
        wave = a * (np.sin(phase) ** 2 - np.sin(phase[:1]) ** 2)
        rates = a * np.pi * np.sin(2.0 * phase), 2.0 * a * np.pi**2 * np.cos(2.0 * phase)
        motion = PlatformMotion(t, moved(robot, home, wave), *rates)
        try:
            inverse_kinematics(robot, motion)
        except UnreachablePoseError:
            reach *= 0.5
            if reach < 1e-4:
                raise
        else:
            return motion


def plan_source(planner: RecedingHorizon, prefix: str) -> str:
    """Return the C of the planner without the prefix."""
    robot = planner.robot
    settings = settings_of(robot, planner.step, planner.horizon, planner.weights, planner.resolved)
    listed = ", ".join(map(as_initialiser, settings))
    text = importlib.resources.files(__package__).joinpath("plan.c").read_text(encoding="utf-8")
    return "\n".join(
        [
            f"/* The on-line planner; see {prefix}.h. */",
            NEEDS_INFINITY,
            f'#include "{prefix}.h"',
            planner_source(_sizes(planner)),
            f"#define NEAR_NUMBERS {_near(robot)}",
            f"static const long SLOWS = {int(planner.slows_down)};",
            f"static const Settings SETTINGS = {{{listed}}};",
            text,
        ]
    )


def _sizes(planner: RecedingHorizon) -> dict[str, int]:
    return sizes_of(planner.robot, planner.step, planner.horizon, TERMS)


def _near(robot: Robot) -> int:
    return NEIGHBOURS * (int(robot.model.nq) + (16 if is_pose(robot) else robot.n))


def plan_stack_bytes(planner: RecedingHorizon) -> int:
    """Return how much stack, bytes, the deepest call of the planner takes at most, as ``pages.stack_bytes`` counts.

    All arrays of the functions that call one another count, as if all were in one frame, and the dynamics behind them.
    """
    sizes, robot = _sizes(planner), planner.robot
    n, m, k, count = (sizes[name] for name in ("N", "M", "K", "COUNT"))
    grid = PARTS * (sizes["STEPS"] + 1) + 4
    wanted = grid + count + 2 * MOST_SINGULAR + INSTANTS + 3 * MOST_ROOTS
    free, moves = k + m, 3 * k
    wide, sides = moves + free + 8, 2 * MOST_SINGULAR + 3
    of_window = 6 * grid + 2 * wanted + BATCH * (sizes["PLACES"] + 2 * n + 6) + 7 * MOST_ROOTS
    of_plan = INSTANTS * (n + 2 * k + m + 6) + 8 * count + 8 * (2 * MOST_SINGULAR + 2)
    of_solver = (2 * moves + free + moves + free) * wide + sides * (2 * wide + sides + 4) + 8 * count * k
    return int(8 * (of_window + of_plan + of_solver)) + stack_bytes(robot)


def most_iterations(*, slows: bool) -> int:
    """Return the steps of the interior point method in an update at most.

    Programmes begin with a solution before, without one, and relaxed, about the last plan and about another motion;
    each change of the speed that is tried has those that are not relaxed.
    """
    tried = MOST_ROUNDS * 2 * ITERATIONS * (len(SLOWER) + 4)
    return 2 * MOST_ROUNDS * (2 * ITERATIONS + RELAXED_ITERATIONS) + (tried if slows else 0)


def plan_facts(planner: RecedingHorizon, recorded: RecordedPlan) -> dict[str, Any]:
    """Return what the templates need of the planner and its updates."""
    robot, preview = planner.robot, recorded.preview
    polynomials = preview.polynomials
    if polynomials is None:
        raise InputError("The preview is no polynomials.", remedy="Pass samples of the motion.")
    numbers = {status: number for number, status in STATUSES.items()}
    commands = [plan.command for plan in recorded.plans]
    motions = [np.stack(command.motion_at(command.t)) for command in commands]
    taus = np.stack([command.tau for command in commands])
    rows = []
    for command, motion, tau in zip(commands, motions, taus, strict=True):
        sigma = command.t if command.scaling is None else float(command.scaling.at([command.t])[0][0])
        fields = (command.t, np.int64(numbers[command.status]), *motion, tau, command.known_until, sigma)
        rows.append("  {" + ", ".join(map(as_initialiser, fields)) + "}")
    size: Array = np.abs(np.stack(motions)).max(axis=0)
    return {
        "step": f"{planner.step:g}",
        "horizon": f"{planner.horizon:g}",
        "slows": planner.slows_down,
        "iterations": most_iterations(slows=planner.slows_down),
        # of structures whose places a compiler may pad, with room for what stands beside the planner
        "doubles": int(planner_library(_sizes(planner)).rp_planner_size()) // 8 + _near(robot) + 64,
        "stack": plan_stack_bytes(planner),
        "updates": len(commands),
        "edges": as_initialiser(polynomials.edges),
        "coefficients": as_initialiser(polynomials.coefficients.ravel()),
        "breaks": as_initialiser(preview.breaks if len(preview.breaks) else np.zeros(1)),
        "break_count": len(preview.breaks),
        "pieces": len(polynomials.edges) - 1,
        "order": len(polynomials.coefficients),
        "moves_until": as_initialiser(preview.moves_until),
        "end": as_initialiser(preview.end),
        "size": as_initialiser(np.maximum(size, 1e-3 * size.max(axis=1, keepdims=True) + 1e-12)),
        "tau_size": as_initialiser(np.full(robot.m, np.abs(taus).max() + 1e-12)),
        "recorded": ",\n".join(rows),
    }
