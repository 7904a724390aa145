"""Closed-chain (parallel-robot) dynamics and planning on Pinocchio.

Names are imported when they are first used: a program pays for the rooms it enters, and for no others.
"""

# ruff: noqa: E402 - Ctrl-C is quiet before anything is imported that takes its time
from redundancy_pin import _startup

_startup.install()

import importlib
import importlib.util
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from redundancy_pin import simulation, trajectory
    from redundancy_pin.codegen import write_c
    from redundancy_pin.dynamics.compiled import CompiledDynamics
    from redundancy_pin.dynamics.compiled.symbolic import symbolic
    from redundancy_pin.dynamics.distribution import distribute
    from redundancy_pin.dynamics.inverse_dynamics import inverse_dynamics
    from redundancy_pin.dynamics.reactions import joint_reactions
    from redundancy_pin.dynamics.rnea import RneaDynamics
    from redundancy_pin.dynamics.virtual_work import VirtualWork
    from redundancy_pin.identification.exciting import exciting_motion
    from redundancy_pin.identification.fit import identify
    from redundancy_pin.kinematics.assembly_modes import assembly_modes
    from redundancy_pin.kinematics.forward_kinematics import forward_kinematics
    from redundancy_pin.kinematics.inverse_kinematics import inverse_kinematics
    from redundancy_pin.loading import load_robot, robot_from_model, with_limits, with_parameters
    from redundancy_pin.motion import CarrierMotion, PlatformMotion
    from redundancy_pin.parallel import sweep
    from redundancy_pin.planners.check import check_plan
    from redundancy_pin.planners.optimal.co_design import co_design
    from redundancy_pin.planners.optimal.time_optimal import plan_time_optimal
    from redundancy_pin.planners.optimal.whole_trajectory import plan_whole_trajectory
    from redundancy_pin.planners.options import Limits, Mesh, Objective, Solver
    from redundancy_pin.planners.plan import Plan, load_plan, load_robot_of
    from redundancy_pin.planners.receding_horizon import RecedingHorizon
    from redundancy_pin.planners.stepwise.planner import plan_stepwise
    from redundancy_pin.planners.switch_off.planner import plan_switch_off
    from redundancy_pin.robot import Robot
    from redundancy_pin.robot.loads import JointForces, Payload, Spring, Wrench
    from redundancy_pin.simulation import simulate
    from redundancy_pin.singularities.classify import classify, classify_motion
    from redundancy_pin.singularities.crossings import find_crossings
    from redundancy_pin.singularities.locus import singular_locus
    from redundancy_pin.singularities.performance import performance, platform_play, platform_stiffness
    from redundancy_pin.singularities.workspace import workspace
    from redundancy_pin.view import show
    from redundancy_pin.visualisation.figures import plots as plot
    from redundancy_pin.writers import write_mjcf

_PLACES = {
    name: place
    for place, names in {
        "codegen": "write_c",
        "dynamics.compiled": "CompiledDynamics",
        "dynamics.compiled.symbolic": "symbolic",
        "dynamics.distribution": "distribute",
        "dynamics.inverse_dynamics": "inverse_dynamics",
        "dynamics.reactions": "joint_reactions",
        "dynamics.rnea": "RneaDynamics",
        "dynamics.virtual_work": "VirtualWork",
        "identification.exciting": "exciting_motion",
        "identification.fit": "identify",
        "kinematics.assembly_modes": "assembly_modes",
        "kinematics.forward_kinematics": "forward_kinematics",
        "kinematics.inverse_kinematics": "inverse_kinematics",
        "loading": "load_robot robot_from_model with_limits with_parameters",
        "motion": "CarrierMotion PlatformMotion",
        "parallel": "sweep",
        "planners.check": "check_plan",
        "planners.options": "Limits Mesh Objective Solver",
        "planners.plan": "Plan load_plan load_robot_of",
        "planners.receding_horizon": "RecedingHorizon",
        "planners.stepwise.planner": "plan_stepwise",
        "planners.switch_off.planner": "plan_switch_off",
        "planners.optimal.co_design": "co_design",
        "planners.optimal.time_optimal": "plan_time_optimal",
        "planners.optimal.whole_trajectory": "plan_whole_trajectory",
        "robot": "Robot",
        "robot.loads": "JointForces Payload Spring Wrench",
        "simulation": "simulate",
        "singularities.classify": "classify classify_motion",
        "singularities.crossings": "find_crossings",
        "singularities.locus": "singular_locus",
        "singularities.performance": "performance platform_play platform_stiffness",
        "singularities.workspace": "workspace",
        "view": "show",
        "writers": "write_mjcf",
    }.items()
    for name in names.split()
}
"""Names of ``__all__`` that are no modules, by where they are defined; the imports above say it to type checkers."""

_SHORT_NAMES = {"plot": "visualisation.figures.plots"}
"""Modules under a name of their own."""

__all__ = [
    "CarrierMotion",
    "CompiledDynamics",
    "JointForces",
    "Limits",
    "Mesh",
    "Objective",
    "Payload",
    "Plan",
    "PlatformMotion",
    "RecedingHorizon",
    "RneaDynamics",
    "Robot",
    "Solver",
    "Spring",
    "VirtualWork",
    "Wrench",
    "assembly_modes",
    "check_plan",
    "classify",
    "classify_motion",
    "co_design",
    "distribute",
    "exciting_motion",
    "find_crossings",
    "forward_kinematics",
    "identify",
    "inverse_dynamics",
    "inverse_kinematics",
    "joint_reactions",
    "load_plan",
    "load_robot",
    "load_robot_of",
    "performance",
    "plan_stepwise",
    "plan_switch_off",
    "plan_time_optimal",
    "plan_whole_trajectory",
    "platform_play",
    "platform_stiffness",
    "plot",
    "robot_from_model",
    "show",
    "simulate",
    "simulation",
    "singular_locus",
    "sweep",
    "symbolic",
    "trajectory",
    "with_limits",
    "with_parameters",
    "workspace",
    "write_c",
    "write_mjcf",
]
__version__ = "0.1.0"


def __getattr__(name: str) -> Any:
    """Import a public name, or a room such as ``rp.errors``, when it is first used (PEP 562)."""
    if name in _PLACES:
        value = getattr(importlib.import_module(f"{__name__}.{_PLACES[name]}"), name)
    else:
        module = f"{__name__}.{_SHORT_NAMES.get(name, name)}"
        if name.startswith("_") or importlib.util.find_spec(module) is None:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        value = importlib.import_module(module)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
