"""W τ = f as terms of the carriers' motion at a few instants at a time, each batch followed from the one before it.

New instants in the preview window of an on-line planner continue the earlier ones: Newton's method starts there, in
one call of machine code (``rp_terms`` of ``batch.c``). Where the branch ends on the way, all instants from
there on are marked as unreachable. Where machine code does not close for another reason, as in another working mode,
the motion is followed from the reference by ``along``, which marks what cannot be reached.
"""

from __future__ import annotations

import ctypes
import math
from typing import TYPE_CHECKING

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.dynamics.base import terms_along
from redundancy_pin.dynamics.compiled.build import NEIGHBOURS
from redundancy_pin.dynamics.compiled.closing import branch_ends
from redundancy_pin.dynamics.results import TERMS, CarrierTerms
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.robot import Wrench
from redundancy_pin.robot.checks import is_pose
from redundancy_pin.robot.loads import of_kind, wrench_values

if TYPE_CHECKING:
    from redundancy_pin.dynamics.compiled import CompiledDynamics


class Continued:
    """Terms of one robot, batch after batch; one for each thread."""

    def __init__(self, dynamics: CompiledDynamics) -> None:
        robot = dynamics.robot
        self._dynamics, self._n, self._m, self._k = dynamics, robot.n, robot.m, robot.k
        self._x: tuple[int, ...] = (4, 4) if is_pose(robot) else (robot.n,)
        self._places, self._nq = 16 if is_pose(robot) else robot.n, robot.model.nq
        self._loads = of_kind(robot.loads, Wrench)
        self._width = 1 + self._places + 2 * robot.n + 6 * len(self._loads)
        # first and last configurations of the batches before, each with its coordinates
        self._near = np.full((NEIGHBOURS, self._nq + self._places), np.nan)
        self._function, self._numbers = dynamics.kernel.library.rp_terms, dynamics.kernel.numbers
        self._make_room(8)

    @property
    def addresses(self) -> tuple[int, int, int] | None:
        """Addresses of ``rp_terms``, the robot's numbers, and the last configurations; None if wrenches act."""
        if self._loads:
            return None
        function = ctypes.cast(self._function, ctypes.c_void_p).value
        return function or 0, self._numbers.value or 0, int(self._near.ctypes.data)

    def _make_room(self, samples: int) -> None:
        """Make memory for so many samples, whose addresses are looked up once."""
        self._room = samples
        self._given, self._sizes = np.empty((samples, self._width)), np.empty((samples, 2))
        n, m, k = self._n, self._m, self._k
        self._out = np.empty(samples * (n * m + (1 + k * TERMS) * (n + k)))
        parts = self._given, self._out, self._sizes
        self._addresses = [ctypes.c_void_p(part.ctypes.data) for part in parts]

    def __call__(self, t: Array, x: Array, xd: Array, xdd: Array) -> CarrierTerms:
        """Return W, f and forces by terms; arguments as of ``Dynamics.carrier_terms``."""
        n, samples = self._n, len(t)
        fits = samples and x.shape[1:] == self._x and x.shape[0] == samples and xd.shape == xdd.shape == (samples, n)
        if not fits:
            return self._followed(t, x, xd, xdd)
        if samples > self._room:
            self._make_room(2 * samples)
        wrenches = wrench_values(self._loads, t, x, xd) if self._loads else ()
        flat = x.reshape(samples, -1)
        np.concatenate((t[:, None], flat, xd, xdd, *wrenches), axis=1, out=self._given[:samples])
        given, result, sizes = self._addresses
        near = ctypes.c_void_p(self._near.ctypes.data)
        closed = int(self._function(self._numbers, samples, given, self._width, near, result, sizes))
        if closed < samples and not self._ends_before(x[closed]):
            return self._followed(t, x, xd, xdd)
        return self._read_out(samples, closed)

    def _read_out(self, samples: int, closed: int) -> CarrierTerms:
        """Return the results, NaN behind those that are closed."""
        n, m, k = self._n, self._m, self._k
        shapes = (n, m), (n + k,), (k, TERMS, n + k)
        ends = np.cumsum([samples * math.prod(shape) for shape in shapes]).tolist()
        parts = np.split(self._out[: ends[-1]].copy(), ends[:-1])
        terms = CarrierTerms(*(part.reshape(samples, *shape) for part, shape in zip(parts, shapes, strict=True)))
        for part in terms:
            part[closed:] = np.nan
        return terms

    def _ends_before(self, x: Array) -> bool:
        """Return whether the branch ends on the way to a pose from the neighbour that is nearest to it."""
        away = np.abs(self._near[:, self._nq :] - x.ravel()).max(axis=1)
        if np.isnan(away).all():
            return False
        nearest = self._near[np.nanargmin(away)]
        return branch_ends(self._dynamics.robot, nearest[: self._nq], nearest[self._nq :].reshape(self._x), x)

    def _followed(self, t: Array, x: Array, xd: Array, xdd: Array) -> CarrierTerms:
        """Follow the motion from the reference, and remember where that led."""
        along = self._dynamics.along(PlatformMotion(t, x, xd, xdd, check_rates=False), unreachable="mark")
        closed = np.flatnonzero(along.reachable)
        if len(closed):
            ends = closed[[0, -1]]
            self._near[2:] = self._near[:-2].copy()
            self._near[:2, : self._nq], self._near[:2, self._nq :] = along.q[ends], x[ends].reshape(2, -1)
        return terms_along(along)
