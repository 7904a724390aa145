"""Outside engines: the planned efforts in Exudyn and MuJoCo, and how far their motion is from the planned one.

A plan claims that certain efforts make a certain motion. An engine that shares no code with this package is given the
efforts and an exact initial state; nothing controls it. What it computes has to be the planned motion, through
singular poses as well (docs/validation.md). Needs the extra ``engines``.
"""

from engines.drive import Drive, commanded, drive_of_motion, drive_of_plan
from engines.exudyn import run_exudyn
from engines.mujoco import run_mujoco
from engines.own import run_own
from engines.run import Deviation, EngineRun, deviation
from engines.sensitivity import open_loop_growth
from engines.task import Efforts, Task

__all__ = [
    "Deviation",
    "Drive",
    "Efforts",
    "EngineRun",
    "Task",
    "commanded",
    "deviation",
    "drive_of_motion",
    "drive_of_plan",
    "open_loop_growth",
    "run_exudyn",
    "run_mujoco",
    "run_own",
]
