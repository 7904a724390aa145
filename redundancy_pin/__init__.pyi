"""Public names of the package, by where they are defined: for type checkers, and for ``__init__.py``."""

# ruff: noqa: F401 - names for users

from typing import Any

from redundancy_pin import simulation as simulation
from redundancy_pin import trajectory as trajectory
from redundancy_pin.codegen import write_c as write_c
from redundancy_pin.dynamics.compiled import CompiledDynamics as CompiledDynamics
from redundancy_pin.dynamics.compiled.gpu import GpuDynamics as GpuDynamics
from redundancy_pin.dynamics.compiled.symbolic import symbolic as symbolic
from redundancy_pin.dynamics.distribution import distribute as distribute
from redundancy_pin.dynamics.inverse_dynamics import inverse_dynamics as inverse_dynamics
from redundancy_pin.dynamics.reactions import joint_reactions as joint_reactions
from redundancy_pin.dynamics.rnea import RneaDynamics as RneaDynamics
from redundancy_pin.dynamics.virtual_work import VirtualWork as VirtualWork
from redundancy_pin.identification.exciting import exciting_motion as exciting_motion
from redundancy_pin.identification.fit import identify as identify
from redundancy_pin.kinematics.assembly_modes import assembly_modes as assembly_modes
from redundancy_pin.kinematics.forward_kinematics import forward_kinematics as forward_kinematics
from redundancy_pin.kinematics.inverse_kinematics import inverse_kinematics as inverse_kinematics
from redundancy_pin.loading import (
    load_robot as load_robot,
)
from redundancy_pin.loading import (
    robot_from_model as robot_from_model,
)
from redundancy_pin.loading import (
    with_limits as with_limits,
)
from redundancy_pin.loading import (
    with_parameters as with_parameters,
)
from redundancy_pin.motion import CarrierMotion as CarrierMotion
from redundancy_pin.motion import PlatformMotion as PlatformMotion
from redundancy_pin.parallel import sweep as sweep
from redundancy_pin.planners.check import check_plan as check_plan
from redundancy_pin.planners.optimal.co_design import co_design as co_design
from redundancy_pin.planners.optimal.time_optimal import plan_time_optimal as plan_time_optimal
from redundancy_pin.planners.optimal.whole_trajectory import plan_whole_trajectory as plan_whole_trajectory
from redundancy_pin.planners.options import Limits as Limits
from redundancy_pin.planners.options import Mesh as Mesh
from redundancy_pin.planners.options import Objective as Objective
from redundancy_pin.planners.options import Solver as Solver
from redundancy_pin.planners.plan import Plan as Plan
from redundancy_pin.planners.plan import load_plan as load_plan
from redundancy_pin.planners.plan import load_robot_of as load_robot_of
from redundancy_pin.planners.receding_horizon import RecedingHorizon as RecedingHorizon
from redundancy_pin.planners.stepwise.planner import plan_stepwise as plan_stepwise
from redundancy_pin.planners.switch_off.planner import plan_switch_off as plan_switch_off
from redundancy_pin.robot import Robot as Robot
from redundancy_pin.robot.loads import (
    JointForces as JointForces,
)
from redundancy_pin.robot.loads import (
    Payload as Payload,
)
from redundancy_pin.robot.loads import (
    Spring as Spring,
)
from redundancy_pin.robot.loads import (
    Wrench as Wrench,
)
from redundancy_pin.simulation import simulate as simulate
from redundancy_pin.singularities.classify import classify as classify
from redundancy_pin.singularities.classify import classify_motion as classify_motion
from redundancy_pin.singularities.crossings import find_crossings as find_crossings
from redundancy_pin.singularities.locus import singular_locus as singular_locus
from redundancy_pin.singularities.performance import (
    performance as performance,
)
from redundancy_pin.singularities.performance import (
    platform_play as platform_play,
)
from redundancy_pin.singularities.performance import (
    platform_stiffness as platform_stiffness,
)
from redundancy_pin.singularities.workspace import workspace as workspace
from redundancy_pin.view import show as show
from redundancy_pin.visualisation.figures import plots as plot
from redundancy_pin.writers import write_mjcf as write_mjcf

__all__: list[str]
__version__: str

def __getattr__(name: str) -> Any: ...
