"""Optional engines, imported when a run asks for them."""

from __future__ import annotations

import importlib
from typing import Any

from redundancy_pin.errors import RedundancyPinError


def require(module: str) -> Any:
    """Return an optional engine.

    Raises:
        RedundancyPinError: it is not installed.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise RedundancyPinError(
            f"This needs the engine {module}, which is not installed.",
            remedy="Install it with `pip install 'redundancy_pin[engines]'`.",
            engine=module,
        ) from error
