"""What a simulation returns."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicHermiteSpline

from redundancy_pin.arrays import Array, Frozen, checked, peak
from redundancy_pin.errors import InputError
from redundancy_pin.io.archive import read_archive, write_archive
from redundancy_pin.io.schema import record_of
from redundancy_pin.io.summary import Summary
from redundancy_pin.kinematics.forward_kinematics import platform_rates
from redundancy_pin.motion import CarrierMotion
from redundancy_pin.planners.limits import LimitEvent
from redundancy_pin.planners.plan import Plan
from redundancy_pin.planners.reference import MotionReference
from redundancy_pin.planners.robot_record import RobotRecord, read_robot, robot_of_record
from redundancy_pin.robot import Robot
from redundancy_pin.simulation.events import Event
from redundancy_pin.simulation.summary import summary
from redundancy_pin.status import ResultStatus

if TYPE_CHECKING:
    from redundancy_pin.planners.export import PlanTable

FORMAT = "redundancy_pin simulation"
"""What a saved simulation calls itself."""

VERSION = 4
"""Version of the file format. 4: limits that are exceeded."""


@dataclass(frozen=True)
class Statistics:
    """What the integration took.

    Attributes:
        steps: accepted steps.
        evaluations: evaluations of the accelerations.
        restarts: number of restarts of the integrator, at breaks and samples of a controller.
        largest_correction: largest closure residual, m, at the end of a step before the projection took it away.
        seconds: time it took, s.
    """

    steps: int
    evaluations: int
    restarts: int
    largest_correction: float
    seconds: float


@dataclass(frozen=True, eq=False, repr=False)
class Simulation(Frozen):
    """A simulated motion; the arrays are read-only.

    N samples, n coordinates, m main actuators, k carriers, r closure rows.

    Where efforts jump, the sample holds those after the jump.

    Attributes:
        t: (N,) time, s.
        q: (N, nq) tree configurations, chains closed.
        v: (N, nv) tree velocities.
        a: (N, nv) tree accelerations.
        x: (N, n) platform coordinates, base frame, m and rad (angles run on past π), or poses (N, 4, 4).
        xd: (N, n) their rate, m/s and rad/s; the world-aligned twist for poses.
        s, sd, sdd: (N, k) carrier positions, m, speeds, m/s, and accelerations, m/s².
        tau: (N, m) main efforts that acted, N or N·m.
        carrier_force: (N, k) forces of the carriers' actuators, N: those that acted, or those that a prescribed
            motion took.
        actuated_rate: (N, m) rates of the main actuators, m/s or rad/s.
        closure_force: (N, r) forces of the closure rows on their second frame, along the axes of the first, N or N·m.
        stop_force: (N, nv) generalised forces of stops on the joints that they hold, N or N·m; zero elsewhere.
        gap: (N,) largest closure residual, m; angles count times the characteristic length.
        energy: (N,) kinetic plus potential energy, J (zero height at the world origin).
        events: events, in order of time.
        violated: limits of the robot that the samples exceed, as those of a plan, by time.
        status: how it ended.
        reason: why it failed; empty otherwise.
        statistics: effort of the integration.
        robot: the robot, in plain data.
        parameters: how it was run, in plain data.
    """

    t: Array
    q: Array
    v: Array
    a: Array
    x: Array
    xd: Array
    s: Array
    sd: Array
    sdd: Array
    tau: Array
    carrier_force: Array
    actuated_rate: Array
    closure_force: Array
    stop_force: Array
    gap: Array
    energy: Array
    events: tuple[Event, ...]
    violated: tuple[LimitEvent, ...]
    status: ResultStatus
    reason: str
    statistics: Statistics
    robot: RobotRecord
    parameters: Mapping[str, object] = field(default_factory=dict)

    def __repr__(self) -> str:
        """Return a short text that identifies the simulation, without its arrays."""
        main, moved = self.robot.actuated, self.robot.carriers
        why = f" ({self.reason})" if self.reason else ""
        return (
            f"Simulation({self.robot.name!r}, {self.status.value}{why}, {len(self.events)} events; N={len(self)}, "
            f"t={self.t[0]:g}..{self.t[-1]:g} s, n={self.xd.shape[1]}, m={len(main)}, k={len(moved)}; "
            f"{peak('tau', self.tau, self.robot.effort_unit(*main))}, "
            f"{peak('carrier_force', self.carrier_force, self.robot.effort_unit(*moved))})"
        )

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.t)

    @property
    def work(self) -> Array:
        """(N,) work of all actuators since the start, J: trapezoidal sum of their power over the samples."""
        power = (self.tau * self.actuated_rate).sum(axis=1) + (self.carrier_force * self.sd).sum(axis=1)
        steps = 0.5 * (power[1:] + power[:-1]) * np.diff(self.t)
        total: Array = np.concatenate([[0.0], np.cumsum(steps)])
        return total

    @property
    def carriers(self) -> CarrierMotion:
        """The carriers' motion."""
        return CarrierMotion(self.s, self.sd, self.sdd, check_rates=False)

    def at(self, times: ArrayLike) -> tuple[Array, Array]:
        """Return x and ẋ, each (T, n), at times (T,) within the simulation, from the cubics through x and ẋ.

        Between samples Δt apart x is off by O(Δt⁴), and by O(Δt²) of the jump in a step where efforts jump.

        Raises:
            InputError: times outside the simulation, or poses.
        """
        instants = checked(np.atleast_1d(np.asarray(times)), "times", ("T",))
        if self.x.ndim == 3 or instants.min() < self.t[0] or instants.max() > self.t[-1]:
            what = "it moves a pose" if self.x.ndim == 3 else f"it lasts from {self.t[0]:.6g} to {self.t[-1]:.6g} s"
            raise InputError(f"The simulation has no x at these times: {what}.", remedy="Simulate with a finer dt.")
        kept = np.append(np.diff(self.t) > 0.0, True)
        spline = CubicHermiteSpline(self.t[kept], self.x[kept], self.xd[kept])
        return spline(instants), spline(instants, 1)

    def summary(self, motion: Plan | MotionReference | None = None, robot: Robot | None = None) -> Summary:
        """Return what is worth knowing of the simulation, SI units: a mapping; ``print`` shows tables with warnings.

        Args:
            motion: the plan, or the motion (``motion_reference``), that it was to follow. With it, how far the platform
                is from it is in the summary too.
            robot: that of the simulation; loaded when left out, and not needed without ``motion``.

        Raises:
            PlanFileError: the robot cannot be loaded, or is no longer what it was.

        Example:
            >>> print(rp.simulate(robot, plan).summary(plan))
        """
        return summary(self, motion, robot)

    def table(self, robot: Robot | None = None) -> PlanTable:
        """Return positions, rates, accelerations and efforts by joint name, as ``Plan.table`` does.

        ``run.table().to_csv("run.csv")`` writes it.

        Args:
            robot: the simulated robot; loaded when left out.

        Raises:
            PlanFileError: the robot cannot be loaded, or has changed since.
        """
        from redundancy_pin.planners.export import FORMAT, VERSION, table_of_states

        machine = robot_of_record(self.robot, robot)
        efforts = np.concatenate([self.tau, self.carrier_force], axis=1)
        about = {"format": FORMAT, "version": VERSION, "robot": self.robot.name, "status": self.status.value}
        xdd = platform_rates(machine, self.q, self.v, self.a)[1]
        states = (self.t, self.x, self.xd, xdd, self.q, self.v, self.a, efforts)
        return table_of_states(machine, states, about)

    def save(self, path: str | Path) -> None:
        """Write the simulation to a file without loss (npz with JSON inside); ``load_simulation`` reads it.

        Raises:
            OutputError: the file cannot be written; an earlier one is as it was.
        """
        write_archive(path, FORMAT, VERSION, replace(self, robot=self.robot.saved_beside(path)))


def load_simulation(path: str | Path) -> Simulation:
    """Read a simulation that was saved with ``Simulation.save``. Nothing in the file is executed.

    Raises:
        PlanFileError: the file is missing, truncated, damaged, no simulation, of a newer format, or its arrays do not
            fit together.

    Example:
        >>> from redundancy_pin.simulation import load_simulation
        >>> rp.simulate("four_bar", duration=0.1).save("run.npz")
        >>> load_simulation("run.npz").status.value
        'ok'
    """
    return read_archive(path, FORMAT, VERSION, "simulation", lambda record: _simulation(record, path))


def _simulation(record: Mapping[str, Any], path: str | Path) -> Simulation:
    """Return the simulation of a record of a file, checked."""
    values = {field.name: record[field.name] for field in fields(Simulation)}
    values["robot"] = read_robot(values["robot"], path)
    values["events"] = tuple(Event(**entry) for entry in values["events"])
    values["violated"] = tuple(record_of(LimitEvent, entry) for entry in values["violated"])
    values["status"] = ResultStatus(values["status"])
    values["statistics"] = Statistics(**values["statistics"])
    simulation = Simulation(**values)
    _check(simulation)
    return simulation


def _check(simulation: Simulation) -> None:
    """Check that the arrays fit together."""
    # first the sizes that the others are measured by
    for name, axes in (("t", (1,)), ("v", (2,)), ("x", (2, 3)), ("xd", (2,)), ("closure_force", (2,))):
        if np.ndim(getattr(simulation, name)) not in axes:
            raise InputError(f"{name} has shape {np.shape(getattr(simulation, name))}, which no simulation has")
    robot, (n, nv, r) = simulation.robot, (getattr(simulation, one).shape[1] for one in ("xd", "v", "closure_force"))
    m, k = len(robot.actuated), len(robot.carriers)
    widths = {
        "t gap energy": (),
        "q": (len(robot.q_reference),),
        "v a stop_force": (nv,),
        "x": (4, 4) if simulation.x.ndim == 3 else (n,),
        "xd": (n,),
        "s sd sdd carrier_force": (k,),
        "tau actuated_rate": (m,),
        "closure_force": (r,),
    }
    for name, width in ((name, width) for names, width in widths.items() for name in names.split()):
        value, shape = getattr(simulation, name), (len(simulation.t), *width)
        if not isinstance(value, np.ndarray) or value.dtype != np.float64:
            raise InputError(f"{name} is no array of floats")
        if value.shape != shape:
            raise InputError(f"{name} has shape {value.shape}, but the rest of the simulation needs {shape}")
