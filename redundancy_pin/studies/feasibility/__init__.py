"""What a machine can do: two of its parameters swept over a grid, and the border between possible and impossible.

    from redundancy_pin.studies.feasibility import MapProblem, feasibility_map, spaced, write_map

    problem = MapProblem("2rpr", spaced("speed", 0.2, 2.0, 10), spaced("stroke", 0.1, 1.2, 12), "circle")
    result = feasibility_map(problem, "store.sqlite", refine=2)  # run again after an interruption: it goes on
    print(result.border("whole-trajectory"))
    write_map(result, "map-2rpr")

Cells are computed by joblib; within ``joblib.parallel_config(backend=...)`` by the backend named there, such as a
cluster.
"""

from redundancy_pin.studies.feasibility.picture import write_map
from redundancy_pin.studies.feasibility.problem import (
    LIMITS,
    OTHER,
    PRESETS,
    STEPWISE,
    SWITCH_OFF,
    WHOLE,
    Axis,
    MapProblem,
    Preset,
    parse_axis,
    spaced,
)
from redundancy_pin.studies.feasibility.sweep import Cell, Crossing, FeasibilityMap, Verdict, compute, feasibility_map

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
