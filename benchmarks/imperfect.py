"""Machines that are not quite as planned: the bounds and the draws of docs/validation.md, for benchmarks and tests."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.robot import Robot

MASSES = {"end_effector_mass": 0.5, "cylinder_mass": 0.3}
"""The 2-RPR of the thesis is massless but for its carriers: forces would not determine its motion. kg."""

DRAWN_MASSES = (*MASSES, "carrier_mass")
DRAWN_LENGTHS = ("base_distance", "track_offset", "cylinder_length")


@dataclass(frozen=True)
class Imperfections:
    """How wrong things may be; each is drawn uniformly within its bounds, one draw a machine.

    Attributes:
        mass: relative error of each mass, ±.
        length: error of each length of the geometry, m, ±.
        start_position: where platform and carriers start beside their plan, m, ± along each coordinate.
        start_speed: by how much faster or slower, m/s, ±.
        prismatic_coulomb: Coulomb friction of prismatic joints, N; a draw has 0.5 to 1.5 times it, each joint its own.
        prismatic_viscous: N·s/m.
        revolute_coulomb: N·m.
        revolute_viscous: N·m·s.
        prismatic_smoothing, revolute_smoothing: speed v₀ of tanh(v / v₀), m/s and rad/s.
        period, delay: of the digital controller, s.
        time_constant: of the filter of the speeds, s.
        noise: standard deviation of the force of every actuator, one value a period, N.
        effort_limit, carrier_force_limit: of the amplifiers, N.
    """

    mass: float = 0.05
    length: float = 1e-3
    start_position: float = 2e-4
    start_speed: float = 2e-3
    prismatic_coulomb: float = 0.1
    prismatic_viscous: float = 0.2
    revolute_coulomb: float = 5e-3
    revolute_viscous: float = 5e-3
    prismatic_smoothing: float = 0.01
    revolute_smoothing: float = 0.05
    period: float = 1e-3
    delay: float = 1e-3
    time_constant: float = 5e-3
    noise: float = 0.05
    effort_limit: float = 20.0
    carrier_force_limit: float = 40.0


@dataclass(frozen=True, eq=False)
class Draw:
    """One machine that is not quite as planned: arguments of ``load_robot``, and what else is drawn.

    That are (nv,) factors on friction, the (nq,) phase of the encoders in fractions of a step, errors of the platform
    (n,) and the carriers (k,) at the start, m and m/s, and what the noise of the forces is drawn from.
    """

    arguments: Mapping[str, float]
    coulomb: Array
    viscous: Array
    phase: Array
    x: Array
    xd: Array
    s: Array
    sd: Array
    random: np.random.Generator


def draw(nominal: Robot, imperfections: Imperfections, seed: int, number: int) -> Draw:
    """Return a draw; the same seed and number give the same machine, whatever was drawn before."""
    random = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number,)))
    known: Mapping[str, Any] = nominal.parameters
    # every call of a stream moves it on: another order of these lines is another machine
    masses = {name: known[name] * (1.0 + imperfections.mass * random.uniform(-1.0, 1.0)) for name in DRAWN_MASSES}
    lengths = {name: known[name] + imperfections.length * random.uniform(-1.0, 1.0) for name in DRAWN_LENGTHS}
    model = nominal.model
    # a stream of its own: with or without errors of the start, everything else is the same machine
    start = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number, 1)))
    position, speed = imperfections.start_position, imperfections.start_speed
    coulomb, viscous = random.uniform(0.5, 1.5, model.nv), random.uniform(0.5, 1.5, model.nv)
    phase = random.uniform(-0.5, 0.5, model.nq)
    bounds = ((position, nominal.n), (speed, nominal.n), (position, nominal.k), (speed, nominal.k))
    x, xd, s, sd = (start.uniform(-bound, bound, count) for bound, count in bounds)
    return Draw({**masses, **lengths}, coulomb, viscous, phase, x, xd, s, sd, random)
