"""Pictures of feasibility maps: borders where they are, every kind of cell told apart without colour."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from redundancy_pin.status import ResultStatus
from redundancy_pin.studies.feasibility import (
    STEPWISE,
    WHOLE,
    Axis,
    Cell,
    FeasibilityMap,
    MapProblem,
    axis_label,
    draw,
    spaced,
    tiles,
    write_map,
)
from redundancy_pin.visualisation.figures.feasibility_map import Tile, border_of, plot_feasibility

pytest.importorskip("matplotlib")

OK, NOT_CONVERGED, INFEASIBLE, UNRESOLVED = (
    ResultStatus.OK,
    ResultStatus.NOT_CONVERGED,
    ResultStatus.INFEASIBLE,
    ResultStatus.UNRESOLVED,
)


def _drawn(*panels: Sequence[Tile], **changes: object) -> Figure:
    labels = {"x": "x", "y": "y", "value": "N", "marks": {"T": "track", "E": "effort"}, **changes}
    return plot_feasibility("t", dict(zip("pqrs", panels, strict=False)), **labels)  # type: ignore[arg-type]


def _lengths(segments: np.ndarray) -> float:
    return float(np.abs(segments[:, 1] - segments[:, 0]).sum())


# ----------------------------------------------------------------------------------------------------------- border


def test_the_border_runs_between_possible_and_infeasible() -> None:
    """A possible square in a corner of four: two sides of length one are border, the outer edges are not."""
    border = border_of([
        Tile(0, 1, 0, 1, OK, 1.0), Tile(1, 2, 0, 1, INFEASIBLE, mark="T"),
        Tile(0, 1, 1, 2, INFEASIBLE, mark="T"), Tile(1, 2, 1, 2, INFEASIBLE, mark="T"),
    ])  # fmt: skip
    assert {tuple(map(tuple, segment)) for segment in border.tolist()} == {((1, 0), (1, 1)), ((0, 1), (1, 1))}


def test_tiles_of_different_height_share_part_of_an_edge() -> None:
    border = border_of([
        Tile(0, 1, 0, 3, NOT_CONVERGED, 1.0),
        Tile(1, 2, 0, 1, OK, 1.0), Tile(1, 2, 1, 1.5, INFEASIBLE, mark="T"), Tile(1, 2, 1.5, 3, UNRESOLVED),
    ])  # fmt: skip
    # possible beside infeasible from 1 to 1.5, possible below infeasible over a width of 1; nothing at the failed one
    assert {tuple(map(tuple, segment)) for segment in border.tolist()} == {((1, 1), (1, 1.5)), ((1, 1), (2, 1))}


def test_where_all_is_alike_there_is_no_border() -> None:
    assert border_of([Tile(0, 1, 0, 1, OK, 1.0), Tile(1, 2, 0, 1, UNRESOLVED)]).shape == (
        0,
        2,
        2,
    )
    assert border_of([Tile(0, 1, 0, 1, INFEASIBLE, mark="T")]).shape == (0, 2, 2)


# ------------------------------------------------------------------------------------------------------------ tiles


def _map(along: str, extra: tuple[Cell, ...] = ()) -> FeasibilityMap:
    problem = MapProblem(
        "3rrr", spaced("speed", 0.1, 0.3, 3), Axis("stroke", (0.5, 1.0, 2.0)), "corner", planners=(STEPWISE, WHOLE)
    )
    cells = []
    for planner in problem.planners:
        for x in problem.x.values:
            for y in problem.y.values:
                good = x < 0.25 and y > 0.7
                verdict = OK if good else INFEASIBLE
                limits = () if good else ("track",) if y < 0.7 else ("fancy",)
                cells.append(Cell(planner, x, y, verdict, limits, peak_effort=x if good else None))
    return FeasibilityMap(problem, (*cells, *extra), along)  # type: ignore[arg-type]


@pytest.mark.parametrize("along", ["x", "y"])
def test_tiles_cover_the_map_without_overlap(along: str) -> None:
    """Refined lines have tiles of their own sizes; each cell lies inside its tile, and the areas add up."""
    extra = (
        Cell(WHOLE, 0.25, 1.0, INFEASIBLE, ("track",)),
        Cell(WHOLE, 0.225, 1.0, OK, peak_effort=1.0),
    )
    border_map = _map(along, extra if along == "x" else ())
    for planner in border_map.problem.planners:
        made = tiles(border_map, planner)
        cells = [cell for line in border_map.lines(planner).values() for cell in line]
        assert len(made) == len(cells)
        for tile, cell in zip(made, cells, strict=True):
            assert tile.x0 < cell.x < tile.x1
            assert tile.y0 < cell.y < tile.y1
        area = sum((tile.x1 - tile.x0) * (tile.y1 - tile.y0) for tile in made)
        assert area == pytest.approx((0.35 - 0.05) * (2.5 - 0.25))


def test_a_refined_border_lies_where_it_was_found() -> None:
    extra = (
        Cell(WHOLE, 0.25, 1.0, INFEASIBLE, ("track",)),
        Cell(WHOLE, 0.225, 1.0, OK, peak_effort=1.0),
    )
    segments = border_of(tiles(_map("x", extra), WHOLE))
    # along the line at a stroke of 1 m, between 0.225 and 0.25; the other lines keep the middle of the grid
    upright = {segment[0][0] for segment in segments.tolist() if segment[0][0] == segment[1][0]}
    assert sorted(upright) == pytest.approx([0.2375, 0.25])


@pytest.mark.parametrize(
    ("values", "edges"),
    [
        ((0.1, 0.5, 0.9), (0.0, 0.3, 0.7, 1.1)),  # half a step below 0.1 there is no stroke
        ((0.0, 0.4, 0.8), (0.0, 0.2, 0.6, 1.0)),
        ((0.5, 0.7), (0.4, 0.6, 0.8)),
        ((-0.5, 0.5), (-1.0, 0.0, 1.0)),  # an angle has values on both sides
        ((-0.9, -0.5, -0.1), (-1.1, -0.7, -0.3, 0.0)),
    ],
)
def test_tiles_do_not_reach_across_zero(values: tuple[float, ...], edges: tuple[float, ...]) -> None:
    assert Axis("stroke", values).edges(values) == pytest.approx(edges)


def test_edges_of_a_logarithmic_axis() -> None:
    assert Axis("stroke", (0.01, 0.1, 1.0), "log").edges([0.01, 0.1, 1.0]) == pytest.approx(
        [10**-2.5, 10**-1.5, 10**-0.5, 10**0.5]
    )


# ------------------------------------------------------------------------------------------------------------ picture


def _texts(panel: Sequence[Tile]) -> list[str]:
    return [text.get_text() for text in _drawn(panel).axes[0].texts]


def test_letters_tell_what_is_in_the_way_and_a_question_mark_what_is_not_known() -> None:
    panel = (
        Tile(0, 1, 0, 1, OK, 1.0), Tile(1, 2, 0, 1, INFEASIBLE, mark="T"),
        Tile(0, 1, 1, 2, INFEASIBLE, mark="E"), Tile(1, 2, 1, 2, UNRESOLVED),
    )  # fmt: skip
    assert sorted(_texts(panel)) == ["?", "E", "T"]


@pytest.mark.long
def test_the_legend_tells_only_what_there_is() -> None:
    one = (Tile(0, 1, 0, 1, OK, 1.0), Tile(1, 2, 0, 1, INFEASIBLE, mark="T"))
    two = (Tile(0, 1, 0, 1, NOT_CONVERGED, 1.0), Tile(1, 2, 0, 1, UNRESOLVED))

    def said(*panels: Sequence[Tile]) -> str:
        return " | ".join(text.get_text() for text in _drawn(*panels).legends[0].get_texts())

    good = (Tile(0, 1, 0, 1, OK, 1.0), Tile(1, 2, 0, 1, UNRESOLVED))
    assert said(good, good) == "? not known (numerical failure)"  # no border anywhere
    assert not _drawn(good[:1]).legends
    assert said(one) == "border | not possible; in the way: T track"
    assert "border, other panel" in said(one, two)
    assert "optimiser did not converge" in said(one, two)
    assert "not known (numerical failure)" in said(one, two)


def test_kinds_of_cells_differ_without_colour() -> None:
    """In grey: a possible cell is even, the others are patterned on white, each in its own way."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    kinds = (OK, NOT_CONVERGED, INFEASIBLE, UNRESOLVED)
    row = tuple(
        Tile(i, i + 1, 0, 1, kind, 1.0 if i < 2 else None, "T" if kind == INFEASIBLE else "")
        for i, kind in enumerate(kinds)
    )  # type: ignore[arg-type]
    drawn = _drawn(row)
    canvas = FigureCanvasAgg(drawn)
    canvas.draw()
    grey = np.asarray(canvas.buffer_rgba())[..., :3] @ [0.299, 0.587, 0.114] / 255.0
    pieces = []
    for tile in row:
        (x0, y0), (x1, y1) = drawn.axes[0].transData.transform([(tile.x0 + 0.1, 0.05), (tile.x1 - 0.1, 0.95)])
        pieces.append(grey[int(len(grey) - y1) : int(len(grey) - y0), int(x0) : int(x1)])
    means, spreads = [piece.mean() for piece in pieces], [piece.std() for piece in pieces]
    assert spreads[0] < 1e-6  # one even colour
    assert spreads[1] > 0.0  # the ring on it
    assert np.median(pieces[1]) == pytest.approx(np.median(pieces[0]))
    for i in (2, 3):
        assert np.median(pieces[i]) > 0.95  # a pattern on white
        assert spreads[i] > 0.02
    assert abs(means[2] - means[3]) > 0.005


@pytest.mark.long
def test_the_same_map_gives_the_same_files(tmp_path: Path) -> None:
    first = [path.read_bytes() for path in write_map(_map("x"), tmp_path / "one")]
    second = [path.read_bytes() for path in write_map(_map("x"), tmp_path / "two")]
    assert first == second
    assert first[3].startswith(b"\x89PNG")


def test_titles_and_axes_name_what_is_drawn() -> None:
    drawn = draw(_map("x"))
    left, right = drawn.axes[:2]
    assert (left.get_title(), right.get_title()) == ("stepwise: λ 0, 0.5, 1", "whole trajectory: least effort")
    assert left.get_xlabel() == "speed of the platform [m/s]"
    assert left.get_ylabel() == "stroke of the carriers [m]"
    assert drawn.axes[2].get_ylabel() == "peak main effort [N·m]"
    assert "X other (see the table)" in " ".join(text.get_text() for text in drawn.legends[0].get_texts())


def test_units_of_axes() -> None:
    for name, says in (
        ("max_effort", "limit: main efforts [N]"),
        ("max_speed", "limit: speed of the carriers [m/s]"),
        ("max_jerk", "limit: jerk of the carriers [m/s³]"),
        ("carrier_mass", "carrier mass [kg]"),
        ("ramp_time", "ramp time [s]"),
        ("radius", "radius [m]"),
        ("platform_inertia", "platform inertia [kg·m²]"),
    ):
        assert axis_label(name, "N") == says


def test_a_map_without_any_plan_can_be_drawn() -> None:
    _drawn((Tile(0, 1, 0, 1, INFEASIBLE, mark="T"), Tile(1, 2, 0, 1, UNRESOLVED)))
    _drawn((Tile(0.1, 1, 1, 2, OK, 0.0),), x_scale="log", y_scale="log")
