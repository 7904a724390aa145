"""Marching squares on shapes whose border is known."""

from __future__ import annotations

import numpy as np

from redundancy_pin.singularities.locus import contour, edge_points, split


def grid(size: int = 41):
    axis = np.linspace(-1.0, 1.0, size)
    return np.meshgrid(axis, axis, indexing="ij")


def test_a_disc_has_one_closed_curve_and_every_edge_crosses_its_border() -> None:
    x, y = grid()
    inside = x**2 + y**2 < 0.6**2
    found = contour(inside, np.ones_like(inside))
    assert len(found.chains) == 1
    (chain,) = found.chains
    assert chain[0] == chain[-1]
    assert len(chain) == len(found.edges) + 1
    radius = np.hypot(x, y).ravel()[found.edges]
    assert ((radius < 0.6).sum(axis=1) == 1).all()
    # consecutive edges share a cell: their middles are no further apart than its diagonal
    nodes = np.stack([x.ravel(), y.ravel()], axis=1)
    middles = edge_points(nodes, found.edges, np.full(len(found.edges), 0.5))[chain]
    assert np.linalg.norm(np.diff(middles, axis=0), axis=1).max() <= 0.05 * np.sqrt(2.0) + 1e-12


def test_a_half_plane_has_one_open_curve_from_border_to_border() -> None:
    x, y = grid()
    found = contour(x + 0.3 * y < 0.111, np.ones_like(x, dtype=bool))
    assert len(found.chains) == 1
    ends = found.edges[found.chains[0][[0, -1]]]
    _, columns = np.unravel_index(ends, x.shape)
    assert {int(columns.min()), int(columns.max())} == {0, 40}


def test_two_discs_have_two_curves() -> None:
    x, y = grid()
    inside = ((x - 0.5) ** 2 + y**2 < 0.3**2) | ((x + 0.5) ** 2 + y**2 < 0.3**2)
    assert len(contour(inside, np.ones_like(inside)).chains) == 2


def test_unusable_nodes_cut_a_curve() -> None:
    x, y = grid()
    inside = x**2 + y**2 < 0.6**2
    found = contour(inside, y > 0.0)
    assert len(found.chains) == 1
    assert found.chains[0][0] != found.chains[0][-1]


def test_dropped_edges_cut_a_curve() -> None:
    x, y = grid()
    inside = x**2 + y**2 < 0.6**2
    found = contour(inside, np.ones_like(inside))
    keep = np.ones(len(found.edges), dtype=bool)
    keep[found.chains[0][10]] = False
    pieces = split(found, keep)
    assert sum(len(piece) for piece in pieces) == len(found.chains[0]) - 1
    assert len(pieces) == 2


def test_a_saddle_keeps_all_four_edges() -> None:
    flags = np.array([[True, False], [False, True]])
    found = contour(flags, np.ones_like(flags))
    assert len(found.edges) == 4
    assert sorted(len(chain) for chain in found.chains) == [2, 2]


def test_a_line_of_nodes_has_points_for_curves() -> None:
    flags = np.array([True, True, False, True])
    found = contour(flags, np.ones_like(flags))
    assert found.edges.tolist() == [[1, 2], [2, 3]]
    assert [chain.tolist() for chain in found.chains] == [[0], [1]]
