"""How the optimum of a whole-trajectory plan changes with the machine: the envelope theorem.

Of the least cost φ(p) of a programme with the Lagrangian L(x, λ; p) the derivative is ∂L/∂p at the optimum: what the
plan changes adds nothing. Here p enters by the numbers of the programme alone: W, f, the carriers' forces and the rates
of the actuators at the nodes, by the kernels' exact derivatives along the plan, and the limits that a machine has.
L is affine in them, so the numbers are moved by a finite amount, and the difference is the derivative to rounding. Not
so in the characteristic length, nor need ends of tracks be in a number of the file: hence the amount is small.

At a singular instant the programme requires uᵀ (Ẇ τ − ḟ) = 0, u turning with p: uᵀ W = 0 gives δuᵀ W = −uᵀ δW, and
with Ẇ τ − ḟ = −W τ̇ the row changes by uᵀ d/dt (δW τ − δf) along the plan. That the instant itself moves adds nothing
more: W τ = f holds on both sides of it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import casadi as ca
import numpy as np

from redundancy_pin.arrays import Array, read_only
from redundancy_pin.errors import UnsupportedRobotError
from redundancy_pin.motion import CarrierMotion, PlatformMotion
from redundancy_pin.planners.limits import ResolvedLimits
from redundancy_pin.planners.optimal.objectives import OBJECTIVES
from redundancy_pin.planners.optimal.problem import Problem, SingularNode, Task, times_beside
from redundancy_pin.planners.optimal.settings import Settings
from redundancy_pin.planners.optimal.solve import Outcome
from redundancy_pin.planners.optimal.transcription import transcribe
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial

MOVED = 1e-6
"""By which parameters are moved, in their units. From 1e-2 to 1e-7 gradients are the same to 1e-8 where L is affine."""


class DesignSlopes(NamedTuple):
    """Derivatives by d parameters at N samples, the motion held.

    Of W (N, n, m, d), f (N, n, d), carriers' forces (N, k, d), and the wrench on the base about the world origin (N, 6,
    d).
    """

    W: Array
    f: Array
    carrier_force: Array
    base_wrench: Array


class Moved(NamedTuple):
    """What else a machine with a parameter increased by ``MOVED`` has: limits and characteristic length, m."""

    limits: ResolvedLimits
    length: float


Slopes = Callable[[PlatformMotion, CarrierMotion], DesignSlopes]
"""Derivatives of a backend by the parameters, along a motion."""


def design_gradient(task: Task, outcome: Outcome, slopes: Slopes, machines: Sequence[Moved]) -> Array:
    """Return (d,) derivatives of the weighted objectives of an optimum by design parameters, in their units.

    Args:
        task: the task.
        outcome: its optimum.
        slopes: the backend's derivatives by the parameters.
        machines: for each parameter.

    Raises:
        UnsupportedRobotError: f is an expression, as with carriers on carriers.
    """
    problem, solution = outcome.problem, outcome.solution
    if problem.exact is not None or solution.rows["elastic"]:
        raise UnsupportedRobotError(
            f"f of {task.dynamics.robot.name} has other terms than those of carriers that slide or turn on a link: how "
            "the optimum changes with the machine is not known.",
            remedy="Design with carriers that stand on links.",
        )
    carriers, motion = problem.carriers(solution.values), task.source.sample_at(problem.grid.t)
    at_nodes, tau = slopes(motion, carriers), problem.tau(solution.values)
    turned = [_turned(task, problem, node, carriers, tau, slopes) for node in problem.singular]
    at_optimum, at_length = _lagrangian(outcome, problem), task.dynamics.robot.characteristic_length
    terms = ((weight, OBJECTIVES[name]) for name, weight in problem.settings.objective.items())
    size = sum(weight * term.size(problem.scales) for weight, term in terms)
    gradient = np.empty(at_nodes.f.shape[-1])
    base = base_slopes(problem.settings, motion, at_nodes.base_wrench, slopes)
    for j, machine in enumerate(machines):
        W, f, force = (MOVED * part[..., j] for part in (at_nodes.W, at_nodes.f, at_nodes.carrier_force))
        model = problem.model
        moved = replace(
            problem,
            model=replace(model, W=model.W + W, f0=model.f0 + f, force0=model.force0 + force),
            actuated_rate=problem.actuated_rate + np.einsum("nim,ni->nm", W, motion.xd),
            singular=tuple(
                replace(node, rate=replace(node.rate, f0=node.rate.f0 - MOVED * change[None, :, j]))
                for node, change in zip(problem.singular, turned, strict=True)
            ),
            settings=replace(problem.settings, limits=machine.limits),
            scales=replace(problem.scales, length=problem.scales.length + machine.length - at_length),
            base=problem.base and replace(problem.base, w0=problem.base.w0 + MOVED * base[..., j]),
        )
        gradient[j] = size * (_lagrangian(outcome, moved) - at_optimum) / MOVED
    return read_only(gradient)


def base_slopes(settings: Settings, motion: PlatformMotion, by: Array, slopes: Slopes) -> Array:
    """Return (N, 6, d) derivatives of the wrench on the base about the point, less the load at rest, N and N·m.

    ``by`` (N, 6, d): those of the wrench about the world origin.
    """
    still, rest = np.zeros_like(motion.xd[:1]), np.zeros((1, len(settings.start)))
    standing = PlatformMotion(motion.t[:1], motion.x[:1], still, still)
    less = by - slopes(standing, CarrierMotion(settings.start[None], rest, rest)).base_wrench
    moment = less[:, 3:] - np.cross(settings.base_point, np.moveaxis(less[:, :3], 1, -1)).swapaxes(1, 2)
    return np.concatenate([less[:, :3], moment], axis=1)


def _turned(task: Task, problem: Problem, node: SingularNode, plan: CarrierMotion, tau: Array, slopes: Slopes) -> Array:
    """Return (n, d) the rate of δW τ − δf along the plan at a singular node."""
    h, t, i = problem.grid.h, float(problem.grid.t[node.index]), node.index
    before = i == len(h) or h[i] == 0.0
    edges, times = times_beside(task.source, t, "left" if i < len(h) and before else "right")
    step = i - 1 if before else i  # whose jerk both sides have
    jerk, since = (plan.sdd[step + 1] - plan.sdd[step]) / h[step], (times - t)[:, None]
    # values and first rates at the node are all that counts
    s, sd, sdd = (
        values[i] + since * rate for values, rate in ((plan.s, plan.sd[i]), (plan.sd, plan.sdd[i]), (plan.sdd, jerk))
    )
    motion, carriers = task.source.sample_at(times), CarrierMotion(s, sd, sdd, check_rates=False)
    reduced, by_design = task.dynamics.along(motion).reduce(carriers), slopes(motion, carriers)

    def at(values: Array) -> tuple[Array, Array]:
        """Return a function of time at the node, and its rate."""
        values = np.asarray(values)
        fitted = PiecewisePolynomial.from_values(edges, values.reshape(1, len(times), -1))
        return fitted.at(t).reshape(values.shape[1:]), fitted.derivative().at(t).reshape(values.shape[1:])

    W, W_rate = at(reduced.W)
    _, f_rate = at(reduced.f)
    by_W, by_W_rate = at(by_design.W)
    _, by_f_rate = at(by_design.f)
    tau_rate = np.linalg.lstsq(W, f_rate - W_rate @ tau[i], rcond=1e-6)[0]
    # what W annihilates of it decides nothing here but how the instant moves: the plan's own slope is near enough
    null = np.eye(W.shape[1]) - np.linalg.pinv(W, rcond=1e-6) @ W
    around = [j for j in (i - 1, i + 1) if 0 <= j <= len(h) and problem.grid.t[j] != t]
    at_steps = np.array([(tau[j] - tau[i]) / (problem.grid.t[j] - t) for j in around])
    share = np.abs([problem.grid.t[j] - t for j in around[::-1]])
    tau_rate = tau_rate + null @ (share @ at_steps / share.sum())
    change: Array = np.einsum("imd,m->id", by_W_rate, tau[i]) + np.einsum("imd,m->id", by_W, tau_rate) - by_f_rate
    return change


def _lagrangian(outcome: Outcome, problem: Problem) -> float:
    """Return the Lagrangian, with the multipliers of the optimum, of a problem with other numbers."""
    solution = outcome.solution
    nlp = transcribe(problem, **solution.rows)
    x, lam_x, lam_g = solution.point
    functions, bounds = nlp.functions, nlp.bounds
    cost, rows = ca.Function("rows", [functions["x"]], [functions["f"], functions["g"]])(x)

    def beyond(values: Array, multipliers: Array, name: str) -> float:
        """Return what multipliers make of the distances from the bounds that they belong to."""
        bound = np.where(multipliers > 0.0, bounds[f"ub{name}"], bounds[f"lb{name}"])
        near = np.isfinite(bound)
        return float(multipliers[near] @ (values - bound)[near])

    return float(cost) + beyond(np.asarray(rows).ravel(), lam_g, "g") + beyond(x, lam_x, "x")
