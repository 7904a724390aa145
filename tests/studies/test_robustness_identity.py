"""What a study's journal depends on: settings by name, libraries, and the code that makes its trials."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

import redundancy_pin
from redundancy_pin.errors import OutputError
from redundancy_pin.experiments.robustness import Imperfections, identity, robustness_study, study
from redundancy_pin.experiments.robustness.scenarios import Scenario
from redundancy_pin.experiments.robustness.trial import Trial
from redundancy_pin.robot.description import models_root
from redundancy_pin.simulation.controllers.computed_torque import ComputedTorque
from redundancy_pin.simulation.controllers.weights import bryson_weights

SHORT = Scenario("line", "switch off", 2.48, 2.53)


@pytest.fixture
def begun(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict:
    """A study with a journal, whose simulations are stood in for."""
    monkeypatch.setattr(
        study,
        "run_trial",
        lambda scenario, drive, bounds, seed, number: Trial(
            scenario.name, drive, number, "completed", "", 1e-3, 5e-4, 1.0, 2.0, 0.0
        ),
    )
    options = {"scenarios": (SHORT,), "drives": ("LQR",), "journal": tmp_path / "journal.jsonl", "jobs": 1}
    robustness_study(1, **options)
    robustness_study(2, **options)  # goes on
    return options


def test_other_gains_are_another_study(begun: dict, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(ComputedTorque.__init__.__kwdefaults__, "bandwidth", 25.0)
    with pytest.raises(OutputError, match=r"for computed torque\.bandwidth it has 30\.0, now it is 25\.0.*delete it"):
        robustness_study(2, **begun)


def test_other_weights_are_another_study(begun: dict, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(bryson_weights.__kwdefaults__, "carrier", 0.02)
    with pytest.raises(OutputError, match=r"for LQR\.carrier it has 0\.01, now it is 0\.02"):
        robustness_study(2, **begun)


def test_another_version_of_a_library_is_another_study(begun: dict, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(identity, "_version", lambda name: "9" if name == "scipy" else "")
    with pytest.raises(OutputError, match=r"for libraries\."):
        robustness_study(2, **begun)


def test_other_code_is_another_study(begun: dict, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(identity, "code_digest", lambda: "another")
    with pytest.raises(OutputError, match=r"for code it has .*, now it is 'another'"):
        robustness_study(2, **begun)


def test_the_code_is_that_of_the_trials_and_the_models(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A changed line of a planner or a model counts; one of the command line or of a picture does not."""
    package = tmp_path / "redundancy_pin"
    shutil.copytree(Path(redundancy_pin.__file__).parent, package, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copytree(models_root(), tmp_path / "models", dirs_exist_ok=True)
    before = identity.code_digest()
    monkeypatch.setattr(redundancy_pin, "__file__", str(package / "__init__.py"))
    monkeypatch.setattr(identity, "models_root", lambda: tmp_path / "models")
    assert identity.code_digest() == before

    def changed(place: Path) -> bool:
        kept = place.read_bytes()
        place.write_bytes(kept + b"\n# changed\n")
        found = identity.code_digest()
        place.write_bytes(kept)
        return found != before

    decides = ["planners/switch_off.py", "simulation/run.py", "arrays.py", "experiments/robustness/trial.py"]
    assert [name for name in decides if not changed(package / name)] == []
    assert changed(tmp_path / "models" / "2rpr" / "robot.yaml")
    for name in ("cli/study.py", "view.py", "experiments/robustness/tables.py", "visualisation/__init__.py"):
        assert not changed(package / name)


def test_what_decides_is_plain_and_differs_with_bounds_and_seed() -> None:
    one = identity.identity(Imperfections(), 0, (SHORT,))
    assert json.loads(json.dumps(one)) == one
    assert one["computed torque"] == {"bandwidth": 30.0, "carrier_bandwidth": 10.0, "damping": 1.0}
    assert one["imperfections"]["start_position"] == 2e-4
    assert one["libraries"]["numpy"]
    assert one != identity.identity(replace(Imperfections(), noise=0.1), 0, (SHORT,))
    assert one != identity.identity(Imperfections(), 1, (SHORT,))
