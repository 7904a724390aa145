"""Results as plain data, for JSON."""

from __future__ import annotations

import math
from collections.abc import Mapping
from enum import Enum
from typing import Any

import numpy as np


def json_data(value: Any) -> Any:
    """Return data for JSON: enumerations by value, arrays and tuples as lists, None for NaN and infinity.

    Example:
        >>> json_data({"t": np.array([0.0, np.nan])})
        {'t': [0.0, None]}
    """
    if isinstance(value, Mapping):
        return {str(key): json_data(entry) for key, entry in value.items()}
    if isinstance(value, (tuple, list, np.ndarray)):
        return [json_data(entry) for entry in value]
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, np.generic):
        return json_data(value.item())
    return None if isinstance(value, float) and not math.isfinite(value) else value
