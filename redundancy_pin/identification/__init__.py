"""Identification of closed chains: masses, inertias and friction from measured motions."""

from redundancy_pin.identification.base import BaseParameters, base_parameters
from redundancy_pin.identification.exciting import ExcitingMotion, exciting_motion
from redundancy_pin.identification.fit import Fit, identify
from redundancy_pin.identification.parameters import Parameter, parameters_of
from redundancy_pin.identification.records import Records
from redundancy_pin.identification.regressor import chain_regressor
from redundancy_pin.identification.robot_file import write_robot

__all__ = [
    "BaseParameters",
    "ExcitingMotion",
    "Fit",
    "Parameter",
    "Records",
    "base_parameters",
    "chain_regressor",
    "exciting_motion",
    "identify",
    "parameters_of",
    "write_robot",
]
