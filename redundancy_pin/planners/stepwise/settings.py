"""The limits a stepwise plan keeps, and the box they leave for the carriers' accelerations in one step."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, TypeGuard, cast, get_args

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array, checked, frozen, positive
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.dynamics.distribution import distribute
from redundancy_pin.errors import InfeasiblePlanError, InputError
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.planners.carrier_return import stoppable_speed
from redundancy_pin.robot import Robot
from redundancy_pin.robot.types import CarrierLimits

_EMPTY = 1e-9
"""A box that is empty by less than this fraction of the accelerations involved is one point: a limit that is met
exactly leaves a rounding error."""


@dataclass(frozen=True)
class StepLimits:
    """What the carriers must keep to at every step.

    Attributes:
        carriers: (k,) names.
        limits: (k,) track, speed, acceleration and force of each; the planner keeps to the first three.
        anticipate: whether a carrier is kept able to stop before the end of its track.
        rest_at: time by which all must be at rest, s; infinite for none.
    """

    carriers: tuple[str, ...]
    limits: tuple[CarrierLimits, ...]
    anticipate: bool
    rest_at: float
    _bounds: tuple[tuple[float, float, float, float], ...] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        # plain tuples: the box is asked for at every step
        bounds = tuple((limit.lower, limit.upper, limit.speed, limit.acceleration) for limit in self.limits)
        object.__setattr__(self, "_bounds", bounds)

    def box(self, t: float, step: float, s: Sequence[float], sd: Sequence[float]) -> tuple[list[float], list[float]]:
        """Return the smallest and largest s̈ of each carrier in a step (Parsa 2014, eqs. 4.2 to 4.4).

        With backward differences ṡ' = ṡ + h s̈ and s' = s + h ṡ' the limits of the track, the speed and the
        acceleration are one box. Two more bounds may narrow it: a carrier must be able to stop before its track ends
        (``anticipate``) and by the time ``rest_at``. Both give way to the largest deceleration, so they never empty it.

        Args:
            t: time at the end of the step, s.
            step: length h of the step, s.
            s: (k,) positions before the step, m.
            sd: (k,) speeds before the step, m/s.

        Raises:
            InfeasiblePlanError: the limits leave nothing; names the carrier, the time and the amount.
        """
        lower, upper = [], []
        for j, (first, last, fastest, a) in enumerate(self._bounds):
            position, speed = s[j], sd[j]
            reach = a * step
            least, most = max(speed - reach, -fastest), min(speed + reach, fastest)
            behind, ahead = position - first, last - position
            if most * step > ahead:
                most = ahead / step
            if -least * step > behind:
                least = -behind / step
            if self.anticipate:
                if most > 0.0 and (step + 0.5 * most / a) * most > ahead:
                    most = min(most, max(stoppable_speed(ahead, step, a), speed - reach))
                if least < 0.0 and (step - 0.5 * least / a) * -least > behind:
                    least = max(least, min(-stoppable_speed(behind, step, a), speed + reach))
            if self.rest_at < math.inf:
                left = a * max(self.rest_at - t, 0.0)
                most = min(most, max(left, speed - reach))
                least = max(least, min(-left, speed + reach))
            low, high = max((least - speed) / step, -a), min((most - speed) / step, a)
            if low > high:
                low = high = self._single(j, t, step, position, speed, low, high)
            lower.append(low)
            upper.append(high)
        return lower, upper

    def _single(self, j: int, t: float, step: float, s: float, sd: float, lower: float, upper: float) -> float:
        """Return the one acceleration left where rounding emptied the box.

        Raises:
            InfeasiblePlanError: it is empty by more than rounding.
        """
        bounds = self.limits[j]
        if lower - upper <= _EMPTY * (abs(lower) + abs(upper)):
            return min(max(0.5 * (lower + upper), -bounds.acceleration), bounds.acceleration)
        a = bounds.acceleration
        braked = sd - math.copysign(min(abs(sd), a * step), sd)
        reached = s + step * braked
        beyond = max(reached - bounds.upper, bounds.lower - reached)
        excess = abs(braked) - bounds.speed
        if beyond > excess:
            what, amount, unit = "track", float(beyond), "m"
            text = f"braked by {a:g} m/s² it would still be {beyond:.3g} m beyond the end of its track"
        else:
            what, amount, unit = "speed", float(excess), "m/s"
            text = f"braked by {a:g} m/s² it would still be {excess:.3g} m/s above its speed limit"
        raise InfeasiblePlanError(
            f"{self.carriers[j]} cannot keep its limits at t = {t:.6g} s: it arrives at s = {s:.6g} m with "
            f"{sd:.6g} m/s, and {text}.",
            remedy="Use anticipate=True, a larger lam, higher limits, or a gentler motion.",
            constraint=what,
            carrier=self.carriers[j],
            time=t,
            amount=amount,
            unit=unit,
        )


def resolve_limits(
    robot: Robot, speed: ArrayLike | None, acceleration: ArrayLike | None, track: ArrayLike | None
) -> tuple[CarrierLimits, ...]:
    """Return the robot's carrier limits with those given in their place.

    Args:
        robot: the robot.
        speed: scalar or (k,) largest |ṡ|, m/s, or None for the robot's own.
        acceleration: scalar or (k,) largest |s̈|, m/s², or None.
        track: (2,) or (k, 2) ends of the tracks, m, or None.

    Raises:
        InputError: a limit that is not positive, a track whose ends are not in order, wrong shapes.
    """
    k = robot.k
    limits = list(robot.carrier_limits)
    for name, given in (("speed", speed), ("acceleration", acceleration)):
        if given is None:
            continue
        values = _each(given, name, (k,))
        if not (values > 0.0).all():
            raise InputError(
                f"{name} is {typed(given)}, but limits must be positive.",
                remedy="Pass inf for no limit.",
                name=name,
                value=given,
            )
        limits = [replace(limit, **{name: float(value)}) for limit, value in zip(limits, values, strict=True)]
    if track is not None:
        ends = _each(track, "track", (k, 2))
        if not (ends[:, 0] < ends[:, 1]).all():
            raise InputError(
                f"track is {typed(track)}, but the ends of a track must increase.",
                remedy="Give the lower end first.",
                value=track,
            )
        limits = [replace(limit, lower=float(a), upper=float(b)) for limit, (a, b) in zip(limits, ends, strict=True)]
    return tuple(limits)


def _each(given: ArrayLike, name: str, shape: tuple[int, ...]) -> Array:
    try:
        values = np.broadcast_to(np.asarray(given, dtype=float), shape)
    except (TypeError, ValueError) as error:
        rows = f"two ends, or two for each of {shape[0]} carriers" if len(shape) == 2 else f"{shape[0]} numbers or one"
        raise InputError(f"{name} is {typed(given)!r}, expected {rows}.", name=name) from error
    if np.isnan(values).any():
        raise InputError(f"{name} contains NaN.", name=name)
    return values


def typed(values: ArrayLike) -> object:
    """Return numbers as they are typed, for messages: the command line hands over arrays."""
    return values.tolist() if isinstance(values, np.ndarray) else values


def require_inside(values: ArrayLike, name: str, robot_limits: StepLimits) -> Array:
    """Return (k,) positions on the tracks.

    Raises:
        InputError: wrong shape.
        InfeasiblePlanError: a position off its track.
    """
    k = len(robot_limits.carriers)
    places = np.array(_each(values, name, (k,)))
    for carrier, limit, place in zip(robot_limits.carriers, robot_limits.limits, places, strict=True):
        beyond = max(place - limit.upper, limit.lower - place)
        if not beyond <= 0.0:
            raise InfeasiblePlanError(
                f"{name} puts {carrier} at {place:g} m, {beyond:.3g} m off its track "
                f"[{limit.lower:g}, {limit.upper:g}] m.",
                remedy="Choose a place on the track.",
                constraint="track",
                carrier=carrier,
                time=0.0,
                amount=float(beyond),
            )
    return places


Active = Literal["always", "accelerating"]
"""When the optimiser works: at every step, or only while the platform accelerates."""

Stop = Literal["after", "within"]
"""When the carriers are brought to rest: after the motion, with the platform held, or by its last sample."""


@dataclass(frozen=True, eq=False)
class StepwiseSettings:
    """Settings of ``plan_stepwise``; see there.

    Attributes:
        lam: fraction of the baseline effort to aim at.
        active: when the optimiser works.
        limits: limits of the carriers.
        start, datum: (k,) positions, m.
        return_time: s, or "shortest".
        stop: when the carriers are brought to rest.
        brake_time: s.
        least_margin: smallest accepted margin of W.
        between: points between two samples at which the plan is checked.
    """

    lam: float
    active: Active
    limits: StepLimits
    start: Array
    datum: Array
    return_time: float | Literal["shortest"]
    stop: Stop
    brake_time: float
    least_margin: float
    between: int

    @property
    def parameters(self) -> dict[str, object]:
        """The settings as plain data, for the plan."""
        limits = self.limits.limits
        return {
            "lam": self.lam,
            "active": self.active,
            "start": tuple(self.start.tolist()),
            "datum": tuple(self.datum.tolist()),
            "speed": tuple(limit.speed for limit in limits),
            "acceleration": tuple(limit.acceleration for limit in limits),
            "track": tuple((limit.lower, limit.upper) for limit in limits),
            "anticipate": self.limits.anticipate,
            "return_time": self.return_time,
            "stop": self.stop,
            "brake_time": self.brake_time,
            "least_margin": self.least_margin,
            "between": self.between,
        }


def checked_settings(
    robot: Robot,
    motion: PlatformMotion,
    *,
    lam: float,
    active: Active,
    start: ArrayLike,
    datum: ArrayLike,
    return_time: float | Literal["shortest"],
    stop: Stop,
    brake_time: float,
    anticipate: bool,
    speed: ArrayLike | None,
    acceleration: ArrayLike | None,
    track: ArrayLike | None,
    least_margin: float,
    between: int,
) -> StepwiseSettings:
    """Return the settings of ``plan_stepwise`` after checking every one.

    Raises:
        InputError: a setting out of its domain; names it.
        InfeasiblePlanError: a start or datum off the track.
    """
    fraction = _number(lam, "lam")
    if not 0.0 <= fraction <= 1.0:
        raise InputError(f"lam is {fraction:g}, expected a number in [0, 1].", name="lam", value=fraction)
    _one_of(active, "active", get_args(Active))
    _one_of(stop, "stop", get_args(Stop))
    if isinstance(return_time, str):
        _one_of(return_time, "return_time", ("shortest",))
    else:
        return_time = positive(return_time, "return_time", "s")
    if len(motion) < 2 or not motion.t[-1] > motion.t[0]:
        raise InputError("The motion has a single instant.", remedy="Pass a motion of at least two instants.")
    if isinstance(between, bool) or not isinstance(between, int) or between < 0:
        raise InputError(f"between is {between}, expected 0 or a positive whole number.", name="between")
    rest_at = float(motion.t[-1]) if stop == "within" else math.inf
    resolved = resolve_limits(robot, speed, acceleration, track)
    if not isinstance(anticipate, bool):
        raise InputError(f"anticipate is {anticipate!r}, expected True or False.", name="anticipate")
    limits = StepLimits(robot.carriers, resolved, anticipate, rest_at)
    if stop == "within" and any(math.isinf(limit.acceleration) for limit in resolved):
        raise InputError(
            'stop="within" needs acceleration limits: without them nothing says when to brake.',
            remedy='Declare or pass acceleration limits, or use stop="after".',
        )
    return StepwiseSettings(
        fraction,
        active,
        limits,
        frozen(require_inside(start, "start", limits)),
        frozen(require_inside(datum, "datum", limits)),
        return_time,
        stop,
        positive(brake_time, "brake_time", "s"),
        positive(least_margin, "least_margin", ""),
        int(between),
    )


def target_effort(
    robot: Robot, motion: PlatformMotion, lam: float, baseline: Dynamics | ArrayLike | None
) -> tuple[Array, Array | None]:
    """Return (N, m) λ τ̂, and τ̂ itself where there is a baseline.

    Raises:
        InputError: λ > 0 without a baseline, or one that does not fit the robot or the motion.
        InfeasiblePlanError: the baseline has no finite efforts somewhere.
    """
    shape = (len(motion), robot.m)
    if baseline is None:
        if lam > 0.0:
            raise InputError(
                f"lam = {lam:g} asks for a fraction of the baseline effort, and there is no baseline.",
                remedy='Pass baseline=VirtualWork(load_robot("3rrr", carriers=False)) or an array (N, m).',
            )
        return np.zeros(shape), None
    if is_dynamics(baseline):
        other = baseline.robot
        if (other.n, other.m) != (robot.n, robot.m):
            raise InputError(
                f"The baseline robot has n, m = {other.n}, {other.m}; {robot.name} has {robot.n}, {robot.m}.",
                remedy="Pass the same mechanism without carriers.",
            )
        tau = distribute(baseline.reduce(motion)).tau
        bad = np.flatnonzero(~np.isfinite(tau).all(axis=1))
        if len(bad):
            raise InfeasiblePlanError(
                f"The baseline robot has no finite efforts at t = {motion.t[bad[0]]:.6g} s.",
                remedy="Use lam = 0, which needs no baseline.",
                constraint="baseline",
                time=float(motion.t[bad[0]]),
            )
    else:
        tau = checked(cast(ArrayLike, baseline), "baseline", shape)
    return lam * tau, tau


def is_dynamics(baseline: Dynamics | ArrayLike) -> TypeGuard[Dynamics]:
    """Return whether a baseline is a backend, rather than efforts."""
    return isinstance(getattr(baseline, "robot", None), Robot)


def _number(value: float, name: str) -> float:
    try:
        return float(value)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} is {value!r}, expected a number.", name=name) from error


def _one_of(value: object, name: str, allowed: tuple[str, ...]) -> None:
    if value not in allowed:
        raise InputError(f"{name} is {value!r}.", remedy=f"Use one of {', '.join(allowed)}.", name=name, value=value)
