"""Scripts of the documents run as a reader starts them, with nothing but their own numbers of samples."""

from __future__ import annotations

import subprocess
import sys
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import pytest

SCRIPTS = sorted((Path(__file__).resolve().parents[2] / "docs" / "examples").glob("*.py"))
OF_OTHERS = {"cassie_leg", "cassie_squat", "solo_feet", "solo_squat"}
"""Those that need example-robot-data."""


@pytest.mark.parametrize("script", [pytest.param(path, id=path.stem) for path in SCRIPTS])
def test_a_script_runs(script: Path, tmp_path: Path) -> None:
    if script.stem in OF_OTHERS:
        try:
            version("example-robot-data")
        except PackageNotFoundError:
            pytest.skip("example-robot-data is not installed: pip install 'redundancy_pin[examples]'")
    done = subprocess.run(
        [sys.executable, script], capture_output=True, text=True, cwd=tmp_path, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr
    assert len(done.stdout.splitlines()) > 1
    assert "nan" not in done.stdout
