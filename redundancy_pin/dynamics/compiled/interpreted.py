"""Kernels without a compiler: casadi evaluates the functions, and the driver (``driver.c``) is written in Python.

Line by line it is the driver in C, whose comments say why; here only what differs.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from redundancy_pin.arrays import CLOSURE_TOLERANCE, Array, IntArray
from redundancy_pin.dynamics.compiled.build import LEAST_MARGIN, Definition
from redundancy_pin.dynamics.compiled.parameters import turning_equations, turning_steps
from redundancy_pin.robot.scales import position_unit
from redundancy_pin.robot.whole_turns import follow_whole_turns

_CONTRACTION, _SETTLED, _ROUNDED, _FLOOR, _LONGEST, _SHORTEST, _ITERATIONS = 0.3, 1e-13, 4e-16, 1e-9, 0.5, 1e-4, 15
_CLOSED, _LOST, _SINGULAR, _OTHER_MODE, _NOT_FINITE = range(5)


@dataclass(frozen=True, eq=False)
class _Pose:
    q: Array
    inverse: Array
    sign: float
    gap: float


class Interpreter:
    """A robot's functions, interpreted; the methods are those of ``build.Library``.

    Args:
        definition: the functions.
    """

    compiled = False

    def __init__(self, definition: Definition) -> None:
        chain = definition.chain
        self._functions, self._robot = definition.functions, chain.robot
        self.alignments, self.trigs = chain.alignment.numel(), 2 * len(chain.turning)
        self.trig_at = chain.trig_at
        self._external = chain.external.numel()
        self._n, self._r, self._columns = chain.robot.n, chain.rows, chain.pose_columns
        length = definition.chain.robot.characteristic_length
        self._step_unit = np.where(turning_steps(chain.robot), 1.0, length)
        self._equation_unit = np.where(turning_equations(chain.robot), 1.0, length)
        self._length, self._position_unit = float(chain.robot.characteristic_length), position_unit(chain.robot)

    def call(self, name: str, *arguments: Any) -> int:
        """Call a function of the driver."""
        return self._lift(*arguments) if name == "rp_lift" else self._follow_to(*arguments)

    def map(self, name: str, samples: int, inputs: Sequence[Array], outputs: Sequence[Array]) -> None:
        """Evaluate a function for many samples."""
        function = self._functions[name]
        given = [
            np.reshape(array, (function.size1_in(i), samples * function.size2_in(i)), order="F")
            for i, array in enumerate(np.reshape(array, -1) for array in inputs)
        ]
        results = function.map(samples).call(given)
        for output, result in zip(outputs, results, strict=True):
            output.reshape(-1)[:] = np.array(result).ravel(order="F")

    def _value(self, name: str, *arguments: Array) -> list[Array]:
        return [np.array(part) for part in self._functions[name].call(list(arguments))]

    def _trig(self, q: Array) -> Array:
        trig: Array = self.trig_at(q[None])[0]
        return trig

    def rows_at(self, q: Array, x: Array) -> tuple[Array, Array, Array]:
        """Return residual and Jacobian without units, and misalignments, of the loops at one configuration."""
        residual, matrix, alignment = self._value("rp_rows", q, self._trig(q), x)
        size = len(residual)
        return residual[:, 0], matrix.reshape(size, size).T, alignment[:, 0]

    def _moved(self, q: Array, step: Array) -> Array:
        whole = np.zeros(self._robot.model.nv)
        whole[self._columns] = step
        return self._value("rp_moved", q, whole)[0][:, 0]

    def _newton(self, q: Array, x: Array, left: Array | None) -> _Pose | None:
        last = _LONGEST / _CONTRACTION
        for _ in range(_ITERATIONS):
            residual, matrix, alignment = self.rows_at(q, x)
            if left is not None:
                residual[self._r :] -= left
            sign = float(np.linalg.slogdet(matrix)[0])
            if sign == 0.0 or not np.isfinite(matrix).all():
                return None
            inverse: Array = np.asarray(np.linalg.inv(matrix), dtype=np.float64)
            step = inverse @ residual
            size, gap = float(np.abs(step).max()), float(np.abs(residual).max())
            stalled = _CONTRACTION * last < size <= _FLOOR
            rounding = _ROUNDED * float(np.abs(q / self._position_unit).max(initial=0.0))
            if size <= _SETTLED or (stalled and (gap < CLOSURE_TOLERANCE or size <= rounding)):
                return _Pose(q, inverse, sign, gap) if left is not None or (alignment > 0.0).all() else None
            if not size <= _CONTRACTION * last:
                return None
            q, last = self._moved(q, step * self._step_unit), size
        return None

    def follow(self, pose: _Pose, x: Array) -> _Pose | None:
        """Bring a closed configuration to a platform pose in steps of Newton's method; None where that fails."""
        residual, done, share, sign = self.rows_at(pose.q, x)[0][self._r :], 0.0, 1.0, pose.sign
        while done < 1.0:
            ahead = max(1.0 - done - share, 0.0)
            reached = self._newton(pose.q, x, ahead * residual if ahead > 0.0 else None)
            if reached is not None and reached.sign == sign:
                pose, done = reached, done + share
                share = min(2.0 * share, 1.0 - done)
            else:
                share *= 0.5
                if share < _SHORTEST:
                    return None
        return pose

    def _follow_to(self, q: Array, home: Array, x: Array) -> int:
        def follow(q: Array, home: Array, x: Array) -> Array | None:
            start = self._newton(q, home, None)
            pose = None if start is None else self.follow(start, x)
            return None if pose is None else pose.q

        reached = follow_whole_turns(self._robot, q, home, x, follow)
        if reached is None:
            return _LOST
        q[:] = reached
        return _CLOSED if self._in_mode(q) else _OTHER_MODE

    def _in_mode(self, q: Array) -> bool:
        return bool((self._value("rp_modes", q, self._trig(q))[0] > 0.0).all())

    def _rates(self, pose: _Pose, xd: Array, xdd: Array) -> tuple[Array, Array, Array, Array, float]:
        nv, r = self._robot.model.nv, self._r
        gamma, a = np.zeros((nv, self._n)), np.zeros(nv)
        inverse = pose.inverse * (self._step_unit[:, None] / self._equation_unit)
        gamma[self._columns] = inverse[:, r:]
        v = gamma @ xd
        bias = self._value("rp_bias", pose.q, self._trig(pose.q), v)[0][:, 0]
        a[self._columns] = inverse @ (np.concatenate([np.zeros(r), xdd]) - bias)
        with np.errstate(over="ignore"):
            size = float((pose.inverse**2).sum())
        W = np.ascontiguousarray(gamma[self._robot.actuated_velocity].T)
        return v, a, gamma, W, 1.0 / np.sqrt(size) if size > 0.0 else np.inf

    def _lift(
        self,
        samples: int,
        t: Array,
        x: Array,
        xd: Array,
        xdd: Array,
        q0: Array,
        x0: Array,
        q: Array,
        trig: Array,
        v: Array,
        a: Array,
        gamma: Array,
        W: Array,
        gap: Array,
        margin: Array,
        status: IntArray,
    ) -> int:
        home = self._newton(q0, x0, None)
        if home is None:
            return 0
        last, known = home, False
        for k in range(samples):
            pose = None
            if known:
                dt = t[k] - t[k - 1]
                guess = self._moved(last.q, (dt * (v[k - 1] + 0.5 * dt * a[k - 1]))[self._columns])
                pose = self._newton(guess, x[k], None)
                pose = pose if pose is not None and pose.sign == last.sign else None
            pose = pose or self.follow(last, x[k])
            status[k] = _LOST
            if pose is not None:
                q[k], trig[k], gap[k] = pose.q, self._trig(pose.q), pose.gap * self._length
                v[k], a[k], gamma[k], W[k], margin[k] = self._rates(pose, xd[k], xdd[k])
                status[k] = _SINGULAR if margin[k] < LEAST_MARGIN else _CLOSED if self._in_mode(pose.q) else _OTHER_MODE
            known = status[k] == _CLOSED
            if pose is None or not known:
                return k
            last = pose
        return samples

    def assemble(self, q: Array, x: Array) -> float:
        """Bring q (nq), in place, to where it misses x least; return what is left."""
        residual, matrix, _ = self.rows_at(q, x)
        damping, size = 1e-3, float(residual @ residual)
        for _ in range(200):
            normal = matrix.T @ matrix + damping * np.eye(len(residual))
            step = np.asarray(np.linalg.solve(normal, matrix.T @ residual), dtype=np.float64)
            longest = float(np.abs(step).max(initial=0.0))
            trial = self._moved(q, step / max(longest, 1.0) * self._step_unit)
            new_residual, new_matrix, _ = self.rows_at(trial, x)
            new_size = float(new_residual @ new_residual)
            if new_size < size:
                stalled = new_size > 0.999999 * size and longest < 1e-6
                q[:], residual, matrix, size = trial, new_residual, new_matrix, new_size
                damping = max(0.2 * damping, 1e-15)
                if stalled or longest < 1e-14:
                    break
            else:
                damping *= 8.0
                if damping > 1e8 or longest < 1e-14:
                    break
        residual, _, alignment = self.rows_at(q, x)
        turned = np.arccos(np.clip(alignment, -1.0, 1.0))[alignment <= 0.0]
        return float(max(np.abs(residual).max(initial=0.0), turned.max(initial=0.0))) * self._length

    def sampler(self, state: Array, given: Array, result: Array) -> Callable[[], int]:
        """Return a function that evaluates one sample from and into fixed arrays."""
        n, k = self._n, self._robot.k
        width = len(given) - 2 * n - 3 * k - self._external

        def sample() -> int:
            x, rest = given[:width], given[width:]
            pose = self._newton(state[:-1].copy(), x, None)
            if pose is None or pose.sign * state[-1] < 0.0:
                return _LOST
            v, a, gamma, W, margin = self._rates(pose, rest[:n], rest[n : 2 * n])
            if margin < LEAST_MARGIN:
                return _SINGULAR
            if not self._in_mode(pose.q):
                return _OTHER_MODE
            carriers, wrenches = rest[2 * n : 2 * n + 3 * k].reshape(3, k), rest[2 * n + 3 * k :]
            f, force = self._value("rp_project", pose.q, self._trig(pose.q), v, a, gamma.T, *carriers, wrenches)
            if not (np.isfinite(f).all() and np.isfinite(force).all()):
                return _NOT_FINITE
            state[:-1], state[-1] = pose.q, pose.sign
            result[:] = np.concatenate([W.ravel(), f[:, 0], force[:, 0], [pose.gap * self._length, margin]])
            return _CLOSED

        return sample
