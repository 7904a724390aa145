"""Shared by the trajectory tests: central differences of eighth order, and points whose stencil meets no knot."""

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

_WEIGHTS = {1: 4.0 / 5.0, 2: -1.0 / 5.0, 3: 4.0 / 105.0, 4: -1.0 / 280.0}
REACH = 4
"""The stencil uses four points on either side."""


def differentiate(function: Callable[[Array], Array], at: Array, step: float) -> Array:
    """Eighth-order central first difference of a vectorised function; exact for polynomials of degree 8."""
    return sum(w * (function(at + k * step) - function(at - k * step)) for k, w in _WEIGHTS.items()) / step


def clear_of(knots: list[float], step: float, count: int = 40) -> Array:
    """Points densely inside each interval between knots, the outermost as close to a knot as the stencil allows."""
    margin = (REACH + 0.01) * step
    return np.concatenate([np.linspace(a + margin, b - margin, count) for a, b in pairwise(knots)])
