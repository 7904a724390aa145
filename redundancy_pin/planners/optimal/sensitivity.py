"""How the optimum of a whole-trajectory or least-time plan changes with the machine: the envelope theorem.

Of the least cost φ(p) of a programme with the Lagrangian L(x, λ; p) the derivative is ∂L/∂p at the optimum: what the
plan changes adds nothing. Here p enters by the numbers of the programme alone: W, f, the carriers' forces and the rates
of the actuators at the nodes, by the kernels' exact derivatives along the plan, and the limits that a machine has.
Along a path whose timing is planned, f and the forces are sums over 1, ṗ, ṗ² and p̈; at the optimum these are numbers,
so what the sum changes by may stand in its first coefficient. There p enters by the largest ṗ of the actuators too.
L is affine in them, so a finite change of the numbers gives the derivative to machine precision. Not
so in the characteristic length, nor need ends of tracks be in a number of the file: hence the step is small.

At a singular instant the programme requires uᵀ (Ẇ τ − ḟ) = 0, u turning with p: uᵀ W = 0 gives δuᵀ W = −uᵀ δW, and
with Ẇ τ − ḟ = −W τ̇ the row changes by uᵀ d/dt (δW τ − δf) along the plan. That the instant itself moves adds nothing
more: W τ = f holds on both sides of it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import casadi as ca
import numpy as np

from redundancy_pin.arrays import Array, read_only
from redundancy_pin.dynamics.default import design_derivatives
from redundancy_pin.dynamics.results import ReducedDynamics
from redundancy_pin.errors import DeclarationError, InputError, ModelFileError, UnsupportedRobotError
from redundancy_pin.loading import with_parameters
from redundancy_pin.motion import CarrierMotion, PlatformMotion
from redundancy_pin.planners.optimal.path_problem import fastest_speed
from redundancy_pin.planners.optimal.problem import PathTiming, Problem, SingularNode, Task, times_beside
from redundancy_pin.planners.optimal.settings import Settings
from redundancy_pin.planners.optimal.solve import Outcome
from redundancy_pin.planners.optimal.transcription import objective_sizes, transcribe
from redundancy_pin.planners.options import Limits
from redundancy_pin.planners.singular_instant import LOST, SingularInstant
from redundancy_pin.robot import Robot
from redundancy_pin.trajectory.continuous_motion import Motion
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial

STEP = 1e-6
"""Step of the differences, relative to the parameter (``DesignedRobot.neighbours``). Where L is affine, gradients are
the same to 1e-8 from 1e-2 to 1e-7; where it is not, they err by about this."""


class DesignSlopes(NamedTuple):
    """Derivatives by d parameters at N samples, at fixed motion.

    Of W (N, n, m, d), f (N, n, d), carriers' forces (N, k, d), and the wrench on the base about the world origin (N, 6,
    d).
    """

    W: Array
    f: Array
    carrier_force: Array
    base_wrench: Array


NO_ROBOT = (DeclarationError, InputError, ModelFileError)
"""What ``with_parameters`` raises for a number of which the robot's file makes no robot: loops that do not close, a
condition under ``requires``, a negative mass."""


@dataclass(frozen=True, eq=False)
class DesignedRobot:
    """A robot and the numbers of its file that are designed.

    Attributes:
        robot: the robot.
        names: (d,) names of the parameters.
    """

    robot: Robot
    names: tuple[str, ...]

    def slopes(self, motion: PlatformMotion, carriers: CarrierMotion) -> DesignSlopes:
        """Return the derivatives along a motion by the parameters."""
        by = design_derivatives(self.robot, motion, carriers, self.names)
        return DesignSlopes(*(part.parameters for part in (by.W, by.f, by.carrier_force, by.base_wrench)))

    @cached_property
    def neighbours(self) -> tuple[tuple[Robot, float], ...]:
        """(d,) the robots with one parameter changed each, and by how much; decreased if an increase is invalid."""
        return tuple(self._neighbour(name) for name in self.names)

    def _neighbour(self, name: str) -> tuple[Robot, float]:
        value = float(self.robot.parameters[name])
        # of a number near 0 the size is not known: as in ``compiled.design``, small for a length of the machine
        step = STEP * max(abs(value), min(1.0, self.robot.characteristic_length))
        try:
            return with_parameters(self.robot, **{name: value + step}), step  # type: ignore[arg-type]
        except NO_ROBOT:
            return with_parameters(self.robot, **{name: value - step}), -step  # type: ignore[arg-type]


def design_gradient(task: Task, outcome: Outcome, platform: Motion, designed: DesignedRobot, limits: Limits) -> Array:
    """Return (d,) derivatives of the weighted objectives, or of the duration, of an optimum by design parameters.

    Args:
        task: the task.
        outcome: its optimum.
        platform: motion of the platform at the optimum: the motion of the task, or the one along its path.
        designed: the robot and its parameters.
        limits: as given, in place of the robot's own.

    Raises:
        UnsupportedRobotError: f is an expression, as with carriers on carriers.
    """
    problem, solution, timing = outcome.problem, outcome.solution, outcome.problem.timing
    if problem.exact is not None or solution.rows["elastic"]:
        raise UnsupportedRobotError(
            f"f of {task.dynamics.robot.name} has other terms than carriers that slide or turn on a link give: the "
            "derivative of the optimum by the machine is not known.",
            remedy="Design with carriers that are on links.",
        )
    carriers, motion = problem.carriers(outcome.values), platform.sample_at(problem.times(outcome.values))
    at_nodes, per_time = designed.slopes(motion, carriers), task.source.sample_at(problem.grid.t).xd
    turned = [_turned(task, outcome, platform, node, designed) for node in problem.singular]
    at_optimum, at_length = _lagrangian(outcome, problem), task.dynamics.robot.characteristic_length
    size = problem.scales.duration if timing else problem.settings.weighted(objective_sizes(problem))
    gradient = np.empty(at_nodes.f.shape[-1])
    base = base_slopes(problem.settings, motion, at_nodes.base_wrench, designed)
    for j, (robot, step) in enumerate(designed.neighbours):
        own = limits.resolved(robot)
        W, f, force = (step * part[..., j] for part in (at_nodes.W, at_nodes.f, at_nodes.carrier_force))
        model, rate = problem.model, problem.actuated_rate + np.einsum("nim,ni->nm", W, per_time)
        moved = replace(
            problem,
            model=replace(
                model, W=model.W + W, f0=_added(model.f0, f, timing), force0=_added(model.force0, force, timing)
            ),
            actuated_rate=rate,
            singular=tuple(
                replace(node, rate=replace(node.rate, f0=_added(node.rate.f0, -step * change[None, :, j], timing)))
                for node, change in zip(problem.singular, turned, strict=True)
            ),
            settings=replace(problem.settings, limits=own),
            scales=replace(problem.scales, length=problem.scales.length + robot.characteristic_length - at_length),
            base=problem.base and replace(problem.base, w0=problem.base.w0 + step * base[..., j]),
            timing=timing and replace(timing, fastest=fastest_speed(rate, own)),
        )
        gradient[j] = size * (_lagrangian(outcome, moved) - at_optimum) / step
    return read_only(gradient)


def _added(coefficients: Array, change: Array, timing: PathTiming | None) -> Array:
    """Return coefficients with a change of their sum: along a path, of the part that neither ṗ nor p̈ multiplies."""
    added = coefficients.copy()
    added[... if timing is None else (..., 0)] += change
    return added


def base_slopes(settings: Settings, motion: PlatformMotion, by: Array, designed: DesignedRobot) -> Array:
    """Return (N, 6, d) derivatives of the wrench on the base about the point, less the load at rest, N and N·m.

    ``by`` (N, 6, d): derivatives of the wrench about the world origin.
    """
    still, rest = np.zeros_like(motion.xd[:1]), np.zeros((1, len(settings.start)))
    standing = PlatformMotion(motion.t[:1], motion.x[:1], still, still)
    less = by - designed.slopes(standing, CarrierMotion(settings.start[None], rest, rest)).base_wrench
    moment = less[:, 3:] - np.cross(settings.base_point, np.moveaxis(less[:, :3], 1, -1)).swapaxes(1, 2)
    return np.concatenate([less[:, :3], moment], axis=1)


def _turned(task: Task, outcome: Outcome, platform: Motion, node: SingularNode, designed: DesignedRobot) -> Array:
    """Return (n, d) the rate of δW τ − δf along the plan at a singular node: by time, along a path by its length."""
    problem, values, i = outcome.problem, outcome.values, node.index
    plan, tau, nodes = problem.carriers(values), problem.tau(values), problem.times(values)
    t, h, jump = float(nodes[i]), np.diff(nodes), problem.grid.h == 0.0
    before = i == len(h) or bool(jump[i])
    edges, times = times_beside(platform, t, "left" if i < len(h) and before else "right")
    step = i - 1 if before else i  # whose jerk both sides have
    jerk = (plan.sdd[step + 1] - plan.sdd[step]) / h[step]

    def at(times: Array) -> tuple[PlatformMotion, CarrierMotion]:
        """Return the motion at times; values and first rates at the node are all that counts."""
        rates = ((plan.s, plan.sd[i]), (plan.sd, plan.sdd[i]), (plan.sdd, jerk))
        carriers = (values[i] + (times - t)[:, None] * rate for values, rate in rates)
        return platform.sample_at(times), CarrierMotion(*carriers, check_rates=False)

    def reduced_at(times: Array) -> ReducedDynamics:
        motion, carriers = at(times)
        return task.dynamics.along(motion).reduce(carriers)

    def rate(values: Array) -> tuple[Array, Array]:
        """Return a function of time at the node, and its rate."""
        fitted = PiecewisePolynomial.from_values(edges, values.reshape(1, len(times), -1))
        return fitted.at(t).reshape(values.shape[1:]), fitted.derivative().at(t).reshape(values.shape[1:])

    instant, by_design = SingularInstant.along(reduced_at, edges, t), designed.slopes(*at(times))
    by_W, by_W_rate = rate(by_design.W)
    _, by_f_rate = rate(by_design.f)
    tau_rate = np.linalg.lstsq(instant.W, instant.f_rate - instant.W_rate @ tau[i], rcond=LOST)[0]
    # what W annihilates of it decides nothing here but how the instant moves: the plan's own slope is near enough
    null = np.eye(tau.shape[1]) - np.linalg.pinv(instant.W, rcond=LOST) @ instant.W
    around = [j for j in (i - 1, i + 1) if 0 <= j <= len(h) and nodes[j] != t]
    at_steps = np.array([(tau[j] - tau[i]) / (nodes[j] - t) for j in around])
    share = np.abs([nodes[j] - t for j in around[::-1]])
    tau_rate = tau_rate + null @ (share @ at_steps / share.sum())
    change: Array = np.einsum("imd,m->id", by_W_rate, tau[i]) + np.einsum("imd,m->id", by_W, tau_rate) - by_f_rate
    if problem.timing is not None:
        change /= problem.timing.powers(values)[i, 1]
    return change


def _lagrangian(outcome: Outcome, problem: Problem) -> float:
    """Return the Lagrangian, with the multipliers of the optimum, of a problem with other numbers."""
    solution = outcome.solution
    nlp = transcribe(problem, **solution.rows)
    x, lam_x, lam_g = solution.point
    functions, bounds = nlp.functions, nlp.bounds
    cost, rows = ca.Function("rows", [functions["x"]], [functions["f"], functions["g"]])(x)

    def beyond(values: Array, multipliers: Array, name: str) -> float:
        """Return Σ multiplier (value − bound): each with the bound that its sign selects, finite bounds only."""
        bound = np.where(multipliers > 0.0, bounds[f"ub{name}"], bounds[f"lb{name}"])
        near = np.isfinite(bound)
        return float(multipliers[near] @ (values - bound)[near])

    return float(cost) + beyond(np.asarray(rows).ravel(), lam_g, "g") + beyond(x, lam_x, "x")
