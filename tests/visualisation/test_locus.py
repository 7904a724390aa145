"""Pictures of the locus: what is drawn is what was computed, and files are written whole or not at all."""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np
import pytest
import zoo

from redundancy_pin.errors import OutputError
from redundancy_pin.singularities.crossings import find_crossings
from redundancy_pin.singularities.locus import SingularLocus, singular_locus
from redundancy_pin.trajectory import reference
from redundancy_pin.visualisation.figures.paths import draw_locus
from redundancy_pin.visualisation.figures.style import save
from redundancy_pin.visualisation.viewer.mechanism import base_hinges, links

pytest.importorskip("matplotlib")


@functools.cache
def locus_of(name: str) -> SingularLocus:
    return singular_locus(zoo.robot_of(name), resolution=24)


@pytest.mark.long_for(".pdf", ".svg")
@pytest.mark.parametrize("suffix", [".png", ".svg", ".pdf"])
def test_a_picture_is_written_in_the_format_of_its_suffix(tmp_path: Path, suffix: str) -> None:
    target = tmp_path / f"locus{suffix}"
    save(draw_locus(locus_of("3rrr")), target)
    head = target.read_bytes()[:200]
    assert {".png": b"\x89PNG", ".svg": b"<svg", ".pdf": b"%PDF"}[suffix] in head or head.startswith(b"<?xml")
    assert list(tmp_path.iterdir()) == [target]


def test_the_curves_and_hinges_of_the_locus_are_drawn() -> None:
    locus = locus_of("3rrr")
    axes = draw_locus(locus).axes[0]
    drawn = [np.stack(line.get_data(), axis=1) for line in axes.get_lines()]
    for curve in locus.curves:
        assert any(len(line) == len(curve.points) and np.allclose(line, curve.points[:, :2]) for line in drawn)
    hinges = np.array([[0.0, 0.0], [np.sqrt(3.0), 0.0], [np.sqrt(3.0) / 2, 1.5]])
    assert any(len(line) == 3 and np.allclose(line, hinges) for line in drawn)
    assert "+++" in axes.get_title()
    assert axes.get_xlabel() == "x [m]"
    assert axes.get_ylabel() == "y [m]"


def test_types_differ_in_line_style_and_not_in_colour_alone() -> None:
    styles = {line.get_label(): line.get_linestyle() for line in draw_locus(locus_of("3rrr")).axes[0].get_lines()}
    one = next(style for label, style in styles.items() if label.startswith("type I "))
    other = next(style for label, style in styles.items() if label.startswith("type II "))
    assert one != other


def test_a_motion_and_its_crossings_are_drawn_over_the_map() -> None:
    trajectory = reference.circle()
    crossings = find_crossings(zoo.robot_of("2rpr"), trajectory)
    drawn = draw_locus(locus_of("2rpr"), motion=trajectory.sample(0.01).x, crossings=crossings)
    lines = {line.get_label(): line.get_data() for line in drawn.axes[0].get_lines()}
    np.testing.assert_allclose(np.stack(lines["singular instant"], axis=1), [c.x for c in crossings])
    assert "motion" in lines


def test_a_single_coordinate_is_drawn_as_curves(tmp_path: Path) -> None:
    robot = zoo.robot_of("four_bar", ground_length=0.4, crank_length=0.3, coupler_length=0.35, rocker_length=0.2)
    locus = singular_locus(robot, resolution=40)
    axes = draw_locus(locus).axes[0]
    assert axes.get_xlabel() == "crank [rad]"
    verticals = [line.get_xdata()[0] for line in axes.get_lines() if str(line.get_label()).startswith("combined")]
    np.testing.assert_allclose(verticals, locus.points[:, 0])


def test_what_cannot_be_written_leaves_nothing(tmp_path: Path) -> None:
    locus = locus_of("2rpr")
    with pytest.raises(OutputError, match="Cannot write"):
        save(draw_locus(locus), tmp_path / "missing" / "locus.png")
    with pytest.raises(OutputError, match="picture format"):
        save(draw_locus(locus), tmp_path / "locus.txt")
    assert list(tmp_path.iterdir()) == []


def test_the_sketch_of_the_three_rrr_is_six_links_and_a_triangle() -> None:
    robot = zoo.robot_of("3rrr")
    lengths = sorted(float(np.linalg.norm(b - a)) for a, b in links(robot, robot.q_reference))
    assert lengths == pytest.approx([0.25 * np.sqrt(3.0)] * 3 + [1.0] * 6)
    assert len(base_hinges(robot)) == 3


def test_the_sketch_of_the_four_bar_is_its_moving_links() -> None:
    robot = zoo.robot_of("four_bar")
    lengths = sorted(float(np.linalg.norm(b - a)) for a, b in links(robot, robot.q_reference))
    assert lengths == pytest.approx(sorted([0.1, 0.35, 0.25]))
    np.testing.assert_allclose(np.ptp(base_hinges(robot), axis=0), [0.4, 0.0, 0.0], atol=1e-12)
