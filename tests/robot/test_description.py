"""Files and arguments of a robot: each mistake gets one clear error that names it."""

from concurrent.futures import ThreadPoolExecutor

import pytest

from redundancy_pin.errors import InputError, ModelFileError
from redundancy_pin.robot.urdf import declaration_path, known_values, models_root, render, shipped_robots, source_in

XACRO = """<?xml version="1.0"?>
<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:arg name="length" default="2.0"/>
  <xacro:arg name="heavy" default="true"/>
  <xacro:arg name="label" default="auto"/>
  <link name="base"/>
  <xacro:if value="$(arg heavy)">
    <link name="bob"><inertial><mass value="${3 * $(arg length)}"/>
      <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
    <joint name="j" type="fixed"><parent link="base"/><child link="bob"/></joint>
  </xacro:if>
</robot>
"""


@pytest.fixture
def xacro(tmp_path):
    path = tmp_path / "r.urdf.xacro"
    path.write_text(XACRO)
    return path


def test_arguments_keep_their_defaults_and_kinds(xacro):
    values = known_values(xacro, {"length": 1})
    assert values == {"length": 1.0, "heavy": True, "label": "auto"}
    assert isinstance(values["length"], float)
    assert known_values(xacro, {"heavy": "False"})["heavy"] is False
    assert known_values(xacro, {"label": 0.5})["label"] == 0.5


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"lenght": 1.0}, r"no argument 'lenght'\. Did you mean 'length'\?"),
        ({"length": "long"}, "'length' is 'long'. It must be a finite number"),
        ({"length": "inf"}, "'length' is 'inf'. It must be a finite number"),
        ({"length": float("nan")}, "'length' is nan"),
        ({"length": True}, "'length' is True"),
        ({"length": [1.0, 2.0]}, r"'length' cannot be \[1.0, 2.0\]"),
        ({"heavy": 1.0}, "'heavy' is 1.0. It must be true or false"),
    ],
)
def test_arguments_that_do_not_fit_are_refused(xacro, arguments, message):
    with pytest.raises(InputError, match=message):
        known_values(xacro, arguments)


def test_an_argument_without_default_must_be_given(tmp_path):
    path = tmp_path / "r.urdf.xacro"
    path.write_text(XACRO.replace(' default="2.0"', ""))
    with pytest.raises(InputError, match="needs a value for the argument 'length'"):
        known_values(path, {})
    assert known_values(path, {"length": 3})["length"] == 3.0


def test_robots_are_found_by_name_file_and_folder(tmp_path):
    assert {"2rpr", "3rrr", "five_bar", "four_bar", "gough"} <= set(shipped_robots())
    inside = declaration_path("3rrr")
    assert inside.name == "robot.yaml"
    assert declaration_path(inside) == inside
    assert declaration_path(inside.parent) == inside
    with pytest.raises(ModelFileError, match=r"no robot '3rr'\. Did you mean '3rrr'\?"):
        declaration_path("3rr")
    with pytest.raises(ModelFileError, match=r"holds no robot\.yaml"):
        declaration_path(tmp_path)


def test_a_folder_of_somebodys_own_comes_before_the_gallery(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert declaration_path("delta") == models_root() / "gallery" / "delta" / "robot.yaml"
    (tmp_path / "delta").mkdir()
    (tmp_path / "delta" / "robot.yaml").write_text("")
    assert (tmp_path / declaration_path("delta")).samefile(tmp_path / "delta" / "robot.yaml")
    assert source_in(tmp_path, "delta") == str(tmp_path / "delta")
    assert source_in(tmp_path / "elsewhere", "delta") == "gallery/delta"


def test_defaults_are_evaluated_by_xacro_and_whole_numbers_stay_whole(tmp_path):
    path = tmp_path / "r.urdf.xacro"
    path.write_text("""<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">
      <xacro:arg name="a" default="0.5"/><xacro:arg name="b" default="$(arg a)"/>
      <xacro:arg name="c" default="${2 * 0.25}"/><xacro:arg name="n" default="1"/>
      <link name="leg_$(arg n)"/><link name="${'b' * $(arg n)}_${2 * $(arg b)}_${2 * $(arg c)}"/>
      <joint name="j" type="fixed"><parent link="leg_$(arg n)"/>
        <child link="${'b' * $(arg n)}_${2 * $(arg b)}_${2 * $(arg c)}"/></joint></robot>""")
    urdf, parameters = render(path, {})
    assert parameters == {"a": 0.5, "b": 0.5, "c": 0.5, "n": 1.0}
    assert 'name="leg_1"' in urdf
    assert 'name="b_1.0_1.0"' in urdf
    urdf, parameters = render(path, {"a": 2, "n": 3})
    assert parameters == {"a": 2.0, "b": 2.0, "c": 0.5, "n": 3.0}
    assert 'name="leg_3"' in urdf


def test_includes_are_found_beside_the_file_from_any_folder(tmp_path, monkeypatch):
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "inner.xacro").write_text(
        """<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:arg name="inner" default="4"/>
        <link name="link_$(arg inner)"/></robot>"""
    )
    path = tmp_path / "r.urdf.xacro"
    path.write_text(
        """<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">
        <xacro:include filename="sub/inner.xacro"/></robot>"""
    )
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    monkeypatch.chdir(elsewhere)
    render(models_root() / "four_bar" / "four_bar.urdf.xacro", {})  # xacro remembers the last file it read
    assert known_values(path, {"inner": 5}) == {"inner": 5.0}
    urdf, parameters = render(path, {"inner": 5})
    assert "link_5" in urdf
    assert parameters == {"inner": 5.0}
    assert render(path, {})[1] == {"inner": 4.0}
    with pytest.raises(InputError, match=r"no argument 'iner'\. Did you mean 'inner'"):
        known_values(path, {"iner": 5})


def test_a_robot_is_not_named_by_a_number():
    with pytest.raises(ModelFileError, match="not by 5"):
        declaration_path(5)


def test_robots_render_in_several_threads_at_once():
    """xacro keeps its stacks in globals; a map by joblib's threads made failed cells of that."""
    path = models_root() / "3rrr" / "3rrr.urdf.xacro"
    masses = [0.5 + 0.1 * i for i in range(12)]
    with ThreadPoolExecutor(6) as pool:
        rendered = list(pool.map(lambda mass: render(path, {"carrier_mass": mass}), masses))
    assert [parameters["carrier_mass"] for _, parameters in rendered] == pytest.approx(masses)
