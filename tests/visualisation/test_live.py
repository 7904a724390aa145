"""A robot under sliders: loops closed after each drag, efforts those of inverse dynamics at rest, refusals told."""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import zoo
from test_page import commands_of

import redundancy_pin as rp
from redundancy_pin.errors import InputError, RedundancyPinError, SingularPoseError, UnsupportedRobotError
from redundancy_pin.kinematics.closure import constraint_system
from redundancy_pin.kinematics.coordinates import coordinates
from redundancy_pin.visualisation.viewer.live import LiveRobot
from redundancy_pin.visualisation.viewer.meshcat_scene import import_meshcat

pytest.importorskip("ipywidgets")

CLOSED = 1e-9  # m
FAST = 0.1  # s from a drag to the picture


def _residual(live: LiveRobot) -> float:
    """Return the closure residual, m, with the carriers where they are."""
    return float(np.abs(constraint_system(live.robot).evaluate(np.array(live.q)[None]).phi).max(initial=0.0))


def _coordinates(live: LiveRobot) -> np.ndarray:
    """Return (1, n) coordinates of the platform, or (1, 4, 4) poses."""
    return coordinates(live.robot, constraint_system(live.robot).evaluate(np.array(live.q)[None]))


def _drag(live: LiveRobot, seed: int = 0) -> list[float]:
    """Drag one slider after another to within a hundredth of its range; return how long each took, s."""
    random, taken = np.random.default_rng(seed), []
    first = {name: slider.value for name, slider in live.sliders.items()}
    for name in [*live.sliders] * (24 // len(live.sliders)):
        slider = live.sliders[name]
        started = time.perf_counter()
        slider.value = first[name] + random.uniform(-0.01, 0.01) * (slider.max - slider.min)
        taken.append(time.perf_counter() - started)
    return taken


@pytest.mark.long_for("2rpr-platform", "2rpr-actuators", "four_bar-actuators")
@pytest.mark.parametrize("by", ["platform", "actuators"])
@pytest.mark.parametrize("name", ["2rpr", "3rrr", "four_bar", "gough", "excavator"])
def test_loops_are_closed_and_efforts_hold_the_robot_while_one_drags(name: str, by: Any) -> None:
    live = rp.show(rp.load_robot(name, gravity=[0.5, -9.0, -3.0]), live=True, by=by)
    sent = commands_of(live.send_to)
    taken = _drag(live)
    robot, s = live.robot, np.array(live.s)
    assert (live.message, _residual(live) < CLOSED) == ("", True)
    assert np.median(taken) < FAST
    np.testing.assert_array_equal(np.array(live.q)[robot.carrier_position], s)
    np.testing.assert_array_equal(s, [live.sliders[carrier].value for carrier in robot.carriers])
    if by == "actuators":
        joints = [joint for joint in robot.actuated if joint in live.sliders]
        values = [live.sliders[joint].value for joint in joints]
        np.testing.assert_allclose(robot.joint_positions(np.array(live.q), joints), values, atol=1e-9)
    still = np.zeros((1, robot.n))  # inverse dynamics at rest by generated code, which has kinematics of its own
    rest = rp.PlatformMotion([0.0], _coordinates(live), still, still)
    reduced = rp.CompiledDynamics(robot).reduce(rest, rp.CarrierMotion(s[None], 0.0 * s[None], 0.0 * s[None]))
    np.testing.assert_allclose(live.tau, rp.distribute(reduced).tau[0], rtol=1e-7, atol=1e-7)
    np.testing.assert_allclose(live.carrier_force, reduced.carrier_force[0], rtol=1e-7, atol=1e-7)
    # the picture is where the robot is
    moved = [command for command in sent if command["type"] == "set_transform"]
    body = f"/meshcat/robot/joint_{live.scene.names[-1]}"
    last = [command["matrix"] for command in moved if command["path"] == body][-1]
    np.testing.assert_allclose(np.reshape(last, (4, 4)).T, live.scene.placement[0, -1], atol=1e-6)


def test_a_drag_that_cannot_be_closed_leaves_the_last_state_and_a_value_beyond_its_slider_its_end() -> None:
    live = rp.show("five_bar", live=True)
    live.set(x=0.3)
    q, tau, start = np.array(live.q), np.array(live.tau), live.sliders["y"].value
    live.sliders["y"].value = live.sliders["y"].max
    assert "no configuration closes the loops" in live.message
    assert live.message in live._numbers.value
    np.testing.assert_array_equal(live.q, q)
    np.testing.assert_array_equal(live.tau, tau)
    assert (live.sliders["x"].value, live.sliders["y"].value) == (0.3, start)  # where the robot is
    live.sliders["y"].value = start - 0.01
    assert live.message == ""
    assert np.abs(np.array(live.q) - q).max() > 1e-3
    assert _residual(live) < CLOSED
    live = rp.show("3rrr", live=True)
    end = live.sliders["carrier_1"].max
    live.set(carrier_1=99.0)
    assert live.message == f"carrier_1 = 99 is outside [{-end:.4g}, {end:.4g}]: set to {end:.4g}."
    assert live.message in live._numbers.value
    assert live.s[0] == live.sliders["carrier_1"].value == end
    live.set(x=99.0)  # which no configuration closes either
    assert "x = 99 is outside" in live.message
    assert "Not followed" in live.message
    with pytest.raises(InputError, match="x has 1 value"):
        live.set(x=float("nan"))
    live.set(carrier_1=0.1)
    assert live.message == ""


def test_arrows_appear_with_the_first_effort() -> None:
    """A crank on a spring at rest needs no effort until it is turned."""
    plain = rp.load_robot("four_bar", gravity=[0.0, 0.0, 0.0])
    (crank,) = plain.actuated
    rest = float(plain.joint_positions(np.array(plain.q_reference), [crank]).item())
    live = rp.show(plain.loaded(rp.JointForces(crank, stiffness=3.0, rest=rest)), live=True, by="actuators")
    sent = commands_of(live.send_to)
    assert not live.scene.arrows
    for turn in (0.1, 0.2):
        live.set(**{crank: rest + turn})
        assert live.tau[0] == pytest.approx(3.0 * turn, rel=1e-6)
        (arrow,) = live.scene.arrows
        assert arrow.length[0] > 0.0
    arrows = [one for one in sent if one["type"] == "set_object" and one["path"].startswith("/meshcat/forces")]
    assert len(arrows) == 1


def test_close_ends_the_server_and_keeps_the_numbers() -> None:
    live = rp.show("four_bar", live=True)
    live.widget.layout.width = "90%"
    server, tau = live._window.server_proc, np.array(live.tau)
    assert server.poll() is None
    live.close()
    assert server.poll() is not None
    np.testing.assert_array_equal(live.tau, tau)
    live.close()  # twice changes nothing


def test_a_singular_pose_is_not_passed_by_motors_and_the_branch_is_named() -> None:
    """The 2-RPR's legs in line with its base, where the platform may go up or down: y = 0."""
    live = rp.show("2rpr", live=True, by="actuators")
    assert live.branch == "working mode ++, det W > 0"
    live.set(slide_1=0.2, slide_2=0.25)  # shorter together than the base of 0.5 m
    assert "Not followed" in live.message
    assert _coordinates(live)[0, 1] > 0.0
    live = rp.show("2rpr", live=True)
    live.set(y=-0.1)  # as platform coordinates the poses are regular, and det W changes its sign
    assert (live.message, live.branch) == ("", "working mode ++, det W < 0")
    live.set(y=0.0)
    assert live.margin < 1e-9
    assert "near_singular" not in live.message


def test_a_notebook_gets_sliders_with_names_and_ranges_numbers_with_units_and_the_picture(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    live = rp.show("3rrr", live=True)
    assert [*live.sliders] == ["x", "y", "rz", "carrier_1", "carrier_2", "carrier_3"]
    limits = live.robot.carrier_limits[0]
    assert (live.sliders["carrier_1"].min, live.sliders["carrier_1"].max) == (limits.lower, limits.upper)
    for text in ("base_1", "N·m", "carrier_3", f"{live.margin:.3g}", "working mode +++"):
        assert text in live._numbers.value
    meshcat = import_meshcat()
    window = SimpleNamespace(send=lambda command: None, web_url="http://127.0.0.1:7000/static/")
    monkeypatch.setattr(meshcat, "Visualizer", partial(meshcat.Visualizer, window=window))
    assert "application/vnd.jupyter.widget-view+json" in live._repr_mimebundle_()
    controls, picture = live.widget.children
    assert controls.children[: len(live.sliders)] == tuple(live.sliders.values())
    assert f'src="{window.web_url}"' in picture.value


def test_what_goes_with_no_sliders_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    robot, motion = zoo.robot_of("2rpr"), rp.trajectory.reference.circle().sample(0.1)
    in_line = rp.inverse_kinematics(robot, rp.PlatformMotion([0.0], [[0.2, 0.0]], [[0.0, 0.0]], [[0.0, 0.0]])).q[0]
    singular, undriven = replace(robot, q_reference=in_line), replace(robot, actuated=robot.actuated[:1])
    refused: list[tuple[type[Exception], str, Any]] = [
        (InputError, "Sliders move a robot", lambda: rp.show(robot, motion, live=True)),  # type: ignore[call-overload]
        (InputError, "by is 'legs'", lambda: rp.show(robot, live=True, by="legs")),  # type: ignore[call-overload]
        (InputError, "No slider is called z", lambda: rp.show(robot, live=True).set(z=1.0)),
        (UnsupportedRobotError, "do not say where", lambda: rp.show(undriven, live=True, by="actuators")),
        (SingularPoseError, "singular for the actuators", lambda: rp.show(singular, live=True, by="actuators")),
    ]
    for kind, text, make in refused:
        with pytest.raises(kind, match=text):
            make()
    monkeypatch.setitem(sys.modules, "ipywidgets", None)
    with pytest.raises(RedundancyPinError, match=r"redundancy_pin\[live\]"):
        rp.show(robot, live=True)


def test_arrows_grow_with_the_efforts_up_to_the_size_of_the_machine() -> None:
    """The legs of the 2-RPR carry the more, the flatter they lie."""
    robot = rp.load_robot("2rpr", gravity=[0.0, -9.81, 0.0], end_effector_mass=1.0)
    live, size = rp.show(robot, live=True), robot.characteristic_length
    longest = []
    for y in (0.2, 0.1, 0.05):
        live.set(y=y)
        assert live.message == ""
        efforts = dict(zip(robot.actuated, live.tau.tolist(), strict=True))
        arrows = [arrow for arrow in live.scene.arrows if arrow.group == "main"]
        wanted = np.array([arrow.per_unit * efforts[arrow.name] for arrow in arrows])
        longest.append(np.abs(wanted).max() / size)
        shown = [joint.position.item() for joint in live.scene.joints]
        names = [joint.name for joint in live.scene.joints]
        np.testing.assert_array_equal(shown, robot.joint_positions(live.q[None], names)[0])
        drawn = [arrow.length.item() for arrow in arrows]
        np.testing.assert_allclose(drawn, np.clip(wanted, -size, size), rtol=1e-9)
    assert 0.6 < longest[0] < 1.0 or 0.6 < longest[1] < 1.0, longest  # longer than arrows of a motion may be
    assert longest[2] > 1.0
