"""What is known of the platform's motion ahead."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TypeAlias

import numpy as np

from redundancy_pin.arrays import Array, Frozen, require_type
from redundancy_pin.errors import InputError
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.planners.receding_horizon.constants import FOR_EVER, SAME, STILL
from redundancy_pin.trajectory.continuous_motion import Motion, TimedTrajectory, as_motion, is_timed
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial

Source: TypeAlias = "Preview | TimedTrajectory | PlatformMotion | Motion | Callable[[Array], PlatformMotion]"
"""A trajectory, samples, or what returns the motion at (N,) times, s."""


@dataclass(frozen=True, eq=False)
class Preview(Frozen):
    """The platform's motion ahead.

    Attributes:
        motion: returns the motion at (N,) increasing times, s.
        start, end: interval of the motion, s; a trajectory that ends at rest stays at rest after its end.
        changing: whether ``motion`` may answer otherwise when asked again.
        breaks: (b,) times at which its acceleration jumps, s, if known.
    """

    motion: Callable[[Array], PlatformMotion]
    start: float
    end: float
    changing: bool = False
    breaks: Array = field(default_factory=lambda: np.empty(0))

    @property
    def polynomials(self) -> PiecewisePolynomial | None:
        """x, ẋ and ẍ side by side as polynomials, valid until ``moves_until``; None if the motion is not polynomial."""
        motion = self._continuous
        return motion.source if motion is not None and isinstance(motion.source, PiecewisePolynomial) else None

    @property
    def moves_until(self) -> float:
        """Time from which the platform is at rest, s; infinite if unknown."""
        motion = self._continuous
        return np.inf if motion is None or motion.moves_until == motion.end else motion.moves_until

    @property
    def _continuous(self) -> Motion | None:
        motion = getattr(self.motion, "__self__", None)
        return motion if isinstance(motion, Motion) and self.motion == motion.sample_at else None

    def states(self, times: Array) -> tuple[Array, Array, Array]:
        """Return x (N, n), or (N, 4, 4), ẋ and ẍ (N, n) at (N,) increasing times, s."""
        if (continuous := self._continuous) is not None:
            return continuous.states_at(times)  # its values need no further check
        motion = self.motion(times)
        return motion.x, motion.xd, motion.xdd

    @staticmethod
    def of(source: Source) -> Preview:
        """Return a preview of a trajectory, of samples, or of a function of (N,) times, which may change its mind.

        Raises:
            InputError: none of these.
        """
        if isinstance(source, Preview):
            return source
        if isinstance(source, (Motion, PlatformMotion)) or is_timed(source):
            known = source if isinstance(source, Motion) else as_motion(source)
            ends = known.sample_at(np.linspace(known.start, known.end, 9)).xd
            rests = np.abs(ends[-1]).max() <= STILL * np.abs(ends).max()
            polynomials = replace(known, source=known.polynomials)
            prolonged = polynomials.prolonged_until(known.end + FOR_EVER) if rests else polynomials
            return Preview(prolonged.sample_at, known.start, prolonged.end, breaks=prolonged.breaks)
        if callable(source):
            return Preview(_answers(source), -np.inf, np.inf, changing=True)
        raise InputError(
            f"The preview is {type(source).__name__}.",
            remedy="Pass a trajectory, a PlatformMotion, or a function from (N,) times to a PlatformMotion.",
        )


def place_of(x: Array) -> list[float]:
    """Return where a platform is at x, (n,) or a pose (4, 4), as messages have it: m and rad, of a pose its origin."""
    place: list[float] = np.round(x if x.ndim == 1 else x[:3, 3], 4).tolist()
    return place


def _answers(source: Callable[[Array], PlatformMotion]) -> Callable[[Array], PlatformMotion]:
    """Return a function of times that validates its results: a motion, at these times."""

    def answer(times: Array) -> PlatformMotion:
        motion = source(times)
        require_type(motion, PlatformMotion, "A PlatformMotion of the preview", "Return one at the requested times.")
        if len(motion.t) != len(times) or np.abs(motion.t - times).max() > SAME:
            raise InputError(
                f"The preview was asked for {len(times)} instants from t = {times[0]:.6g} s on, and answers for "
                f"{len(motion.t)} from {motion.t[0]:.6g} s on.",
                remedy="Return the motion at the times that are passed.",
            )
        return motion

    return answer
