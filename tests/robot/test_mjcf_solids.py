"""Masses and orientations of MJCF without MuJoCo: solids by integration over slices, rotations by scipy."""

from __future__ import annotations

import numpy as np
import pytest
from mjcf_models import write
from scipy.spatial.transform import Rotation

from redundancy_pin.errors import ModelFileError
from redundancy_pin.robot.formats.mjcf import read_mjcf

MODEL = """<mujoco><compiler {compiler}/><worldbody><body name="body"><joint name="turn" axis="0 0 1"/>
{content}</body></worldbody><actuator><motor joint="turn"/></actuator></mujoco>"""


def body(tmp_path, content, compiler=""):
    link = read_mjcf(write(tmp_path, MODEL.format(content=content, compiler=compiler))).links["body"]
    return link.mass, link.centre, link.inertia


def solid(kind, size):
    """Volume and moments about the centre of a solid of density one, by slices across z: Gauss's points are exact."""
    a, b, c = (*size, 0.0, 0.0)[:3]
    pieces = {"sphere": [(-a, a)], "cylinder": [(-b, b)], "capsule": [(-a - b, -b), (-b, b), (b, b + a)]}
    volume, moments = 0.0, np.zeros(3)
    for low, high in pieces.get(kind, [(-c, c)]):
        nodes, weights = np.polynomial.legendre.leggauss(6)
        z, weights = 0.5 * (low + high) + 0.5 * (high - low) * nodes, 0.5 * (high - low) * weights
        beyond = np.maximum(np.abs(z) - (b if kind == "capsule" else 0.0), 0.0)
        ratio = z / c if kind == "ellipsoid" else beyond / a if kind in ("sphere", "capsule") else 0.0 * z
        shrunk = 1.0 - ratio**2
        # half axes of the slice, squared: a rectangle or an ellipse
        p, q = a**2 * shrunk, (b if kind in ("box", "ellipsoid") else a) ** 2 * shrunk
        area = (4.0 if kind == "box" else np.pi) * np.sqrt(p * q)
        share = 3.0 if kind == "box" else 4.0
        volume += weights @ area
        moments += [weights @ (area * m) for m in (q / share + z**2, p / share + z**2, (p + q) / share)]
    return volume, moments


SIZES = {"sphere": [0.2], "cylinder": [0.1, 0.3], "capsule": [0.15, 0.2], "box": [0.1, 0.2, 0.35],
         "ellipsoid": [0.1, 0.25, 0.3]}  # fmt: skip


@pytest.mark.parametrize("kind", SIZES)
def test_masses_of_solids_are_their_integrals(kind, tmp_path):
    """Of a given density and of a given mass, turned and shifted in a frame that is turned and shifted itself."""
    volume, moments = solid(kind, SIZES[kind])
    inner, outer = Rotation.from_euler("XYZ", [10, 20, 30], degrees=True), Rotation.from_rotvec([0.0, 0.0, np.pi / 2])
    turn, place = (outer * inner).as_matrix(), np.array([0.5, 0.0, 0.0]) + outer.apply([0.1, 0.2, 0.3])
    size = " ".join(map(str, SIZES[kind]))
    for given, mass in (("", 1000.0 * volume), ('density="700"', 700.0 * volume), ('mass="2.5"', 2.5)):
        geom = f'<geom type="{kind}" size="{size}" pos="0.1 0.2 0.3" euler="10 20 30" {given}/>'
        found = body(tmp_path, f'<frame pos="0.5 0 0" axisangle="0 0 2 90">{geom}</frame>')
        np.testing.assert_allclose(found[0], mass, rtol=1e-12)
        np.testing.assert_allclose(found[1], place, atol=1e-12)
        np.testing.assert_allclose(found[2], turn @ np.diag(mass / volume * moments) @ turn.T, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("kind", ["capsule", "cylinder", "box", "ellipsoid"])
def test_solids_from_end_to_end_have_its_middle_and_its_length(kind, tmp_path):
    ends = np.array([0.1, 0.2, 0.3]), np.array([0.3, -0.2, 0.5])
    half = 0.5 * np.linalg.norm(ends[1] - ends[0])
    volume, moments = solid(kind, [0.05, half] if kind in ("capsule", "cylinder") else [0.05, 0.05, half])
    text = " ".join(map(str, np.concatenate(ends)))
    mass, centre, inertia = body(tmp_path, f'<geom type="{kind}" fromto="{text}" size="0.05" density="500"/>')
    along = (ends[1] - ends[0]) / (2.0 * half)
    np.testing.assert_allclose(mass, 500.0 * volume, rtol=1e-12)
    np.testing.assert_allclose(centre, 0.5 * (ends[0] + ends[1]), atol=1e-12)
    # both other moments are one but of a rectangle, which here is a square
    expected = 500.0 * (moments[0] * np.eye(3) + (moments[2] - moments[0]) * np.outer(along, along))
    np.testing.assert_allclose(inertia, expected, atol=1e-12)


def test_several_solids_count_together_and_an_inertial_counts_alone(tmp_path):
    """By Steiner, of points: a heavy body of two balls, of which those of other groups are none."""
    balls = '<geom size="0.1" mass="2" pos="0.3 0 0"/><geom size="0.2" mass="3" pos="0 0.4 0"/>'
    mass, centre, inertia = body(tmp_path, balls)
    points, masses = np.array([[0.3, 0.0, 0.0], [0.0, 0.4, 0.0]]), np.array([2.0, 3.0])
    middle = masses @ points / 5.0
    away = points - middle
    expected = sum(m * (d @ d * np.eye(3) - np.outer(d, d)) for m, d in zip(masses, away, strict=True))
    np.testing.assert_allclose(inertia, expected + 0.4 * (2.0 * 0.1**2 + 3.0 * 0.2**2) * np.eye(3), atol=1e-12)
    np.testing.assert_allclose([mass, *centre], [5.0, *middle], atol=1e-12)
    assert body(tmp_path, balls.replace('mass="3"', 'mass="3" group="4"'), 'inertiagrouprange="0 3"')[0] == 2.0
    inertial = '<inertial pos="0.1 0 0" mass="0.5" diaginertia="0.01 0.02 0.025" quat="0 0 1 1"/>'
    mass, centre, inertia = body(tmp_path, inertial + balls)
    turn = Rotation.from_quat([0.0, 1.0, 1.0, 0.0]).as_matrix()
    np.testing.assert_allclose([mass, *centre], [0.5, 0.1, 0.0, 0.0])
    np.testing.assert_allclose(inertia, turn @ np.diag([0.01, 0.02, 0.025]) @ turn.T, atol=1e-15)
    assert body(tmp_path, inertial + balls, 'inertiafromgeom="true"')[0] == 5.0
    assert body(tmp_path, balls, 'inertiafromgeom="false"')[0] == 0.0
    full = '<inertial pos="0 0 0" mass="0.7" fullinertia="0.01 0.02 0.015 0.001 0.004 -0.002"/>'
    expected = [[0.01, 0.001, 0.004], [0.001, 0.02, -0.002], [0.004, -0.002, 0.015]]
    np.testing.assert_allclose(body(tmp_path, full)[2], expected)


@pytest.mark.parametrize(
    ("moments", "right"),
    [
        ("0.01 0.02 0.03", True),  # a flat body
        ("0.01 0.02 0.0301", False),
        ("0.0301 0.02 0.01", False),
        ("-0.001 0.02 0.02", False),
        ("0 0 0", True),
        ("0 0.02 0.02", True),  # a rod
    ],
)
def test_moments_of_an_inertial_are_those_of_a_body(moments, right, tmp_path):
    text = f'<inertial pos="0 0 0" mass="0.5" diaginertia="{moments}"/>'
    if right:
        np.testing.assert_allclose(np.diag(body(tmp_path, text)[2]), [float(part) for part in moments.split()])
    else:
        with pytest.raises(ModelFileError, match="which no body has"):
            body(tmp_path, text)


ORIENTATIONS = [
    ("", 'quat="0.9 0.1 -0.2 0.3"', Rotation.from_quat([0.1, -0.2, 0.3, 0.9])),
    ("", 'axisangle="1 -2 3 40"', Rotation.from_rotvec(np.radians(40) * np.array([1, -2, 3]) / np.sqrt(14))),
    ('angle="radian"', 'axisangle="1 -2 3 0.7"', Rotation.from_rotvec(0.7 * np.array([1, -2, 3]) / np.sqrt(14))),
    ("", 'euler="10 -20 30"', Rotation.from_euler("XYZ", [10, -20, 30], degrees=True)),
    ('eulerseq="zyx"', 'euler="10 -20 30"', Rotation.from_euler("ZYX", [10, -20, 30], degrees=True)),
    ('eulerseq="XYZ"', 'euler="10 -20 30"', Rotation.from_euler("xyz", [10, -20, 30], degrees=True)),
    ("", 'zaxis="1 -2 3"', Rotation.from_rotvec(np.arccos(3 / np.sqrt(14)) * np.array([2, 1, 0]) / np.sqrt(5))),
    ("", 'zaxis="0 0 -1"', Rotation.from_rotvec([np.pi, 0, 0])),
    ("", 'zaxis="0 0 2"', Rotation.identity()),
    ("", 'zaxis="0 1 -1"', Rotation.from_rotvec([-0.75 * np.pi, 0, 0])),
]


@pytest.mark.parametrize(("compiler", "text", "expected"), ORIENTATIONS, ids=[text for _, text, _ in ORIENTATIONS])
def test_orientations_are_those_of_scipy(compiler, text, expected, tmp_path):
    geom = f'<geom type="box" size="0.1 0.2 0.35" {text}/>'
    volume, moments = solid("box", [0.1, 0.2, 0.35])
    turn = expected.as_matrix()
    np.testing.assert_allclose(body(tmp_path, geom, compiler)[2], 1000.0 * turn @ np.diag(moments) @ turn.T, atol=1e-9)
    # a box looks the same from two sides: the point beside it does not
    beside = f'<frame {text}><geom size="0.1" mass="1" pos="1 2 4"/></frame>'
    np.testing.assert_allclose(body(tmp_path, beside, compiler)[1], expected.apply([1.0, 2.0, 4.0]), atol=1e-12)
    assert volume > 0.0


def test_two_axes_make_three(tmp_path):
    """The second is what of it is across the first."""
    x, y = np.array([1.0, 2.0, -2.0]) / 3.0, np.array([0.5, 1.0, 1.0])
    y -= (x @ y) * x
    y /= np.linalg.norm(y)
    turn = np.column_stack([x, y, np.cross(x, y)])
    found = body(tmp_path, '<frame xyaxes="1 2 -2 0.5 1 1"><geom size="0.1" mass="1" pos="1 2 4"/></frame>')
    np.testing.assert_allclose(found[1], turn @ [1.0, 2.0, 4.0], atol=1e-12)


def test_a_site_with_the_name_of_a_body_gets_another(tmp_path):
    content = """<geom size="0.1"/><site name="body" pos="0 0 1"/><site name="tip"/><body name="tip"><geom size="0.1"/>
    <joint name="second" axis="0 0 1"/></body>"""
    links = read_mjcf(write(tmp_path, MODEL.format(content=content, compiler=""))).links
    assert {"body", "site:body", "tip", "site:tip"} <= set(links) or {"body", "site:body", "tip", "body:tip"} <= set(
        links
    )
    nested = '<lengthrange mode="none"/>'
    text = MODEL.format(content='<geom size="0.1"/>', compiler="").replace(
        "/><worldbody>", f">{nested}</compiler><worldbody>"
    )
    assert read_mjcf(write(tmp_path, text)).links["body"].mass > 0.0
    with pytest.raises(ModelFileError, match="<flag> is not covered"):
        read_mjcf(write(tmp_path, text.replace(nested, "<flag/>")))


NO_BODY = {
    "negative mass": ('<geom size="0.1" mass="-1"/>', "the mass -1"),
    "no radius": ('<geom size="0" mass="1"/>', "a sphere with the size"),
    "negative radius": ('<geom type="capsule" size="-0.1 0.2"/>', "a capsule with the size"),
    "no length": ('<geom type="cylinder" size="0.1"/>', "a cylinder with the size"),
    "two edges": ('<geom type="ellipsoid" size="0.1 0.2"/>', "a ellipsoid with the size"),
    "ends that are one": ('<geom type="capsule" size="0.1" fromto="1 2 3 1 2 3"/>', "a fromto of length zero"),
    "negative inertial": ('<inertial pos="0 0 0" mass="-0.5"/>', "which no body has"),
    "shell": ('<geom size="0.1" shellinertia="true"/>', "shellinertia"),
}


@pytest.mark.parametrize("case", NO_BODY)
def test_solids_that_are_none_are_refused(case, tmp_path):
    text, message = NO_BODY[case]
    with pytest.raises(ModelFileError, match=message):
        body(tmp_path, text)


@pytest.mark.parametrize(
    ("geom", "mass"),
    [
        ('type="plane" size="1 1 1"', 0.0),
        ('type="plane" size="1 1 1" mass="2"', 0.0),
        ('size="0.1" density="0"', 0.0),
        ('size="0.1" mass="0"', 0.0),
        # of no mass, whatever its density
        ('size="0.1" mass="0" density="500"', 0.0),
        ('size="0.1" mass="3" density="0"', 3.0),
        ('type="mesh" mesh="shell" mass="0"', 0.0),
        ('size="0.1" mass="3" shellinertia="false"', 3.0),
    ],
)
def test_solids_may_have_no_mass(geom, mass, tmp_path):
    ball = '<geom size="0.2" mass="1.5" pos="1 0 0"/>'
    found = body(tmp_path, f"<geom {geom}/>{ball}")
    assert found[0] == 1.5 + mass
    np.testing.assert_allclose(found[1], [1.5 / (1.5 + mass), 0.0, 0.0])


@pytest.mark.parametrize(("group", "counts"), [(0, False), (1, True), (2, True), (3, True), (4, False)])
def test_groups_of_solids_count_from_the_first_to_the_last(group, counts, tmp_path):
    geom = f'<geom size="0.1" mass="2" group="{group}"/>'
    assert body(tmp_path, geom, 'inertiagrouprange="1 3"')[0] == (2.0 if counts else 0.0)
