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
    ("scales", "column"),
    [
        ({"in_t": 1e3}, "xd0"),
        ({"in_t": 1 / 60}, "xd0"),
        ({"xd": 1e3, "xdd": 1e3}, "xd0"),
        ({"x": 1e3}, "xd0"),
        ({"x": 180 / np.pi}, "xd0"),
        ({"xd": 30 / np.pi, "xdd": 30 / np.pi}, "xd0"),
        ({"xd": -1.0, "xdd": -1.0}, "xd0"),
        ({"xd": 0.0, "xdd": 0.0}, "xd0"),
        ({"in_t": 1.25}, "xd0"),
        ({"xd": 1.1}, "xd0"),
        ({"xd": 0.9}, "xd0"),
        ({"xdd": 1 / 9.80665}, "xdd0"),
        ({"xdd": 0.0}, "xdd0"),
        ({"xdd": 1.1}, "xdd0"),
        ({"xdd": 0.9}, "xdd0"),
    ],
)
@pytest.mark.parametrize("samples", [201, 1001])
def test_wrong_rates_are_refused_with_the_step_and_both_rates(
    scales: dict[str, float], column: str, samples: int
) -> None:
    wrong = motion(np.linspace(0.0, 2.0, samples), **scales)
    with pytest.raises(InputError) as caught:
        require_consistent(wrong)
    details, k = caught.value.details, caught.value.details["sample"]
    assert details["column"] in (column, f"{column[:-1]}1")
    assert details["time"] == wrong.t[k]
    level, coordinate = column.count("d"), int(details["column"][-1])
    values, rates = ((wrong.x, wrong.xd, wrong.xdd)[j][k - 1 : k + 1, coordinate] for j in (level - 1, level))
    step = wrong.t[k] - wrong.t[k - 1]
    assert details["found"] == pytest.approx((values[1] - values[0]) / step, rel=1e-9)
    assert details["given"] == pytest.approx(rates.mean(), rel=1e-9, abs=1e-15)
    assert abs(details["found"] - details["given"]) > details["allowed"]
    message = str(caught.value)
    assert f"from sample {k - 1} to {k} (t = {wrong.t[k]:.6g} s)" in message
    assert f"differ by {details['allowed']:.3g}. Correct the rates" in message
    assert "check_rates=False" in message


def test_the_tolerance_is_the_one_that_is_stated() -> None:
    """3 % of the largest rate, what rounding to six digits makes of it, and at constant speed no more."""
    t = np.linspace(0.0, 1.0, 101)[:, None]
    bound = 0.03 * 2.0 + 2.0 * 0.5e-5 / 0.01
    for rate in (2.0, 2.0 + 0.95 * bound):
        require_consistent(PlatformMotion(t[:, 0], 2.0 * t, rate + 0.0 * t, 0.0 * t))
    with pytest.raises(InputError) as caught:
        require_consistent(PlatformMotion(t[:, 0], 2.0 * t, 2.0 + 1.1 * bound + 0.0 * t, 0.0 * t))
    assert caught.value.details["allowed"] == pytest.approx(bound, rel=0.05)  # of a rate that is a little larger


@pytest.mark.parametrize("samples", [2, 3, 4, 5, 8])
def test_a_sign_and_a_factor_of_ten_are_found_in_few_samples(samples: int) -> None:
    t = np.linspace(0.0, 1.0, samples)
    even = np.column_stack([0.1 * t, 0.2 - 0.3 * t])
    rate = np.tile([0.1, -0.3], (samples, 1))
    arc = [np.column_stack([f(t), f(t + 0.3)]) for f in (np.sin, np.cos, lambda t: -np.sin(t))]
    rest = [np.polyval(np.polyder([6.0, -15.0, 10.0, 0.0, 0.0, 0.0], k), t)[:, None] for k in range(3)]
    for x, xd, xdd in ((even, rate, 0.0 * rate), arc, rest):
        require_consistent(PlatformMotion(t, x, xd, xdd))
        require_consistent(PlatformMotion(t, x, xd, 180.0 * xdd))  # of few samples ẍ is not compared
        if samples <= 3 and x is rest[0]:  # one end of each step is at rest: the trapezoidal rule says too little
            continue
        for factor in (10.0, 180.0 / np.pi, 1e3):
            with pytest.raises(InputError, match="does not change as xd"):
                require_consistent(PlatformMotion(t, x, factor * xd, xdd))
        if samples > 2:
            with pytest.raises(InputError, match="does not change as xd"):
                require_consistent(PlatformMotion(t, x, -xd, -xdd))


@pytest.mark.parametrize("times", [np.linspace(0.0, 10.0, 1001), np.linspace(0.0, 10.0, 40)])
def test_an_angle_that_is_written_within_a_turn_hides_no_wrong_rate(times: np.ndarray) -> None:
    t = times[:, None]
    within = np.angle(np.exp(1j * (3.0 + 2.0 * t + 0.1 * np.sin(t))))
    xd, xdd = 2.0 + 0.1 * np.cos(t), -0.1 * np.sin(t)
    assert (np.abs(np.diff(within, axis=0)) > 4.0).sum() >= 3
    require_consistent(PlatformMotion(times, within, xd, xdd))
    for factor in (-1.0, 0.0, 0.1, 2.0, 3.0, 10.0):
        with pytest.raises(InputError, match="x0 does not change as xd0"):
            require_consistent(PlatformMotion(times, within, factor * xd, xdd))


def test_long_steps_are_no_turns_where_the_coordinate_goes_beyond_one_turn() -> None:
    t = np.arange(40.0)[:, None]
    for step, rate in ((6.0, 6.0 - 2.0 * np.pi), (2.0 * np.pi, 0.0)):  # a slide, m; a crank, one turn a sample
        require_consistent(PlatformMotion(t[:, 0], step * t, 0.0 * t + step, 0.0 * t))
        with pytest.raises(InputError, match="x0 does not change as xd0"):
            require_consistent(PlatformMotion(t[:, 0], step * t, 0.0 * t + rate, 0.0 * t))


def test_a_motion_may_turn_back_between_two_of_few_samples() -> None:
    """A triangular wave of slope 1 that turns at 1.5 s and 2.5 s, which none of the samples shows."""
    t, x = np.array([0.0, 1.0, 3.0, 4.0]), np.array([[0.0], [1.0], [1.0], [2.0]])
    require_consistent(PlatformMotion(t, x, np.ones((4, 1)), np.zeros((4, 1))))


def test_few_angles_written_within_a_turn_pass() -> None:
    t = np.linspace(0.0, 1.0, 6)[:, None]
    angle = 3.0 + 2.0 * t
    within = np.angle(np.exp(1j * angle))
    assert np.abs(np.diff(within, axis=0)).max() > 4.0
    require_consistent(PlatformMotion(t[:, 0], within, 0.0 * t + 2.0, 0.0 * t))
    with pytest.raises(InputError, match="x0 does not change as xd0"):
        require_consistent(PlatformMotion(t[:, 0], within, 0.0 * t - 2.0, 0.0 * t))


def test_a_sign_is_found_in_eleven_samples_of_a_sine() -> None:
    for periods in (0.5, 1.0, 1.5):
        t = np.linspace(0.0, 2.0 * np.pi * periods, 11)[:, None]
        x, xd, xdd = np.sin(t), np.cos(t), -np.sin(t)
        require_consistent(PlatformMotion(t[:, 0], x, xd, xdd))
        for rates in ((-xd, -xdd), (-xd, xdd)):
            with pytest.raises(InputError, match="x0 does not change as xd0"):
                require_consistent(PlatformMotion(t[:, 0], x, *rates))


def test_a_position_that_is_wrong_among_right_ones_is_found() -> None:
    t = np.linspace(0.0, 2.0, 401)
    x = wave(t)
    x[200, 1] += 1e-3
    with pytest.raises(InputError, match="x1 does not change as xd1 says: from sample 199 to 200 "):
        require_consistent(PlatformMotion(t, x, wave(t, 1), wave(t, 2)))


def test_exchanged_columns_and_a_coordinate_that_stands_are_refused() -> None:
    t = np.linspace(0.0, 2.0, 201)
    with pytest.raises(InputError, match="x0 does not change as xd0 says"):
        require_consistent(PlatformMotion(t, np.repeat(wave(t[:1]), 201, axis=0), wave(t, 1), wave(t, 2)))
    with pytest.raises(InputError, match="x0 does not change as xd0 says"):
        require_consistent(PlatformMotion(t, wave(t), wave(t, 1)[:, ::-1], wave(t, 2)[:, ::-1]))


# --- random smooth motions: what is found, and nothing else ---


def random_motion(rng: np.random.Generator, a_period: float, samples: int, *, even: bool) -> list[np.ndarray]:
    """Return t, x, ẋ, ẍ of a sum of six sines, ``a_period`` samples in the period of the fastest, and a drift."""
    f, phase = rng.uniform(0.1, 5.0, (6, 2)), rng.uniform(0.0, 2.0 * np.pi, (6, 2))
    size = rng.exponential(1.0, (6, 2)) / (1.0 + f * rng.uniform(0.0, 2.0)) * 10.0 ** rng.uniform(-2.0, 0.0, 2)
    start, drift = rng.normal(size=2) * rng.choice([0.0, 1.0, 5.0]), rng.normal(size=2) * rng.choice([0.0, 1.0])
    h = 1.0 / (f.max() * a_period)
    t = h * (np.arange(samples) + (0.0 if even else rng.uniform(-0.2, 0.2, samples)))
    w, angle = 2.0 * np.pi * f, 2.0 * np.pi * f * t[:, None, None] + phase
    return [
        t,
        start + drift * t[:, None] + (size * np.sin(angle)).sum(axis=1),
        drift + (size * w * np.cos(angle)).sum(axis=1),
        -(size * w**2 * np.sin(angle)).sum(axis=1),
    ]


def six_digits(values: np.ndarray) -> np.ndarray:
    return np.array([float(f"{value:.6g}") for value in values.ravel()]).reshape(values.shape)


@pytest.mark.parametrize("seed", range(4))
def test_random_smooth_motions_pass_from_two_samples_a_period_on(seed: int) -> None:
    rng = np.random.default_rng(seed)
    for _ in range(250):
        a_period = 10.0 ** rng.uniform(np.log10(2.2), 3.0)
        t, *parts = random_motion(rng, a_period, int(rng.integers(2, 80)), even=bool(rng.random() < 0.7))
        require_consistent(PlatformMotion(t, *parts))
        if rng.random() < 0.2:
            require_consistent(PlatformMotion(t, *map(six_digits, parts)))


@pytest.mark.parametrize("samples", [3, 9, 12, 40])
def test_six_digits_of_a_motion_that_is_hardly_more_than_their_last_one_pass(samples: int) -> None:
    rng = np.random.default_rng(samples)
    for _ in range(60):
        h, size = 10.0 ** rng.uniform(-3.0, -1.0), 10.0 ** rng.uniform(-7.0, -4.0)
        w = rng.uniform(0.05, 1.0) / h / rng.choice([1.0, 5.0, 20.0])
        angle = w * h * np.arange(samples)[:, None] + rng.uniform(0.0, 6.0)
        x, xd, xdd = 0.7 + size * np.sin(angle), size * w * np.cos(angle), -size * w**2 * np.sin(angle)
        require_consistent(PlatformMotion(h * np.arange(samples), *map(six_digits, (x, xd, xdd))))


FOUND = {  # factors of x, ẋ, ẍ, and samples in the shortest period from which they are found
    "ten times": ((1.0, 10.0, 1.0), 5),
    "a sign": ((1.0, -1.0, -1.0), 6),
    "milli": ((1.0, 1e3, 1e3), 5),
    "degrees": ((1.0, 180.0 / np.pi, 180.0 / np.pi), 5),
    "positions in mm": ((1e3, 1.0, 1.0), 6),
    "twice": ((1.0, 2.0, 2.0), 10),
    "half": ((1.0, 0.5, 0.5), 10),
    "1.1": ((1.0, 1.1, 1.0), 20),
    "0.9": ((1.0, 0.9, 1.0), 20),
    "1.1 of both": ((1.0, 1.1, 1.1), 20),
    "accelerations twice": ((1.0, 1.0, 2.0), 15),
    "accelerations 1.1": ((1.0, 1.0, 1.1), 30),
    "accelerations 0.9": ((1.0, 1.0, 0.9), 30),
}


@pytest.mark.parametrize("mistake", FOUND)
def test_mistakes_in_random_smooth_motions_are_found(mistake: str) -> None:
    factors, a_period = FOUND[mistake]
    for seed in range(60):
        rng = np.random.default_rng(seed)
        t, *parts = random_motion(rng, a_period * rng.uniform(1.0, 10.0), 2 * a_period, even=True)
        with pytest.raises(InputError):
            require_consistent(PlatformMotion(t, *(factor * part for factor, part in zip(factors, parts, strict=True))))


# --- what passes ---


@pytest.mark.parametrize("samples", [1, 2, 5, 8, 9, 12, 20, 40, 1000])
def test_right_motions_pass_however_sparsely_they_are_sampled(samples: int) -> None:
    for end in (0.5, 1.0, 2.0, 5.0, *([20.0, 200.0] if samples == 1000 else [])):  # no wave is met once a period
        require_consistent(motion(np.linspace(0.0, end, samples)))
    still = np.zeros((samples, 2))
    require_consistent(PlatformMotion(np.arange(float(samples)), still, still, still))


@pytest.mark.parametrize("name", ["circle", "line", "corner", "square"])
def test_trajectories_pass_at_any_step(name: str) -> None:
    """Ramps, arcs and jumps of the acceleration that lie within a step are none of a mistake in rates."""
    trajectory = getattr(rp.trajectory.reference, name)()
    rng = np.random.default_rng(0)
    for steps in (1.0, 2.0, 3.0, 4.0, 5.0, *(1.0 / rng.uniform(0.012, 1.0, 20))):
        for two_sided in (True, False):
            sampled = trajectory.sample(trajectory.duration / steps, two_sided=two_sided)
            require_consistent(PlatformMotion(sampled.t, sampled.x, sampled.xd, sampled.xdd))


def test_timing_laws_pass_at_any_step() -> None:
    path = rp.trajectory.corner_path((0.0, 0.0), (1.0, 0.0), 0.2, 0.05)
    laws = [rp.trajectory.RestToRest(path.length, 1.0, shape) for shape in ("3-4-5", "4-5-6-7")]
    laws += [rp.trajectory.SpeedProfile(path.length, 0.5, ramp) for ramp in (1e-3, 0.02, 0.3)]
    motions = [rp.trajectory.Trajectory(path, law) for law in laws]
    points = [[0.0, 0.0], [0.2, 0.1], [0.3, 0.4], [0.1, 0.5], [0.0, 0.3]]
    motions.append(rp.trajectory.from_points(points, "time-optimal", max_speed=0.5, max_acceleration=2.0))
    motions.append(rp.trajectory.from_points(points, speed=0.2, ramp_time=0.02))
    for trajectory in motions:
        even = [np.linspace(0.0, trajectory.duration, samples) for samples in (*range(2, 30, 3), 200)]
        for times in (*even, *(np.array([0.0, part, 1.0]) * trajectory.duration for part in (0.1, 0.9, 0.96, 0.98))):
            sampled = trajectory.sample(times=times, two_sided=False)
            require_consistent(PlatformMotion(sampled.t, sampled.x, sampled.xd, sampled.xdd))


def test_few_poses_to_stand_still_in_pass_and_many_need_the_word() -> None:
    for samples in (2, 5, 9):
        t = np.linspace(0.0, 1.0, samples)
        require_consistent(stays_in_place(t, wave(t)))
    with pytest.raises(InputError, match="x0 does not change as xd0"):
        require_consistent(stays_in_place(np.linspace(0.0, 1.0, 10), wave(np.linspace(0.0, 1.0, 10))))


def test_measured_rates_pass_and_their_noise_hides_no_unit() -> None:
    rng = np.random.default_rng(1)
    t = np.linspace(0.0, 4.0, 2001)
    noisy = [wave(t, order) * (1.0 + 0.02 * rng.normal(size=(2001, 2))) for order in range(1, 3)]
    x = wave(t) + 1e-5 * rng.normal(size=(2001, 2))
    require_consistent(PlatformMotion(t, x, *noisy))
    with pytest.raises(InputError, match="x0 does not change"):
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


@pytest.mark.parametrize(("turning", "tilting"), [(1.0, 1.0), (3.0, 1.0), (1.0, 3.0), (0.5, 4.0)])
def test_rotations_whose_axis_tilts_pass_at_any_step(turning: float, tilting: float) -> None:
    """Rz(Ω t) exp(t (ω ex − Ω ez)) turns at ω about an axis that turns at Ω: in finite steps about z too."""
    for h in (1e-3, 0.01, 0.05, 0.2, 0.4, 0.9):  # up to more than half a turn, whose sense nobody can tell
        for samples in (3, 9, 30):
            t = h * np.arange(samples)
            x, still = np.tile(np.eye(4), (samples, 1, 1)), np.zeros((samples, 3))
            about_z = Rotation.from_rotvec(np.outer(turning * t, [0.0, 0.0, 1.0]))
            x[:, :3, :3] = (about_z * Rotation.from_rotvec(np.outer(t, [tilting, 0.0, -turning]))).as_matrix()
            omega = about_z.apply([tilting, 0.0, 0.0])
            alpha = turning * np.column_stack([-omega[:, 1], omega[:, 0], 0.0 * t])
            xd, xdd = np.column_stack([still, omega]), np.column_stack([still, alpha])
            require_consistent(PlatformMotion(t, x, xd, xdd))
            if h == 0.01 and samples == 30:
                for factor in (1.1, 0.9, -1.0, 10.0):
                    with pytest.raises(InputError, match="x3 does not change"):
                        require_consistent(PlatformMotion(t, x, factor * xd, xdd))


# --- where it is asked ---


def stays_in_place(t: np.ndarray, x: np.ndarray, **word: bool) -> PlatformMotion:
    return PlatformMotion(t, x, 0.0 * x, 0.0 * x, **word)


def test_efforts_plans_crossings_and_references_refuse_and_take_the_word() -> None:
    robot = zoo.robot_of("2rpr")
    t = np.linspace(0.0, 1.0, 20)
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
        with pytest.raises(InputError, match="x0 does not change as xd0 says"):
            take(wrong)
        take(vouched)
    with pytest.raises(InputError, match="x0 does not change"):
        rp.plan_switch_off(dynamics, wrong)
    with pytest.raises(InputError, match="x0 does not change"):
        rp.plan_whole_trajectory(dynamics, wrong)
    # poses alone: rates play no part
    assert rp.inverse_kinematics(robot, wrong).reachable.all()


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
        with pytest.raises(InputError, match="s0 does not change as sd0 says"):
            make(robot).reduce(platform, CarrierMotion(parts[0], 1e3 * parts[1], 1e3 * parts[2]))
        make(robot).reduce(platform, CarrierMotion(parts[0], 1e3 * parts[1], parts[2], check_rates=False))


def test_the_command_line_takes_the_word(tmp_path: Path) -> None:
    t = np.linspace(0.0, 1.0, 20)
    x = np.array([0.2, 0.3]) + 0.02 * wave(t)
    path, out = tmp_path / "still.csv", tmp_path / "out.csv"
    rows = np.column_stack([t, x, 0.0 * x, 0.0 * x])
    np.savetxt(path, rows, delimiter=",", header="t,x0,x1,xd0,xd1,xdd0,xdd1", comments="")
    base = ("inverse-dynamics", "--robot", "2rpr", "--motion", path, "--out", out)
    line = refused(*base)
    assert "still.csv: x0 does not change as xd0 says: from sample 0 to 1 " in line
    assert "check_rates=False" in line
    assert call(*base, "--no-check-rates").exit_code == 0
    for command in (("singularities",), ("plan", "stepwise"), ("plan", "switch-off")):
        assert "check_rates=False" in refused(*command, "--robot", "2rpr", "--motion", path)
    assert call("singularities", "--robot", "2rpr", "--motion", path, "--no-check-rates").exit_code == 0
    problem = tmp_path / "problem.yaml"
    problem.write_text("planner: stepwise\nrobot: 2rpr\nmotion: still.csv\nparameters: {stop: within}\n")
    assert "check_rates=False" in refused("plan", "--problem", problem)
    problem.write_text(problem.read_text() + "check_rates: false\n")
    assert call("plan", "--problem", problem).exit_code == 0


@pytest.mark.parametrize("wrong", [1.3, 1.0])
def test_the_verdict_does_not_depend_on_the_unit_of_length(wrong: float) -> None:
    """A small swing far from the origin, where the digits of the place limit what is found."""
    t = np.arange(500) * 1e-3
    angle = 2.0 * np.pi * t / 0.1
    x, xd = 0.9 + 2e-4 * np.sin(angle), 2e-4 * 20.0 * np.pi * np.cos(angle)
    xdd = -2e-4 * (20.0 * np.pi) ** 2 * np.sin(angle)
    verdicts = set()
    for length in (1e-6, 1e-3, 1.0, 1.05, 1.1112, 1.2, 2.0, 5.0, 39.37, 1e3, 1e6):
        motion = PlatformMotion(t, *(length * part[:, None] for part in (x, wrong * xd, wrong * xdd)))
        try:
            require_consistent(motion)
            verdicts.add("accepted")
        except InputError:
            verdicts.add("refused")
    assert len(verdicts) == 1
    assert wrong != 1.0 or verdicts == {"accepted"}


def test_long_motions_are_compared_to_their_end():
    t = np.arange(50_000) * 1e-3
    x, xd, xdd = (3.0**k * np.sin(3.0 * t + 0.5 * np.pi * k)[:, None] for k in range(3))
    require_consistent(PlatformMotion(t, x, xd, xdd))
    for late in (16_667, 49_990):
        wrong = x.copy()
        wrong[late:] += 0.02
        with pytest.raises(InputError, match=f"from sample {late - 1} to {late} ") as caught:
            require_consistent(PlatformMotion(t, wrong, xd, xdd))
        assert caught.value.details["time"] == t[late]
