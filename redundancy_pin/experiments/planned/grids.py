"""What the thesis leaves unstated, as grids over which a case is varied."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

from redundancy_pin.experiments.planned.cases import Case, Mode, StepwiseCase, SwitchOffCase

_RAMP_TIME = {"circle": 0.2, "line": 1.0, "corner": 0.4, "square": 0.2}
"""Duration T of the ramps, s."""

_CORNER_SPEED = 0.2
"""Cruising speed v of the 3-RRR, m/s; the 2-RPR's cases have their own."""


@dataclass(frozen=True)
class Grid:
    """Variations of one unstated parameter.

    Attributes:
        parameter: its name.
        values: for people, ``"0.4 to 0.6 v T"``.
        cases: from a case to its variations.
    """

    parameter: str
    values: str
    cases: Callable[[Case], tuple[Case, ...]]


def with_options(case: Case, **options: float) -> Case:
    """Return a case with other options of its path."""
    merged: Mapping[str, float] = {**case.path_options, **options}
    return replace(case, path_options=merged)


def ramp_lengths(fractions: Sequence[float]) -> Grid:
    """Return ramp lengths p as fractions of v T (speed and duration of the ramp)."""

    def cases(case: Case) -> tuple[Case, ...]:
        cruised = case.path_options.get("speed", _CORNER_SPEED) * _RAMP_TIME[case.path]
        return tuple(with_options(case, ramp_length=fraction * cruised) for fraction in fractions)

    return Grid("ramp length p", f"{_listed(fractions)} v T", cases)


def return_times(values: Sequence[float]) -> Grid:
    """Return durations of the carriers' return, s."""
    return Grid(
        "return time",
        f"{_listed(values)} s",
        lambda case: tuple(replace(case, return_time=value) for value in values),
    )


def steps(values: Sequence[float]) -> Grid:
    """Return time steps, s; of a crossing by backward differences, the only scheme in which the step matters."""

    def cases(case: Case) -> tuple[Case, ...]:
        if isinstance(case, SwitchOffCase):
            return tuple(replace(case, dt=value, scheme="backward_differences") for value in values)
        return tuple(replace(case, dt=value) for value in values)

    return Grid("step δt", f"{_listed([1e3 * value for value in values])} ms", cases)


def steps_and_returns(values: Sequence[float], durations: Sequence[float]) -> Grid:
    """Return all pairs of time step and return time, s, by backward differences."""
    first, second = steps(values), return_times(durations)
    return Grid(
        "step δt and return time",
        f"{first.values}; {second.values}",
        lambda case: tuple(pair for one in first.cases(case) for pair in second.cases(one)),
    )


def ramp_down_samples(values: Sequence[float]) -> Grid:
    """Return starts of the ramp-down, s before the window: on a time grid the ramp starts up to one step late."""

    def cases(case: Case) -> tuple[Case, ...]:
        return tuple(replace(case, ramp_down=value) for value in values) if isinstance(case, SwitchOffCase) else ()

    return Grid("sample at which the ramp starts", f"{_listed(values)} s before the threshold", cases)


def thresholds(values: Sequence[float]) -> Grid:
    """Return thresholds of the condition number."""

    def cases(case: Case) -> tuple[Case, ...]:
        return tuple(replace(case, threshold=value) for value in values) if isinstance(case, SwitchOffCase) else ()

    return Grid("threshold", _listed(values), cases)


def modes(values: Sequence[Mode]) -> Grid:
    """Return working modes."""

    def cases(case: Case) -> tuple[Case, ...]:
        return tuple(replace(case, mode=mode) for mode in values) if isinstance(case, StepwiseCase) else ()

    return Grid("working mode", f"{len(values)} modes", cases)


def orientations(values: Sequence[float]) -> Grid:
    """Return constant orientations α of the platform, rad."""
    return Grid(
        "orientation α",
        f"{_listed(values)} rad",
        lambda case: tuple(with_options(case, alpha=value) for value in values),
    )


def _listed(values: Sequence[float]) -> str:
    return ", ".join(f"{value:g}" for value in values)
