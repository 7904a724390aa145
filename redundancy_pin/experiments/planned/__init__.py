"""The planned experiments of the thesis: chapters 3 and 4 repeated, judged and compared fairly."""

from redundancy_pin.experiments.planned.settings import FULL, QUICK, StudySettings
from redundancy_pin.experiments.planned.study import Study, run_study

__all__ = ["FULL", "QUICK", "Study", "StudySettings", "run_study"]
