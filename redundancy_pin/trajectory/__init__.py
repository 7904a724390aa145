"""Trajectories: polynomials from boundary conditions, paths by arc length, timing laws, sampled motion.

The thesis's own trajectories are the functions of ``reference``.
"""

from redundancy_pin.arrays import Side
from redundancy_pin.trajectory import reference
from redundancy_pin.trajectory.csv_file import carriers_from_csv, from_csv
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial
from redundancy_pin.trajectory.paths import (
    Arc,
    ChainedPath,
    Line,
    Path,
    PathPoint,
    PoseLine,
    circle_path,
    with_constant,
)
from redundancy_pin.trajectory.points import from_points
from redundancy_pin.trajectory.timing import (
    RestToRest,
    SpeedProfile,
    TimingLaw,
    TimingPoint,
    boundary_polynomial,
    rest_to_rest_345,
    rest_to_rest_4567,
)
from redundancy_pin.trajectory.trajectory import Trajectory, TrajectoryPoint
from redundancy_pin.trajectory.waypoints import (
    PosePath,
    SplinePath,
    TimedSpline,
    corner_path,
    rounded_polygon,
    through_points,
)

__all__ = [
    "Arc",
    "ChainedPath",
    "Line",
    "Path",
    "PathPoint",
    "PiecewisePolynomial",
    "PoseLine",
    "PosePath",
    "RestToRest",
    "Side",
    "SpeedProfile",
    "SplinePath",
    "TimedSpline",
    "TimingLaw",
    "TimingPoint",
    "Trajectory",
    "TrajectoryPoint",
    "boundary_polynomial",
    "carriers_from_csv",
    "circle_path",
    "corner_path",
    "from_csv",
    "from_points",
    "reference",
    "rest_to_rest_345",
    "rest_to_rest_4567",
    "rounded_polygon",
    "through_points",
    "with_constant",
]
