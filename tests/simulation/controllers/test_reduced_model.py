"""The equations in platform and carrier coordinates against the inverse dynamics of a backend."""

from __future__ import annotations

import numpy as np
import pytest
from crossing_case import corner, crossing

from redundancy_pin.dynamics.rnea import RneaDynamics
from redundancy_pin.errors import SingularPoseError
from redundancy_pin.motion import CarrierMotion, PlatformMotion
from redundancy_pin.simulation.controllers.computed_torque import ReducedModel
from redundancy_pin.simulation.state import closed_state


@pytest.mark.parametrize("case", [crossing, corner])
def test_it_is_the_inverse_dynamics_of_the_backend(case):
    reference = case()
    robot, random = reference.robot, np.random.default_rng(2)
    model = ReducedModel(robot)
    for t in np.linspace(reference.start, reference.end, 5):
        point = reference.at(float(t))
        xd, xdd = random.normal(size=robot.n), random.normal(size=robot.n)
        sd, sdd = random.normal(size=robot.k), random.normal(size=robot.k)
        motion = PlatformMotion([0.0], point.x[None], xd[None], xdd[None])
        along = CarrierMotion(point.s[None], sd[None], sdd[None])
        reduced = RneaDynamics(robot).reduce(motion, along)
        state = closed_state(robot, point.x, xd, point.s, sd)
        evaluated = model.at(state.q, state.v)
        force = evaluated.mass @ np.concatenate([xdd, sdd]) + evaluated.bias
        assert np.allclose(force[: robot.n], reduced.f[0], atol=1e-10)
        assert np.allclose(force[robot.n :], reduced.carrier_force[0], atol=1e-10)
        assert np.allclose(evaluated.W, reduced.W[0], atol=1e-12)
        assert np.allclose(evaluated.mass, evaluated.mass.T)


def test_a_type_one_pose_is_refused():
    robot = corner().robot
    q = np.array(robot.q_reference)
    q[robot.model.joints[robot.model.getJointId("elbow_1")].idx_q] = 0.0  # a straight leg; the rows alone decide
    with pytest.raises(SingularPoseError, match="type I pose"):
        ReducedModel(robot).at(q, np.zeros(robot.model.nv))
