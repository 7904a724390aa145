"""A machine that follows a planned motion, under a controller and conditions that are less than perfect."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from redundancy_pin.arrays import not_negative, whole
from redundancy_pin.errors import InputError, did_you_mean, rounded_down, shown
from redundancy_pin.planners.reference import MotionReference
from redundancy_pin.robot import Robot
from redundancy_pin.simulation.controllers.base import Controller, Sampling
from redundancy_pin.simulation.controllers.by_name import Drive, NoisyAmplifier, controller_by_name, joint_friction
from redundancy_pin.simulation.controllers.encoders import Encoders
from redundancy_pin.simulation.replay import CONTROLLED_ATOL, CONTROLLED_RTOL
from redundancy_pin.simulation.result import Simulation
from redundancy_pin.simulation.simulate import simulate
from redundancy_pin.simulation.state import closed_state

FRICTION = tuple(name for name in inspect.signature(joint_friction).parameters if name.endswith(("coulomb", "viscous")))
"""Keywords of ``joint_friction`` that ``Conditions.friction`` takes."""

LARGEST_SEED = 2**63 - 1

FEWEST = 10
"""Periods, and samples, of a whole motion: with fewer they are probably in another unit."""


@dataclass(frozen=True, kw_only=True)
class Conditions:
    """What makes a machine under control less than perfect.

    Attributes:
        period: sampling of the controller, s; it is evaluated at every instant when left out.
        delay: from the reading of the controller to its answer, s; 0 when left out.
        encoders: the controller sees the joints through encoders of 16 bits a turn and 1 µm.
        noise: standard deviation of every actuator's effort, one value a period, N or N·m.
        seed: of the noise; 0 when left out.
        friction: of the joints, by names of ``FRICTION``; N, N·m, s.

    Raises:
        InputError: delay, encoders or noise without a period; a seed without noise; unknown names of friction.
    """

    period: float | None = None
    delay: float | None = None
    encoders: bool = False
    noise: float = 0.0
    seed: int | None = None
    friction: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check the combination of the settings."""
        for name in self.friction:
            if name not in FRICTION:
                remedy = f"{did_you_mean(name, FRICTION)}It takes {', '.join(FRICTION)}."
                raise InputError(f"friction has no {shown(name)}.", remedy=remedy, name="friction")
        if self.seed is not None:
            whole(self.seed, "seed", 0, LARGEST_SEED)
        if self.seed is not None and not self.noise:
            raise InputError("seed is that of the noise, and there is none.", remedy="Add noise.", name="seed")
        not_negative(self.noise, "noise")
        for name in ("delay", "noise", "encoders") if self.sampling is None else ():
            if getattr(self, name):
                remedy = "Add a period, 0.001 (--period 0.001)."
                raise InputError(f"{name} goes with a sampled controller.", remedy=remedy, name=name)

    @property
    def sampling(self) -> Sampling | None:
        """The sampling of the controller; None for one that is evaluated at every instant."""
        return None if self.period is None else Sampling(self.period, self.delay or 0.0)


def follow(
    machine: Robot,
    reference: MotionReference,
    controller: Drive = "open loop",
    conditions: Conditions | None = None,
    *,
    duration: float | None = None,
    dt: float | None = None,
    **settings: Any,
) -> Simulation:
    """Simulate a machine that is to follow a motion, from the planned start.

    Args:
        machine: the robot that is simulated; the controller knows the robot of the reference.
        reference: the motion, from ``plan_reference`` or ``motion_reference``.
        controller: what drives the machine, as of ``controller_by_name``.
        conditions: imperfections; none when left out.
        duration: s; to the end of the motion when left out.
        dt: between the samples of the result, s; the period of the controller, or 0.005, when left out.
        settings: further keywords of ``simulate``.

    Raises:
        InputError: a period or ``dt`` of more than a tenth of the motion.
        RedundancyPinError: as ``simulate``.

    Example:
        >>> noisy = Conditions(period=1e-3, delay=1e-3, noise=0.05)
        >>> follow(robot, plan_reference(plan), "computed torque", noisy).status
        <ResultStatus.OK: 'ok'>
    """
    given = conditions or Conditions()
    sampling, most = given.sampling, (reference.end - reference.start) / FEWEST
    for name, value in (("period", given.period), ("dt", dt)):
        if value is not None and value > most:
            raise InputError(
                f"{name} is {value:g} s, and the whole motion takes {FEWEST * most:.4g} s.",
                remedy=f"Pass at most {rounded_down(most)} s.",
                name=name,
            )
    limits = {name: settings.get(name) for name in ("effort_limit", "carrier_force_limit")}
    drive: Controller = controller_by_name(controller, reference, sampling=sampling, **limits)
    start, point = drive.start_state(machine), reference.at(reference.start)
    if machine is not reference.robot:  # with other lengths its chains would not be closed there
        start = closed_state(machine, point.x, point.xd, point.s, point.sd, t=reference.start)
    if sampling is not None:
        digital = {"rtol": CONTROLLED_RTOL, "atol": CONTROLLED_ATOL, "integrator": "RK45"}
        settings = {"dt": sampling.period, **digital, **settings}
        if given.encoders:
            drive = Encoders(drive, reference, period=sampling.period)
    if given.noise:
        drive = NoisyAmplifier(drive, np.random.default_rng(given.seed or 0), given.noise)
    return simulate(
        machine,
        drive,
        start=start,
        duration=reference.end - reference.start if duration is None else duration,
        sampling=sampling,
        external=joint_friction(machine, **given.friction) if given.friction else None,
        **(settings if dt is None else {**settings, "dt": dt}),
    )
