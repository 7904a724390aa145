"""What is watched for while a machine moves: ends of tracks and joints, stretched legs, lost control."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from redundancy_pin.arrays import Array, BoolArray
from redundancy_pin.errors import InputError
from redundancy_pin.kinematics.coordinates import velocity_scale
from redundancy_pin.kinematics.modes import ModeIndicator
from redundancy_pin.robot import Robot
from redundancy_pin.simulation.chain import ClosedChain

KINDS = ("track", "joint_limit", "type_I", "type_II")
"""A carrier at an end of its track; another joint at its limit; a leg at full stretch or folded, where the platform
velocity does not determine the joints; actuators that do not hold the platform."""

ONE_SIDED = ("track", "joint_limit")
"""Kinds that stand for a stop: only leaving the allowed side counts."""


@dataclass(frozen=True)
class Event:
    """Something that happened during a simulation.

    Attributes:
        kind: one of ``KINDS``.
        name: which one: "carrier_1 upper", "leg 2", or the kind itself.
        t: time, s, found as a root on the integrator's own interpolant.
        terminal: whether the simulation stopped there.
    """

    kind: str
    name: str
    t: float
    terminal: bool


@dataclass(frozen=True)
class Watch:
    """One scalar function whose sign is watched.

    Attributes:
        kind, name: see ``Event``.
        terminal: whether the simulation stops at it.
    """

    kind: str
    name: str
    terminal: bool


class Watcher:
    """The watched functions of a robot, positive or negative but zero at an event.

    Args:
        chain: evaluator of the robot.
        stop_at: kinds at which the simulation stops.

    Raises:
        InputError: an unknown kind.
    """

    def __init__(self, chain: ClosedChain, stop_at: tuple[str, ...]) -> None:
        unknown = [kind for kind in stop_at if kind not in KINDS]
        if unknown:
            raise InputError(f"stop_at names {unknown[0]!r}.", remedy=f"Known kinds: {', '.join(KINDS)}.")
        self.chain = chain
        self._limits = _limits(chain.robot)
        self._index = np.array([index for _, _, index, _, _, _ in self._limits], dtype=np.intp)
        self._rate_index = chain.model.nq + np.array([index for _, _, _, index, _, _ in self._limits], dtype=np.intp)
        self._side = np.array([side for _, _, _, _, side, _ in self._limits])
        self._bound = np.array([bound for _, _, _, _, _, bound in self._limits])
        robot = chain.robot
        legs = 0 if robot.working_modes is None else len(robot.working_modes.joints)
        self._by_legs = legs > 0
        self._indicator = ModeIndicator(robot)
        self._square = robot.m == robot.n
        type_one = [f"leg {i + 1}" for i in range(legs)] if legs else ["type_I"]
        kinds = [(kind, name) for kind, name, *_ in self._limits] + [("type_I", name) for name in type_one]
        kinds += [("type_II", "type_II")] if self._square else []
        self.watches = tuple(Watch(kind, name, kind in stop_at) for kind, name in kinds)
        self._one_sided = np.array([watch.kind in ONE_SIDED for watch in self.watches])
        self._scale = 1.0 / velocity_scale(robot)[chain.pose_columns]
        actuated = np.zeros((robot.m, robot.model.nv))
        actuated[np.arange(robot.m), robot.actuated_velocity] = 1.0
        self._actuated = actuated[:, chain.pose_columns]
        self._still = np.zeros(robot.model.nv)

    def values(self, q: Array) -> Array:
        """Return (w,) the watched functions at a configuration (nq,)."""
        found: Array = self.values_at(q[None])[0]
        return found

    def values_at(self, q: Array) -> Array:
        """Return (N, w) the watched functions at (N, nq) configurations, which takes less time than one by one."""
        chain = self.chain
        columns = chain.pose_columns
        closures = chain.jacobians(q).take(columns, 2)
        parts = [self._side * (self._bound - q.take(self._index, 1))]
        if self._by_legs:
            parts.append(self._indicator(q))
        else:
            parts.append(self._determinants(closures, np.array([self._platform_rows(one) for one in q])))
        if self._square:
            parts.append(self._determinants(closures, self._actuated))
        return np.concatenate(parts, axis=1)

    def _platform_rows(self, q: Array) -> Array:
        self.chain.update(q, self._still)
        return self.chain.platform_jacobian()[:, self.chain.pose_columns]

    def _determinants(self, closures: Array, rows: Array) -> Array:
        """Return (N, 1) the determinants of closure rows (N, r, p) over p − r further rows, N times or once for all."""
        count, held, width = closures.shape
        stacked = np.empty((count, width, width))
        stacked[:, :held], stacked[:, held:] = closures, rows
        stacked *= self._scale
        found: Array = np.linalg.det(stacked)[:, None]
        return found

    def at_start(self, q: Array) -> Array:
        """Return ``values`` at the start, rounding taken for zero.

        A machine that starts at a stop, as a run that stopped there leaves it, then stops again if it goes on outward,
        whichever way its position was rounded; and one that starts at a singular pose has not come to it.
        """
        values = self.values(q)
        values[np.abs(values) <= _ROUNDING] = 0.0
        return values

    def stops(self, y: Array) -> tuple[Array, Array]:
        """Return the distances (N, l) that are left to the stops, the first l of ``values``, and their rates.

        Args:
            y: (N, nq + nv) configurations and velocities.
        """
        rates: Array = -self._side * y.take(self._rate_index, 1)
        return self._side * (self._bound - y.take(self._index, 1)), rates

    def crossed(self, before: Array, after: Array) -> list[int]:
        """Return the indices of the functions that changed sign, or came to zero, between two points of time.

        A stop is passed where its function turns negative; leaving zero is an event for stops only.
        """
        return [int(i) for i in np.flatnonzero(self._crossing(before, after))]

    def any_crossed(self, before: Array, after: Array) -> bool:
        """Return whether ``crossed`` finds any in N pairs of points of time, (N, w) each."""
        if (before * after > 0.0).all():  # nearly always, and quickly said
            return False
        return bool(self._crossing(before, after).any())

    def _crossing(self, before: Array, after: Array) -> BoolArray:
        leaves = (before >= 0.0) & (after < 0.0)
        swaps = ((before > 0.0) & (after <= 0.0)) | ((before < 0.0) & (after >= 0.0))
        return np.where(self._one_sided, leaves, swaps)

    def require_allowed(self, q: Array) -> None:
        """Check that no stop at which the simulation ends has been passed at its start.

        Raises:
            InputError: a carrier off its track, or a joint beyond its limit.
        """
        values = self.values(q)
        for watch, value in zip(self.watches, values, strict=True):
            if watch.kind in ONE_SIDED and watch.terminal and value < -_ROUNDING:
                raise InputError(
                    f"The simulation starts {-value:.3g} beyond the limit {watch.name!r}.",
                    remedy="Start within the limits, or leave the kind out of stop_at.",
                    event=watch.name,
                    amount=float(-value),
                )


_ROUNDING = 1e-12
"""A carrier that starts at the very end of its track may overshoot it by rounding, m."""


def _limits(robot: Robot) -> list[tuple[str, str, int, int, float, float]]:
    """Return kind, name, indices in q and v, side and bound of every finite limit of a joint of one number."""
    found = []
    tracks = {
        int(position): (name, limits.lower, limits.upper)
        for position, name, limits in zip(robot.carrier_position, robot.carriers, robot.carrier_limits, strict=True)
    }
    model = robot.model
    for j in range(1, model.njoints):
        joint = model.joints[j]
        if joint.nq != 1:
            continue
        i = int(joint.idx_q)
        lower, upper = float(model.lowerPositionLimit[i]), float(model.upperPositionLimit[i])
        kind, name = "joint_limit", str(model.names[j])
        if i in tracks:
            kind, (name, lower, upper) = "track", tracks[i]
        for side, bound, which in ((-1.0, lower, "lower"), (1.0, upper, "upper")):
            if np.isfinite(bound) and abs(bound) < _UNLIMITED:
                found.append((kind, f"{name} {which}", i, int(joint.idx_v), side, bound))
    return found


_UNLIMITED = 1e6
"""rad or m; URDF writers put large numbers where there is no limit."""
