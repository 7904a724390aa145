"""The closed-loop cases: the 2-RPR with masses through two type II poses, the 3-RRR around a corner."""

from __future__ import annotations

from functools import cache

import redundancy_pin as rp
from redundancy_pin.planners.reference import MotionReference, plan_reference
from redundancy_pin.robot import Robot
from redundancy_pin.simulation.state import State, closed_state
from redundancy_pin.trajectory import reference as trajectories


def two_rpr(**changed: float) -> Robot:
    return rp.load_robot("2rpr", end_effector_mass=0.5, cylinder_mass=0.3, **changed)


@cache
def crossing() -> MotionReference:
    """A whole-trajectory plan of the circle at 0.5 m/s, on tracks 4 cm shorter than those of ``two_rpr()``."""
    robot = two_rpr(track_half_length=0.16)
    circle = trajectories.circle(speed=0.5)
    plan = rp.plan_whole_trajectory(rp.RneaDynamics(robot), circle, mesh=rp.Mesh(dt=0.02))
    return plan_reference(plan, robot=robot, motion=circle)


@cache
def corner() -> MotionReference:
    """A whole-trajectory plan of the corner of radius 0.025 m."""
    robot = rp.load_robot("3rrr")
    path = trajectories.corner(radius=0.025)
    plan = rp.plan_whole_trajectory(rp.RneaDynamics(robot), path, mesh=rp.Mesh(dt=0.01))
    return plan_reference(plan, robot=robot, motion=path)


def perturbed(robot: Robot, motion: MotionReference, t: float, away: list[float], speed: list[float]) -> State:
    """The planned state at t with the platform displaced by ``away`` and its velocity by ``speed``."""
    point = motion.at(t)
    return closed_state(robot, point.x + away, point.xd + speed, point.s, point.sd, t=t)
