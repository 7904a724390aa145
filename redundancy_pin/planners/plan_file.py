"""Plans in files: written without loss, read back with every inconsistency refused."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from redundancy_pin.dynamics.distribution import SampleStatus
from redundancy_pin.errors import InputError
from redundancy_pin.io.archive import read_archive
from redundancy_pin.motion import CarrierMotion, PlatformMotion
from redundancy_pin.planners.functions import PlanFunctions
from redundancy_pin.planners.limits import LimitEvent, LimitReport
from redundancy_pin.planners.plan import PLAN_FORMAT, PLAN_VERSION, Plan, PlanStatus
from redundancy_pin.planners.robot_record import load_recorded, read_robot
from redundancy_pin.robot import CarrierLimits, Robot
from redundancy_pin.trajectory.functions_of_time import ContinuousMotion, PiecewisePolynomial

_T = TypeVar("_T")


def save_plan(plan: Plan, path: str | Path) -> None:
    """Write a plan to a file without loss: an npz archive with JSON inside.

    Arrays are stored bit by bit; status, limits, robot, parameters and diagnostics as JSON text in the array
    ``metadata``, with the version of the format and of the package.

    Raises:
        OutputError: the file cannot be written; an earlier one is as it was.
        InputError: ``parameters`` or ``diagnostics`` hold something that is not plain data.
    """
    plan.save(path)


def load_plan(path: str | Path) -> Plan:
    """Read a plan that was saved with ``save_plan`` or ``Plan.save``. Nothing in the file is executed.

    Raises:
        PlanFileError: the file is missing, truncated, damaged, no plan, of a newer format, or its arrays do not fit
            together.
    """
    return read_archive(path, PLAN_FORMAT, PLAN_VERSION, "plan", _plan)


def load_robot_of(plan: Plan, source: str | Path | None = None) -> Robot:
    """Load the robot a plan was made for, with the arguments, gravity and working mode it had.

    Args:
        plan: the plan.
        source: where the robot is now (as for ``load_robot``), if its files have moved.

    Raises:
        PlanFileError: the robot's files are gone, or describe another robot than when the plan was made.
    """
    return load_recorded(plan.robot, source)


def _plan(record: Mapping[str, Any]) -> Plan:
    """Return the plan of a record, checked."""
    values = _values(Plan, {"functions": None, **record})  # files of version 1 have no functions of time
    limits = _values(LimitReport, values["limits"])
    values["motion"] = _make(PlatformMotion, values["motion"])
    values["carriers"] = _make(CarrierMotion, values["carriers"])
    values["limits"] = LimitReport(
        violated=tuple(_make(LimitEvent, event) for event in limits["violated"]),
        binding=tuple(_make(LimitEvent, event) for event in limits["binding"]),
        judged_by=tuple(_make(CarrierLimits, entry) for entry in limits["judged_by"]),
    )
    values["status"] = PlanStatus(values["status"])
    values["robot"] = read_robot(values["robot"])
    if values["functions"] is not None:
        values["functions"] = _functions(values["functions"])
    plan = Plan(**values)
    _check(plan)
    return plan


def _functions(record: Mapping[str, Any]) -> PlanFunctions:
    platform = _values(ContinuousMotion, record["platform"])
    preferred = record["preferred"]
    return PlanFunctions(
        platform=ContinuousMotion(**{**platform, "source": _polynomial(platform["source"])}),
        carriers=_polynomial(record["carriers"]),
        prescribed=tuple(_polynomial(part) for part in record["prescribed"]),
        preferred=None if preferred is None else _polynomial(preferred),
    )


def _polynomial(record: Mapping[str, Any]) -> PiecewisePolynomial:
    function = PiecewisePolynomial(**record)
    _require_array("functions, edges", function.edges, "f", (function.coefficients.shape[1] + 1,))
    _require_array("functions, coefficients", function.coefficients, "f", function.coefficients.shape)
    if function.coefficients.ndim != 3 or not (np.diff(function.edges) > 0.0).all():
        raise InputError("functions hold polynomials whose pieces do not follow each other")
    return function


def _values(kind: type[Any], record: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values of all fields of a dataclass."""
    return {field.name: record[field.name] for field in fields(kind)}


def _make(kind: Callable[..., _T], record: Mapping[str, Any]) -> _T:
    return kind(**record)


def _check(plan: Plan) -> None:
    """Check that the arrays of a plan fit together and that its codes mean something."""
    samples, actuators, carriers = len(plan.motion), len(plan.robot.actuated), len(plan.robot.carriers)
    for name, value, kind, shape in (
        ("carriers.s", plan.carriers.s, "f", (samples, carriers)),
        ("tau", plan.tau, "f", (samples, actuators)),
        ("carrier_force", plan.carrier_force, "f", (samples, carriers)),
        ("actuated_rate", plan.actuated_rate, "f", (samples, actuators)),
        ("sample_status", plan.sample_status, "i", (samples,)),
        ("residual", plan.residual, "f", (samples,)),
        ("margin", plan.margin, "f", (samples,)),
        ("condition", plan.condition, "f", (samples,)),
        ("phase", plan.phase, "i", (samples,)),
    ):
        _require_array(name, value, kind, shape)
    for entries in (plan.robot.carrier_limits, plan.limits.judged_by):
        if len(entries) != carriers:
            raise InputError(f"it has limits of {len(entries)} carriers, but {carriers} carriers")
    _require_codes("phase", plan.phase, range(len(plan.phases)))
    _require_codes("sample_status", plan.sample_status, [int(status) for status in SampleStatus])


def _require_array(name: str, value: NDArray[Any], kind: str, shape: tuple[int, ...]) -> None:
    if not isinstance(value, np.ndarray) or value.dtype.kind != kind or value.dtype.itemsize != 8:
        found = f"array of {value.dtype}" if isinstance(value, np.ndarray) else type(value).__name__
        raise InputError(f"{name} is an {found}, expected one of 8-byte {'floats' if kind == 'f' else 'integers'}")
    if value.shape != shape:
        raise InputError(f"{name} has shape {value.shape}, but the rest of the plan needs {shape}")


def _require_codes(name: str, codes: NDArray[Any], known: Sequence[int]) -> None:
    foreign = codes[~np.isin(codes, list(known))]
    if len(foreign):
        raise InputError(f"{name} holds {int(foreign[0])}, which stands for nothing (known: 0 to {len(known) - 1})")
