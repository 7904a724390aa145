"""Where version 0.1.0 documented ``Sampling`` and its neighbours; they are in ``simulation.controllers.base``."""

import warnings

from redundancy_pin.simulation.controllers import base


def __getattr__(name: str) -> object:
    value: object = getattr(base, name)
    if not name.startswith("__"):
        text = f"redundancy_pin.simulation.control.{name} is now in redundancy_pin.simulation.controllers.base."
        warnings.warn(text, DeprecationWarning, stacklevel=2)
    return value
