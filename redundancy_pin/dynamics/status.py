"""What the distribution of a generalised force over the actuators says about each sample."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from redundancy_pin.arrays import Array, BoolArray, IntArray, peak, read_only


class SampleStatus(IntEnum):
    """Whether and how W τ = f has a solution at one sample. Up to ``SINGULAR_CONSISTENT`` it has one."""

    REGULAR = 0
    """W has full rank and a margin; the efforts balance f."""
    NEAR_SINGULAR = 1
    """As regular, but the margin is below the threshold: expect large efforts."""
    SINGULAR_CONSISTENT = 2
    """W lacks rank, but f lies in its range: finite efforts exist, and those of least norm are returned."""
    SINGULAR_INCONSISTENT = 3
    """W lacks rank and f has a part outside its range: no finite efforts."""
    UNDERACTUATED_INCONSISTENT = 4
    """W has all the rank its columns allow, but there are fewer actuators than freedoms and f has a part that none of
    them can balance: the motion is impossible, though the pose is not singular."""
    BOUND_INFEASIBLE = 5
    """Efforts exist, but none within the bounds."""
    UNREACHABLE = 6
    """No configuration closes the chains, so there is no W and no f."""

    @property
    def label(self) -> str:
        """The name in lower case, as tables and files show it: ``near_singular``."""
        return self.name.lower()


@dataclass(frozen=True, eq=False, repr=False)
class Distribution:
    """Efforts of the main actuators and what they rest on, sample by sample.

    N samples, n independent coordinates, m main actuators. *Scaled* means D_x⁻¹ W D_a and D_x⁻¹ f with
    D_x = diag(row_scale), D_a = diag(column_scale): moments and torques are divided by the robot's characteristic
    length, so that W has no unit and f is in newtons.

    Attributes:
        tau: (N, m) efforts, N or N·m by joint; positive along the joint rate. NaN where there are none.
        status: (N,) a ``SampleStatus`` each.
        rank: (N,) rank of the scaled W; 0 where unreachable.
        residual: (N,) N, scaled. Where tau is finite the norm of W τ − f. Where the status is inconsistent the part
            of f outside the range of W. Where the bounds are infeasible the least norm of W τ − f within them. NaN
            where unreachable.
        margin: (N,) smallest singular value of the scaled W; NaN where unreachable.
        condition: (N,) condition number of the scaled W, infinite where the margin is zero. Of a robot with
            translations and prismatic actuators only it is the condition number of its Jacobian (the 2-RPR in
            Parsa 2014, section 3.2).
        free_direction: (N, m) where the status is singular_consistent, efforts that can be added in any amount
            without changing the motion: W δ = 0, ‖D_a⁻¹ δ‖ = 1, N or N·m by joint. NaN elsewhere. If there are
            several such directions (m − rank > 1), one of them.
        uncontrolled: (N, n) where the rank is below n, a platform velocity that no actuator feels and so none
            resists: Wᵀ ξ = 0, ‖D_x ξ‖ = 1, m/s and rad/s in the base frame. NaN elsewhere. If there are several
            (n − rank > 1), one of them.
    """

    tau: Array
    status: IntArray
    rank: IntArray
    residual: Array
    margin: Array
    condition: Array
    free_direction: Array
    uncontrolled: Array

    def __repr__(self) -> str:
        """Return how many samples have which status, and peaks, not the arrays."""
        found = [(status, int((self.status == status).sum())) for status in SampleStatus]
        counts = ", ".join(f"{count} {status.label}" for status, count in found if count)
        return (
            f"Distribution(N={len(self)}, m={self.tau.shape[1]}: {counts}; {peak('tau', self.tau, 'N or N·m')}, "
            f"least margin {np.nanmin(self.margin, initial=np.inf):.4g})"
        )

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.status)

    @property
    def solved(self) -> BoolArray:
        """(N,) true where tau solves W τ = f."""
        return read_only(self.status <= SampleStatus.SINGULAR_CONSISTENT)

    @property
    def status_labels(self) -> NDArray[np.str_]:
        """(N,) the statuses as text, such as ``"regular"``."""
        return read_only(np.array([status.label for status in SampleStatus])[self.status])
