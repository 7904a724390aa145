"""``redundancy-pin identify``: files in, a robot, a report and exit codes out."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from command_line import call, refused
from measured import built, measured, noisy, true_values

import redundancy_pin as rp
from redundancy_pin.errors import OutputError
from redundancy_pin.identification import Records
from redundancy_pin.identification.robot_file import write_robot


def columns_of(records: Records) -> dict[str, np.ndarray]:
    joints = ("base_1", "base_2")
    return {
        "t [s]": records.t,
        **{f"q:{joint} [deg]": np.degrees(column) for joint, column in zip(joints, records.position.T, strict=True)},
        **{f"tau:{joint} [N*m]": column for joint, column in zip(joints, records.effort.T, strict=True)},
        "note": np.zeros(len(records)),
    }


def write(path: Path, columns: dict[str, np.ndarray]) -> Path:
    rows = np.stack(list(columns.values()), axis=1)
    np.savetxt(path, rows, delimiter=",", header=",".join(columns), comments="", fmt="%.12g")
    return path


def machine() -> rp.RneaDynamics:
    """A five-bar without carriers with other masses and friction than declared."""
    given = rp.load_robot("five_bar").loaded(*(rp.JointForces(j, friction_speed=0.01) for j in ("base_1", "base_2")))
    return rp.RneaDynamics(built(given))


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Records]:
    """A file with the columns of the motors, and what is in it."""
    records = noisy(measured(machine(), seconds=3.0), seed=1)
    folder = tmp_path_factory.mktemp("run")
    return write(folder / "run.csv", columns_of(records)), records


def test_a_machine_is_identified_and_its_file_loads_as_what_was_found(
    run: tuple[Path, Records], tmp_path: Path
) -> None:
    path, records = run
    out, page = tmp_path / "found.yaml", tmp_path / "fit.html"
    given = ("--robot", "five_bar", "--records", path, "--cut-off", "12")
    result = call("identify", *given, "--out", out, "--report", page, "--json")
    assert (result.exit_code, result.stderr) == (0, "")
    facts = json.loads(result.stdout)
    fit = rp.identify("five_bar", records, cut_off=12.0, physical=True)
    assert facts["names"] == list(fit.base.names)
    assert np.allclose(facts["values"], fit.values, rtol=1e-6)
    assert np.allclose(facts["half_intervals"], 1.959964 * fit.standard_deviation, rtol=1e-5)
    write_robot(fit.robot, tmp_path / "again.yaml")
    again = rp.load_robot(tmp_path / "again.yaml")
    for one, other in zip(again.model.inertias, fit.robot.model.inertias, strict=True):
        assert np.allclose(one.toDynamicParameters(), other.toDynamicParameters(), atol=1e-12)
    # records of the command have twelve digits: masses that the motion does not show move by more than those it shows
    loaded, expected = (true_values(fit, robot) for robot in (rp.load_robot(out), fit.robot))
    assert (np.abs(loaded - expected) < 0.01 * fit.standard_deviation).all()
    html = page.read_text(encoding="utf-8")
    assert html.count("data:image/png;base64,") == 3
    assert not re.search(r"<script|https?://", html)
    assert f"{len(fit.base.unseen)} parameters are not shown" in html
    assert all(f"{value:.5g}" in html for value in fit.values)
    table = call("identify", *given).stdout
    assert all(f"{value:.5g}" in table for value in fit.values)


@pytest.mark.parametrize(
    ("change", "named"),
    [
        pytest.param(lambda r: Records(r.t, r.effort * [1.0, -1.0], r.position), "those of base_1, -base_2", id="sign"),
        pytest.param(lambda r: Records(r.t, -r.effort, r.position), "those of -base_1, -base_2", id="all signs"),
        pytest.param(lambda r: Records(r.t, r.effort[:, ::-1], r.position), "those of base_2, base_1", id="swapped"),
        pytest.param(
            lambda r: Records(r.t[25:], r.effort[:-25], r.position[25:]), "Efforts 0.1 s later", id="shifted time"
        ),
        pytest.param(
            lambda r: Records(r.t[:150], r.effort[:150], r.position[:150]), "more motion is needed", id="short"
        ),
        pytest.param(
            lambda _: noisy(measured(machine(), seconds=3.0, speed=0.5), seed=1), "more motion is needed", id="slow"
        ),
    ],
)
def test_bad_measurements_are_named_on_stderr_and_by_the_exit_code(
    run: tuple[Path, Records], tmp_path: Path, change: Callable[[Records], Records], named: str
) -> None:
    path = write(tmp_path / "run.csv", columns_of(change(run[1])))
    result = call("identify", "--robot", "five_bar", "--records", path, "--cut-off", "12")
    assert result.exit_code in (1, 4)
    assert any(line.startswith("warning: ") and named in line for line in result.stderr.splitlines())


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: c.pop("tau:base_1 [N*m]"), "no column 'tau:base_1'"),
        (lambda c: c.pop("q:base_2 [deg]"), "no column 'q:base_2'"),
        (lambda c: c.pop("t [s]"), "no column 't'"),
        (lambda c: c.update({"q:base_1 [deg/s]": c.pop("q:base_1 [deg]")}), "deg/s"),
        (lambda c: c.update({"t [s]": c["t [s]"][::-1]}), "does not increase"),
        (lambda c: c.update({"tau:base_1 [kg]": c.pop("tau:base_1 [N*m]")}), "kg"),
        (lambda c: c.update({"tau:base_1": c["tau:base_1 [N*m]"]}), "more than once"),
        (lambda c: c.update(zip(list(c)[1:3], [c[k] for k in list(c)[2:0:-1]], strict=True)), "zero and unit of the"),
    ],
)
def test_bad_records_are_one_line(run: tuple[Path, Records], tmp_path: Path, change, message: str) -> None:
    columns = columns_of(run[1])
    change(columns)
    path = write(tmp_path / "run.csv", columns)
    assert message in refused("identify", "--robot", "five_bar", "--records", path, "--cut-off", "12")


def test_bad_outputs_are_refused_before_the_work(run: tuple[Path, Records], tmp_path: Path) -> None:
    given = ("identify", "--robot", "five_bar", "--records", run[0], "--cut-off", "12")
    assert "--out" in refused(*given, "--out", tmp_path / "found.urdf")
    assert "--report" in refused(*given, "--report", tmp_path / "fit.txt")
    assert "mas of" in refused(*given, "--parameters", "mas of *")
    in_part = refused(*given, "--parameters", "moment x*", "--out", tmp_path / "found.yaml")
    assert "--out seeks real bodies" in in_part
    assert "physical" not in in_part
    light = rp.identify("five_bar", run[1], cut_off=12.0).robot
    with pytest.raises(OutputError, match=r"No body can have the inertia of .*physical=True"):
        write_robot(light, tmp_path / "light.yaml")
    assert not list(tmp_path.iterdir())
