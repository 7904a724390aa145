"""What is in sight: which instants are evaluated, kept and asked for, singular instants by formula, nodes by loops."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
import zoo

import redundancy_pin as rp
from redundancy_pin.arrays import Array
from redundancy_pin.planners.receding_horizon import RecedingHorizon
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
def test_each_instant_of_a_grid_is_asked_for_once(begins: float) -> None:
    motion = Counted(AWAY)
    preview, planner = Preview(motion, -np.inf, np.inf), RecedingHorizon(dynamics(), step=STEP, horizon=0.1)
    updates = begins + np.array([0.0, 0.02, 0.0204, 0.03, 0.03, 0.1])
    for t in updates.tolist():
        planner.update(t, preview)
    expected = np.append(begins, grid(begins, begins + 0.1 + 0.1))
    asked = np.sort(motion.asked)
    near = np.abs(asked[:, None] - expected).min(axis=0)
    assert near.max() < 1e-9
    assert np.diff(asked).min() > SAME
    between = asked[np.abs(asked[:, None] - expected).min(axis=1) > SAME]  # updates and their ends, off the grid
    ends = np.concatenate([updates, updates + 0.1])
    assert np.abs(between[:, None] - ends).min(axis=1).max(initial=0.0) < SAME


@pytest.mark.parametrize("end", [0.1, 0.1 + 0.4 * SPACING, 0.1 + 0.05 * SPACING, 0.1 + 0.5e-9])
def test_nothing_is_asked_for_outside_a_preview_and_its_end_is(end: float) -> None:
    motion = Counted(AWAY)
    planner, preview = RecedingHorizon(dynamics(), step=STEP, horizon=0.1), Preview(motion, 0.0, end)
    for t in (0.0, 0.03, 0.05, 0.06):
        planner.update(t, preview)
    assert motion.asked.min() == 0.0
    assert end - SAME <= motion.asked.max() <= end


def test_what_may_change_its_mind_is_read_anew_each_time() -> None:
    motion = Counted(AWAY)
    planner = RecedingHorizon(dynamics(), step=STEP, horizon=0.1)
    planner.update(0.0, motion)
    before = len(motion.asked)
    planner.update(0.02, motion)
    assert len(motion.asked) == 2 * before


@pytest.mark.parametrize("rate", [50.0, 3000.0])
def test_planners_that_run_without_end_keep_what_is_in_sight(rate: float) -> None:
    """Whatever is past is forgotten: many times what there is memory for, with the instants of updates off the grid."""
    motion, count = Counted(AWAY), 800
    preview, planner = Preview(motion, -np.inf, np.inf), RecedingHorizon(dynamics(), step=STEP, horizon=0.1)
    size = len(planner.updates._memory)
    for i in range(count):
        command = planner.update(i / rate, preview)
    assert command.status.value == "ok"
    assert len(planner.updates._memory) == size
    fresh = RecedingHorizon(dynamics(), step=STEP, horizon=0.1)
    s, sd, _ = command.motion_at(command.t)
    assert fresh.update(command.t, preview, s, sd).status.value == "ok"
    assert len(motion.asked) < (1 if rate == 50.0 else 6) * count + count / rate / SPACING + 100  # 40 are in sight


# singular instants


CASES = {
    "crossing": (polynomial(0.1037), [0.1037]),
    "on the grid": (polynomial(40.0 * SPACING), [40.0 * SPACING]),
    "there and back": (polynomial(0.0611, 0.1437, size=20.0), [0.0611, 0.1437]),
    "twice from an instant to the next": (
        polynomial(0.1003, 0.1017, size=20.0), [0.1003, 0.1017]
    ),
    "twice before the last instant in sight": (
        polynomial(0.0983, 0.0997, size=20.0), [0.0983, 0.0997]
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
@pytest.mark.parametrize("pieces", [(0.0,), (-0.1065, -0.1, -0.0975, -0.095, 0.0), tuple(np.arange(-0.19, 0.01, 0.02))])
def test_singular_instants_are_the_zeros_of_the_height(name: str, pieces: tuple[float, ...]) -> None:
    """However they come into sight, each once."""
    motion, roots = CASES[name]
    preview, planner = Preview(motion, -np.inf, np.inf), RecedingHorizon(dynamics(), step=STEP, horizon=0.2)
    for t in pieces:
        found = planner.update(float(t), preview).singular
    np.testing.assert_allclose(found, roots, atol=2e-6 if "touching" in name else 1e-9)


@pytest.mark.parametrize("seed", [*range(12), *(pytest.param(seed, marks=pytest.mark.long) for seed in range(12, 40))])
def test_zeros_of_random_heights_are_all_found(seed: int) -> None:
    """Up to six between two instants of the grid and anywhere else, at least a hundredth of a step apart."""
    rng = np.random.default_rng(seed)
    width = rng.choice([0.6 * SPACING, 0.02, 0.15])
    most = 7 if width > STEP else 4  # of more the height is next to nothing against what it is later
    roots = 0.05 + np.sort(rng.uniform(0.0, width, int(rng.integers(1, most))))
    roots = roots[np.append(True, np.diff(roots) > 0.02 * width)]
    if width < SPACING:  # of those between two instants two show, as a dip
        roots = roots[:2]
    size = 0.05 / np.abs(np.polynomial.Polynomial.fromroots(roots)(np.linspace(0.0, 0.2, 50))).max()
    planner = RecedingHorizon(dynamics(), step=STEP, horizon=0.2)
    found = planner.update(0.0, Preview(polynomial(*roots, size=size), -np.inf, np.inf)).singular
    np.testing.assert_allclose(found, roots, atol=1e-8)


def test_of_very_many_singular_instants_those_within_reach_of_a_plan_are_planned() -> None:
    """Twelve have their rows; the motion behind them is not planned before they are past, and that is told."""

    def swing(t: Array) -> tuple[Array, Array, Array]:
        phase = 2.0 * np.pi * 50.0 * (t + 0.003)
        w = 2.0 * np.pi * 50.0
        return 2e-4 * np.sin(phase), 2e-4 * w * np.cos(phase), -2e-4 * w**2 * np.sin(phase)

    planner = RecedingHorizon(dynamics(), step=STEP, horizon=0.5)
    command = planner.update(0.0, Preview(moving(swing), -np.inf, np.inf))
    every = np.arange(1, 61) * 0.01 - 0.003
    np.testing.assert_allclose(command.singular, every[every < 0.5], atol=1e-8)
    assert len(command.singular) > 12
    assert every[9] < command.known_until < every[12]


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
        nodes, known = planner.updates.last.nodes, planner.updates
        coming = [root for root in known.roots if root > start - 1e-9]
        begins = coming[0] if coming and coming[0] <= start + 0.25 * STEP else start
        assert not len(known.sharp)
        expected = nodes_by_loops(begins, len(nodes), known.roots.tolist())
        np.testing.assert_allclose(nodes, expected, rtol=0.0, atol=1e-12)
