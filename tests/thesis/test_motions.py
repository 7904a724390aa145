"""Motions without a planner against closed forms, and what a run refuses."""

from __future__ import annotations

import math

import numpy as np
import pytest
import quick_results

from redundancy_pin.dynamics.backends import BACKENDS, VIRTUAL_WORK
from redundancy_pin.dynamics.results import ReducedDynamics
from redundancy_pin.dynamics.virtual_work import VirtualWork
from redundancy_pin.errors import CrossCheckError
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.status import SampleStatus
from redundancy_pin.thesis.cases import MOTIONS
from redundancy_pin.thesis.measures import run

ROOT_TOLERANCE = 1e-9
"""Times come from a bracketing root finder to 1e-13 of the duration, abscissae through speeds below 1 m/s."""


@pytest.mark.parametrize("name", ["circle-0.5-parked", "circle-0.75-parked"])
def test_circle_is_singular_where_it_meets_the_base_line(name: str) -> None:
    """The circle about (0.25, 0.185) with radius 0.2 meets y = 0 at x = 0.25 ± sqrt(0.2² − 0.185²)."""
    half = math.sqrt(0.2**2 - 0.185**2)
    instants = quick_results.motion_run(name).instants
    np.testing.assert_allclose(
        [instant["x"] for instant in instants], [[0.25 - half, 0.0], [0.25 + half, 0.0]], atol=ROOT_TOLERANCE
    )


@pytest.mark.parametrize(("name", "speed", "ramp"), [("line-0.1-parked", 0.1, 1.0), ("line-0.2-parked", 0.2, 1.0)])
def test_line_is_singular_after_the_way_to_the_base_line(name: str, speed: float, ramp: float) -> None:
    """From (0.15, 0.4) to (0.25, −0.7): y = 0 after 4/11 of the way; a ramp of length v T/2 costs T/2."""
    (instant,) = quick_results.motion_run(name).instants
    assert instant["x"][0] == pytest.approx(0.15 + 0.1 * 4.0 / 11.0, abs=ROOT_TOLERANCE)
    length = math.hypot(0.1, 1.1) * 4.0 / 11.0
    assert instant["t"] == pytest.approx(length / speed + ramp / 2.0, abs=ROOT_TOLERANCE)


def _missing_force(x: float, v: tuple[float, float], a_y: float) -> float:
    """Force across the base line that the legs cannot give, from the angular momenta of two point masses, N.

    On the line n_1 = (0, 1) and n_2 = (0, −1) for x between the hinges; h = L² θ̈ for carriers at s = 0 of 1 kg and
    L = 0.1 m; θ̈ = (n·a − 2 ḋ θ̇)/d; the force on the platform is Σ n h/d (Parsa 2014, eq. 2.17).
    """
    total = 0.0
    for d, along, across in ((x, 1.0, 1.0), (0.5 - x, -1.0, -1.0)):
        d_rate, theta_rate = along * v[0], across * v[1] / d
        theta_acceleration = (across * a_y - 2.0 * d_rate * theta_rate) / d
        total += across * 0.1**2 * theta_acceleration / d
    return abs(total)


@pytest.mark.parametrize(("name", "speed"), [("circle-0.5-parked", 0.5), ("circle-0.75-parked", 0.75)])
def test_missing_force_at_the_singular_instants_of_the_circle(name: str, speed: float) -> None:
    """At constant speed on the circle: v tangential, a = v²/r towards the centre."""
    result = quick_results.motion_run(name)
    for instant in result.instants:
        outward = (np.array(instant["x"]) - [0.25, 0.185]) / 0.2
        v = speed * np.array([-outward[1], outward[0]])
        a = -(speed**2) / 0.2 * outward
        expected = _missing_force(instant["x"][0], (v[0], v[1]), a[1])
        assert instant["missing_force"] == pytest.approx(expected, rel=1e-6)  # the pose is on the line to 1e-13
        assert instant["unbounded"]
        assert instant["t"] in result.t
        np.testing.assert_allclose(np.abs(instant["uncontrolled"]), [0.0, 1.0], atol=1e-9)


def test_efforts_grow_as_missing_force_over_margin() -> None:
    """|τ| · margin is continuous through the singular instant, where it is the missing force."""
    result = quick_results.motion_run("circle-0.5-parked", 1e-3)
    d = result.distribution
    product = np.linalg.norm(d.tau, axis=1) * d.margin
    for instant in result.instants:
        sample = int(np.searchsorted(result.t, instant["t"]))
        assert np.isnan(d.tau[sample]).all()
        assert d.status[sample] == SampleStatus.SINGULAR_INCONSISTENT
        beside = [sample - 1, sample + 1]
        # interpolated over 1 ms, an 80th of the time in which the product changes by its own size
        between = np.interp(instant["t"], result.t[beside], product[beside])
        assert between == pytest.approx(instant["missing_force"], rel=1e-3)


def test_peaks_leave_out_near_singular_samples_and_the_statement_says_unbounded() -> None:
    result = quick_results.motion_run("circle-0.5-parked", 1e-3)
    d = result.distribution
    assert result.peaks.max() < 20.0 < 1000.0 < np.nanmax(np.abs(d.tau))
    assert not result.record()["bounded"]
    assert "unbounded at t = 0.5194 s, 0.8312 s" in result.statement
    assert sum(result.distribution.status_counts.values()) == len(result.t)
    windows = result.record()["near_singular_windows"]
    assert len(windows) == 2
    for (start, end), instant in zip(windows, result.instants, strict=True):
        assert start < instant["t"] < end


def test_jumps_are_two_sided_and_the_torque_jumps_there() -> None:
    result = quick_results.motion_run("corner-r0.025-baseline")
    jumps = np.flatnonzero(result.motion.jumps)
    np.testing.assert_allclose(result.t[jumps], [0.8, 0.8 + 0.025 * np.pi / 2.0 / 0.2], rtol=1e-12)
    tau = result.distribution.tau
    assert (np.abs(tau[jumps] - tau[jumps - 1]).max(axis=1) > 1.0).all()


@pytest.mark.parametrize("name", [case.name for case in MOTIONS])
def test_backends_agree_on_every_experiment(name: str) -> None:
    parity = quick_results.motion_run(name, 0.02).worst_parity
    assert 0.0 < parity < 1e-12  # not identical, so not one backend twice; rounding of cond ≤ 30


class _SignFlipped(VirtualWork):
    """A backend with one of the mistakes that people make."""

    def reduce(self, motion: PlatformMotion, *args: object, **kwargs: object) -> ReducedDynamics:
        right = super().reduce(motion, *args, **kwargs)  # type: ignore[arg-type]
        return ReducedDynamics(**{**vars(right), "carrier_force": -right.carrier_force})


def test_a_backend_with_a_wrong_sign_stops_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(BACKENDS, VIRTUAL_WORK, _SignFlipped)
    with pytest.raises(CrossCheckError, match="carrier force 2"):
        run(quick_results.motion("corner-r0.025-parked"))
