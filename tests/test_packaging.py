"""What is built from a checkout: contents of the wheel, and that it works with nothing of the checkout in reach."""

from __future__ import annotations

import email
import os
import re
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
import yaml

import redundancy_pin

ROOT = Path(__file__).resolve().parents[1]

pytestmark = pytest.mark.skipif(
    not (ROOT / "pyproject.toml").is_file(), reason="needs a source checkout, not an installed package"
)


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the wheel with the build backend of this environment, so that no network is needed."""
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "hatchling", "build", "--target", "wheel", "--directory", str(folder)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, stdin=subprocess.DEVNULL, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    (built,) = folder.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def contents(wheel: Path) -> set[str]:
    with zipfile.ZipFile(wheel) as archive:
        return set(archive.namelist())


def test_wheel_ships_every_model_file(contents: set[str]) -> None:
    files = {f"redundancy_pin/{path.relative_to(ROOT).as_posix()}" for path in (ROOT / "models").rglob("*.*")}
    assert "redundancy_pin/models/3rrr/robot.yaml" in files
    assert {name for name in contents if name.startswith("redundancy_pin/models/")} == files


def test_wheel_ships_every_module_and_the_typing_marker(contents: set[str]) -> None:
    modules = {path.relative_to(ROOT).as_posix() for path in (ROOT / "redundancy_pin").rglob("*.py")}
    assert modules <= contents
    assert "redundancy_pin/py.typed" in contents
    assert "redundancy_pin/visualisation/viewer/page.html" in contents
    assert "redundancy_pin/visualisation/figures/style.mplstyle" in contents


def test_wheel_holds_the_package_and_nothing_else(contents: set[str]) -> None:
    tops = {name.split("/")[0] for name in contents}
    assert {top for top in tops if not top.endswith(".dist-info")} == {"redundancy_pin"}


def test_installed_wheel_loads_its_own_models_and_reports_of_them(wheel: Path, tmp_path: Path) -> None:
    target, empty = tmp_path / "site", tmp_path / "empty"
    empty.mkdir()
    with zipfile.ZipFile(wheel) as archive:  # a wheel of Python files is installed by unpacking it
        archive.extractall(target)
        (metadata,) = (name for name in archive.namelist() if name.endswith(".dist-info/WHEEL"))
        assert b"Root-Is-Purelib: true" in archive.read(metadata)
    # one of the robots: the files of the others are there as well, by the test above
    program = (
        "from dataclasses import replace\n"
        "import redundancy_pin, redundancy_pin.robot.shipped as files\n"
        "from redundancy_pin.thesis.cases import BY_NAME, QUICK\n"
        "from redundancy_pin.thesis.reproduce import reproduce\n"
        "motion = replace(BY_NAME['corner-r0.025-baseline'], dt=0.02)\n"
        "reproduce('results', replace(QUICK, motions=(motion,), chapters=(), samples=1))\n"
        "redundancy_pin.load_robot('2rpr')\n"
        "print(redundancy_pin.__file__, files.models_root(), *files.shipped_robots(), sep='\\n')\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program],
        cwd=empty,
        env={**os.environ, "PYTHONPATH": str(target)},
        capture_output=True,
        text=True,
        stdin=subprocess.DEVNULL,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert (empty / "results" / "report.html").read_text(encoding="utf-8").startswith("<!DOCTYPE html>")
    package, models, *robots = done.stdout.splitlines()
    # resolved: a temporary folder may be reached through a symbolic link
    assert Path(package).resolve().is_relative_to(target.resolve())
    assert Path(models).resolve().is_relative_to(target.resolve())
    assert robots == sorted(path.parent.name for path in (ROOT / "models").glob("**/robot.yaml"))


def test_version_has_one_source(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        (metadata,) = (name for name in archive.namelist() if name.endswith(".dist-info/METADATA"))
        fields = email.message_from_bytes(archive.read(metadata))
    assert fields["Version"] == redundancy_pin.__version__
    declared = re.findall(r'^version\s*=\s*"', (ROOT / "pyproject.toml").read_text(encoding="utf-8"), re.MULTILINE)
    assert not declared, "pyproject.toml takes the version from redundancy_pin/__init__.py"


def test_changelog_and_citation_name_this_version() -> None:
    changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert re.search(rf"^## \[{re.escape(redundancy_pin.__version__)}\]", changelog, re.MULTILINE)
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert citation["version"] == redundancy_pin.__version__
