"""Base parameters: the combinations of dynamic parameters that a motion of a closed chain shows.

Columns of the regressor that depend on columns before them add nothing: their parameters are regrouped into these
(Gautier 1991, "Numerical calculation of the base inertial parameters of robots"). With Y = (Y₁, Y₁ B) up to the order,

    Y π = Y₁ (π₁ + B π₂).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from redundancy_pin.arrays import Array, Frozen, IntArray, read_only
from redundancy_pin.identification.parameters import NOT_NEGATIVE, Parameter

_DEPENDENT = 1e-7
"""Part of a column that is not in those before it, below which it depends on them: the smallest singular value
of what is left, relative to the largest, is 3e-6 or more on shipped machines, and rounding where columns depend."""

_UNSEEN = 1e-9
"""Norm of a column for a parameter of its size, relative to the largest, below which it is rounding."""


@dataclass(frozen=True, eq=False)
class BaseParameters(Frozen):
    """The b base parameters that a motion shows.

    Attributes:
        parameters: the p parameters that they are made of.
        independent: (b,) which of them lead a base parameter.
        combination: (b, p) base = combination · parameters; 1 at the leading one.
        unseen: names of parameters that the motion does not show at all.
    """

    parameters: tuple[Parameter, ...]
    independent: IntArray
    combination: Array
    unseen: tuple[str, ...]

    def __len__(self) -> int:
        """Return b."""
        return len(self.independent)

    @property
    def names(self) -> tuple[str, ...]:
        """Their names: ``"mass of arm + 0.25 mass of hand"``; inertial terms with factors in m, m² or 1/m."""
        return tuple(self._name(lead, row) for lead, row in zip(self.independent, self.combination, strict=True))

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the leading parameters."""
        return tuple(self.parameters[k].unit for k in self.independent)

    @property
    def standard(self) -> Array:
        """(p,) values of the parameters in the robot."""
        return read_only(np.array([p.value for p in self.parameters]))

    @property
    def sizes(self) -> Array:
        """(p,) scales of the parameters."""
        return read_only(np.array([p.size for p in self.parameters]))

    def _name(self, lead: int, row: Array) -> str:
        relative = np.abs(row) * self.sizes
        parts = [self.parameters[lead].name]
        for k in np.flatnonzero(relative > 1e-6 * relative.max()):
            if k != lead:
                factor = "" if abs(abs(row[k]) - 1.0) < 1e-9 else f"{abs(row[k]):.4g} "
                parts.append(f"{'-' if row[k] < 0.0 else '+'} {factor}{self.parameters[k].name}")
        return " ".join(parts)

    def standard_values(self, change: Array) -> Array:
        """Return (p,) the parameters nearest to the robot's, relative to sizes, whose base parameters change (b,).

        Masses, friction, springs and rotors do not become negative where others can take the change.
        """
        sizes, before = self.sizes, self.standard
        scaled, low = self.combination * sizes, -before / sizes
        signed = np.array([p.kind in NOT_NEGATIVE for p in self.parameters], dtype=bool)
        zero, first = np.zeros(len(sizes), dtype=bool), None
        while True:
            moved = np.where(zero, low, 0.0)
            moved[~zero] = np.linalg.lstsq(scaled[:, ~zero], change - scaled @ moved, rcond=None)[0]
            left = float(np.abs(scaled @ moved - change).max(initial=0.0))
            if first is None:
                first = moved
            elif left > 1e-9 * float(np.abs(change).max(initial=0.0)):
                return before + sizes * first
            below = signed & ~zero & (moved < low)
            if not below.any():
                return before + sizes * moved
            zero |= below


def base_parameters(rows: Array, parameters: Sequence[Parameter], least: float = 0.0) -> BaseParameters:
    """Return the base parameters that rows (M, p) of a regressor, weighted or not, show of p parameters.

    The parameters that lead are the first ones: a later one is regrouped into those before it. A parameter whose
    column, times its size, has a norm of at most ``least`` is unseen.

    Example:
        >>> from redundancy_pin.identification import base_parameters, chain_regressor, parameters_of
        >>> line = rp.trajectory.from_points([[0.2, 0.6], [0.3, 0.7]], [0.0, 1.0], ends="rest")
        >>> Y = chain_regressor(rp.RneaDynamics("five_bar").along(line.sample(0.05)))
        >>> base_parameters(Y.reshape(-1, Y.shape[-1]), parameters_of(rp.load_robot("five_bar"))).names[0]
        'inertia zz of proximal_1 + 0.25 mass of distal_1 + inertia zz of distal_2'
    """
    sizes = np.array([p.size for p in parameters])
    columns: Array = np.linalg.qr(rows * sizes).R
    norms = np.linalg.norm(columns, axis=0)
    seen = norms > max(_UNSEEN * norms.max(initial=0.0), least)
    columns = np.where(seen, columns / np.where(seen, norms, 1.0), 0.0)
    independent = _independent_columns(columns)
    solved = np.linalg.lstsq(columns[:, independent], columns, rcond=None)[0]
    solved[np.abs(solved) < _DEPENDENT] = 0.0
    solved[:, independent] = np.eye(len(independent))
    scale = np.where(seen, norms / sizes, 0.0)
    combination = solved * scale / scale[independent, None]
    combination[:, independent] = np.eye(len(independent))
    unseen = tuple(p.name for p, known in zip(parameters, seen, strict=True) if not known)
    return BaseParameters(tuple(parameters), independent, read_only(combination), unseen)


def _independent_columns(columns: Array) -> IntArray:
    """Return which columns (M, p) of unit length, or zero, do not depend on those before them: Gram and Schmidt's QR.

    Householder's would spread the rest of a column over the diagonal entries of dependent ones.
    """
    basis, kept = np.zeros((len(columns), 0)), []
    for k, column in enumerate(columns.T):
        rest = column - basis @ (basis.T @ column)
        rest -= basis @ (basis.T @ rest)
        size = float(np.linalg.norm(rest))
        if size > _DEPENDENT:
            kept.append(k)
            basis = np.column_stack([basis, rest / size])
    return np.array(kept, dtype=np.intp)
