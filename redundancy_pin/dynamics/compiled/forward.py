"""Forward dynamics as machine code, a library of their own with their integration: compiled when they are first used.

``forward.c`` uses four functions of the same symbols as inverse dynamics: rows, bias, mass matrix
and efforts at rest of the tree. ``derivatives`` has their linearisation.
"""

from __future__ import annotations

import ctypes
import math
from itertools import accumulate
from typing import Any

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.dynamics.compiled.build import (
    Code,
    carried_table,
    functions_of,
    tables,
    text_of,
    tree_functions,
)
from redundancy_pin.dynamics.compiled.derivatives import motion_partials
from redundancy_pin.dynamics.compiled.design import design_of
from redundancy_pin.dynamics.compiled.integration import DECLARATIONS, CompiledIntegration
from redundancy_pin.dynamics.compiled.parameters import Topology
from redundancy_pin.dynamics.compiled.symbols import SymbolicChain, ca
from redundancy_pin.dynamics.forward import Accelerations, Equations, LinearParts, Rules
from redundancy_pin.errors import UnsupportedRobotError
from redundancy_pin.machine_code import FLAGS
from redundancy_pin.robot import Robot, Wrench
from redundancy_pin.robot.checks import is_pose
from redundancy_pin.robot.loads import of_kind


class CompiledForward(Code):
    """Forward dynamics of one robot; ``dynamics.forward.ForwardKernel``.

    Args:
        robot: the robot.
    """

    # as fast with -O2, and compiled in half the time
    flags = tuple("-O2" if flag == "-O3" else flag for flag in FLAGS)

    def __init__(self, robot: Robot) -> None:
        super().__init__(robot)
        model = robot.model
        self._nv, self._p = model.nv, model.nv - robot.k
        self._rows = self._p - robot.n

    @staticmethod
    def source(topology: Topology) -> str:
        """Return the C of forward dynamics and their integration."""
        return "\n".join([CompiledForward.dynamics_source(topology), DECLARATIONS, text_of("integration.c")])

    @staticmethod
    def dynamics_source(topology: Topology) -> str:
        """Return the C of forward dynamics."""
        robot, chain = topology.robot, SymbolicChain(topology.robot, topology)
        pose, motion = [chain.q, chain.trig], [chain.q, chain.trig, chain.v]
        efforts = chain.efforts[0]
        at_rest = ca.substitute(efforts, chain.a, ca.SX.zeros(chain.model.nv))
        mass = ca.jacobian(efforts, chain.a)
        definitions: dict[str, tuple[list[Any], list[Any]]] = {
            "equations": ([*motion, chain.external], [ca.vec(chain.K), chain.bias, ca.vec(mass), at_rest]),
            "closures": (pose, [chain.closure_rows, ca.vec(chain.K)]),
            "rates": ([chain.q, chain.v], [chain.configuration_rate]),
            **tree_functions(chain),
            "platform": (motion, [chain.coordinates, chain.row_rates[chain.row_rates.numel() - robot.n :]]),
        }
        text = [*tables(chain, functions_of(chain, definitions).values(), "static"), carried_table(robot)]
        return "\n".join([*text, text_of("forward.c")])

    def accelerations(
        self, q: Array, v: Array, force: Array, carrier_acceleration: Array | None = None
    ) -> Accelerations | None:
        """Return accelerations and forces at a closed state; see ``ForwardKernel.accelerations``."""
        a, closure_force, missing = np.empty(self._nv), np.empty(self._rows), np.empty(self._nv)
        given = [None if part is None else _plain(part) for part in (q, v, force, None, carrier_acceleration)]
        status = self.call("rp_accelerations", *given, a, closure_force, missing)
        return None if status else Accelerations(a, closure_force, missing)

    def project(self, y: Array, tolerance: float) -> tuple[Array, float, float] | None:
        """Return the closed state nearest to y (nq + nv,), the residual before and after, m; None if not found."""
        state, residuals = np.array(y, dtype=np.float64), np.zeros(2)
        if not self.call("rp_projected", state, ctypes.c_double(tolerance), residuals):
            return None
        return state, float(residuals[0]), float(residuals[1])

    def equations(self, q: Array, v: Array) -> Equations:
        """Return the equations of the tree and its closures at a state."""
        p, nv = self._p, self._nv
        K, bias, mass, effort = self._read("rp_dynamics", q, v, (p * p, p, nv * nv, nv))
        return Equations(K.reshape(p, p, order="F"), bias, mass.reshape(nv, nv, order="F"), effort)

    def platform(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Return coordinates of the platform and their rates at a state; see ``ForwardKernel.platform``."""
        n, shape = self.robot.n, (4, 4) if is_pose(self.robot) else (self.robot.n,)
        x, xd = self._read("rp_platform_at", q, v, (math.prod(shape), n))
        return x.reshape(shape), xd

    def _read(self, name: str, q: Array, v: Array, sizes: tuple[int, ...]) -> list[Array]:
        """Return results of these sizes at a state; side by side in memory, for an address takes a microsecond."""
        out = np.empty(sum(sizes))
        self.call(name, np.concatenate((q, v)), out)
        ends = accumulate(sizes)
        return [out[end - size : end] for size, end in zip(sizes, ends, strict=True)]

    def linear(self, q: Array, v: Array, a: Array, tau: Array) -> LinearParts:
        """Return exact derivatives at N states in motion under main efforts (N, m)."""
        robot, samples = self.robot, len(q)
        if of_kind(robot.loads, Wrench):
            raise UnsupportedRobotError(
                f"{robot.name} has wrenches on it, whose derivatives are not known here.",
                remedy="Linearise, and design a controller, without them.",
            )
        d, W, _ = motion_partials(robot, design_of(robot, ()), q, v, a, np.zeros((samples, 0)))

        def both(name: str, carrier_name: str) -> Array:
            """Derivatives (N, d, d) of (f − W τ, F) by platform and carriers."""
            rows = [
                np.concatenate([getattr(of, name), getattr(of, carrier_name)], axis=-1)
                for of in (d["f"], d["carrier_force"], d["W"])
            ]
            rows[0] = rows[0] - np.einsum("nimc,nm->nic", rows[2], tau)
            return np.concatenate(rows[:2], axis=1)

        acting = np.zeros((samples, robot.n + robot.k, robot.m + robot.k))
        acting[:, : robot.n, : robot.m], acting[:, robot.n :, robot.m :] = W, np.eye(robot.k)
        return LinearParts(both("xdd", "sdd"), both("x", "s"), both("xd", "sd"), acting)

    def integration(self, rules: Rules) -> CompiledIntegration:
        """Return an integration by these rules."""
        return CompiledIntegration(self, rules)


def _plain(array: Array) -> Array:
    return np.ascontiguousarray(array, dtype=np.float64)
