"""What updates promise where no plan keeps every limit, judged by an independent solution of the same programme."""

from __future__ import annotations

import numpy as np
import pytest
from online_programme import Asked

import redundancy_pin as rp
from redundancy_pin.planners.receding_horizon import RecedingHorizon
from redundancy_pin.status import UpdateStatus
from redundancy_pin.trajectory import SpeedProfile, Trajectory
from redundancy_pin.trajectory.paths import circle_path

_ARC = circle_path((0.25, 0.05), 0.09, start_angle=np.pi, sweep=np.pi)
ACROSS = Trajectory(_ARC, SpeedProfile(_ARC.length, 0.45, 0.2))
"""Over the singular line of the 2-RPR and back."""


@pytest.mark.parametrize(("t", "effort", "acceleration"), [(0.0, 0.2, 0.3), (0.08, 0.1, 0.1)])
def test_what_a_relaxed_plan_misses_at_a_singular_instant_is_least_too(
    t: float, effort: float, acceleration: float
) -> None:
    """uᵀ Ẇ τ = uᵀ ḟ cannot be met with efforts (N) and accelerations (m/s²) so small: a square is the cost."""
    robot = rp.load_robot("2rpr", end_effector_mass=0.5, cylinder_mass=0.3)
    limits = rp.Limits(effort=effort, acceleration=acceleration)
    planner = RecedingHorizon(rp.CompiledDynamics(robot), limits=limits)
    command = planner.update(t, ACROSS)
    assert command.status is UpdateStatus.RELAXED
    assert len(command.singular) > 0
    made = planner.updates.last
    assert made is not None
    judge, best = Asked(planner, None, made, (None, None), 0.0).solve()
    assert judge.problem.relaxed
    found, wanted = (judge.unknowns(at, best.tau) for at in (made.at, best.at))
    assert judge.cost(found) <= best.cost * (1.0 + 1e-6)
    rates = judge.written.missing.argmax(axis=2)[:, robot.n :]  # what is missing of these rows
    assert np.abs(wanted[rates]).max() > 0.01
    np.testing.assert_allclose(found[rates], wanted[rates], atol=1e-3 * np.abs(wanted[rates]).max())
    np.testing.assert_allclose(made.multipliers, best.multipliers, atol=1e-3 * np.abs(best.multipliers).max())
