"""Marching squares: where a yes/no function on a grid changes, and how the places of change join into curves.

An edge joins two neighbouring nodes; it is given by its two node numbers. Only the topology is computed here: where on
its edge a change lies is for root finding to say.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from redundancy_pin.arrays import Array, BoolArray, IntArray


@dataclass(frozen=True, eq=False)
class Contour:
    """Edges over which a function changes, and the chains they form.

    Attributes:
        edges: (E, 2) node numbers of each edge.
        chains: edge numbers of each curve, in order along it; a closed curve ends with the edge it starts with.
    """

    edges: IntArray
    chains: tuple[IntArray, ...]


def contour(flags: BoolArray, usable: BoolArray) -> Contour:
    """Return the edges between true and false nodes and the curves through them.

    Args:
        flags: (A,) or (A, B) the function at the nodes.
        usable: same shape; edges with a node that is not usable are left out.
    """
    numbers = np.arange(flags.size).reshape(flags.shape)
    found = []
    for axis in range(flags.ndim):
        one, other = (np.take(numbers, range(s, flags.shape[axis] - 1 + s), axis=axis).ravel() for s in (0, 1))
        change = (flags.flat[one] != flags.flat[other]) & usable.flat[one] & usable.flat[other]
        found.append(np.stack([one[change], other[change]], axis=1))
    edges = np.concatenate(found)
    if flags.ndim == 1:
        return Contour(edges, tuple(np.array([k]) for k in range(len(edges))))
    return Contour(edges, _chains(edges, _links(edges, flags.shape, numbers), len(edges)))


def split(contour: Contour, keep: BoolArray) -> tuple[IntArray, ...]:
    """Return the chains without the edges that are not kept, cut where one is missing."""
    pieces: list[IntArray] = []
    for chain in contour.chains:
        good = keep[chain]
        bounds = np.flatnonzero(np.diff(np.concatenate([[0], good.astype(np.intp), [0]])))
        pieces += [chain[start:stop] for start, stop in zip(bounds[::2], bounds[1::2], strict=True)]
    return tuple(pieces)


def _links(edges: IntArray, shape: tuple[int, ...], numbers: IntArray) -> IntArray:
    """Return (L, 2) pairs of edges that a curve joins inside a cell."""
    key = {(int(a), int(b)): k for k, (a, b) in enumerate(edges)}
    corners = _touched_cells(edges, shape)
    pairs = []
    for i, j in corners:
        ring = [numbers[i, j], numbers[i + 1, j], numbers[i + 1, j + 1], numbers[i, j + 1]]
        sides = [(ring[0], ring[1]), (ring[1], ring[2]), (ring[3], ring[2]), (ring[0], ring[3])]
        here = [key[side] for side in ((int(a), int(b)) for a, b in sides) if side in key]
        if len(here) == 4:
            # a saddle: cut off the corners 0 and 2 (the other choice is as good)
            pairs += [(here[0], here[3]), (here[1], here[2])]
        elif len(here) == 2:
            pairs.append((here[0], here[1]))
    return np.array(pairs, dtype=np.intp).reshape(-1, 2)


def _touched_cells(edges: IntArray, shape: tuple[int, ...]) -> list[tuple[int, int]]:
    """Return the lower corners of the cells on either side of the edges."""
    row, column = np.unravel_index(edges[:, 0], shape)
    along_rows = edges[:, 1] - edges[:, 0] == shape[1]  # the edge goes to the next row
    cells = {(int(i), int(j)) for i, j in zip(row, column, strict=True)}
    cells |= {(int(i), int(j) - 1) for i, j in zip(row[along_rows], column[along_rows], strict=True)}
    cells |= {(int(i) - 1, int(j)) for i, j in zip(row[~along_rows], column[~along_rows], strict=True)}
    return sorted((i, j) for i, j in cells if 0 <= i < shape[0] - 1 and 0 <= j < shape[1] - 1)


def _chains(edges: IntArray, links: IntArray, count: int) -> tuple[IntArray, ...]:
    """Join pairs of edges into chains: open ones first from their ends, then the closed ones."""
    neighbours: list[list[int]] = [[] for _ in range(count)]
    for a, b in links.tolist():
        neighbours[a].append(b)
        neighbours[b].append(a)
    seen = np.zeros(count, dtype=bool)
    chains: list[IntArray] = []
    ends = [k for k in range(count) if len(neighbours[k]) < 2]
    for start in ends + list(range(count)):
        if seen[start]:
            continue
        chain, at = [start], start
        seen[start] = True
        while True:
            onward = [k for k in neighbours[at] if not seen[k]]
            if not onward:
                break
            at = onward[0]
            seen[at] = True
            chain.append(at)
        if len(chain) > 2 and start in neighbours[at]:
            chain.append(start)
        chains.append(np.array(chain, dtype=np.intp))
    return tuple(chains)


def edge_points(nodes: Array, edges: IntArray, fraction: Array) -> Array:
    """Return (E, n) the points that divide edges between nodes (G, n) at fractions (E,)."""
    start, end = nodes[edges[:, 0]], nodes[edges[:, 1]]
    result: Array = start + fraction[:, None] * (end - start)
    return result
