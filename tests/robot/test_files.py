"""Files that cannot be meant, or are read in part: the error, or a note, says what their first comment says."""

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
BAD, NOTED = (
    [path for path in sorted(FILES.glob(f"*/{kind}/*.*")) if path.suffix != ".xml" or find_spec("mujoco")]
    for kind in ("bad", "noted")
)
DECLARATIONS: dict[str, dict[str, Any]] = yaml.safe_load((FILES / "declaration" / "bad.yaml").read_text())


def skip_newer_than_mujoco(path: Path) -> None:
    """Springs that yield came with MuJoCo 4."""
    if path.stem == "yielding" and int(pytest.importorskip("mujoco").__version__.partition(".")[0]) < 4:
        pytest.skip("of MuJoCo 4")


def comment_of(path: Path) -> str:
    found = re.search(r"<!-- (.*) -->", path.read_text())
    assert found
    return found[1]


@pytest.mark.parametrize("path", NOTED, ids=lambda path: path.name)
def test_what_is_not_in_force_is_noted(path: Path) -> None:
    assert sum(comment_of(path) in note for note in rp.load_robot(path).notes) == 1


@pytest.mark.parametrize("path", BAD, ids=lambda path: path.name)
def test_a_file_that_cannot_be_meant_is_refused_by_name(path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """Nothing is only on the error stream, where urdfdom and MuJoCo write."""
    skip_newer_than_mujoco(path)
    with pytest.raises(RedundancyPinError) as refusal:
        rp.load_robot(path)
    assert comment_of(path) in str(refusal.value)
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
