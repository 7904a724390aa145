"""Where version 0.1.0 documented ``Sampling`` and its neighbours; they are in ``simulation.controllers.base``."""

import warnings

from redundancy_pin.simulation.controllers.base import CarrierDrive, CarrierLaw, Constant, Controller, Sampling

__all__ = ["CarrierDrive", "CarrierLaw", "Constant", "Controller", "Sampling"]

warnings.warn(
    "redundancy_pin.simulation.control is now redundancy_pin.simulation.controllers.base.",
    DeprecationWarning,
    stacklevel=2,
)
