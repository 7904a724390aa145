"""What no body can have: negative masses, and moments of inertia that no distribution of mass makes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from redundancy_pin.arrays import Array

ROUNDED_MOMENTS = 1e-6
"""Fraction of the largest moment of inertia by which a file with six digits misses a limit."""

NO_MASS = 1e-6
"""Fraction of the mass of a mechanism below which a link weighs nothing: exporters give frames 1e-9 kg."""

NO_MOMENT = 1e-12
"""kg·m². Less is zero: exporters leave products of 1e-35 beside moments of nothing, as for iCub's head."""


def negative_inertia(mass: float, inertia: Array) -> str:
    """Name the negative or infinite quantities of a body, for messages; empty for a body that may exist.

    Args:
        mass: kg.
        inertia: (3, 3) about the centre of mass, kg·m².

    Example:
        >>> negative_inertia(-1.0, np.eye(3))
        'a negative mass, -1 kg'
    """
    if not np.isfinite([mass, *inertia.flat]).all():
        return f"the mass {mass:g} kg and the inertia {inertia.tolist()} kg·m², not finite"
    if mass < 0.0:
        return f"a negative mass, {mass:g} kg"
    moments = np.linalg.eigvalsh(inertia)
    if moments[0] >= -_rounding(moments):
        return ""
    text = np.array2string(moments, precision=4)
    return f"principal moments of inertia {text} that no body can have: a negative one"


def impossible_inertia(inertia: Array) -> str:
    """Return the principal moments of an inertia (3, 3), kg·m², for messages; empty where a body can have them.

    No body has a largest principal moment beyond the sum of the other two.
    """
    moments = np.linalg.eigvalsh(inertia)
    exceeds = moments[2] > moments[0] + moments[1] + _rounding(moments)
    return np.array2string(moments, precision=4) if exceeds else ""


def _rounding(moments: NDArray[np.floating[Any]]) -> float:
    return ROUNDED_MOMENTS * float(np.abs(moments).max()) + NO_MOMENT
