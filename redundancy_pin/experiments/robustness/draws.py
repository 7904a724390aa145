"""What may be wrong with a machine, drawn at random."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.robot import Robot

MASSES = ("end_effector_mass", "cylinder_mass", "carrier_mass")
LENGTHS = ("base_distance", "track_offset", "cylinder_length")


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
    """One machine that is not quite as planned.

    Attributes:
        arguments: of ``load_robot``.
        coulomb: (nv,) factors on Coulomb friction.
        viscous: (nv,) factors on viscous friction.
        phase: (nq,) of the encoders, fractions of a step.
        x, xd: (n,) errors of the platform at the start, m and m/s.
        s, sd: (k,) those of the carriers.
        random: for the noise of the forces.
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
    """Return a draw; the same seed and number give the same machine, whatever was drawn before.

    Args:
        nominal: the robot as planned.
        imperfections: bounds.
        seed: of the study.
        number: which draw.
    """
    random = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number,)))
    known = nominal.parameters
    arguments = {name: float(known[name]) * (1.0 + imperfections.mass * random.uniform(-1.0, 1.0)) for name in MASSES}
    for name in LENGTHS:
        arguments[name] = float(known[name]) + imperfections.length * random.uniform(-1.0, 1.0)
    model = nominal.model
    # a stream of its own: with or without errors of the start, everything else is the same machine
    start = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number, 1)))
    position, speed = imperfections.start_position, imperfections.start_speed
    return Draw(
        arguments,
        random.uniform(0.5, 1.5, model.nv),
        random.uniform(0.5, 1.5, model.nv),
        random.uniform(-0.5, 0.5, model.nq),
        start.uniform(-position, position, nominal.n),
        start.uniform(-speed, speed, nominal.n),
        start.uniform(-position, position, nominal.k),
        start.uniform(-speed, speed, nominal.k),
        random,
    )
