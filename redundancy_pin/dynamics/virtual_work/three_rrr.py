"""Virtual work on the 3-RRR with a carrier on each distal link (Parsa 2014, section 2.2), gravity included.

Leg i runs from the base hinge G over the elbow B = G + l1 u(θ) to the platform corner A = B + l2 u(β), with
A = P - l3 u(φ) and φ = α + 30°, α + 150°, α - 90°; u(θ) = (cos θ, sin θ), and v⊥ = (-v_y, v_x) is v turned by +90°.
The working mode of a leg is the sign in θ = γ ± ψ, γ the direction of A from G and ψ the angle at G in the triangle
G B A. The links are kept as vectors b = l1 u(θ) and e = l2 u(β), x + iy, found by rotating A - G within its triangle,
so that the cosine and sine of α are the only trigonometric functions.

The corner moves with v_A = v + α̇ (A - P)⊥, so that θ̇ = -e·v_A/c and l2² β̇ = e⊥·(v_A - θ̇ b⊥). Read per unit of each
platform rate they are the link Jacobians G of eqs. 2.39 to 2.44; H of the elbow is b⊥ times G of θ.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import CLOSURE_TOLERANCE, SINGULAR_MARGIN, Array, BoolArray, Frozen, read_only
from redundancy_pin.dynamics.virtual_work.mechanism import (
    Body,
    Carriers,
    ComplexArray,
    Parameters,
    PlanarDynamics,
    PlanarFrame,
    PlanarJoint,
    fixed_frame,
    planar,
    revolute,
)

CORNER_ANGLES = (np.pi / 6.0, 5.0 * np.pi / 6.0, -np.pi / 2.0)
"""φ - α of each leg, rad (Parsa 2014, eq. 2.20)."""


@dataclass(frozen=True)
class ThreeRrrGeometry:
    """Lengths that fix the kinematics of the 3-RRR, m.

    Attributes:
        base_radius: circumradius of the triangle of base hinges; the first hinge is the origin.
        platform_radius: l3, from the platform's centre to its corners.
        proximal_length: l1.
        distal_length: l2.
    """

    base_radius: float
    platform_radius: float
    proximal_length: float
    distal_length: float

    @classmethod
    def from_parameters(cls, parameters: Parameters) -> ThreeRrrGeometry:
        """Read the lengths off the parameters of the shipped model."""
        return cls(*(float(parameters[field.name]) for field in fields(cls)))

    @property
    def tolerance(self) -> float:
        """Largest closure residual of a closed leg, m."""
        return CLOSURE_TOLERANCE * (self.proximal_length + self.distal_length)

    @property
    def base_points(self) -> Array:
        """(3, 2) base hinges G in the base frame, m."""
        triangle = np.array([[0.0, 0.0], [np.sqrt(3.0), 0.0], [np.sqrt(3.0) / 2.0, 1.5]])
        return read_only(self.base_radius * triangle)

    @property
    def hinges(self) -> ComplexArray:
        """(3, 1) the same, complex."""
        return planar(self.base_points)[:, None]


@dataclass(frozen=True, eq=False)
class ThreeRrrLegs(Frozen):
    """The legs of the 3-RRR at sampled platform poses, in one working mode; each array is (3, N), vectors x + iy.

    Attributes:
        geometry: the lengths.
        arm: from the platform's centre to its corner, A - P = -l3 u(φ), m.
        b: proximal link B - G, m; NaN out of reach.
        e: distal link A - B, m; NaN out of reach.
        c: (A - G) x b, m²: minus l1 l2 times the sine of the elbow angle β - θ, zero at a type I
            singularity (Parsa 2014, eq. 2.37); its sign is the mode. NaN out of reach.
        residual: distance of the corner from the leg's reach, m; within reach the residual of
            |A - B| = l2 (a few roundings).
    """

    geometry: ThreeRrrGeometry
    arm: ComplexArray
    b: ComplexArray
    e: ComplexArray
    c: Array
    residual: Array

    @property
    def reachable(self) -> BoolArray:
        """(3, N) whether the leg reaches its corner, to within the closure tolerance."""
        return read_only(self.residual <= self.geometry.tolerance)

    @property
    def theta(self) -> Array:
        """(3, N) angle of the proximal link, rad, in (-π, π]."""
        return read_only(np.angle(self.b))

    @property
    def beta(self) -> Array:
        """(3, N) angle of the distal link, rad, in (-π, π]."""
        return read_only(np.angle(self.e))

    @property
    def margin(self) -> Array:
        """(3, N) |sin(β - θ)|: 0 where the leg is straight or folded (type I)."""
        return read_only(np.abs(self.c) / (self.geometry.proximal_length * self.geometry.distal_length))

    @property
    def jacobian(self) -> Array:
        """(3, 3, N) θ̇ of each leg per unit of each platform rate: -(a, b, d)/c (Parsa 2014, eq. 2.34-2.38)."""
        with np.errstate(divide="ignore", invalid="ignore"):
            rows = -self.e / self.c
        return read_only(np.stack([rows.real, rows.imag, (np.conj(self.arm) * rows).imag]))


def inverse_displacement(geometry: ThreeRrrGeometry, pose: ArrayLike, mode: Sequence[int] = (1, 1, 1)) -> ThreeRrrLegs:
    """Return the legs that put the platform at ``pose`` (Parsa 2014, eq. 2.18-2.27).

    With p = A - G, ρ = |p|, q = (l1² + ρ² - l2²)/2 and c = ± sqrt(l1² ρ² - q²), turning p by ±ψ gives
    b = (q p + c p⊥)/ρ². The root is twice the area of the triangle with sides l1, l2, ρ, taken in Heron's
    factored form: it keeps its digits next to a type I singularity.

    Args:
        geometry: the lengths.
        pose: (N, 3) platform centre and orientation (x, y, α) in the base frame, m and rad. NaN passes through.
        mode: sign of each leg.
    """
    sign, x = np.array(mode, dtype=float)[:, None], np.asarray(pose, dtype=float)
    l1, l2 = geometry.proximal_length, geometry.distal_length
    corners = -geometry.platform_radius * np.exp(1j * np.array(CORNER_ANGLES))
    arm = corners[:, None] * np.exp(1j * x[:, 2])
    span = planar(x) + arm - geometry.hinges
    rho_squared = span.real**2 + span.imag**2
    rho = np.sqrt(rho_squared)
    shortage = np.maximum(rho - (l1 + l2), abs(l1 - l2) - rho)
    sixteen_area_squared = (rho + (l1 + l2)) * ((l1 + l2) - rho) * (rho - (l1 - l2)) * (rho + (l1 - l2))
    c = sign * (0.5 * np.sqrt(np.maximum(sixteen_area_squared, 0.0)))
    out_of_reach = shortage > geometry.tolerance
    if out_of_reach.any():
        c[out_of_reach] = np.nan
    q = 0.5 * (rho_squared + (l1 - l2) * (l1 + l2))
    with np.errstate(divide="ignore", invalid="ignore"):  # ρ = 0: every direction closes the leg, and c = 0
        b = (q / rho_squared + 1j * (c / rho_squared)) * span
    e = span - b
    # fmax: the shortage where e is NaN
    residual = np.fmax(np.abs(np.sqrt(e.real**2 + e.imag**2) - l2), shortage)
    return ThreeRrrLegs(geometry, *map(read_only, (arm, b, e, c, residual)))


class ThreeRrrMechanism:
    """The 3-RRR in one working mode.

    The proximal link is a slender rod from the base hinge to the elbow. The distal link is one from the end of its tail
    to the platform; the tail is there for the carrier, so a robot without carriers has none. A platform inertia of
    "auto" is the inertia of a uniform disc.

    Args:
        parameters: parameters of the model ``3rrr``, kg and m.
        gravity: (3,) acceleration of gravity in the base frame, m/s².
        mode: sign of each leg in θ = γ ± ψ.
    """

    frames = (
        "base",
        *(f"{kind}_{leg}" for kind in ("proximal", "distal", "tip", "mass") for leg in (1, 2, 3)),
        *("platform_arm", "platform", "corner_2", "corner_3"),
    )
    joints = (*(f"{kind}_{leg}" for kind in ("base", "elbow", "carrier") for leg in (1, 2, 3)), "wrist_1")
    least_margin = SINGULAR_MARGIN  # of the sine of the elbow

    def __init__(self, parameters: Parameters, gravity: Sequence[float], mode: Sequence[int]) -> None:
        self.geometry = geometry = ThreeRrrGeometry.from_parameters(parameters)
        self.tolerance = geometry.tolerance
        self.gravity, self.mode = gravity, mode
        carriers, given = bool(parameters["carriers"]), parameters["platform_inertia"]
        l1, l2 = geometry.proximal_length, geometry.distal_length
        tail = float(parameters["tail_length"]) if carriers else 0.0
        proximal, distal, platform, carrier = (
            float(parameters[f"{kind}_mass"]) for kind in ("proximal", "distal", "platform", "carrier")
        )
        of_legs = (
            ("proximal", proximal, 0.5 * l1, proximal * l1**2 / 12.0),
            ("distal", distal, 0.5 * (l2 - tail), distal * (l2 + tail) ** 2 / 12.0),  # r_a from the elbow
            ("mass", carrier if carriers else 0.0, 0.0, 0.0),
        )
        disc = 0.5 * platform * geometry.platform_radius**2
        inertia = disc if given == "auto" else float(given)
        self.bodies = tuple(Body(f"{kind}_{leg}", *values) for kind, *values in of_legs for leg in (1, 2, 3))
        self.bodies += (Body("platform", platform, 0.0, inertia),)

    def legs(self, x: Array) -> ThreeRrrLegs:
        """Solve the inverse displacement at (N, 3) platform poses (x, y, α), m and rad."""
        return inverse_displacement(self.geometry, x, self.mode)

    def along(self, legs: ThreeRrrLegs, x: Array, xd: Array, xdd: Array) -> ThreeRrrAlongMotion:
        """Return the dynamics along a motion (N, 3) through poses whose legs are solved."""
        return ThreeRrrAlongMotion(self, legs, x, xd, xdd)


class ThreeRrrAlongMotion(PlanarDynamics):
    """Dynamics of the 3-RRR along one motion, whose poses, velocities and accelerations are (N, 3) each.

    The corner moves with v_A = v + α̇ (A - P)⊥ and a_A = a + α̈ (A - P)⊥ - α̇² (A - P). Since |A - B| = l2:
    e·(v_A - v_B) = 0 and e·(a_A - a_B) + l2² β̇² = 0, with v_B = θ̇ b⊥, a_B = θ̈ b⊥ - θ̇² b and e·b⊥ = -c.
    Across the distal link, l2² β̇ = e⊥·(v_A - v_B) and l2² β̈ = e⊥·(a_A - a_B) (Parsa 2014, eq. 2.28-2.38).
    """

    def __init__(
        self, mechanism: ThreeRrrMechanism, legs: ThreeRrrLegs, pose: Array, velocity: Array, acceleration: Array
    ) -> None:
        self.bodies, self.gravity, geometry = mechanism.bodies, mechanism.gravity, mechanism.geometry
        self.shape, self._geometry, v, a = (3, *legs.c.shape), geometry, velocity, acceleration
        b, e, across, over_length = legs.b, legs.e, np.conj(legs.e), 1.0 / geometry.distal_length**2
        corner_v = planar(v) + 1j * v[:, 2] * legs.arm
        corner_a = planar(a) + (1j * a[:, 2] - v[:, 2] ** 2) * legs.arm
        # along e and across it: the real and the imaginary part of ē z
        with np.errstate(divide="ignore", invalid="ignore"):
            over_c = -1.0 / legs.c
            w1 = (across * corner_v).real * over_c  # of the proximal link, θ̇; w2 of the distal one, β̇
            across_v = (across * (corner_v - 1j * w1 * b)).imag
            w2 = across_v * over_length
            pull = corner_a + w1**2 * b
            wd1 = ((across * pull).real + across_v * w2) * over_c
            wd2 = (across * (pull - 1j * wd1 * b)).imag * over_length
        # per unit of ẋ, ẏ, α̇: velocity of the corner (E_A of eq. 2.43), θ̇ (eq. 2.39) and β̇ (eq. 2.44)
        unit, unit_theta = np.ones(legs.c.shape), legs.jacobian
        corner = np.stack([unit, 1j * unit, 1j * legs.arm])
        unit_beta = (across * (corner - 1j * unit_theta * b)).imag * over_length
        hinge = fixed_frame(geometry.hinges + 0j * legs.c, 1.0, 3, moves=True)
        self._proximal = replace(hinge, axis=b / geometry.proximal_length, spin=w1, spin_rate=wd1, G=unit_theta)
        elbow = self._proximal.point(geometry.proximal_length)
        self._distal = replace(elbow, axis=e / geometry.distal_length, spin=w2, spin_rate=wd2, G=unit_beta)
        still = np.zeros(len(pose), dtype=np.complex128)
        H = np.stack([still + 1.0, still + 1j, still])
        G = np.stack([still.real, still.real, still.real + 1.0])
        centre = planar(pose), planar(v), planar(a)
        self._platform = PlanarFrame(*centre, np.exp(1j * pose[:, 2]), v[:, 2], a[:, 2], H, G)

    def frame(self, name: str, carriers: Carriers) -> PlanarFrame:
        """Return a link's frame."""
        if name == "base":
            return fixed_frame(np.zeros(self.shape[2], dtype=np.complex128), 1.0, 3)
        if name == "platform":
            return self._platform
        corners = {"platform_arm": 0, "corner_2": 1, "corner_3": 2}
        if name in corners:
            arm = -self._geometry.platform_radius * np.exp(1j * CORNER_ANGLES[corners[name]])
            return self._platform.point(complex(arm))
        kind, _, number = name.rpartition("_")
        leg = int(number) - 1
        if kind == "mass":
            return self._distal.carried(leg, 1.0, carriers)
        if kind == "proximal":
            return self._proximal.of(leg)
        distal = self._distal.of(leg)
        return distal if kind == "distal" else distal.point(self._geometry.distal_length)

    def joint(self, name: str, carriers: Carriers) -> PlanarJoint:
        """Return a joint's motion."""
        kind, _, number = name.rpartition("_")
        if kind == "carrier":
            leg, link = int(number) - 1, self.frame(f"distal_{number}", carriers)
            s, sd, sdd = (part[leg] for part in carriers)
            return PlanarJoint(s, sd, sdd, 0.0 * link.G, link, axis=link.axis, carrier=leg)
        before, after = {
            "base": ("base", f"proximal_{number}"),
            "elbow": (f"proximal_{number}", f"distal_{number}"),
            "wrist": (f"distal_{number}", "platform"),
        }[kind]
        return revolute(self.frame(before, carriers), self.frame(after, carriers))
