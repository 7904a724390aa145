"""The equations of a closed chain as casadi Functions, for problems of a user's own.

The functions compiled by ``CompiledDynamics`` are available here: in an optimal-control problem configurations may be
unknowns, closed by ``position``, and efforts too, tied to the motion by ``balance``, which is as finite at a type II
singularity as elsewhere.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from redundancy_pin.arrays import Frozen
from redundancy_pin.dynamics.compiled.load_symbols import constant_wrenches
from redundancy_pin.dynamics.compiled.parameters import parameter_vector
from redundancy_pin.dynamics.compiled.symbols import SymbolicChain, ca
from redundancy_pin.loading import RobotLike, as_robot
from redundancy_pin.robot import Robot


@dataclass(frozen=True, eq=False, repr=False)
class SymbolicRobot(Frozen):
    """casadi Functions of one robot; made by ``rp.symbolic``.

    They take numbers, SX and MX, are made of scalar expressions, and have derivatives of any order. Arguments are
    columns: configuration q (nq), velocity v and acceleration a (nv) of the whole tree as Pinocchio orders them,
    carriers included (at ``robot.carrier_position`` in q and ``robot.carrier_velocity`` in v); platform coordinates x,
    (n) or a pose (4, 4), with ẋ and ẍ (n), of a pose the twist in world axes at the platform's origin; main efforts tau
    (m), carrier forces F (k), closure forces lam (r). p = nv − k = r + n. SI units and radians.

    Branches are not followed: ``mode`` and ``alignment`` identify a configuration of the robot's working mode among all
    closed ones. A guess near ``robot.q_reference``, or from ``rp.inverse_kinematics``, stays on its branch.

    Attributes:
        robot: the robot.
        closure: Φ(q), (r): closure residuals, m; of rotation rows the sine of the angle that is off.
        coordinates: x(q), (n) or (4, 4).
        position: (q, x) to (r + n): Φ(q), then x(q) − x (the short way round; of a pose the sine of the turn).
        velocity: (q, v, xd) to (r + n): J_c v, then ẋ of the tree less ẋ. Zero along a motion.
        acceleration: (q, v, a, xdd) to (r + n): the rate of ``velocity``. Zero along a motion.
        Jc: J_c(q), (r, nv): constraint Jacobian.
        Jx: J_x(q), (n, nv): the independent velocities are ẋ = J_x v.
        K: K(q), (p, p): J_c over J_x, without the carriers' columns.
        bias: (q, v) to (r + n): the rates of J_c v and J_x v at v̇ = 0.
        gamma: Γ(q), (nv, n): velocities of the tree per unit of each independent velocity, J_c Γ = 0. Infinite at
            type I singularities.
        moved: (q, step) to (nq): the configuration a tangent step (nv) away, to first order; q + step except for joints
            with more coordinates than degrees of freedom.
        rnea: (q, v, a) to (nv): generalised forces of the open tree, N and N·m.
        f: (q, v, a) to (n): generalised force Γᵀ rnea; W τ = f.
        W: W(q), (n, m): actuation matrix.
        carrier_force: (q, v, a) to (k): forces of the carriers' own actuators, N.
        balance: (q, v, a, tau, F, lam) to (nv): rnea − Sᵀ τ − Cᵀ F − J_cᵀ λ. Zero where the efforts produce the motion;
            λ is what frame a of each closure exerts on frame b, in the axes of frame a.
        base_wrench: (q, v, a) to (6): force and moment of the robot on its base, world origin and axes, N and N·m.
        energy: (q, v) to (1): kinetic plus potential energy, J (zero height at the world origin).
        mode: (q) to (legs): positive in the robot's own working mode; empty without working modes.
        alignment: (q) to (some): positive at a true closure of hinges and welds, and at no false one.
    """

    robot: Robot
    closure: Any
    coordinates: Any
    position: Any
    velocity: Any
    acceleration: Any
    Jc: Any
    Jx: Any
    K: Any
    bias: Any
    gamma: Any
    moved: Any
    rnea: Any
    f: Any
    W: Any
    carrier_force: Any
    balance: Any
    base_wrench: Any
    energy: Any
    mode: Any
    alignment: Any

    def __repr__(self) -> str:
        """Return the robot; the Functions print themselves."""
        return f"SymbolicRobot({self.robot!r})"


def symbolic(robot: RobotLike) -> SymbolicRobot:
    """Return the equations of a robot as casadi Functions, for an optimal-control problem of one's own.

    Args:
        robot: any declared robot.

    Raises:
        UnsupportedRobotError: a joint of a type that is not covered.

    Example:
        >>> sym = rp.symbolic(rp.load_robot("five_bar"))
        >>> sym.closure.size_out(0)
        (2, 1)
    """
    robot = as_robot(robot)
    chain = SymbolicChain(robot)
    q, v, a = chain.q, chain.v, chain.a
    r, n, nv = chain.rows, robot.n, robot.model.nv
    xd, xdd, step = ca.SX.sym("xd", n), ca.SX.sym("xdd", n), chain.step
    tau, force, lam = ca.SX.sym("tau", robot.m), ca.SX.sym("F", robot.k), ca.SX.sym("lam", r)
    x = ca.SX.sym("x", 4, 4) if chain.is_pose else chain.x
    missing = ca.substitute(chain.missing, chain.x, ca.vec(x.T)) if chain.is_pose else chain.missing
    coordinates = ca.reshape(chain.coordinates, 4, 4).T if chain.is_pose else chain.coordinates
    rates = chain.row_rates
    rows = ca.jacobian(rates, v)
    K, closing, describing = chain.K, rows[:r, :], rows[r:, :]
    still, carried = ca.SX.zeros(r), robot.carrier_velocity.tolist()
    second = ca.substitute(rates, v, a) + chain.bias
    wrenches = ca.SX(constant_wrenches(robot))
    efforts, ground = (ca.substitute(part, chain.external, wrenches) for part in chain.efforts)
    # one solution for Γ: a column for each independent velocity
    solved = ca.solve(K, ca.vertcat(ca.SX(r, n), ca.SX.eye(n)))
    gamma = ca.SX(nv, n)
    gamma[chain.pose_columns.tolist(), :] = solved
    applied = closing.T @ lam
    for at, effort in ((robot.actuated_velocity.tolist(), tau), (carried, force)):
        if at:
            applied[at] += effort
    definitions: dict[str, tuple[dict[str, Any], Any]] = {
        "closure": ({"q": q}, chain.closure_rows),
        "coordinates": ({"q": q}, coordinates),
        "position": ({"q": q, "x": x}, ca.vertcat(chain.closure_rows, -missing)),
        "velocity": ({"q": q, "v": v, "xd": xd}, rates - ca.vertcat(still, xd)),
        "acceleration": ({"q": q, "v": v, "a": a, "xdd": xdd}, second - ca.vertcat(still, xdd)),
        "Jc": ({"q": q}, closing),
        "Jx": ({"q": q}, describing),
        "K": ({"q": q}, K),
        "bias": ({"q": q, "v": v}, chain.bias),
        "gamma": ({"q": q}, gamma),
        "moved": ({"q": q, "step": step}, chain.moved),
        "rnea": ({"q": q, "v": v, "a": a}, efforts),
        "f": ({"q": q, "v": v, "a": a}, gamma.T @ efforts),
        "W": ({"q": q}, gamma[robot.actuated_velocity.tolist(), :].T),
        "carrier_force": ({"q": q, "v": v, "a": a}, efforts[carried] if carried else ca.SX(0, 1)),
        "balance": ({"q": q, "v": v, "a": a, "tau": tau, "F": force, "lam": lam}, efforts - applied),
        "base_wrench": ({"q": q, "v": v, "a": a}, -ground),
        "energy": ({"q": q, "v": v}, chain.energy),
        "mode": ({"q": q}, chain.mode_indicators),
        "alignment": ({"q": q}, chain.alignment[:-1] if chain.is_pose else chain.alignment),
    }
    angles = [f(q[i]) for i in chain.turning for f in (ca.cos, ca.sin)]
    turned = ca.vertcat(*angles) if angles else ca.SX(0, 1)
    numbers, functions = ca.SX(parameter_vector(robot)), {}
    for name, (inputs, result) in definitions.items():
        at_q = ca.cse(ca.substitute([result], [chain.trig, chain.parameters], [turned, numbers])[0])
        functions[name] = ca.Function(name, list(inputs.values()), [at_q], list(inputs), [f"{name}_"])
    return SymbolicRobot(robot, **functions)
