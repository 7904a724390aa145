"""The cases of the reproduction (``cases.yaml``), the methods that move the carriers, and how much of it all is run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, NamedTuple

from redundancy_pin.simulation.replay import DRIVES, Drive
from redundancy_pin.thesis.case import Case, Mode, options
from redundancy_pin.thesis.table import Record, data

FIRST_MODE: Mode = (1, 1, 1)
"""Working mode of the 3-RRR in the figures; the thesis does not state it."""

ALL_MODES: tuple[Mode, ...] = tuple(product((1, -1), repeat=3))


def read_case(name: str, entry: Mapping[str, Any]) -> Case:
    """Return a case from an entry of the data file."""
    rest: Record = dict(entry)
    path, mode = dict(rest.pop("trajectory")), rest.pop("working_mode", "")
    own = {key: rest.pop(key) for key in ("robot", "planner", "dt", "title") if key in rest}
    arguments, trajectory = options(**rest.pop("set", {})), path.pop("name")
    return Case(name, path=trajectory, path_options=options(**path), arguments=arguments, options=options(**rest),
                working_mode=tuple(1 if sign == "+" else -1 for sign in mode), **own)  # fmt: skip


def _read(section: str) -> tuple[Case, ...]:
    return tuple(read_case(*entry) for entry in data("cases")[section].items())


def motion_name(case: Case) -> str:
    """Return the name of a motion without what its carriers do: ``"corner-r0.025"``."""
    return case.name.rpartition("-")[0]


def without_carriers(case: Case) -> Case:
    """Return the same motion, at the same samples, of the machine without carriers."""
    return replace(case, planner="none", options=())


def parked(case: Case) -> Case:
    """Return the same motion with the carriers parked at s = 0."""
    return replace(case, planner="parked", options=())


MOTIONS, CROSSINGS, CORNERS = _read("motions"), _read("crossings"), _read("corners")
"""Motions without a planner; crossings by switching off and stepwise plans of corners, as in the thesis."""

SINGULAR, TURNS = _read("singular"), _read("turns")
"""Motions through singularities, and corners and square far from them, planned in every way."""

TASKS: tuple[Case, ...] = (*SINGULAR, *TURNS)

HEAVY_CROSSING, HEAVY_LINE = _read("others")

MODE_CASES: tuple[Case, ...] = (
    *CORNERS[:4],
    replace(CORNERS[2].with_options(acceleration=12.0), name="corner-r0.013-lam0-a12"),
    *CORNERS[4:],
    replace(CORNERS[5].with_options(speed=1.2), name="square-lam0-v1.2"),
)
"""Stepwise plans that are made in every working mode; the thesis raises the limits in two of them."""

BY_NAME: Mapping[str, Case] = {case.name: case for case in (*MOTIONS, *CROSSINGS, *CORNERS)}

# --- methods -------------------------------------------------------------------------------------------------------

NONE, PARKED, MOVING = "no carriers", "carriers parked", "carriers moving"
SWITCH_OFF, SWITCH_OFF_LATE = "switching off", "switching off late"
STEPWISE, STEPWISE_HALF = "stepwise λ = 0", "stepwise λ = 0.5"
EFFORT, PEAK, PEAK_FREE = "whole trajectory: effort", "whole trajectory: peak", "whole trajectory: peak (end free)"
ENERGY, SMOOTH = "whole trajectory: energy", "whole trajectory: smooth effort"

SMOOTHING = 0.01
"""Weight of ∫ Σ τ̇² dt beside the effort in smooth plans."""

OBJECTIVES: Mapping[str, tuple[tuple[str, float], ...]] = {
    EFFORT: (("effort", 1.0),),
    PEAK: (("peak", 1.0),),
    PEAK_FREE: (("peak", 1.0),),
    ENERGY: (("energy", 1.0),),
    SMOOTH: (("effort", 1.0), ("effort_rate", SMOOTHING)),
}
"""What each method of the whole-trajectory planner minimises."""

LATE = 20.0
"""Condition number, the largest of the thesis, beyond which the motors are off in the second way of switching off."""

STEP = 5e-3
"""Largest step between nodes, s."""

_NODES = {"line-0.1": 2e-2, "line-0.2": 1e-2, "heavy-line-0.2": 1e-2}
"""The same on slow motions, s."""

_ENERGY_COARSER = 2.0
"""Factor on the step of plans of least energy: absolute values are many rows for the solver."""


def crosses(task: Case) -> bool:
    """Return whether a task crosses a type II singularity."""
    return task.planner == "switch_off"


def methods(task: Case) -> tuple[str, ...]:
    """Return the methods by which a task is carried out, in the order of the tables."""
    if crosses(task):
        return (SWITCH_OFF, SWITCH_OFF_LATE, EFFORT, PEAK, SMOOTH)
    whole = (EFFORT, PEAK, PEAK_FREE, ENERGY) if task.path == "corner" else (EFFORT, PEAK)
    return (NONE, PARKED, STEPWISE, STEPWISE_HALF, *whole)


def by_method(task: Case, method: str, coarser: float = 1.0) -> Case:
    """Return a task by one of ``methods``; its name is the stem of the files of the plan.

    ``coarser`` is a factor on the largest step between the nodes of whole-trajectory plans.
    """
    if method in OBJECTIVES:
        step = coarser * _NODES.get(task.name, STEP)
        step *= _ENERGY_COARSER if method == ENERGY else 1.0
        whole = replace(task, planner="whole_trajectory", dt=step, options=options(objective=OBJECTIVES[method]))
        name = f"{task.name}-{'-'.join(quantity for quantity, _ in OBJECTIVES[method])}"
        if method == PEAK_FREE:
            return replace(whole.with_options(end="free"), name=f"{name}-end-free")
        return replace(whole, name=name)
    other = {NONE: without_carriers(task), PARKED: parked(task), STEPWISE: task.with_options(lam=0.0),
             STEPWISE_HALF: task.with_options(lam=0.5), SWITCH_OFF: task,
             SWITCH_OFF_LATE: task.with_options(threshold=LATE)}[method]  # fmt: skip
    off = method in (SWITCH_OFF, SWITCH_OFF_LATE)
    return replace(other, name=f"{task.name}-{method.replace(' ', '-')}") if off else other


def at_speed(case: Case, speed: float) -> Case:
    """Return a case at another speed, ramps as long in time."""
    own = dict(case.path_options)
    length = own.get("ramp_length")
    scaled = {} if length is None else {"ramp_length": length * speed / own["speed"]}
    return case.with_path(speed=speed, **scaled)


# --- how much is run -----------------------------------------------------------------------------------------------

SPARSE = 5e-3
"""Distance of the samples of replayed switch-off plans, s: the same motion of the carriers, five times faster."""

_LIGHT, _HEAVY, _FIVE_BAR = SINGULAR[0], SINGULAR[2], SINGULAR[5]


class Replayed(NamedTuple):
    """A task by a method, and the drives that replay its plan."""

    task: Case
    method: str
    drives: tuple[Drive, ...] = DRIVES

    @property
    def name(self) -> str:
        """Unique, for tables."""
        return f"{self.task.name}, {self.method}"

    def case(self, coarser: float) -> Case:
        """Return the case whose plan is replayed."""
        planned = by_method(self.task, self.method, coarser)
        return replace(planned, dt=SPARSE) if self.method == SWITCH_OFF else planned


REPLAYED: tuple[Replayed, ...] = (
    Replayed(_LIGHT, SWITCH_OFF, ("open loop", "carriers by motion")),
    Replayed(_LIGHT, EFFORT, ("open loop",)),
    *(Replayed(task, method) for task in (_HEAVY, HEAVY_LINE, _FIVE_BAR) for method in (SWITCH_OFF, EFFORT)),
    *(Replayed(TURNS[0], method) for method in (STEPWISE, STEPWISE_HALF, EFFORT)),
    *(Replayed(task, method) for task in TURNS[1:] for method in (STEPWISE, EFFORT)),
)


class Race(NamedTuple):
    """A motion whose greatest speed is bracketed, from a speed that has a plan.

    Main forces of a ``capped`` one are limited to what switching off needs until the motors are off.
    """

    task: Case
    capped: bool = False


TRADED: tuple[Case, ...] = (_LIGHT, TURNS[0])
"""Tasks whose effort is traded against the carriers' acceleration."""

CHAPTERS = ("planned", "beyond", "future", "replay")


@dataclass(frozen=True)
class Extent:
    """How much of the reproduction is run; the plans that the thesis shows are always made.

    Attributes:
        motions: run without a planner.
        chapters: of ``CHAPTERS``, besides these motions.
        samples: random states of each robot in the cross-check before the job.
        figures: whether all figures are drawn, or only those on the first page of the report.
        parity: plans of the thesis that both backends make.
        modes: working modes of the 3-RRR to compare; the figures show the first one.
        whole_grids: whether to vary what the thesis leaves unstated over whole grids, or only at their ends.
        coarser: factor on the largest step between nodes of every whole-trajectory plan.
        tolerance: width of the bracket of the fastest motion, as a fraction of the speed.
        starts: first guesses in the search for other optima, and for a plan at a speed where one failed.
        starts_coarser, started: factor on the step, and tasks, of plans from several first guesses.
        ratios: weights of the carriers' acceleration in the trade-off, over the one at which both parts of the cost
            would be the same for the plan of least effort.
        races: motions whose fastest is bracketed.
        both_backends: whether both objectives are planned with both backends, or only the first.
        replayed: plans that are replayed.
        jobs: processes; -1 for all cores.
        name: what results call this extent.
    """

    motions: tuple[Case, ...] = MOTIONS
    chapters: tuple[str, ...] = CHAPTERS
    samples: int = 2000
    figures: bool = True
    parity: tuple[Case, ...] = (*CROSSINGS, *CORNERS)
    modes: tuple[Mode, ...] = ALL_MODES
    whole_grids: bool = True
    coarser: float = 1.0
    tolerance: float = 1e-2
    starts: int = 5
    starts_coarser: float = 2.0
    started: tuple[Case, ...] = (_LIGHT, _HEAVY, _FIVE_BAR, *TURNS[:2])
    ratios: tuple[float, ...] = (0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 1e3)
    races: tuple[Race, ...] = (Race(_LIGHT), Race(_LIGHT, capped=True), Race(_HEAVY), Race(SINGULAR[4]))
    both_backends: bool = True
    replayed: tuple[Replayed, ...] = REPLAYED
    jobs: int = -1
    name: str = "full"


FULL = Extent()

QUICK = Extent(
    samples=100, figures=False, parity=(CROSSINGS[0], *CORNERS), modes=(FIRST_MODE,), whole_grids=False, coarser=4.0,
    tolerance=0.1, starts=2, starts_coarser=6.0, started=(_LIGHT,), ratios=(1e-2, 1.0, 100.0),
    races=(Race(SINGULAR[4]),), both_backends=False, replayed=(REPLAYED[0], REPLAYED[2], REPLAYED[10]), jobs=1,
    name="quick",
)  # fmt: skip
"""Coarse, for a look and for tests: one working mode, the ends of the grids, a massless, a missing and a cornering
replay, and the figures of the first page."""
