"""Sampled motions of the platform and of the carriers: what every computation takes as input."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array, BoolArray, Frozen, assign, checked, largest, read_only
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

    Raises:
        InputError: wrong shapes, values that are not finite, time that does not increase.
    """

    t: Array
    x: Array
    xd: Array
    xdd: Array

    def __init__(self, t: ArrayLike, x: ArrayLike, xd: ArrayLike, xdd: ArrayLike) -> None:
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
        assign(self, t=time, x=position, xd=rate, xdd=acceleration)

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
        return PlatformMotion(self.t[index], self.x[index], self.xd[index], self.xdd[index])


@dataclass(frozen=True, init=False, eq=False, repr=False)
class CarrierMotion(Frozen):
    """Motion of the carriers along their tracks, sampled at the times of a platform motion.

    Attributes:
        s: (N, k) position on the track, m (rad for a carrier that rotates), in the joint's own sense.
        sd: (N, k) its rate, m/s.
        sdd: (N, k) its second rate, m/s².

    Raises:
        InputError: wrong shapes or values that are not finite.
    """

    s: Array
    sd: Array
    sdd: Array

    def __init__(self, s: ArrayLike, sd: ArrayLike, sdd: ArrayLike) -> None:
        position = checked(s, "s", ("N", "k"))
        rate = checked(sd, "sd", position.shape)
        acceleration = checked(sdd, "sdd", position.shape)
        assign(self, s=position, sd=rate, sdd=acceleration)

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
        place = checked(np.atleast_1d(at) if _dimensions(at) == 0 else at, "at", ("k",))
        if len(place) not in (1, carriers):
            raise InputError(
                f"at has {len(place)} values for {carriers} carriers.",
                remedy="Pass one number, or one for each carrier.",
            )
        zero = np.zeros((samples, carriers))
        return CarrierMotion(zero + place[: max(carriers, 1)] if carriers else zero, zero, zero)

    def __getitem__(self, index: slice) -> CarrierMotion:
        """Return the motion of a slice of the samples."""
        return CarrierMotion(self.s[index], self.sd[index], self.sdd[index])


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
