"""Closed-chain (parallel-robot) dynamics and planning on Pinocchio."""

from redundancy_pin import _startup

_startup.install()  # before the imports that take long

# ruff: noqa: E402
from redundancy_pin import _moved, simulation, trajectory
from redundancy_pin.dynamics.compiled import CompiledDynamics
from redundancy_pin.dynamics.distribution import distribute
from redundancy_pin.dynamics.rnea import RneaDynamics, joint_reactions
from redundancy_pin.dynamics.virtual_work import VirtualWork
from redundancy_pin.kinematics.lift import lift
from redundancy_pin.loading import load_robot
from redundancy_pin.motion import CarrierMotion, PlatformMotion
from redundancy_pin.planners.check import check_plan
from redundancy_pin.planners.plan import Plan, load_plan, load_robot_of
from redundancy_pin.planners.stepwise.planner import plan_stepwise
from redundancy_pin.planners.switch_off.planner import plan_switch_off
from redundancy_pin.planners.whole_trajectory.planner import plan_whole_trajectory
from redundancy_pin.simulation import simulate
from redundancy_pin.singularities.classify import classify, classify_motion
from redundancy_pin.singularities.crossings import find_crossings
from redundancy_pin.singularities.locus import singular_locus
from redundancy_pin.view import show
from redundancy_pin.visualisation.figures import plots as plot

__all__ = [
    "CarrierMotion",
    "CompiledDynamics",
    "Plan",
    "PlatformMotion",
    "RneaDynamics",
    "VirtualWork",
    "check_plan",
    "classify",
    "classify_motion",
    "distribute",
    "find_crossings",
    "joint_reactions",
    "lift",
    "load_plan",
    "load_robot",
    "load_robot_of",
    "plan_stepwise",
    "plan_switch_off",
    "plan_whole_trajectory",
    "plot",
    "show",
    "simulate",
    "simulation",
    "singular_locus",
    "trajectory",
]
__version__ = "0.1.0"

_moved.install()
