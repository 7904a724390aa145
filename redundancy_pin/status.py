"""The vocabulary of statuses: one spelling per meaning, for samples, results and on-line updates.

Three enumerations cover every answer of the package. A status is part of an answer, never an exception: arrays hold
the codes of ``SampleStatus``, results and commands hold a member of the other two. Files, ``--json`` and CSV hold the
spelling in lower case (``near_singular``), generated controllers the one in upper case (``ROBOT_NEAR_SINGULAR``).

Example:
    >>> from redundancy_pin.status import ResultStatus, SampleStatus
    >>> SampleStatus(1).label, ResultStatus("ok") is ResultStatus.OK
    ('near_singular', True)
"""

from __future__ import annotations

from enum import Enum

import numpy as np

from redundancy_pin.arrays import BoolArray, IntArray, Labelled

__all__ = ["ResultStatus", "SampleStatus", "UpdateStatus", "solved_status"]


class SampleStatus(Labelled):
    """The answer at one sample, from inverse dynamics, forward kinematics, allocation or a generated controller.

    The first three have efforts, or positions and rates, that solve the equations; so has ``OUT_OF_RANGE``. Results of
    all others are NaN, with exceptions named below.
    """

    OK = 0
    """Solved: W has full rank and a margin, the loops are closed on the branch of the start."""
    NEAR_SINGULAR = 1
    """Solved, but the singularity margin is below the threshold: expect large efforts."""
    SINGULAR_CONSISTENT = 2
    """W lacks rank, but f lies in its range: finite efforts exist, and those of least norm are returned."""
    SINGULAR_INCONSISTENT = 3
    """W lacks rank and f has a part outside its range: no finite efforts balance it."""
    UNDERACTUATED = 4
    """W has all the rank its columns allow, but there are fewer actuators than degrees of freedom and f has a part that
    none of them can balance: the motion is impossible, though the pose is not singular."""
    BOUND_INFEASIBLE = 5
    """Efforts exist, but none within the bounds. An allocation returns those within the bounds of least residual."""
    UNREACHABLE = 6
    """No configuration closes the loops, or redundant motors contradict each other: no W and no f."""
    BRANCH_LOST = 7
    """The loops can be closed, but not on the branch of the start: in another working mode, or beyond samples that are
    singular or unreachable, where kinematics cannot say on which side of the singularity the machine returns."""
    OUT_OF_RANGE = 8
    """Solved, but a joint, maybe a passive one, is beyond its range: the pose cannot be reached. It replaces the three
    statuses with a solution, whose margin and rank are still given; those without one take precedence."""
    TYPE_I = 9
    """A type I singularity: the platform's velocity does not determine the velocities of the joints, so that there is
    no W. Generated controllers and allocations report it; batches mark such samples as unreachable."""
    TYPE_II = 10
    """Forward kinematics at a type II singularity: the motors do not determine the velocity of the platform. The pose
    is known, rates are NaN."""
    NOT_FINITE = 11
    """An input is NaN or infinite, or a result is larger than a double can be. Generated controllers report it."""

    @property
    def solved(self) -> bool:
        """Whether there is a solution, which is returned."""
        return bool(solved_status(np.array(self)))


def solved_status(status: IntArray) -> BoolArray:
    """Return whether samples have a solution, for an array of codes of ``SampleStatus`` of any shape."""
    result: BoolArray = (status <= SampleStatus.SINGULAR_CONSISTENT) | (status == SampleStatus.OUT_OF_RANGE)
    return result


class ResultStatus(Enum):
    """A result as a whole: a plan, the efforts along a motion, a simulation, one cell of a feasibility map."""

    OK = "ok"
    """Complete: efforts are finite and every limit holds on the continuous motion, to 0.1 % (``LIMIT_TOLERANCE``);
    a simulation reached its end, its samples within every limit of the robot."""
    LIMIT_VIOLATED = "limit_violated"
    """A limit is exceeded somewhere on the continuous motion, or the range of a joint is left. Of a simulation: at a
    sample."""
    INFEASIBLE = "infeasible"
    """The planner reports that no plan keeps every limit: an ``InfeasiblePlanError``, where sweeps record it as data.
    For a cell of a feasibility map also: its plan violates a limit or has no finite efforts."""
    UNBOUNDED = "unbounded"
    """No finite efforts, or none within given bounds, exist at some sample or at a singularity between two."""
    UNRESOLVED = "unresolved"
    """Not known from the samples: an effort between them exceeds that actuator's largest at them by more than 5 % of
    the largest of all actuators, or the motion cannot be followed between them. For a cell of a feasibility map:
    nothing is known, since planner or solver failed."""
    NOT_CONVERGED = "not_converged"
    """The solver ended early. A plan keeps every limit but may not be the best; a simulation ends where its
    integration could not continue, and ``reason`` says why."""
    STOPPED = "stopped"
    """An event ended a simulation before its end: the last of ``events``."""


class UpdateStatus(Enum):
    """One control update of the on-line planner."""

    OK = "ok"
    """A plan that keeps every limit, over the whole horizon or to the end of the preview."""
    TIME_SCALED = "time_scaled"
    """Such a plan, but the preview is followed more slowly: at its own speed there was none."""
    RELAXED = "relaxed"
    """No such plan: the one of least violation of W τ = f, or with relaxed limits where carriers are beyond theirs.
    Also a plan whose violation ahead exceeds a tenth of f, where f is not linear."""
    FALLBACK = "fallback"
    """No plan at all, or it came too late: the previous plan continues to its end, then the carriers stand still."""
    REFUSED = "refused"
    """The preview leads where the machine cannot go, at the time in ``reason``: the plan ends there."""
