"""Ticks that are missed at random: the last plan goes on, its carriers to rest within limits, its efforts in balance.

Each tick that is missed is judged as if no other came after it: the carriers on a dense grid through the stop behind
the plan, the efforts by another backend to the end of what was known of the platform's motion.
"""

import sys
from dataclasses import dataclass, field
from itertools import islice

import numpy as np
import online
import pytest
from examples import SHARE

import redundancy_pin as rp
from redundancy_pin.planners.receding_horizon import RecedingHorizon
from redundancy_pin.planners.receding_horizon.command import extended
from redundancy_pin.status import UpdateStatus

DROPS = {"2rpr": 10_000, "3rrr": 1_000, "five_bar": 1_000}
PARTS = 10
"""Tests that share them."""

PATHS = {"2rpr": 15, "3rrr": 2, "five_bar": 2}
"""Between those with which the parts begin."""

STEP = 0.02
"""Of the plans, and between ticks, s."""

MISSED = 0.3
"""Share of plans after which ticks are missed: one to three as a rule, and now and then more than a horizon of them."""

SPACING = 2e-3
"""Of the grids, s."""

LIMIT = 1e-8
"""Of the carriers' limits, by which rounding may exceed them."""

AGES = (0.04, 0.06, 0.5)
"""Of plans, s. Efforts are those of W τ = f every 2.5 ms for three steps; then the nodes', 20 and 40 ms apart, with
what a linear f leaves. Of a singular instant in the third step it leaves more than of one in the second."""

BALANCE = 0.05
"""Of the largest f of parked carriers: what efforts may miss up to the first of these ages, 0.02 here."""

USUAL = 1e-4
"""What they miss as a rule, 2e-5 here; with those at the nodes alone it is twenty times as much."""

SMALL = 0.01
"""Of the same: what counts as missing next to nothing."""

AGAIN = 0.95
"""Share of ticks after missed ones that find a plan within every limit: all of them here."""

JUMP = 1e-9
"""m and m/s, from one plan to the next."""


@dataclass
class Missed:
    """What came of ticks missed after plans within every limit.

    ``ticks``: their number; ``broken``: what was promised and not kept; ``missing``: by the ages of the plan, s, the
    largest force that was, over the largest f of parked carriers; ``lasts``: from when the plan was made until a
    hundredth is missing, s; ``again``: whether the tick after a miss found a plan within every limit.
    """

    ticks: int = 0
    broken: list[str] = field(default_factory=list)
    missing: dict[float, list[float]] = field(default_factory=lambda: {age: [] for age in AGES})
    lasts: list[float] = field(default_factory=list)
    again: list[bool] = field(default_factory=list)

    def judge(self, command, plan, trajectory, judge, size):
        """Count a missed tick after a plan, the largest f being of some size."""
        made = plan.t
        self.ticks += 1
        beyond = carriers_beyond(command, judge.robot)
        if beyond > LIMIT:
            self.broken.append(f"carriers beyond a limit by {beyond:.2g} of it after {command.t:.6g} s")
        if command.t > min(command.known_until, trajectory.duration):
            return  # the carriers rest, and nothing is known of the platform
        t, left = missing(command, trajectory, judge)
        lost = t[left > SMALL * size]
        self.lasts.append((lost[0] if len(lost) else t[-1]) - made)
        for after, before in zip((0.0, *AGES), AGES, strict=False):
            young = (t >= made + after) & (t <= made + before)
            if young.any():
                self.missing[before].append(left[young].max() / size)
        if t[0] < made + AGES[0] and self.missing[AGES[0]][-1] > BALANCE:
            self.broken.append(f"{self.missing[AGES[0]][-1]:.2g} of f is missing soon after {command.t:.6g} s")

    def __str__(self):
        """Return the figures of docs/online.md."""
        missing = {age: np.percentile(part, [50, 99, 100]).round(5).tolist() for age, part in self.missing.items()}
        lasts = np.percentile(self.lasts, [0, 10, 50]).round(3).tolist()
        return (
            f"{self.ticks} ticks missed, {len(self.broken)} promises broken; missing of f (50, 99, 100 %) by age "
            f"{missing}; a hundredth after {lasts} s (least, 10, 50 %); "
            f"{sum(self.again)} of {len(self.again)} planned next"
        )


def carriers_beyond(command, robot):
    """Return by how much carriers are beyond limits from a tick to the end of the stop, or not at rest there.

    As a fraction of the limits.
    """
    t = np.append(np.arange(command.t, command.carriers.end, 0.25 * SPACING), command.carriers.end)
    worst = 0.0
    for limit, *motion in zip(robot.carrier_limits, *(part.T for part in extended(command.carriers, t)), strict=True):
        s, sd, sdd = motion
        half = 0.5 * (limit.upper - limit.lower)
        outside = (limit.lower - s.min()) / half, (s.max() - limit.upper) / half
        rates = np.abs(sd).max() / limit.speed - 1.0, np.abs(sdd).max() / limit.acceleration - 1.0
        worst = max(worst, *outside, *rates, np.abs(sd[-1]) / limit.speed)
    return float(worst)


def missing(command, trajectory, judge):
    """Return times from a tick to the end of what is known, s, and what efforts miss of f then."""
    end = min(command.known_until, trajectory.duration)
    t = np.linspace(command.t, end, max(int((end - command.t) / SPACING), 1) + 1)
    carriers = rp.CarrierMotion(*extended(command.carriers, t), check_rates=False)
    reduced = judge.reduce(trajectory.sample_at(t), carriers, check_track=False)
    left = (np.einsum("nij,nj->ni", reduced.W, command.efforts(t)) - reduced.f) / reduced.row_scale
    return t, np.abs(left).max(axis=1)


def miss_ticks(name, least, seed):
    """Miss so many ticks along random paths of a machine, from the path of this number on."""
    dynamics, missed, rng = online.machine(name), Missed(), np.random.default_rng([17, seed])
    judge = (rp.RneaDynamics if name == "five_bar" else rp.VirtualWork)(dynamics.robot)
    for trajectory in islice(online.random_paths(name, dynamics), seed, None):
        parked = judge.reduce(trajectory.sample(0.005))
        size = float(np.abs(parked.f / parked.row_scale).max())
        planner, plan, last, left_out = RecedingHorizon(dynamics), None, None, 0
        for t in planner.step * np.arange(int(trajectory.duration / planner.step)):
            command = planner.skip(t) if left_out else planner.update(t, trajectory)
            before, after = (np.concatenate(one.motion_at(t)[:2]) for one in (last or command, command))
            if np.abs(after - before).max() > JUMP:
                missed.broken.append(f"the carriers jump at {t:.6g} s")
            if left_out:
                left_out -= 1
                if plan.status is UpdateStatus.OK:  # an elastic plan promises nothing
                    missed.judge(command, plan, trajectory, judge, size)
            else:
                if last is not plan and plan.status is UpdateStatus.OK:
                    missed.again.append(command.status is UpdateStatus.OK)
                plan = command
                if rng.random() < MISSED:
                    left_out = int(rng.choice([1, 2, 3, 10, 40], p=[0.5, 0.2, 0.2, 0.08, 0.02]))
            last = command
            if missed.ticks == least:
                return missed
    raise AssertionError("no more paths")


@pytest.mark.long_for("five_bar-2-40-20")
@pytest.mark.parametrize(("name", "path", "count", "young"), [("2rpr", 0, 100, 30), ("five_bar", 2, 40, 20)])
def test_plans_go_on_when_ticks_are_missed(name, path, count, young):
    """Over and over the singular line; and where the platform turns within 20 ms, and nodes are finer."""
    missed = miss_ticks(name, count, path)
    sys.stdout.write(f"{missed}\n")  # pytest -s shows it
    assert not missed.broken
    assert len(missed.missing[AGES[0]]) > young
    assert np.median(missed.missing[AGES[0]]) < USUAL
    assert np.mean(missed.again) > AGAIN


@pytest.mark.long
@pytest.mark.parametrize("part", range(PARTS))
@pytest.mark.parametrize("name", ["2rpr", "3rrr", "five_bar"])
def test_ten_thousand_missed_ticks(name, part, keep, capsys):
    missed = miss_ticks(name, max(1, int(SHARE * DROPS[name] / PARTS)), PATHS[name] * part)
    keep("drops", name, {"right": missed.ticks - len(missed.broken), "wrong": len(missed.broken)}, {})
    with capsys.disabled():
        sys.stdout.write(f"\n{name}, {missed}\n")
    assert not missed.broken
