"""The machines that tests of the dynamics share, by name: with mass in every link and gravity in two directions."""

from __future__ import annotations

import functools

import spatial_chains
import zoo
from generated_c import ACTUATED, Code

from redundancy_pin.robot import Robot

MASSIVE: dict[str, dict[str, object]] = {
    "2rpr": {"end_effector_mass": 0.4, "cylinder_mass": 0.5, "piston_mass": 0.3, "gravity": (1.0, -9.81, 0.0)},
    "3rrr": {"gravity": (1.0, -9.81, 0.0)},
    "five_bar": {"gravity": (1.0, -9.81, 0.0)},
    "four_bar": {},
    "gough": {"payload_mass": 2.0},
}
"""Arguments under which every link has mass and gravity acts: nothing can hide."""


@functools.cache
def machine(name: str) -> Robot:
    """Return a shipped robot with mass in every link, one with other actuators, or a small spatial chain."""
    if name in ACTUATED:
        driven, *joints = ACTUATED[name]
        return zoo.driven_by(zoo.robot_of(driven), *joints)
    if name in spatial_chains.CHAINS:
        return spatial_chains.chain_of(name)
    return zoo.robot_of(name, **MASSIVE.get(name, {}))


@functools.cache
def code_of(name: str) -> Code:
    """Return the generated C of a machine, compiled once a session."""
    return Code(machine(name))
