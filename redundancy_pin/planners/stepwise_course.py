"""The carriers' whole course: stretches of the optimiser, returns to the datum, braking."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from redundancy_pin.arrays import Array, BoolArray, IntArray
from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.motion import CarrierMotion
from redundancy_pin.planners.carrier_return import CarrierState, return_polynomial, shortest_return
from redundancy_pin.planners.stepwise_march import StepProblems, Stretch, optimise
from redundancy_pin.planners.stepwise_settings import StepwiseSettings
from redundancy_pin.robot import Robot

PHASES = ("parked", "optimise", "return", "brake")
"""What the carriers do: stand, follow the optimiser, follow the degree-seven polynomial, are braked."""

PARKED, OPTIMISE, RETURN, BRAKE = range(4)


@dataclass(frozen=True, eq=False)
class Course:
    """The carriers at J + 1 instants.

    Attributes:
        t: (J + 1,) instants, s.
        s, sd, sdd: (J + 1, k) their motion; while they are optimised or braked ṡ and s̈ are the backward differences
            of s and ṡ, on a return the derivatives of its polynomial.
        phase: (J + 1,) index into ``PHASES``: what the step that ends there was.
        stretches: first step and result of each run of the optimiser.
        returns: start and end of each return, s; the end is that of its polynomial.
        between: for each return, times densely along it, s, and the motion there: its extremes lie between the steps.
        brake_from: instant from which the carriers are only braked; the motion is not filled in after it.
    """

    t: Array
    s: Array
    sd: Array
    sdd: Array
    phase: IntArray
    stretches: list[tuple[int, Stretch]] = field(default_factory=list)
    returns: list[tuple[float, float]] = field(default_factory=list)
    between: list[tuple[Array, CarrierMotion]] = field(default_factory=list)
    brake_from: int = -1


def run_course(
    robot: Robot, settings: StepwiseSettings, problems: StepProblems, active: BoolArray, at_rest: BoolArray
) -> Course:
    """Plan the carriers from the first instant to the last, but for the braking.

    Args:
        robot: the robot.
        settings: of the planner.
        problems: the prepared steps, J of them.
        active: (J,) whether the optimiser decides a step.
        at_rest: (J,) whether the platform rests at the end of a step.

    Raises:
        InfeasiblePlanError: the box of a step is empty, or no return keeps the limits.
    """
    t = problems.t
    shape = (len(t), robot.k)
    s, sd, sdd = (np.zeros(shape) for _ in range(3))
    s[0] = settings.start
    course = Course(t, s, sd, sdd, np.full(len(t), PARKED, dtype=np.intp))
    edges = np.flatnonzero(np.diff(active)) + 1
    runs = list(zip([0, *edges], [*edges, len(active)], strict=True))
    for first, last in runs:
        steps = slice(first + 1, last + 1)
        if active[first]:
            state = CarrierState(float(t[first]), s[first], sd[first], sdd[first])
            found = optimise(problems, int(first), int(last), state, settings.limits)
            s[steps], sd[steps], sdd[steps] = found.s, found.sd, found.sdd
            course.phase[steps] = OPTIMISE
            course.stretches.append((int(first), found))
        elif first == 0:
            s[steps] = settings.start
        elif last == len(active) and at_rest[first:last].all():
            return replace(course, brake_from=int(first))
        else:
            _follow_return(robot, settings, course, int(first), int(last))
    return replace(course, brake_from=len(active))


def _follow_return(robot: Robot, settings: StepwiseSettings, course: Course, first: int, last: int) -> None:
    """Fill in the way back to the datum from instant ``first``, as far as instant ``last``."""
    state = CarrierState(float(course.t[first]), course.s[first], course.sd[first], course.sdd[first])
    duration = _return_duration(robot, settings, state, float(course.t[-1]))
    polynomial = return_polynomial(state, duration, settings.datum)
    steps = np.arange(first + 1, last + 1)
    on_way = steps[course.t[steps] < polynomial.t1]
    for order, part in enumerate((course.s, course.sd, course.sdd)):
        part[on_way] = polynomial(course.t[on_way], order)
    arrived = steps[len(on_way) :]
    course.s[arrived] = settings.datum
    course.phase[on_way] = RETURN
    course.returns.append((state.t, polynomial.t1))
    dense = np.linspace(state.t, min(polynomial.t1, float(course.t[last])), _DENSE)
    course.between.append((dense, CarrierMotion(*(polynomial(dense, order) for order in range(3)))))


_DENSE = 2001
"""Points along a return at which its limits are judged: a peak of a polynomial of degree seven is missed by 1e-6."""


def _return_duration(robot: Robot, settings: StepwiseSettings, state: CarrierState, end: float) -> float:
    if settings.return_time != "shortest":
        return settings.return_time
    limited = replace(robot, carrier_limits=settings.limits.limits)

    def no_force(times: Array, *_: Array) -> Array:
        return np.zeros((len(times), robot.k))

    duration, use = shortest_return(limited, no_force, state, settings.datum, end - state.t)
    if duration is None:
        raise InfeasiblePlanError(
            f"No return of the carriers from t = {state.t:.6g} s keeps their limits: the best one breaks the "
            f"{use.quantity} limit {use.limit:g} of {use.carrier} by {use.amount:.4g} at t = {use.t:.6g} s.",
            remedy="Use a larger lam, higher limits, or a return_time and accept a plan that violates limits.",
            constraint=use.quantity,
            carrier=use.carrier,
            time=use.t,
            amount=use.amount,
        )
    return duration
