"""Machines with other parameters than they are declared with, and what is measured of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import zoo

import redundancy_pin as rp
from redundancy_pin.arrays import Array
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.identification import Records, parameters_of
from redundancy_pin.robot import Robot


def declared(name: str) -> Robot:
    """Return a shipped robot whose motors and carriers are declared to have friction of unknown size."""
    robot = zoo.robot_of(name)
    driven = (*robot.actuated, *robot.carriers)
    return robot.loaded(*(rp.JointForces(joint, friction_speed=0.02) for joint in driven))


def built(robot: Robot, seed: int = 0) -> Robot:
    """Return the machine that was built: masses, centres and inertias up to 30 % off, friction in the motors."""
    rng, model = np.random.default_rng(seed), robot.model.copy()
    for index in range(1, model.njoints):
        inertia = model.inertias[index]
        if inertia.mass:
            factors = rng.uniform(0.7, 1.3, 3)
            model.inertias[index] = pin.Inertia(
                inertia.mass * factors[0], factors[1] * inertia.lever, factors[2] * inertia.inertia
            )
    loads = [
        replace(load, damping=rng.uniform(0.5, 1.0), friction=rng.uniform(0.5, 1.0))
        if isinstance(load, rp.JointForces)
        else load
        for load in robot.loads
    ]
    return replace(robot, model=model, loads=tuple(loads), closed_form=None)


def measured(
    dynamics: Dynamics, seconds: float = 6.0, rate: float = 250.0, seed: int = 0, speed: float = 8.0
) -> Records:
    """Return exact records of a smooth motion, efforts by a backend; carriers move too, their forces are measured."""
    robot, t = dynamics.robot, np.arange(0.0, seconds, 1.0 / rate)
    motion, carriers = zoo.smooth_motion(robot, seed=seed, speed=speed).at(t), zoo.carriers_at(robot, t, seed)
    reduced = dynamics.reduce(motion, carriers)
    tau = np.linalg.solve(reduced.W, reduced.f[..., None])[..., 0]
    position = robot.joint_positions(rp.inverse_kinematics(robot, motion).q)
    carried = {"carriers": carriers.s, "carrier_force": reduced.carrier_force} if robot.k else {}
    return Records(t, tau, position, **carried)


def noisy(records: Records, seed: int, effort: float = 0.05, counts: float = 2.0**17) -> Records:
    """Return records with white noise of the efforts, relative to their size, and encoders whose zeros are random."""
    rng, step = np.random.default_rng(seed), 2.0 * np.pi / counts

    def rough(values: Array) -> Array:
        return values + effort * values.std(axis=0) * rng.standard_normal(values.shape)

    def counted(values: Array) -> Array:
        zero = rng.uniform(0.0, step, values.shape[1])  # of the encoder's first count
        return step * np.round((values - zero) / step) + zero

    carried = (
        {"carriers": counted(records.carriers), "carrier_force": rough(records.carrier_force)}
        if records.carriers.shape[1]
        else {}
    )
    return Records(records.t, rough(records.effort), counted(records.position), **carried)


def true_values(fit: rp.identification.Fit, robot: Robot) -> Array:
    """Return (b,) the base parameters of a fit in another robot."""
    values = {p.name: p.value for p in parameters_of(robot, ["*"])}
    return np.array(fit.base.combination @ np.array([values[p.name] for p in fit.base.parameters]))
