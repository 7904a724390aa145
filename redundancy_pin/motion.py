"""Sampled motions of the platform and of the carriers: what every computation takes as input."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import (
    Array,
    BoolArray,
    Frozen,
    assign,
    blocks,
    checked,
    largest,
    read_only,
    require_type,
)
from redundancy_pin.errors import InputError, numbered_from


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
            require_poses(position)
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


RATE_TOLERANCE = 0.03
"""Part of the largest rate of a coordinate by which rates may be off: a bias of measured ones, say."""

_NOISE = 4.0
"""Standard deviations of its noise, by its fourth differences, by which a comparison may be off."""

_NOTHING = 1e-9
"""Part of the largest rate of any coordinate that is rounding in another."""

_FEW_STEPS = 8
"""Fewer steps tell coarse mistakes only. So many may also change a coordinate that stands at both of their ends."""

_TOO_FAR = 4.0
"""Times as far as the positions that few rates may travel; from rest to a speed that grows with t³ it is 2."""

_FAST = 0.4
"""Part of its largest rate at which a coordinate must move in a step that tells of few."""

_TURN = 2.0
"""Turn in a step of a pose, rad, from which rates are not compared: at half a turn its sense is not determined."""

_PART = 20_000
"""Samples that are compared at a time, with the noise among them."""


def require_consistent(motion: PlatformMotion, carriers: CarrierMotion | None = None) -> None:
    """Check that x, ẋ, ẍ (and s, ṡ, s̈) are samples of one motion, unless whoever made them says that they need not be.

    For what takes samples as a motion: efforts along it, planners, the search of crossings. Where they are poses and no
    more (``inverse_kinematics``, ``classify_motion``, ``along``) rates play no part.

    In each step of each coordinate the mean rate by the positions, Δx/h, is compared with the mean of the rates at its
    ends, by the trapezoid rule; so is Δẋ/h with the mean of ẍ. They may differ by the sum of

    - 3 % of the largest rate of the coordinate;
    - what the step leaves open: half of |Δẋ| and a quarter of h |ẍ|; for accelerations |Δẍ|, and by how much Δẋ/h
      changes from this step to the next or the last;
    - rounding of x to six digits, over h, four times the noise that fourth differences of the comparison show, and of
      rotations h² |ω| |ω̇|/6, as their axis tilts.

    From 9 samples and one period on this finds a wrong sign, milli and kilo, degrees for radians, a factor of 2 (10
    samples in the shortest period; of ẍ against ẋ 15), of 1.1 (20 samples; of ẍ against ẋ 40), and positions that
    move, or rates that change, while their rate is zero in more than eight steps. Of fewer samples it finds that
    rates have the wrong sign or travel at least four times as far as the positions, in each step and coordinate in
    which they are large, as a factor of ten does on a motion that does not turn back between two samples; rates that
    are too small, and ẍ, pass there. Not found: smaller factors; a bias of up to 3 %; errors below the noise; one
    wrong ẋ or ẍ among right ones, which may be a motion that is too short for the samples.

    Raises:
        InputError: rates that are not those of the positions, with ``column``, ``sample``, ``time``, the mean rate
            ``found`` from the positions and ``given`` by the rates, and how much they may differ, ``allowed``.
    """
    require_carrier_motion(carriers)
    if motion.check_rates:
        _require_rates("x", motion.t, (motion.x, motion.xd, motion.xdd))
        if carriers is not None and carriers.check_rates:
            _require_rates("s", motion.t, (carriers.s, carriers.sd, carriers.sdd))


def _require_rates(name: str, time: Array, motion: tuple[Array, Array, Array]) -> None:
    """Compare values, rates and second rates of N samples, called x, xd and xdd of an x."""
    for part in blocks(len(time), _PART):
        inside = slice(max(part.start - 1, 0), part.stop)  # no step is left out
        t, values, rates, seconds = (each[inside] for each in (time, *motion))
        tilt = np.zeros((rates.shape[1], max(len(t) - 1, 0)))
        if values.ndim == 3:  # the rotation vector of a step differs from the mean of h ω by h³ ω̇ × ω/12
            omega, alpha = (np.linalg.norm(array[:, 3:], axis=1) for array in (rates, seconds))
            turn = np.diff(t) * np.maximum(omega[1:], omega[:-1])
            tilt[3:] = np.where(turn < _TURN, turn * np.diff(t) * np.maximum(alpha[1:], alpha[:-1]) / 6.0, np.inf)
        with numbered_from(inside.start):
            _require_rate(name, t, values, rates, seconds, tilt)
            _require_rate(f"{name}d", t, rates, seconds, None, np.zeros_like(tilt))


def _require_rate(name: str, t: Array, values: Array, rates: Array, seconds: Array | None, tilt: Array) -> None:
    """Compare steps of values (N, n), or of poses, with their rates (N, n), whose own rates are (N, n) or None.

    ``tilt`` (n, N−1) is by how much mean rates differ from those of the steps because the axis of a rotation tilts.
    """
    steps = _steps(values)
    if _agree_closely(t, steps, rates):
        return
    size = (
        np.abs(values).max(axis=0) if values.ndim == 2 else np.append(np.abs(values[:, :3, 3]).max(axis=0), np.ones(3))
    )
    later = np.diff(t) > 0.0
    h, steps, tilt = np.diff(t)[later], steps[:, later], tilt[:, later]
    ends = [
        array[side][later].T for array in (rates, seconds) if array is not None for side in (slice(-1), slice(1, None))
    ]
    if len(h) < (_FEW_STEPS if seconds is None else 1) or not steps.size:
        return
    found, largest_rate = steps / h, np.abs(rates).max(axis=0)
    compared = _compare(h, found, size, largest_rate, ends, tilt)
    far = np.abs(steps) > np.pi
    if compared.wrong.any() and far.any():  # an angle may be written within a turn
        within = np.ptp(np.cumsum(steps, axis=1), axis=1, keepdims=True) <= 2.0 * np.pi
        turned = found - np.where(far & within, 2.0 * np.pi * np.sign(steps) / h, 0.0)
        other = _compare(h, turned, size, largest_rate, ends, tilt)
        compared = compared._replace(wrong=compared.wrong & other.wrong.any(axis=1, keepdims=True))
    if not compared.wrong.any():
        return
    step = int(compared.wrong.any(axis=0).argmax())
    k = int(compared.wrong[:, step].argmax())
    sample = int(np.flatnonzero(later)[step]) + 1
    given, allowed = float(compared.given[k, step]), float(compared.allowed[k, step])
    raise InputError(
        f"{name}{k} does not change as {name}d{k} says: from sample {sample - 1} to {sample} (t = {t[sample]:.6g} s) "
        f"its mean rate is {found[k, step]:.6g}, by {name}d{k} it is {given:.6g}; these may differ by {allowed:.3g}.",
        remedy="Correct the rates (SI units: m, rad, s; the columns of each coordinate with the same number), or pass "
        "check_rates=False for states that are no motion, such as poses to stand still in.",
        column=f"{name}d{k}",
        sample=sample,
        time=float(t[sample]),
        found=float(found[k, step]),
        given=given,
        allowed=allowed,
    )


def _agree_closely(t: Array, steps: Array, rates: Array) -> bool:
    """Return whether all steps (n, N−1) agree with rates (N, n) without the further allowances of ``_compare``.

    Most motions do, and this takes a tenth of the time.
    """
    rows = np.ascontiguousarray(rates.T)  # reductions along long rows take a tenth of the time
    h = np.diff(t)
    apart = rows[:, 1:] + rows[:, :-1]
    apart *= 0.5 * h
    apart -= steps
    np.abs(apart, out=apart)
    largest_rate = np.maximum(rows.max(axis=1, initial=0.0), -rows.min(axis=1, initial=0.0))
    return bool((apart <= (RATE_TOLERANCE * largest_rate)[:, None] * h).all())


SIX_DIGITS = 5e-6
"""Largest error of a number that is rounded to six digits, relative to the number."""


class _Compared(NamedTuple):
    """Mean rates in (n, K) steps by trapezoids, how much others may differ, and which differ by more."""

    given: Array
    allowed: Array
    wrong: BoolArray


def _compare(h: Array, found: Array, size: Array, largest_rate: Array, ends: Sequence[Array], tilt: Array) -> _Compared:
    """Compare mean rates (n, K) in steps of h (K,) with rates at both ends, and maybe their own rates, (n, K) each."""
    first, last = ends[:2]
    given, change = 0.5 * (first + last), np.abs(last - first)
    apart, top = np.abs(found - given), largest_rate[:, None]
    nothing = _NOTHING * largest_rate.max()
    sure = RATE_TOLERANCE * top + nothing + 2.0 * SIX_DIGITS * size[:, None] / h + tilt
    bends = np.diff(found - given, 4)
    if bends.shape[1] >= 4:
        sure = sure + _NOISE * np.sqrt((bends**2).mean(axis=1, keepdims=True) / 70.0)  # 70: noise of its size 1
    if len(ends) == 4:
        second = h * np.maximum(np.abs(ends[2]), np.abs(ends[3]))
        opened = 0.5 * change + 0.25 * second
    else:
        jumps = np.pad(np.abs(np.diff(found)), ((0, 0), (1, 1)))
        opened = change + np.maximum(jumps[:, 1:], jumps[:, :-1])
    standing = np.maximum(np.abs(first), np.abs(last)) <= nothing
    if len(h) >= _FEW_STEPS:
        allowed = sure + opened
        wrong = apart > allowed
        few = (wrong & standing).sum(axis=1, keepdims=True) <= _FEW_STEPS
        return _Compared(given, allowed, wrong & ~(standing & few))
    # a motion of few steps may do anything between samples but turn back, or hurry less than at their ends
    unsure = sure + (second if len(h) == 1 else 0.25 * second)
    onwards = first * last >= -1e-6 * np.maximum(first**2, last**2)
    along, beyond = found * np.sign(given), np.abs(given) - unsure
    travelled = h * onwards / np.where(top > 0.0, top, 1.0)
    tells = onwards & (beyond > 0.0) & (np.abs(given) > _FAST * top)
    wrong = tells & (_TOO_FAR * along < np.abs(given))
    too_far = (np.maximum(beyond, 0.0) * travelled).sum() > _TOO_FAR * (np.maximum(along, 0.0) * travelled).sum()
    if (wrong != tells).any() or (standing & (np.abs(found) > sure)).any() or not too_far:
        wrong[:] = False
    return _Compared(given, (1.0 - 1.0 / _TOO_FAR) * np.abs(given), wrong)


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


def _pose_errors(x: Array) -> Array:
    """Return (N,) by how much matrices (N, 4, 4) miss homogeneous poses [R p; 0 1] with R a rotation."""
    rotation = x[:, :3, :3]
    with np.errstate(over="ignore", invalid="ignore"):  # entries of 1e200 are no rotation either
        error = np.abs(rotation @ rotation.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
        error = np.maximum(error, np.abs(np.linalg.det(rotation) - 1.0))
    return np.asarray(np.maximum(error, np.abs(x[:, 3] - np.array([0.0, 0.0, 0.0, 1.0])).max(axis=1)))


def require_poses(x: Array) -> None:
    """Raise InputError where a matrix among (N, 4, 4) is no homogeneous pose, to ``POSE_TOLERANCE``."""
    error = _pose_errors(x)
    if not error.max() <= POSE_TOLERANCE:
        k = int(error.argmax())
        raise InputError(
            f"x[{k}] is not a homogeneous pose: it misses orthonormality by {error[k]:.2g}.",
            remedy="Pass 4 x 4 matrices [R p; 0 1] with R a rotation.",
            sample=k,
        )


POSE_TOLERANCE = 1e-9
"""Rounding of a product of a few rotations stays near 1e-15; text with nine digits passes too."""
