"""Results of dynamics: the equation of motion W τ = f along a motion, its derivatives, and single samples."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Protocol

from redundancy_pin.arrays import Array, BoolArray, Frozen, IntArray, peak
from redundancy_pin.status import SampleStatus


@dataclass(frozen=True, eq=False, repr=False)
class ReducedDynamics(Frozen):
    """The equation of motion W τ = f in independent coordinates, with the carrier forces.

    N samples, n independent (platform) coordinates, m main actuators, k carriers. ``f`` and ``W`` stay
    finite at a type II singularity, where W loses rank. Positive efforts do positive work on positive
    joint rates. Gravity and inertia are both inside ``f``.

    Attributes:
        t: (N,) time, s.
        f: (N, n) generalised force, N and N·m, in the base frame.
        W: (N, n, m) actuation matrix; its transpose maps ẋ to the actuated joint rates.
        carrier_force: (N, k) force of each carrier's own actuator, N.
        reachable: (N,) false where no configuration closes the chains (f, W, carrier_force are NaN there).
        residual: (N,) closure residual left by the kinematics, m; the distance to the nearest closed configuration
            found where ``reachable`` is false.
        row_scale: (n,) the characteristic length for rotations, 1 for translations: dividing row i of W and f by it
            turns moments into forces.
        column_scale: (m,) the characteristic length for revolute actuators, 1 for prismatic ones.
        out_of_range: (N,) whether some joint is beyond its range, passive ones too; None where that was not checked.
        force_size: (N,) size of the forces of the motion before they cancel, N: mass · (gravity + length · (rate² +
            acceleration)), plus loads. Tolerances on f are fractions of it. None if W and f do not come from a robot.
    """

    t: Array
    f: Array
    W: Array
    carrier_force: Array
    reachable: BoolArray
    residual: Array
    row_scale: Array
    column_scale: Array
    out_of_range: BoolArray | None = None
    force_size: Array | None = None

    def __repr__(self) -> str:
        """Return shapes and peaks, not the arrays."""
        unreached = "" if self.reachable.all() else f", {int((~self.reachable).sum())} unreachable"
        return (
            f"ReducedDynamics(N={len(self.t)}, n={self.W.shape[1]}, m={self.W.shape[2]}, "
            f"k={self.carrier_force.shape[1]}{unreached}; {peak('f', self.f, 'N or N·m')})"
        )

    def at(self, samples: slice | IntArray) -> ReducedDynamics:
        """Return some of the samples."""
        names = ("t", "f", "W", "carrier_force", "reachable", "residual", "out_of_range", "force_size")
        parts = {name: getattr(self, name) for name in names}
        chosen: dict[str, Any] = {name: part if part is None else part[samples] for name, part in parts.items()}
        return replace(self, **chosen)


class ReducedSample(Protocol):
    """W τ = f at one sample; the result of ``Dynamics.sample``."""

    @property
    def W(self) -> Array:
        """(n, m) actuation matrix."""

    @property
    def f(self) -> Array:
        """(n,) generalised force, N and N·m, in the base frame."""

    @property
    def carrier_force(self) -> Array:
        """(k,) force of each carrier's own actuator, N."""


class Sample(NamedTuple):
    """One sample of the equation of motion: W (n, m), f (n,), carrier_force (k,); see ``ReducedDynamics``."""

    W: Array
    f: Array
    carrier_force: Array


class TorqueSample(NamedTuple):
    """Efforts of one sample, with a status; the result of ``Dynamics.torque``.

    Attributes:
        tau: (m,) efforts of the main actuators, N or N·m; NaN if none exist.
        status: as ``distribute`` gives it.
        margin: singularity margin of type II, the smallest singular value of the scaled W, no unit; NaN without W.
        carrier_force: (k,) force of each carrier's actuator, N or N·m; NaN without W.
        residual: closure residual of the configuration, m; of an unreachable pose the residual that Newton's method
            ends with; NaN if it is not known.
        serial_margin: lower bound of the distance to a type I singularity, no unit (``JointTrajectory``'s
            ``serial_margin_bound``); joint rates and efforts grow as it falls. NaN without W, and of a closed form.
    """

    tau: Array
    status: SampleStatus
    margin: float
    carrier_force: Array
    residual: float
    serial_margin: float = math.nan


class AccelerationSample(NamedTuple):
    """Accelerations of the tree at one state, with a status; the result of ``Dynamics.acceleration``.

    Attributes:
        a: (nv,) acceleration of the tree, m/s² and rad/s²; NaN unless the status is ok.
        status: ok; singular_inconsistent where the closures have lost rank, or a free motion has no inertia;
            not_finite.
    """

    a: Array
    status: SampleStatus


class JointStateSample(NamedTuple):
    """All joints and the platform at one instant; the result of ``Dynamics.joint_state``.

    Attributes:
        q: (nq,) configuration of the tree, m and rad, as Pinocchio has it: carriers included.
        v: (nv,) its velocity, m/s and rad/s.
        x: (n,) platform coordinates in the base frame, m and rad; (4, 4) for a pose.
        xd: (n,) their rates; the twist of a pose, in world axes at the platform's origin.
        status: ok, near_singular (type II), out_of_range; otherwise all numbers but the residual are NaN. Redundant
            motors whose positions or velocities contradict each other are unreachable, as in ``forward_kinematics``:
            by more than 1e-8 characteristic lengths or rad, or than that fraction of the velocities.
        margin: singularity margin, the smallest singular value of the scaled W, no unit.
        residual: closure residual or mismatch of redundant motors, whichever is larger, m (angles times the
            characteristic length); NaN if unknown. To use one of several noisy encoders, declare fewer joints as
            actuated.
    """

    q: Array
    v: Array
    x: Array
    xd: Array
    status: SampleStatus
    margin: float
    residual: float


@dataclass(frozen=True, eq=False)
class CarrierDerivatives(Frozen):
    """Exact derivatives of f and of the carrier forces with respect to the carrier motion.

    Attributes:
        f_s, f_sd, f_sdd: (N, n, k) derivatives of f by s, ṡ, s̈.
        force_s, force_sd, force_sdd: (N, k, k) derivatives of carrier_force by s, ṡ, s̈.
    """

    f_s: Array
    f_sd: Array
    f_sdd: Array
    force_s: Array
    force_sd: Array
    force_sdd: Array


TERMS = 5
"""Terms by which a carrier on a straight track enters W τ = f: s, s², ṡ, s ṡ and s̈."""


class CarrierTerms(NamedTuple):
    """W τ = f at N instants for every motion of carriers on straight tracks: they enter by s, s², ṡ, s ṡ and s̈.

    N samples, n independent coordinates, m main actuators, k carriers; NaN where no configuration closes the chains.

    ``W`` (N, n, m) actuation matrix; ``constant`` (N, n + k) f and the carriers' forces with the carriers at rest at
    s = 0, N and N·m; ``terms`` (N, k, 5, n + k) their increments per unit of s, s², ṡ, s ṡ and s̈ of each
    carrier. A carrier adds nothing to the force of another one.
    """

    W: Array
    constant: Array
    terms: Array
