"""Loading a robot of one's own: where files are found, which configuration is the reference, and what is refused."""

from __future__ import annotations

import shutil
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from written import J, urdf_of, write_changed, write_robot

import redundancy_pin as rp
from redundancy_pin.errors import DeclarationError, InputError, ModelFileError
from redundancy_pin.kinematics.coordinates import gravity_acts
from redundancy_pin.robot.declaration import Declaration
from redundancy_pin.robot.shipped import declaration_path, models_root, shipped_robots, source_in

FILES = Path(__file__).parent / "robot" / "files" / "declaration"
DECLARATION: dict[str, Any] = yaml.safe_load((FILES / "robot.yaml").read_text())
FIVE_BAR = (FILES / "bar.urdf").read_text()


def write(folder: Path, tree: str = FIVE_BAR, **changes: Any) -> Path:
    folder.mkdir(exist_ok=True)
    (folder / "bar.urdf").write_text(tree)
    (folder / "robot.yaml").write_text(yaml.safe_dump(DECLARATION | changes))
    return folder / "robot.yaml"


# --- where a robot is -------------------------------------------------------------------------------------------------


def test_robots_are_found_by_name_file_and_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A folder of somebody's own comes before the gallery."""
    assert {"2rpr", "3rrr", "five_bar", "four_bar", "gough"} <= set(shipped_robots())
    inside = declaration_path("3rrr")
    assert inside.name == "robot.yaml"
    assert declaration_path(inside) == declaration_path(inside.parent) == inside
    monkeypatch.chdir(tmp_path)
    assert declaration_path("delta") == models_root() / "gallery" / "delta" / "robot.yaml"
    write(tmp_path / "delta")
    assert (tmp_path / declaration_path("delta")).samefile(tmp_path / "delta" / "robot.yaml")
    assert source_in(tmp_path, "delta") == str(tmp_path / "delta")
    assert source_in(tmp_path / "elsewhere", "delta") == "gallery/delta"


def test_a_path_means_the_robot_of_the_folder_one_is_in(monkeypatch: pytest.MonkeyPatch) -> None:
    """Shipped robots are kept in memory, by a path that means the same in all folders."""
    for name in ("four_bar", "2rpr"):
        monkeypatch.chdir(models_root() / name)
        assert rp.load_robot("robot.yaml").name == name


@pytest.mark.parametrize(
    ("source", "message"),
    [
        ("3rr", r"no robot '3rr'\. Did you mean '3rrr'\?"),
        ("3RR", "Did you mean '3rrr'"),
        (Path(), r"holds no robot\.yaml"),
        (5, "not by 5"),
        (Path("robot.yaml"), r"There is no file .*robot\.yaml"),
        *((name, ".") for name in ("x" * 300, "x" * 300 + "/robot.yaml", "nul\x00", "/dev/zero", "~nobody/robot.yaml")),
    ],
)
def test_sources_that_are_no_robot(source: Any, message: str, tmp_path: Path) -> None:
    with pytest.raises(ModelFileError, match=message):
        rp.load_robot(tmp_path / source if isinstance(source, Path) else source)


@pytest.mark.parametrize(
    ("file", "text", "message"),
    [
        ("robot.yaml", "closures: [}", "not readable YAML"),
        ("robot.yaml", "- 1\n- 2\n", "holds no mapping"),
        ("robot.yaml", '<mujoco model="a"/>', "is an MJCF model of MuJoCo.*not a declaration"),
        ("robot.yaml", '<?xml version="1.0"?>\n<!-- a note: <robot> -->\n<sdf/>', "is an SDF model"),
        ("robot.yaml", '\n<!-- note: yaml would choke on this -->\n<robot name="a"/>', "is a URDF"),
        ("robot.yaml", "<!DOCTYPE html><html/>", "is an XML file with <html> on top.*Convert it"),
        ("robot.yaml", "<!-- never closed", "is an XML file"),
        ("robot.yaml", "<?a?>" * 200_000 + "<", "is an XML file"),
        (
            "bar.urdf",
            '<mujoco model="a"/>',
            "<mujoco>, not <robot>: it is an MJCF model of MuJoCo.*call it",
        ),
        ("bar.urdf", "", r"bar\.urdf"),
    ],
)
def test_files_that_are_something_else(file: str, text: str, message: str, tmp_path: Path) -> None:
    path = write(tmp_path)
    (tmp_path / file).write_text(text)
    with pytest.raises((DeclarationError, ModelFileError), match=message):
        rp.load_robot(path)


def test_file_and_line_of_a_bad_declaration_are_named(tmp_path: Path) -> None:
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
    (tmp_path / "bar.urdf").unlink()
    path.write_text("\n".join(lines))
    with pytest.raises(ModelFileError, match="does not exist"):
        rp.load_robot(path)


# --- arguments --------------------------------------------------------------------------------------------------------


def test_arguments_are_evaluated_and_whole_numbers_stay_whole() -> None:
    """Those of included files too, which are found from any folder."""
    path = FILES.parent / "xacro" / "arguments" / "r.urdf.xacro"
    robot = rp.load_robot(path, n=3)
    assert robot.parameters == {"needed": 7.0, "length": 2.0, "heavy": True, "half": 0.5, "n": 3.0}
    assert robot.model.jointPlacements[1].translation.tolist() == [4.0, 0.0, 7.0]
    assert 'name="leg_3"' in robot.urdf
    for given, message in (
        ({"lenght": 1.0}, r"no argument 'lenght'\. Did you mean 'length'\?"),
        ({"neded": 1.0}, r"no argument 'neded'\. Did you mean 'needed'\?"),
        ({"length": "long"}, "'length' is 'long'. It must be a finite number"),
        ({"length": "inf"}, "'length' is 'inf'. It must be a finite number"),
        ({"length": True}, "'length' is True"),
        ({"length": float("nan")}, "'length' is nan"),
        ({"length": [1.0, 2.0]}, r"'length' cannot be \[1.0, 2.0\]"),
        ({"heavy": 1.0}, "'heavy' is 1.0. It must be true or false"),
    ):
        with pytest.raises(InputError, match=message):
            rp.load_robot(path, **given)


def test_a_condition_may_be_on_an_argument_whose_default_is_evaluated(tmp_path: Path) -> None:
    path = FILES.parent / "xacro" / "arguments" / "r.urdf.xacro"
    (tmp_path / "robot.yaml").write_text(f"urdf: {path}\nrequires: [half > 0.4]\n")
    assert rp.load_robot(tmp_path).actuated == ("j",)
    with pytest.raises(InputError, match=r"half > 0\.4 does not hold \(half = 0\.25\)"):
        rp.load_robot(tmp_path, length=1.0)
    shutil.copytree(path.parent, tmp_path, dirs_exist_ok=True)
    path = write_changed(tmp_path, path, ("${2 * $(arg length)}", "${sqrt($(arg length))}"))
    (tmp_path / "robot.yaml").write_text(f"urdf: {path.name}\nrequires: [length > 0, half > 0]\n")
    with pytest.raises(InputError, match="length > 0 does not hold"):  # in place of xacro's own error
        rp.load_robot(tmp_path, length=-1.0)
    (tmp_path / "robot.yaml").write_text(f"urdf: {path.name}\nrequires: [half > 0, length > 0]\n")
    with pytest.raises(ModelFileError, match="xacro cannot render"):
        rp.load_robot(tmp_path, length=-1.0)


@pytest.mark.parametrize(
    ("name", "given", "message"),
    [
        ("3rrr", {"base_radius": 0.0}, "base_radius > 0 does not hold"),
        ("2rpr", {"carrier_mass": -1.0}, "carrier_mass >= 0 does not hold"),
        ("3rrr", {"proximal_length": 0.1, "distal_length": 0.1}, r"does not close in working mode \+\+\+.*gap of"),
        *(
            ("3rrr", {"working_mode": mode}, "the robot has 3 legs")
            for mode in (1, (1, 1), (1, 1, 0), (1, 1, 1, 1), "+++")
        ),
        ("excavator", {"working_mode": (1, 1)}, "declares no working modes"),
        *(("3rrr", {"gravity": value}, "gravity") for value in ((0.0, -9.81), (0.0, float("nan"), 0.0), "down")),
    ],
)
def test_arguments_that_make_no_machine(name: str, given: dict[str, Any], message: str) -> None:
    with pytest.raises((InputError, DeclarationError), match=message):
        rp.load_robot(name, **given)


def test_robots_load_in_several_threads_at_once() -> None:
    """xacro keeps its stacks in globals, and so does Python's parser; a map by joblib's threads made failed cells."""
    masses = [0.5 + 0.1 * i for i in range(16)]
    with ThreadPoolExecutor(4) as pool:
        robots = list(pool.map(lambda mass: rp.load_robot("3rrr", carrier_mass=mass), masses))
    assert [robot.parameters["carrier_mass"] for robot in robots] == pytest.approx(masses)


# --- references -------------------------------------------------------------------------------------------------------


def test_gravity_and_default_mode() -> None:
    np.testing.assert_array_equal(rp.load_robot("3rrr", gravity=(0.0, -9.81, 0.0)).gravity, [0.0, -9.81, 0.0])
    assert rp.load_robot("3rrr").working_mode == (1, 1, 1)
    other = rp.load_robot("3rrr", working_mode=(1, -1, 1))
    assert other.working_mode == (1, -1, 1)
    assert "mode +-+" in repr(other)


def test_the_size_of_a_machine_does_not_depend_on_the_guess_or_the_carriers(tmp_path: Path) -> None:
    modes = {"joints": ["b1", "b2"], "signs": [-1, 1]}
    lengths = []
    for guess in ({"a1": 2.0, "b1": -1.0, "a2": 1.0, "b2": 1.0}, {"a1": 2.5, "b1": -2.5, "a2": 0.5}):
        path = write(tmp_path, working_modes=modes, reference={"platform": [0.25, 0.7], "guess": guess})
        lengths.append(rp.load_robot(path).characteristic_length)
    assert lengths[0] == pytest.approx(lengths[1], rel=1e-12)
    with_carriers, without = rp.load_robot("3rrr"), rp.load_robot("3rrr", carriers=False)
    assert with_carriers.characteristic_length == pytest.approx(without.characteristic_length, rel=1e-12)


@pytest.mark.parametrize("turn", [np.pi / 2, -np.pi / 2])
def test_a_platform_may_be_mounted_any_way_round(turn: float, tmp_path: Path) -> None:
    """A planar arm in the x-z plane: its frames have their z axis along the axis of rotation."""
    joints = [J("up", "fixed", "base", "root", rpy=(turn, 0, 0)), J("a1", "revolute", "root", "l1")]
    joints += [J("a2", "revolute", "l1", "l2", (1, 0, 0)), J("a3", "revolute", "l2", "ee", (1, 0, 0))]
    declaration = {
        "actuated": ["a1", "a2", "a3"],
        "independent": {"platform": "ee", "axes": ["x", "z", "ry"]},
        "reference": {"platform": [1.2, 1.0, 0.3], "guess": {"a1": 0.2, "a2": 0.8}},
    }
    robot = rp.load_robot(write_robot(tmp_path, urdf_of(joints), declaration))
    t = np.linspace(0.0, 1.0, 2001)
    x = np.stack([1.2 + 0.1 * np.sin(t), 1.0 + 0.1 * t, 0.3 + 0.5 * np.sin(2 * t)], axis=1)
    xd = np.stack([0.1 * np.cos(t), 0.1 + 0 * t, np.cos(2 * t)], axis=1)
    xdd = np.stack([-0.1 * np.sin(t), 0 * t, -2 * np.sin(2 * t)], axis=1)
    tree = rp.inverse_kinematics(robot, rp.PlatformMotion(t, x, xd, xdd))
    numeric = np.gradient(np.asarray(tree.q), t, axis=0, edge_order=2)
    # second-order differences with a step of 5e-4 of motions of order 1 to 10
    np.testing.assert_allclose(numeric, tree.v, atol=1e-5)


@pytest.mark.parametrize("guess", [{"a1": 2.0, "a2": 1.0}, {"a1": 2.05, "a2": 1.09}, {"a1": 0.3, "a2": 2.8}])
def test_the_reference_is_the_configuration_nearest_to_the_guess(guess: dict[str, float], tmp_path: Path) -> None:
    """The joints left out start stretched, where Newton leaves the guess; four branches to choose from."""
    robot = rp.load_robot(write(tmp_path, reference={"platform": [0.25, 0.6], "guess": guess}))
    # closed form: the base angles are those of the line to the tip plus or minus the angle of an isosceles triangle
    half = np.arccos(np.hypot(0.25, 0.6) / (2 * 0.5))
    for name, foot in (("a1", 0.25), ("a2", -0.25)):
        branches = np.arctan2(0.6, foot) + half * np.array([1, -1])
        nearest = branches[np.argmin(np.abs(branches - guess[name]))]
        column = robot.model.joints[robot.model.getJointId(name)].idx_q
        assert robot.q_reference[column] == pytest.approx(nearest, abs=1e-9)


def test_a_joint_whose_limits_are_turns_away_may_start_there(tmp_path: Path) -> None:
    """Angles of more than a turn are taken for degrees otherwise."""
    reference = {"platform": [0.25, 0.7], "guess": {"a1": 2.0 + 2.0 * np.pi, "b1": -1.0, "a2": 1.0, "b2": 1.0}}
    tree = FIVE_BAR.replace('lower="-9" upper="9"', 'lower="7" upper="9"', 1)
    assert rp.load_robot(write(tmp_path, tree, reference=reference)).n == 2


def test_the_documented_declaration_shows_every_key_and_loads(tmp_path: Path) -> None:
    """docs/robot.yaml with a five-bar made for it: every key that the loader knows occurs in it."""
    text = (Path(__file__).resolve().parents[1] / "docs" / "robot.yaml").read_text(encoding="utf-8")
    data = yaml.safe_load(text)
    assert set(Declaration.model_fields) - {"closed_form"} == set(data)
    names = {"a1": "left_base", "b1": "left_elbow", "a2": "right_base", "b2": "right_elbow", "slider": "carrier"}
    tree = FIVE_BAR.replace(
        '<robot name="bar">',
        '<robot name="bar" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:arg name="carriers" default="true"/>'
        '<xacro:arg name="distal_length" default="0.5"/><xacro:arg name="base_distance" default="0.5"/>',
    )
    for old, new in (names | {"tip1": "left_tip", "tip2": "right_tip"}).items():
        tree = tree.replace(f'"{old}"', f'"{new}"')
    (tmp_path / data["urdf"]).write_text(tree)
    (tmp_path / "robot.yaml").write_text(text)
    robot = rp.load_robot(tmp_path)
    assert (robot.n, robot.m, robot.k, robot.working_mode) == (2, 2, 1, (1, -1))
    assert robot.carrier_limits[0].force == 50.0


# --- errors that name their cause -------------------------------------------------------------------------------------


def test_a_closure_whose_frame_is_wrong_is_named_and_the_others_are_not(tmp_path: Path) -> None:
    """Two loops, independent of each other, each closed at its tips; in the second a link of the base is named."""
    joints = [J("mount", "fixed", "base", "far", (9, 0, 0))]
    for a, b, tip, x in (
        ("a1", "b1", "tip1", 0),
        ("a2", "b2", "tip2", 0.5),
        ("c1", "d1", "top1", 3),
        ("c2", "d2", "top2", 3.5),
    ):
        joints += [
            J(a, "revolute", "base", f"{a}_link", (x, 0, 0)),
            J(b, "revolute", f"{a}_link", f"{b}_link", (0.5, 0, 0)),
        ]
        joints.append(J(f"to_{tip}", "fixed", f"{b}_link", tip, (0.5, 0, 0)))
    driven = {"a1": 1.9, "a2": 1.2, "c1": 1.9, "c2": 1.2}

    def declared(frame: str) -> Path:
        ends = {"left": ["tip1", "tip2"], "right": ["top1", frame]}
        declaration = {
            "closures": [{"name": name, "frames": pair, "axes": ["x", "y"]} for name, pair in ends.items()],
            "actuated": list(driven),
            "independent": {"joints": list(driven)},
            "reference": {"joints": driven, "guess": {"b1": -1.0, "b2": 1.0, "d1": -1.0, "d2": 1.0}},
        }
        return write_robot(tmp_path, urdf_of(joints), declaration)

    assert rp.load_robot(declared("top2")).n == 4
    # which is farther from there than both links are long
    with pytest.raises(DeclarationError, match=r"leaves a gap of .* \(open: 'right' by [3-6]") as caught:
        rp.load_robot(declared("far"))
    assert "'left'" not in str(caught.value)


@pytest.mark.parametrize("angle", [30, 6.3])
def test_a_platform_angle_in_degrees_is_said_to_be(angle: float, tmp_path: Path) -> None:
    text = (models_root() / "3rrr" / "robot.yaml").read_text()
    platform = f'  platform: ["sqrt(3) / 2", 0.5, {angle}]'
    lines = [platform if line.startswith("  platform: [") else line for line in text.splitlines()]
    assert platform in lines
    (tmp_path / "robot.yaml").write_text("\n".join(lines))
    shutil.copy(models_root() / "3rrr" / "3rrr.urdf.xacro", tmp_path)
    with pytest.raises(DeclarationError, match=r"reference\.platform.*angles in radians, within a turn \(degrees\?\)"):
        rp.load_robot(tmp_path)


def test_gravity_that_moves_nothing_is_said(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = write(tmp_path)
    still = rp.load_robot(path, gravity=[0.0, 0.0, -9.81])
    assert "gravity = [0.0, 0.0, -9.81] is normal to the plane in which my_five_bar moves" in caplog.text
    motion = rp.PlatformMotion([0.0], [[0.25, 0.7]], [[0.0, 0.0]], [[0.0, 0.0]])
    # it is so: the efforts are those of no gravity; any other direction has an effect, and is not warned of
    robots = (still, False), (rp.load_robot(path), False), (rp.load_robot(path, gravity=[0.0, -1e-3, -9.81]), True)
    for robot, acts in robots:
        assert gravity_acts(robot) is acts
        assert bool(np.abs(rp.RneaDynamics(robot).reduce(motion).f).max() > 1e-12) is acts
    # a machine that slides along its normal is moved by it
    slide = {"actuated": ["a1"], "independent": {"joints": ["a1"]}, "reference": {"joints": {"a1": 0.0}}}
    write_robot(tmp_path, urdf_of([J("a1", "prismatic", "base", "l1")]), slide)
    assert gravity_acts(rp.load_robot(tmp_path, gravity=[0.0, 0.0, -9.81]))


def test_speed_and_force_of_carriers_that_the_urdf_leaves_at_zero_are_not_known(tmp_path: Path) -> None:
    limits = rp.load_robot(write(tmp_path, FIVE_BAR.replace('velocity="9" effort="9"', 'velocity="0" effort="0"')))
    assert limits.carrier_limits[0].speed == limits.carrier_limits[0].force == float("inf")


def test_a_joint_may_have_the_name_of_its_link(tmp_path: Path) -> None:
    tree = FIVE_BAR.replace('<joint name="m1"', '<joint name="tip1"').replace('<joint name="m2"', '<joint name="tip2"')
    assert tree.count('<joint name="tip') == 2
    assert rp.load_robot(write(tmp_path, tree)).n == 2
