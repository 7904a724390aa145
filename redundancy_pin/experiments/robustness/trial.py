"""One machine that is not quite as planned, driven through a crossing."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.dynamics.allocation import AllocationStatus
from redundancy_pin.errors import RedundancyPinError
from redundancy_pin.experiments.robustness.draws import Draw, Imperfections, draw
from redundancy_pin.experiments.robustness.scenarios import MASS, Drive, Scenario, nominal, planned
from redundancy_pin.kinematics.coordinates import turning_velocities
from redundancy_pin.loading import load_robot
from redundancy_pin.simulation.controllers.base import Controller, Sampling, Tracking
from redundancy_pin.simulation.controllers.computed_torque import ComputedTorque
from redundancy_pin.simulation.controllers.encoders import Encoders, JointFriction
from redundancy_pin.simulation.controllers.lqr import TimeVaryingLqr
from redundancy_pin.simulation.reference import MotionReference
from redundancy_pin.simulation.simulate import simulate
from redundancy_pin.simulation.state import State, closed_state

Key = tuple[str, str, int]
"""Names of scenario and drive, number of the draw."""

SUCCESS = 0.01
"""m; a crossing counts where the simulation reaches its end and the platform was never farther from its plan."""

RTOL, ATOL = 1e-6, 1e-8
"""Of the integrator: a hundredth of an encoder's step over a crossing."""


@dataclass(frozen=True)
class Trial:
    """What became of one draw.

    Attributes:
        scenario, drive: names.
        number: of the draw.
        status: of the simulation; "error" where none came about, with why in ``reason``.
        reason: of a failure; the event at a stop; else empty.
        largest: largest distance of the platform from its plan, m; NaN where nothing was simulated.
        rms: its root mean square over time.
        effort: largest |τ|, N.
        carrier_force: largest |F|, N.
        given_up: share of the readings at which a computed torque found no answer.
    """

    scenario: str
    drive: str
    number: int
    status: str
    reason: str
    largest: float
    rms: float
    effort: float
    carrier_force: float
    given_up: float

    @property
    def success(self) -> bool:
        """Whether the machine crossed."""
        return self.status == "completed" and self.largest <= SUCCESS

    @property
    def key(self) -> Key:
        """What identifies it within a study."""
        return self.scenario, self.drive, self.number

    def as_dict(self) -> dict[str, Any]:
        """Return plain data, for JSON; None for NaN."""
        return {key: None if isinstance(value, float) and np.isnan(value) else value
                for key, value in asdict(self).items()}  # fmt: skip


def trial_from(data: Mapping[str, Any]) -> Trial:
    """Return a trial from its plain data.

    Raises:
        KeyError, TypeError, ValueError: it is none.
    """
    names = Trial.__dataclass_fields__
    values: dict[str, Any] = {name: data[name] for name in names}
    for name in ("largest", "rms", "effort", "carrier_force", "given_up"):
        values[name] = float("nan") if values[name] is None else float(values[name])
    return Trial(**values)


def run_trial(scenario: Scenario, drive: Drive, imperfections: Imperfections, seed: int, number: int) -> Trial:
    """Simulate one draw.

    The machine is homed at the pose and carrier positions that the plan starts with, and starts a little beside them.
    The controller knows the robot as planned, and the machine through encoders alone.

    Args:
        scenario: the crossing.
        drive: what controls it.
        imperfections: bounds.
        seed: of the study.
        number: which draw.
    """
    motion = planned(scenario)
    drawn = draw(nominal(), imperfections, seed, number)
    control = controller(scenario, drive, imperfections)
    if isinstance(control, ComputedTorque):
        control.history.clear()
    point = motion.at(scenario.start)
    arguments: dict[str, Any] = {**MASS, **drawn.arguments}
    try:
        robot = load_robot("2rpr", **arguments)
        homed = closed_state(robot, point.x, point.xd, point.s, point.sd, t=scenario.start).q - point.q
        seen = _through_encoders(control, motion, drawn, imperfections, homed)
        run = simulate(
            robot,
            Amplifier(seen, drawn.random, imperfections.noise),
            start=closed_state(
                robot,
                point.x + drawn.x,
                point.xd + drawn.xd,
                point.s + drawn.s,
                point.sd + drawn.sd,
                t=scenario.start,
            ),
            duration=scenario.end - scenario.start,
            dt=imperfections.period,  # every value that the amplifiers put out is among the samples
            sampling=Sampling(imperfections.period, imperfections.delay),
            effort_limit=imperfections.effort_limit,
            carrier_force_limit=imperfections.carrier_force_limit,
            external=_friction(drawn, imperfections),
            rtol=RTOL,
            atol=ATOL,
            integrator="RK45",
        )
    except RedundancyPinError as error:
        none = float("nan")
        return Trial(scenario.name, drive, number, "error", str(error), none, none, none, none, none)
    reference = np.array([motion.platform(float(t))[0] for t in run.t])
    away = np.linalg.norm(run.x - reference, axis=1)
    span = float(run.t[-1] - run.t[0])
    last = run.events[-1] if run.events else None
    return Trial(
        scenario.name,
        drive,
        number,
        run.status.value,
        run.reason or (last.name if last is not None and last.terminal else ""),
        float(away.max()),
        float(np.sqrt(np.trapezoid(away**2, run.t) / span)) if span > 0.0 else float(away[0]),
        float(np.nanmax(np.abs(run.tau))),
        float(np.nanmax(np.abs(run.carrier_force))),
        _given_up(control),
    )


@functools.cache
def controller(scenario: Scenario, drive: Drive, imperfections: Imperfections) -> Controller:
    """Return the controller of a cell, made once a process; it knows the robot as planned."""
    motion = planned(scenario)
    sampling = Sampling(imperfections.period, imperfections.delay)
    limits = imperfections.effort_limit, imperfections.carrier_force_limit
    match drive:
        case "computed torque":
            return ComputedTorque(motion, effort_limit=limits[0], carrier_force_limit=limits[1], sampling=sampling)
        case "LQR":
            return TimeVaryingLqr(motion, effort_limit=limits[0], carrier_force_limit=limits[1], sampling=sampling)
        case _:
            return _OpenLoop(motion, None, sampling)


class _OpenLoop(Tracking):
    """The planned efforts, those of the middle of the interval in which they will act."""

    def effort(self, t: float, state: State) -> tuple[Array, Array]:
        return self.reference.loads(t + self.lead)


class Amplifier:
    """A controller whose forces come out with noise, one value a period.

    Args:
        controller: what commands the efforts.
        random: for the noise.
        noise: its standard deviation, N or N·m.
    """

    def __init__(self, controller: Controller, random: np.random.Generator, noise: float) -> None:
        self._controller, self._random, self._noise = controller, random, noise

    def effort(self, t: float, state: State) -> tuple[Array, Array]:
        """Return main efforts (m,) and carrier forces (k,) with noise."""
        tau, force = self._controller.effort(t, state)
        return (
            tau + self._noise * self._random.standard_normal(len(tau)),
            force + self._noise * self._random.standard_normal(len(force)),
        )


def _through_encoders(
    control: Controller, motion: MotionReference, drawn: Draw, imperfections: Imperfections, home: Array
) -> Encoders:
    return Encoders(
        control,
        motion,
        period=imperfections.period,
        time_constant=imperfections.time_constant,
        phase=drawn.phase,
        home=home,
    )


def _friction(drawn: Draw, imperfections: Imperfections) -> JointFriction:
    turning = turning_velocities(nominal())
    return JointFriction(
        drawn.coulomb * np.where(turning, imperfections.revolute_coulomb, imperfections.prismatic_coulomb),
        drawn.viscous * np.where(turning, imperfections.revolute_viscous, imperfections.prismatic_viscous),
        np.where(turning, imperfections.revolute_smoothing, imperfections.prismatic_smoothing),
    )


def _given_up(control: Controller) -> float:
    if not isinstance(control, ComputedTorque) or not control.history:
        return 0.0
    lost = sum(one.allocation.status is AllocationStatus.UNBALANCED for one in control.history)
    return lost / len(control.history)
