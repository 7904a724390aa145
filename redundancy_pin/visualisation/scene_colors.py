"""Colours of the moving picture: one for each role, and classes of the margin to a singularity."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise

import numpy as np

from redundancy_pin.arrays import NEAR_SINGULAR_MARGIN, Array, IntArray
from redundancy_pin.visualisation.scene import Group, Role

ROLE_COLORS: Mapping[Role, str] = {
    "base": "#5A5A5A",
    "link": "#4A7FB5",
    "track": "#F0C808",
    "carrier": "#D95F0E",
    "actuated": "#202020",
    "passive": "#C8C8C8",
    "closure": "#9B59B6",
    "platform": "#348C4D",
}
"""Colour of each role, where the URDF does not give a link its own."""

ROLE_NAMES: Mapping[Role, str] = {
    "link": "link",
    "actuated": "driven joint",
    "passive": "passive joint",
    "closure": "closure",
    "track": "track",
    "carrier": "carrier",
}
"""What legends call them, in their order."""

EFFORT_COLORS: Mapping[Group, str] = {"main": "#E4007C", "carrier": "#00A3A3"}
"""Colours of the arrows: the main actuators', the carriers'."""

MARGIN_EDGES = (NEAR_SINGULAR_MARGIN, 0.1, 0.2, 0.4)
"""Where the classes of the margin part: below the first a pose is reported as near-singular."""

MARGIN_COLORS = ("#B2182B", "#EF6C00", "#F6B600", "#5BAA3A", "#2166AC")
"""Colour of each class of the margin, from singular to far."""

UNKNOWN_COLOR = "#9E9E9E"
"""Where there is no margin."""


def margin_classes(margin: Array) -> IntArray:
    """Return (N,) the class of each margin: an index into ``MARGIN_COLORS``, −1 where it is not known."""
    found: IntArray = np.searchsorted(MARGIN_EDGES, np.abs(margin), side="right").astype(np.intp)
    return np.where(np.isnan(margin), -1, found)


def margin_labels() -> tuple[str, ...]:
    """Return what the legend says of each class."""
    edges = [f"{edge:g}" for edge in MARGIN_EDGES]
    inner = [f"{low} to {high}" for low, high in pairwise(edges)]
    return (f"below {edges[0]}: near-singular", *inner, f"above {edges[-1]}")


def rgb(color: str) -> tuple[float, float, float]:
    """Return a colour ``#rrggbb`` as three numbers from 0 to 1."""
    red, green, blue = (int(color[i : i + 2], 16) / 255.0 for i in (1, 3, 5))
    return red, green, blue


def code(color: str) -> int:
    """Return a colour ``#rrggbb`` as one number, as viewers want it."""
    return int(color[1:], 16)
