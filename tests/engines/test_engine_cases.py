"""Every case in every engine, to 1e-5 m over the whole motion without control: ``make engines``."""

import re
from pathlib import Path

import pytest
from engines import deviation, run_exudyn, run_mujoco
from engines.cases import CASES, prepare

import redundancy_pin as rp
from redundancy_pin.status import ResultStatus

pytestmark = pytest.mark.engines

MOTION_TOLERANCE = 1e-5
"""m and rad, platform and carriers, at every step of the whole motion."""

STEP = 1.25e-4
"""s. The largest error of all cases at 1 ms falls with the square of the step below the tolerance here."""


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
@pytest.mark.parametrize("engine", [run_exudyn, run_mujoco], ids=["exudyn", "mujoco"])
def test_the_planned_efforts_make_the_planned_motion(engine, case):
    if engine is run_mujoco and not case.mujoco:
        pytest.skip("MuJoCo needs inertia at every joint of the open tree")
    drive = prepare(case, rp.RneaDynamics)
    robot, trajectory = drive.task.robot, case.trajectory(drive.task.robot)
    met = [crossing for crossing in rp.find_crossings(robot, trajectory) if crossing.kind.label == "type_ii"]
    assert len(met) == case.crossings
    assert all(crossing.crosses for crossing in met)
    run = engine(drive.task, step=STEP)
    assert run.status == ResultStatus.OK
    assert deviation(drive, run).largest < MOTION_TOLERANCE


def test_the_example_of_the_page_runs_as_written(capsys):
    page = Path(__file__).resolve().parents[2] / "docs" / "validation.md"
    example = re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), flags=re.DOTALL)[0]
    exec(compile(example, page.name, "exec"), {})
    status, *errors = capsys.readouterr().out.split()
    assert status == "ResultStatus.OK"
    assert all(float(error) < MOTION_TOLERANCE for error in errors)
