"""One crossing with the main actuators off: ramp-down, off, return."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.motion import CarrierMotion
from redundancy_pin.planners.carrier_equation import CarrierEquation, StepGivenUpError
from redundancy_pin.planners.carrier_path import CarrierPath
from redundancy_pin.planners.carrier_return import CarrierState
from redundancy_pin.planners.continuous_motion import ContinuousMotion
from redundancy_pin.planners.dips import Interval
from redundancy_pin.planners.ramp_down import RampDown, ramp_down
from redundancy_pin.planners.singular_carriers import LostDirection, lost_directions, nothing_carries, require_balanced
from redundancy_pin.planners.timed_model import TimedModel
from redundancy_pin.trajectory import Side


class CarriersOverTime(Protocol):
    """Carrier motion from a start to an end, at any time or at the samples it has."""

    @property
    def start(self) -> float:
        """First time, s."""

    @property
    def end(self) -> float:
        """Last time, s."""

    def __call__(self, times: Array, side: Side = "right") -> CarrierMotion:
        """Return the motion at (N,) times."""

    def peaks(self) -> Array:
        """Return the inner times, s, at which some s, ṡ or s̈ is largest or smallest."""


@dataclass(frozen=True, eq=False)
class Crossing:
    """Carriers and efforts from the start of a ramp-down to the switch-on.

    Attributes:
        window: when the actuators are off.
        ramp: the main efforts.
        path: the carriers, continuous in time or as samples.
        lost: instants at which the carriers cannot act in some direction.
    """

    window: Interval
    ramp: RampDown
    path: CarriersOverTime
    lost: tuple[LostDirection, ...]

    @property
    def exit(self) -> CarrierState:
        """The carriers at switch-on."""
        end = self.path.end
        motion = self.path(np.array([end]))
        return CarrierState(end, *(np.array(part[0]) for part in (motion.s, motion.sd, motion.sdd)))


def cross(
    dynamics: Dynamics, motion: ContinuousMotion, window: Interval, ramp_time: float, datum: Array, row_scale: Array
) -> Crossing:
    """Integrate the carriers through one window (steps 3 and 4 of Parsa 2014, section 3.1; eqs 3.5 and 3.6).

    Raises:
        InfeasiblePlanError: a force that nothing can carry at the singular pose.
    """
    equation, lost = crossing_equation(dynamics, motion, window, window.start - ramp_time, datum, row_scale)
    start = equation.model.start
    zero = np.zeros_like(datum)
    try:
        down = equation.solve(start, window.start, datum, zero)
        at_entry = down(np.array([window.start]), "left")
        off = equation.solve(window.start, window.end, np.array(at_entry.s[0]), np.array(at_entry.sd[0]))
    except StepGivenUpError as stuck:
        raise _unbounded(equation, lost, stuck) from stuck
    path = CarrierPath(np.append(down.edges, off.edges[1:]), np.concatenate([down.series, off.series]))
    return Crossing(window, equation.effort, path, lost)


def crossing_equation(
    dynamics: Dynamics, motion: ContinuousMotion, window: Interval, start: float, datum: Array, row_scale: Array
) -> tuple[CarrierEquation, tuple[LostDirection, ...]]:
    """Return what the carriers have to satisfy from the start of the ramp-down to switch-on, and where they cannot act.

    Raises:
        InfeasiblePlanError: where they cannot act a force is left that no motion of the carriers changes.
    """
    ramp = ramp_down(dynamics, motion, start, window.start, datum)
    model = TimedModel.of(dynamics, motion, start, window.end)
    times = np.unique(np.concatenate([model.interpolant.edges, np.linspace(start, window.end, 201)]))
    here = model.at(times)
    load = np.einsum("nij,nj->ni", here.W, ramp(times))
    size = float(max(np.abs(here.f0 / row_scale).max(), np.abs(load / row_scale).max(), 1e-12))
    equation = CarrierEquation(model, ramp, row_scale, size)
    lost = tuple(lost_directions(equation, start, window.end))
    require_balanced(equation, lost)
    return equation, lost


_RUNAWAY = 100.0
"""Distance, m, beyond which a carrier has left every machine."""


def _unbounded(
    equation: CarrierEquation, lost: tuple[LostDirection, ...], stuck: StepGivenUpError
) -> InfeasiblePlanError:
    near = [instant for instant in lost if instant.t >= stuck.t]
    farthest = int(np.argmax(np.abs(stuck.s)))
    if abs(stuck.s[farthest]) > _RUNAWAY:
        # what is left of the equation there is rounding of huge terms, and says nothing
        return InfeasiblePlanError(
            f"Carrier {farthest + 1} runs away with the main actuators off: at t = {stuck.t:.6g} s it would be at "
            f"{stuck.s[farthest]:.3g} m with {stuck.sd[farthest]:.3g} m/s.",
            remedy="Shorten the window (a threshold nearer to the singularity), or park the carriers elsewhere.",
            constraint="carrier_motion",
            time=stuck.t,
            amount=float(abs(stuck.s[farthest])),
        )
    if near:
        ahead = near[0].t - stuck.t
        force = near[0].left(equation, stuck.s + ahead * stuck.sd, stuck.sd)
        return nothing_carries(near[0], force, f"brought there at s = {np.round(stuck.s, 4).tolist()} m")
    return InfeasiblePlanError(
        f"Past t = {stuck.t:.6g} s no bounded motion of the carriers balances the prescribed efforts: "
        f"{stuck.defect:.3g} N are left.",
        remedy="Shorten the window (a threshold nearer to the singularity) or slow down.",
        constraint="carrier_motion",
        time=stuck.t,
        amount=stuck.defect,
    )
