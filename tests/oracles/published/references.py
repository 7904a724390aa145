"""What the machines should do: published numbers, and equations of motion that know nothing of this package.

Where no digits are published the reference is Lagrange's equation in the few coordinates that closed forms leave, with
each body as seven point masses that have its mass, centre and inertia. Derivatives are exact: positions are analytic
functions, evaluated at complex arguments. scipy integrates.
"""

from __future__ import annotations

import numpy as np
from scipy.integrate import solve_ivp

from published.models import ANDREWS, ANDREWS_START, DRAKE_START

G = 9.81

ANDREWS_END = {
    "q": (0.1581077119629904e2, -0.1575637105984298e2, 0.4082224013073101e-1, -0.5347301163226948e0,
          0.5244099658805304e0, 0.5347301163226948e0, 0.1048080741042263e1),
    "v": (0.1139920302151208e4, -0.1424379294994111e4, 0.1103291221937134e2, 0.1929337464421385e2,
          0.5735699284790808e0, -0.1929337464421385e2, 0.3231791658026955e0),
}  # fmt: skip
"""β, Θ, γ, Φ, δ, Ω, ε at 0.03 s, rad and rad/s: Test Set for IVP Solvers (Mazzia, Magherini), by PSIDE at 1e-14."""


def andrews_acceleration(q, v, torque=0.033, stiffness=4530.0, rest=0.07785):
    """Accelerations by the equations as Hairer and Wanner print them: M q̈ + Gᵀ λ = f, G q̈ + Ġ q̇ = 0."""
    p, (s, c) = ANDREWS, (np.sin, np.cos)
    be, th, ga, ph, de, om, ep = q
    bed, thd, gad, phd, ded, omd, epd = v
    rr, d, ss, e, zt, zf, u = (p[name] for name in ("rr", "d", "ss", "e", "zt", "zf", "u"))
    k, h, da = e - p["ea"], zf - p["fa"], p["da"]
    M = np.zeros((7, 7))
    M[0, 0] = p["m1"] * p["ra"] ** 2 + p["m2"] * (rr**2 - 2 * da * rr * c(th) + da**2) + p["i1"] + p["i2"]
    M[0, 1] = M[1, 0] = p["m2"] * (da**2 - da * rr * c(th)) + p["i2"]
    M[1, 1] = p["m2"] * da**2 + p["i2"]
    M[2, 2] = p["m3"] * (p["sa"] ** 2 + p["sb"] ** 2) + p["i3"]
    M[3, 3] = p["m4"] * k**2 + p["i4"]
    M[3, 4] = M[4, 3] = p["m4"] * (k**2 + zt * k * s(ph)) + p["i4"]
    M[4, 4] = (
        p["m4"] * (zt**2 + 2 * zt * k * s(ph) + k**2) + p["m5"] * (p["ta"] ** 2 + p["tb"] ** 2) + p["i4"] + p["i5"]
    )
    M[5, 5] = p["m6"] * h**2 + p["i6"]
    M[5, 6] = M[6, 5] = p["m6"] * (h**2 - u * h * s(om)) + p["i6"]
    M[6, 6] = p["m6"] * (h**2 - 2 * u * h * s(om) + u**2) + p["m7"] * (p["ua"] ** 2 + p["ub"] ** 2) + p["i6"] + p["i7"]
    x = p["sd"] * c(ga) + p["sc"] * s(ga) - 0.03635 - 0.014
    y = p["sd"] * s(ga) - p["sc"] * c(ga) + 0.03273 - 0.072
    pull = -stiffness * (1.0 - rest / np.hypot(x, y))
    f = np.array([
        torque - p["m2"] * da * rr * thd * (thd + 2 * bed) * s(th),
        p["m2"] * da * rr * bed**2 * s(th),
        pull * (x * (p["sc"] * c(ga) - p["sd"] * s(ga)) + y * (p["sd"] * c(ga) + p["sc"] * s(ga))),
        p["m4"] * zt * k * ded**2 * c(ph),
        -p["m4"] * zt * k * phd * (phd + 2 * ded) * c(ph),
        -p["m6"] * u * h * epd**2 * c(om),
        p["m6"] * u * h * omd * (omd + 2 * epd) * c(om),
    ])  # fmt: skip
    bt, pd, oe = be + th, ph + de, om + ep
    J, bias = np.zeros((6, 7)), np.zeros(6)
    J[0::2, 0], J[0::2, 1] = -rr * s(be) + d * s(bt), d * s(bt)
    J[1::2, 0], J[1::2, 1] = rr * c(be) - d * c(bt), -d * c(bt)
    J[0, 2], J[1, 2] = -ss * c(ga), -ss * s(ga)
    J[2, 3:5], J[3, 3:5] = (-e * c(pd), -e * c(pd) + zt * s(de)), (-e * s(pd), -e * s(pd) - zt * c(de))
    J[4, 5:], J[5, 5:] = (zf * s(oe), zf * s(oe) - u * c(ep)), (-zf * c(oe), -zf * c(oe) - u * s(ep))
    bias[0::2] = -rr * c(be) * bed**2 + d * c(bt) * (bed + thd) ** 2
    bias[1::2] = -rr * s(be) * bed**2 + d * s(bt) * (bed + thd) ** 2
    bias += gad**2 * np.array([ss * s(ga), -ss * c(ga), 0, 0, 0, 0])
    bias += (phd + ded) ** 2 * np.array([0, 0, e * s(pd), -e * c(pd), 0, 0])
    bias += ded**2 * np.array([0, 0, zt * c(de), zt * s(de), 0, 0])
    bias += (omd + epd) ** 2 * np.array([0, 0, 0, 0, zf * c(oe), zf * s(oe)])
    bias += epd**2 * np.array([0, 0, 0, 0, u * s(ep), -u * c(ep)])
    return np.linalg.solve(np.block([[M, J.T], [J, np.zeros((6, 6))]]), np.concatenate([f, -bias]))[:7]


def andrews_end(t=0.03):
    """q and v (7,) at a time, by these equations."""
    start = np.append(ANDREWS_START, np.zeros(7))
    rate = lambda t, y: np.append(y[7:], andrews_acceleration(y[:7], y[7:]))  # noqa: E731
    return np.split(solve_ivp(rate, (0.0, t), start, "DOP853", rtol=1e-13, atol=1e-14).y[:, -1], 2)


def body(mass, inertia, centre=(0.0, 0.0, 0.0)):
    """Seven point masses of a body with this principal inertia about its centre: masses (7,), places (7, 3)."""
    inertia = np.array(inertia, dtype=float)
    reach = np.sqrt(3.0 * np.maximum(0.5 * inertia.sum() - inertia, 0.0) / mass)
    arms = np.concatenate([np.diag(reach), -np.diag(reach), np.zeros((1, 3))])
    return np.append(np.full(6, mass / 6.0), 0.0), arms + np.array(centre)


CIRCLE = np.exp(2j * np.pi * np.arange(16) / 16)
RADIUS = 0.05


class Lagrange:
    """Equations of motion of point masses: ``place`` gives (P, 3) positions of (n,) coordinates, complex ones too."""

    def __init__(self, mass, place, gravity, force=lambda q, v: 0.0):
        self.mass, self.place, self.gravity, self.force = mass, place, np.array(gravity), force

    def jacobian(self, q):
        steps = 1e-30j * np.eye(len(q))
        return np.stack([self.place(q + step).imag / 1e-30 for step in steps], axis=-1)  # (P, 3, n)

    def acceleration(self, q, v):
        J, speed = self.jacobian(q), np.linalg.norm(v)
        direction = v / speed if speed else v
        around = np.mean([self.place(q + RADIUS * z * direction) / z**2 for z in CIRCLE], axis=0)
        bias = 2.0 * around.real / RADIUS**2 * speed**2  # second derivative along the motion
        weighted = self.mass[:, None, None] * J
        M = np.einsum("pia,pib->ab", weighted, J)
        return np.linalg.solve(M, np.einsum("pia,pi->a", weighted, self.gravity - bias) + self.force(q, v))

    def motion(self, q, v, times, method="DOP853", rtol=1e-12, atol=1e-13):
        n = len(q)
        rate = lambda t, y: np.append(y[n:], self.acceleration(y[:n], y[n:]))  # noqa: E731
        integrated = solve_ivp(rate, (times[0], times[-1]), np.append(q, v), method, times, rtol=rtol, atol=atol)
        return integrated.y[:n].T


def unit(vector):
    return vector / np.sqrt((vector**2).sum())


def turn(axis, angle):
    """Rotation about an axis of the frame by a complex angle."""
    i, j, k = np.roll(range(3), -"xyz".index(axis))
    R = np.zeros((3, 3), dtype=complex)
    R[i, i], R[j, j], R[k, k], R[j, k], R[k, j] = 1.0, np.cos(angle), np.cos(angle), -np.sin(angle), np.sin(angle)
    return R


def slider_crank(times):
    """Positions (N,) of Haug's slider, from rest angle 0 at 6 rad/s: one coordinate, the crank's angle."""
    parts = [
        body(0.12, (1e-4, 1e-4, 1e-5), (0, 0, 0.04)),
        body(0.5, (4e-4, 4e-3, 4e-3), (0.15, 0, 0)),  # along x from the slider
        (np.array([2.0]), np.zeros((1, 3))),
    ]

    def ends(q):
        crank = turn("x", q[0])
        ball = crank @ [0.0, 0.0, 0.08] + [0.0, 0.1, 0.12]
        return crank, ball, np.array([np.sqrt(0.09 - ball[1] ** 2 - ball[2] ** 2), 0.0, 0.0])

    def place(q):
        crank, ball, slider = ends(q)
        along = (ball - slider) / 0.3
        across = unit(np.cross([1.0, 0.0, 0.0], along))  # what the universal joint keeps normal to the rod and the rail
        rod = np.stack([along, across, np.cross(along, across)], axis=1)
        places = (parts[0][1] @ crank.T + [0.0, 0.1, 0.12], parts[1][1] @ rod.T + slider, parts[2][1] + slider)
        return np.concatenate(places)

    lagrange = Lagrange(np.concatenate([mass for mass, _ in parts]), place, (0, 0, -G))
    angles = lagrange.motion(np.zeros(1), np.array([6.0]), times)
    return np.array([ends(angle)[2][0] for angle in angles]).real


def drake(times, rate):
    """Angle of link A (N,) from the isosceles trapezoid: one coordinate; B and C meet where two circles cross."""
    mass, local = body(20.0, (0.08333333333333334, 29.46666666666666, 29.416666666666668), (2.0, 0, 0))

    def place(q):
        tip = 4.0 * np.array([np.cos(q[0]), 0.0, -np.sin(q[0])])
        pivot = np.array([-2.0, 0.0, 0.0])
        apart = pivot - tip
        square = (apart**2).sum()
        normal = np.array([-apart[2], 0.0, apart[0]])  # which of the two points: that of the start
        meet = 0.5 * (tip + pivot) + normal * np.sqrt(16.0 / square - 0.25)
        frames = []
        for origin, end in ((np.zeros(3), tip), (tip, meet), (pivot, meet)):
            x = (end - origin) / 4.0
            frames.append((origin, np.stack([x, [0.0, 1.0, 0.0], np.cross(x, [0.0, 1.0, 0.0])], axis=1)))
        return np.concatenate([local @ R.T + origin for origin, R in frames])

    return Lagrange(np.tile(mass, 3), place, (0, 0, -G)).motion(np.array([DRAKE_START]), np.array([rate]), times)[:, 0]


def parallel_cranks(times, start, rate, count, crank=1.0, mass=(1.0, 1.0), height=0.0):
    """Angle of the cranks (N,) of parallelograms in a row: couplers stay level, so that it is one pendulum."""
    inertia = (count + 1) * mass[0] * (crank**2 / 3.0 + height**2 / 12.0) + count * mass[1] * crank**2
    moment = G * crank * ((count + 1) * mass[0] / 2.0 + count * mass[1])
    rates = lambda t, y: [y[1], -moment / inertia * np.cos(y[0])]  # noqa: E731
    return solve_ivp(rates, (times[0], times[-1]), [start, rate], "DOP853", times, rtol=1e-12, atol=1e-13).y[0]


def governor(times, rate):
    """Height of the slider (N,): height and the angle of both arms below the level; the angular momentum stays."""
    ball, arm, slider, thin, across = 5.0, 0.3, 3.0, 0.025 * 2e-4, 0.025 * 1.0001
    fixed = 0.025 * 2e-4 + 0.005

    def about_shaft(a):
        c, s = np.cos(a), np.sin(a)
        inertia = ball * (0.05 + c) ** 2 + arm * (0.05 + 0.5 * c) ** 2 + across * c**2 + thin * s**2
        slope = -2 * s * (ball * (0.05 + c) + 0.5 * arm * (0.05 + 0.5 * c)) - 2 * s * c * (across - thin)
        return fixed + 2 * inertia, 2 * slope

    momentum = about_shaft(np.pi / 6)[0] * rate

    def rates(t, y):
        s, a, sd, ad = y
        x, z = 0.5 * np.cos(a), 1.0 - 0.5 * np.sin(a) - s
        length = np.hypot(x, z)
        by_s, by_a = -z / length, (-0.5 * np.sin(a) * x - 0.5 * np.cos(a) * z) / length
        force = -2.0 * (8e5 * (length - 0.5) + 4e4 * (by_s * sd + by_a * ad))
        inertia, slope = about_shaft(a)
        weight = 2 * G * (ball + 0.5 * arm) * np.cos(a)
        swing = (0.5 * slope * (momentum / inertia) ** 2 + weight + force * by_a) / (2 * (ball + arm / 4 + across))
        return [sd, ad, -G + force * by_s / slider, swing]

    start = [0.5, np.pi / 6, 0.0, 0.0]
    return solve_ivp(rates, (times[0], times[-1]), start, "Radau", times, rtol=1e-11, atol=1e-12).y[0]


def bricard(times):
    """First hinge angle (N,), from rest: (1 + sin a)(1 + sin b) = 1 leaves one coordinate of hinges a, b, a, b, …"""
    steps = [("y", (1, 0, 0)), ("z", (0, -1, 0)), ("x", (0, 0, 1)), ("y", (-1, 0, 0)), ("z", (0, 1, 0))]
    bodies = [body(1.0, (1.0 + 0.01 - (1.0 - 0.01) * np.abs(step)) / 12.0, 0.5 * np.array(step)) for _, step in steps]

    def place(q):
        a, b = q[0], np.arcsin(-np.sin(q[0]) / (1.0 + np.sin(q[0])))
        R, origin, places = np.eye(3), np.zeros(3), []
        for (axis, step), angle, (_, local) in zip(steps, (a, b, a, b, a), bodies, strict=True):
            R = R @ turn(axis, angle)
            places.append(local @ R.T + origin)
            origin = origin + R @ np.array(step)
        return np.concatenate(places)

    lagrange = Lagrange(np.concatenate([mass for mass, _ in bodies]), place, (0, -G, 0))
    return lagrange.motion(np.zeros(1), np.zeros(1), times, rtol=1e-11, atol=1e-12)[:, 0]
