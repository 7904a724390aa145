"""Exact derivatives of the dynamics along a motion: casadi's of the symbols, through the closed loops by solving.

At a sample the tree's motion (q, v, a) and the multipliers μ solve

    Φ(q) = 0, x(q) = x;   K v = (0, ẋ);   K a + J̇ v = (0, ẍ);   Kᵀ μ = rnea(q, v, a) without the carriers' rows,

where K stacks the closures' Jacobian and the platform's. Then f is the lower part of μ, and with Kᵀ N = Sᵀ the
lower part of N is W; the upper parts determine the closure forces, λ = μ − N τ. Differentiated with respect to
anything, each line is a solve with K or Kᵀ, in this order. Casadi differentiates the other terms;
finite differences are taken of the numbers of a xacro file only (``design``). Expressions belong to a topology: robots
that differ in numbers share them.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array, BoolArray, Frozen, IntArray, blocks, checked, read_only
from redundancy_pin.dynamics.compiled.design import Design
from redundancy_pin.dynamics.compiled.parameters import Topology, parameter_vector, topology_of, trig_at
from redundancy_pin.dynamics.compiled.symbols import SymbolicChain, ca
from redundancy_pin.dynamics.distribution import CONSISTENCY_TOLERANCE, Distribution, distribute
from redundancy_pin.dynamics.results import ReducedDynamics
from redundancy_pin.robot import Robot
from redundancy_pin.spectrum import scaled

_SAMPLES_PER_BLOCK = 1000
"""Samples beyond these are worked on in blocks: a 3-RRR takes 40 kB a sample on the way."""


@dataclass(frozen=True, eq=False)
class Partials(Frozen):
    """Derivatives of one quantity, an array (N, ...) along the motion.

    Attributes:
        x: (N, ..., n) by the platform coordinates, 1/m and 1/rad. Of a pose by a small displacement in world axes: of
            the platform's origin, then a rotation about it.
        xd, xdd: (N, ..., n) by ẋ and ẍ.
        s, sd, sdd: (N, ..., k) by s, ṡ, s̈.
        parameters: (N, ..., d) by the design parameters, at fixed motion of platform and carriers.
    """

    x: Array
    xd: Array
    xdd: Array
    s: Array
    sd: Array
    sdd: Array
    parameters: Array


@dataclass(frozen=True, eq=False)
class MotionDerivatives(Frozen):
    """Exact derivatives along a motion, by platform motion, carriers and design parameters.

    N samples, n platform coordinates, m main actuators, k carriers, r closure rows, d parameters. Units and frames
    follow from the quantities. Rows of samples that are not reachable are NaN.

    Attributes:
        parameters: names of the design parameters.
        f: of the (N, n) generalised force.
        W: of the (N, n, m) actuation matrix.
        carrier_force: of the (N, k) carrier forces.
        base_wrench: of the (N, 6) wrench on the base.
        passive_closure_force: of the (N, r) closure forces λ₀ without main efforts.
        closure_share: of the (N, r, m) closure forces a unit of main effort takes away: λ = λ₀ − Λ τ.
        share: (N, r, m) Λ itself.
        reduced: (f, W) themselves.
    """

    parameters: tuple[str, ...]
    f: Partials
    W: Partials
    carrier_force: Partials
    base_wrench: Partials
    passive_closure_force: Partials
    closure_share: Partials
    share: Array
    reduced: ReducedDynamics

    @cached_property
    def efforts(self) -> Distribution:
        """The main efforts, with a status each: at a singular sample ``tau`` has no derivatives."""
        return distribute(self.reduced)

    @cached_property
    def tau(self) -> Partials:
        """Derivatives of the (N, m) main efforts, of least norm if they are not unique, as ``efforts`` has them.

        Of W τ = f by the implicit function: W ∂τ = ∂f − ∂W τ. Redundant efforts u = Aᵀ y, divided by their sizes (taken
        as constant, the characteristic length included), have least norm: their part in the null space of A follows
        from ∂Aᵀ y. NaN where W lacks rank, since efforts there grow without bound or jump to the least-norm values; and
        with fewer actuators than coordinates, by every variable that leads to an f that they cannot balance.
        """
        reduced, efforts = self.reduced, self.efforts
        at = efforts.solved & (efforts.rank == min(reduced.W.shape[1:]))
        rows, columns = reduced.row_scale, reduced.column_scale
        A, u = scaled(reduced.W, rows, columns)[at], efforts.tau[at] / columns
        back: Array = np.asarray(np.linalg.pinv(A))
        y = np.einsum("nmi,nm->ni", back, u)
        free = np.eye(A.shape[2]) - back @ A
        parts = []
        for field in fields(Partials):
            f_by, W_by = (getattr(of, field.name)[at] for of in (self.f, self.W))
            g_by, A_by = f_by / rows[:, None], W_by / rows[:, None, None] * columns[:, None]
            turned = np.einsum("nimc,nm->nic", A_by, u)
            part = back @ (g_by - turned) + free @ np.einsum("nimc,ni->nmc", A_by, y)
            left = np.linalg.norm(g_by - turned - A @ part, axis=1)
            allowed = CONSISTENCY_TOLERANCE * (np.linalg.norm(g_by, axis=1) + np.linalg.norm(turned, axis=1))
            part = np.where((left <= allowed)[:, None], part * columns[:, None], np.nan)
            whole = np.full((len(at), *part.shape[1:]), np.nan)
            whole[at] = part
            parts.append(read_only(whole))
        return Partials(*parts)

    def closure_force(self, tau: ArrayLike, tau_by: Partials | None = None) -> Partials:
        """Return the derivatives of the closure forces (N, r), as ``joint_reactions`` defines them.

        Args:
            tau: (N, m) main efforts that produce the motion, W τ = f, for example ``efforts.tau``.
            tau_by: the derivatives of ``tau``; zero when left out (constant efforts). Derivatives along efforts that
                keep producing the motion need them (``self.tau``).

        Raises:
            InputError: ``tau`` has the wrong shape.
        """
        effort = checked(tau, "tau", (self.share.shape[0], self.share.shape[2]))
        parts = []
        for field in fields(Partials):
            loose, share = (getattr(of, field.name) for of in (self.passive_closure_force, self.closure_share))
            part = loose - np.einsum("nrmc,nm->nrc", share, effort)
            if tau_by is not None:
                part = part - self.share @ getattr(tau_by, field.name)
            parts.append(read_only(part))
        return Partials(*parts)


# --- the symbols ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Functions:
    """casadi Functions of q, trig, v, a (``motion``), and of q, trig and a multiplier ν (``transposed``).

    The last two arguments are the robot's numbers and the derivatives of its model's numbers by the parameters, those
    that may differ from zero (``pattern``).
    """

    chain: SymbolicChain
    motion: Any
    transposed: Any


def _functions(robot: Robot, design: Design) -> tuple[_Functions, tuple[Array, Array]]:
    """Return the derivatives of a robot's topology, and their last two arguments for the robot and design."""
    touched: BoolArray = np.asarray(design.columns.any(axis=1))
    topology = topology_of(robot).varying(touched)
    rows, columns = np.nonzero(design.columns.T)  # column by column, as casadi lays matrices out
    pattern = tuple(zip(columns.tolist(), rows.tolist(), strict=True))
    constants = parameter_vector(robot, topology), design.columns.T[rows, columns]
    return _written(topology, len(design.names), pattern), constants


@lru_cache(maxsize=16)
def _written(topology: Topology, count: int, pattern: tuple[tuple[int, int], ...]) -> _Functions:
    """Write the derivatives of a topology by parameters that change some numbers; under a second for a 3-RRR.

    Args:
        topology: the topology.
        count: d, the number of parameters.
        pattern: number of the model and parameter of each derivative of the one by the other.
    """
    chain = SymbolicChain(topology.robot, topology)
    columns = chain.pose_columns.tolist()
    slopes = ca.SX.sym("slopes", len(pattern))
    seeds = ca.SX(chain.layout.size, count)
    places = chain.layout.starts["MODEL"] + np.cumsum(topology.free) - 1
    for k, (number, parameter) in enumerate(pattern):
        seeds[int(places[number]), parameter] = slopes[k]

    def by_parameters(expression: Any) -> Any:
        """Return the derivative (rows, d) by the parameters."""
        return ca.jtimes(expression, chain.parameters, seeds) if count else ca.SX(expression.numel(), 0)

    rates = chain.row_rates
    second = ca.substitute(rates, chain.v, chain.a) + chain.bias
    # where the coordinates are, less x: what a parameter opens is closed again by K times a tangent step
    opened = by_parameters(ca.vertcat(-chain.closure_rows, chain.missing))
    efforts, ground = chain.efforts
    outputs = [
        chain.K,
        ca.substitute(opened, chain.x, chain.coordinates),
        chain.by_tangent(rates)[:, columns],
        by_parameters(rates),
        chain.by_tangent(second)[:, columns],
        ca.jacobian(second, chain.v)[:, columns],
        by_parameters(second),
        efforts,
    ]
    for forces in (efforts, ground):
        outputs += [
            chain.by_tangent(forces),
            ca.jacobian(forces, chain.v),
            ca.jacobian(forces, chain.a),
            by_parameters(forces),
        ]
    multiplier = ca.SX.sym("nu", len(columns))
    transposed = chain.K.T @ multiplier
    pose, constants = [chain.q, chain.trig], [chain.parameters, slopes]
    return _Functions(
        chain,
        _function("motion", [*pose, chain.v, chain.a, chain.external, *constants], outputs),
        _function(
            "transposed",
            [*pose, multiplier, *constants],
            [chain.by_tangent(transposed)[:, columns], by_parameters(transposed)],
        ),
    )


def _function(name: str, inputs: list[Any], outputs: list[Any]) -> Any:
    # transposed: casadi's columns are numpy's rows
    return ca.Function(name, inputs, [ca.densify(part.T) for part in ca.cse(outputs)])


def _evaluated(function: Any, constants: tuple[Array, Array], *inputs: Array) -> list[Array]:
    """Return the results at many samples, (N, rows, columns) each; the constants are the same for all of them."""
    samples, count = len(inputs[0]), len(inputs)
    given = [*(np.asfortranarray(array.reshape(samples, -1).T) for array in inputs), *constants]
    results = function.map("samples", "serial", samples, [count, count + 1], []).call(given)
    return [
        np.ascontiguousarray(np.array(result).T).reshape(samples, function.size2_out(i), function.size1_out(i))
        for i, result in enumerate(results)
    ]


# --- the numbers ------------------------------------------------------------------------------------------------------


def motion_partials(
    robot: Robot, design: Design, q: Array, v: Array, a: Array, external: Array
) -> tuple[dict[str, Partials], Array, Array]:
    """Return the derivatives along a motion whose kinematics are solved, by names of ``MotionDerivatives``; W and Λ.

    Args:
        robot: the robot.
        design: how its numbers depend on the parameters.
        q: (N, nq) configurations, carriers included; NaN where the chains do not close.
        v: (N, nv) velocities, likewise.
        a: (N, nv) accelerations, likewise.
        external: (N, 6 w) the wrenches on the robot.
    """
    functions, constants = _functions(robot, design)
    samples, known = len(q), np.flatnonzero(np.isfinite(v).all(axis=1))
    wholes = {
        name: np.full((samples, *shape), np.nan) for name, shape in _shapes(functions.chain, len(design.names)).items()
    }
    for part in blocks(len(known), _SAMPLES_PER_BLOCK):
        at = known[part]
        motion = q[at], v[at], a[at], external[at]
        for name, result in _block(functions, constants, len(design.names), *motion).items():
            wholes[name][at] = result
    W, share = read_only(wholes.pop("actuation")), read_only(wholes.pop("share"))
    return {name: _split(robot, whole) for name, whole in wholes.items()}, W, share


def _shapes(chain: SymbolicChain, parameters: int) -> dict[str, tuple[int, ...]]:
    robot, r = chain.robot, chain.rows
    n, m, k = robot.n, robot.m, robot.k
    width = 3 * n + 3 * k + parameters
    return {
        "f": (n, width),
        "W": (n, m, width),
        "carrier_force": (k, width),
        "base_wrench": (6, width),
        "passive_closure_force": (r, width),
        "closure_share": (r, m, width),
        "actuation": (n, m),
        "share": (r, m),
    }


def _split(robot: Robot, whole: Array) -> Partials:
    edges = np.cumsum([robot.n] * 3 + [robot.k] * 3)
    return Partials(*(read_only(np.ascontiguousarray(part)) for part in np.split(whole, edges, axis=-1)))


def _block(
    functions: _Functions,
    constants: tuple[Array, Array],
    parameters: int,
    q: Array,
    v: Array,
    a: Array,
    external: Array,
) -> dict[str, Array]:
    chain, robot = functions.chain, functions.chain.robot
    pose: IntArray = chain.pose_columns
    carried, driven = robot.carrier_velocity, np.searchsorted(pose, robot.actuated_velocity)
    n, k, r, p, d = robot.n, robot.k, chain.rows, len(pose), parameters
    samples, width = len(q), 3 * n + 3 * k + d
    by_x, by_xd, by_xdd, by_carriers, by_design = (
        slice(first, last)
        for first, last in ((0, n), (n, 2 * n), (2 * n, 3 * n), (3 * n, 3 * n + 3 * k), (width - d, width))
    )
    trig = trig_at(robot, q)
    K, opened, A_q, A_d, C_q, C_v, C_d, efforts, *rest = _evaluated(
        functions.motion, constants, q, trig, v, a, external
    )
    inverse: Array = np.asarray(np.linalg.inv(K), dtype=np.float64)
    # (q, v, a): the platform's rows are prescribed, the closures stay shut
    right = np.zeros((3, samples, p, width))
    for order, columns in enumerate((by_x, by_xd, by_xdd)):
        right[order, :, r:, columns] = np.eye(n)
    right[0][..., by_design] = opened
    right[1][..., by_design] = -A_d
    right[2][..., by_design] = -C_d
    y: Array = inverse @ right[0]
    y_v = inverse @ (right[1] - A_q @ y)
    y_a = inverse @ (right[2] - C_q @ y - C_v @ y_v)

    def along(by_q: Array, by_v: Array, by_a: Array, own: Array) -> Array:
        """Return the derivative of a quantity that depends on the tree's motion, and on the parameters directly."""
        total = by_q[..., pose] @ y + by_v[..., pose] @ y_v + by_a[..., pose] @ y_a
        total[..., by_carriers] += np.concatenate([part[..., carried] for part in (by_q, by_v, by_a)], axis=-1)
        total[..., by_design] += own
        result: Array = total
        return result

    effort_by, wrench_by = along(*rest[:4]), along(*rest[4:])
    # columns of (μ, N): solutions with Kᵀ, one of them for the motion and one for each actuator
    loads = np.zeros((samples, p, 1 + len(driven)))
    loads[:, :, 0] = efforts[:, pose, 0]
    loads[:, driven, 1 + np.arange(len(driven))] = 1.0
    multipliers = inverse.transpose(0, 2, 1) @ loads
    loads_by = np.zeros((samples, 1 + len(driven), p, width))
    loads_by[:, 0] = effort_by[:, pose]
    for column in range(1 + len(driven)):
        T_q, T_d = _evaluated(functions.transposed, constants, q, trig, multipliers[:, :, column])
        loads_by[:, column] -= T_q @ y
        loads_by[:, column][..., by_design] -= T_d
    multipliers_by = inverse.transpose(0, 2, 1)[:, None] @ loads_by
    unit = multipliers_by[:, 1:].transpose(0, 2, 1, 3)  # (N, p, m, width)
    return {
        "f": multipliers_by[:, 0, r:],
        "W": unit[:, r:],
        "carrier_force": effort_by[:, carried],
        "base_wrench": -wrench_by,
        "passive_closure_force": multipliers_by[:, 0, :r],
        "closure_share": unit[:, :r],
        "actuation": multipliers[:, r:, 1:],
        "share": multipliers[:, :r, 1:],
    }
