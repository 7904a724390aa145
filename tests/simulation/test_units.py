"""A machine in other units of length, mass and time is simulated alike: same status, same steps, same motion."""

from __future__ import annotations

import numpy as np
import pytest
from folding import folding_four_bar
from scaled import Units, scaled_robot
from spatial_chains import chain_of

import redundancy_pin as rp
from redundancy_pin.dynamics.rnea import RneaDynamics
from redundancy_pin.robot.scales import position_unit
from redundancy_pin.simulation.state import closed_state, tree_state


@pytest.mark.parametrize(
    "name", [*("hinge", "universal"), *(pytest.param(n, marks=pytest.mark.long) for n in ("cylindrical", "rod"))]
)
@pytest.mark.parametrize("length", [1e-6, pytest.param(1e2, marks=pytest.mark.long), 1e6])
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


@pytest.mark.parametrize(
    "units",
    [
        pytest.param(Units(length=1e6), marks=pytest.mark.long),
        Units(length=1e-6),
        pytest.param(Units(time=1e-6), marks=pytest.mark.long),
        Units(time=1e6),
    ],
    ids=repr,
)
@pytest.mark.parametrize("backend", [rp.CompiledDynamics, RneaDynamics])
def test_a_crank_turns_through_the_flat_pose_of_a_four_bar_in_every_unit(units, backend, tmp_path) -> None:
    own = folding_four_bar(tmp_path, (0.4, 0.2, 0.35, 0.25), (1.0, 1.9, 1.5))
    runs = []
    for robot, time in ((own, 1.0), (scaled_robot(own, units), units.time)):
        start = closed_state(robot, xd=[6.0 / time])
        runs.append(rp.simulate(robot, start=start, duration=0.6 * time, dt=0.1 * time, dynamics=backend(robot)))
    assert [run.status.value for run in runs] == ["ok", "ok"], runs[1].reason
    assert runs[1].statistics.steps == pytest.approx(runs[0].statistics.steps, rel=0.1)
    assert runs[0].q[-1, 0] - runs[0].q[0, 0] > np.pi - 1.0  # beyond the flat pose at π
    np.testing.assert_allclose(runs[1].q, runs[0].q, atol=1e-7)


def test_a_start_that_is_open_by_a_tenth_of_a_small_machine_is_refused() -> None:
    robot = scaled_robot(rp.load_robot("five_bar"), Units(length=1e-6))
    start = closed_state(robot)
    q = np.array(start.q)
    q[robot.actuated_velocity[0]] += 0.1
    with pytest.raises(rp.errors.InputError, match="not closed"):
        rp.simulate(robot, start=tree_state(robot, q, start.v), duration=0.1)
