"""Every constant of the on-line planner, a line each: value, unit, meaning, and where the value comes from.

A source is *trial* (chosen on the random paths of ``benchmarks/online.py``), *accuracy* (follows from double precision
or from how accurate the result has to be), *memory*, or *convention*.
"""

from __future__ import annotations

from typing import NamedTuple, TypeVar

from redundancy_pin.planners.limits import LIMIT_TOLERANCE

Number = TypeVar("Number", int, float, tuple[tuple[float, float], ...])


class Constant(NamedTuple):
    """A line of the table. ``in_c``: whether the C text has it too, by the same name."""

    value: float | tuple[tuple[float, float], ...]
    unit: str
    meaning: str
    source: str
    in_c: bool


CONSTANTS: dict[str, Constant] = {}
"""The table, by name."""


def _line(name: str, value: Number, unit: str, meaning: str, source: str, in_c: bool = True) -> Number:
    CONSTANTS[name] = Constant(value, unit, meaning, source, in_c)
    return value


# times
SAME = _line("SAME", 1e-9, "s", "times that differ by less are one", "accuracy: rounding of clocks of hours")
BESIDE = _line("BESIDE", 1e-8, "s", "before and after a jump of ẍ: f and the efforts jump with it", "accuracy")
LATEST = _line(
    "LATEST", 4e6, "s", "latest time of a clock, 46 days: beyond it rounding is half of SAME", "accuracy: 2⁻⁵² of it"
)
FOR_EVER = _line("FOR_EVER", 1e6, "s", "how long a motion that ends at rest is held", "convention", False)
NO_END = _line("NO_END", 1e9, "s", "how long the last rate of slowing down is written out", "convention")
STILL = _line("STILL", 1e-9, "1", "last over largest speed of a motion that ends at rest", "accuracy", False)

# instants at which W τ = f is known
PARTS = _line("PARTS", 8, "1/step", "instants: two crossings closer than that show as a dip of det W", "trial")
INSTANTS = _line(
    "INSTANTS", 320, "1", "most instants at which a plan's efforts are exact", "memory; a plan has 25 to 60"
)
BATCH = _line("BATCH", 128, "1", "instants that are evaluated at once, at most", "memory")
KEPT = _line("KEPT", 3, "steps", "that are past and kept, for nodes around a singular instant that is past", "as ZONE")

# singular instants
POINTS = _line("POINTS", 9, "1", "samples of det W for its polynomial", "accuracy: to rounding for steps to 50 ms")
ROUNDING = _line("ROUNDING", 1e-14, "1", "coefficients of that, over the largest det W, that are none", "accuracy")
SHALLOW = _line(
    "SHALLOW",
    0.1,
    "1",
    "least over largest |det W| of a dip without zeros; a touching parabola: 1/45",
    "accuracy",
)
ROOTED = _line(
    "ROOTED",
    1e-13,
    "1",
    "|det W| over its largest, at a dip or an end, that is a zero: ten roundings of it",
    "accuracy",
)
PI = _line("PI", 3.141592653589793, "rad", "half a turn", "convention")
TOUCH = _line("TOUCH", 1e-3, "1", "|det W| over its largest at a dip that counts as singular", "trial")
AT_REST = _line("AT_REST", 1e-9, "1", "|det W| over its largest that counts as zero", "accuracy")
DIFFERENCE = _line("DIFFERENCE", 1e-4, "s", "central differences of W and f by time", "accuracy: off by its square")
MOST_ROOTS = _line(
    "MOST_ROOTS", 64, "1", "singular instants, or sharp ones, in sight: more end what is in sight", "memory"
)
CURVE = _line("CURVE", 64, "1", "pieces of the platform's time by the clock's within three steps", "memory")
MOST_SINGULAR = _line(
    "MOST_SINGULAR", 12, "1", "singular instants of a plan: the motion behind them is not planned yet", "memory"
)
BORDER_GIVES = _line(
    "BORDER_GIVES", 1e-13, "1", "by which their rows, which may depend on each other, give", "accuracy"
)
SAME_ROW = _line("SAME_ROW", 1e-8, "1", "share of the jerk in such a row below which it has none", "accuracy")
SLOWEST = _line(
    "SLOWEST",
    0.1,
    "1/horizon",
    "of the largest entry of W: rate of W that the size of such a row counts at least",
    "trial",
)
REGULAR = _line(
    "REGULAR", 1e-3, "1", "smallest over largest singular value of W from which W⁻¹ f is the effort", "trial"
)

# nodes
EXTRA = _line("EXTRA", 8, "1", "nodes beyond those of even steps, for finer ones", "trial", False)
NEAR = _line("NEAR", 10, "steps", "from which on nodes are twice as far apart", "trial")
ZONE = _line("ZONE", 2.5, "steps", "around a singular instant, nodes half as far apart: s̈ bends τ there", "trial")
SHARP = _line("SHARP", 0.1, "1", "bend of f within a step over its largest of late that makes nodes finer", "trial")
SHARP_ZONE = _line("SHARP_ZONE", 1.0, "steps", "around such a turn in which they are", "trial")
MOST_SHARP = _line(
    "MOST_SHARP", 3, "1", "such turns with finer nodes, the next ones: the horizon must not be short", "trial"
)
FADES = _line("FADES", 0.5, "s", "in which that largest f falls by half: f has no bound next to out of reach", "trial")
APART_SINGULAR = _line(
    "APART_SINGULAR", 0.05, "steps", "least distance of singular instants from each other and the start", "trial"
)
APART_OTHER = _line("APART_OTHER", 0.2, "steps", "least distance of other nodes from these", "trial")
SOON = _line(
    "SOON", 0.01, "steps", "least distance of a node from the start: one of the last plan that goes is a bend", "trial"
)
FIRST = _line(
    "FIRST", 3, "steps", "in which efforts are exact at every known instant", "trial: 60 ms of missed updates"
)

# where a plan begins
NEAR_ROOT = _line(
    "NEAR_ROOT", 0.25, "steps", "to a singular instant: the last plan leads there, the new one begins there", "trial"
)
SETTLED = _line(
    "SETTLED", 2.0, "steps", "before a singular instant in which measured carriers are not looked at", "trial"
)
BEYOND = _line("BEYOND", 1e-6, "m, m/s", "by which a start may be beyond a limit", "accuracy")

# programmes of an update
FIRST_ROUNDS = _line("FIRST_ROUNDS", 3, "1", "programmes of a first plan, at least", "trial")
MOST_ROUNDS = _line("MOST_ROUNDS", 8, "1", "programmes of an update, at most", "trial")
LINEAR = _line("LINEAR", 1e-2, "1", "of f that a plan may miss at a node, f being linear in its programme", "trial")
CONVERGED = _line(
    "CONVERGED", 2.5, "steps", "before a singular instant in which f is met to EXACT: W⁻¹ magnifies", "trial"
)
EXACT = _line("EXACT", 1e-6, "1", "of f that may be missed there", "accuracy")
STUCK = _line("STUCK", 0.1, "1", "of f that a plan within limits may miss before it counts as relaxed", "trial")
SLOW = _line("SLOW", 0.99, "1", "of the violation before, that a further relaxed programme may keep", "trial")
ASIDE = _line("ASIDE", 0.6, "1", "of half the tracks, out to which other motions to begin with go", "trial")
SMALLEST = _line(
    "SMALLEST", 0.1, "1", "of the efforts of parked carriers, that the unit of effort has at least", "trial"
)
SMALLEST_FORCE = _line("SMALLEST_FORCE", 1e-6, "N, N·m", "unit of f at least", "accuracy")

DEPENDENT = _line(
    "DEPENDENT",
    1e-9,
    "1",
    "of a row of W τ = f that the others leave, over the largest: a row without rank",
    "accuracy",
)
CONVEX = _line("CONVEX", 1e-8, "1", "least weight of s, ṡ and the peak: the cost has one minimum", "accuracy")

# limits
NO_LIMIT = _line("NO_LIMIT", 1e20, "1", "limit, in units, from which there is none", "convention")
CLOSER = _line(
    "CLOSER", 1e-5, "1", "by which limits are closer at the end of the horizon", "accuracy: the next plan has rounding"
)
IN_HAND = _line("IN_HAND", 0.1, "1", "of the acceleration kept at the end of the horizon, for corrections", "trial")
FORCE_KEPT = _line("FORCE_KEPT", 0.98, "1", "of the carriers' forces at nodes: between them they are larger", "trial")
SHORTEST_STOP = _line("SHORTEST_STOP", 1e-9, "s", "a carrier that stops sooner stands", "accuracy")
MOST_ACCELERATION = _line(
    "MOST_ACCELERATION", 1e3, "m/s²", "counted on for coming back from beyond a limit", "convention"
)
TURNING = _line("TURNING", 1.5, "steps", "in which carriers that begin beyond a limit have room to turn", "trial")
GO_BACK = _line("GO_BACK", 0.5, "1", "of the acceleration, by which the room for their way back shrinks", "trial")
AT_LIMIT = _line("AT_LIMIT", 1e-12, "1", "below a limit at which an effort counts as cut off", "accuracy")
LIMIT_TOLERANCE = _line("LIMIT_TOLERANCE", LIMIT_TOLERANCE, "1", "of limits between nodes", "accuracy: as of all plans")
CUT_OFF = _line("CUT_OFF", 1e-3, "1", "of f that limits of effort may cut off between nodes", "trial")
SAME_SPEED = _line("SAME_SPEED", 1e-8, "1", "by which a speed may exceed its limit", "accuracy")

# interior point method
ITERATIONS = _line("ITERATIONS", 40, "1", "steps of a programme at most; 5 in the median", "trial")
RELAXED_ITERATIONS = _line("RELAXED_ITERATIONS", 80, "1", "of a relaxed programme: 15 in the median", "trial")
PRECISION = _line(
    "PRECISION", 1e-9, "1", "by which bounds and rows of singular instants are missed, in units", "accuracy"
)
BARRIER = _line("BARRIER", 1e-9, "1", "mean of slacks times duals, of a cost of size one", "accuracy")
STATIONARY = _line(
    "STATIONARY", 1e-5, "1", "gradient over the largest in it: multipliers are large, and rounded", "accuracy"
)
CENTRED = _line("CENTRED", 0.1, "1", "of BARRIER, that steps aim at least at", "accuracy: to end below it")
DIVERGED = _line("DIVERGED", 1e12, "1", "mean of slacks times duals of a programme without a solution", "convention")
SHORTEST_WAY = _line("SHORTEST_WAY", 1e-8, "1", "of a step that can be gone: the method is stuck below it", "accuracy")
CLOSE = _line("CLOSE", 0.995, "1", "of the way to the nearest bound", "Mehrotra (1992)")
LEAST_SLACK = _line("LEAST_SLACK", 0.05, "1", "of a first point, in units", "trial: half the iterations of PIQP")
FIRST_BARRIER = _line("FIRST_BARRIER", 1e-2, "1", "slack times dual there", "trial")
RELAXED_SLACK = _line("RELAXED_SLACK", 0.5, "1", "least slack of a first point of a relaxed programme", "trial")
RELAXED_BARRIER = _line(
    "RELAXED_BARRIER", 10.0, "1", "slack times dual there: the cost of what is missed is large", "trial"
)
WARM_SLACK = _line("WARM_SLACK", 5e-3, "1", "least slack where nearly the same programme has a solution", "trial")
WARM_BARRIER = _line("WARM_BARRIER", 3e-5, "1", "slack times dual there", "trial")
WITHIN = _line("WITHIN", 0.9, "1", "of the limits of acceleration, at most of a first point", "trial")
DAMPING = _line("DAMPING", 1e-2, "1", "of a first point: weight of the efforts, that of accelerations being 1", "trial")

# slowing down
SLOWER = _line(
    "SLOWER",
    (
        *((0.85, 0.8), (0.7, 0.8), (0.5, 0.8), (0.3, 0.8), (0.5, 0.4), (0.2, 0.4), (0.0, 0.8), (0.0, 0.4)),
        *((0.85, 0.2), (0.7, 0.2), (0.5, 0.2)),
    ),
    "1, horizon",
    "factors of σ̇, and within which part of the horizon",
    "trial: without the last three one of 16 runs of weak carriers had an update without a plan, with them none of 56",
)
FASTER = _line("FASTER", 0.25, "1", "by which σ̇ rises where the whole of the speed is too much", "trial")
RISE = _line("RISE", 0.8, "horizon", "within which part it does", "trial")
CREEPING = _line("CREEPING", 0.05, "1", "σ̇ below which it rises by as much: to creep over a singular pose", "trial")
LEAST_RATE = _line("LEAST_RATE", 5e-3, "1", "σ̇ below which the platform rather stands still", "trial")
HOLD = _line("HOLD", 5, "steps", "from one change of σ̇, or one that was tried, to the next rise", "trial")
FULL = _line("FULL", 1.0 - 1e-9, "1", "σ̇ from which the speed is that of the preview", "accuracy")

# whole motions (``run_online``)
SAMPLES = _line("SAMPLES", 0.0025, "s", "between samples of the plan of a run", "convention", False)
STRAIGHT = _line(
    "STRAIGHT", 1e-4, "1", "singular value of W, over the largest, below which efforts are straight in time",
    "trial: a longer stretch would miss f by over a millionth, in a shorter one W⁻¹ magnifies", False,
)  # fmt: skip
STRAIGHT_PIECES = _line("STRAIGHT_PIECES", 16, "1", "pieces of the efforts there, at least", "trial", False)
STANDING = _line(
    "STANDING", 4.0, "horizons", "a platform that has stood so long is not expected to go on", "convention", False
)
LONGEST = _line(
    "LONGEST", 20.0, "durations", "of a motion, after which a planner has not found a way", "convention", False
)
