"""Planar mechanisms with carriers from first principles, symbolic: positions are written down, casadi does the rest.

Nothing here knows the package. A body has a mass, an inertia, a position and an angle as functions of the platform
coordinates x and the carriers' s; the kinetic energy is differentiated into Lagrange's equation for x,

    d/dt ∂T/∂ẋ − ∂T/∂x = (∂q/∂x)ᵀ τ,

with q the actuated joints (no gravity). Angles are those of ``atan2`` and the law of cosines.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi
import numpy as np

SX = casadi.SX


@dataclass(frozen=True)
class Mechanism:
    """Functions of one mechanism; n coordinates, m actuators, k carriers.

    ``balance`` (x, ẋ, ẍ, s, ṡ, s̈, τ) → (n,) residual of Lagrange's equation; ``rate`` of the same and x⃛, s⃛ → its total
    time derivative at constant τ; ``actuation`` x → (n, m) (∂q/∂x)ᵀ.
    """

    n: int
    m: int
    k: int
    balance: casadi.Function
    rate: casadi.Function
    actuation: casadi.Function


def _u(angle):
    return casadi.vertcat(casadi.cos(angle), casadi.sin(angle))


def _n(angle):
    return casadi.vertcat(-casadi.sin(angle), casadi.cos(angle))


def mechanism(n, k, bodies, joints):
    """From ``bodies(x, s)`` → [(mass, inertia, position, angle)] and ``joints(x)`` → (m,) q."""
    x, xd, xdd, xddd = (SX.sym(name, n) for name in ("x", "xd", "xdd", "xddd"))
    s, sd, sdd, sddd = (SX.sym(name, k) for name in ("s", "sd", "sdd", "sddd"))
    q = joints(x)
    tau = SX.sym("tau", q.numel())
    energy = 0
    for mass, inertia, position, angle in bodies(x, s):
        v = casadi.jtimes(position, casadi.vertcat(x), xd) + casadi.jtimes(position, s, sd)
        energy += 0.5 * mass * casadi.dot(v, v)
        if inertia:
            energy += 0.5 * inertia * casadi.jtimes(angle, x, xd) ** 2
    momentum = casadi.gradient(energy, xd)
    state, state_rate = casadi.vertcat(x, xd, s, sd), casadi.vertcat(xd, xdd, sd, sdd)
    W = casadi.jacobian(q, x).T
    residual = casadi.jtimes(momentum, state, state_rate) - casadi.gradient(energy, x) - W @ tau
    rate = casadi.jtimes(residual, casadi.vertcat(x, xd, xdd, s, sd, sdd), casadi.vertcat(xd, xdd, xddd, sd, sdd, sddd))
    return Mechanism(
        n,
        q.numel(),
        k,
        casadi.Function("balance", [x, xd, xdd, s, sd, sdd, tau], [residual]),
        casadi.Function("rate", [x, xd, xdd, xddd, s, sd, sdd, sddd, tau], [rate]),
        casadi.Function("actuation", [x], [W]),
    )


def two_rpr(
    base_distance=0.5,
    track_offset=0.1,
    carrier_mass=1.0,
    end_effector_mass=0.0,
    cylinder_mass=0.0,
    cylinder_length=0.3,
    piston_mass=0.0,
    piston_length=0.3,
    arm=None,
):
    """Two legs that lengthen; ``arm``: length of a turning arm that carries the mass in place of a track."""
    hinges = [np.zeros(2), np.array([base_distance, 0.0])]
    sides = (1.0, -1.0)

    def bodies(x, s):
        bodies = [(end_effector_mass, 0.0, x, None)]
        for i, hinge in enumerate(hinges):
            along = x - hinge
            angle = casadi.atan2(along[1], along[0])
            u = _u(angle)
            if arm is None:
                place = hinge + track_offset * u + sides[i] * s[i] * _n(angle)
            else:
                place = hinge + track_offset * u + arm * _n(angle + sides[i] * s[i])
            bodies += [
                (carrier_mass, 0.0, place, None),
                (cylinder_mass, cylinder_mass * cylinder_length**2 / 12, hinge + cylinder_length / 2 * u, angle),
                (piston_mass, piston_mass * piston_length**2 / 12, x - piston_length / 2 * u, angle),
            ]
        return bodies

    return mechanism(2, 2, bodies, lambda x: casadi.vertcat(*(casadi.norm_2(x - hinge) for hinge in hinges)))


def _elbow(hinge, tip, l1, l2, mode):
    """Angle of the proximal link: that of the tip plus (mode +1) or minus what the law of cosines says."""
    along = tip - hinge
    reach = casadi.dot(along, along)
    opening = casadi.acos((l1**2 + reach - l2**2) / (2 * l1 * casadi.sqrt(reach)))
    return casadi.atan2(along[1], along[0]) + mode * opening


def _leg(hinge, tip, l1, l2, mode, proximal_mass, distal_mass, tail, carrier_mass, s):
    theta = _elbow(hinge, tip, l1, l2, mode)
    elbow = hinge + l1 * _u(theta)
    along = tip - elbow
    beta = casadi.atan2(along[1], along[0])
    rod = l2 + tail
    return [
        (proximal_mass, proximal_mass * l1**2 / 12, hinge + l1 / 2 * _u(theta), theta),
        (distal_mass, distal_mass * rod**2 / 12, elbow + (l2 - tail) / 2 * along / l2, beta),
        (carrier_mass, 0.0, elbow + s * along / l2, None),
    ]


def three_rrr(
    mode=(1, 1, 1),
    base_radius=1.0,
    platform_radius=0.25,
    proximal_length=1.0,
    distal_length=1.0,
    tail_length=1.0,
    proximal_mass=1.0,
    distal_mass=1.0,
    platform_mass=0.5,
    carrier_mass=3.0,
):
    hinges = [base_radius * np.array(at) for at in ((0.0, 0.0), (np.sqrt(3), 0.0), (np.sqrt(3) / 2, 1.5))]
    phases = (np.pi / 6, 5 * np.pi / 6, -np.pi / 2)

    def tip(x, i):
        return x[:2] - platform_radius * _u(x[2] + phases[i])

    def bodies(x, s):
        bodies = [(platform_mass, 0.5 * platform_mass * platform_radius**2, x[:2], x[2])]
        for i, hinge in enumerate(hinges):
            bodies += _leg(
                hinge,
                tip(x, i),
                proximal_length,
                distal_length,
                mode[i],
                proximal_mass,
                distal_mass,
                tail_length,
                carrier_mass,
                s[i],
            )
        return bodies

    def joints(x):
        return casadi.vertcat(
            *(_elbow(hinges[i], tip(x, i), proximal_length, distal_length, mode[i]) for i in range(3))
        )

    return mechanism(3, 3, bodies, joints)


def five_bar(
    mode=(1, -1),
    base_distance=0.5,
    proximal_length=0.5,
    distal_length=0.5,
    tail_length=0.5,
    proximal_mass=0.5,
    distal_mass=0.5,
    end_effector_mass=0.2,
    carrier_mass=1.0,
):
    hinges = [np.zeros(2), np.array([base_distance, 0.0])]

    def bodies(x, s):
        bodies = [(end_effector_mass, 0.0, x, None)]
        for i, hinge in enumerate(hinges):
            bodies += _leg(
                hinge,
                x,
                proximal_length,
                distal_length,
                mode[i],
                proximal_mass,
                distal_mass,
                tail_length,
                carrier_mass,
                s[i],
            )
        return bodies

    def joints(x):
        return casadi.vertcat(*(_elbow(hinges[i], x, proximal_length, distal_length, mode[i]) for i in range(2)))

    return mechanism(2, 2, bodies, joints)
