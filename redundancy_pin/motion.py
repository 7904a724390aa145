"""Sampled motions of the platform and of the carriers: what every computation takes as input."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple, NoReturn

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import (
    Array,
    BoolArray,
    Frozen,
    IntArray,
    assign,
    blocks,
    checked,
    largest,
    read_only,
    require_type,
)
from redundancy_pin.errors import InputError


@dataclass(frozen=True, init=False, eq=False, repr=False)
class PlatformMotion(Frozen):
    """Motion of the independent (platform) coordinates, sampled in time.

    Attributes:
        t: (N,) time, s. Strictly increasing, but for *two-sided samples*: where the acceleration
            jumps, the same instant appears twice, with equal ``x`` and ``xd`` and the acceleration
            before and after the jump.
        x: (N, n) platform coordinates in the base frame, m and rad; or (N, 4, 4) homogeneous poses of a
            spatial platform.
        xd: (N, n) their rate, m/s and rad/s; for a pose, the twist (linear, angular) in world-aligned
            axes at the platform origin.
        xdd: (N, n) its rate, m/s² and rad/s².

    Efforts, plans and crossings are not computed of a motion whose rates are not those of its positions
    (``require_consistent``): one in other units, or one that moves while ẋ is zero, would give numbers that look right.
    ``check_rates=False`` is the word of the caller that the samples need not be a motion (poses to stand still in,
    states that have nothing to do with one another); slices and copies keep it.

    Raises:
        InputError: wrong shapes, values that are not finite, time that does not increase.
    """

    t: Array
    x: Array
    xd: Array
    xdd: Array
    check_rates = True

    def __init__(self, t: ArrayLike, x: ArrayLike, xd: ArrayLike, xdd: ArrayLike, *, check_rates: bool = True) -> None:
        time = checked(t, "t", ("N",))
        rate = checked(xd, "xd", (len(time), "n"))
        is_pose = _dimensions(x) == 3
        position_shape = (len(time), 4, 4) if is_pose else (len(time), rate.shape[1])
        position = checked(x, "x", position_shape)
        acceleration = checked(xdd, "xdd", (len(time), rate.shape[1]))
        if len(time) == 0:
            raise InputError("The motion has no samples.", remedy="Pass at least one sample.")
        if is_pose:
            _require_poses(position)
        _require_increasing(time, position, rate)
        assign(self, t=time, x=position, xd=rate, xdd=acceleration, check_rates=bool(check_rates))

    def __repr__(self) -> str:
        """Return shape and times, not the arrays."""
        poses = ", poses" if self.is_pose else ""
        return f"PlatformMotion(N={len(self)}, n={self.xd.shape[1]}{poses}, t={self.t[0]:g}..{self.t[-1]:g} s)"

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.t)

    @property
    def is_pose(self) -> bool:
        """Whether ``x`` holds homogeneous poses instead of coordinates."""
        return self.x.ndim == 3

    @property
    def jumps(self) -> BoolArray:
        """(N,) true at the second half of each two-sided sample (the acceleration jumps there)."""
        return read_only(np.concatenate([[False], np.diff(self.t) == 0.0]))

    def __getitem__(self, index: slice) -> PlatformMotion:
        """Return the motion of a slice of the samples."""
        parts = self.t[index], self.x[index], self.xd[index], self.xdd[index]
        return PlatformMotion(*parts, check_rates=self.check_rates)


@dataclass(frozen=True, init=False, eq=False, repr=False)
class CarrierMotion(Frozen):
    """Motion of the carriers along their tracks, sampled at the times of a platform motion.

    Attributes:
        s: (N, k) position on the track, m (rad for a carrier that rotates), in the joint's own sense.
        sd: (N, k) its rate, m/s.
        sdd: (N, k) its second rate, m/s².

    ``check_rates=False`` as of a ``PlatformMotion``.

    Raises:
        InputError: wrong shapes or values that are not finite.
    """

    s: Array
    sd: Array
    sdd: Array
    check_rates = True

    def __init__(self, s: ArrayLike, sd: ArrayLike, sdd: ArrayLike, *, check_rates: bool = True) -> None:
        position = checked(s, "s", ("N", "k"))
        rate = checked(sd, "sd", position.shape)
        acceleration = checked(sdd, "sdd", position.shape)
        assign(self, s=position, sd=rate, sdd=acceleration, check_rates=bool(check_rates))

    def __repr__(self) -> str:
        """Return shape and peaks, not the arrays."""
        peaks = ", ".join(f"{largest(values).max(initial=0.0):.4g}" for values in (self.s, self.sd, self.sdd))
        return f"CarrierMotion(N={len(self)}, k={self.s.shape[1]}; largest |s|, |sd|, |sdd|: {peaks})"

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.s)

    @staticmethod
    def parked(samples: int, carriers: int, at: ArrayLike = 0.0) -> CarrierMotion:
        """Carriers at rest.

        Args:
            samples: number of samples N.
            carriers: number of carriers k.
            at: scalar or (k,) position on each track, m.

        Raises:
            InputError: ``at`` does not fit k carriers, or a count is negative or no whole number.
        """
        for count in (samples, carriers):
            if not isinstance(count, (int, np.integer)) or count < 0:
                raise InputError(
                    f"The numbers of samples and of carriers are whole and not negative; one is {count!r}.",
                    remedy="Pass len(motion) of a sampled motion, and robot.k.",
                )
        place = parked_place(at, carriers, "at")
        zero = np.zeros((samples, carriers))
        return CarrierMotion(zero + place, zero, zero)

    def __getitem__(self, index: slice) -> CarrierMotion:
        """Return the motion of a slice of the samples."""
        return CarrierMotion(self.s[index], self.sd[index], self.sdd[index], check_rates=self.check_rates)


def parked_place(at: ArrayLike, carriers: int, name: str) -> Array:
    """Return (k,) where carriers are parked, m, by one number for all or one for each.

    Raises:
        InputError: ``at``, called ``name``, does not fit k carriers.
    """
    place = checked(np.atleast_1d(at) if _dimensions(at) == 0 else at, name, ("k",))
    if len(place) not in (1, carriers):
        raise InputError(
            f"{name} has {len(place)} values for {carriers} carrier{'s' * (carriers != 1)}.",
            remedy="Pass one number, or one for each carrier.",
        )
    return np.broadcast_to(place[:carriers], (carriers,))


def require_sampled(motion: object) -> None:
    """Check that a motion has samples, for what does not sample a trajectory by itself.

    Raises:
        InputError: it is a trajectory, or something else.
    """
    if not isinstance(motion, PlatformMotion):
        raise InputError(
            f"A sampled motion was expected, not {type(motion).__name__}.",
            remedy="Pass trajectory.sample(dt=0.001)."
            if hasattr(motion, "sample")
            else "Pass a PlatformMotion, such as trajectory.sample(dt=0.001) returns.",
        )


def require_carrier_motion(carriers: object) -> None:
    """Check that carriers are a ``CarrierMotion``, or left out.

    Raises:
        InputError: they are something else.
    """
    if carriers is not None:
        require_type(carriers, CarrierMotion, "A carrier motion", "Pass CarrierMotion.parked(N, k), or one of yours.")


def require_consistent(motion: PlatformMotion, carriers: CarrierMotion | None = None) -> None:
    """Check that samples are those of a motion, unless whoever made them says that they need not be.

    For what takes samples as a motion: efforts along it, planners, the search of crossings. Where they are poses and no
    more (``lift``, ``classify_motion``, ``along``) rates play no part.

    Raises:
        InputError: rates that are not those of the positions; see ``Consistency``.
    """
    require_carrier_motion(carriers)
    check = Consistency()
    for part in blocks(len(motion)):
        # slices of arrays, as a slice of a motion is checked anew
        check.add(motion, carriers, part)
    check.require()


class Consistency:
    """Whether samples that come in parts are those of a motion: each of x, ẋ, ẍ, and of s, ṡ, s̈, the rate of the last.

    What a rate, integrated by trapezoids, says is compared with what the values change by, where the samples are dense
    enough to tell. How far the two may be apart comes from the sampling: the error of the trapezoids, a tenth to a
    quarter of all that changes. Not told, and passed: rates that are off by a constant of at most a twentieth of their
    size, as measured ones are; fewer than eight steps; a step that is a large part of the whole, behind which anything
    may lie; values that jump about as those of states do that have nothing to do with one another. Beyond so many
    samples both are integrated over all, and compared at every second, fourth, ... of them: memory does not grow.
    """

    def __init__(self) -> None:
        self._levels: dict[str, tuple[_Rates, _Rates]] = {}

    def add(self, motion: PlatformMotion, carriers: CarrierMotion | None = None, part: slice = slice(None)) -> None:
        """Take samples that follow those before."""
        if not motion.check_rates:
            return
        given = {"x": (motion.x, motion.xd, motion.xdd)}
        if carriers is not None and carriers.check_rates:
            given["s"] = (carriers.s, carriers.sd, carriers.sdd)
        for name, values in given.items():
            for level, pair in zip(self._levels.setdefault(name, (_Rates(), _Rates())), pairwise(values), strict=True):
                level.add(motion.t[part], *(value[part] for value in pair))

    def require(self) -> None:
        """Raise InputError where they are not, naming the column, the first sample that shows it, and the factor."""
        for name, levels in self._levels.items():
            compared = [one.compared() for one in levels]
            for level, one in enumerate(compared):
                if one.wrong.any():
                    _raise_wrong_rate(name, levels, compared, level, int(one.wrong.argmax()))


def _raise_wrong_rate(of: str, levels: Sequence[_Rates], compared: Sequence[_Compared], level: int, k: int) -> NoReturn:
    """Say what is wrong with a column; levels are ``of`` and its rate, and that and its rate."""
    of, name = of + level * "d", of + (level + 1) * "d"
    one = compared[level]
    factor, sample, time = float(one.factor[k]), int(one.sample[k]), float(one.time[k])
    shown = f"as sample {sample} (t = {time:.6g} s) shows"
    # other units of time show in both rates
    in_time = level == 0 and not (compared[-1].moves & ~compared[-1].wrong).any()
    if levels[level].still[k]:
        message = f"{of}{k} moves while {name}{k} is zero, {shown}."
    elif not one.change[k]:
        message = f"{of}{k} does not change as {name}{k} says, {shown}: it stands still."
    elif not one.similar[k]:
        message = f"{of}{k} does not change as {name}{k} says, {shown}, nor in proportion to it: are columns exchanged?"
    else:
        unit = _unit(abs(factor), in_time)
        why = f": {unit}?" if unit else ": a sign?" if factor < 0.0 else "."
        times = f"{name}{k} is {float(f'{factor:.3g}'):g} times what {of}{k} and t say"
        message = f"{of}{k} does not change as {name}{k} says, {shown}: {times}{why}"
    raise InputError(
        message,
        remedy="Give SI units (m, rad, s) throughout, and the columns of each coordinate with the same number. Poses "
        "to stand still in, and states that are no motion, pass with check_rates=False.",
        column=f"{name}{k}",
        sample=sample,
        time=time,
        factor=factor,
    )


# Rates are compared with positions from so many steps on. A wrong unit is off by 9.5 (rpm), 57 (degrees), 1000 (mm):
# what is off by a quarter is no rounding, nor an integral by trapezoids over steps that are small parts of the whole;
# a tenth is left to rates that were measured
_FEWEST_STEPS, _LEAST_MISFIT, _MISFIT, _LARGEST_STEP, _ROUNDED = 8, 0.1, 0.25, 0.15, 1e-6

_BIAS = 0.05
"""Constant error of measured rates, as a part of their root mean square, that is none of units, signs or columns: its
integral grows with the length of the motion, and what it is compared with does not."""

_ROUGH = 0.6
"""Steps of states that have nothing to do with one another are 1.4 times as large as the states are spread (root mean
square); of ten samples of a whole wave 0.6 times, of twenty half of that. Fewer could be those of another wave."""

_SIMILAR = 0.9
"""Cosine between what changes and what rates say, above which the two differ by a factor."""

_UNITS = (
    *((1e3, "milliseconds", "millimetres"), (1e-3, "millimetres", "millimetres"), (1.0 / 60.0, "minutes", "minutes")),
    *((1e6, "microseconds", "micrometres"), (1e-6, "micrometres", "micrometres"), (60.0, "minutes", "minutes")),
    *((180.0 / np.pi, "degrees", "degrees"), (np.pi / 180.0, "degrees", "degrees")),
    *((30.0 / np.pi, "revolutions a minute", "revolutions a minute"), (1.0 / 9.80665, "g", "g")),
)
"""Factors that name a unit; the first name where times may be in it."""


def _unit(factor: float, in_time: bool) -> str:
    return next((names[not in_time] for of, *names in _UNITS if abs(factor / of - 1.0) < 0.02), "")


COMPARED_AT = 30_000
"""Instants at which integrals of longer motions are compared, at least."""


class _Compared(NamedTuple):
    """What n rates say, compared with what the values change by; each (n,)."""

    wrong: BoolArray
    moves: BoolArray
    change: BoolArray
    similar: BoolArray
    factor: Array
    sample: IntArray
    time: Array


class _Rates:
    """Sums over the samples of n values and their rates, as they come, and the integrals at some of their instants."""

    def __init__(self) -> None:
        self._last: tuple[Array, Array, Array] | None = None
        self._sums: dict[str, Any] = {}
        self._ends: dict[str, Array] = {}
        # integral of the rates, change of the values, and the same of angles written within a turn; (3, 1 + n, I).
        # Time runs along the last axis in here: sums over what lies side by side take a fifth as long
        self._kept: list[Array] = []
        self._steps, self._stride = 0, 1

    @property
    def still(self) -> BoolArray:
        """(n,) whether a rate is zero throughout."""
        return np.asarray(self._ends["rate"] == 0.0)

    def add(self, t: Array, values: Array, rates: Array) -> None:
        """Take N samples: times, values (N, n) or poses (N, 4, 4), and rates (N, n)."""
        rates = np.ascontiguousarray(rates.T)
        new: dict[str, Any] = {"rate2": np.einsum("nk,nk->n", rates, rates), "samples": np.float64(len(t))}
        ends = {"rate": np.abs(rates).max(axis=1)}
        known = 0
        if self._last is not None:
            known = len(self._last[0])
            t, values = (np.concatenate(both) for both in zip(self._last[:2], (t, values), strict=True))
            rates = np.concatenate([self._last[2], rates], axis=1)
        else:
            self._start, zero = t[0], np.zeros((3, len(rates), 1))
            self._integral, self._change, self._continued = zero
        self._last = t[-2:], values[-2:], rates[:, -2:]
        first = max(known - 1, 0)
        dt, bends = np.diff(t), np.diff(rates)
        # four times the error of the trapezoids, as second differences show it
        bent = (dt[1:] * np.abs(np.diff(bends)))[:, max(known - 2, 0) :]
        dt, bends, steps = dt[first:], bends[:, first:], _steps(values[first:])
        if steps.shape[1]:
            means = 0.5 * (rates[:, first:-1] + rates[:, first + 1 :])
            integral = self._integral + np.cumsum(dt * means, axis=1)
            change = self._change + np.cumsum(steps, axis=1)
            # angles may be written within a turn
            continued = self._continued + np.cumsum(steps - 2.0 * np.pi * np.round(steps / (2.0 * np.pi)), axis=1)
            self._integral, self._change, self._continued = (part[:, -1:] for part in (integral, change, continued))
            elapsed, later = t[first + 1 :] - self._start, dt > 0.0
            new |= {
                "error": bent.sum(axis=1) / 3.0,
                "later": np.float64(np.count_nonzero(later)),
                "steps": np.float64(steps.shape[1]),
                "bias": (integral - change) @ elapsed,
                "bias of angles": (integral - continued) @ elapsed,
                "elapsed2": elapsed @ elapsed,
                "step2": np.einsum("nk,nk,k->n", steps, steps, later),
                "bend2": np.einsum("nk,nk,k->n", bends, bends, later),
                "change": change.sum(axis=1),
                "change2": np.einsum("nk,nk->n", change, change),
                "integral2": np.einsum("nk,nk->n", integral, integral),
                "product": np.einsum("nk,nk->n", change, integral),
            }
            ends |= {"step": np.abs(steps).max(axis=1)}
            for name, series in (("change", change), ("integral", integral)):
                ends |= {f"{name} up": series.max(axis=1), f"{name} down": -series.min(axis=1)}
            self._keep(t[first + 1 :], (integral, change, continued))
        for name, value in new.items():
            self._sums[name] = self._sums.get(name, 0.0) + value
        for name, value in ends.items():
            self._ends[name] = np.maximum(self._ends.get(name, -np.inf), value)

    def _keep(self, t: Array, series: tuple[Array, Array, Array]) -> None:
        """Keep three series (n, N), with their times, at each ``stride``-th step."""
        at = slice(-(self._steps + 1) % self._stride, None, self._stride)
        self._steps += len(t)
        self._kept.append(np.stack([np.concatenate([t[None, at], part[:, at]]) for part in series]))
        while sum(part.shape[2] for part in self._kept) > 2 * COMPARED_AT:
            self._kept = [np.concatenate(self._kept, axis=2)[:, :, 1::2].copy()]
            self._stride *= 2

    def compared(self) -> _Compared:
        """Return what the rates say beside what the values do."""
        sums, ends = self._sums, self._ends
        n = len(ends["rate"])
        if "later" not in sums or sums["later"] < _FEWEST_STEPS:
            no = np.zeros(n, dtype=bool)
            return _Compared(no, no, no, no, np.ones(n), np.zeros(n, dtype=np.intp), np.zeros(n))
        kept = np.concatenate(self._kept, axis=2)
        integral, change, continued = kept[:, 1:]
        elapsed, most = kept[0, 0] - self._start, _BIAS * np.sqrt(sums["rate2"] / sums["samples"])

        change_range, integral_range = (ends[f"{name} up"] + ends[f"{name} down"] for name in ("change", "integral"))

        def without_bias(bias: Array) -> Array:
            """Return the integral of the rates less a constant, where a small one brings it nearer to what changes."""
            bias = bias / sums["elapsed2"]
            return np.asarray(integral - np.where(np.abs(bias) <= most, bias, 0.0)[:, None] * elapsed)

        def tolerance(size: Array) -> Array:
            size = np.maximum(change_range, size)
            return np.asarray(np.clip(sums["error"], _LEAST_MISFIT * size, _MISFIT * size))

        def follows(changed: Array, integral: Array, most: Array) -> BoolArray:
            return np.asarray(np.abs(changed - integral).max(axis=1) <= most)

        size = np.maximum(change_range, integral_range)
        apart = np.abs(change - integral) > tolerance(integral_range)[:, None]
        fits = ~apart.any(axis=1)
        if not fits.all():
            unbiased = without_bias(sums["bias"])
            fits |= follows(change, unbiased, tolerance(np.ptp(unbiased, axis=1)))
            for rest in (integral, without_bias(sums["bias of angles"])):
                over = np.ptp(rest, axis=1)
                fits |= follows(continued, rest, np.minimum(tolerance(over), _MISFIT * over))
        # a ramp between two samples is in the values, and not in rates sampled before and after it
        dense = ends["step"] <= _LARGEST_STEP * size
        # what hardly changes has few digits: the seventh of the largest coordinate is rounding
        largest = np.maximum(ends["change up"], ends["change down"]).max(initial=0.0)
        rounding = _ROUNDED * max(1.0, float(largest))
        moves, changes = size > rounding, change_range > rounding
        count = sums["steps"] + 1.0
        spread = np.sqrt(np.maximum(sums["change2"] / count - (sums["change"] / count) ** 2, 0.0))
        over = {"step2": "later", "bend2": "later", "rate2": "samples"}
        step, bend, rate = (np.sqrt(sums[name] / sums[of]) for name, of in over.items())
        rough = np.where(changes, step > _ROUGH * spread, bend > _ROUGH * rate)
        wrong = ~fits & dense & moves & ~rough
        with np.errstate(divide="ignore", invalid="ignore"):
            factor = sums["product"] / sums["change2"]
            similar = np.abs(factor) * np.sqrt(sums["change2"]) >= _SIMILAR * np.sqrt(sums["integral2"])
        at = np.argmax(apart, axis=1)
        sample = (at + 1) * self._stride
        return _Compared(wrong, moves & dense & ~rough, changes, similar, factor, sample, kept[0, 0, at])


def _steps(x: Array) -> Array:
    """Return (n, N-1) what coordinates change by from sample to sample, or (6, N-1) poses, as a screw in world axes."""
    if x.ndim == 2:
        return np.diff(np.ascontiguousarray(x.T))
    turn = x[1:, :3, :3] @ x[:-1, :3, :3].transpose(0, 2, 1)
    # sin of the angle times the axis; not defined at half a turn, which is no step of a dense motion
    axis = 0.5 * np.stack([turn[:, i, j] - turn[:, j, i] for i, j in ((2, 1), (0, 2), (1, 0))], axis=1)
    sine = np.linalg.norm(axis, axis=1)
    angle = np.arctan2(sine, 0.5 * (np.trace(turn, axis1=1, axis2=2) - 1.0))
    scale = np.where(sine > 1e-9, angle / np.maximum(sine, 1e-9), 1.0)
    return np.concatenate([np.diff(x[:, :3, 3].T), scale * axis.T])


def _dimensions(values: ArrayLike) -> int:
    """Return the number of axes, −1 where there is no such number; ``checked`` says what is wrong then."""
    try:
        return np.ndim(values)
    except ValueError:
        return -1


def _require_increasing(t: Array, x: Array, xd: Array) -> None:
    step = np.diff(t)
    same_state = (x[1:] == x[:-1]).all(axis=tuple(range(1, x.ndim))) & (xd[1:] == xd[:-1]).all(axis=1)
    two_sided = (step == 0.0) & same_state
    bad = ~(step > 0.0) & ~two_sided
    if not bad.any():
        bad[1:] = two_sided[1:] & two_sided[:-1]  # three of one instant
    if bad.any():
        k = int(bad.argmax())
        raise InputError(
            f"Time does not increase: t[{k}] = {t[k]:.9g}, t[{k + 1}] = {t[k + 1]:.9g}.",
            remedy="Sort the samples; an instant may appear twice only to give the acceleration before and "
            "after a jump, with equal x and xd.",
            sample=k + 1,
        )


def _require_poses(x: Array) -> None:
    rotation = x[:, :3, :3]
    with np.errstate(over="ignore", invalid="ignore"):  # entries of 1e200 are no rotation either
        error = np.abs(rotation @ rotation.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
        error = np.maximum(error, np.abs(np.linalg.det(rotation) - 1.0))
    error = np.maximum(error, np.abs(x[:, 3] - np.array([0.0, 0.0, 0.0, 1.0])).max(axis=1))
    if not error.max() <= _POSE_TOLERANCE:
        k = int(error.argmax())
        raise InputError(
            f"x[{k}] is not a homogeneous pose: it misses orthonormality by {error[k]:.2g}.",
            remedy="Pass 4 x 4 matrices [R p; 0 1] with R a rotation.",
            sample=k,
        )


_POSE_TOLERANCE = 1e-9
"""Rounding of a product of a few rotations stays near 1e-15; text with nine digits passes too."""
