"""Curves over grid edges on shapes whose border is known."""

from __future__ import annotations

import numpy as np

from redundancy_pin.singularities.locus import crossed_edges


def grid(size: int = 41):
    axis = np.linspace(-1.0, 1.0, size)
    return np.meshgrid(axis, axis, indexing="ij")


def test_a_disc_has_one_closed_curve_and_every_edge_crosses_its_border() -> None:
    x, y = grid()
    inside = x**2 + y**2 < 0.6**2
    (curve,) = crossed_edges(inside, np.ones_like(inside))
    assert (curve[0] == curve[-1]).all()
    assert len(np.unique(curve, axis=0)) == len(curve) - 1
    assert ((np.hypot(x, y).ravel()[curve] < 0.6).sum(axis=1) == 1).all()
    rows, columns = np.unravel_index(curve, x.shape)
    assert (np.abs(np.diff(rows, axis=1)) + np.abs(np.diff(columns, axis=1)) == 1).all()
    # consecutive edges share a cell: their middles are no further apart than its diagonal
    middles = np.stack([x.ravel()[curve].mean(axis=1), y.ravel()[curve].mean(axis=1)], axis=1)
    assert np.linalg.norm(np.diff(middles, axis=0), axis=1).max() <= 0.05 * np.sqrt(2.0) + 1e-12


def test_no_change_is_left_out() -> None:
    x, y = grid()
    inside = x**2 + y**2 < 0.6**2
    changes = (inside[1:] != inside[:-1]).sum() + (inside[:, 1:] != inside[:, :-1]).sum()
    (curve,) = crossed_edges(inside, np.ones_like(inside))
    assert len(curve) == changes + 1


def test_a_half_plane_has_one_open_curve_from_border_to_border() -> None:
    x, y = grid()
    (curve,) = crossed_edges(x + 0.3 * y < 0.111, np.ones_like(x, dtype=bool))
    _, columns = np.unravel_index(curve[[0, -1]], x.shape)
    assert {int(columns.min()), int(columns.max())} == {0, 40}


def test_two_discs_have_two_curves() -> None:
    x, y = grid()
    inside = ((x - 0.5) ** 2 + y**2 < 0.3**2) | ((x + 0.5) ** 2 + y**2 < 0.3**2)
    assert len(crossed_edges(inside, np.ones_like(inside))) == 2


def test_unusable_nodes_cut_a_curve_and_take_no_part() -> None:
    x, y = grid()
    inside = x**2 + y**2 < 0.6**2
    usable = x + y > 0.0  # the border runs over the diagonals of cells
    (curve,) = crossed_edges(inside, usable)
    assert (curve[0] != curve[-1]).any()
    assert usable.ravel()[curve].all()
    change = [
        (inside[1:] != inside[:-1]) & usable[1:] & usable[:-1],
        (inside[:, 1:] != inside[:, :-1]) & usable[:, 1:] & usable[:, :-1],
    ]
    assert len(curve) == sum(int(part.sum()) for part in change)


def test_a_saddle_keeps_all_four_edges() -> None:
    flags = np.array([[True, False], [False, True]])
    curves = crossed_edges(flags, np.ones_like(flags))
    assert sorted(len(curve) for curve in curves) == [2, 2]
    assert len(np.unique(np.concatenate(curves), axis=0)) == 4


def test_a_line_of_nodes_has_points_for_curves() -> None:
    flags = np.array([True, True, False, True])
    assert [curve.tolist() for curve in crossed_edges(flags, np.ones_like(flags))] == [[[1, 2]], [[2, 3]]]
