"""Identification of closed chains: masses, inertias and friction from measured motions."""

from redundancy_pin.identification.base import BaseParameters, base_parameters
from redundancy_pin.identification.fit import Fit, identify
from redundancy_pin.identification.parameters import Parameter, parameters_of
from redundancy_pin.identification.records import Records
from redundancy_pin.identification.regressor import chain_regressor

__all__ = [
    "BaseParameters",
    "Fit",
    "Parameter",
    "Records",
    "base_parameters",
    "chain_regressor",
    "identify",
    "parameters_of",
]
