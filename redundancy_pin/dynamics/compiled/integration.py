"""The integration of forward dynamics in machine code: ordinary steps of a simulation (``integration.c``).

Python and C share two structures, each defined once; numbers of ``Rules`` and ``Progress`` are members as they are.
"""

from __future__ import annotations

import ctypes
import math
from dataclasses import fields, replace
from typing import Any

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.dynamics.compiled.build import Code
from redundancy_pin.dynamics.forward import Loads, Progress, ProgressT, Rules

_LOADS = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_double, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p)

_INT, _LONG, _DOUBLE, _POINTER = ctypes.c_int, ctypes.c_long, ctypes.c_double, ctypes.c_void_p

_IN_C = {_INT: "int ", _LONG: "long ", _DOUBLE: "double ", _POINTER: "double *", _LOADS: "Loads "}
"""C type of each ctypes type."""

_NUMBERS = {"float": _DOUBLE, "float | None": _DOUBLE, "int": _LONG}
"""By the annotation of a number in ``dynamics.forward`` its type."""


def _shared(of: type) -> dict[str, Any]:
    """Return the type of each number of a dataclass of ``dynamics.forward`` by name; that module documents them."""
    known = ((field.name, str(field.type)) for field in fields(of))
    return {name: _NUMBERS[kind] for name, kind in known if kind in _NUMBERS}


class _Run(ctypes.Structure):
    """What stays the same in an integration; pointers are to doubles, SI units."""

    _fields_ = (
        ("stages", _INT),  # of an explicit Runge-Kutta method, by the tables of scipy
        ("rows", _INT),  # stages, the rates at the end, and stages of the interpolant
        ("powers", _INT),  # of the share of a step in the interpolant, without the constant
        ("A", _POINTER),  # (rows, rows); the row after the stages leads to the end of a step
        ("C", _POINTER),  # (rows)
        ("E", _POINTER),  # (stages + 1) of the error estimate
        ("E3", _POINTER),  # (stages + 1) of a second one, of DOP853; zeros otherwise
        ("P", _POINTER),  # (rows, powers) interpolant
        ("rates", _POINTER),  # (rows, NQ + NV), memory for the rates of the stages
        ("order", _DOUBLE),  # of its error estimate
        ("atol", _POINTER),  # (NQ + NV) absolute tolerance of a step
        ("prescribed", _INT),  # whether the carriers' motion is given, by loads
        ("pieces", _INT),  # of the polynomials of efforts
        ("terms", _INT),  # of each of them
        ("edges", _POINTER),  # (pieces + 1) their ends, s
        ("coefficients", _POINTER),  # (pieces, terms, M + NK), N and N m
        ("limits", _POINTER),  # (M + NK) largest main efforts and carrier forces, N and N m
        ("loads", _LOADS),  # what acts in place of the polynomials, or null
        ("breaks", _INT),  # times at which efforts jump or kink, the last one being the end
        ("samples", _INT),  # times to record
        ("break_at", _POINTER),  # (breaks) s
        ("sample_at", _POINTER),  # (samples) s
        ("recorded", _POINTER),  # (samples, NQ + NV) states
        ("stops", _INT),  # of joints at their limits
        ("stop", _POINTER),  # (stops, 4) index in q and in v, side, bound
        ("mode", _POINTER),  # (LEGS) signs of the working mode
        *_shared(Rules).items(),
    )


class _Progress(ctypes.Structure):
    """How far an integration is."""

    _fields_ = (
        *_shared(Progress).items(),
        ("sample", _INT),  # the next one to record
        ("piece", _INT),  # of the polynomials, at the last evaluation
        ("next_break", _INT),  # the next one
    )


def _declared(name: str, of: type[ctypes.Structure]) -> str:
    """Return the declaration in C of a structure."""
    members = "".join(f"  {_IN_C[kind]}{member};\n" for member, kind, *_ in of._fields_)
    return f"typedef struct {{\n{members}}} {name};"


DECLARATIONS = "\n".join(
    [
        "/* Generalised forces (NV) at a state, then s, s', s'' (NK each) where the carriers' motion is given;",
        "   returns 0 where there are none. */",
        "typedef int (*Loads)(double t, const double *q, const double *v, double *out);",
        _declared("Run", _Run),
        _declared("Progress", _Progress),
    ]
)


class CompiledIntegration:
    """An integration in machine code; ``dynamics.forward.Integration``.

    Args:
        forward: the forward dynamics of the robot.
        rules: tolerances, limits and events of the integration.
    """

    def __init__(self, forward: Code, rules: Rules) -> None:
        self._forward, self._rules = forward, rules
        robot, self._nq, self._nv = forward.robot, forward.robot.model.nq, forward.robot.model.nv
        self._width = self._nq + self._nv
        self._recorded = np.full((len(rules.grid), self._width), np.nan)
        self._run, self._at = _Run(), _Progress()
        self._kept: dict[str, Any] = {}
        self._views: dict[int, Array] = {}
        self._set_method(rules.method)
        for name in _shared(Rules):
            setattr(self._run, name, getattr(rules, name))
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
        for name in _shared(Progress):
            setattr(at, name, getattr(progress, name))
        at.sample = recorded
        at.next_break = int(np.searchsorted(breaks, progress.t, side="right"))
        self._run.breaks = int(np.searchsorted(breaks, end, side="right"))
        y, values = np.array(progress.y, dtype=np.float64), np.array(progress.values, dtype=np.float64)
        given = ctypes.byref(self._run), ctypes.byref(at), y, values, ctypes.c_long(most)
        status = self._forward.call("rp_advance", *given)
        if self._error is not None:
            error, self._error = self._error, None
            raise error
        progress = replace(progress, y=y, values=values, **{name: getattr(at, name) for name in _shared(Progress)})
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
        try:
            state = (self._memory(q, self._nq).copy(), self._memory(v, self._nv).copy())
            force, motion = self._load_function(t, *state)
            whole = force if motion is None else np.concatenate([force, *motion])
            self._memory(out, len(whole))[:] = whole
        except BaseException as error:  # C cannot raise it: the caller does
            self._error = error
            return 0
        return int(math.isfinite(sum(whole.tolist())))  # for a few numbers faster than np.isfinite

    def _memory(self, address: int, size: int) -> Array:
        """Return the memory of C at an address; C passes the same few addresses repeatedly."""
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
