"""Forward dynamics and their integration as machine code, a library of their own: compiled when somebody simulates.

``forward.c`` beside this file stands on four functions of the same symbols as inverse dynamics: rows, bias, mass matrix
and efforts at rest of the tree. Their linearisation is that of ``derivatives``.
"""

from __future__ import annotations

import ctypes
import math
from dataclasses import fields, replace
from itertools import accumulate
from typing import Any

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.dynamics.compiled.build import (
    Code,
    Recipe,
    address,
    carried_table,
    function_of,
    tables,
    text_of,
    tree_functions,
)
from redundancy_pin.dynamics.compiled.derivatives import TreeSamples, motion_partials
from redundancy_pin.dynamics.compiled.design import design_of
from redundancy_pin.dynamics.compiled.layout import Member, Struct
from redundancy_pin.dynamics.compiled.symbols import SymbolicChain, ca
from redundancy_pin.dynamics.forward import (
    Accelerations,
    Equations,
    LinearParts,
    Loads,
    Progress,
    ProgressT,
    Rules,
)
from redundancy_pin.errors import UnsupportedRobotError
from redundancy_pin.machine_code import FLAGS
from redundancy_pin.motion import CarrierMotion
from redundancy_pin.robot import Robot, Wrench
from redundancy_pin.robot.checks import is_pose
from redundancy_pin.robot.loads import of_kind

_LOADS = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_double, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p)

_RUN = Struct(
    "Run",
    (
        Member("stages", "int", "of an explicit Runge-Kutta method, by the tables of scipy"),
        Member("rows", "int", "stages, the rates at the end, and stages of the interpolant"),
        Member("powers", "int", "of the share of a step in the interpolant, without the constant"),
        Member("A", "const double *", "(rows, rows); the row after the stages leads to the end of a step"),
        Member("C", "const double *", "(rows)"),
        Member("E", "const double *", "(stages + 1) of the error estimate"),
        Member("E3", "const double *", "(stages + 1) of a second one, of DOP853; zeros otherwise"),
        Member("P", "const double *", "(rows, powers) interpolant"),
        Member("rates", "double *", "(rows, NQ + NV), memory for the rates of the stages"),
        Member("order", "double", "of its error estimate"),
        Member("rtol", "double", "relative tolerance of a step"),
        Member("atol", "const double *", "(NQ + NV) absolute tolerance of a step"),
        Member("max_step", "double", "s"),
        Member("prescribed", "int", "whether the carriers' motion is given, by loads"),
        Member("pieces", "int", "of the polynomials of efforts"),
        Member("terms", "int", "of each of them"),
        Member("edges", "const double *", "(pieces + 1) their ends, s"),
        Member("coefficients", "const double *", "(pieces, terms, M + NK), N and N m"),
        Member("limits", "const double *", "(M + NK) largest main efforts and carrier forces, N and N m"),
        Member("loads", "Loads", "what acts in place of the polynomials, or null"),
        Member("breaks", "int", "times at which efforts jump or kink, the last one being the end"),
        Member("samples", "int", "times to record"),
        Member("break_at", "const double *", "(breaks) s"),
        Member("sample_at", "const double *", "(samples) s"),
        Member("recorded", "double *", "(samples, NQ + NV) states"),
        Member("time_tolerance", "double", "s; times closer than this are one"),
        Member("stops", "int", "of joints at their limits"),
        Member("stop", "const double *", "(stops, 4) index in q and in v, side, bound"),
        Member("mode", "const double *", "(LEGS) signs of the working mode"),
        Member("time", "double", "s; time scale of the motion"),
        Member(
            "brief", "double", "rad; steps with less travel, at the speeds of their ends, are checked at their end only"
        ),
        Member("check_travel", "double", "rad; largest travel of joints between two checks of the closures' rank"),
        Member("near_rank", "double", "ratio of singular values of the closures below which a rank loss may be near"),
        Member("shortest", "double", "s; the shortest ordinary step"),
        Member("tolerance", "double", "m; closure residual that a projection must reach"),
        Member("largest_residual", "double", "m; closure residual that it must not leave"),
        Member("velocity_change", "double", "by a projection, at most this share of the largest velocity"),
        Member("velocity_floor", "double", "and this amount, characteristic lengths or rad, per time scale"),
    ),
    {"Loads": _LOADS},
)

_PROGRESS = Struct(
    "Progress",
    (
        Member("t", "double", "s"),
        Member("next_step", "double", "s, at most"),
        Member("near", "double", "ratio of singular values of the closures below which a rank loss is looked for"),
        Member("largest_correction", "double", "m; largest closure residual before a projection"),
        Member("steps", "long", "so far"),
        Member("evaluations", "long", "so far"),
        Member("restarts", "long", "so far"),
        Member("sample", "int", "the next one to record"),
        Member("piece", "int", "of the polynomials, at the last evaluation"),
        Member("next_break", "int", "the next one"),
    ),
)

_SHARED = tuple(field.name for field in fields(Progress) if field.name not in ("y", "values"))
"""Members of ``dynamics.forward.Progress`` that the structure has too."""

_DECLARATIONS = "\n".join(
    [
        "/* Generalised forces (NV) at a state, then s, s', s'' (NK each) where the carriers' motion is given;",
        "   returns 0 where there are none. */",
        "typedef int (*Loads)(double t, const double *q, const double *v, double *out);",
        _RUN.declaration,
        _PROGRESS.declaration,
    ]
)


def source(robot: Robot) -> str:
    """Return the C of a robot's forward dynamics."""
    chain = SymbolicChain(robot)
    pose, motion = [chain.q, chain.trig], [chain.q, chain.trig, chain.v]
    efforts = chain.efforts[0]
    at_rest = ca.substitute(efforts, chain.a, ca.SX.zeros(chain.model.nv))
    mass = ca.jacobian(efforts, chain.a)
    definitions: dict[str, tuple[list[Any], list[Any]]] = {
        "equations": ([*motion, chain.external], [ca.vec(chain.K), chain.bias, ca.vec(mass), at_rest]),
        "closures": (pose, [chain.closure_rows, ca.vec(chain.K)]),
        "rates": ([chain.q, chain.v], [chain.configuration_rate]),
        **tree_functions(chain),
        "platform": (motion, [chain.coordinates, chain.row_rates[chain.row_rates.numel() - robot.n :]]),
    }
    functions = [function_of(chain, f"rp_{name}", inputs, outputs) for name, (inputs, outputs) in definitions.items()]
    text = [*tables(chain, functions, "static"), carried_table(robot)]
    return "\n".join([*text, _DECLARATIONS, text_of("forward.c")])


# as fast with -O2, and compiled in half the time
_FORWARD = Recipe("forward", source, tuple("-O2" if flag == "-O3" else flag for flag in FLAGS))


class CompiledForward(Code):
    """Forward dynamics of one robot; ``dynamics.forward.ForwardKernel``.

    Args:
        robot: the robot.

    Raises:
        CompilerError: there is no C compiler, or it fails.
    """

    def __init__(self, robot: Robot) -> None:
        super().__init__(_FORWARD, robot)
        self._accelerations, self._projected = self.library.rp_accelerations, self.library.rp_projected
        self._advance = self.library.rp_advance
        model = robot.model
        self._nq, self._nv, self._p = model.nq, model.nv, model.nv - robot.k
        self._rows = self._p - robot.n

    def accelerations(
        self, q: Array, v: Array, force: Array, carrier_acceleration: Array | None = None
    ) -> Accelerations | None:
        """Return what acts at a closed state; see ``ForwardKernel.accelerations``."""
        a, closure_force, missing = np.empty(self._nv), np.empty(self._rows), np.empty(self._nv)
        # held by name until the call is over: ctypes keeps addresses only
        inputs = [np.ascontiguousarray(part, dtype=np.float64) for part in (q, v, force)]
        carriers = None if carrier_acceleration is None else np.ascontiguousarray(carrier_acceleration, np.float64)
        given = None if carriers is None else address(carriers)
        results = (address(part) for part in (a, closure_force, missing))
        status = self._accelerations(self.numbers, *(address(part) for part in inputs), None, given, *results)
        return None if status else Accelerations(a, closure_force, missing)

    def project(self, y: Array, tolerance: float) -> tuple[Array, float, float] | None:
        """Return the closed state nearest to y (nq + nv,), the residual before and after, m; None if none is."""
        state, gaps = np.array(y, dtype=np.float64), np.zeros(2)
        if not self._projected(self.numbers, address(state), ctypes.c_double(tolerance), address(gaps)):
            return None
        return state, float(gaps[0]), float(gaps[1])

    def equations(self, q: Array, v: Array) -> Equations:
        """Return the equations of the tree and its closures at a state."""
        p, nv = self._p, self._nv
        K, bias, mass, effort = self._read(self.library.rp_dynamics, q, v, (p * p, p, nv * nv, nv))
        return Equations(K.reshape(p, p, order="F"), bias, mass.reshape(nv, nv, order="F"), effort)

    def platform(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Return coordinates of the platform and their rates at a state; see ``ForwardKernel.platform``."""
        n, shape = self.robot.n, (4, 4) if is_pose(self.robot) else (self.robot.n,)
        x, xd = self._read(self.library.rp_platform_at, q, v, (math.prod(shape), n))
        return x.reshape(shape), xd

    def _read(self, function: Any, q: Array, v: Array, sizes: tuple[int, ...]) -> list[Array]:
        """Return results of these sizes at a state; side by side in memory, for an address takes a microsecond."""
        state, out = np.concatenate((q, v)), np.empty(sum(sizes))
        function(self.numbers, address(state), address(out))
        ends = accumulate(sizes)
        return [out[end - size : end] for size, end in zip(sizes, ends, strict=True)]

    def linear(self, q: Array, v: Array, a: Array, tau: Array) -> LinearParts:
        """Return exact derivatives at N states in motion under main efforts (N, m)."""
        robot, samples = self.robot, len(q)
        at, moves = robot.carrier_position, robot.carrier_velocity
        carriers = CarrierMotion(q[:, at], v[:, moves], a[:, moves])
        # the platform is where its state is: coordinates that were missed would change nothing that is read here
        x = np.zeros((samples, 16 if is_pose(robot) else robot.n))
        if of_kind(robot.loads, Wrench):
            raise UnsupportedRobotError(
                f"{robot.name} has wrenches on it, whose derivatives are not known here.",
                remedy="Linearise, and design a controller, without them.",
            )
        tree = TreeSamples(x, q, v, a, np.ones(samples, dtype=bool), np.zeros((samples, 0)))
        d, W, _ = motion_partials(robot, design_of(robot, ()), tree, carriers)

        def both(name: str, carrier_name: str) -> Array:
            """Derivatives (N, d, d) of (f − W τ, F) by platform and carriers."""
            rows = [
                np.concatenate([getattr(of, name), getattr(of, carrier_name)], axis=-1)
                for of in (d["f"], d["carrier_force"], d["W"])
            ]
            rows[0] = rows[0] - np.einsum("nimc,nm->nic", rows[2], tau)
            return np.concatenate(rows[:2], axis=1)

        acting = np.zeros((samples, robot.n + robot.k, robot.m + robot.k))
        acting[:, : robot.n, : robot.m], acting[:, robot.n :, robot.m :] = W, np.eye(robot.k)
        return LinearParts(both("xdd", "sdd"), both("x", "s"), both("xd", "sd"), acting)

    def integration(self, rules: Rules) -> CompiledIntegration:
        """Return an integration by these rules."""
        return CompiledIntegration(self, rules)


class CompiledIntegration:
    """An integration in machine code; ``dynamics.forward.Integration``.

    Args:
        forward: of the robot.
        rules: what it must keep to.
    """

    def __init__(self, forward: CompiledForward, rules: Rules) -> None:
        self._forward, self._rules = forward, rules
        robot = forward.robot
        self._width, self._loads = forward._nq + forward._nv, robot.m + robot.k
        self._recorded = np.full((len(rules.grid), self._width), np.nan)
        self._run, self._at = _RUN.type(), _PROGRESS.type()
        self._kept: dict[str, Any] = {}
        self._views: dict[int, Array] = {}
        self._set_method(rules.method)
        for field in fields(rules):
            if field.type == "float":
                setattr(self._run, field.name, getattr(rules, field.name))
        self._point("atol", rules.atol)
        self._point("sample_at", rules.grid)
        self._point("break_at", rules.breaks)
        self._point("stop", rules.stops.T)
        self._point("mode", np.array(robot.working_mode, dtype=np.float64))
        self._point("limits", rules.limits)
        self._run.recorded = self._recorded.ctypes.data
        self._run.samples, self._run.breaks = len(rules.grid), len(rules.breaks)
        self._run.stops, self._run.prescribed = rules.stops.shape[1], int(rules.prescribed)
        if rules.efforts is not None:
            self._act(rules.efforts.edges, np.swapaxes(rules.efforts.coefficients, 0, 1))
        if rules.loads is not None:
            self._load_function: Loads = rules.loads
            self._kept["loads"] = _LOADS(self._called)
            self._run.loads = self._kept["loads"]
        self._error: BaseException | None = None

    def hold(self, command: Array) -> None:
        """Let constant efforts (m + k,) act."""
        self._act(self._rules.grid[[0, -1]], command[None, None])

    def advance(self, progress: ProgressT, recorded: int, end: float, most: int) -> tuple[ProgressT, Array, bool]:
        """Take ordinary steps; see ``dynamics.forward.Integration.advance``."""
        at, breaks = self._at, self._rules.breaks
        for name in _SHARED:
            setattr(at, name, getattr(progress, name))
        at.sample = recorded
        at.next_break = int(np.searchsorted(breaks, progress.t, side="right"))
        self._run.breaks = int(np.searchsorted(breaks, end, side="right"))
        y, values = np.array(progress.y, dtype=np.float64), np.array(progress.values, dtype=np.float64)
        status = self._forward._advance(
            self._forward.numbers,
            ctypes.byref(self._run),
            ctypes.byref(at),
            address(y),
            address(values),
            ctypes.c_long(most),
        )
        if self._error is not None:
            error, self._error = self._error, None
            raise error
        progress = replace(progress, y=y, values=values, **{name: getattr(at, name) for name in _SHARED})
        return progress, self._recorded[recorded : at.sample].copy(), bool(status)

    def _act(self, edges: Array, coefficients: Array) -> None:
        """Let polynomials act: coefficients (pieces, terms, m + k)."""
        self._point("edges", edges)
        self._point("coefficients", coefficients)
        self._run.pieces, self._run.terms = coefficients.shape[:2]
        self._at.piece = 0

    def _called(self, t: float, q: int, v: int, out: int) -> int:
        """Write the forces that act at q, v (addresses) where C wants them; return whether there are any."""
        if self._error is not None:
            return 0
        forward = self._forward
        try:
            state = (self._memory(q, forward._nq).copy(), self._memory(v, forward._nv).copy())
            force, motion = self._load_function(t, *state)
            whole = force if motion is None else np.concatenate([force, *motion])
            self._memory(out, len(whole))[:] = whole
        except BaseException as error:  # C cannot raise it: the caller does
            self._error = error
            return 0
        return int(math.isfinite(sum(whole.tolist())))  # of a few numbers sooner known than by np.isfinite

    def _memory(self, address: int, size: int) -> Array:
        """Return the memory of C at an address; C hands over the same few again and again."""
        view = self._views.get(address)
        if view is None or len(view) != size:
            view = self._views[address] = np.ctypeslib.as_array((ctypes.c_double * size).from_address(address))
        return view

    def _point(self, name: str, values: Array) -> None:
        """Give C the address of an array, which is kept."""
        kept = self._kept[name] = np.ascontiguousarray(values, dtype=np.float64)
        setattr(self._run, name, kept.ctypes.data)

    def _set_method(self, name: str) -> None:
        """Set the tables of a method of scipy."""
        from scipy.integrate import DOP853, RK45

        is_8 = name == "DOP853"
        method: Any = DOP853 if is_8 else RK45
        count = method.n_stages
        rows = count + 1 + (len(DOP853.C_EXTRA) if is_8 else 0)
        A, C = np.zeros((rows, rows)), np.ones(rows)
        A[:count, : method.A.shape[1]], A[count, :count], C[:count] = method.A, method.B, method.C
        if is_8:
            A[count + 1 :], C[count + 1 :] = DOP853.A_EXTRA, DOP853.C_EXTRA
        tables: dict[str, Array] = {
            "A": A,
            "C": C,
            "E": DOP853.E5 if is_8 else RK45.E,
            "E3": DOP853.E3 if is_8 else np.zeros(count + 1),
            "P": _interpolant_of_order_7() if is_8 else RK45.P,
            "rates": np.zeros((rows, self._width)),
        }
        for table, values in tables.items():
            self._point(table, values)
        run = self._run
        run.stages, run.rows, run.powers = count, rows, tables["P"].shape[1]
        run.order = method.error_estimator_order


def _interpolant_of_order_7() -> Array:
    """Return (16, 7) scipy's interpolant of DOP853 by powers of the share x of a step, y(x) = y₀ + h Σ K_s P_sp x^p.

    Scipy has it as a nested product of x and 1 − x (Hairer, Norsett and Wanner, 1993, section II.6).
    """
    from scipy.integrate import DOP853

    count, (extra, rows) = DOP853.n_stages, DOP853.D.shape
    change, first, both = np.zeros((3, rows))
    change[:count], first[0], both[[0, count]] = DOP853.B, 1.0, 1.0
    parts = np.vstack([change, first - change, 2.0 * change - both, DOP853.D])
    powers, weight = np.zeros((3 + extra, 4 + extra)), np.ones(1)
    for i in range(len(powers)):
        weight = np.convolve(weight, [1.0, -1.0] if i % 2 else [0.0, 1.0])
        powers[i, : i + 2] = weight
    return np.asarray(parts.T @ powers[:, 1:], dtype=np.float64)
