"""Beyond the thesis: its planners beside the one that sees the whole trajectory, on the same motions and limits."""

from redundancy_pin.experiments.beyond.settings import FULL, QUICK, BeyondSettings
from redundancy_pin.experiments.beyond.study import Beyond, run_beyond

__all__ = ["FULL", "QUICK", "Beyond", "BeyondSettings", "run_beyond"]
