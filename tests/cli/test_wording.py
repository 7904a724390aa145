"""Errors of the package in the words of the command line and of problem files, rule by rule."""

from __future__ import annotations

import pytest

from redundancy_pin.cli.errors import KEYS, OPTIONS, in_words
from redundancy_pin.errors import (
    CarrierLimitError,
    InputError,
    RedundancyPinError,
    SingularPoseError,
    UnreachablePoseError,
)

NAMES = {
    "dt": "--step",
    "lam": "--lam",
    "stop": "--stop",
    "speed": "--max-speed",
    "ramp_down": "--ramp-down",
    "anticipate": "--anticipate/--no-anticipate",
    "carrier_force": "--max-carrier-force",
}
FLAGS = OPTIONS.knowing(NAMES)
YAML = KEYS.knowing({name: name for name in NAMES})


@pytest.mark.parametrize(
    ("said", "flags", "keys"),
    [
        ("lam = 0.5 asks for more.", "--lam 0.5 asks for more.", "lam: 0.5 asks for more."),
        ("Use lam = 0, which suits.", "Use --lam 0, which suits.", "Use lam: 0, which suits."),
        ("Use a larger lam, or wait.", "Use a larger --lam, or wait.", "Use a larger lam, or wait."),
        ("Allow a longer dt.", "Allow a longer --step.", "Allow a longer dt."),
        ('Use stop="after".', "Use --stop after.", "Use stop: after."),
        ("Use anticipate=True, or not.", "Use --anticipate, or not.", "Use anticipate: true, or not."),
        ("Try anticipate=False.", "Try --no-anticipate.", "Try anticipate: false."),
        ("Shorten ramp_down.", "Shorten --ramp-down.", "Shorten ramp_down."),
        # English in the middle of a sentence, a parameter where it begins
        ("speed is 3, at full speed.", "--max-speed is 3, at full speed.", "speed is 3, at full speed."),
        ("speedy is 3.", "speedy is 3.", "speedy is 3."),
        # what stands in it already is not a name
        ("Write --lam 0.5 or --ramp-down 1.", "Write --lam 0.5 or --ramp-down 1.", "Write --lam 0.5 or --ramp-down 1."),
        # a word given to another parameter
        ("Use peak, carrier_force.", "Use peak, carrier_force.", "Use peak, carrier_force."),
        ("carrier_force is -1.", "--max-carrier-force is -1.", "carrier_force is -1."),
        ("Load it in another working_mode.", "Load it in another --mode.", "Load it in another mode."),
    ],
)
def test_names_become_flags_or_keys(said: str, flags: str, keys: str) -> None:
    for wording, expected in ((FLAGS, flags), (YAML, keys)):
        reworded = wording.reword(InputError(said, remedy=said))
        assert reworded.message == expected
        assert reworded.remedy == expected


def test_an_error_keeps_its_kind_and_is_reworded_once() -> None:
    with pytest.raises(UnreachablePoseError) as caught, in_words(FLAGS), in_words(YAML):
        raise UnreachablePoseError("lam = 1 is too much.", remedy="Use lam = 0.", gap=1.0)
    assert caught.value.message == "lam: 1 is too much."
    assert caught.value.remedy == "Use lam: 0."
    assert isinstance(caught.value.__cause__, UnreachablePoseError)


@pytest.mark.parametrize(
    "error",
    [
        UnreachablePoseError("Out.", remedy="Stay inside, or ask for unreachable samples to be marked."),
        SingularPoseError("Out.", remedy='Stay inside, or pass unreachable="mark".'),
    ],
)
def test_only_a_command_that_can_mark_samples_says_so(error: RedundancyPinError) -> None:
    assert OPTIONS.reword(error).remedy == "Stay inside."
    marking = OPTIONS.knowing({"unreachable": "--unreachable"})
    assert marking.reword(error).remedy == "Stay inside, or write --unreachable mark."


def test_python_only_remedies_are_left_out() -> None:
    error = CarrierLimitError("Off.", remedy="Shorten it or lengthen it; planners evaluate with check_track=False.")
    assert OPTIONS.reword(error).remedy == "Shorten it or lengthen it."


@pytest.mark.parametrize(
    ("axes", "poses", "given", "message", "remedy"),
    [
        (
            ("x", "y"),
            False,
            3,
            "has 3 coordinates, but bot moves in 2 (x, y)",
            "trajectory circle, line, points with 2",
        ),
        (
            ("x", "y", "rz"),
            False,
            2,
            "has 2 coordinates, but bot moves in 3",
            "corner, square, points with 3 numbers a",
        ),
        (
            ("crank",),
            False,
            2,
            "moves in 1 (crank)",
            "points with 1 number a row, or a file with the columns t, x0, xd0",
        ),
        (("x", "y", "z", "rx", "ry", "rz"), True, 2, "moves through poses", "x0 to x6"),
    ],
)
def test_a_motion_of_another_robot(axes: tuple[str, ...], poses: bool, given: int, message: str, remedy: str) -> None:
    details = {"robot": "bot", "axes": axes, "poses": poses, "given": given, "given_poses": False}
    reworded = OPTIONS.reword(InputError("x has shape (1, 2).", remedy="Pass x as (N, 3).", **details))
    assert message in reworded.message
    assert remedy in reworded.remedy
    assert OPTIONS.reword(InputError("x", **{**details, "given_poses": True})).message.startswith(
        "The motion has poses,"
    )


def test_a_mode_of_another_robot() -> None:
    def said(legs: int) -> str:
        return str(OPTIONS.reword(InputError("It is (1, -1).", remedy="A tuple.", working_mode=(1, -1), legs=legs)))

    assert said(3) == "--mode is +-, but the robot has 3 legs. Give a sign for each, such as --mode +++."
    assert said(0) == "--mode is +-, but the robot declares no working modes. Leave it out."
