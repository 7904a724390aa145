"""Base parameters: the combinations of dynamic parameters that motions of a closed chain show.

Columns of the regressor that depend on columns before them add nothing: their parameters are regrouped into these
(Gautier 1991, "Numerical calculation of the base inertial parameters of robots"). With Y = (Y₁, Y₁ B) up to the order,

    Y π = Y₁ (π₁ + B π₂).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from redundancy_pin.arrays import Array, Frozen, IntArray, read_only
from redundancy_pin.identification.parameters import Parameter, standard_values
from redundancy_pin.identification.regressor import random_regressor
from redundancy_pin.robot import Robot

_DEPENDENT = 1e-7
"""Part of a column that is not in those before it, below which it depends on them: the smallest singular value
of what is left, relative to the largest, is 3e-6 or more on shipped machines, and rounding where columns depend."""


@dataclass(frozen=True, eq=False)
class BaseParameters(Frozen):
    """The b base parameters of a robot.

    Attributes:
        parameters: the p parameters that they are made of.
        independent: (b,) which of them lead a base parameter.
        combination: (b, p) base = combination · parameters; 1 at the leading one.
        unseen: names of parameters that no motion of the machine shows.
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
        return tuple(self._name(row) for row in self.combination)

    @property
    def units(self) -> tuple[str, ...]:
        """Their units, those of the leading parameters."""
        return tuple(self.parameters[k].unit for k in self.independent)

    @property
    def values(self) -> Array:
        """(b,) their values in the robot."""
        return read_only(self.combination @ standard_values(self.parameters))

    @property
    def sizes(self) -> Array:
        """(p,) what each parameter is compared with."""
        return read_only(np.array([p.size for p in self.parameters]))

    def _name(self, row: Array) -> str:
        relative = np.abs(row) * self.sizes
        lead = int(self.independent[np.flatnonzero(row[self.independent] == 1.0)[0]])
        parts = [self.parameters[lead].name]
        for k in np.flatnonzero(relative > 1e-6 * relative.max()):
            if k != lead:
                factor = "" if abs(abs(row[k]) - 1.0) < 1e-9 else f"{abs(row[k]):.4g} "
                parts.append(f"{'-' if row[k] < 0.0 else '+'} {factor}{self.parameters[k].name}")
        return " ".join(parts)

    def spread(self, change: Array) -> Array:
        """Return (p,) the smallest change of the parameters, relative to sizes, that changes base parameters (b,)."""
        scaled = self.combination * self.sizes
        return self.sizes * np.linalg.lstsq(scaled, change, rcond=None)[0]


def base_parameters(robot: Robot, parameters: Sequence[Parameter]) -> BaseParameters:
    """Return the base parameters of some parameters of a robot, by random closed states.

    The parameters that lead are the first ones: a later one is regrouped into those before it.

    Example:
        >>> base = base_parameters(robot, parameters_of(robot))
        >>> base.names[0]
    """
    rows = random_regressor(robot, parameters)
    sizes = np.array([p.size for p in parameters])
    columns = rows.reshape(-1, rows.shape[-1]) * sizes
    norms = np.linalg.norm(columns, axis=0)
    seen = norms > _DEPENDENT * norms.max(initial=0.0)
    columns = columns / np.where(seen, norms, 1.0)
    independent = _independent_columns(columns * seen)
    combination = np.zeros((len(independent), len(sizes)))
    if len(independent):
        solved = np.linalg.lstsq(columns[:, independent], columns * seen, rcond=None)[0]
        combination = solved * np.where(seen, norms, 0.0) / norms[independent, None]
        combination = combination * (sizes[independent, None] / sizes)
        small = np.abs(solved) < _DEPENDENT
        combination[small] = 0.0
        combination[:, independent] = np.eye(len(independent))
    unseen = tuple(p.name for p, known in zip(parameters, seen, strict=True) if not known)
    return BaseParameters(tuple(parameters), independent, read_only(combination), unseen)


def _independent_columns(columns: Array) -> IntArray:
    """Return which columns (M, p) of unit length, or zero, do not depend on those before them: Gram and Schmidt's QR.

    Householder's would spread what is left of a column over the diagonal entries of dependent ones.
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
