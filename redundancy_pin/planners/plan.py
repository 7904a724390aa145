"""A plan: platform motion, carrier motion and all efforts, with what limits them; saved and read back."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from redundancy_pin.arrays import NEAR_SINGULAR_MARGIN, Array, Frozen, IntArray, Side, largest, peak, require_type
from redundancy_pin.dynamics.default import DynamicsLike, as_dynamics
from redundancy_pin.errors import InputError, shown
from redundancy_pin.io.archive import read_archive, write_archive
from redundancy_pin.io.schema import record_of
from redundancy_pin.io.summary import Summary
from redundancy_pin.loading import RobotLike
from redundancy_pin.motion import CarrierMotion, PlatformMotion
from redundancy_pin.planners.functions import PlanFunctions
from redundancy_pin.planners.intersample_check import Findings, IntersamplePeaks
from redundancy_pin.planners.limits import QUANTITIES, LimitEvent, LimitReport, ResolvedLimits
from redundancy_pin.planners.robot_record import RobotRecord, load_recorded, read_robot
from redundancy_pin.planners.summary import REVERSAL, summary
from redundancy_pin.robot import Robot
from redundancy_pin.status import ResultStatus, SampleStatus
from redundancy_pin.trajectory.continuous_motion import Motion, TimedTrajectory, as_motion
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial

if TYPE_CHECKING:
    from redundancy_pin.planners.export import PlanTable

PLAN_FORMAT = "redundancy_pin plan"
"""What a saved plan calls itself."""

PLAN_VERSION = 6
"""Version of the file format: counts up whenever the fields of the file change. 6: limits of further quantities."""

SAME_TIME = 1e-9
"""How far, relative to the duration, plan and trajectory may differ in their times."""


@dataclass(frozen=True, eq=False, repr=False)
class Plan(Frozen):
    """What a planner returns; the arrays are read-only. N samples, n coordinates, m main actuators, k carriers.

    Attributes:
        motion: platform motion; instants where an acceleration jumps appear twice.
        carriers: carrier motion.
        tau: (N, m) main efforts, N or N·m.
        carrier_force: (N, k) forces of the carriers' actuators, N.
        actuated_rate: (N, m) rates of the main actuators, m/s or rad/s.
        sample_status: (N,) a ``SampleStatus`` each.
        residual: (N,) scaled norm of W τ − f, N.
        margin: (N,) smallest singular value of the scaled W.
        condition: (N,) condition number of the scaled W.
        phase: (N,) index into ``phases`` of each sample.
        phases: names of the phases.
        limits: limits broken and touched.
        status: status of the whole plan.
        planner: name of the planner.
        backend: name of the backend.
        robot: the robot, in plain data.
        parameters: the planner's parameters, in plain data.
        findings: results of the planner for other functions.
        diagnostics: its other results (windows, counts, …), in plain data.
        functions: platform, carriers and efforts as functions of time, between the samples too: what ``simulate``,
            controllers and engines play. Whoever replaces ``motion`` or ``carriers`` replaces it too.
        between: largest efforts and forces of the continuous motion.
    """

    motion: PlatformMotion
    carriers: CarrierMotion
    tau: Array
    carrier_force: Array
    actuated_rate: Array
    sample_status: IntArray
    residual: Array
    margin: Array
    condition: Array
    phase: IntArray
    phases: tuple[str, ...]
    limits: LimitReport
    status: ResultStatus
    planner: str
    backend: str
    robot: RobotRecord
    functions: PlanFunctions
    between: IntersamplePeaks
    parameters: Mapping[str, object] = field(default_factory=dict)
    findings: Findings = field(default_factory=Findings)
    diagnostics: Mapping[str, object] = field(default_factory=dict)

    def __repr__(self) -> str:
        """Return a short text that identifies the plan, without its arrays."""
        main, moved = self.robot.actuated, self.robot.carriers
        return (
            f"Plan({self.robot.name!r}, {self.planner!r}, {self.backend!r}, {self.status.value}; "
            f"N={len(self.t)}, t={self.t[0]:g}..{self.t[-1]:g} s, n={self.motion.xd.shape[1]}, m={len(main)}, "
            f"k={len(moved)}; {peak('tau', self.peak_effort[None], self.robot.effort_unit(*main))}, "
            f"{peak('carrier_force', self.carrier_force, self.robot.effort_unit(*moved))})"
        )

    @property
    def t(self) -> Array:
        """(N,) time, s."""
        return self.motion.t

    def functions_along(self, trajectory: TimedTrajectory) -> PlanFunctions:
        """Return the functions of time with the platform on the trajectory that was planned for.

        Raises:
            InputError: the trajectory is not the plan's trajectory.
        """
        platform, first, last = as_motion(trajectory), float(self.t[0]), float(self.t[-1])
        slack = SAME_TIME * (last - first)
        after = self.t > platform.end + slack
        if abs(platform.start - first) > slack or platform.end > last + slack or self.motion.xd[after].any():
            raise InputError(
                f"The plan runs from {first:.9g} to {last:.9g} s, the trajectory to {platform.end:.9g} s.",
                remedy="Pass the trajectory the plan was made for.",
            )
        if after.any():
            platform = platform.prolonged_until(last)
        return replace(self.functions, platform=platform)

    def platform_at(self, times: ArrayLike) -> PlatformMotion:
        """Return the platform motion at (N,) increasing times, s; a jump twice gets both accelerations."""
        return self.functions.platform.sample_at(np.asarray(times, dtype=np.float64))

    def carriers_at(self, times: ArrayLike, side: Side = "right") -> CarrierMotion:
        """Return the carrier motion at (N,) times, s; ``side`` decides where s̈ jumps."""
        return self.functions.carriers_at(np.asarray(times, dtype=np.float64), side)

    def efforts_at(self, times: ArrayLike, dynamics: DynamicsLike) -> Array:
        """Return main efforts (N, m) at (N,) times, N or N·m: prescribed by the planner, or τ = W⁻¹ f of the motion.

        Args:
            times: (N,) increasing times, s.
            dynamics: the robot of the plan, or its name or path, for generated code (``as_dynamics``); or a
                backend of it.

        Returns:
            Efforts; NaN on an isolated type II singularity: see ``tau`` there.
        """
        dynamics = as_dynamics(dynamics)
        instants = np.asarray(times, dtype=np.float64)
        reduced = dynamics.along(self.platform_at(instants)).reduce(self.carriers_at(instants))
        return self.functions.efforts(reduced)

    def base_wrench(self, dynamics: DynamicsLike, point: ArrayLike | None = None) -> Array:
        """Return (N, 6) force, N, and moment, N·m, of the robot on its base at the samples, world axes.

        Args:
            dynamics: the robot of the plan, or its name or path, for generated code (``as_dynamics``); or a
                backend of it.
            point: (3,) point about which the moment is taken, m; the world origin when left out.
        """
        from redundancy_pin.planners.base_wrench import point_of, shift_moment_point

        dynamics = as_dynamics(dynamics)
        return shift_moment_point(dynamics.along(self.motion).base_wrench(self.carriers), point_of(point))

    @property
    def main_power(self) -> Array:
        """(N, m) power of the main actuators, W."""
        return self.tau * self.actuated_rate

    @property
    def carrier_power(self) -> Array:
        """(N, k) power of the carriers' actuators, W."""
        return self.carrier_force * self.carriers.sd

    @property
    def main_energy(self) -> float:
        """∫ Σ |τ q̇| dt of the main actuators at the samples, J: the energy drawn without recuperation."""
        return _absolute_integral(self.main_power, self.t)

    @property
    def carrier_energy(self) -> float:
        """∫ Σ |F ṡ| dt of the carriers' actuators at the samples, J."""
        return _absolute_integral(self.carrier_power, self.t)

    @property
    def peak_effort(self) -> Array:
        """(m,) largest |τ| of each main actuator in the continuous motion, N or N·m; infinite if unbounded."""
        return self.between.peak

    @property
    def peak_effort_at_samples(self) -> Array:
        """(m,) largest |τ| of each main actuator over the samples with finite efforts, N or N·m."""
        return largest(self.tau)

    @property
    def reversals(self) -> IntArray:
        """(m,) number of ``effort_reversals`` at the samples."""
        return np.array([len(samples) for samples in effort_reversals(self.tau)], dtype=np.intp)

    @property
    def reversals_near_singularities(self) -> IntArray:
        """(m,) number of ``reversals`` at samples with a singularity margin below ``NEAR_SINGULAR_MARGIN``."""
        near = self.margin < NEAR_SINGULAR_MARGIN
        return np.array([near[samples].sum() for samples in effort_reversals(self.tau)], dtype=np.intp)

    @property
    def least_cost(self) -> float | None:
        """Least weighted objective J* that ``plan_whole_trajectory`` found, in its unit; None for other planners.

        Optima are compared by it. The plan itself may cost more, by the fraction ``calm``.
        """
        return self.findings.least_cost

    @property
    def rms_effort(self) -> Array:
        """(m,) root mean square over time of each main effort at the samples, N or N·m."""
        duration = float(self.t[-1] - self.t[0])
        square = np.where(np.isfinite(self.tau), self.tau, 0.0) ** 2
        mean: Array = np.sqrt(np.trapezoid(square, self.t, axis=0) / duration) if duration > 0 else np.abs(self.tau[0])
        return mean

    def summary(self, dynamics: DynamicsLike | None = None) -> Summary:
        """Return a summary of the plan, SI units: a mapping, whose ``print`` is a table with warnings.

        ``smallest_margin`` is zero if the plan crosses a singularity, though no sample may lie on it; ``phases`` has
        name, first and last time of every run of samples in one phase.

        Args:
            dynamics: the robot of the plan, or its name or path; or a backend of it. With it, the largest force, N,
                and moment, N·m, on the base and the joints that leave their ranges are in the summary too.

        Example:
            >>> rp.load_plan("plan.npz").summary()["status"]
            'ok'
        """
        return summary(self, dynamics)

    def save(self, path: str | Path) -> None:
        """Write the plan to a file without loss (npz with JSON inside); ``load_plan`` reads it.

        Arrays are stored bit by bit; status, limits, robot, parameters and diagnostics as JSON text in the array
        ``metadata``, with the version of the format and of the package.

        Raises:
            OutputError: the file cannot be written; an earlier one is as it was.
            InputError: ``parameters`` or ``diagnostics`` hold something that is not plain data.
        """
        robot, platform = self.robot.saved_beside(path), self.functions.platform
        # a trajectory is not plain data
        functions = replace(self.functions, platform=replace(platform, source=platform.polynomials))
        write_archive(path, PLAN_FORMAT, PLAN_VERSION, replace(self, functions=functions, robot=robot))

    def table(
        self, rate: float | None = None, *, two_sided: bool | None = None, robot: RobotLike | None = None
    ) -> PlanTable:
        """Return positions, rates, accelerations and efforts by joint name, at a rate, Hz, or at the samples.

        The table writes itself for other programs: ``plan.table(rate=1000).to_csv("plan.csv")``, ``to_json``,
        ``to_mat``, ``to_ros``, ``to_dataframe`` (``PlanTable``).

        Args:
            rate: rows a second, by the functions of time of the plan; its samples when left out.
            two_sided: whether an instant at which something jumps has two rows, before and after it. When left out,
                rows at a rate have the values after the jump, and samples stay as they are.
            robot: the robot of the plan; loaded when left out.

        Raises:
            InputError: a rate that is not positive, or makes too many rows.
            InfeasiblePlanError: a rate, of a plan that has no finite efforts somewhere.
            PlanFileError: the robot cannot be loaded, or has changed since.
        """
        from redundancy_pin.planners.export import plan_table

        return plan_table(self, rate, two_sided=two_sided, robot=robot)


def effort_reversals(tau: Array) -> list[IntArray]:
    """Return for each effort the samples at which it reverses.

    A turning point is a reversal if the effort changes by ``REVERSAL`` of the peak before it and after it.

    Args:
        tau: (N, m) efforts at samples, N or N·m; NaN counts as zero.

    Returns:
        m arrays of indices of samples, increasing.
    """
    tau = np.nan_to_num(tau)
    least = REVERSAL * float(np.abs(tau).max(initial=0.0))
    return [_turning_points(effort, least) for effort in tau.T]


def _turning_points(values: Array, least: float) -> IntArray:
    """Return the samples at which (N,) values turn between changes of at least ``least``."""
    turned: list[int] = []
    low = high = 0  # samples of the extremes since the last turning point
    rising = None
    for i, value in enumerate(values.tolist()):
        low, high = (i if value < values[low] else low), (i if value > values[high] else high)
        if rising is not False and values[high] - value >= least > 0.0:
            turned += [high] if rising else []
            rising, low = False, i
        elif rising is not True and value - values[low] >= least > 0.0:
            turned += [low] if rising is False else []
            rising, high = True, i
    return np.array(turned, dtype=np.intp)


def _absolute_integral(power: Array, t: Array) -> float:
    return float(np.trapezoid(np.abs(np.where(np.isfinite(power), power, 0.0)).sum(axis=1), t))


def load_plan(path: str | Path) -> Plan:
    """Read a plan that was saved with ``Plan.save``. Nothing in the file is executed.

    Raises:
        PlanFileError: the file is missing, truncated, damaged, no plan, of another version, or its arrays do not fit
            together.

    Example:
        >>> rp.plan_stepwise("3rrr", rp.trajectory.reference.corner()).save("plan.npz")
        >>> rp.load_plan("plan.npz").planner
        'stepwise'
    """
    return read_archive(path, PLAN_FORMAT, PLAN_VERSION, "plan", lambda record: _plan(record, path))


class OfRobot(Protocol):
    """A result that records its robot: a plan or a simulation."""

    @property
    def robot(self) -> RobotRecord:
        """The robot, in plain data."""


def load_robot_of(plan: OfRobot, source: str | Path | None = None, *, trust: bool = False) -> Robot:
    """Load the robot a plan was made for, with the arguments, gravity and working mode it had.

    Args:
        plan: the plan, or a simulation.
        source: where the robot is now (as for ``load_robot``), if its files have moved. A plan that was loaded from a
            file needs it where its robot is neither shipped nor inside the folder of that file: the author of a file
            must not choose which code is loaded.
        trust: let expressions in the robot's files be any Python, as for ``load_robot``.

    Raises:
        PlanFileError: the robot's files are gone, lie elsewhere than in the plan's folder, or describe another robot
            than when the plan was made.

    Example:
        >>> plan = rp.plan_stepwise("3rrr", rp.trajectory.reference.corner())
        >>> rp.load_robot_of(plan).name
        '3rrr'
    """
    require_type(getattr(plan, "robot", plan), RobotRecord, "A plan or a simulation", "Pass load_plan(...).")
    return load_recorded(plan.robot, source, trust=trust)


def _plan(record: Mapping[str, Any], path: str | Path) -> Plan:
    """Return the plan of a record of a file, checked."""
    values = _values(Plan, record)
    limits = _values(LimitReport, values["limits"])
    values |= {
        # validated when they were planned
        "motion": PlatformMotion(**values["motion"], check_rates=False),
        "carriers": CarrierMotion(**values["carriers"], check_rates=False),
        "limits": LimitReport(
            violated=tuple(record_of(LimitEvent, one) for one in limits["violated"]),
            binding=tuple(record_of(LimitEvent, one) for one in limits["binding"]),
            judged_by=ResolvedLimits(**_values(ResolvedLimits, limits["judged_by"])),
        ),
        "status": ResultStatus(values["status"]),
        "robot": read_robot(values["robot"], path),
        "functions": _functions(values["functions"]),
        "between": IntersamplePeaks(**values["between"]),
        "findings": record_of(Findings, values["findings"]),
    }
    plan = Plan(**values)
    _check(plan)
    return plan


def _functions(record: Mapping[str, Any]) -> PlanFunctions:
    platform = _values(Motion, record["platform"])
    for name in ("breaks", "knots"):
        _require_array(f"functions, {name}", platform[name], "f", np.shape(platform[name])[:1] or (0,))
    for name, kind in (("start", float), ("end", float), ("moves_until", float), ("exact", bool)):
        if type(platform[name]) is not kind or not np.isfinite(platform[name]):
            raise InputError(f"functions, {name} is {shown(platform[name])}, expected a finite {kind.__name__}")
    preferred = record["preferred"]
    return PlanFunctions(
        platform=Motion(**{**platform, "source": _polynomial(platform["source"])}),
        carriers=_polynomial(record["carriers"]),
        prescribed=tuple(_polynomial(part) for part in record["prescribed"]),
        preferred=None if preferred is None else _polynomial(preferred),
    )


def _polynomial(record: Mapping[str, Any]) -> PiecewisePolynomial:
    function = PiecewisePolynomial(**record)
    _require_array("functions, edges", function.edges, "f", (function.coefficients.shape[1] + 1,))
    _require_array("functions, coefficients", function.coefficients, "f", function.coefficients.shape)
    if (
        function.coefficients.ndim != 3
        or 0 in function.coefficients.shape[:2]
        or not (np.diff(function.edges) > 0.0).all()
    ):
        raise InputError("functions hold polynomials whose pieces do not follow each other")
    return function


def _values(kind: type[Any], record: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values of all fields of a dataclass."""
    return {field.name: record[field.name] for field in fields(kind)}


def _check(plan: Plan) -> None:
    """Check that the arrays of a plan fit together and that its codes mean something."""
    samples, actuators, carriers = len(plan.motion), len(plan.robot.actuated), len(plan.robot.carriers)
    kinds = {"phases": tuple, "planner": str, "backend": str, "parameters": Mapping, "diagnostics": Mapping}
    for name, expected in kinds.items():
        if not isinstance(getattr(plan, name), expected) or not all(isinstance(phase, str) for phase in plan.phases):
            raise InputError(f"its {name} are {shown(getattr(plan, name))}")
    shapes = {
        "carriers.s": (samples, carriers),
        "tau": (samples, actuators),
        "actuated_rate": (samples, actuators),
        "carrier_force": (samples, carriers),
        "residual": (samples,),
        "margin": (samples,),
        "condition": (samples,),
        "between.peak": (actuators,),
        "between.time": (actuators,),
        "between.force_peak": (carriers,),
    }
    judged = plan.limits.judged_by
    for key, quantity in QUANTITIES.items():
        if key in judged.further or hasattr(judged, key):
            ends = (2,) if key == "track" else ()
            shape = (actuators if quantity.owner == "actuated" else carriers, *ends)
            _require_array(f"limits.judged_by.{key}", judged.of(key), "f", shape)
    for key in judged.further:
        if key not in QUANTITIES:
            raise InputError(
                f"it limits {shown(key)}, which is not in planners.limits.QUANTITIES (add it before loading)"
            )
    for name, shape in shapes.items():
        _require_array(name, attrgetter(name)(plan), "f", shape)
    for name in ("sample_status", "phase"):
        _require_array(name, getattr(plan, name), "i", (samples,))
    for count in (len(plan.robot.carrier_limits), len(plan.limits.judged_by.names)):
        if count != carriers:
            raise InputError(f"it has limits of {count} carriers, but {carriers} carriers")
    unbounded = ~np.isfinite(plan.tau).all(axis=1)
    if unbounded.any() and plan.status is not ResultStatus.UNBOUNDED:
        t = float(plan.t[unbounded][0])
        raise InputError(f"its status is {plan.status.value}, but it has no finite efforts at t = {t:.6g} s")
    _require_codes("phase", plan.phase, range(len(plan.phases)))
    _require_codes("sample_status", plan.sample_status, [int(status) for status in SampleStatus])


def _require_array(name: str, value: NDArray[Any], kind: str, shape: tuple[int, ...]) -> None:
    if not isinstance(value, np.ndarray) or value.dtype.kind != kind or value.dtype.itemsize != 8:
        actual = f"array of {value.dtype}" if isinstance(value, np.ndarray) else type(value).__name__
        raise InputError(f"{name} is an {actual}, expected one of 8-byte {'floats' if kind == 'f' else 'integers'}")
    if value.shape != shape:
        raise InputError(f"{name} has shape {value.shape}, but the rest of the plan needs {shape}")


def _require_codes(name: str, codes: NDArray[Any], known: Sequence[int]) -> None:
    foreign = codes[~np.isin(codes, list(known))]
    if len(foreign):
        raise InputError(f"{name} holds {int(foreign[0])}, which is not defined (known: 0 to {len(known) - 1})")
