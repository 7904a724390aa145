"""Old import paths give the new modules, and say so."""

from __future__ import annotations

import importlib
import subprocess
import sys

import pytest

from redundancy_pin._moved import MOVED


def test_an_old_path_is_the_new_module_and_warns_where_it_is_imported() -> None:
    """In a process of its own: what another test has imported warns no more."""
    program = (
        "import warnings\n"
        "with warnings.catch_warnings(record=True) as caught:\n"
        "    warnings.simplefilter('always')\n"
        "    from redundancy_pin.kinematics.singularity import SingularityKind\n"
        "    import redundancy_pin.files as files\n"
        "from redundancy_pin.singularities import classify\n"
        "from redundancy_pin.io import files as new\n"
        "assert SingularityKind is classify.SingularityKind and files is new\n"
        "assert classify.__name__ == classify.__spec__.name == 'redundancy_pin.singularities.classify'\n"
        "for warning in caught:\n"
        "    print(warning.category.__name__, warning.filename, warning.message)\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == [
        f"DeprecationWarning <string> redundancy_pin.{old} is now redundancy_pin.{new}."
        for old, new in (("kinematics.singularity", "singularities.classify"), ("files", "io.files"))
    ]


@pytest.mark.parametrize(("old", "new"), MOVED.items())
def test_every_old_path_leads_somewhere(old: str, new: str, monkeypatch: pytest.MonkeyPatch) -> None:
    if new == "studies":
        pytest.importorskip("redundancy_pin.studies", reason="not merged yet")
    monkeypatch.delitem(sys.modules, f"redundancy_pin.{old}", raising=False)
    with pytest.warns(DeprecationWarning, match=f"redundancy_pin.{old} is now redundancy_pin.{new}"):
        module = importlib.import_module(f"redundancy_pin.{old}")
    assert module is importlib.import_module(f"redundancy_pin.{new}")


def test_an_unknown_path_is_refused_as_ever() -> None:
    with pytest.raises(ModuleNotFoundError, match=r"redundancy_pin\.kinematics\.nothing"):
        importlib.import_module("redundancy_pin.kinematics.nothing")
