"""Motions whose rates are not those of their positions: refused where they are taken for motions."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest
import zoo
from command_line import call, refused
from scipy.spatial.transform import Rotation

import redundancy_pin as rp
from redundancy_pin import CarrierMotion, PlatformMotion
from redundancy_pin.errors import InputError
from redundancy_pin.motion import require_consistent
from redundancy_pin.planners.reference import motion_reference

RATE = np.array([2.0, 3.0])
SIZE = np.array([0.02, 0.05])


def wave(t: np.ndarray, order: int = 0) -> np.ndarray:
    """A smooth motion of two coordinates, or its derivative."""
    return SIZE * RATE**order * np.sin(np.outer(t, RATE) + 0.5 * np.pi * order) + ([0.25, 0.6] if order == 0 else 0.0)


def motion(t: np.ndarray | None = None, *, in_t: float = 1.0, x: float = 1.0, xd: float = 1.0, xdd: float = 1.0):
    t = np.linspace(0.0, 2.0, 201) if t is None else t
    return PlatformMotion(in_t * t, x * wave(t), xd * wave(t, 1), xdd * wave(t, 2))


@pytest.mark.parametrize(
    ("scales", "says", "factor"),
    [
        ({"in_t": 1e3}, "xd0 is 1000 times what x0 and t say: milliseconds?", 1e3),
        ({"in_t": 1e6}, "xd0 is 1e+06 times what x0 and t say: microseconds?", 1e6),
        ({"in_t": 1 / 60}, "xd0 is 0.0167 times what x0 and t say: minutes?", 1 / 60),
        ({"xd": 1e3, "xdd": 1e3}, "xd0 is 1000 times what x0 and t say: millimetres?", 1e3),
        ({"x": 1e3}, "xd0 is 0.001 times what x0 and t say: millimetres?", 1e-3),
        ({"x": 180 / np.pi}, "xd0 is 0.0175 times what x0 and t say: degrees?", np.pi / 180),
        (
            {"xd": 30 / np.pi, "xdd": 30 / np.pi},
            "xd0 is 9.55 times what x0 and t say: revolutions a minute?",
            30 / np.pi,
        ),
        ({"xdd": 1 / 9.80665}, "xdd0 is 0.102 times what xd0 and t say: g?", 1 / 9.80665),
        ({"xd": -1.0, "xdd": -1.0}, "xd0 is -1 times what x0 and t say: a sign?", -1.0),
        ({"xd": 0.0, "xdd": 0.0}, "x0 moves while xd0 is zero", 0.0),
        ({"xdd": 0.0}, "xd0 moves while xdd0 is zero", 0.0),
        ({"in_t": 1.25}, "xd0 is 1.25 times what x0 and t say.", 1.25),
    ],
)
def test_sample_and_factor_are_said(scales: dict[str, float], says: str, factor: float) -> None:
    with pytest.raises(InputError) as caught:
        require_consistent(motion(**scales))
    assert says in str(caught.value)
    details = caught.value.details
    assert details["factor"] == pytest.approx(factor, rel=0.01)  # what trapezoids leave, and no more
    # by the sample that is named the two are apart, by the one before they were not yet
    assert f"sample {details['sample']} (t = {details['time']:.6g} s)" in str(caught.value)
    t = motion(**scales).t
    assert t[details["sample"]] == details["time"]


def test_what_stands_still_while_its_rate_moves_is_said() -> None:
    t = np.linspace(0.0, 2.0, 201)
    with pytest.raises(InputError, match=r"x0 does not change as xd0 says.*it stands still"):
        require_consistent(PlatformMotion(t, np.repeat(wave(t[:1]), 201, axis=0), wave(t, 1), wave(t, 2)))


def test_columns_that_are_exchanged_are_said() -> None:
    t = np.linspace(0.0, 2.0, 201)
    with pytest.raises(InputError, match="are columns exchanged"):
        require_consistent(PlatformMotion(t, wave(t), wave(t, 1)[:, ::-1], wave(t, 2)[:, ::-1]))


# --- what passes ---


@pytest.mark.parametrize("samples", [1, 2, 5, 8, 9, 12, 20, 40, 1000])
def test_right_motions_pass_however_sparsely_they_are_sampled(samples: int) -> None:
    for end in (0.5, 1.0, 2.0, 5.0, *([20.0, 200.0] if samples == 1000 else [])):  # no wave is met once a period
        require_consistent(motion(np.linspace(0.0, end, samples)))
    still = np.zeros((samples, 2))
    require_consistent(PlatformMotion(np.arange(float(samples)), still, still, still))


def test_uneven_and_two_sided_samples_pass() -> None:
    trajectory = rp.trajectory.reference.corner()
    for dt in (1e-3, 0.03):
        sampled = trajectory.sample(dt)
        assert sampled.jumps.any()
        require_consistent(sampled)
    t = np.sort(np.random.default_rng(0).uniform(0.0, 2.0, 400))
    require_consistent(motion(t))
    require_consistent(motion(np.union1d(np.linspace(0.0, 2.0, 50), 1.0 + np.array([1e-9, 2e-9]))))


@pytest.mark.parametrize("seed", range(5))
def test_states_that_have_nothing_to_do_with_one_another_pass(seed: int) -> None:
    """At whole seconds or at times like those of a motion; at one pose with many velocities as well."""
    rng = np.random.default_rng(seed)
    for samples in (9, 30, 1000):
        x, xd, xdd = rng.uniform(-1.0, 1.0, (3, samples, 2)) * np.array([0.1, 2.0, 30.0])[:, None, None]
        for t in (np.arange(float(samples)), np.linspace(0.0, 1.0, samples)):
            require_consistent(PlatformMotion(t, x, xd, xdd))
            require_consistent(PlatformMotion(t, x, 0.0 * x, 0.0 * x))
            require_consistent(PlatformMotion(t, 0.0 * x, xd, xdd))
            still = np.zeros_like(x)
            require_consistent(PlatformMotion(t, still, still, still), CarrierMotion(x, xd, xdd))


def test_measured_rates_pass_and_their_noise_hides_no_unit() -> None:
    rng = np.random.default_rng(1)
    t = np.linspace(0.0, 4.0, 2001)
    noisy = [wave(t, order) * (1.0 + 0.02 * rng.normal(size=(2001, 2))) for order in range(1, 3)]
    x = wave(t) + 1e-5 * rng.normal(size=(2001, 2))
    require_consistent(PlatformMotion(t, x, *noisy))
    with pytest.raises(InputError, match="milliseconds"):
        require_consistent(PlatformMotion(1e3 * t, x, *noisy))


@pytest.mark.parametrize("seconds", [2.0, 60.0, 600.0])
def test_a_small_bias_of_measured_rates_passes_however_long_and_hides_nothing(seconds: float) -> None:
    t = np.arange(0.0, seconds, 0.01)
    x, xd, xdd = (0.1 * 3.0**k * np.sin(3.0 * t + 0.5 * np.pi * k)[:, None] for k in range(3))
    require_consistent(PlatformMotion(t, x, xd + 0.002, xdd - 0.01))
    turning = np.angle(np.exp(1j * (x + 3.1)))  # the same about half a turn, written within a turn
    assert np.abs(np.diff(turning, axis=0)).max() > 6.0
    require_consistent(PlatformMotion(t, turning, xd + 0.002, xdd))
    wrong = [1.25 * xd, 0.75 * xd, -xd, 1e3 * xd, 0.0 * xd, xdd / 3.0]
    if seconds > 2.0:  # shorter than a swing a bias has no time to show
        wrong.append(xd + 0.1 * np.abs(xd).max())
    for rates in wrong:
        for bias in (0.0, 0.002):
            with pytest.raises(InputError):
                require_consistent(PlatformMotion(t, x, rates + bias, xdd))


def test_poses_turn_as_their_twist_says() -> None:
    t = np.linspace(0.0, 3.0, 100)
    x = np.tile(np.eye(4), (100, 1, 1))
    x[:, :3, :3] = (
        Rotation.from_rotvec(np.outer(2.0 * t, [0.0, 0.0, 1.0])) * Rotation.from_euler("x", 1.5)
    ).as_matrix()
    x[:, 0, 3] = 0.3 * t
    twist = np.tile([0.3, 0.0, 0.0, 0.0, 0.0, 2.0], (100, 1))
    require_consistent(PlatformMotion(t, x, twist, 0.0 * twist))
    for column, other in ((5, 4), (0, 1)):
        wrong = twist.copy()
        wrong[:, [column, other]] = wrong[:, [other, column]]
        with pytest.raises(InputError, match=f"x{min(column, other)} "):
            require_consistent(PlatformMotion(t, x, wrong, 0.0 * twist))


# --- where it is asked ---


def stays_in_place(t: np.ndarray, x: np.ndarray, **word: bool) -> PlatformMotion:
    return PlatformMotion(t, x, 0.0 * x, 0.0 * x, **word)


def test_efforts_plans_crossings_and_references_refuse_and_take_the_word() -> None:
    robot = zoo.robot_of("2rpr")
    t = np.linspace(0.0, 1.0, 60)
    x = np.array([0.2, 0.3]) + 0.02 * wave(t)
    wrong, vouched = stays_in_place(t, x), stays_in_place(t, x, check_rates=False)
    dynamics = rp.RneaDynamics(robot)
    takers = {
        "rnea": lambda motion: dynamics.reduce(motion),
        "virtual work": lambda motion: rp.VirtualWork(robot).reduce(motion),
        "stepwise": lambda motion: rp.plan_stepwise(dynamics, motion, stop="within"),
        "crossings": lambda motion: rp.find_crossings(robot, motion),
        "reference": lambda motion: motion_reference(robot, motion),
    }
    for take in takers.values():
        with pytest.raises(InputError, match="x0 moves while xd0 is zero"):
            take(wrong)
        take(vouched)
    with pytest.raises(InputError, match="x0 moves"):
        rp.plan_switch_off(dynamics, wrong)
    with pytest.raises(InputError, match="x0 moves"):
        rp.plan_whole_trajectory(dynamics, wrong)
    # poses alone: rates play no part
    assert rp.lift(robot, wrong).reachable.all()


def test_the_word_goes_with_slices_and_copies() -> None:
    t = np.linspace(0.0, 1.0, 60)
    vouched = stays_in_place(t, wave(t), check_rates=False)
    carriers = CarrierMotion(wave(t), 0.0 * wave(t), 0.0 * wave(t), check_rates=False)
    for one, other in (
        (vouched, carriers),
        (vouched[5:], carriers[5:]),
        pickle.loads(pickle.dumps((vouched, carriers))),
    ):
        require_consistent(one, other)
    with pytest.raises(InputError):
        require_consistent(stays_in_place(t, wave(t))[5:])


def test_carriers_are_held_against_the_times_of_the_platform() -> None:
    robot = zoo.robot_of("2rpr")
    t = np.linspace(0.0, 1.0, 60)
    standing = np.tile([0.2, 0.3], (60, 1))
    platform = PlatformMotion(t, standing, 0.0 * standing, 0.0 * standing)
    parts = [wave(t) - wave(t[:1]), wave(t, 1), wave(t, 2)]
    for make in (rp.RneaDynamics, rp.VirtualWork):
        make(robot).reduce(platform, CarrierMotion(*parts))
        with pytest.raises(InputError, match="sd0 is 1000 times what s0 and t say: millimetres"):
            make(robot).reduce(platform, CarrierMotion(parts[0], 1e3 * parts[1], 1e3 * parts[2]))
        make(robot).reduce(platform, CarrierMotion(parts[0], 1e3 * parts[1], parts[2], check_rates=False))


def test_the_command_line_takes_the_word(tmp_path: Path) -> None:
    t = np.linspace(0.0, 1.0, 60)
    x = np.array([0.2, 0.3]) + 0.02 * wave(t)
    path, out = tmp_path / "still.csv", tmp_path / "out.csv"
    rows = np.column_stack([t, x, 0.0 * x, 0.0 * x])
    np.savetxt(path, rows, delimiter=",", header="t,x0,x1,xd0,xd1,xdd0,xdd1", comments="")
    base = ("inverse-dynamics", "--robot", "2rpr", "--motion", path, "--out", out)
    line = refused(*base)
    assert "still.csv: x0 moves while xd0 is zero" in line
    assert "--no-check-rates" in line
    assert "check_rates" not in line
    assert call(*base, "--no-check-rates").exit_code == 0
    for command in (("singularities",), ("plan", "stepwise"), ("plan", "switch-off")):
        assert "--no-check-rates" in refused(*command, "--robot", "2rpr", "--motion", path)
    assert call("singularities", "--robot", "2rpr", "--motion", path, "--no-check-rates").exit_code == 0
    problem = tmp_path / "problem.yaml"
    problem.write_text("planner: stepwise\nrobot: 2rpr\nmotion: still.csv\nparameters: {stop: within}\n")
    assert "check_rates: false" in refused("plan", "--problem", problem)
    problem.write_text(problem.read_text() + "check_rates: false\n")
    assert call("plan", "--problem", problem).exit_code == 0
