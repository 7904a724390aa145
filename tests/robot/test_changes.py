"""``with_parameters`` and ``with_limits``: as if the files had said so, and checked as they are."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from written import FOUR_BAR, J, urdf_of, write_robot
from zoo import index, places_of

import redundancy_pin as rp
from redundancy_pin.errors import DeclarationError, InputError, UnsupportedRobotError
from redundancy_pin.robot import Robot
from redundancy_pin.trajectory import Line, RestToRest, Trajectory

PATH = Line((0.25, 0.8), (0.32, 0.75))
MOTION = Trajectory(PATH, RestToRest(PATH.length, 0.5)).sample(dt=0.05)
GRAVITY = (0.0, -9.81, 0.0)


@pytest.fixture(scope="module")
def robot() -> Robot:
    return rp.load_robot("five_bar", carriers=True, gravity=GRAVITY)


def reduced(robot: Robot) -> Any:
    parked = rp.CarrierMotion.parked(len(MOTION), robot.k, 0.1)
    return rp.RneaDynamics(robot).reduce(MOTION, parked, check_track=False)


def test_masses_of_links_are_those_of_the_argument(robot: Robot) -> None:
    """The xacro file makes a rod of the same form, whose moments grow as its mass."""
    other = rp.load_robot("five_bar", carriers=True, gravity=GRAVITY, proximal_mass=1.7, distal_mass=0.3)
    masses = {"proximal_1": 1.7, "proximal_2": 1.7, "distal_1": 0.3, "distal_2": 0.3}
    changed = rp.with_parameters(robot, masses=masses)
    for name in ("f", "carrier_force"):
        np.testing.assert_allclose(getattr(reduced(changed), name), getattr(reduced(other), name), rtol=1e-9, atol=1e-9)
    assert np.abs(reduced(changed).f - reduced(robot).f).max() > 0.1
    np.testing.assert_array_equal(changed.gravity, GRAVITY)
    assert changed.working_mode == robot.working_mode
    np.testing.assert_array_equal(changed.q_reference, robot.q_reference)
    assert changed.characteristic_length == robot.characteristic_length
    assert "proximal_1" in changed.notes[-1]


def test_lengths_move_the_joints(robot: Robot) -> None:
    """W is kinematics alone; the links keep their masses, which the argument does not."""
    other = rp.load_robot("five_bar", carriers=True, gravity=GRAVITY, proximal_length=0.6)
    changed = rp.with_parameters(robot, lengths={"elbow_1": 0.6, "elbow_2": (0.6, 0.0, 0.0)})
    np.testing.assert_allclose(reduced(changed).W, reduced(other).W, atol=1e-9)
    assert np.abs(reduced(changed).W - reduced(robot).W).max() > 0.01
    masses = [[body.mass for body in list(one.model.inertias)[1:]] for one in (changed, robot)]
    assert masses[0] == masses[1]
    tips = places_of(changed.model, changed.q_reference, "end_effector", "tip_2")  # closed anew
    np.testing.assert_allclose(tips[0].translation[:2], tips[1].translation[:2], atol=1e-10)
    assert np.abs(changed.q_reference - robot.q_reference).max() > 0.05
    with pytest.raises(DeclarationError, match="does not close"):
        rp.with_parameters(robot, lengths={"elbow_1": 0.1})


def test_lengths_may_not_part_a_tool_from_its_closure(tmp_path: Path) -> None:
    """A four-bar whose coupler ends in a pin, where a tool and the hinge of a pendulum are too."""
    joints = [
        *FOUR_BAR,
        J("tool_mount", "fixed", "coupler", "tool", (0.3, 0, 0)),
        J("pendulum", "revolute", "rocker", "bob", (0.2, 0, 0)),
        J("far_mount", "fixed", "coupler", "far", (0.4, 0, 0)),
    ]
    declaration = {
        "closures": [{"frames": ["coupler_tip", "rocker_tip"], "axes": ["x", "y"]}],
        "actuated": ["crank"],
        "independent": {"joints": ["crank", "pendulum"]},
        "reference": {"joints": {"crank": 1.0, "pendulum": 0.2}, "guess": {"knee": -0.6, "rocker": 1.4}},
    }
    robot = rp.load_robot(write_robot(tmp_path, urdf_of(joints), declaration))
    for parted, frame, other in (
        ({"coupler_end": 0.32}, "coupler_tip", "tool_mount"),
        ({"tool_mount": 0.32}, "coupler_tip", "tool_mount"),
        ({"rocker_end": 0.22}, "rocker_tip", "pendulum"),
        ({"pendulum": 0.22}, "rocker_tip", "pendulum"),
    ):
        with pytest.raises(InputError, match=f"'{frame}' and the joint '{other}' .* 0.02 m apart") as refusal:
            rp.with_parameters(robot, lengths=parted)
        assert refusal.value.details["distance"] == pytest.approx(0.02, rel=1e-9)
        assert all(repr(name) in refusal.value.remedy for name in parted)
    # the remedy: both; and what was nowhere else may go alone
    changed = rp.with_parameters(
        robot, lengths={"coupler_end": 0.32, "tool_mount": 0.32, "far_mount": 0.5, "knee": 0.11}
    )
    tips = places_of(changed.model, changed.q_reference, "coupler_tip", "tool", "rocker_tip")
    np.testing.assert_allclose([tip.translation for tip in tips[1:]], [tips[0].translation] * 2, atol=1e-10)


def test_arguments_are_those_of_load_robot(robot: Robot) -> None:
    changed = rp.with_parameters(robot, carrier_mass=2.0)
    other = rp.load_robot("five_bar", carriers=True, gravity=GRAVITY, carrier_mass=2.0)
    np.testing.assert_array_equal(reduced(changed).f, reduced(other).f)
    both = rp.with_parameters(robot, carrier_mass=2.0, masses={"distal_1": 0.9})
    after = rp.with_parameters(changed, masses={"distal_1": 0.9})
    np.testing.assert_array_equal(reduced(both).f, reduced(after).f)
    with pytest.raises(InputError, match="no argument 'carier_mass'"):
        rp.with_parameters(robot, carier_mass=1.0)
    with pytest.raises(InputError, match="changed already"):
        rp.with_parameters(after, carrier_mass=3.0)


def test_a_closed_form_does_not_stand_for_a_changed_robot() -> None:
    two_rpr = rp.load_robot("2rpr")
    rp.VirtualWork(rp.with_parameters(two_rpr, carrier_mass=2.0))
    rp.VirtualWork(rp.with_limits(two_rpr, speed=1.0))
    with pytest.raises(UnsupportedRobotError):
        rp.VirtualWork(rp.with_parameters(two_rpr, masses={"mass_1": 3.0}))


def test_plain_urdfs_take_changes(tmp_path: Path) -> None:
    """A crank that moves a cross slide; a weight of m at c, and sliders of 1 kg, ask for what a textbook says."""
    joints = [
        J("crank", "revolute", "base", "arm"),
        J("tip_mount", "fixed", "arm", "tip", xyz=(0.5, 0.0, 0.0)),
        J("across", "prismatic", "base", "slide", axis=(1.0, 0.0, 0.0)),
        J("up", "prismatic", "slide", "pin", axis=(0.0, 1.0, 0.0)),
    ]
    declaration = {
        "closures": [{"frames": ["tip", "pin"], "axes": ["x", "y"]}],
        "actuated": ["crank"],
        "independent": {"joints": ["crank"]},
        "reference": {"joints": {"crank": 0.3}},
        "gravity": [0, -9.81, 0],
    }
    robot = rp.load_robot(write_robot(tmp_path, urdf_of(joints), declaration))
    heavy = rp.with_parameters(robot, masses={"arm": 2.5}, lengths={"tip_mount": 0.7})
    q, qdd = 0.3, 2.0
    still = rp.PlatformMotion([0.0], [[q]], [[0.0]], [[qdd]])
    for one, mass, length in ((robot, 1.0, 0.5), (heavy, 2.5, 0.7)):
        inertia = mass * (0.025 + 0.1**2 + 0.02**2) + length**2 * (np.sin(q) ** 2 + 1.0)  # of the slide and of the pin
        weight = 9.81 * (mass * (0.1 * np.cos(q) - 0.02 * np.sin(q)) + length * np.cos(q))
        assert rp.RneaDynamics(one).reduce(still).f[0, 0] == pytest.approx(inertia * qdd + weight, rel=1e-12)
    frame = heavy.model.frames[heavy.model.getFrameId("tip")]
    np.testing.assert_allclose(frame.placement.translation, [0.7, 0.0, 0.0])
    limited = rp.with_limits(heavy, {"crank": {"lower": -1.0, "upper": 2.0, "speed": 3.0, "effort": 4.0}})
    again = rp.with_parameters(limited, masses={"arm": 1.0})
    crank = index(heavy, "crank")
    for model in (limited.model, again.model):
        assert (model.lowerPositionLimit[crank], model.upperPositionLimit[crank]) == (-1.0, 2.0)
        efforts = model.lowerEffortLimit[crank], model.upperEffortLimit[crank]
        assert (model.upperVelocityLimit[crank], *efforts) == (3.0, -4.0, 4.0)
    assert heavy.model.upperPositionLimit[crank] == 100.0  # robots do not change


def test_limits_of_carriers(robot: Robot) -> None:
    own = robot.carrier_limits
    limited = rp.with_limits(robot, {"carrier_2": {"upper": 0.05, "force": 9.0}}, speed=[1.0, 2.0], acceleration=np.inf)
    first, second = limited.carrier_limits
    assert (first.lower, first.upper, first.force) == (own[0].lower, own[0].upper, own[0].force)
    assert (first.speed, second.speed) == (1.0, 2.0)
    assert first.acceleration == second.acceleration == np.inf
    assert (second.lower, second.upper, second.force) == (own[1].lower, 0.05, 9.0)
    assert rp.with_parameters(limited, masses={"distal_1": 1.0}).carrier_limits == limited.carrier_limits
    parked = rp.CarrierMotion.parked(len(MOTION), 2, 0.06)
    with pytest.raises(rp.errors.CarrierLimitError, match="carrier_2"):
        rp.RneaDynamics(limited).reduce(MOTION, parked)
    assert robot.carrier_limits == own


MISTAKES: list[tuple[Callable[..., Robot], dict[str, Any], str]] = [
    (rp.with_parameters, {"masses": {"elbow_1": 1.0}}, "no link 'elbow_1'.*The joint elbow_1 moves distal_1"),
    (rp.with_parameters, {"masses": {"proximal": 1.0}}, "no link 'proximal'.*Did you mean 'proximal_"),
    (rp.with_parameters, {"lengths": {"elbow": 1.0}}, "no joint 'elbow'"),
    (rp.with_parameters, {"masses": {"distal_1": -1.0}}, "mass of distal_1 is -1.0"),
    (rp.with_parameters, {"masses": {"distal_1": "1 kg"}}, "mass of distal_1 is '1 kg'"),
    (rp.with_parameters, {"masses": {"tip_2": 1.0}}, "'tip_2' has no mass"),
    (rp.with_parameters, {"masses": [1.0]}, "masses is"),
    (rp.with_parameters, {"lengths": {"base_1": 0.1}}, "no direction"),
    (rp.with_parameters, {"lengths": {"elbow_1": (0.1, 0.2)}}, r"shape \(2,\)"),
    (rp.with_parameters, {"lengths": {"elbow_1": [1, [2]]}}, "place of elbow_1 is not an array"),
    (rp.with_limits, {"lower": 1.0, "upper": 0.5}, "runs from 1 to 0.5"),
    (rp.with_limits, {"speed": 0.0}, "speed of carrier_1 is 0.0"),
    (rp.with_limits, {"speed": [1.0] * 3}, "2 carrier"),
    (rp.with_limits, {"speed": [[1], [2, 3]]}, r"speed of carrier_1 is \[1\]"),
    (rp.with_limits, {"limits": {"carrier_3": {}}}, "no moving joint 'carrier_3'"),
    (rp.with_limits, {"limits": {"carrier_1": {"effort": 1.0}}}, "no limit 'effort'"),
    (rp.with_limits, {"limits": {"elbow_1": {"lower": 9.0, "upper": -9.0}}}, "runs from"),
    (rp.with_limits, {"limits": {"elbow_1": {"effort": -1.0}}}, "effort of elbow_1 is -1.0"),
]


@pytest.mark.parametrize(("change", "given", "message"), MISTAKES)
def test_mistakes_are_named(change: Callable[..., Robot], given: dict[str, Any], message: str, robot: Robot) -> None:
    with pytest.raises(InputError, match=message):
        change(robot, **given)


def test_both_ends_of_a_joint_are_set_before_they_are_compared() -> None:
    once = rp.with_limits(rp.load_robot("four_bar"), {"rocker": {"lower": -1.0, "upper": 1.0}})
    at = index(once, "rocker")
    for ends in ({"lower": 2.0, "upper": 3.0}, {"upper": -2.0, "lower": -3.0}):
        model = rp.with_limits(once, {"rocker": ends}).model
        assert (model.lowerPositionLimit[at], model.upperPositionLimit[at]) == (ends["lower"], ends["upper"])
    with pytest.raises(InputError, match="runs from 2 to 1"):
        rp.with_limits(once, {"rocker": {"lower": 2.0}})
    # limits of 0 and 0 are none: a URDF without lower and upper has them
    once.model.lowerPositionLimit[at] = once.model.upperPositionLimit[at] = 0.0
    for name, expected in (("lower", (0.5, np.inf)), ("upper", (-np.inf, 0.5))):
        model = rp.with_limits(once, {"rocker": {name: 0.5}}).model
        assert (model.lowerPositionLimit[at], model.upperPositionLimit[at]) == expected


def test_loads_of_the_files_are_there_once(tmp_path: Path) -> None:
    """Those declared, and those added since; a payload twice would be twice its mass."""
    import shutil

    from redundancy_pin.robot.shipped import declaration_path

    folder = tmp_path / "bar"
    shutil.copytree(declaration_path("four_bar").parent, folder)
    with (folder / "robot.yaml").open("a") as file:
        file.write("joint_forces: [{joint: crank, damping: 0.5}]\npayloads: [{frame: rocker_link, mass: 1.0}]\n")
    loaded = rp.load_robot(folder).loaded(rp.JointForces("rocker", damping=0.1))
    masses = [body.mass for body in loaded.model.inertias]
    mass = loaded.parameters["crank_mass"]
    for changed in (
        rp.with_parameters(loaded, crank_mass=mass),
        rp.with_parameters(loaded, masses={"crank_link": float(mass)}),
    ):
        assert repr(changed.loads) == repr(loaded.loads)
        np.testing.assert_allclose([body.mass for body in changed.model.inertias], masses, rtol=1e-12)


def test_balls_that_became_hinges_stay_hinges(tmp_path: Path) -> None:
    """A URDF without a declaration; the same as a file that has the other mass and length."""

    text = (Path(__file__).parent / "files" / "urdf" / "other" / "arm_with_a_wrist.urdf").read_text()

    def loaded(mass: float, length: float) -> Robot:
        (tmp_path / "arm.urdf").write_text(text.replace("MASS", str(mass)).replace("LENGTH", str(length)))
        return rp.load_robot(tmp_path / "arm.urdf")

    expected = loaded(2.5, 0.7)
    changed = rp.with_parameters(loaded(1.0, 0.2), masses={"hand": 2.5}, lengths={"hip": (0.7, 0.0, 0.0)})
    assert changed.independent_joints == expected.independent_joints == ("hip", "wrist_rz", "wrist_ry", "wrist_rx")
    state = np.random.default_rng(1).uniform(-0.5, 0.5, (3, 1, 4))
    f = [rp.RneaDynamics(each).reduce(rp.PlatformMotion([0.0], *state)).f for each in (changed, expected)]
    np.testing.assert_allclose(f[0], f[1], rtol=1e-12)
    np.testing.assert_array_equal(changed.model.jointPlacements[1].translation, [0.7, 0.0, 0.0])
