"""What is left where carriers cannot act, which instant is named with which amount, and the grid of the thesis."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import zoo

from redundancy_pin import PlatformMotion, VirtualWork
from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.planners.carrier_model import CarrierModel
from redundancy_pin.planners.switch_off import crossing
from redundancy_pin.planners.switch_off.carrier_equation import StepGivenUpError
from redundancy_pin.planners.switch_off.crossing import BALANCED, LostDirection
from redundancy_pin.singularities.roots import Interval
from redundancy_pin.trajectory import reference
from redundancy_pin.trajectory.continuous_motion import continuous_motion

SCALE = np.array([1.0, 5.0])
"""m, what moments are divided by."""

SIZE = 50.0
"""N, of the largest f."""

U = np.array([0.6, -0.8])

RNG = np.random.default_rng(5)
W, F0, TERMS = RNG.uniform(-3.0, 3.0, (2, 2)), RNG.uniform(-9.0, 9.0, 2), RNG.uniform(-2.0, 2.0, (2, 2, 5))


def efforts(t: Any) -> Any:
    return np.stack([3.0 * t, 1.0 - 7.0 * t], axis=-1)


def equation(**other: Any) -> Any:
    """A model whose coefficients are the same at all times, with efforts that are not."""

    def at(t: Any) -> CarrierModel:
        n = len(t)
        f_terms, none = np.tile(TERMS, (n, 1, 1, 1)), np.zeros((n, 2, 5))
        return CarrierModel(t, np.tile(W, (n, 1, 1)), np.tile(F0, (n, 1)), f_terms, np.zeros((n, 2)), none)

    return SimpleNamespace(model=SimpleNamespace(at=at, k=2), row_scale=SCALE, effort=efforts, size=SIZE, **other)


def lost(t: float, parked: float = 0.0, by_motion: float = 1.0, by_main: bool = False) -> LostDirection:
    return LostDirection(t, U, parked, by_motion, by_main)


def left_by_hand(t: float, s: Any, sd: Any) -> float:
    f = F0 + sum(TERMS[:, j] @ [s[j], s[j] ** 2, sd[j], s[j] * sd[j], 0.0] for j in range(2))
    return float(U @ ((f - W @ efforts(t)) / SCALE))


S, SD = np.array([0.3, -0.7]), np.array([1.1, 0.4])


def test_what_is_left_along_a_lost_direction_is_the_load_less_that_of_the_actuators() -> None:
    for t in (0.2, 0.9):
        assert lost(t).left(equation(), S, SD) == pytest.approx(left_by_hand(t, S, SD), rel=1e-12)


@pytest.mark.parametrize(
    ("parked", "by_motion", "raises"),
    [(2.0, 0.5, True), (-2.0, 0.5, True), (0.5, 0.5, False), (-0.5, 0.5, False), (2.0, 2.0, False)],
)
def test_nothing_may_be_left_where_the_carriers_can_neither_push_nor_change_it(
    parked: float, by_motion: float, raises: bool
) -> None:
    """In tolerances: a fraction of the size of f."""
    unit = BALANCED * SIZE
    instants = [lost(0.1, 0.0, 0.0), lost(0.4, parked * unit, by_motion * unit)]
    if not raises:
        crossing.require_balanced(equation(), instants)
        return
    with pytest.raises(InfeasiblePlanError, match="whatever the carriers do") as caught:
        crossing.require_balanced(equation(), instants)
    assert caught.value.details["time"] == 0.4
    assert caught.value.details["amount"] == pytest.approx(2.0 * unit)


@pytest.mark.parametrize(
    ("force", "said"), [(2.5, "(0.600000, -0.800000, 0.000000)"), (-2.5, "(-0.600000, 0.800000, 0.000000)")]
)
@pytest.mark.parametrize("by_main", [True, False])
def test_the_force_that_is_missing_is_said_along_the_direction_it_has(force: float, said: str, by_main: bool) -> None:
    for zero in (0.0, -0.0):
        error = crossing.nothing_carries(LostDirection(0.4, np.array([*U, zero]), 0.0, 0.0, by_main), force, "so")
        assert f"t = 0.4 s, nothing can carry the inertial force: the motion needs 2.5 N along {said}" in str(error)
        assert error.details["amount"] == 2.5
        np.testing.assert_allclose(error.details["direction"], np.sign(force) * np.array([*U, 0.0]))
        assert ("leave the main actuators on" in str(error.remedy)) is by_main is error.details["main_actuators_could"]


@pytest.mark.parametrize(("stuck", "named"), [(0.5, 0.6), (0.6, 0.6), (0.1, 0.2), (0.61, 0.9), (0.95, None)])
def test_the_instant_that_stops_the_carriers_is_the_next_one(
    stuck: float, named: float | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    details = stopped_at(stuck, S, monkeypatch)
    if named is None:
        assert (details["constraint"], details["time"], details["amount"]) == ("carrier_motion", stuck, 0.125)
        return
    assert (details["constraint"], details["time"]) == ("singular_pose", named)
    force = left_by_hand(named, S, SD)
    assert details["amount"] == pytest.approx(abs(force), rel=1e-12)
    np.testing.assert_allclose(details["direction"], np.sign(force) * U)


@pytest.mark.parametrize(("s", "away"), [([3.0, -150.0], 150.0), ([101.0, 2.0], 101.0), ([3.0, -99.0], None)])
def test_a_carrier_has_run_away_a_hundred_metres_off(
    s: list[float], away: float | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    details = stopped_at(0.95, np.array(s), monkeypatch)
    assert details["amount"] == (0.125 if away is None else away)
    if away is not None:
        assert f"Carrier {1 + int(np.argmax(np.abs(s)))} runs away" in details["said"]


def stopped_at(t: float, s: Any, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """The details of the error, and its text, where no step goes on past a time."""

    def solve(*_: Any) -> None:
        raise StepGivenUpError(t, s, SD, 0.125)

    made = equation(solve=solve)
    made.model.interpolant = SimpleNamespace(start=0.0)
    instants = (lost(0.2), lost(0.6), lost(0.9))
    monkeypatch.setattr(crossing, "crossing_equation", lambda *_: (made, np.zeros(2), instants))
    with pytest.raises(InfeasiblePlanError) as caught:
        crossing.cross(None, None, Interval(0.5, 1.0), 0.1, np.zeros(2), SCALE)  # type: ignore[arg-type]
    return {**caught.value.details, "said": str(caught.value)}


def lost_by(of_time: Callable[[Any], Any], actuators: Any = W, mass: float = 1.0) -> list[LostDirection]:
    """Instants at which F = diag(1, of_time(t)) by a mass, in forces, lacks rank."""

    def at(t: Any) -> Any:
        terms = np.zeros((len(t), 2, 2, 5))
        terms[:, 0, 0, 4], terms[:, 1, 1, 4] = mass * SCALE[0], mass * SCALE[1] * of_time(t)
        return SimpleNamespace(t=t, f_terms=terms, f0=np.tile(F0, (len(t), 1)), W=np.tile(actuators, (len(t), 1, 1)))

    model = SimpleNamespace(at=at, interpolant=SimpleNamespace(edges=np.array([0.0, 0.25, 1.0])))
    return crossing.lost_directions(SimpleNamespace(model=model, row_scale=SCALE, effort=efforts), 0.0, 1.0)  # type: ignore[arg-type]


def test_a_direction_is_lost_where_carriers_have_no_effect_in_it_at_all() -> None:
    (instant,) = lost_by(lambda t: t - 0.4)
    assert instant.t == pytest.approx(0.4, abs=1e-9)
    np.testing.assert_allclose(np.abs(instant.direction), [0.0, 1.0], atol=1e-9)
    for mass in (1e-4, 1e4):
        assert lost_by(lambda t: np.hypot(t - 0.4, 1e-6), W, mass) == []  # weak, but there
    (instant,) = lost_by(lambda t: t - 0.4, np.array([[2.0, 1.0], [1e-8, 0.0]]))
    assert instant.by_main is False
    for nothing in (lambda t: 0.0 * t, lambda t: 1e-10 * (1.0 + t)):
        with pytest.raises(InfeasiblePlanError, match="no effect") as caught:
            lost_by(nothing, W, 1e4)
        assert caught.value.details["amount"] == 1.0
        assert caught.value.details["time"] == 0.0


BEGUN = 2.0
"""s, when the motion begins."""


@pytest.mark.parametrize(
    ("window", "ramp", "grid"),
    [
        ((0.41, 0.57), 0.03, (0.38, 0.41, 0.57)),  # on the grid but for rounding
        ((0.413, 0.568), 0.03, (0.39, 0.42, 0.56)),  # the samples inside
        ((0.41, 0.57), 0.001, (0.40, 0.41, 0.57)),  # a ramp takes a step
        ((0.41, 0.57), 0.034, (0.38, 0.41, 0.57)),
        ((0.41, 0.57), 0.036, (0.37, 0.41, 0.57)),
        ((0.41, 0.57), 5.0, (0.0, 0.41, 0.57)),  # the motion has not begun before
    ],
)
def test_a_window_of_backward_differences_is_that_of_the_samples_inside(
    window: tuple[float, float], ramp: float, grid: tuple[float, float, float], monkeypatch: pytest.MonkeyPatch
) -> None:
    course, steps = crossed(window, ramp, 0.01, monkeypatch)
    assert course.samples is not None
    times = [course.start, course.window.start, course.window.end, course.end]
    np.testing.assert_allclose(np.array(times) - BEGUN, [*grid, grid[-1]], atol=1e-12)
    np.testing.assert_allclose(np.diff(course.samples[0]), 0.01, atol=1e-12)
    assert len(course.samples[0]) == round((grid[-1] - grid[0]) / 0.01) + 1
    # Newton's method on a quadratic: from what goes on as before the error squares from step to step
    assert steps <= 3.0 * len(course.samples[0])


def test_what_moments_are_divided_by_changes_no_carrier(monkeypatch: pytest.MonkeyPatch) -> None:
    """Up to the tolerance of a sample's balance, and in as many steps."""
    one, other = (crossed((0.41, 0.57), 0.03, 0.01, monkeypatch, scale) for scale in (np.ones(2), np.array([1.0, 5.0])))
    np.testing.assert_allclose(other[0].samples[1].s, one[0].samples[1].s, atol=1e-9)
    assert abs(other[1] - one[1]) <= 0.2 * one[1]


def crossed(
    window: tuple[float, float], ramp: float, dt: float, monkeypatch: pytest.MonkeyPatch, scale: Any = (1.0, 1.0)
) -> tuple[Any, int]:
    """The carriers of a 2-RPR through a window of its circle, and how many linear equations that took."""
    samples, steps = reference.circle().sample(0.005), []
    true = CarrierModel.slopes
    monkeypatch.setattr(CarrierModel, "slopes", lambda *of: steps.append(1) or true(*of))
    motion = continuous_motion(PlatformMotion(samples.t + BEGUN, samples.x, samples.xd, samples.xdd))
    off = Interval(*(BEGUN + t for t in window))
    dynamics = VirtualWork(zoo.robot_of("2rpr"))
    course = crossing.cross_stepwise(dynamics, motion, off, ramp, np.zeros(2), np.array(scale), dt)
    monkeypatch.undo()
    return course, len(steps)
