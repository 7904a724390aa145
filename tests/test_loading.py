"""Loading a robot of one's own: what is accepted, and one clear error for everything that is not."""

import shutil

import numpy as np
import pytest
import yaml

import redundancy_pin as rp
from redundancy_pin.errors import DeclarationError, InputError, ModelFileError
from redundancy_pin.kinematics.coordinates import gravity_acts
from redundancy_pin.robot.urdf import models_root

URDF = """<?xml version="1.0"?>
<robot name="bar">
  <link name="base"/>
  {links}
</robot>
"""


def body(name, parent, joint, kind="revolute", origin="0 0 0", axis="0 0 1", mass=1.0):
    return f"""
  <link name="{name}"><inertial><origin xyz="0.25 0 0"/><mass value="{mass}"/>
    <inertia ixx="0" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="{joint}" type="{kind}"><parent link="{parent}"/><child link="{name}"/>
    <origin xyz="{origin}"/><axis xyz="{axis}"/><limit lower="-9" upper="9" velocity="9" effort="9"/></joint>"""


FIVE_BAR = URDF.format(
    links=body("l1", "base", "a1")
    + body("l2", "l1", "b1", origin="0.5 0 0")
    + body("tip1", "l2", "m1", kind="fixed", origin="0.5 0 0", mass=0.1)
    + body("r1", "base", "a2", origin="0.5 0 0")
    + body("r2", "r1", "b2", origin="0.5 0 0")
    + body("tip2", "r2", "m2", kind="fixed", origin="0.5 0 0", mass=0.1)
    + body("bob", "l2", "slider", kind="prismatic", axis="1 0 0", mass=0.5)
)
DECLARATION = {
    "name": "my_five_bar",
    "urdf": "bar.urdf",
    "closures": [{"frames": ["tip1", "tip2"], "axes": ["x", "y"]}],
    "actuated": ["a1", "a2"],
    "carriers": [{"joint": "slider", "position": [-0.2, 0.4], "acceleration": 5.0}],
    "independent": {"platform": "tip1", "axes": ["x", "y"]},
    "reference": {"platform": [0.25, 0.7], "guess": {"a1": 2.0, "b1": -1.0, "a2": 1.0, "b2": 1.0}},
}


def write(folder, tree=FIVE_BAR, **changes):
    data = {**DECLARATION, **changes}
    (folder / "bar.urdf").write_text(tree)
    (folder / "robot.yaml").write_text(yaml.safe_dump({k: v for k, v in data.items() if v is not None}))
    return folder / "robot.yaml"


def test_gravity_and_folder_and_default_mode(tmp_path):
    write(tmp_path)
    robot = rp.load_robot(tmp_path, gravity=(0.0, -9.81, 0.0))
    np.testing.assert_array_equal(robot.gravity, [0.0, -9.81, 0.0])
    assert robot.working_mode == ()
    assert rp.load_robot("3rrr").working_mode == (1, 1, 1)
    assert rp.load_robot("3rrr", working_mode=(1, -1, 1)).working_mode == (1, -1, 1)


def test_file_and_line_of_a_bad_declaration_are_named(tmp_path):
    path = write(tmp_path)
    lines = path.read_text().splitlines()
    number = next(i for i, line in enumerate(lines) if line.startswith("actuated")) + 1
    path.write_text("\n".join(lines).replace("actuated:", "actuated: 3\ncarriers_:"))
    with pytest.raises(DeclarationError, match=rf"robot\.yaml, line {number + 1}: Unknown key `carriers_`"):
        rp.load_robot(path)
    path.write_text("\n".join(lines).replace("actuated:", "gravity: [0, 0, down]\nactuated:"))
    with pytest.raises(DeclarationError, match=rf"robot\.yaml, line {number}: .*`gravity\[2\]` is 'down'"):
        rp.load_robot(path)
    path.write_text("\n".join([*lines, "actuated: [m1]"]))
    with pytest.raises(ModelFileError, match=rf"line {len(lines) + 1}.*'actuated' was given in line {number}"):
        rp.load_robot(path)


@pytest.mark.parametrize("source", ["x" * 300, "x" * 300 + "/robot.yaml", "nul\x00", "/dev/zero", "~nobody/robot.yaml"])
def test_names_that_no_file_can_have(source):
    with pytest.raises(ModelFileError):
        rp.load_robot(source)


def test_files_that_are_missing_or_broken(tmp_path):
    with pytest.raises(ModelFileError, match="does not exist"):
        rp.load_robot(_without_urdf(tmp_path))
    path = write(tmp_path)
    path.write_text("closures: [}")
    with pytest.raises(ModelFileError, match="not readable YAML"):
        rp.load_robot(path)
    path.write_text("- 1\n- 2\n")
    with pytest.raises(DeclarationError, match="holds no mapping"):
        rp.load_robot(path)
    path = write(tmp_path, tree=FIVE_BAR.replace("</robot>", ""))
    with pytest.raises(ModelFileError, match="not well-formed XML"):
        rp.load_robot(path)
    path = write(tmp_path, tree=FIVE_BAR.replace('<parent link="l1"/>', '<parent link="nowhere"/>'))
    with pytest.raises(
        ModelFileError, match=r"'b1' of bar\.urdf has the parent 'nowhere', which is no link \(line 11\)"
    ):
        rp.load_robot(path)


def _without_urdf(folder):
    path = write(folder)
    (folder / "bar.urdf").unlink()
    return path


def test_arguments_that_make_no_machine():
    with pytest.raises(InputError, match="base_radius > 0 does not hold"):
        rp.load_robot("3rrr", base_radius=0.0)
    with pytest.raises(InputError, match="carrier_mass >= 0 does not hold"):
        rp.load_robot("2rpr", carrier_mass=-1.0)
    with pytest.raises(InputError, match=r"no argument 'carier_mass'\. Did you mean 'carrier_mass'"):
        rp.load_robot("3rrr", carier_mass=2.0)
    with pytest.raises(DeclarationError, match=r"does not close in working mode \+\+\+.*gap of"):
        rp.load_robot("3rrr", proximal_length=0.1, distal_length=0.1)


@pytest.mark.parametrize("mode", [1, (1, 1), (1, 1, 0), "+++", (1, 1, 1, 1)])
def test_bad_working_modes(mode):
    with pytest.raises(InputError, match="a tuple of 3 signs"):
        rp.load_robot("3rrr", working_mode=mode)


@pytest.mark.parametrize("gravity", [(0.0, -9.81), (0.0, float("nan"), 0.0), "down"])
def test_bad_gravity(gravity):
    with pytest.raises(InputError, match="gravity"):
        rp.load_robot("3rrr", gravity=gravity)


def test_the_size_of_a_machine_does_not_depend_on_the_guess_or_the_carriers(tmp_path):
    lengths = []
    for index, guess in enumerate(({"a1": 2.0, "b1": -1.0, "a2": 1.0, "b2": 1.0}, {"a1": 2.5, "b1": -2.5, "a2": 0.5})):
        (tmp_path / str(index)).mkdir()
        robot = rp.load_robot(
            write(
                tmp_path / str(index),
                working_modes={"joints": ["b1", "b2"], "signs": [-1, 1]},
                reference={"platform": [0.25, 0.7], "guess": guess},
            )
        )
        lengths.append(robot.characteristic_length)
    assert lengths[0] == pytest.approx(lengths[1], rel=1e-12)
    with_carriers, without = rp.load_robot("3rrr"), rp.load_robot("3rrr", carriers=False)
    assert with_carriers.characteristic_length == pytest.approx(without.characteristic_length, rel=1e-12)


PLANAR_ARM = """<?xml version="1.0"?><robot name="arm"><link name="base"/>
  <link name="root"/><joint name="up" type="fixed"><parent link="base"/><child link="root"/>
    <origin rpy="{turn} 0 0"/></joint>{links}</robot>"""


@pytest.mark.parametrize("turn", [np.pi / 2, -np.pi / 2])
def test_a_platform_may_be_mounted_any_way_round(tmp_path, turn):
    """A planar arm in the x-z plane: its frames have their z axis along the axis of rotation."""
    links = body("l1", "root", "a1") + body("l2", "l1", "a2", origin="1 0 0") + body("ee", "l2", "a3", origin="1 0 0")
    (tmp_path / "bar.urdf").write_text(PLANAR_ARM.format(turn=turn, links=links))
    declaration = {
        "urdf": "bar.urdf",
        "actuated": ["a1", "a2", "a3"],
        "independent": {"platform": "ee", "axes": ["x", "z", "ry"]},
        "reference": {"platform": [1.2, 1.0, 0.3], "guess": {"a1": 0.2, "a2": 0.8}},
    }
    (tmp_path / "robot.yaml").write_text(yaml.safe_dump(declaration))
    robot = rp.load_robot(tmp_path)
    t = np.linspace(0.0, 1.0, 2001)
    x = np.stack([1.2 + 0.1 * np.sin(t), 1.0 + 0.1 * t, 0.3 + 0.5 * np.sin(2 * t)], axis=1)
    xd = np.stack([0.1 * np.cos(t), 0.1 + 0 * t, np.cos(2 * t)], axis=1)
    xdd = np.stack([-0.1 * np.sin(t), 0 * t, -2 * np.sin(2 * t)], axis=1)
    tree = rp.inverse_kinematics(robot, rp.PlatformMotion(t, x, xd, xdd))
    numeric = np.gradient(np.asarray(tree.q), t, axis=0, edge_order=2)
    # second-order differences with a step of 5e-4 of motions of order 1 to 10
    np.testing.assert_allclose(numeric, tree.v, atol=1e-5)


@pytest.mark.parametrize("guess", [{"a1": 2.0, "a2": 1.0}, {"a1": 2.05, "a2": 1.09}, {"a1": 0.3, "a2": 2.8}])
def test_the_reference_is_the_configuration_nearest_to_the_guess(tmp_path, guess):
    """The joints left out start stretched, where Newton leaves the guess; four branches to choose from."""
    robot = rp.load_robot(write(tmp_path, reference={"platform": [0.25, 0.6], "guess": guess}))
    at = [robot.model.joints[robot.model.getJointId(name)].idx_q for name in ("a1", "a2")]
    # closed form: the base angles are those of the line to the tip plus or minus the angle of an isosceles triangle
    half = np.arccos(np.hypot(0.25, 0.6) / (2 * 0.5))
    branches = {
        "a1": np.arctan2(0.6, 0.25) + half * np.array([1, -1]),
        "a2": np.arctan2(0.6, -0.25) + half * np.array([1, -1]),
    }
    for name, column in zip(("a1", "a2"), at, strict=True):
        nearest = branches[name][np.argmin(np.abs(branches[name] - guess[name]))]
        assert robot.q_reference[column] == pytest.approx(nearest, abs=1e-9)


def test_the_documented_declaration_shows_every_key_and_loads(tmp_path):
    """docs/robot.yaml with a five-bar made for it: every key that the loader knows occurs in it."""
    from pathlib import Path

    from redundancy_pin.robot.declaration import Declaration

    text = (Path(__file__).resolve().parents[1] / "docs" / "robot.yaml").read_text(encoding="utf-8")
    data = yaml.safe_load(text)
    assert set(Declaration.model_fields) - {"closed_form"} == set(data)
    names = {"a1": "left_base", "b1": "left_elbow", "a2": "right_base", "b2": "right_elbow", "slider": "carrier"}
    names |= {"tip1": "left_tip", "tip2": "right_tip"}
    tree = FIVE_BAR.replace(
        '<robot name="bar">',
        '<robot name="bar" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:arg name="carriers" default="true"/>'
        '<xacro:arg name="distal_length" default="0.5"/><xacro:arg name="base_distance" default="0.5"/>',
    )
    for old, new in names.items():
        tree = tree.replace(f'"{old}"', f'"{new}"')
    (tmp_path / data["urdf"]).write_text(tree)
    (tmp_path / "robot.yaml").write_text(text)
    robot = rp.load_robot(tmp_path)
    assert (robot.n, robot.m, robot.k, robot.working_mode) == (2, 2, 1, (1, -1))
    assert robot.carrier_limits[0].force == 50.0


def test_paths_that_lead_nowhere_are_said_to(tmp_path):
    with pytest.raises(ModelFileError, match=r"There is no file .*robot\.yaml"):
        rp.load_robot(tmp_path / "robot.yaml")
    path = write(tmp_path)
    with pytest.raises(DeclarationError, match=r"bar\.urdf does not say it all.*Where are loops cut"):
        rp.load_robot(path.parent / "bar.urdf")
    with pytest.raises(ModelFileError, match="Did you mean '3rrr'"):
        rp.load_robot("3RR")
    assert "URDF" not in repr(rp.load_robot("3rrr"))
    assert len(repr(rp.load_robot("3rrr"))) < 400


# --- errors that name their cause ---


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ('<mujoco model="a"><worldbody/></mujoco>', "an MJCF model of MuJoCo"),
        ('<?xml version="1.0"?>\n<!-- a note: <robot> -->\n<sdf version="1.6"><model name="a"/></sdf>', "an SDF model"),
        ('\n<!-- note: yaml would choke on this -->\n<robot name="a"/>', "a URDF"),
        ("<!DOCTYPE html><html><body/></html>", "an XML file with <html> on top"),
        ("<!-- never closed", "an XML file"),
        ("<?a?>" * 200_000 + "<", "an XML file"),
    ],
)
def test_a_model_of_another_format_is_called_what_it_is(text, what, tmp_path):
    (tmp_path / "model.yaml").write_text(text)
    with pytest.raises(DeclarationError, match=f"model.yaml is {what}.*not a declaration") as caught:
        rp.load_robot(tmp_path / "model.yaml")
    assert ("Convert it" in str(caught.value)) is (what not in ("a URDF", "an MJCF model of MuJoCo", "an SDF model"))


def test_a_closure_whose_frame_is_wrong_is_named_and_the_others_are_not(tmp_path):
    """Two loops, independent of each other, each closed at its tips; in the second a link of the base is named."""
    second = (
        body("s1", "base", "c1", origin="3 0 0")
        + body("s2", "s1", "d1", origin="0.5 0 0")
        + body("top1", "s2", "n1", kind="fixed", origin="0.5 0 0", mass=0.1)
        + body("u1", "base", "c2", origin="3.5 0 0")
        + body("u2", "u1", "d2", origin="0.5 0 0")
        + body("top2", "u2", "n2", kind="fixed", origin="0.5 0 0", mass=0.1)
        + body("far", "base", "n3", kind="fixed", origin="9 0 0", mass=0.1)
    )
    tree = FIVE_BAR.replace("</robot>", second + "</robot>")
    guess = {**DECLARATION["reference"]["guess"], "c1": 2.0, "d1": -1.0, "c2": 1.0, "d2": 1.0}

    def declared(frame):
        return {
            "closures": [
                {"name": "left", "frames": ["tip1", "tip2"], "axes": ["x", "y"]},
                {"name": "right", "frames": ["top1", frame], "axes": ["x", "y"]},
            ],
            "actuated": ["a1", "a2", "c1", "c2"],
            "independent": {"joints": ["a1", "a2", "c1", "c2"]},
            "reference": {"joints": {"a1": 1.9, "a2": 1.2, "c1": 1.9, "c2": 1.2}, "guess": guess},
        }

    assert rp.load_robot(write(tmp_path, tree=tree, **declared("top2"))).n == 4
    # which is farther from there than both links are long
    with pytest.raises(DeclarationError, match=r"leaves a gap of .* \(open: 'right' by [3-6]") as caught:
        rp.load_robot(write(tmp_path, tree=tree, **declared("far")))
    assert "'left'" not in str(caught.value)


@pytest.mark.parametrize("angle", [30, 6.3])
def test_a_platform_angle_in_degrees_is_said_to_be(angle, tmp_path):
    text = (models_root() / "3rrr" / "robot.yaml").read_text()
    assert "  platform: [" in text
    lines = [
        f'  platform: ["sqrt(3) / 2", 0.5, {angle}]' if line.startswith("  platform: [") else line
        for line in text.splitlines()
    ]
    (tmp_path / "robot.yaml").write_text("\n".join(lines))
    shutil.copy(models_root() / "3rrr" / "3rrr.urdf.xacro", tmp_path)
    with pytest.raises(DeclarationError, match=r"reference\.platform.*angles in radians, within a turn \(degrees\?\)"):
        rp.load_robot(tmp_path)


def test_gravity_that_moves_nothing_is_said(tmp_path, caplog):
    path = write(tmp_path)
    still = rp.load_robot(path, gravity=[0.0, 0.0, -9.81])
    assert "gravity = [0.0, 0.0, -9.81] is normal to the plane in which my_five_bar moves" in caplog.text
    lying = rp.load_robot(path)
    motion = rp.PlatformMotion([0.0], [[0.25, 0.7]], [[0.0, 0.0]], [[0.0, 0.0]])
    # it is so: the efforts are those of no gravity; any other direction has an effect, and is not warned of
    for robot, acts in ((still, False), (lying, False), (rp.load_robot(path, gravity=[0.0, -1e-3, -9.81]), True)):
        assert gravity_acts(robot) is acts
        assert bool(np.abs(rp.RneaDynamics(robot).reduce(motion).f).max() > 1e-12) is acts
    # a machine that slides up and down its plane is moved by it
    slide = body("l1", "base", "a1", kind="prismatic", axis="0 0 1")
    (tmp_path / "bar.urdf").write_text(URDF.format(links=slide))
    (tmp_path / "robot.yaml").write_text(
        "urdf: bar.urdf\nactuated: [a1]\nindependent: {joints: [a1]}\nreference: {joints: {a1: 0.0}}\n"
    )
    assert gravity_acts(rp.load_robot(tmp_path, gravity=[0.0, 0.0, -9.81]))
