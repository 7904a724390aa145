"""Rows at one state against the batched rows of the kinematics, which its own tests compare with Pinocchio."""

from __future__ import annotations

import numpy as np
import pytest
import zoo
from spatial_chains import CHAINS, chain_of

from redundancy_pin.kinematics.chain import ClosedChain
from redundancy_pin.kinematics.coordinates import coordinates
from redundancy_pin.robot import Robot

ROUNDING = 1e-13
"""Sums of a dozen products of order 1."""

ROBOTS = [*zoo.SHIPPED, "3rps", *CHAINS]


def robot_called(name: str) -> Robot:
    return chain_of(name) if name in CHAINS else zoo.robot_of(name)


@pytest.mark.parametrize("name", ROBOTS)
def test_rows_and_their_rates_are_those_of_the_kinematics_also_off_the_closures(name: str) -> None:
    robot = robot_called(name)
    q, v = zoo.random_tree(robot, 1, 5)
    chain = ClosedChain(robot)
    expected = chain.system.evaluate(q)
    bias, platform_bias = chain.system.bias(expected, v)
    places = coordinates(robot, expected)
    for i in range(len(q)):
        chain.update(q[i], v[i])
        np.testing.assert_allclose(chain.residual(), expected.phi[i], atol=ROUNDING)
        np.testing.assert_allclose(chain.jacobian(), expected.Jc[i], atol=ROUNDING)
        np.testing.assert_allclose(chain.bias(), bias[i], atol=ROUNDING)
        np.testing.assert_allclose(chain.jacobian_rate() @ v[i], bias[i], atol=ROUNDING)
        np.testing.assert_allclose(chain.platform_jacobian(), expected.Jx[i], atol=ROUNDING)
        np.testing.assert_allclose(chain.platform_jacobian_rate() @ v[i], platform_bias[i], atol=ROUNDING)
        np.testing.assert_allclose(chain.platform_position(), places[i], atol=ROUNDING)
