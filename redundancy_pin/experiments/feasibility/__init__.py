"""What a machine can do: two of its parameters swept over a grid, and the border between possible and impossible.

    from redundancy_pin.experiments.feasibility import MapProblem, feasibility_map, spaced, write_map

    problem = MapProblem("2rpr", spaced("speed", 0.2, 2.0, 10), spaced("stroke", 0.1, 1.2, 12), "circle")
    found = feasibility_map(problem, "journal.jsonl", refine=2)  # run again after an interruption: it goes on
    print(found.border("whole-trajectory"))
    write_map(found, "map-2rpr")

Cells are computed by joblib; within ``joblib.parallel_config(backend=...)`` by the backend named there, such as a
cluster.
"""

from redundancy_pin.experiments.feasibility.axis import Axis, parse_axis, spaced
from redundancy_pin.experiments.feasibility.cell import Cell, Verdict
from redundancy_pin.experiments.feasibility.planning import compute
from redundancy_pin.experiments.feasibility.presets import OTHER, PRESETS, Preset
from redundancy_pin.experiments.feasibility.problem import LIMITS, STEPWISE, SWITCH_OFF, WHOLE, MapProblem
from redundancy_pin.experiments.feasibility.result import Crossing, FeasibilityMap
from redundancy_pin.experiments.feasibility.sweep import feasibility_map
from redundancy_pin.experiments.feasibility.written import write_map

__all__ = [
    "LIMITS",
    "OTHER",
    "PRESETS",
    "STEPWISE",
    "SWITCH_OFF",
    "WHOLE",
    "Axis",
    "Cell",
    "Crossing",
    "FeasibilityMap",
    "MapProblem",
    "Preset",
    "Verdict",
    "compute",
    "feasibility_map",
    "parse_axis",
    "spaced",
    "write_map",
]
