"""What a page shows of plans made on line: the path known ahead, and what was planned, tick by tick."""

from __future__ import annotations

import json
import re
from functools import cache
from typing import Any

import numpy as np
import pytest

import redundancy_pin as rp
from redundancy_pin.errors import InputError
from redundancy_pin.planners.receding_horizon import OnLineRun, run_online
from redundancy_pin.trajectory import Line, SpeedProfile, Trajectory
from redundancy_pin.visualisation.viewer.ahead import MOST_BEADS, MOST_TICKS, Ahead
from redundancy_pin.visualisation.viewer.page import View

HORIZON = 0.2

ACROSS = Trajectory(Line((0.2, 0.08), (0.26, -0.08)), SpeedProfile(np.hypot(0.06, 0.16), 0.4, 0.2))
"""Through one type II pose of the 2-RPR, in 0.63 s."""


@cache
def run_and_view() -> tuple[OnLineRun, View]:
    robot = rp.load_robot("2rpr", end_effector_mass=0.5, cylinder_mass=0.3)
    run = run_online(rp.RecedingHorizon(rp.CompiledDynamics(robot), horizon=HORIZON), ACROSS)
    return run, rp.show(run.plan, robot=robot, commands=run.commands)


def ahead() -> Ahead:
    shown = run_and_view()[1].scene.ahead
    assert shown is not None
    return shown


def test_places_on_the_path_are_seen_while_they_are_known_and_ahead() -> None:
    shown = ahead()
    np.testing.assert_allclose(shown.places[:, :2], ACROSS.sample_at(shown.reached).x, atol=1e-9)
    assert len(shown.places) <= MOST_BEADS
    for t in (0.0, 0.301, ACROSS.duration):
        (seen,) = shown.in_sight(np.array([t]))
        tick = 0.02 * np.floor(t / 0.02 + 1e-9)
        horizon = min(tick + HORIZON, ACROSS.duration)
        inside = (shown.reached > t) & (shown.reached < horizon - 0.02)
        beyond = (shown.reached <= t) | (shown.reached > horizon + 0.04)  # the last nodes are two steps apart
        assert seen[inside].all()
        assert not seen[beyond].any()
    assert inside.sum() == 0


def test_what_is_drawn_is_what_was_planned() -> None:
    (run, _), shown = run_and_view(), ahead()
    assert len(shown.t) == len(run.commands) <= MOST_TICKS
    for command, times, own, other in zip(
        run.commands, shown.times, shown.planned["carrier_2"], shown.planned["slide_1"], strict=True
    ):
        np.testing.assert_allclose(own, [command.motion_at(t)[0][1] for t in times.tolist()], atol=1e-12)
        np.testing.assert_allclose(other[:5], command.efforts(times[:5])[:, 0], atol=1e-9)
    (root,) = shown.singular
    assert root == pytest.approx(run.plan.findings.singular_instants[0], abs=1e-4)


def test_commands_of_another_time_are_refused() -> None:
    run, _ = run_and_view()
    later = Trajectory(ACROSS.path, SpeedProfile(ACROSS.path.length, 0.4, 0.2)).sample(0.01)
    moved = rp.PlatformMotion(later.t + 7.0, later.x, later.xd, later.xdd)
    with pytest.raises(InputError, match=r"No command lies between 7 and 7\.6"):
        rp.show("2rpr", moved, commands=run.commands)


def listed(page: str) -> Any:
    (text,) = re.findall(r"const ahead = (.*);\n", page)
    return json.loads(text)


def test_the_page_has_it_and_others_have_none_of_it() -> None:
    pytest.importorskip("umsgpack", reason="comes with meshcat")
    run, view = run_and_view()
    plain = View(rp.show(run.plan, robot=rp.load_robot("2rpr", end_effector_mass=0.5, cylinder_mass=0.3)).scene)
    page, without = view.html(), plain.html()
    data = listed(page)
    assert listed(without) is None
    assert "path known ahead" in page
    assert "path known ahead" not in without
    assert [panel["title"] for panel in data["panels"]] == ["carriers [m]", "efforts [N]"]
    assert len(data["t"]) == len(data["times"]) == len(run.commands)
    joints = [i for panel in data["panels"] for i in panel["joints"]]
    assert sorted(map(int, data["planned"])) == sorted(joints)
    names = [view.scene.readings[i].name for i in joints]
    assert names == ["carrier_1", "carrier_2", "slide_1", "slide_2"]
    assert data["planned"][str(joints[1])][3] == pytest.approx(ahead().planned["carrier_2"][3], rel=1e-5, abs=1e-12)
    assert without.count('id="plan" hidden') == 1
    assert page.count('id="plan" hidden') == 0
