"""What is in sight: which instants are evaluated, kept and asked for, singular instants by formula, nodes by loops."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
import zoo
from online_programme import linearised

import redundancy_pin as rp
from redundancy_pin.arrays import Array
from redundancy_pin.planners.receding_horizon import RecedingHorizon
from redundancy_pin.planners.receding_horizon.ahead import Ahead, zeros_of
from redundancy_pin.planners.receding_horizon.preview import Preview

STEP = 0.02
SPACING = STEP / 8.0
"""s; of instants on the grid."""

KEPT = 3.0 * STEP
"""s; how long what is past is kept at least."""

SAME = 1e-9
"""s; instants nearer than this are one."""


@cache
def dynamics() -> rp.CompiledDynamics:
    return rp.CompiledDynamics(rp.load_robot("2rpr", end_effector_mass=0.5, cylinder_mass=0.3))


def moving(height: Callable[[Array], tuple[Any, Any, Any]]) -> Callable[[Array], rp.PlatformMotion]:
    """The platform goes up and down at half the distance of the bases: det W is zero where its height is."""

    def motion(t: Array) -> rp.PlatformMotion:
        y, yd, ydd = (np.asarray(part) + 0.0 * t for part in height(t))
        x, xd, xdd = (
            np.stack([part, rate], axis=1) for part, rate in ((0.25 + 0.0 * t, y), (0.0 * t, yd), (0.0 * t, ydd))
        )
        return rp.PlatformMotion(t, x, xd, xdd, check_rates=False)

    return motion


def polynomial(*roots: float, size: float = 1.0, offset: float = 0.0) -> Callable[[Array], rp.PlatformMotion]:
    """A height that is a polynomial of the time with these zeros, but for an offset, m."""
    p = size * np.polynomial.Polynomial.fromroots(roots) + offset
    return moving(lambda t: (p(t), p.deriv()(t), p.deriv(2)(t)))


class Counted:
    """A preview's motion that remembers what was asked."""

    def __init__(self, motion: Callable[[Array], rp.PlatformMotion]) -> None:
        self.motion, self.asked = motion, np.empty(0)

    def __call__(self, t: Array) -> rp.PlatformMotion:
        self.asked = np.append(self.asked, t)
        return self.motion(t)


AWAY = moving(lambda t: (0.1 + 0.01 * np.sin(t), 0.01 * np.cos(t), -0.01 * np.sin(t)))
"""Never singular."""


def grid(start: float, end: float) -> Array:
    """Multiples of the spacing behind a start, up to an end."""
    return SPACING * np.arange(np.floor(start / SPACING + 1e-6) + 1, np.floor(end / SPACING + 1e-6) + 1)


@pytest.mark.parametrize("begins", [-0.7113, 0.0, 2.0 + 0.3 * SPACING])
def test_all_of_a_grid_is_evaluated_once_as_it_comes_into_sight(begins: float) -> None:
    motion = Counted(AWAY)
    ahead = Ahead(dynamics(), Preview(motion, -np.inf, np.inf), STEP)
    end, sizes = begins, []
    for start, more in ((0.0, 0.1), (0.02, 0.02), (0.0204, 0.0004), (0.03, 0.0101), (0.03, 0.0), (0.1, SPACING)):
        end = max(end, begins + start) + more
        ahead.look(begins + start, end)
        expected = np.append(begins, grid(begins, end))
        np.testing.assert_allclose(ahead.known.t, expected, rtol=0.0, atol=1e-12)
        sizes.append(len(expected))
    np.testing.assert_allclose(np.sort(motion.asked), ahead.known.t, rtol=0.0, atol=1e-12)
    assert sizes[0] < sizes[-1]


def test_an_instant_next_to_the_first_one_is_no_other() -> None:
    for before, joins in ((0.05, True), (0.15, False)):
        ahead = Ahead(dynamics(), Preview(AWAY, -np.inf, np.inf), STEP)
        start = 40.0 * SPACING - before * SPACING
        ahead.look(start, start + 5.0 * SPACING)
        assert (len(ahead.known.t) == 5) == joins
        assert ahead.known.t[0] == start


@pytest.mark.parametrize("end", [0.1, 0.1 + 0.4 * SPACING, 0.1 + 0.05 * SPACING, 0.1 + 0.5e-9])
def test_the_end_of_a_preview_is_in_sight_too(end: float) -> None:
    """Off the grid it is one instant more, once; where it is on it, none."""
    motion = Counted(AWAY)
    ahead = Ahead(dynamics(), Preview(motion, 0.0, end), STEP)
    for start, until in ((0.0, 0.08), (0.03, end - SPACING), (0.05, end), (0.06, end), (0.06, end + 1.0)):
        ahead.look(start, until)
        up_to = min(until, end)
        expected = np.append(0.0, grid(0.0, up_to))
        if up_to == end and end - expected[-1] > SAME:
            expected = np.append(expected, end)
        for found in (ahead.known.t, ahead.edges):
            np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(np.sort(motion.asked), ahead.known.t, rtol=0.0, atol=1e-12)


def test_what_is_before_the_preview_is_not_asked_for() -> None:
    motion = Counted(AWAY)
    ahead = Ahead(dynamics(), Preview(motion, 0.05, np.inf), STEP)
    ahead.look(0.0, 0.1)
    assert motion.asked.min() == ahead.known.t[0] == 0.05


def test_what_is_past_is_dropped_but_for_three_steps_when_it_is_much() -> None:
    """More than twice what is in sight and a hundred instants; singular instants with it."""

    def swing(t: Array) -> tuple[Array, Array, Array]:
        phase = 20.0 * (t + 0.03)
        return 0.05 * np.sin(phase), np.cos(phase), -20.0 * np.sin(phase)

    ahead = Ahead(dynamics(), Preview(moving(swing), -np.inf, np.inf), STEP)
    drops, known, edges = [], np.empty(0), np.empty(0)
    for start in 0.7 * STEP * np.arange(60):
        end = float(start) + 0.12
        limit = 2.0 * 0.12 / SPACING + 100.0
        if len(known) > limit:
            drops.append(len(known))
            known, edges = known[known >= start - KEPT], edges[edges >= start - KEPT]
        roots = ahead.look(float(start), end)
        new = np.append([] if len(edges) else [start], grid(edges[-1] if len(edges) else start, end))
        every = np.pi / 20.0 * np.arange(1, 30) - 0.03
        found = every[(every >= max(start, edges[-1] if len(edges) else start)) & (every <= new[-1])]
        beside = (found[:, None] + 1e-4 * np.arange(-1, 2)).ravel()
        edges, known = np.append(edges, new), np.sort(np.concatenate([known, new, beside]))
        np.testing.assert_allclose(ahead.known.t, known, rtol=0.0, atol=1e-9)
        np.testing.assert_allclose(roots, every[(every >= start) & (every <= edges[-1])], atol=1e-9)
        if drops:
            assert ahead.roots.min() >= known[0] - 1e-9
    assert len(drops) >= 2
    assert min(drops) <= 196 + 8 + 3


@pytest.mark.parametrize("later", [0.05, 0.3])
def test_where_time_goes_back_or_leaves_a_gap_all_is_read_anew(later: float) -> None:
    ahead = Ahead(dynamics(), Preview(polynomial(0.12, size=1.0), -np.inf, np.inf), STEP)
    ahead.look(0.1, 0.2)
    assert len(ahead.roots) == 1
    ahead.look(later, later + 0.05)
    assert ahead.known.t[0] == later
    assert len(ahead.roots) == 0


def test_from_the_last_instant_on_it_goes_on() -> None:
    for later, anew in ((0.2, False), (0.2 + 0.5 * SAME, False), (0.2 + 1e-6, True)):
        ahead = Ahead(dynamics(), Preview(AWAY, -np.inf, np.inf), STEP)
        ahead.look(0.1, 0.2)
        ahead.look(later, 0.3)
        assert (ahead.known.t[0] == later) == anew


def test_what_may_change_its_mind_is_read_anew_each_time() -> None:
    motion = Counted(AWAY)
    ahead = Ahead(dynamics(), Preview(motion, -np.inf, np.inf, changing=True), STEP)
    ahead.look(0.0, 0.1)
    before = len(motion.asked)
    ahead.look(0.02, 0.12)
    assert len(motion.asked) == 2 * before
    assert ahead.known.t[0] == 0.02


# singular instants


CASES = {
    "crossing": (polynomial(0.1037), [0.1037]),
    "on the grid": (polynomial(40.0 * SPACING), [40.0 * SPACING]),
    "there and back": (polynomial(0.0611, 0.1437, size=20.0), [0.0611, 0.1437]),
    "twice from an instant to the next": (
        polynomial(0.1003, 0.1017, size=20.0), [0.1003, 0.1017]
    ),
    "twice around an instant": (polynomial(0.0995, 0.1005, size=20.0), [0.0995, 0.1005]),
    "touching": (polynomial(0.1011, 0.1011, size=20.0), [0.1011]),
    "touching on the grid": (polynomial(0.1, 0.1, size=20.0), [0.1]),
    # relative to the largest in sight
    "as good as touching": (polynomial(0.1011, 0.1011, size=20.0, offset=0.5e-4), [0.1011]),
    "passing by": (polynomial(0.1011, 0.1011, size=20.0, offset=2e-3), []),
    "at rest on the line": (moving(lambda t: (0.0, 0.0, 0.0)), []),
    "along it": (moving(lambda t: (1e-12, 0.0, 0.0)), []),
    "three times": (polynomial(0.03, 0.0915, 0.17, size=300.0), [0.03, 0.0915, 0.17]),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("pieces", [(0.2,), (0.0935, 0.1, 0.1025, 0.105, 0.2), tuple(np.arange(0.01, 0.21, 0.0025))])
def test_singular_instants_are_the_zeros_of_the_height(name: str, pieces: tuple[float, ...]) -> None:
    """However it comes into sight, each once."""
    motion, roots = CASES[name]
    ahead = Ahead(dynamics(), Preview(motion, -np.inf, np.inf), STEP)
    for end in pieces:
        found = ahead.look(0.0, float(end))
    np.testing.assert_allclose(found, roots, atol=2e-6 if "touching" in name else 1e-9)


def test_singular_instants_are_told_from_the_first_one_on() -> None:
    ahead = Ahead(dynamics(), Preview(polynomial(0.0611, 0.1437, size=20.0), -np.inf, np.inf), STEP)
    assert len(ahead.look(0.0, 0.2)) == 2
    for start, count in ((0.0611 - 1e-6, 2), (0.0611 + 1e-6, 1), (0.15, 0)):
        assert len(ahead.look(start, 0.2)) == count
        assert len(ahead.roots) == 2


@pytest.mark.parametrize("length", [0.05, 4.0])
def test_directions_that_are_lost_count_moments_over_the_characteristic_length(length: float) -> None:
    robot = replace(zoo.robot_of("3rrr"), characteristic_length=length)
    rate = np.array([0.0, 0.0, -2.0])
    start = zoo.home_of(robot) + np.array([0.1, 0.2, 0.0])

    def turning(t: Array) -> rp.PlatformMotion:
        return rp.PlatformMotion(t, start + t[:, None] * rate, np.tile(rate, (len(t), 1)), np.zeros((len(t), 3)))

    ahead = Ahead(rp.RneaDynamics(robot), Preview(turning, 0.0, 1.0), STEP)
    (root,) = ahead.look(0.0, 1.0)
    nodes = root + np.array([-STEP, 0.0, STEP])
    at = tuple(np.zeros((3, 3)) for _ in range(3))
    lin = linearised(ahead, nodes, np.array([1]), at, np.zeros((3, 3)), 1.0)
    W = rp.VirtualWork(robot).reduce(turning(np.array([root]))).W[0]
    np.testing.assert_allclose(lin.row_scale, [1.0, 1.0, length])
    np.testing.assert_allclose(lin.lost[0] @ W, 0.0, atol=1e-6 * np.abs(W).max())
    assert np.linalg.norm(lin.lost[0] * lin.row_scale) == pytest.approx(1.0)


@pytest.mark.parametrize("degree", [0, 1, 2, 4, 8])
def test_zeros_of_a_series_are_those_of_its_polynomial(degree: int) -> None:
    """Next to straight lines, of which they are approached, and others, of which they are eigenvalues."""
    rng, many = np.random.default_rng(degree), 0
    for bent in np.geomspace(1e-3, 10.0, 60):
        series = bent * rng.normal(size=degree + 1) / np.arange(1, degree + 2) ** 2
        series[:2] = rng.normal(size=2)[: len(series[:2])]
        if rng.random() < 0.2 and degree > 1:  # a parabola that all but touches zero at 0.3
            series[:3] = np.array([0.59 + rng.choice([-1.0, 1.0]) * rng.uniform(0.0, 3e-3), -0.6, 0.5])
            series[3:] = 0.0
        ordinary = np.polynomial.Chebyshev(series).convert(kind=np.polynomial.Polynomial).roots()
        real = ordinary.real[(np.abs(ordinary.imag) < 1e-9) & (np.abs(ordinary.real) <= 1.0)]
        found = zeros_of([*series.tolist(), 1e-15])
        if not len(real):  # lows that all but touch zero
            polynomial = np.polynomial.Chebyshev(series).convert(kind=np.polynomial.Polynomial)
            lows = polynomial.deriv().roots()
            lows = lows.real[(np.abs(lows.imag) < 1e-9) & (np.abs(lows.real) < 1.0)]
            real = lows[np.abs(polynomial(lows)) < 1e-3]
        np.testing.assert_allclose(np.sort(found), np.sort(real), rtol=0.0, atol=1e-9)
        many += len(real)
    assert many >= (20 if degree else 0)


@pytest.mark.parametrize("constant", np.linspace(-1.05, 0.93, 21))
def test_a_series_that_is_steep_next_to_its_ends_has_its_zeros(constant: float) -> None:
    """Four times as steep there as in the mean, so that no step by that leads to them."""
    series = [constant, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.06]
    places = np.cos(np.linspace(0.0, np.pi, 20001))[::-1]
    value = np.polynomial.Chebyshev(series)(places)
    (changes,) = np.nonzero(value[1:] * value[:-1] < 0.0)
    assert len(changes)
    found = np.sort(zeros_of(series))
    assert len(found) == len(changes)
    assert (found >= places[changes]).all()
    assert (found <= places[changes + 1]).all()


@pytest.mark.parametrize(("known", "horizon"), [(0.1, 1.0), (np.inf, 0.1)])
@pytest.mark.parametrize("root", [0.09995, 0.00005])
def test_nothing_is_asked_beyond_what_is_in_sight(known: float, horizon: float, root: float) -> None:
    """A singular instant 0.05 ms before the end or after the start, of whose other side nothing is in sight: there
    the preview ends, or the horizon."""
    motion = Counted(polynomial(root, size=1.0))
    ahead = Ahead(dynamics(), Preview(motion, 0.0, known), STEP)
    np.testing.assert_allclose(ahead.look(0.0, horizon), [root], atol=1e-9)
    assert min(motion.asked) == 0.0
    assert max(motion.asked) == 0.1
    assert (
        np.isclose(motion.asked[:, None], root + np.array([0.0, 1e-4 if root < 0.05 else -1e-4]), atol=1e-9)
        .any(0)
        .all()
    )


# instants of plans


@pytest.mark.parametrize("until", [10.0, 0.1, 0.0871, 0.06, 0.06 - 0.5e-9, 0.05, 0.0])
def test_instants_are_nodes_the_grid_in_between_and_both_sides_of_jumps(until: float) -> None:
    breaks = np.array([0.02, 0.0301, 0.0501, 0.0601, 0.0999, 0.2])
    nodes = np.array([0.0301 - 1e-7, 0.04, 0.0501, 0.06, 0.0871, 0.1])
    ahead = Ahead(dynamics(), Preview(AWAY, -np.inf, np.inf, breaks=breaks), STEP)
    asked = nodes[nodes <= until + SAME]
    asked = asked if len(asked) else nodes[:1]
    inner = [b for b in breaks if asked[0] + 2e-8 < b < asked[-1] - 2e-8]
    expected = [*asked]
    for b in inner:
        expected += [b - 1e-8, b + 1e-8]
    for place in SPACING * np.arange(100):
        near = np.abs(place - np.array([*asked, *inner])).min()
        if asked[0] < place < asked[-1] and near > 0.1 * SPACING:
            expected.append(place)
    found = ahead.instants(nodes, until)
    np.testing.assert_allclose(found, np.sort(expected), rtol=0.0, atol=1e-12)
    places = ahead.at(found)
    np.testing.assert_array_equal(ahead.known.t[places], found)


def test_places_are_those_of_the_instants_and_what_is_missing_is_evaluated() -> None:
    motion = Counted(AWAY)
    ahead = Ahead(dynamics(), Preview(motion, -np.inf, np.inf), STEP)
    ahead.look(0.0, 0.05)
    before = len(motion.asked)
    times = np.array([0.02, 0.0213, 0.02 + 0.5 * SAME, 0.05, 0.07, 0.0213, -0.01, 0.02 - 0.5 * SAME])
    places = ahead.at(times)
    np.testing.assert_allclose(ahead.known.t[places], times, rtol=0.0, atol=0.6 * SAME)
    assert sorted(motion.asked[before:]) == [-0.01, 0.0213, 0.07]
    assert (np.diff(ahead.known.t) > 0.0).all()
    reduced = rp.VirtualWork(dynamics().robot).reduce(AWAY(ahead.known.t))
    np.testing.assert_allclose(ahead.known.W, reduced.W, atol=1e-12)
    np.testing.assert_allclose(ahead.known.constant[:, :2], reduced.f, atol=1e-9)
    np.testing.assert_allclose(ahead.known.constant[:, 2:], reduced.carrier_force, atol=1e-9)


def test_all_that_is_known_is_what_was_evaluated_and_lies_in_one_piece() -> None:
    """Instants behind the others, between them, and more than there was memory for; those that are past are dropped."""
    ahead = Ahead(dynamics(), Preview(AWAY, -np.inf, np.inf), STEP)
    names = ("t", "known", "W", "constant", "terms")
    places = 0
    for i in range(30):
        start = 0.31 * i * STEP
        end = start + (3.0 if i == 20 else 0.3)
        ahead.look(start, end)
        if i % 7 == 3:
            # the last ones, and many steps before them; a single one; two that are next to each other
            inside = {0: [0.00071, 0.00333, 0.2222], 1: [0.2991], 2: [0.0521, 0.0522]}[i // 7 % 3]
            before, asked = ahead.known.t.copy(), start + np.array(inside)
            ahead.at(asked)
            np.testing.assert_array_equal(ahead.known.t, np.union1d(before, asked))
            places += len(asked)
        known = ahead.known
        parts = [getattr(known, name) for name in names]
        assert all(part.flags.c_contiguous and len(part) == len(known.t) for part in parts)
        assert [part.dtype for part in parts] == [np.float64, bool, np.float64, np.float64, np.float64]
        assert (np.diff(known.t) > 0.0).all()
        terms = dynamics().carrier_terms(known.t, *ahead.preview.states(known.t))
        for own, expected in zip(parts[2:], terms, strict=True):
            np.testing.assert_allclose(own, expected, rtol=1e-9, atol=1e-9)
    assert places > 7
    assert len(ahead.known.t) > 1000
    reduced = rp.VirtualWork(dynamics().robot).reduce(AWAY(ahead.known.t))
    np.testing.assert_allclose(ahead.known.W, reduced.W, atol=1e-12)
    np.testing.assert_allclose(ahead.known.constant[:, :2], reduced.f, atol=1e-9)


def test_nothing_is_evaluated_behind_what_cannot_be_reached_until_that_is_past() -> None:
    """Beyond the stretched legs for a tenth of a second, and back: no plan leads past that, so none asks for it."""
    robot = rp.load_robot("five_bar", carriers=True)
    edge, rate = np.sqrt(1.0 - 0.25**2), np.pi / 0.2

    def up_and_back(t: Array) -> rp.PlatformMotion:
        height = edge - 0.1 + 0.2 * np.sin(rate * t), 0.2 * rate * np.cos(rate * t), -0.2 * rate**2 * np.sin(rate * t)
        x, xd, xdd = (np.stack([side + 0.0 * t, part], axis=1) for side, part in zip((0.25, 0, 0), height, strict=True))
        return rp.PlatformMotion(t, x, xd, xdd, check_rates=False)

    preview, lost = Counted(up_and_back), 0.2 / 6.0
    ahead = Ahead(rp.CompiledDynamics(robot), Preview(preview, -np.inf, np.inf), STEP)
    ahead.look(0.0, 0.18)
    asked = len(preview.asked)
    for start in (0.004, 0.013, 0.03):
        ahead.look(start, start + 0.18)
        assert len(preview.asked) == asked
        np.testing.assert_array_equal(ahead.known.known, ahead.known.t < lost)
    ahead.look(0.2 - lost + 0.003, 0.23)
    assert ahead.known.known.all()
    np.testing.assert_allclose(ahead.known.t[[0, -1]], [0.2 - lost + 0.003, 0.23], atol=SPACING)


@pytest.mark.parametrize("backend", [rp.CompiledDynamics, rp.RneaDynamics])
def test_what_cannot_be_reached_is_zero_and_not_known(backend: Callable[[Any], Any]) -> None:
    """Up until the legs are stretched, and beyond: first between instants that are known, then from the start."""
    robot = rp.load_robot("five_bar", carriers=True)
    edge = np.sqrt(1.0 - 0.25**2)

    def up(t: Array) -> rp.PlatformMotion:
        x = np.stack([0.25 + 0.0 * t, edge - 0.1 + 2.0 * t], axis=1)
        return rp.PlatformMotion(t, x, np.tile([0.0, 2.0], (len(t), 1)), np.zeros((len(t), 2)))

    ahead = Ahead(backend(robot), Preview(up, -np.inf, np.inf), STEP)
    for start in (0.0, 0.004, 0.013, 0.03):
        ahead.look(start, start + 0.03)
    known = ahead.known
    np.testing.assert_array_equal(known.known, known.t < 0.05)
    assert not known.known.all()
    for part in (known.W, known.constant, known.terms):
        assert (part[~known.known] == 0.0).all()
        assert (part[known.known] != 0.0).any(axis=(1, 2) if part.ndim == 3 else None).all()


@pytest.mark.parametrize("what", ["trajectory", "samples", "function"])
def test_states_are_those_of_the_motion(what: str) -> None:
    """Of a trajectory while the platform is held at its end, too."""
    sources: dict[str, tuple[Any, float]] = {
        "trajectory": (rp.trajectory.reference.circle(), np.inf),
        "samples": (zoo.smooth_motion(dynamics().robot, 0).at(np.linspace(0.0, 1.0, 201)), 1.0),
        "function": (AWAY, np.inf),
    }
    source, last = sources[what]
    preview, end = Preview.of(source), getattr(source, "duration", 1.0)
    for times in ([0.0, 0.1], [0.3], [end - 1e-3, end], [end], [end - 0.1, end, end + 0.1, end + 5.0], [end + 1.0]):
        t = np.array(times)
        if t[-1] <= last:
            motion = preview.motion(t)
            for got, want in zip(preview.states(t), (motion.x, motion.xd, motion.xdd), strict=True):
                np.testing.assert_allclose(got, want, rtol=0.0, atol=1e-13)  # of sizes up to one


# nodes


def nodes_by_loops(start: float, count: int, roots: list[float]) -> list[float]:
    """The nodes one after the other, in half steps of a grid that is fixed in time."""
    half = 0.5 * STEP
    singular: list[float] = []
    for root in roots:
        if (
            root - start > 0.05 * STEP
            and root <= start + 2 * STEP * count
            and all(root - other > 0.05 * STEP for other in singular)
        ):
            singular.append(root)
    nodes = [start, *singular]
    for i in range(int(np.floor(start / half)), int(np.floor(start / half)) + 4 * count):
        t = i * half
        every = 2 if t <= start + (10 + 1e-6) * STEP else 4  # half steps from node to node
        if any(abs(t - root) < 2.5 * (every // 2) * STEP for root in roots):
            every //= 2
        if t > start and i % every == 0 and min(abs(t - other) for other in [start, *singular]) > 0.2 * STEP:
            nodes.append(t)
    return sorted(nodes)[:count]


@pytest.mark.parametrize("start", [0.0, 0.0137, 1.23, -0.4301])
@pytest.mark.parametrize(
    "roots",
    [
        [], [0.0], [0.0005], [0.0015], [0.031], [0.031, 0.0315], [0.031, 0.0325], [0.31], [0.11, 0.2501, 0.41],
        [-0.03], [0.3995], [0.21, 0.2512], [0.039, 0.0791, 0.1203], [3.0],
    ],
    ids=str,
)  # fmt: skip
def test_nodes_are_steps_apart_then_two_and_half_as_far_around_singular_instants(
    start: float, roots: list[float]
) -> None:
    """From an update on; the one before it knows of a singular instant that is past."""
    motion = polynomial(*(start + root for root in roots)) if roots else AWAY
    for horizon in (0.04, 0.5):
        planner = RecedingHorizon(dynamics(), step=STEP, horizon=horizon)
        for t in (start - 0.06, start):
            planner.update(t, motion)
        nodes, known = planner.ticks.last.nodes, planner.ticks.ahead
        coming = [root for root in known.roots if root > start - 1e-9]
        begins = coming[0] if coming and coming[0] <= start + 0.25 * STEP else start
        assert not len(known.sharp)
        expected = nodes_by_loops(begins, len(nodes), known.roots.tolist())
        np.testing.assert_allclose(nodes, expected, rtol=0.0, atol=1e-12)
