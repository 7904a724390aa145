"""Workspaces against closed forms: discs and rings of a five-bar's legs, leg lengths of a Gough platform."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
import zoo

import redundancy_pin as rp
from redundancy_pin.arrays import Array
from redundancy_pin.errors import InputError, UnsupportedRobotError
from redundancy_pin.kinematics.coordinates import with_independent_joints
from redundancy_pin.singularities.workspace import Workspace

BASE = 0.5  # m, between the hinges of the shipped five-bar
AROUND = [(-0.6, 1.1), (-1.0, 1.0)]


def nodes(space: Workspace) -> Array:
    return np.stack(np.meshgrid(*space.axes, indexing="ij"), axis=-1)


def reaches(x: Array) -> Array:
    """Return (..., 2) the distances from both base hinges."""
    return np.linalg.norm(x[..., None, :] - np.array([[0.0, 0.0], [BASE, 0.0]]), axis=-1)


@pytest.fixture(scope="module")
def five_bar() -> Workspace:
    """All working modes of the five-bar, whose first elbow may bend by at most 2.4 rad."""
    robot = rp.with_limits(zoo.robot_of("five_bar"), {"elbow_1": {"lower": -2.4, "upper": 2.4}})
    return rp.workspace(robot, bounds=AROUND, resolution=22, modes="all")


def test_five_bar_reaches_what_two_discs_share_in_every_mode(five_bar: Workspace) -> None:
    rho = reaches(nodes(five_bar))
    inside = (rho < 1.0).all(axis=-1)
    assert five_bar.modes == ((1, 1), (1, -1), (-1, 1), (-1, -1))
    assert (five_bar.reachable == inside).all()
    # two links of half a metre at an elbow angle e span 2 · 0.5 · cos(e / 2)
    bent = 2.0 * np.arccos(np.minimum(rho[..., 0], 1.0)) > 2.4
    assert (bent & inside).any()
    assert (five_bar.in_range == (inside & ~bent)).all()
    lens = 2.0 * np.arccos(BASE / 2.0) - BASE / 2.0 * np.sqrt(4.0 - BASE**2)
    narrow = (rho[..., 0] < np.cos(1.2)) & inside
    cell = float(np.prod([axis[1] - axis[0] for axis in five_bar.axes]))
    assert abs(five_bar.size + cell * narrow.sum() - lens) < 0.03 * lens


def test_margins_are_those_of_the_legs_directions(five_bar: Workspace) -> None:
    x, L = nodes(five_bar), five_bar.robot.characteristic_length
    rho = reaches(x)
    for mode, margin, reachable in zip(five_bar.modes, five_bar.margin, five_bar.reachable, strict=True):
        rows = []
        for i, sign in enumerate(mode):
            leg = x - np.array([[0.0, 0.0], [BASE, 0.0]])[i]
            half = np.arccos(np.minimum(rho[..., i], 1.0))
            proximal = np.arctan2(leg[..., 1], leg[..., 0]) + sign * half  # mode +1 bends the elbow clockwise
            distal = np.arctan2(leg[..., 1], leg[..., 0]) - sign * half
            along = np.stack([np.cos(distal), np.sin(distal)], axis=-1)
            # the distal link keeps its length: along · ẋ = along · (0.5 n) θ̇, n normal to the proximal link
            lever = 0.5 * (-np.sin(proximal) * along[..., 0] + np.cos(proximal) * along[..., 1])
            with np.errstate(divide="ignore"):  # out of reach, where legs count as stretched
                rows.append(L * along / lever[..., None])
        W = np.stack(rows, axis=-2)[reachable]
        least = np.linalg.svd(W, compute_uv=False)[:, -1]
        assert np.abs(np.abs(margin[reachable]) - least).max() < 1e-7  # arccos beside a stretched leg
    best = np.where(five_bar.in_range, np.abs(five_bar.margin), 0.0).max(axis=0)
    assert np.array_equal(np.nan_to_num(five_bar.best), best)


def add_legs(model: pin.Model, bases: Array, lengths: Array, far: Array, modes: Sequence[int]) -> dict[str, float]:
    """Add legs of two links, named crank_i and elbow_i with a frame tip_i, and return their angles.

    Each is drawn from its base hinge bases (legs, 2), with links of lengths (legs, 2), to a tip at far (legs, 2) from
    there, bent as its mode says.
    """
    guess = {}
    for leg, (base, (upper, lower), to, mode) in enumerate(zip(bases, lengths, far, modes, strict=True)):
        bend = mode * np.arccos((to @ to - upper**2 - lower**2) / (2.0 * upper * lower))
        turned = np.arctan2(to[1], to[0]) - np.arctan2(lower * np.sin(bend), upper + lower * np.cos(bend))
        guess |= {f"crank_{leg}": float(np.angle(np.exp(1j * turned))), f"elbow_{leg}": float(bend)}
        crank = zoo.add_body(model, 0, pin.JointModelRZ(), *base, f"crank_{leg}")
        elbow = zoo.add_body(model, crank, pin.JointModelRZ(), upper, 0.0, f"elbow_{leg}")
        model.addBodyFrame(f"tip_{leg}", elbow, pin.SE3(np.eye(3), np.array([lower, 0.0, 0.0])), 0)
    return guess


def test_the_default_grid_goes_on_where_a_horn_is_narrow() -> None:
    """Three rings share an area with a horn that is narrower than a cell of the coarse grid: it was cut by 20 mm."""
    bases, corners = [[0.73, -0.12], [-0.08, 0.61], [-0.33, -0.8]], [[0.23, -0.04], [-0.02, 0.15], [-0.09, -0.23]]
    lengths, modes = np.array([[0.39, 0.62], [0.57, 0.49], [0.31, 0.66]]), [1, 1, -1]
    model, angle, home = pin.Model(), -0.52, np.array([-0.07, -0.24])
    offsets = np.array(corners) @ np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]]) - bases
    guess = {"x": float(home[0]), "y": float(home[1]), "turn": angle}
    guess |= add_legs(model, bases, lengths, home + offsets, modes)
    hand = 0
    for name, joint in {"x": pin.JointModelPX(), "y": pin.JointModelPY(), "turn": pin.JointModelRZ()}.items():
        hand = zoo.add_body(model, hand, joint, 0.0, 0.0, name)
    for name, place in (("hand", [0.0, 0.0]), *((f"corner_{leg}", corners[leg]) for leg in range(3))):
        model.addBodyFrame(name, hand, pin.SE3(np.eye(3), np.array([*place, 0.0])), 0)
    model.lowerPositionLimit, model.upperPositionLimit = -100.0 * np.ones(9), 100.0 * np.ones(9)
    robot = rp.robot_from_model(
        model,
        closures=[(f"tip_{leg}", f"corner_{leg}", ["x", "y"]) for leg in range(3)],
        actuated=[f"crank_{leg}" for leg in range(3)],
        independent={"platform": "hand", "axes": ["x", "y", "rz"]},
        reference={"platform": [*home.tolist(), angle], "guess": guess},
        working_modes={"joints": [f"elbow_{leg}" for leg in range(3)], "signs": [1, 1, 1], "default": modes},
    )
    space = rp.workspace(robot, resolution=24)
    fine = np.stack(np.meshgrid(*2 * [np.linspace(-1.5, 1.5, 300)], indexing="ij"), axis=-1)
    rho = np.linalg.norm(fine[:, :, None] + offsets, axis=-1)
    inside = fine[((rho > np.abs(lengths[:, 0] - lengths[:, 1])) & (rho < lengths.sum(axis=1))).all(axis=-1)]
    for axis, least, most in zip(space.axes, inside.min(axis=0), inside.max(axis=0), strict=True):
        assert axis[0] < least
        assert most < axis[-1]


def test_strips_narrower_than_a_cell_are_reached_across_its_corners() -> None:
    """Two rings share a horn whose nodes hang on by a corner: it was missing in the map of this mode."""
    model, bases, modes = pin.Model(), np.array([[0.0, 0.0], [0.401, 0.0]]), [1, -1]
    lengths, start = np.array([[0.963, 0.433], [0.426, 0.545]]), np.array([-0.2, 0.75])
    guess = add_legs(model, bases, lengths, start - bases, modes)
    robot = rp.robot_from_model(
        model,
        closures=[("tip_0", "tip_1", ["x", "y"])],
        actuated=["crank_0", "crank_1"],
        independent={"platform": "tip_0", "axes": ["x", "y"]},
        reference={"platform": start.tolist(), "guess": guess},
        working_modes={"joints": ["elbow_0", "elbow_1"], "signs": [1, 1], "default": modes},
    )
    space = rp.workspace(robot, resolution=30)
    rho = np.linalg.norm(nodes(space)[:, :, None] - bases, axis=-1)
    least, most = np.abs(lengths[:, 0] - lengths[:, 1]), lengths.sum(axis=1)
    assert (space.reachable[0] == ((rho > least) & (rho < most)).all(axis=-1)).all()
    assert space.island.max() == 0  # the rings meet in one piece


def test_an_island_is_not_left_out_for_a_node_at_its_end() -> None:
    """Of a four-bar whose crank swings in two ranges, the far one was two nodes, at its ends, where branches meet."""
    crank, coupler, rocker, base, angle = 0.424, 0.569, 0.297, 0.618, -0.5707
    far = np.array([base, 0.0]) - crank * np.array([np.cos(angle), np.sin(angle)])
    length = np.linalg.norm(far)
    spread = np.arccos((length**2 + coupler**2 - rocker**2) / (2.0 * coupler * length))
    model = pin.Model()
    for name, parent, x in (("crank", 0, 0.0), ("knee", 1, crank), ("rocker", 0, base)):
        zoo.add_body(model, parent, pin.JointModelRZ(), x, 0.0, name)
    for name, joint, x in (("tip", 2, coupler), ("end", 3, rocker)):
        model.addBodyFrame(name, joint, pin.SE3(np.eye(3), np.array([x, 0.0, 0.0])), 0)
    for turn in (1.0, -1.0):
        heading = np.arctan2(far[1], far[0]) + turn * spread
        ends = coupler * np.array([np.cos(heading), np.sin(heading)]) - far
        robot = rp.robot_from_model(
            model,
            closures=[("tip", "end", ["x", "y"])],
            actuated=["crank"],
            reference=[angle, heading - angle, np.arctan2(ends[1], ends[0])],
        )
        space = rp.workspace(robot, resolution=150)
        apart = np.sqrt(crank**2 + base**2 - 2.0 * crank * base * np.cos(space.axes[0]))
        inside = (apart > coupler - rocker + 1e-2) & (apart < coupler + rocker - 1e-2)
        assert np.diff(inside.astype(int)).tolist().count(1) == 2
        assert space.reachable[0][inside].all()


@pytest.mark.long_for("False")
@pytest.mark.parametrize("modes", [True, False])
def test_a_part_that_is_not_connected_is_found(modes: bool) -> None:
    """Short distal links: each leg reaches a ring, and two rings share a part above and one below the base."""
    robot = zoo.robot_of("five_bar", distal_length=0.2)
    if not modes:
        robot = replace(robot, working_modes=None, working_mode=())
    space = rp.workspace(robot, resolution=20)
    rho = reaches(nodes(space))
    inside = ((rho > 0.3) & (rho < 0.7)).all(axis=-1)
    y = space.axes[1]
    assert inside[:, y > 0.2].any()
    assert inside[:, y < -0.2].any()
    assert not inside[:, np.abs(y) < 0.15].any()
    # beside a stretched leg continuity is lost, and nothing but it tells branches apart without modes
    clear = inside if modes else ((rho > 0.32) & (rho < 0.68)).all(axis=-1)
    assert space.reachable[0][clear].all()
    assert not space.reachable[0][~inside].any()
    above = np.broadcast_to(y > 0.0, inside.shape)
    assert (space.island[0] == np.where(space.reachable[0], np.where(above, 0, 1), -1)).all()  # the reference is above
    drawn = rp.plot.workspace(space)
    assert "not reached from the reference" in [text.get_text() for text in drawn.legends[0].get_texts()]
    [outline] = [one for one in drawn.axes[0].collections if one.get_linestyle()[0][1] is not None]
    assert (np.concatenate([path.vertices for path in outline.get_paths()])[:, 1] < 0.0).all()  # about the part below


@pytest.mark.parametrize("free", [("x", "z"), pytest.param(("x", "y", "z"), marks=pytest.mark.long)])
def test_gough_is_in_range_where_its_legs_are(free: tuple[str, ...]) -> None:
    robot = rp.with_limits(zoo.robot_of("gough"), {f"slide_{i}": {"lower": 0.5, "upper": 0.9} for i in range(1, 7)})
    bounds = [*[(-0.45, 0.45)] * (len(free) - 1), (0.2, 0.9)]
    space = rp.workspace(robot, free, bounds=bounds, resolution=8 if len(free) == 2 else 6)
    lengths = np.array([zoo.leg_lengths(robot, pose) for pose in space.x])
    within = ((lengths >= 0.5) & (lengths <= 0.9)).all(axis=1).reshape(space.in_range.shape[1:])
    assert within.any()
    assert (~within).any()
    assert (space.in_range[0] == within).all()
    assert np.array_equal(space.points, nodes(space)[within])
    if len(free) == 2:
        assert np.ptp(space.x[:, 1, 3]) == 0.0  # held at the reference


def test_figures_keep_out_of_reach_and_best_apart(five_bar: Workspace) -> None:
    from matplotlib import colormaps

    drawn = rp.plot.workspace(five_bar)
    panels = [axes for axes in drawn.axes if axes.get_title()]
    assert [axes.get_title()[-2:] for axes in panels] == ["++", "+-", "-+", "--"]
    for axes, in_range, margin in zip(panels, five_bar.in_range, five_bar.margin, strict=True):
        [image] = [one for one in axes.collections if np.shape(one.get_array()) == in_range.T.shape]
        assert (np.ma.getmaskarray(image.get_array()) == ~in_range.T).all()
        assert image.norm.vmax < np.nanmax(np.abs(margin[in_range])) * 1.01
    shares = np.mean(np.abs(five_bar.margin[five_bar.in_range]) > image.norm.vmax)
    assert 0.03 < shares < 0.07  # a bright spot is cut, not the others darkened
    assert {text.get_text() for text in drawn.legends[0].get_texts()} == {"out of reach", "a joint beyond its limits"}
    best = np.array(colormaps[image.get_cmap().name](1.0)[:3])
    assert np.linalg.norm(best - 1.0) > 0.5  # not white


def test_islands_are_marked_in_clouds_and_on_lines() -> None:
    cloud = rp.workspace("gough", bounds=[(-0.1, 0.1), (-0.1, 0.1), (0.3, 0.5)], resolution=3)
    island = np.array(cloud.island)
    island[..., 2] = 1  # above
    drawn = rp.plot.workspace(replace(cloud, island=island))
    points = drawn.axes[0].collections[-1]
    ringed = np.array(points.get_linewidths()) > 0.0
    assert sorted(ringed) == sorted((island > 0)[cloud.in_range])
    order = np.argsort(points.get_offsets()[:, 1])
    assert ringed[order[-6:]].all()
    assert not ringed[order[:6]].any()
    assert "not reached from the reference" in [text.get_text() for text in drawn.legends[0].get_texts()]
    assert not any(
        text.get_text() == "not reached from the reference"
        for legend in rp.plot.workspace(cloud).legends
        for text in legend.get_texts()
    )
    line = rp.workspace("five_bar", "x", resolution=5)
    island = np.where(np.arange(5) < 3, line.island, 1)
    start, other = (each.get_ydata() for each in rp.plot.workspace(replace(line, island=island)).axes[0].lines)
    assert not (np.isfinite(start) & np.isfinite(other)).any()
    assert np.array_equal(np.isfinite(other), line.in_range[0] & (np.arange(5) >= 3))


def test_of_a_robot_without_platform_one_or_two_joints_span_a_workspace() -> None:
    shipped = zoo.robot_of("five_bar")
    robot = with_independent_joints(shipped, shipped.actuated)
    space = rp.workspace(robot, resolution=13)
    middle = [shipped.q_reference[zoo.index(shipped, name)] for name in shipped.actuated]
    for axis, at in zip(space.axes, middle, strict=True):
        assert np.abs(axis[[0, -1]] - [at - np.pi, at + np.pi]).max() < 1e-12
    u = nodes(space)
    ends = 0.5 * np.stack([np.cos(u), np.sin(u)], axis=-1) + np.array([[0.0, 0.0], [BASE, 0.0]])
    apart = np.linalg.norm(ends[..., 1, :] - ends[..., 0, :], axis=-1)
    assert not space.reachable[0][apart > 1.0].any()  # links of half a metre do not meet
    assert space.reachable[0][apart < 1.0].mean() > 0.8
    one = rp.workspace(robot, [shipped.actuated[1]], resolution=9)
    assert np.abs(one.axes[0][4] - middle[1]) < 1e-12


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"free": ("x", "q")}, "free is"),
        ({"free": 3}, "Names of coordinates"),
        ({"modes": [(1, 2)]}, "no working mode"),
        ({"modes": "each"}, "modes is"),
        ({"modes": []}, "modes is"),
        ({"modes": [["a", "b"]]}, "modes is"),
        ({"modes": 3}, "modes is"),
        ({"bounds": [(1, -1), (0, 1)]}, "bounds are"),
        ({"bounds": [(np.nan, 1), (0, 1)]}, "bounds"),
        ({"bounds": [(0, 0), (0, 1)]}, "bounds are"),
        ({"bounds": [(0,), (1,)]}, "bounds"),
        ({"bounds": "ab"}, "bounds"),
        ({"bounds": [(-1e300, 1e300), (0, 1)]}, "bounds"),
        ({"bounds": [(-1e12, 1e12), (0, 1)]}, "bounds are"),
        ({"resolution": "x"}, "resolution is"),
        ({"resolution": 4.5}, "resolution is"),
        ({"resolution": 2}, "from 3 to 447"),
        ({"resolution": 10**400}, "from 3 to 447"),
    ],
)
def test_slices_of_no_sense_are_refused(given: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        rp.workspace("five_bar", **{"resolution": 5, **given})
    with pytest.raises(UnsupportedRobotError, match="has no picture"):
        rp.workspace("3rrr", ())


def test_a_grid_that_is_all_in_range_is_as_large_as_its_bounds_and_prints_in_a_line() -> None:
    """The crank of a Grashof four-bar turns right round: 2π rad, not a step more; a block of a Gough platform's."""
    crank = rp.workspace("four_bar", resolution=30)
    assert crank.in_range.all()
    assert crank.size == pytest.approx(np.ptp(crank.axes[0]), rel=1e-12)
    block = rp.workspace("gough", bounds=[(-0.02, 0.02), (-0.01, 0.03), (0.5, 0.53)], resolution=4)
    assert block.in_range.all()
    assert block.size == pytest.approx(0.04 * 0.04 * 0.03, rel=1e-12)
    assert repr(block).startswith("Workspace('gough'; x=-0.02..0.02 m, ")
    assert len(repr(block)) < 200
