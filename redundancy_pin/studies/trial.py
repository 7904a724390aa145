"""A trial: one machine that is not quite as planned, driven through a planned crossing."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.dynamics.backends import RNEA
from redundancy_pin.errors import RedundancyPinError
from redundancy_pin.loading import load_robot
from redundancy_pin.planners.reference import MotionReference, plan_reference
from redundancy_pin.robot import Robot
from redundancy_pin.simulation.controllers.base import Controller, Sampling
from redundancy_pin.simulation.controllers.by_name import Drive, NoisyAmplifier, controller_by_name, joint_friction
from redundancy_pin.simulation.controllers.computed_torque import ComputedTorque
from redundancy_pin.simulation.controllers.encoders import Encoders, JointFriction
from redundancy_pin.simulation.replay import away_from, rms_over_time
from redundancy_pin.simulation.simulate import simulate
from redundancy_pin.simulation.state import closed_state
from redundancy_pin.status import ResultStatus
from redundancy_pin.studies.case import Case, Planner, load, options

MASSES = {"end_effector_mass": 0.5, "cylinder_mass": 0.3}
"""The 2-RPR of the thesis is massless but for its carriers: forces would not determine its motion. kg."""

PLANNED_TRACK = 0.16
"""Half of the track that plans may use, m; the machine has 0.2: a controller needs room."""

DRAWN_MASSES = (*MASSES, "carrier_mass")
DRAWN_LENGTHS = ("base_distance", "track_offset", "cylinder_length")

Key = tuple[str, str, int]
"""Names of scenario and drive, number of the draw."""

SUCCESS = 0.01
"""m; a crossing counts where the simulation reaches its end and the platform was never farther from its plan."""

RTOL, ATOL = 1e-6, 1e-8
"""Of the integrator: a hundredth of an encoder's step over a crossing."""


@dataclass(frozen=True)
class Scenario:
    """A planned crossing, simulated from ``start`` to ``end``, s: the singular poses and what leads there."""

    case: Case
    start: float
    end: float

    @property
    def name(self) -> str:
        """For tables."""
        return self.case.name


def crossing(
    path: str, planner: Planner, speed: float, dt: float, start: float, end: float, **parameters: float
) -> Scenario:
    """Return a scenario of the 2-RPR with masses, whose plan may use part of its tracks."""
    arguments = options(**MASSES, track_half_length=PLANNED_TRACK)
    name = f"{path}, {planner.replace('_', ' ')}"
    case = Case(name, "2rpr", path, options(speed=speed), planner, options(**parameters), arguments=arguments, dt=dt)
    return Scenario(case, start, end)


SCENARIOS: tuple[Scenario, ...] = (
    crossing("line", "switch_off", 0.2, 5e-3, 1.9, 3.1, threshold=4.0, ramp_down=0.36),
    crossing("line", "whole_trajectory", 0.2, 1e-2, 1.9, 3.1),
    crossing("circle", "whole_trajectory", 0.5, 5e-3, 0.2, 1.1),
)
"""On the circle the machine with masses has no switch-off plan: its end-effector accelerates at the singular poses."""


def nominal() -> Robot:
    """Return the robot as planned, with its own track."""
    return load("2rpr", arguments=options(**MASSES))


@functools.cache
def planned(case: Case) -> MotionReference:
    """Return the planned motion of a case, made once a process; InfeasiblePlanError if there is none."""
    return plan_reference(case.plan(RNEA), robot=case.load_robot(), motion=case.trajectory())


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
        return self.status == ResultStatus.OK.value and self.largest <= SUCCESS

    @property
    def key(self) -> Key:
        """What identifies it within a study."""
        return self.scenario, self.drive, self.number

    def as_dict(self) -> dict[str, Any]:
        """Return plain data; NaN is left to the reader."""
        return asdict(self)


def run_trial(scenario: Scenario, drive: Drive, imperfections: Imperfections, seed: int, number: int) -> Trial:
    """Simulate one draw of a study.

    The machine is homed at the pose and carrier positions that the plan starts with, and starts a little beside them.
    The controller knows the robot as planned, and the machine through encoders alone.
    """
    motion = planned(scenario.case)
    drawn = draw(nominal(), imperfections, seed, number)
    control = controller(scenario, drive, imperfections)
    if isinstance(control, ComputedTorque):
        control.history.clear()  # of the draw before: a controller is made once a process
    point = motion.at(scenario.start)
    arguments: dict[str, Any] = {**MASSES, **drawn.arguments}
    try:
        robot = load_robot("2rpr", **arguments)
        homed = closed_state(robot, point.x, point.xd, point.s, point.sd, t=scenario.start).q - point.q
        period, filtered = imperfections.period, imperfections.time_constant
        seen = Encoders(control, motion, period=period, time_constant=filtered, phase=drawn.phase, home=homed)
        beside = (point.x + drawn.x, point.xd + drawn.xd, point.s + drawn.s, point.sd + drawn.sd)
        run = simulate(
            robot,
            NoisyAmplifier(seen, drawn.random, imperfections.noise),
            start=closed_state(robot, *beside, t=scenario.start),
            duration=scenario.end - scenario.start,
            dt=period,  # every value that the amplifiers put out is among the samples
            sampling=Sampling(period, imperfections.delay),
            effort_limit=imperfections.effort_limit,
            carrier_force_limit=imperfections.carrier_force_limit,
            external=_friction(drawn, imperfections),
            rtol=RTOL,
            atol=ATOL,
            integrator="RK45",
        )
    except RedundancyPinError as error:
        return Trial(scenario.name, drive, number, "error", str(error), *5 * (float("nan"),))
    away = away_from(motion, run)
    last = run.events[-1] if run.events else None
    reason = run.reason or (last.name if last is not None and last.terminal else "")
    worst, (tau, force) = float(away.max()), (float(np.nanmax(np.abs(part))) for part in (run.tau, run.carrier_force))
    status = run.status.value
    rms, lost = rms_over_time(run.t, away), _given_up(control)
    return Trial(scenario.name, drive, number, status, reason, worst, rms, tau, force, lost)


@functools.cache
def controller(scenario: Scenario, drive: Drive, imperfections: Imperfections) -> Controller:
    """Return the controller of a cell, made once a process; it knows the robot as planned."""
    motion, sampling = planned(scenario.case), Sampling(imperfections.period, imperfections.delay)
    most = {name: getattr(imperfections, name) for name in ("effort_limit", "carrier_force_limit")}
    return controller_by_name(drive, motion, sampling=sampling, **most)


def _friction(drawn: Draw, imperfections: Imperfections) -> JointFriction:
    named = {name: value for name, value in asdict(imperfections).items() if name.startswith(("prismatic", "revolute"))}
    return joint_friction(nominal(), coulomb_factor=drawn.coulomb, viscous_factor=drawn.viscous, **named)


def _given_up(control: Controller) -> float:
    if not isinstance(control, ComputedTorque) or not control.history:
        return 0.0
    lost = sum(not one.allocation.balanced for one in control.history)
    return lost / len(control.history)
