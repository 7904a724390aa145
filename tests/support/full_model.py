"""Whole-trajectory plans found another way, on the nodes of a plan: what the planner's optimum is judged by.

For the 2-RPR the model is its closed form, written out in casadi and differentiated by it. For any other robot without
a singularity on the way it is a backend, asked at every iteration of scipy's SLSQP, with τ = W⁻¹ f and the carriers'
accelerations as the only unknowns.
"""

from __future__ import annotations

import casadi
import numpy as np
from leg_momentum import OFFSET, SIGMA, legs_along
from scipy.optimize import LinearConstraint, minimize

from redundancy_pin import CarrierMotion, distribute

REGULARISATION = 1e-6
EPSILON = 1e-5
"""Time from a singular instant at which its closed form is differenced, s."""


def weights_of(t):
    half = 0.5 * np.diff(t)
    return np.append(half, 0.0) + np.append(0.0, half)


def integration(t):
    """Matrices (M, M) that take s̈ at the nodes to ṡ and s (rest at 0 at the start)."""
    rate, place = np.zeros((len(t), len(t))), np.zeros((len(t), len(t)))
    for i, h in enumerate(np.diff(t)):
        rate[i + 1], place[i + 1] = rate[i], place[i] + h * rate[i]
        rate[i + 1, [i, i + 1]] += h / 2.0
        place[i + 1, i] += h * h / 3.0
        place[i + 1, i + 1] += h * h / 6.0
    return rate, place


def hull(t, rate, place):
    """Matrices whose rows, times s̈, must keep the limits of ṡ and s: nodes and inner Bézier points."""
    h = np.diff(t)[:, None]
    eye = np.eye(len(t))
    speeds = np.vstack([rate, rate[:-1] + h * eye[:-1] / 2.0])
    places = np.vstack([place, place[:-1] + h * rate[:-1] / 3.0, place[1:] - h * rate[1:] / 3.0])
    return speeds, places


def balance_2rpr(legs, i, s, v, a, tau):
    """(2,) Σ u τ − Σ n h / d of the massless 2-RPR with 1 kg carriers, symbolic in the carriers."""
    total = [0.0, 0.0]
    for leg in range(2):
        h = (
            (OFFSET**2 + s[leg] ** 2) * legs.acceleration[i, leg]
            + 2.0 * s[leg] * v[leg] * legs.rate[i, leg]
            + SIGMA[leg] * OFFSET * a[leg]
        )
        for axis in range(2):
            total[axis] += legs.u[i, leg, axis] * tau[leg] - legs.n[i, leg, axis] * h / legs.d[i, leg]
    return total


def solve_2rpr(trajectory, plan, objective, limits):
    """Return the objective of the best plan from rest at 0 to rest at 0 on the nodes of ``plan``."""
    t, k = plan.t, 2
    nodes = len(t)
    A = casadi.SX.sym("a", nodes, k)
    tau = casadi.SX.sym("tau", nodes, k)
    top = casadi.SX.sym("top")
    S, V = casadi.SX.sym("s", nodes, k), casadi.SX.sym("v", nodes, k)
    h = casadi.repmat(casadi.DM(np.diff(t)), 1, k)
    g, low, high = [], [], []

    def require(expression, lower, upper):
        g.append(casadi.vec(expression))
        low.extend([lower] * expression.numel())
        high.extend([upper] * expression.numel())

    s0, s1, v0, v1, a0, a1 = S[:-1, :], S[1:, :], V[:-1, :], V[1:, :], A[:-1, :], A[1:, :]
    require(s1 - (s0 + h * v0 + h * h * (2.0 * a0 + a1) / 6.0), 0.0, 0.0)
    require(v1 - (v0 + h * (a0 + a1) / 2.0), 0.0, 0.0)
    require(v0 + h * a0 / 2.0, -limits["speed"], limits["speed"])
    require(casadi.vertcat(s0 + h * v0 / 3.0, s1 - h * v1 / 3.0), -limits["track"], limits["track"])
    require(casadi.vertcat(S[0, :], V[0, :]), 0.0, 0.0)
    require(V[-1, :], 0.0, 0.0)
    require(S[-1, :], 0.0, 0.0)
    legs = legs_along(plan.motion.x, plan.motion.xd, plan.motion.xdd)
    for i in range(nodes):
        row = balance_2rpr(legs, i, *(casadi.vertsplit(part[i, :].T) for part in (S, V, A, tau)))
        require(casadi.vertcat(*row), 0.0, 0.0)
    for i in plan.diagnostics["smooth_nodes"]:
        before, after = t[i] - t[i - 1], t[i + 1] - t[i]
        require((A[i, :] - A[i - 1, :]) / before - (A[i + 1, :] - A[i, :]) / after, 0.0, 0.0)
    for i in plan.diagnostics["singular_nodes"]:
        jerk = (A[i + 1, :] - A[i, :]) / (t[i + 1] - t[i])
        u = legs.n[i, 0]  # across both legs: the direction that no slide acts in
        sides = []
        for e in (-EPSILON, EPSILON):
            point = trajectory.sample_at(np.array([t[i] + e]))
            beside = legs_along(point.x, point.xd, point.xdd)
            s = S[i, :] + e * V[i, :] + e**2 / 2.0 * A[i, :] + e**3 / 6.0 * jerk
            v, a = V[i, :] + e * A[i, :] + e**2 / 2.0 * jerk, A[i, :] + e * jerk
            row = balance_2rpr(beside, 0, *(casadi.vertsplit(part.T) for part in (s, v, a, tau[i, :])))
            sides.append(u[0] * row[0] + u[1] * row[1])
        require((sides[1] - sides[0]) / (2.0 * EPSILON), 0.0, 0.0)
    w = casadi.DM(weights_of(t))
    duration = t[-1] - t[0]
    gentle = REGULARISATION * casadi.sum1(casadi.sum2(A**2) * w) / limits["acceleration"] ** 2 / duration
    size = float(np.abs(plan.tau).max())
    if objective == "peak":
        require(tau - top, -np.inf, 0.0)
        require(tau + top, 0.0, np.inf)
        cost = top / size
    else:
        cost = casadi.sum1(casadi.sum2(tau**2) * w) / duration / size**2
    x = casadi.vertcat(casadi.vec(A), casadi.vec(tau), casadi.vec(V), casadi.vec(S), top)
    most = (limits["acceleration"], np.inf, limits["speed"], limits["track"])
    bound = np.append(np.repeat(most, nodes * k), np.inf)
    solver = casadi.nlpsol(
        "oracle",
        "ipopt",
        {"x": x, "f": cost + gentle, "g": casadi.vertcat(*g)},
        {"ipopt.print_level": 0, "ipopt.sb": "yes", "print_time": False, "ipopt.tol": 1e-8},
    )
    optimum = np.asarray(solver(x0=0.0, lbx=-bound, ubx=bound, lbg=low, ubg=high)["x"]).ravel()
    assert solver.stats()["success"]
    effort = optimum[nodes * k : 2 * nodes * k]
    if objective == "peak":
        return float(np.abs(effort).max())
    return float((np.tile(weights_of(t), k) * effort**2).sum())


def solve_by_backend(dynamics, plan, objective, limits):
    """Return the objective of the best plan from rest at 0 to rest at 0, by SLSQP on the backend."""
    t, k = plan.t, dynamics.robot.k
    nodes = len(t)
    rate, place = (np.kron(matrix, np.eye(k)) for matrix in integration(t))
    speeds, places = (np.kron(matrix, np.eye(k)) for matrix in hull(t, *integration(t)))
    along = dynamics.along(plan.motion)
    w = weights_of(t)[:, None]
    size = float(np.abs(plan.tau).max())

    def efforts(a):
        carriers = CarrierMotion(*(part.reshape(nodes, k) for part in (place @ a, rate @ a, a)))
        reduced, slopes = along.reduce(carriers), along.carrier_derivatives(carriers)
        maps = [np.linalg.solve(reduced.W, part) for part in (slopes.f_s, slopes.f_sd, slopes.f_sdd)]
        eye = np.eye(nodes * k)
        jacobian = sum(
            np.einsum("nmk,nkx->nmx", part, matrix.reshape(nodes, k, -1))
            for part, matrix in zip(maps, (place, rate, eye), strict=True)
        )
        return distribute(reduced).tau / size, jacobian / size

    linear = [
        LinearConstraint(speeds, -limits["speed"], limits["speed"]),
        LinearConstraint(places, -limits["track"], limits["track"]),
        LinearConstraint(np.vstack([rate[-k:], place[-k:]]), 0.0, 0.0),
    ]
    bounds = [(-limits["acceleration"], limits["acceleration"])] * (nodes * k)
    options = {"maxiter": 500, "ftol": 1e-9}
    if objective == "effort":

        def cost(a):
            tau, jacobian = efforts(a)
            return float((w * tau**2).sum()), 2.0 * np.einsum("nm,nmx->x", w * tau, jacobian)

        optimum = minimize(
            cost, np.zeros(nodes * k), jac=True, bounds=bounds, constraints=linear, method="SLSQP", options=options
        )
        assert optimum.success, optimum.message
        return float(optimum.fun) * size**2
    padded = [LinearConstraint(np.hstack([part.A, np.zeros((len(part.A), 1))]), part.lb, part.ub) for part in linear]

    def room(x):
        tau = efforts(x[:-1])[0].ravel()
        return np.concatenate([x[-1] - tau, x[-1] + tau])

    def room_slope(x):
        jacobian = efforts(x[:-1])[1].reshape(-1, nodes * k)
        one = np.ones((len(jacobian), 1))
        return np.vstack([np.hstack([-jacobian, one]), np.hstack([jacobian, one])])

    last = np.append(np.zeros(nodes * k), 1.0)
    optimum = minimize(
        lambda x: x[-1],
        np.append(np.zeros(nodes * k), np.abs(efforts(np.zeros(nodes * k))[0]).max()),
        jac=lambda x: last,
        bounds=[*bounds, (0.0, None)],
        constraints=[*padded, {"type": "ineq", "fun": room, "jac": room_slope}],
        method="SLSQP",
        options=options,
    )
    assert optimum.success, optimum.message
    return float(optimum.fun) * size
