"""Whole-trajectory plans by IPOPT on a symbolic mechanism: every derivative is casadi's own, every condition its own.

The unknowns s̈, ṡ, s and τ stand at the nodes of a plan. What this shares with the planner are those nodes, the places
where the jerk is to be continuous, and that s̈ is linear in a step. At a singular node the direction u without effect of
the actuators comes from the mechanism's own ∂q/∂x, and the condition on τ is uᵀ times the total time derivative of
Lagrange's equation, by symbolic differentiation along the motion.
"""

from __future__ import annotations

import casadi
import numpy as np

REGULARISATION = 1e-6
EPSILON = 1e-4
"""Time over which ẍ is differenced for x⃛, s; the references are smooth there, so the error is of the order of 1e-8."""


def _weights(t):
    half = 0.5 * np.diff(t)
    return np.append(half, 0.0) + np.append(0.0, half)


def _jerk_of_the_platform(trajectory, t):
    before, after = (trajectory.sample_at(np.array([t + e])).xdd[0] for e in (-EPSILON, EPSILON))
    return (after - before) / (2.0 * EPSILON)


def solve(machine, trajectory, plan, objective, limits, tolerance=1e-8, end="datum"):
    """Return (objective of the best plan from rest at 0, by default to rest at 0; τ, s) on the nodes of ``plan``.

    ``limits``: acceleration, speed, track (half length, or both ends); where it has them, jerk and effort.
    """
    t, k, nodes = plan.t, machine.k, len(plan.t)
    ends = np.broadcast_to(limits["track"], 2) * (np.array([-1.0, 1.0]) if np.ndim(limits["track"]) == 0 else 1.0)
    size = float(np.abs(plan.tau).max())
    A, V, S = (casadi.MX.sym(name, k, nodes) for name in "AVS")
    tau, top = casadi.MX.sym("tau", machine.m, nodes), casadi.MX.sym("top")
    g, low, high = [], [], []

    def require(expression, lower, upper):
        g.append(casadi.vec(expression))
        low.append(np.broadcast_to(lower, expression.shape).ravel(order="F"))
        high.append(np.broadcast_to(upper, expression.shape).ravel(order="F"))

    h = casadi.repmat(casadi.DM(np.diff(t)).T, k, 1)
    s0, s1, v0, v1, a0, a1 = S[:, :-1], S[:, 1:], V[:, :-1], V[:, 1:], A[:, :-1], A[:, 1:]
    require(s1 - (s0 + h * v0 + h * h * (2.0 * a0 + a1) / 6.0), 0.0, 0.0)
    require(v1 - (v0 + h * (a0 + a1) / 2.0), 0.0, 0.0)
    inner = [int(i) for i in np.flatnonzero(np.diff(t) > 0.0)]
    require((v0 + h * a0 / 2.0)[:, inner], -limits["speed"], limits["speed"])
    require((s0 + h * v0 / 3.0)[:, inner], *ends)
    require((s1 - h * v1 / 3.0)[:, inner], *ends)
    if "jerk" in limits:
        require(((a1 - a0) / h)[:, inner], -limits["jerk"], limits["jerk"])
    ends_at = {
        "datum": (S[:, -1], V[:, -1]),
        "rest": (V[:, -1],),
        "periodic": tuple(part[:, -1] - part[:, 0] for part in (S, V, A)),
        "free": (),
    }
    for part in (S[:, 0], V[:, 0], *ends_at[end]):
        require(part, 0.0, 0.0)
    x, xd, xdd = (casadi.DM(part.T) for part in (plan.motion.x, plan.motion.xd, plan.motion.xdd))
    require(machine.balance.map(nodes)(x, xd, xdd, S, V, A, size * tau) / size, 0.0, 0.0)
    for i in plan.diagnostics["smooth_nodes"]:
        before, after = t[i] - t[i - 1], t[i + 1] - t[i]
        require(((A[:, i] - A[:, i - 1]) * after - (A[:, i + 1] - A[:, i]) * before) / (before + after), 0.0, 0.0)
    for i in plan.diagnostics["singular_nodes"]:
        jerk = (A[:, i + 1] - A[:, i]) / (t[i + 1] - t[i])
        u = np.linalg.svd(np.asarray(machine.actuation(plan.motion.x[i])))[0][:, -1]
        rate = machine.rate(
            x[:, i],
            xd[:, i],
            xdd[:, i],
            _jerk_of_the_platform(trajectory, float(t[i])),
            S[:, i],
            V[:, i],
            A[:, i],
            jerk,
            size * tau[:, i],
        )
        require(casadi.DM(u).T @ rate / size, 0.0, 0.0)
    w = casadi.DM(_weights(t)).T
    duration = t[-1] - t[0]
    gentle = REGULARISATION * casadi.sum2(casadi.sum1(A**2) * w) / limits["acceleration"] ** 2 / duration
    if objective == "peak":
        require(tau - top, -np.inf, 0.0)
        require(tau + top, 0.0, np.inf)
        cost = top
    else:
        cost = casadi.sum2(casadi.sum1(tau**2) * w) / duration
    unknowns = casadi.vertcat(casadi.vec(A), casadi.vec(tau), casadi.vec(V), casadi.vec(S), top)
    efforts = np.full(machine.m * nodes, limits.get("effort", np.inf) / size)

    def bounds(track, sign):
        parts = [np.full(k * nodes, sign * limits[name]) for name in ("acceleration", "speed")]
        return np.concatenate([parts[0], sign * efforts, parts[1], np.full(k * nodes, track), [sign * np.inf]])

    solver = casadi.nlpsol(
        "oracle",
        "ipopt",
        {"x": unknowns, "f": cost + gentle, "g": casadi.vertcat(*g)},
        {
            "ipopt.print_level": 0,
            "ipopt.sb": "yes",
            "print_time": False,
            "ipopt.tol": tolerance,
            "ipopt.max_iter": 1000,
        },
    )
    optimum = solver(
        x0=0.0, lbx=bounds(ends[0], -1.0), ubx=bounds(ends[1], 1.0), lbg=np.concatenate(low), ubg=np.concatenate(high)
    )
    assert solver.stats()["success"], solver.stats()["return_status"]
    value = np.asarray(optimum["x"]).ravel()
    count = k * nodes
    efforts = size * value[count : count + machine.m * nodes].reshape(nodes, machine.m)
    if objective == "peak":
        return float(np.abs(efforts).max()), efforts
    return float((_weights(t)[:, None] * efforts**2).sum()), efforts


def least_time(machine, start, end, effort, limits, park, steps=60):
    """Return the least time, s, along a straight line from rest to rest, carriers from rest at 0, on nodes in time.

    Place, speed and acceleration along the line are unknown, as the carriers' motion, the efforts and the duration.
    ``effort``: limit of all of them; ``limits``: as of ``solve``; ``park``: whether the carriers end at rest at 0.
    """
    nodes, k = steps + 1, machine.k
    start, end = np.asarray(start, float), np.asarray(end, float)
    length = float(np.linalg.norm(end - start))
    T = casadi.MX.sym("T")
    p, rate, bend = (casadi.MX.sym(name, 1, nodes) for name in ("p", "rate", "bend"))
    S, V, A = (casadi.MX.sym(name, k, nodes) for name in "SVA")
    tau = casadi.MX.sym("tau", machine.m, nodes)
    h, along = T / steps, casadi.DM((end - start) / length)
    rows = [machine.balance.map(nodes)(start + along @ p, along @ rate, along @ bend, S, V, A, effort * tau) / effort]
    for y, yd, ydd in ((p, rate, bend), (S, V, A)):
        gained = h * (ydd[:, :-1] + ydd[:, 1:]) / 2.0
        moved = h * yd[:, :-1] + h**2 * (2.0 * ydd[:, :-1] + ydd[:, 1:]) / 6.0
        rows += [y[:, :-1] + moved - y[:, 1:], yd[:, :-1] + gained - yd[:, 1:]]
    rows += [p[0], p[-1] - length, rate[0], rate[-1], S[:, 0], V[:, 0], *([S[:, -1], V[:, -1]] if park else [])]
    phase = np.pi * np.linspace(0.0, 1.0, nodes)
    guess = {
        "p": 0.5 * length * (1.0 - np.cos(phase)), "rate": 0.5 * length * np.pi / 2.0 * np.sin(phase),
        "bend": 0.5 * length * (np.pi / 2.0) ** 2 * np.cos(phase),
    }  # fmt: skip
    most = {"S": limits["track"], "V": limits["speed"], "A": limits["acceleration"], "tau": 1.0}
    x0, upper = [[2.0]], [[60.0]]
    for block in (p, rate, bend, S, V, A, tau):
        x0.append(np.ravel(guess.get(block.name(), np.zeros(block.numel()))))
        upper.append(np.full(block.numel(), most.get(block.name(), np.inf)))
    high = np.concatenate(upper)
    solver = casadi.nlpsol(
        "least_time", "ipopt",
        {"x": casadi.vertcat(T, *(casadi.vec(one) for one in (p, rate, bend, S, V, A, tau))),
         "f": T + 1e-6 * casadi.sumsqr(A / limits["acceleration"]) / nodes,
         "g": casadi.vertcat(*(casadi.vec(row) for row in rows))},
        {"ipopt.print_level": 0, "ipopt.sb": "yes", "print_time": False, "ipopt.max_iter": 1000},
    )  # fmt: skip
    low = np.concatenate([[1e-2], -high[1:]])
    optimum = solver(x0=np.concatenate(x0), lbx=low, ubx=high, lbg=0.0, ubg=0.0)
    assert solver.stats()["success"], solver.stats()["return_status"]
    return float(optimum["x"][0])
