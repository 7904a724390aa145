"""The cases of the reproduction: every motion of the thesis and beyond it, by every method that moves the carriers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import product
from typing import NamedTuple

from redundancy_pin.simulation.replay import DRIVES, Drive
from redundancy_pin.thesis.case import Case, Mode, options

FIRST_MODE: Mode = (1, 1, 1)
"""Working mode of the 3-RRR in the figures; the thesis does not state it."""

ALL_MODES: tuple[Mode, ...] = tuple(product((1, -1), repeat=3))


# --- motions without a planner -------------------------------------------------------------------------------------


def _two_rpr(path: str, speed: float) -> Case:
    title = f"2-RPR, {path} at {speed:g} m/s"
    return Case(f"{path}-{speed:g}-parked", "2rpr", path, options(speed=speed), working_mode=(1, 1), title=title)


def _three_rrr(path: str, **path_options: float) -> tuple[Case, Case]:
    what = f"corner of radius {path_options['radius']:g} m" if path == "corner" else path
    name = f"{path}-r{path_options['radius']:g}" if path == "corner" else path
    parked = Case(f"{name}-parked", "3rrr", path, options(**path_options), working_mode=FIRST_MODE,
                  title=f"3-RRR, {what}")  # fmt: skip
    return replace(parked, name=f"{name}-baseline", planner="none"), parked


# The 2-RPR of the thesis is massless but for its carriers: without them every force is zero, and there is no baseline.
MOTIONS: tuple[Case, ...] = (
    _two_rpr("circle", 0.5),
    _two_rpr("circle", 0.75),
    _two_rpr("line", 0.1),
    _two_rpr("line", 0.2),
    *_three_rrr("corner", radius=0.025),
    *_three_rrr("corner", radius=0.013),
    *_three_rrr("square"),
)
"""Every motion of the thesis with carriers parked, and without carriers."""


def motion_name(case: Case) -> str:
    """Return the name of a motion without what its carriers do: ``"corner-r0.025"``."""
    return case.name.rpartition("-")[0]


# --- planned as in the thesis --------------------------------------------------------------------------------------

RETURN_TIME = 0.4
"""Duration of the carriers' return on circle and line, s; the thesis does not state it."""

SQUARE_RETURN_TIME = 0.6
"""The same on the square, where 0.65 s lie between the first ramp and the first corner."""

STEP = 5e-3
"""Time step of the stepwise planner, s; the thesis does not state it."""


def _crossing(path: str, speed: float, threshold: float, ramp_down: float) -> Case:
    name = f"{path}-{speed:g}-cn{threshold:g}"
    return _switching_off(name, _two_rpr(path, speed), threshold=threshold, ramp_down=ramp_down)


def _switching_off(name: str, motion: Case, **parameters: float) -> Case:
    return replace(motion.with_planner("switch_off", return_time=RETURN_TIME, **parameters), name=name)


def corner(radius: float, lam: float = 0.0, mode: Mode = FIRST_MODE) -> Case:
    """Return a stepwise plan of a corner with the carriers' limits of the thesis (1 m/s, 7 m/s²)."""
    motion = replace(_three_rrr("corner", radius=radius)[1], working_mode=mode)
    planned = motion.with_planner("stepwise", STEP, lam=lam, return_time=SQUARE_RETURN_TIME)
    return replace(planned, name=f"corner-r{radius:g}-lam{lam:g}")


def square(lam: float = 0.0, mode: Mode = FIRST_MODE) -> Case:
    """Return a stepwise plan of the square; carriers return while the platform does not accelerate."""
    motion = replace(_three_rrr("square")[1], working_mode=mode)
    planned = motion.with_planner("stepwise", STEP, lam=lam, active="accelerating", return_time=SQUARE_RETURN_TIME)
    return replace(planned, name=f"square-lam{lam:g}")


CROSSINGS: tuple[Case, ...] = (
    _crossing("circle", 0.5, 5.0, 0.03),
    _crossing("circle", 0.5, 10.0, 0.03),
    _crossing("circle", 0.5, 20.0, 0.03),
    _crossing("circle", 0.75, 5.0, 0.03),
    _crossing("line", 0.1, 4.0, 0.36),
    _crossing("line", 0.2, 4.0, 0.36),
    _crossing("line", 0.2, 15.0, 0.36),
)
"""The crossings whose results the thesis shows. Its threshold at 0.1 m/s is not stated: 4 as at 0.2 m/s."""

CORNERS: tuple[Case, ...] = (
    corner(0.025, 0.0),
    corner(0.025, 0.5),
    corner(0.013, 0.0),
    corner(0.013, 0.5),
    square(0.5),
    square(0.0),
)
"""The stepwise plans whose results the thesis shows, and λ = 0.5 at the sharper corner."""

HEAVY_CROSSING = replace(CROSSINGS[0], name="circle-0.5-heavy", arguments=options(end_effector_mass=0.5))
"""The method tried with an end-effector of the mass, kg, of the 3-RRR's platform."""

MODE_CASES: tuple[Case, ...] = (
    *CORNERS[:4],
    replace(CORNERS[2].with_options(acceleration=12.0), name="corner-r0.013-lam0-a12"),
    *CORNERS[4:],
    replace(CORNERS[5].with_options(speed=1.2), name="square-lam0-v1.2"),
)
"""Stepwise plans that are made in every working mode; the thesis raises the limits in two of them."""

BY_NAME: Mapping[str, Case] = {case.name: case for case in (*MOTIONS, *CROSSINGS, *CORNERS)}


def without_carriers(case: Case) -> Case:
    """Return the same motion, at the same samples, of the machine without carriers."""
    return replace(case, planner="none", options=())


def parked(case: Case) -> Case:
    """Return the same motion with the carriers parked at s = 0."""
    return replace(case, planner="parked", options=())


# --- beyond the thesis ---------------------------------------------------------------------------------------------

NONE = "no carriers"
PARKED = "carriers parked"
SWITCH_OFF = "switching off"
SWITCH_OFF_LATE = "switching off late"
STEPWISE = "stepwise λ = 0"
STEPWISE_HALF = "stepwise λ = 0.5"
EFFORT = "whole trajectory: effort"
PEAK = "whole trajectory: peak"
PEAK_FREE = "whole trajectory: peak (end free)"
ENERGY = "whole trajectory: energy"
SMOOTH = "whole trajectory: smooth effort"

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

_ENERGY_COARSER = 2.0
"""Factor on the step of plans of least energy: absolute values are many rows for the solver."""

_NODES = {"line-0.1": 2e-2, "line-0.2": 1e-2, "heavy-line-0.2": 1e-2}
"""Largest step between nodes, s, on slow motions; 5 ms elsewhere."""

_MASSES = options(end_effector_mass=0.5, cylinder_mass=0.3)
_WITH_MASSES = "2-RPR with masses (end-effector 0.5 kg, cylinders 0.3 kg)"


def _cross(name: str, motion: Case, threshold: float = 5.0, ramp_down: float = 0.03) -> Case:
    if motion.path == "circle":  # ramps of the 3-4-5 shape, not the thesis's overshooting one: v T / 2 with T = 0.2 s
        motion = motion.with_path(ramp_time=0.2, ramp_length=0.1 * motion.option("speed"))
    return _switching_off(name, motion, threshold=threshold, ramp_down=ramp_down)


def _with_masses(path: str, speed: float) -> Case:
    return replace(_two_rpr(path, speed), arguments=_MASSES, title=f"{_WITH_MASSES}, {path} at {speed:g} m/s")


_DESCENT = Case(
    "five-bar-0.3", "five_bar", "polygon",
    options(vertices=((0.25, 0.6), (0.32, 0.3)), radius=0.01, speed=0.3, ramp_time=0.2),  # a line: there is no corner
    working_mode=(1, -1), arguments=options(carriers=True),
    title="five-bar, straight down through its singularity at 0.3 m/s",
)  # fmt: skip

SINGULAR: tuple[Case, ...] = (
    _cross("circle-0.5", _two_rpr("circle", 0.5)),
    _cross("circle-0.75", _two_rpr("circle", 0.75)),
    _cross("heavy-0.5", _with_masses("circle", 0.5)),
    _cross("line-0.1", _two_rpr("line", 0.1), 4.0, 0.36),
    _cross("line-0.2", _two_rpr("line", 0.2), 4.0, 0.36),
    _cross("five-bar-0.3", _DESCENT),
)
"""Motions through type II singularities, planned by switching off."""

TURNS: tuple[Case, ...] = (
    replace(corner(0.025), name="corner-r0.025"),
    replace(corner(0.013), name="corner-r0.013"),
    replace(square(), name="square", title="3-RRR, square with corners of radius 0.025 m"),
)
"""Motions of chapter 4, far from singularities, planned stepwise."""

TASKS: tuple[Case, ...] = (*SINGULAR, *TURNS)

HEAVY_LINE = _cross("heavy-line-0.2", _with_masses("line", 0.2), 4.0, 0.36)


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
    if method in (NONE, PARKED):
        return without_carriers(task) if method == NONE else parked(task)
    if method in (STEPWISE, STEPWISE_HALF):
        return task.with_options(lam=0.0 if method == STEPWISE else 0.5)
    if method in (SWITCH_OFF, SWITCH_OFF_LATE):
        late = task.with_options(threshold=LATE) if method == SWITCH_OFF_LATE else task
        return replace(late, name=f"{task.name}-{method.replace(' ', '-')}")
    step = coarser * _NODES.get(task.name, STEP) * (_ENERGY_COARSER if method == ENERGY else 1.0)
    whole = task.with_planner("whole_trajectory", step, objective=OBJECTIVES[method])
    name = f"{task.name}-{'-'.join(quantity for quantity, _ in OBJECTIVES[method])}"
    if method == PEAK_FREE:
        return replace(whole.with_options(end="free"), name=f"{name}-end-free")
    return replace(whole, name=name)


def at_speed(case: Case, speed: float) -> Case:
    """Return a case at another speed, ramps as long in time."""
    own = dict(case.path_options)
    length = own.get("ramp_length")
    scaled = {} if length is None else {"ramp_length": length * speed / own["speed"]}
    return case.with_path(speed=speed, **scaled)


# --- how much is run -----------------------------------------------------------------------------------------------

SPARSE = 5e-3
"""Distance of the samples of replayed switch-off plans, s: the same motion of the carriers, five times faster."""

_MASSLESS: tuple[Drive, ...] = ("open loop", "carriers by motion")
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
    Replayed(_LIGHT, SWITCH_OFF, _MASSLESS),
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


RACES = (Race(_LIGHT), Race(_LIGHT, capped=True), Race(_HEAVY), Race(SINGULAR[4]))

STARTED: tuple[Case, ...] = (_LIGHT, _HEAVY, _FIVE_BAR, *TURNS[:2])
"""Tasks that are planned from several first guesses."""

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
        starts_coarser: the factor for plans from several first guesses.
        started: tasks that are planned from them.
        ratios: weights of the carriers' acceleration in the trade-off, over the one at which both parts of the cost
            would be the same for the plan of least effort.
        races: motions whose fastest is bracketed.
        both_backends: whether both objectives are planned with both backends, or only the first.
        replayed: plans that are replayed.
        jobs: processes; -1 for all cores.
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
    started: tuple[Case, ...] = STARTED
    ratios: tuple[float, ...] = (0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 1e3)
    races: tuple[Race, ...] = RACES
    both_backends: bool = True
    replayed: tuple[Replayed, ...] = REPLAYED
    jobs: int = -1


FULL = Extent()

QUICK = Extent(
    samples=100,
    figures=False,
    parity=(CROSSINGS[0], *CORNERS),
    modes=(FIRST_MODE,),
    whole_grids=False,
    coarser=4.0,
    tolerance=0.1,
    starts=2,
    starts_coarser=6.0,
    started=STARTED[:1],
    ratios=(1e-2, 1.0, 100.0),
    races=RACES[3:],
    both_backends=False,
    replayed=(REPLAYED[0], REPLAYED[2], REPLAYED[10]),
    jobs=1,
)
"""Coarse, for a look and for tests: one working mode, the ends of the grids, a massless, a missing and a cornering
replay, and the figures of the first page."""
