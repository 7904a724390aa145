"""What a backend may offer ``simulate`` and controllers beyond inverse dynamics: forward dynamics as machine code.

``Dynamics.forward`` returns it, or None: then the simulation computes everything itself (``simulation.forward``). Tests
compare the two.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple, Protocol, TypeVar

from redundancy_pin.arrays import Array
from redundancy_pin.robot import Robot

if TYPE_CHECKING:
    from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial

LEAST_INERTIA = 1e-8
"""Least share, no unit, of the largest inertia that a free motion may have; below it the model counts as massless in
some direction. Rounding leaves 1e-16, and accelerations that shrink steps to nothing long before; a part of a
thousandth of the mass of the others leaves 1e-3. Halfway between."""


Loads = Callable[[float, Array, Array], tuple[Array, tuple[Array, Array, Array] | None]]
"""From t, q (nq,), v (nv,) to generalised forces (nv,), and s, ṡ, s̈ (k,) where the carriers' motion is given."""


class Equations(NamedTuple):
    """The tree and its closures at one state: K v = (0, ẋ), K a + bias its rate, M a + effort the generalised forces.

    Attributes:
        K: (p, p) closure rows over platform rows; columns are the velocities that move the pose.
        bias: (p,) their rates at v̇ = 0.
        mass: (nv, nv) M of the open tree.
        effort: (nv,) velocity terms and gravity.
    """

    K: Array
    bias: Array
    mass: Array
    effort: Array


class LinearParts(NamedTuple):
    """Derivatives of the equations of motion at N states in motion; see ``simulation.derivatives.DynamicsDerivatives``.

    Attributes:
        mass: (N, d, d); force_y, force_z: (N, d, d); input: (N, d, m + k).
    """

    mass: Array
    force_y: Array
    force_z: Array
    input: Array


class Accelerations(NamedTuple):
    """Result at one state: tree acceleration (nv,), closure forces (r,), and residual forces (nv,)."""

    a: Array
    closure_force: Array
    missing: Array


@dataclass(frozen=True, eq=False)
class Rules:
    """Tolerances, limits and forces of an integration, and the events at which it returns a step to its caller.

    Attributes:
        method: "DOP853" or "RK45", explicit Runge-Kutta methods of scipy.
        rtol, max_step: of the steps.
        atol: (nq + nv,) absolute tolerance of a step, in the units of q and v.
        grid: (G,) times to record, s; those closer than ``time_tolerance`` are one.
        breaks: (B,) times, s, at which the integration is restarted; the last one is the end.
        efforts: polynomials of main efforts and carrier forces; or None.
        loads: the function of the state that gives the forces without ``efforts``.
        prescribed: whether the carriers' motion is given (by ``loads``).
        limits: (m + k,) where main efforts and carrier forces saturate.
        stops: (4, l) index in q, index in v, side and bound of each stop.
        time: s; time scale of the motion.
        brief: rad; steps with less travel, at the speeds of their ends, are checked at their end only.
        check_travel: rad; largest travel of joints between two checks of the closures' rank.
        near_rank: ratio of singular values below which a rank loss may be near.
        shortest: s; the shortest ordinary step.
        tolerance, largest_residual: m; closure residual that a projection must reach, and must not leave.
        velocity_change, velocity_floor: a projection may change a velocity by this share of the largest one, plus this
            amount, characteristic lengths or rad, per time scale.
    """

    method: str
    rtol: float
    atol: Array
    max_step: float
    grid: Array
    time_tolerance: float
    breaks: Array
    efforts: PiecewisePolynomial | None
    loads: Loads | None
    prescribed: bool
    limits: Array
    stops: Array
    time: float
    brief: float
    check_travel: float
    near_rank: float
    shortest: float
    tolerance: float
    largest_residual: float
    velocity_change: float
    velocity_floor: float


@dataclass(frozen=True, eq=False)
class Progress:
    """How far an integration is.

    Attributes:
        t: s.
        y: (nq + nv,) the closed state there.
        values: (w,) functions of the events there.
        near: ratio of singular values of the closures below which a rank loss is looked for.
        next_step: length the integrator suggests for its next step, s; None before the first.
        steps, evaluations, restarts, largest_correction: see ``Statistics``.
    """

    t: float
    y: Array
    values: Array
    near: float
    next_step: float | None = None
    steps: int = 0
    evaluations: int = 0
    restarts: int = 0
    largest_correction: float = 0.0


ProgressT = TypeVar("ProgressT", bound=Progress)


class Integration(Protocol):
    """An integration whose ordinary steps are taken by machine code."""

    def hold(self, command: Array) -> None:
        """Let constant efforts (m + k,) act."""

    def advance(self, progress: ProgressT, recorded: int, end: float, most: int) -> tuple[ProgressT, Array, bool]:
        """Take ordinary steps up to a time, s, at most so many; the length of the first is ``progress.next_step``.

        ``recorded``: how many of the times to record are behind. Returns the progress, the states (S, nq + nv) at the
        times to record that were passed, and whether the next step is not ordinary.
        """


class ForwardKernel(Protocol):
    """Forward dynamics of one robot as machine code."""

    @property
    def robot(self) -> Robot:
        """The robot."""

    def accelerations(
        self, q: Array, v: Array, force: Array, carrier_acceleration: Array | None = None
    ) -> Accelerations | None:
        """Return accelerations and forces at a closed state under generalised forces (nv,).

        None if the closures have lost rank or a free motion has no inertia; ``ForwardDynamics`` distinguishes them.
        """

    def project(self, y: Array, tolerance: float) -> tuple[Array, float, float] | None:
        """Return the closed state nearest to y (nq + nv,), the residual before and after, m; None if not found."""

    def equations(self, q: Array, v: Array) -> Equations:
        """Return the equations of the tree and its closures at a state."""

    def platform(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Return the platform's coordinates (n,), m and rad, or pose (4, 4), base frame, and their rates (n,)."""

    def linear(self, q: Array, v: Array, a: Array, tau: Array) -> LinearParts:
        """Return exact derivatives at N states in motion under main efforts (N, m)."""

    def integration(self, rules: Rules) -> Integration:
        """Return an integration."""
