"""The regressor of a closed chain: generalised forces are linear in its parameters.

With Γ the velocities of the tree per rate of the platform, C the carriers, and Y the regressor of the open tree
(``pin.computeJointTorqueRegressor`` for bodies, one column for each term of a joint),

    W τ = f = Γᵀ Y(q, v, a) π,    carrier force = Cᵀ Y(q, v, a) π.

Constraint forces do no work in Γ and drop out; nothing is divided by W, so that rows are finite at type II
singularities too.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import Array, read_only
from redundancy_pin.dynamics.rnea import RneaAlongMotion
from redundancy_pin.dynamics.tree_loads import TreeState, tree_effort
from redundancy_pin.identification.parameters import (
    INERTIAL,
    Parameter,
    index_of,
    massless,
    parameters_of,
    unit_forces,
)
from redundancy_pin.kinematics.branch import follower
from redundancy_pin.kinematics.closing import closed_neighbours
from redundancy_pin.kinematics.closure import constraint_system
from redundancy_pin.motion import CarrierMotion
from redundancy_pin.robot import Robot

_SEED = 0
_STATES, _SPREADS = 12, np.linspace(0.05, 0.6, 13)
"""Random closed states that say which parameters a machine can show: how many at each distance from the reference, of
the joint that moves farthest, rad or characteristic lengths. Of a machine with one freedom a distance has two."""


class TreeRegressor:
    """The regressor Y of the open tree: effort = Y π.

    Args:
        robot: the robot.
        parameters: p of its parameters, see ``parameters_of``.
    """

    def __init__(self, robot: Robot, parameters: Sequence[Parameter]) -> None:
        self.robot, self.parameters = robot, tuple(parameters)
        self._data = robot.model.createData()
        self._bodies = [
            (k, 10 * (p.joint - 1) + INERTIAL.index(p.kind))
            for k, p in enumerate(self.parameters)
            if p.kind in INERTIAL
        ]
        bare = massless(robot)
        self._joints = [
            (k, p, bare.loaded(unit_forces(robot, p)) if p.kind == "rotor inertia" else None)
            for k, p in enumerate(self.parameters)
            if p.kind not in INERTIAL
        ]

    def at(self, state: TreeState) -> Array:
        """Return Y (nv, p) at a state of the tree, N or N·m per unit of each parameter."""
        model = self.robot.model
        Y = np.zeros((model.nv, len(self.parameters)))
        if self._bodies:
            columns, sources = np.array(self._bodies).T
            full = pin.computeJointTorqueRegressor(model, self._data, state.q, state.v, state.a)
            Y[:, columns] = full[:, sources]
        for k, parameter, rotor in self._joints:
            if rotor is not None:
                Y[:, k] = tree_effort(rotor, self._data, state)
                continue
            row = index_of(self.robot, parameter.of)
            joint = model.joints[parameter.joint]
            if parameter.kind == "preload":
                Y[row, k] = 1.0
            elif parameter.kind == "stiffness":
                Y[row, k] = state.q[joint.idx_q]
            else:
                Y[row, k] = unit_forces(self.robot, parameter).resistance(np.zeros(()), state.v[row])
        return Y


def projected(robot: Robot, gamma: Array, Y: Array) -> Array:
    """Return (n + k, p) the rows Γᵀ Y, and Cᵀ Y of the carriers."""
    return np.concatenate([gamma.T @ Y, Y[robot.carrier_velocity]])


def chain_regressor(
    along: RneaAlongMotion, parameters: Sequence[Parameter] | None = None, carriers: CarrierMotion | None = None
) -> Array:
    """Return (N, n + k, p) the regressor of a closed chain along a motion: of f (n), then of carrier forces (k).

    Args:
        along: a platform motion whose kinematics are solved, ``RneaDynamics(robot).along(motion)``.
        parameters: p parameters; those of ``parameters_of(robot)`` when left out.
        carriers: N samples of the carriers; parked at zero when left out.

    Example:
        >>> along = rp.RneaDynamics("five_bar").along(motion)
        >>> chain_regressor(along).shape
    """
    chosen = parameters_of(along.robot) if parameters is None else parameters
    tree = TreeRegressor(along.robot, chosen)
    rows = [
        projected(along.robot, gamma, tree.at(state))
        for gamma, state in zip(along.gamma, along.states(carriers), strict=True)
    ]
    return read_only(np.array(rows))


def random_regressor(robot: Robot, parameters: Sequence[Parameter]) -> Array:
    """Return (M, n + k, p) the regressor at random closed states around the reference, regular ones.

    Rates are such that the platform moves by its own size in a second, friction speeds are left behind.
    """
    own, tree, rng = follower(robot), TreeRegressor(robot, parameters), np.random.default_rng(_SEED)
    rows, unit = [], own.unit
    system, reference = constraint_system(robot), np.array(robot.q_reference)
    for q in np.concatenate([closed_neighbours(system, reference, _STATES, spread) for spread in _SPREADS]):
        state = own.state_at(q)
        if state is None or state.margin < own.near:
            continue
        _, v, a = own.rates(state, *(3.0 * unit * rng.standard_normal((2, robot.n))))
        q = np.array(state.q)
        q[robot.carrier_position], v[robot.carrier_velocity], a[robot.carrier_velocity] = rng.standard_normal(
            (3, robot.k)
        )
        rows.append(projected(robot, state.gamma, tree.at(TreeState(q, v, a))))
    return np.array(rows)
