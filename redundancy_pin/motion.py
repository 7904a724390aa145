"""Sampled motions of the platform and of the carriers: what every computation takes as input."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import (
    Array,
    BoolArray,
    Frozen,
    assign,
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
        t: (N,) time, s. Strictly increasing, except for *two-sided samples*: where the acceleration
            jumps, the same instant appears twice, with equal ``x`` and ``xd`` and the acceleration
            before and after the jump.
        x: (N, n) platform coordinates in the base frame, m and rad; or (N, 4, 4) homogeneous poses of a
            spatial platform.
        xd: (N, n) their rate, m/s and rad/s; for a pose, the twist (linear, angular) in world-aligned
            axes at the platform origin.
        xdd: (N, n) its rate, m/s² and rad/s².

    Efforts, plans and crossings are refused for a motion whose rates contradict its positions (``require_consistent``):
    other units, or positions that move while ẋ is zero, would give plausible but wrong numbers. ``check_rates=False``
    declares that the samples are not one motion (poses at rest, unrelated states); slices and copies keep it.

    Raises:
        InputError: wrong shapes, values that are not finite, time that does not increase.

    Example:
        >>> motion = rp.PlatformMotion([0.0, 1.0], [[0.2, 0.4], [0.3, 0.4]], [[0.1, 0.0]] * 2, [[0.0, 0.0]] * 2)
        >>> motion.x.shape
        (2, 2)
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

    Example:
        >>> rp.CarrierMotion.parked(5, 3).s.shape
        (5, 3)
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
        InputError: ``at``, called ``name``, does not fit k carriers; there are none, and it is not zero.
    """
    place = checked(np.atleast_1d(at) if _dimensions(at) == 0 else at, name, ("k",))
    if not carriers and place.any():
        raise InputError(
            f"{name} is {place.tolist()}, but the robot has no carriers.", remedy="Leave it out.", name="park"
        )
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
"""Difference between a rate and the mean rate of a step, relative to the largest rate of the coordinate: a bias of
measured rates passes."""

SIX_DIGITS = 5e-6
"""Largest error of a number that is rounded to six digits, relative to the number."""

_NOISE = 4.0
"""Standard deviations of noise, estimated by fourth differences, by which a comparison may be off."""

_NOTHING = 1e-9
"""Rounding of a rate, relative to the largest rate of any coordinate."""

_FEW_STEPS = 8
"""Fewer steps must all contradict the rates. In so many a coordinate may change that is at rest at both ends."""

_TOO_SLOW = 0.25
"""Mean rate of the positions, relative to that of the rates, below which few steps contradict them: a factor of ten
is found although the trapezoidal rule may be wrong by a factor of 2.5 in a coarse step."""

_TURN = 2.0
"""Turn of a pose in a step, rad, from which rates are not compared: at half a turn its sense is not determined."""


def require_consistent(motion: PlatformMotion, carriers: CarrierMotion | None = None) -> None:
    """Check that x, ẋ, ẍ (and s, ṡ, s̈) are samples of one motion, unless ``check_rates`` is false.

    For what takes samples as a motion: efforts along it, planners, the search of crossings. Where only poses count
    (``inverse_kinematics``, ``classify_motion``, ``along``) rates play no part.

    In each step of each coordinate the mean rate of the positions, Δx/h, is compared with the mean of the rates at both
    ends, the trapezoidal rule; so is Δẋ/h with the mean of ẍ. They may differ by the sum of

    - 3 % of the largest rate of the coordinate;
    - the error of the trapezoidal rule: half of |Δẋ| and a quarter of h |ẍ|; for accelerations |Δẍ|, and the change of
      Δẋ/h from this step to the next or the last;
    - rounding of x to six digits, over h, four times the noise that fourth differences of the comparison show, and of
      rotations h² |ω| |ω̇|/6, as their axis tilts.

    From 9 samples and one period on this finds a wrong sign, milli and kilo, degrees for radians, a factor of 2 (10
    samples per shortest period; of ẍ against ẋ 15) or of 1.1 (20 samples; of ẍ against ẋ 40), and positions that move
    while their rate is zero in more than eight steps.

    Fewer samples are refused if the positions move less than a quarter of what ẋ says, or backwards, in every step in
    which ẋ exceeds the sum above, where h |ẍ| counts in full in a single step, half in two, and a third in three. A
    wrong sign and a factor of ten are found where steps are not coarse; rates that are too small, and ẍ, are not
    compared.

    Right motions pass from 2.2 samples in the shortest period on. Not found: smaller factors; a bias of up to 3 %;
    errors below the noise; one wrong ẋ or ẍ among right ones.

    Raises:
        InputError: rates that contradict the positions, with ``column``, ``sample``, ``time``, the mean rate
            ``found`` from the positions and ``given`` by the rates, and how much they may differ, ``allowed``.
    """
    require_carrier_motion(carriers)
    if motion.check_rates:
        _require_rates("x", motion.t, motion.x, motion.xd, motion.xdd)
        _require_rates("xd", motion.t, motion.xd, motion.xdd, None)
        if carriers is not None and carriers.check_rates:
            _require_rates("s", motion.t, carriers.s, carriers.sd, carriers.sdd)
            _require_rates("sd", motion.t, carriers.sd, carriers.sdd, None)


def _require_rates(name: str, t: Array, values: Array, rates: Array, seconds: Array | None) -> None:
    """Compare steps of values (N, n), or of poses, with their rates (N, n), whose own rates are (N, n) or None."""
    later = np.diff(t) > 0.0
    h, steps = np.diff(t)[later], _steps(values)[:, later]
    few = len(h) < _FEW_STEPS
    if not steps.size or not len(h) or (few and seconds is None):
        return
    rows = np.ascontiguousarray(rates.T)  # reductions along long rows take a tenth of the time
    first, last = rows[:, :-1][:, later], rows[:, 1:][:, later]
    found, given, top = steps / h, 0.5 * (first + last), np.abs(rows).max(axis=1, keepdims=True)
    apart = np.abs(found - given)
    if (apart <= RATE_TOLERANCE * top).all():  # as in most motions
        return
    if values.ndim == 2 and seconds is not None:  # an angle may be written within a turn
        turned = found - 2.0 * np.pi * np.sign(steps) / h
        nearer = (np.abs(steps) > np.pi) & (np.abs(turned - given) < apart)
        found = np.where(nearer & (np.ptp(values, axis=0) <= 2.0 * np.pi)[:, None], turned, found)
        apart = np.abs(found - given)
    change = np.abs(last - first)
    if seconds is None:
        jumps = np.pad(np.abs(np.diff(found)), ((0, 0), (1, 1)))
        allowed = RATE_TOLERANCE * top + change + np.maximum(jumps[:, 1:], jumps[:, :-1])
    else:
        second = np.maximum(np.abs(seconds[:-1]), np.abs(seconds[1:]))[later].T
        allowed = RATE_TOLERANCE * top + 0.5 * change + max(0.25, 1.0 / len(h)) * h * second
    bends = np.diff(found - given, 4)
    if bends.shape[1] >= 4:
        allowed += _NOISE * np.sqrt((bends**2).mean(axis=1, keepdims=True) / 70.0)  # 70: of noise of size 1
    if (
        values.ndim == 3 and seconds is not None
    ):  # the rotation vector of a step differs from the mean of h ω by h³ ω̇ × ω/12
        omega, alpha = (np.linalg.norm(part[:, 3:], axis=1) for part in (rates, seconds))
        turn = h * np.maximum(omega[1:], omega[:-1])[later]
        tilt = turn * h * np.maximum(alpha[1:], alpha[:-1])[later] / 6.0
        allowed[3:] += np.where(turn < _TURN, tilt, np.inf)
        size = np.append(np.abs(values[:, :3, 3]).max(axis=0), np.ones(3))
    else:
        size = np.abs(values).max(axis=0)
    nothing = _NOTHING * top.max()
    allowed += nothing + 2.0 * SIX_DIGITS * size[:, None] / h
    wrong = apart > allowed
    rests = np.maximum(np.abs(first), np.abs(last)) <= nothing
    wrong &= ~(rests & ((wrong & rests).sum(axis=1, keepdims=True) <= _FEW_STEPS))
    if few:  # a motion may hurry, or turn back once, between two of few samples
        fast = np.abs(given) > allowed
        wrong = fast & (found * np.sign(given) < _TOO_SLOW * np.abs(given))
        wrong &= (wrong == fast).all()
    if not wrong.any():
        return
    step = int(wrong.any(axis=0).argmax())
    k = int(wrong[:, step].argmax())
    sample = int(np.flatnonzero(later)[step]) + 1
    raise InputError(
        f"{name}{k} does not change as {name}d{k} says: from sample {sample - 1} to {sample} (t = {t[sample]:.6g} s) "
        f"its mean rate is {found[k, step]:.6g}, by {name}d{k} it is {given[k, step]:.6g}; these may differ by "
        f"{allowed[k, step]:.3g}.",
        remedy="Correct the rates (SI units: m, rad, s; the columns of each coordinate with the same number), or pass "
        "check_rates=False for states that are no motion, such as poses to stand still in.",
        column=f"{name}d{k}",
        sample=sample,
        time=float(t[sample]),
        found=float(found[k, step]),
        given=float(given[k, step]),
        allowed=float(allowed[k, step]),
    )


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
    """Return the number of axes; −1 for ragged values, which ``checked`` refuses."""
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
    """Raise InputError if a matrix among (N, 4, 4) is not a homogeneous pose within ``POSE_TOLERANCE``."""
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
