"""Forward dynamics of closed chains: accelerations, simulation, feed-forward of plans, linearisation."""

from redundancy_pin.planners.reference import MotionReference, ReferencePoint, motion_reference, plan_reference
from redundancy_pin.simulation.controllers.base import CarrierLaw, Constant, Controller, FeedForward, Sampling
from redundancy_pin.simulation.derivatives import (
    DynamicsDerivatives,
    Linearisation,
    inverse_derivatives,
    linearise,
    state_error,
)
from redundancy_pin.simulation.events import KINDS, Event
from redundancy_pin.simulation.forward import ForwardDynamics
from redundancy_pin.simulation.result import Simulation, Statistics, load_simulation
from redundancy_pin.simulation.simulate import simulate
from redundancy_pin.simulation.state import State, closed_state, tree_state

__all__ = [
    "KINDS",
    "CarrierLaw",
    "Constant",
    "Controller",
    "DynamicsDerivatives",
    "Event",
    "FeedForward",
    "ForwardDynamics",
    "Linearisation",
    "MotionReference",
    "ReferencePoint",
    "Sampling",
    "Simulation",
    "State",
    "Statistics",
    "closed_state",
    "inverse_derivatives",
    "linearise",
    "load_simulation",
    "motion_reference",
    "plan_reference",
    "simulate",
    "state_error",
    "tree_state",
]
