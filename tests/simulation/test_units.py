"""A machine in other units of length, mass and time is simulated alike: same status, same steps, same motion."""

from __future__ import annotations

import numpy as np
import pytest
from scaled import Units, scaled_robot
from spatial_chains import chain_of

import redundancy_pin as rp
from redundancy_pin.dynamics.rnea import RneaDynamics
from redundancy_pin.robot.scales import position_unit
from redundancy_pin.simulation.state import closed_state


@pytest.mark.parametrize("name", ["hinge", "universal", "cylindrical"])
@pytest.mark.parametrize("length", [1e-6, 1e2])
@pytest.mark.parametrize("backend", [rp.CompiledDynamics, RneaDynamics])
def test_closures_of_lengths_and_angles_keep_their_rank_in_every_unit_of_length(name, length, backend) -> None:
    robots = chain_of(name), scaled_robot(chain_of(name), Units(length=length))
    runs = [
        rp.simulate(robot, start=closed_state(robot, xd=[3.0]), duration=0.3, dynamics=backend(robot))
        for robot in robots
    ]
    assert [run.status.value for run in runs] == ["ok", "ok"]
    assert runs[0].statistics.restarts == runs[1].statistics.restarts == 1
    own, other = (run.q / position_unit(robot) for run, robot in zip(runs, robots, strict=True))
    assert np.abs(own[-1] - own[0]).max() > 0.5
    np.testing.assert_allclose(other, own, atol=1e-8)
