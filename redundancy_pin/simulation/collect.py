"""From the states of a run to a ``Simulation``: forces, energies and platform coordinates at its samples."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import Array, frozen, read_only
from redundancy_pin.errors import IllPosedModelError, InputError, SingularPoseError
from redundancy_pin.kinematics.closure import ConstraintSystem
from redundancy_pin.kinematics.coordinates import coordinates
from redundancy_pin.planners.robot_record import robot_record
from redundancy_pin.robot import Robot
from redundancy_pin.simulation.machine import Machine
from redundancy_pin.simulation.result import Simulation, SimulationStatus
from redundancy_pin.simulation.run import Outcome


def collect(machine: Machine, outcome: Outcome, parameters: dict[str, object]) -> Simulation:
    """Evaluate forces, accelerations and energies at the samples and put everything together.

    Args:
        machine: what was integrated.
        outcome: what the run left.
        parameters: how it was run, in plain data.

    Raises:
        InputError: the controller returns something else than finite efforts at a sample.
    """
    robot, record = machine.robot, outcome.record
    model, data = robot.model, machine.chain.data
    count = len(record.t)
    q, v = (np.array(part) for part in zip(*((y[: model.nq], y[model.nq :]) for y in record.y), strict=True))
    a, energy = np.full((count, model.nv), np.nan), np.empty(count)
    tau, carrier_force = np.full((count, robot.m), np.nan), np.full((count, robot.k), np.nan)
    closure_force = np.full((count, machine.chain.rows), np.nan)
    for i, (t, y, held) in enumerate(zip(record.t, record.y, record.held, strict=True)):
        machine.held = held
        energy[i] = pin.computeKineticEnergy(model, data, q[i], v[i]) + pin.computePotentialEnergy(model, data, q[i])
        try:
            (tau[i], _), loads = machine.loads(machine.state(t, y))
        except (IllPosedModelError, SingularPoseError):
            continue  # a failed simulation ends there: the efforts have no accelerations
        except InputError:
            if outcome.status is not SimulationStatus.FAILED:
                raise
            continue  # what blows up may leave a controller without an answer
        a[i], closure_force[i], carrier_force[i] = loads.a, loads.closure_force, loads.carrier_force
    system = ConstraintSystem(robot)
    evaluated = system.evaluate(q)
    columns = robot.carrier_velocity
    xd = np.einsum("nij,nj->ni", evaluated.Jx, v)
    return Simulation(
        t=frozen(record.t),
        q=read_only(q),
        v=read_only(v),
        a=read_only(a),
        x=read_only(_running_on(robot, frozen(record.t), coordinates(robot, evaluated), xd)),
        xd=read_only(xd),
        s=frozen(q[:, robot.carrier_position]),
        sd=frozen(v[:, columns]),
        sdd=frozen(a[:, columns]),
        tau=read_only(tau),
        carrier_force=read_only(carrier_force),
        actuated_rate=frozen(v[:, robot.actuated_velocity]),
        closure_force=read_only(closure_force),
        gap=frozen(np.abs(evaluated.phi).max(axis=1, initial=0.0)),
        energy=read_only(energy),
        events=outcome.events,
        status=outcome.status,
        reason=outcome.reason,
        statistics=outcome.statistics,
        robot=robot_record(robot),
        parameters=parameters,
    )


def _running_on(robot: Robot, t: Array, x: Array, xd: Array) -> Array:
    """Let angles of the platform and of continuous joints run on past π.

    Turns are counted by how far the rates carry the angles from sample to sample: those may be many turns apart.
    """
    if x.ndim == 3:
        return x
    if robot.platform is not None:
        turning = [axis.startswith("r") for axis in robot.platform.axes]
    else:
        model = robot.model
        turning = [model.joints[model.getJointId(name)].nq == 2 for name in robot.independent_joints]
    x = x.copy()
    carried = np.zeros_like(x)
    carried[1:] = np.cumsum(0.5 * (xd[1:] + xd[:-1]) * np.diff(t)[:, None], axis=0)
    turns = np.round((carried + np.unwrap(x - carried, axis=0) - x) / (2.0 * np.pi))
    x[:, turning] += 2.0 * np.pi * turns[:, turning]
    return x
