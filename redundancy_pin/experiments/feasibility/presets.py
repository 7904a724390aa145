"""Maps worth having of the two machines of the thesis: what a user gets who names nothing but the robot."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from redundancy_pin.experiments.feasibility.problem import STEPWISE, SWITCH_OFF


@dataclass(frozen=True)
class Preset:
    """What a map is of where nothing else is said.

    Attributes:
        trajectory: the motion.
        x, y: axes, as text.
        thesis: the planner of the thesis for this machine.
        limits: limits beside the robot's own.
        options: of the trajectory.
    """

    trajectory: str
    x: str
    y: str
    thesis: str
    limits: Mapping[str, float] = field(default_factory=dict)
    options: Mapping[str, float] = field(default_factory=dict)


PRESETS: Mapping[str, Preset] = {
    "2rpr": Preset("circle", "speed=0.2:2.0:10", "stroke=0.1:1.2:12", SWITCH_OFF),
    # a corner has no singularity: it is the limit of the torques that separates one planner from the other
    "3rrr": Preset("corner", "speed=0.06:0.3:9", "stroke=0.2:2.0:10", STEPWISE, {"max_effort": 5.0}),
}
"""By the robot's name. The 3-RRR may use 5 N·m: its corner at 0.2 m/s needs 3.0 N·m without carriers."""

OTHER = Preset("line", "speed=0.1:1.0:10", "stroke=0.1:1.0:10", STEPWISE)
"""For robots of the user's own, whose trajectory has to be named anyway."""
