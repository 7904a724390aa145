"""The robustness study: draws, statistics, store, what it depends on, and a small study of two drives."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import redundancy_pin
from redundancy_pin.errors import InputError, OutputError
from redundancy_pin.robot.shipped import models_root
from redundancy_pin.simulation.controllers import NoisyAmplifier
from redundancy_pin.simulation.controllers.computed_torque import ComputedTorque
from redundancy_pin.simulation.controllers.encoders import Encoders
from redundancy_pin.simulation.controllers.lqr import bryson_weights
from redundancy_pin.studies import robustness as study
from redundancy_pin.studies.robustness import (
    code_digest,
    identity,
    mean_interval,
    robustness_study,
    scaled,
    study_csv,
    study_table,
    wilson,
)
from redundancy_pin.studies.trial import (
    DRAWN_LENGTHS,
    DRAWN_MASSES,
    SCENARIOS,
    SUCCESS,
    Imperfections,
    Scenario,
    Trial,
    draw,
    nominal,
    planned,
    run_trial,
)

LINE_OFF, LINE_WHOLE = SCENARIOS[0].case, SCENARIOS[1].case
SHORT = Scenario(LINE_OFF, 2.45, 2.55)
"""s; the singular pose at 2.508 s, and little else."""


def trial(number: int, largest: float = 1e-3, **changed) -> Trial:
    return replace(Trial("line, switch off", "LQR", number, "ok", "", largest, 5e-4, 1.0, 2.0, 0.0), **changed)


def test_a_draw_depends_on_seed_and_number_alone():
    bounds = Imperfections()
    first, again, other = (draw(nominal(), bounds, seed, number) for seed, number in ((1, 4), (1, 4), (2, 4)))
    assert first.arguments == again.arguments
    assert np.array_equal(first.phase, again.phase)
    assert first.random.normal() == again.random.normal()
    assert first.arguments != other.arguments


def test_errors_of_the_start_have_a_stream_of_their_own():
    """Without them the machine, and the noise of its forces, are the same."""
    bounds = Imperfections()
    first, none = (draw(nominal(), one, 1, 4) for one in (bounds, replace(bounds, start_position=0.0, start_speed=0.0)))
    assert first.arguments == none.arguments
    assert np.array_equal(first.phase, none.phase)
    assert first.random.normal() == none.random.normal()
    assert not np.concatenate([none.x, none.xd, none.s, none.sd]).any()
    draws = [draw(nominal(), bounds, 0, number) for number in range(300)]
    for name, most in (("x", 2e-4), ("s", 2e-4), ("xd", 2e-3), ("sd", 2e-3)):
        away = np.array([getattr(one, name) for one in draws])
        assert away.shape == (300, 2)
        assert (0.95 * most < np.abs(away).max(axis=0)).all()
        assert np.abs(away).max() <= most


@pytest.mark.long
def test_a_trial_starts_beside_its_plan_and_the_controller_sees_it(monkeypatch: pytest.MonkeyPatch):
    """With the geometry as planned, the first reading is the true start, to the steps of the encoders."""
    seen = []
    real = Encoders.estimate

    def estimate(self, t, state):
        command = real(self, t, state)
        seen.append((state, command))
        return command

    monkeypatch.setattr(Encoders, "estimate", estimate)
    exact = replace(scaled(Imperfections(), 0.0), start_position=2e-4, start_speed=2e-3)
    run_trial(SHORT, "computed torque", exact, 0, 5)
    true, estimated = seen[0]
    point, drawn = planned(LINE_OFF).at(SHORT.start), draw(nominal(), exact, 0, 5)
    assert true.x - point.x == pytest.approx(drawn.x, abs=1e-12)
    assert true.xd - point.xd == pytest.approx(drawn.xd, abs=1e-12)
    assert true.s - point.s == pytest.approx(drawn.s, abs=1e-12)
    assert true.sd - point.sd == pytest.approx(drawn.sd, abs=1e-12)
    assert np.abs(drawn.x).max() > 2e-5
    # 16 bits a turn on legs of half a metre
    assert estimated.x == pytest.approx(true.x, abs=5e-5)
    assert estimated.s == pytest.approx(true.s, abs=2e-6)


def test_draws_stay_within_their_bounds_and_fill_them():
    bounds, known = Imperfections(), nominal().parameters
    draws = [draw(nominal(), bounds, 0, number) for number in range(300)]
    for name in DRAWN_MASSES:
        away = np.array([one.arguments[name] / known[name] - 1.0 for one in draws])
        assert 0.045 < np.abs(away).max() <= 0.05
    for name in DRAWN_LENGTHS:
        away = np.array([one.arguments[name] - known[name] for one in draws])
        assert 0.9e-3 < np.abs(away).max() <= 1e-3
    factors = np.array([one.coulomb for one in draws])
    assert 0.5 <= factors.min() < 0.52
    assert 1.48 < factors.max() <= 1.5


def test_severity_scales_errors_friction_and_noise_and_nothing_else():
    bounds = Imperfections()
    doubled, zero = scaled(bounds, 2.0), scaled(bounds, 0.0)
    assert (doubled.mass, doubled.length, doubled.noise) == (0.1, 2e-3, 0.1)
    assert (doubled.start_position, doubled.start_speed, zero.start_position) == (4e-4, 4e-3, 0.0)
    assert doubled.revolute_coulomb == 2.0 * bounds.revolute_coulomb
    assert doubled.prismatic_viscous == 2.0 * bounds.prismatic_viscous
    assert (doubled.period, doubled.prismatic_smoothing, doubled.effort_limit) == (1e-3, 0.01, 20.0)
    assert zero.noise == zero.prismatic_coulomb == 0.0
    with pytest.raises(InputError, match="severity is 20"):
        scaled(bounds, 20.0)
    exact = Imperfections(mass=0.0)
    assert scaled(exact, 50.0).noise == 50.0 * exact.noise
    for wrong in (-1.0, np.nan, np.inf):
        with pytest.raises(InputError, match="not negative"):
            scaled(exact, wrong)
    known = replace(bounds, mass=0.0)
    assert scaled(known, 30.0).length == 30.0 * bounds.length
    with pytest.raises(InputError, match="severity is inf"):
        scaled(known, float("inf"))


@pytest.mark.parametrize(("successes", "count"), [(0, 10), (7, 10), (200, 200)])
def test_rates_have_wilsons_interval(successes, count):
    p, z = successes / count, 1.959963984540054
    middle = (p + z * z / (2 * count)) / (1 + z * z / count)
    half = z * np.sqrt(p * (1 - p) / count + z * z / (4 * count**2)) / (1 + z * z / count)
    interval = wilson(successes, count)
    assert (interval.value, interval.low, interval.high) == pytest.approx((p, middle - half, middle + half), abs=1e-12)


def test_means_have_an_interval_like_students():
    values = np.random.default_rng(3).normal(5.0, 2.0, 200)
    interval = mean_interval(values)
    half = 1.97 * values.std(ddof=1) / np.sqrt(200)
    assert interval.value == pytest.approx(values.mean())
    assert (interval.low, interval.high) == pytest.approx((values.mean() - half, values.mean() + half), rel=0.02)
    assert np.isnan(mean_interval(values[:1]).low)


@pytest.mark.parametrize(
    ("changed", "success"),
    [
        ({}, True),
        ({"largest": SUCCESS * 1.01}, False),
        ({"status": "stopped"}, False),
        ({"status": "error", "largest": float("nan")}, False),
    ],
)
def test_success_is_the_end_reached_near_the_plan(changed, success):
    assert trial(0, **changed).success is success
    back = Trial(**json.loads(json.dumps(trial(0, **changed).as_dict())))
    assert back.success is success


def test_a_small_study_crosses_goes_on_and_is_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    book = tmp_path / "store"
    options = {"scenarios": (SHORT,), "drives": ("computed torque",), "journal": book, "jobs": 1}
    first = robustness_study(1, **options)
    (cell,) = first.cells
    assert cell.draws == 1
    assert cell.success.value == 1.0
    assert cell.worst < 1e-3
    assert cell.effort > 0.0
    run: list[int] = []
    real = study.run_trial

    def counted(*given):
        run.append(given[-1])
        return real(*given)

    monkeypatch.setattr(study, "run_trial", counted)
    seen: list[tuple[int, int]] = []
    second = robustness_study(2, **options, progress=lambda done, total, what: seen.append((done, total)))
    assert run == [1]  # the first draw was taken over
    assert seen == [(1, 2), (2, 2)]
    assert second.trials[0] == first.trials[0]
    assert robustness_study(2, **options).trials == second.trials
    assert [row[1] for row in study_table(second).texts] == ["computed torque"]
    lines = study_csv(second).splitlines()
    assert len(lines) == 3
    assert {line.count(",") for line in lines} == {lines[0].count(",")}


def test_scenarios_that_share_a_name_are_refused():
    with pytest.raises(InputError, match="'line, switch off'"):
        robustness_study(1, scenarios=(SHORT, replace(SHORT, end=2.6)), drives=("open loop",), jobs=1)


@pytest.mark.long
def test_the_trials_do_not_depend_on_the_number_of_processes():
    options = {"scenarios": (SHORT,), "drives": ("open loop",), "seed": 5}
    assert robustness_study(2, jobs=1, **options).trials == robustness_study(2, jobs=2, **options).trials


def test_the_largest_forces_are_those_of_every_period(monkeypatch: pytest.MonkeyPatch):
    put_out: list[np.ndarray] = []
    real = NoisyAmplifier.effort

    def recorded(self, t, state):
        put_out.append(np.concatenate(real(self, t, state)))
        return put_out[-1][:2], put_out[-1][2:]

    monkeypatch.setattr(NoisyAmplifier, "effort", recorded)
    outcome = run_trial(SHORT, "computed torque", Imperfections(), 0, 3)
    acted = np.abs(put_out[:-1])  # the last has not had the time to act
    assert outcome.effort == acted[:, :2].max()
    assert outcome.carrier_force == acted[:, 2:].max()


@pytest.mark.long
def test_a_plan_that_hardly_uses_its_main_actuators_crosses_against_friction():
    """With τ̂ the largest planned effort alone, 0.08 N, carrier 1 comes to the end of its track in every draw."""
    bounds = scaled(Imperfections(), 5.0)
    outcome = run_trial(Scenario(LINE_WHOLE, 1.9, 3.1), "computed torque", bounds, 0, 0)
    assert outcome.success


@pytest.mark.parametrize("changed", [{"draws": 0}, {"jobs": 0}])
def test_numbers_out_of_their_domain(changed):
    with pytest.raises(InputError, match="a whole number from 1"):
        robustness_study(**{"draws": 1, "jobs": 1, **changed})


# ---------------------------------------------------------------------------------- what a store of trials depends on


@pytest.fixture
def begun(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict:
    """A study with a store, whose simulations are stood in for."""
    monkeypatch.setattr(study, "run_trial", lambda scenario, drive, bounds, seed, number: trial(number, drive=drive))
    options = {"scenarios": (SHORT,), "drives": ("LQR",), "journal": tmp_path / "a" / "store", "jobs": 1}
    robustness_study(1, **options)
    robustness_study(2, **options)  # goes on
    return options


def test_another_study_is_refused_and_named(begun: dict, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(says: str, **changed) -> None:
        with pytest.raises(OutputError, match=says):
            robustness_study(2, **{**begun, **changed})

    refused("for seed it has 0, now it is 1", seed=1)
    refused(r"for imperfections\.mass it has 0\.05, now it is 0\.1", severity=2.0)
    refused(r"for scenarios\.line, switch off\.?", scenarios=(replace(SHORT, end=2.6),))
    refused(r"for scenarios\.line, switch off", scenarios=(replace(SHORT, case=LINE_OFF.with_options(threshold=5.0)),))
    with monkeypatch.context() as patched:  # of functions, so that the code stays the same
        patched.setitem(ComputedTorque.__init__.__kwdefaults__, "bandwidth", 25.0)
        refused(r"for computed torque\.bandwidth it has 30\.0, now it is 25\.0.*delete it")
    with monkeypatch.context() as patched:
        patched.setitem(bryson_weights.__kwdefaults__, "carrier", 0.02)
        refused(r"for LQR\.carrier it has 0\.01, now it is 0\.02")
    with monkeypatch.context() as patched:
        patched.setattr(study, "versions", lambda *names: {**dict.fromkeys(names, ""), "scipy": "9"})
        refused(r"for libraries\.")
    with monkeypatch.context() as patched:
        patched.setattr(study, "code_digest", lambda: "another")
        refused(r"for code it has .*, now it is 'another'")
    assert len(robustness_study(2, **begun).trials) == 2


def test_the_code_is_that_of_the_trials_and_the_models(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A changed line of a planner or a model counts; one of the command line or of a picture does not."""
    package = tmp_path / "redundancy_pin"
    shutil.copytree(Path(redundancy_pin.__file__).parent, package, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copytree(models_root(), tmp_path / "models", dirs_exist_ok=True)
    before = code_digest()
    monkeypatch.setattr(redundancy_pin, "__file__", str(package / "__init__.py"))
    monkeypatch.setattr(study, "models_root", lambda: tmp_path / "models")
    assert code_digest() == before

    def changed(place: Path) -> bool:
        kept = place.read_bytes()
        place.write_bytes(kept + b"\n# changed\n")
        digest = code_digest()
        place.write_bytes(kept)
        return digest != before

    decides = ["planners/plan.py", "simulation/simulate.py", "arrays.py", "studies/trial.py"]
    assert [name for name in (*decides, "studies/case.py") if not changed(package / name)] == []
    assert changed(tmp_path / "models" / "2rpr" / "robot.yaml")
    for name in ("cli/studies.py", "view.py", "studies/robustness.py", "studies/store.py", "workers.py"):
        assert not changed(package / name)


def test_what_decides_is_plain_and_differs_with_bounds_and_seed() -> None:
    one = identity(Imperfections(), 0, (SHORT,))
    assert json.loads(json.dumps(one)) == one
    assert one["computed torque"] == {"bandwidth": 30.0, "carrier_bandwidth": 10.0, "damping": 1.0}
    assert one["imperfections"]["start_position"] == 2e-4
    assert one["libraries"]["numpy"]
    assert one != identity(replace(Imperfections(), noise=0.1), 0, (SHORT,))
    assert one != identity(Imperfections(), 1, (SHORT,))
