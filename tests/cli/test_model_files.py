"""Commands on files that describe a whole mechanism: a model of MuJoCo is a robot like any other."""

import json

import numpy as np
import pytest
from command_line import call, refused
from mjcf_models import FOUR_BAR, write

import redundancy_pin as rp


@pytest.fixture
def model(tmp_path):
    return write(tmp_path, FOUR_BAR)


def test_info_says_what_was_chosen_and_what_is_not_in_force(model):
    facts = json.loads(call("info", "--robot", model, "--json").stdout)
    assert facts["name"] == "four_bar"
    assert facts["independent"]["joints"] == ["crank"]
    assert facts["closures"] == [{"frame_a": "tip", "frame_b": "end", "axes": ["x", "y"], "length": None}]
    assert any("springs of crank" in note for note in facts["notes"])
    assert facts["parameters"]["base"] == {"value": "free", "default": "free"}
    text = call("info", "--robot", model).stdout
    assert "springs of crank" in text.replace("\n", " ")


def test_inverse_dynamics_and_mistakes(model, tmp_path):
    robot = rp.load_robot(model)
    motion = tmp_path / "motion.csv"
    x = float(robot.q_reference[0])
    motion.write_text(f"t,x0,xd0,xdd0\n0.0,{x!r},0.5,1.0\n")
    out = tmp_path / "out.csv"
    call("inverse-dynamics", "--robot", model, "--motion", motion, "--out", out)
    names, row = (line.split(",") for line in out.read_text().splitlines())
    tau = float(row[names.index("tau:crank [N*m]")])
    expected = rp.distribute(rp.RneaDynamics(robot).reduce(rp.PlatformMotion([0.0], [[x]], [[0.5]], [[1.0]]))).tau[0, 0]
    assert tau == pytest.approx(expected, rel=1e-9)
    assert np.isfinite(tau)
    assert "no argument 'carriers'" in refused("info", "--robot", model, "--set", "carriers=true")
    model.write_text(FOUR_BAR.replace("<light", "<lamp"))
    said = refused("info", "--robot", model)
    assert "MuJoCo refuses it" in said
    assert "line 10" in said


def test_plans_know_their_model_again(model, tmp_path):
    from redundancy_pin.planners.robot_record import load_recorded, robot_record

    robot = rp.load_robot(model, gravity=(0.0, 0.0, -1.0))
    again = load_recorded(robot_record(robot))
    np.testing.assert_array_equal(again.q_reference, robot.q_reference)
    np.testing.assert_array_equal(again.gravity, robot.gravity)


def test_validation_knows_friction_and_springs(tmp_path):
    """Power that friction takes, springs, and the same in forward dynamics; a law of the other sign would not pass."""
    joint = '<joint name="elbow" class="main" stiffness="3" springref="0.2" frictionloss="0.1"/>'
    text = FOUR_BAR.replace('<joint name="elbow" class="main"/>', joint)
    assert joint in text
    path = write(tmp_path, text)
    report = json.loads(call("validate", "--robot", path, "--samples", "100", "--json").stdout)
    rows = report["rows"]
    assert {"power balance (rnea)", "inverse -> forward (rnea)"} <= {row["check"] for row in rows}
    assert all(row["passed"] and row["samples"] > 50 for row in rows)
