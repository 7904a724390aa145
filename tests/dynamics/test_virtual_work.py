"""The virtual-work backend as planners see it: shapes, refusals, marks, scales, carriers that are not there."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from scipy.optimize import brentq

import redundancy_pin as rp
from redundancy_pin.dynamics.virtual_work import VirtualWork
from redundancy_pin.errors import (
    InputError,
    SingularPoseError,
    UnreachablePoseError,
    UnsupportedRobotError,
)
from redundancy_pin.robot.urdf import models_root

START = {"2rpr": [0.25, 0.4], "3rrr": [0.9, 0.5, 0.1]}
UP = np.array([np.cos(np.pi / 6), np.sin(np.pi / 6)])
STRETCHED = {"2rpr": [0.0, 0.0], "3rrr": [*(2.25 * UP), 0.0]}
"""Type I: leg 1 of the 2-RPR has no length; leg 1 of the 3-RRR is straight."""


@pytest.fixture(scope="module", params=["2rpr", "3rrr"])
def robot(request):
    return rp.load_robot(request.param, gravity=[0.3, -9.0, 2.0])


def motion_of(robot, samples=7):
    rng = np.random.default_rng(3)
    x = START[robot.name] + 0.1 * rng.uniform(-1, 1, (samples, robot.n))
    return rp.PlatformMotion(np.arange(samples), x, *rng.normal(size=(2, samples, robot.n)), check_rates=False)


def carriers_of(robot, samples=7):
    return rp.CarrierMotion(*np.random.default_rng(4).uniform(-0.19, 0.19, (3, samples, robot.k)), check_rates=False)


def with_pose(motion, sample, pose):
    x = motion.x.copy()
    x[sample] = pose
    return rp.PlatformMotion(motion.t, x, motion.xd, motion.xdd, check_rates=False)


def arrays(result):
    return {f.name: getattr(result, f.name) for f in fields(result)}


def test_shapes_and_read_only_results(robot):
    motion, carriers = motion_of(robot), carriers_of(robot)
    N, n, m, k = 7, robot.n, robot.m, robot.k
    along = VirtualWork(robot).along(motion)
    shapes = {"t": (N,), "f": (N, n), "W": (N, n, m), "carrier_force": (N, k), "reachable": (N,), "gap": (N,)}
    shapes |= {"row_scale": (n,), "column_scale": (m,), "out_of_range": (N,), "force_size": (N,)}
    assert {name: a.shape for name, a in arrays(along.reduce(carriers)).items()} == shapes
    derivatives = arrays(along.carrier_derivatives(carriers))
    for name, array in derivatives.items():
        assert array.shape == ((N, n, k) if name.startswith("f_") else (N, k, k))
    assert along.base_wrench(carriers).shape == (N, 6)
    assert along.energy(carriers).shape == (N,)
    results = [*arrays(along.reduce(carriers)).values(), *derivatives.values()]
    for array in (*results, along.base_wrench(carriers), along.energy(carriers)):
        assert not array.flags.writeable
    assert along.robot is robot
    assert along.motion is motion


def test_scales_turn_moments_into_forces(robot):
    reduced = VirtualWork(robot).reduce(motion_of(robot))
    L = robot.characteristic_length
    rows, columns = ([1, 1], [1, 1]) if robot.name == "2rpr" else ([1, 1, L], [L, L, L])
    np.testing.assert_array_equal(reduced.row_scale, rows)
    np.testing.assert_array_equal(reduced.column_scale, columns)


def test_poses_without_a_configuration_are_refused_with_sample_and_leg(robot):
    motion, dynamics = motion_of(robot), VirtualWork(robot)
    with pytest.raises(SingularPoseError, match="leg 1") as refusal:
        dynamics.along(with_pose(motion, 2, STRETCHED[robot.name]))
    assert (refusal.value.details["leg"], refusal.value.details["sample"]) == (0, 2)
    assert abs(refusal.value.details["margin"]) < 1e-5
    if robot.name == "3rrr":  # the other one reaches everything
        with pytest.raises(UnreachablePoseError) as refusal:
            dynamics.reduce(with_pose(motion, 3, [*(2.5 * UP), 0.0]))  # leg 1 is 0.25 m short
        assert refusal.value.details["sample"] == 3
        assert refusal.value.details["gap"] == pytest.approx(0.25)


def test_marked_samples_are_nan_and_leave_the_others_alone(robot):
    motion, carriers = motion_of(robot), carriers_of(robot)
    broken = with_pose(motion, 2, STRETCHED[robot.name])
    good = np.arange(7) != 2
    if robot.name == "3rrr":
        broken = with_pose(broken, 5, [5.0, 0.0, 0.0])
        good[5] = False
    along, intact = VirtualWork(robot).along(broken, unreachable="mark"), VirtualWork(robot).along(motion)
    reduced = along.reduce(carriers)
    np.testing.assert_array_equal(reduced.reachable, good)
    assert np.isfinite(reduced.gap).all()
    assert reduced.gap[good].max() < 1e-11
    if robot.name == "3rrr":
        # the largest distance of a corner from its base hinge, less the 2 m a leg reaches
        corners = np.array([5.0, 0.0]) - 0.25 * np.array([UP, [-UP[0], UP[1]], [0.0, -1.0]])
        base = np.array([[0, 0], [np.sqrt(3), 0], [np.sqrt(3) / 2, 1.5]])
        assert reduced.gap[5] == pytest.approx(np.hypot(*(corners - base).T).max() - 2.0)
    pairs = [(arrays(reduced), arrays(intact.reduce(carriers)))]
    pairs += [(arrays(along.carrier_derivatives(carriers)), arrays(intact.carrier_derivatives(carriers)))]
    pairs += [({"wrench": along.base_wrench(carriers)}, {"wrench": intact.base_wrench(carriers)})]
    pairs += [({"energy": along.energy(carriers)}, {"energy": intact.energy(carriers)})]
    for marked, whole in pairs:
        for name, array in marked.items():
            if name in ("t", "reachable", "gap", "row_scale", "column_scale", "out_of_range", "force_size"):
                continue
            assert np.isnan(array[~good]).all(), name
            np.testing.assert_array_equal(array[good], whole[name][good])


def test_type_two_poses_stay_finite():
    """B of the 2-RPR on the base line: parallel legs. In the middle of the 3-RRR's base, by symmetry, all distal links
    point at the centre for one α: they meet in a point."""
    flat = rp.PlatformMotion([0.0], [[0.2, 0.0]], [[0.1, 0.3]], [[0.0, 0.2]])

    def turned(alpha):
        x = [[np.sqrt(3) / 2, 0.5, alpha]]
        return rp.PlatformMotion([0.0], x, [[0.1, 0.3, -0.5]], [[0.4, 0.2, 1.0]])

    def moment(alpha):  # of leg 1's pull about the centre
        return VirtualWork("3rrr").reduce(turned(alpha)).W[0, 2, 0]

    for name, motion in (("2rpr", flat), ("3rrr", turned(brentq(moment, -np.pi / 2, np.pi / 2, xtol=1e-15)))):
        reduced = VirtualWork(name).reduce(motion)
        assert np.isfinite(reduced.f).all()
        singular_values = np.linalg.svd(reduced.W[0], compute_uv=False)
        assert singular_values[-1] < 1e-12 < 0.1 < singular_values[-2]


@pytest.mark.parametrize("name", ["2rpr", "3rrr"])
def test_a_robot_without_carriers_has_empty_carrier_arrays(name):
    bare = rp.load_robot(name, carriers=False)
    motion = motion_of(bare)
    along = VirtualWork(bare).along(motion)
    for carriers in (None, rp.CarrierMotion(*np.zeros((3, 7, 0)))):
        assert along.reduce(carriers).carrier_force.shape == (7, 0)
    derivatives = along.carrier_derivatives()
    assert derivatives.f_s.shape == (7, bare.n, 0)
    assert derivatives.force_sdd.shape == (7, 0, 0)
    if name == "2rpr":  # nothing else has mass by default
        np.testing.assert_array_equal(along.reduce().f, 0.0)
    loaded = rp.load_robot(name)
    assert np.abs(along.reduce().f - VirtualWork(loaded).along(motion).reduce().f).max() > 0.1


def test_platform_inertia_auto_is_that_of_a_disc():
    spin = rp.PlatformMotion([0.0], [[0.9, 0.5, 0.1]], [[0.0, 0.0, 0.0]], [[0.0, 0.0, 1.0]])
    auto, none = (VirtualWork(rp.load_robot("3rrr", platform_inertia=value)).reduce(spin) for value in ("auto", 0.0))
    np.testing.assert_allclose(auto.f - none.f, [[0.0, 0.0, 0.5 * 0.5 * 0.25**2]], atol=1e-12)


def test_gravity_out_of_the_plane_enters_the_base_wrench_alone(robot):
    flat = rp.load_robot(robot.name, gravity=[0.3, -9.0, 0.0])
    motion, carriers = motion_of(robot), carriers_of(robot)
    tilted, level = (VirtualWork(r).along(motion) for r in (robot, flat))
    np.testing.assert_array_equal(tilted.reduce(carriers).f, level.reduce(carriers).f)
    np.testing.assert_array_equal(tilted.energy(carriers), level.energy(carriers))
    difference = tilted.base_wrench(carriers) - level.base_wrench(carriers)
    mass = {"2rpr": 2.0, "3rrr": 3 * (1.0 + 1.0 + 3.0) + 0.5}[robot.name]
    np.testing.assert_allclose(difference[:, 2], 2.0 * mass)
    np.testing.assert_array_equal(difference[:, [0, 1, 5]], 0.0)
    assert np.abs(difference[:, 3:5]).min() > 0.0


def test_bad_input_is_refused(robot):
    dynamics, motion = VirtualWork(robot), motion_of(robot)
    wrong = rp.PlatformMotion(motion.t, *np.zeros((3, 7, robot.n + 1)))
    poses = rp.PlatformMotion(motion.t, np.tile(np.eye(4), (7, 1, 1)), *np.zeros((2, 7, robot.n)))
    for bad in (wrong, poses):
        with pytest.raises(InputError, match=r"moves in \d coordinates"):
            dynamics.along(bad)
    with pytest.raises(InputError, match="unreachable"):
        dynamics.along(motion, unreachable="ignore")
    with pytest.raises(InputError, match="carrier motion"):
        dynamics.along(motion).energy(rp.CarrierMotion(*np.zeros((3, 6, robot.k))))


@pytest.mark.parametrize("change", [{"closed_form": None}, {"closed_form": "gough"}, {"working_mode": (1,)}])
def test_robots_without_a_closed_form_are_refused(robot, change):
    with pytest.raises(UnsupportedRobotError, match="RneaDynamics"):
        VirtualWork(replace(robot, **change))


@pytest.mark.parametrize(
    ("model", "old", "new"),
    [
        ("2rpr", "actuated: [slide_1, slide_2]", "actuated: [slide_2, slide_1]"),
        ("2rpr", "actuated: [slide_1, slide_2]", "actuated: [swivel_1, slide_2]"),
        ("2rpr", "signs: [1, 1]", "signs: [1, -1]"),
        ("3rrr", "actuated: [base_1, base_2, base_3]", "actuated: [elbow_1, base_2, base_3]"),
        ("3rrr", "actuated: [base_1, base_2, base_3]", "actuated: [base_1, base_2, base_3, elbow_1]"),
        ("3rrr", "joints: [elbow_1, elbow_2, elbow_3]", "joints: [elbow_2, elbow_1, elbow_3]"),
        ("3rrr", "carrier_1, acceleration", "carrier_2, acceleration"),
    ],
)
def test_motors_modes_and_carriers_in_another_order_have_no_closed_form(model, old, new, tmp_path):
    """Its numbers would be those of other motors; all other backends take them."""
    for file in (models_root() / model).iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    path = tmp_path / "robot.yaml"
    text = path.read_text()
    assert text.count(old) == 1
    text = text.replace(new, "@") if old.startswith("carrier") else text  # the two change places
    path.write_text(text.replace(old, new).replace("@", old))
    robot = rp.load_robot(path)
    assert robot.closed_form is None
    with pytest.raises(UnsupportedRobotError, match="other motors, modes or carriers"):
        VirtualWork(robot)


def test_one_sample_has_no_spring_that_counts_turns_and_the_slack_of_tracks_of_all_backends():
    plain, still = rp.load_robot("3rrr"), np.zeros(3)
    x = START["3rrr"]
    for joint, refused in (("base_1", True), (plain.carriers[0], False)):
        sprung = VirtualWork(plain.loaded(rp.JointForces(joint, stiffness=7.0)))
        if refused:
            with pytest.raises(UnsupportedRobotError, match="whole turns"):
                sprung.torque(x, still, still)
        else:
            assert sprung.torque(x, still, still).status.solved
    upper = plain.carrier_limits[0].upper
    for s, status in ((upper * (1.0 + 1e-15), "ok"), (upper * (1.0 + 1e-6), "out_of_range")):
        for backend in (VirtualWork, rp.RneaDynamics):
            assert backend(plain).torque(x, still, still, [s, 0.0, 0.0]).status.label == status
