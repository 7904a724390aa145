"""Files that cannot be meant: each is one error that says what its first comment says, and names file and line."""

from __future__ import annotations

import re
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
import yaml

import redundancy_pin as rp
from redundancy_pin.errors import DeclarationError, ModelFileError, RedundancyPinError

FILES = Path(__file__).parent / "files"
BAD = [path for path in sorted(FILES.glob("*/bad/*.*")) if path.suffix != ".xml" or find_spec("mujoco")]
DECLARATIONS: dict[str, dict[str, Any]] = yaml.safe_load((FILES / "declaration" / "bad.yaml").read_text())


def skip_newer_than_mujoco(path: Path) -> None:
    """Springs that yield came with MuJoCo 4."""
    if path.stem == "yielding" and int(pytest.importorskip("mujoco").__version__.partition(".")[0]) < 4:
        pytest.skip("of MuJoCo 4")


@pytest.mark.parametrize("path", BAD, ids=lambda path: f"{path.parts[-3]}-{path.stem}")
def test_a_file_that_cannot_be_meant_is_refused_by_name(path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """Nothing is only on the error stream, where urdfdom and MuJoCo write."""
    skip_newer_than_mujoco(path)
    comment = re.search(r"<!-- (.*) -->", path.read_text())
    assert comment
    with pytest.raises(RedundancyPinError) as refusal:
        rp.load_robot(path)
    assert comment[1] in str(refusal.value)
    assert refusal.value.remedy
    assert path.name in str(refusal.value) or path.suffix == ".xml"
    assert "line " in str(refusal.value) or path.suffix != ".sdf"
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("message", DECLARATIONS)
def test_a_declaration_that_cannot_be_meant_is_refused_by_name(message: str, tmp_path: Path) -> None:
    """The table gives what differs from ``declaration/robot.yaml``; a key of null is left out."""
    declaration = yaml.safe_load((FILES / "declaration" / "robot.yaml").read_text()) | DECLARATIONS[message]
    given = {key: value for key, value in declaration.items() if value is not None}
    (tmp_path / "bar.urdf").write_text((FILES / "declaration" / "bar.urdf").read_text())
    (tmp_path / "robot.yaml").write_text(yaml.safe_dump(given))
    with pytest.raises(DeclarationError) as refusal:
        rp.load_robot(tmp_path)
    assert message in str(refusal.value)
    assert refusal.value.remedy


@pytest.mark.parametrize(
    ("name", "details"),
    [
        ("negative_mass", {"link": "l1", "line": 5}),
        ("axis_of_length_zero", {"joint": "slider", "line": 20}),
        ("unknown_parent", {"joint": "b1", "link": "l11"}),
        ("two_parents", {"link": "l2"}),
    ],
)
def test_what_a_mistake_is_about_is_in_its_details(name: str, details: dict[str, object]) -> None:
    with pytest.raises(ModelFileError) as caught:
        rp.load_robot(FILES / "urdf" / "bad" / f"{name}.urdf")
    assert details.items() <= caught.value.details.items()
