"""How much stack the generated functions take at most, and which of them are written."""

from __future__ import annotations

from typing import Any

from redundancy_pin.dynamics.compiled.build import Definition, define
from redundancy_pin.robot import Robot

_FUNCTIONS = ("turns", "rows", "bias", "moved", "modes", "coordinates", "project")
"""Generated functions that ``driver.c`` and ``controller.c`` call; a static one without a caller is a warning."""


def written_functions(robot: Robot) -> tuple[Definition, list[Any]]:
    """Return the functions of a robot's topology, and those of them that a controller needs."""
    definition = define(robot)
    names = [*_FUNCTIONS, "drives"] if robot.m >= robot.n else _FUNCTIONS
    return definition, [definition.functions[f"rp_{name}"] for name in names]


_FRAMES = 2048
"""Bytes of stack for what is not counted by name: registers, pointers and indices of eight functions that call one
another (1 kB), and functions of math.h."""


def stack_bytes(robot: Robot) -> int:
    """Return how much stack, bytes, the deepest call takes at most: whatever is optimised, and all of it inlined.

    It counts the arrays of all functions of the deepest call, forward kinematics or going to a pose, as if none shared
    its place, and a place for each value of the largest expression, as unoptimised code has it.
    """
    definition, functions = written_functions(robot)
    chain, n, m = definition.chain, robot.n, robot.m
    nq, nv, rows = chain.model.nq, chain.model.nv, len(chain.pose_columns) + 1
    short, long, state = min(n, m), max(n, m), nq + 2 * len(chain.turning)
    matrices = 4 * rows**2  # of closures and platform: factors of three states, and one on the way
    tree = nv * (n + 4) + 3 * state + 8 * rows
    spectra = 2 * (short * long + short**2 + 2 * short + 4)
    arguments = 3 * int(chain.x.numel() + n * m + 2 * n + 2 * m + 3 * robot.k + chain.alignment.numel())
    values = max(int(function.n_instructions()) for function in functions)
    return int(8 * (matrices + tree + spectra + arguments + values)) + _FRAMES
