"""Replay: what the machine does with the plans, open loop and under control."""

from redundancy_pin.experiments.replay.study import FULL, QUICK, Replays, ReplaySettings, run_replays

__all__ = ["FULL", "QUICK", "ReplaySettings", "Replays", "run_replays"]
