"""Every mistake on the command line ends with one line on stderr, its exit code, and no file written or changed."""

from __future__ import annotations

import re
import shlex
import shutil
from pathlib import Path

import pytest
from click.shell_completion import ShellComplete
from command_line import call, refused, write_motion

import redundancy_pin as rp
from redundancy_pin.cli import main
from redundancy_pin.trajectory import reference

BASES = {
    "LINE": "plan switch-off --robot 2rpr --motion line --threshold 4 --dt 0.01",
    "CORNER": "plan stepwise --robot 3rrr --working-mode +++ --motion corner --dt 0.02",
    "CIRCLE": "plan whole-trajectory --robot 2rpr --backend virtual-work --motion circle --dt 0.02",
    "FAST": "plan time-optimal --robot 3rrr --working-mode +++ --motion corner --set carriers=false",
    "ONLINE": "online --robot 2rpr --set end_effector_mass=0.5 --set cylinder_mass=0.3 --motion circle",
    "EFFORTS": "inverse-dynamics --robot 2rpr --motion circle.csv --out o.csv",
    "OTHERS": "inverse-dynamics --robot 3rrr --motion corner.csv --out o.csv",
    "RUN": "simulate --plan plan.npz",
    "LIGHT": "simulate --robot 2rpr --motion timed.csv",
    "TURN": "inverse-dynamics --robot 3rrr --out o.csv --dt 0.01 --motion",
    "ROUND": "circle:radius=0.02,centre=1 0.45",
    "LONG": "a" * 300,
    "SING": "singularities --robot 2rpr",
    "WALK": "singularities --robot 2rpr --motion",
    "SPACE": "workspace --robot five_bar",
}
"""Commands that run, to which the table adds a mistake; a later flag replaces an earlier one."""

MISTAKES = [
    line.split(" => ")
    for line in """
nonsense => No such command 'nonsense'
plan => No task given
 => Missing command
info --set a=1 => --set
info --robot 4rrr => There is no robot '4rrr'
{FAST} --effort inf --actuator-speed inf => Nothing limits the time
{FAST} --effort 3 --lap => The path ends 0.145 from where it begins
{FAST} --effort 3 --begin somehow => error: --begin: begin is 'somehow'
{CORNER} --motion corner:speed=-1 --speed 2 => error: --motion: speed is -1
{LINE} --return-time soon --ramp-down=0.1 => error: --return-time: return_time is 'soon'
{LINE} --ramp-down=-1 => error: --ramp-down: ramp_down is -1
{LINE} --set carrier_mass=2 --set carrier_mass=3 => --set has 'carrier_mass' twice
{CORNER} --lam 0.5 --baseline carriers=false --baseline carriers=true => --baseline has 'carriers' twice
{CIRCLE} --at-most peak => Write peak=NUMBER
{CIRCLE} --at-most peak=3 --at-most effort => Write effort=NUMBER
{CIRCLE} --track=-0.1,0.1;-0.2 => track is
{CIRCLE} --track=0.1 => error: --track: track is 0.1
{CIRCLE} --track=0.1,-0.1 => error: --track: track is [0.1, -0.1]
{CIRCLE} --at-most peak=x => error: --at-most: peak in at_most is 'x'
{CIRCLE} --objective peak=x => error: --objective: peak in objective is 'x'
{RUN} --seed 3 => error: --seed: seed is that of the noise
validate --robot 3rrr --jobs -2 => or -1 for one process per core
{ONLINE} --horizon soon => horizon is 'soon'
{ONLINE} --objective beauty => objective is 'beauty'
{ONLINE} --html a.pdf => Cannot write a.pdf
{ONLINE} --tick -1 => tick is -1 s
{ONLINE} --start 0,0,0 => start is [0.0
{ONLINE} --step 0 => step is 0 s
{ONLINE} --step 20 --horizon 500 => error: --step: step is 20 s, and the whole motion takes 2.68 s
{ONLINE} --step 1 --horizon 200 => error: --horizon: horizon is 200 s, and the whole motion takes 2.68 s
{ONLINE} --start 30 => error: --start: start puts carrier_1 at 30 m
plan --robot 2rpr --motion circle => Write plan NAME --robot ..., with one of switch-off, stepwise, whole-trajectory
plan --robot 2rpr whole-trajectory --motion circle => Write plan whole-trajectory --robot 2rpr --motion circle.
plan --problem task.yaml --robot 2rpr => --robot does not go with --problem
plan --robto 2rpr => No such option '--robto'
{ONLINE} --out a.csv => --out a.csv does not end in .npz
online --robot 3rrr --set carriers=false --motion corner => 3rrr has no carriers to plan for
online --robot 2rpr => On-line planning needs a motion
plan stepwise --robot 3rrr => A plan needs a motion
{LINE} --motion {LONG} => The trajectory is 'aaaa
{LINE} --motion lien => The trajectory is 'lien'
{LINE} --motion line:radius=0.1 => The trajectory line has no key 'radius'
{LINE} --motion line:sped=0.1 => The trajectory line has no key 'sped'
{LINE} --motion line:speed=0.1,speed=0.2 => speed of the trajectory is given twice
{LINE} --motion line:speed => 'speed' of the trajectory is not KEY=VALUE. Write
{LINE} --motion 'line:speed=a;b' => speed of the trajectory line is 'a;b'
{LINE} --motion line:speed= => speed of the trajectory line is ''
{LINE} --motion line:speed=fast => speed of the trajectory line is 'fast'
{LINE} --motion line:speed=-1 => speed is -1 m/s
{LINE} --motion line:ramp_time=-1 => ramp_time is -1 s
{LINE} --motion corner => The motion has 3 coordinates
{LINE} --threshold high => threshold is 'high'
{LINE} --threshold 0.5 => threshold is 0.5
{LINE} --threshold inf => threshold is inf
{LINE} --measure distance => measure is 'distance'
{LINE} --return-time longest => return_time is 'longest'
{LINE} --datum 0,0,0 => datum is [0.0
{LINE} --datum abc => datum is 'abc'
{LINE} --datum 1 => datum puts carrier_1 at 1 m
{LINE} --ramp-down 0 => ramp_down is 0 s
{LINE} --gravity 0,inf,0 => gravity is '0,inf,0'
{LINE} --out nowhere/plan.npz => Cannot write nowhere/plan.npz
{LINE} --out plan => --out plan does not end in .npz
{LINE} --plot plan.txt => Cannot write plan.txt
{LINE} --plot nowhere/plan.png => Cannot write nowhere/plan.png
{LINE} --treshold 5 => No such option '--treshold'
{LINE} --thresh 5 => No such option '--thresh'. Did you mean '--threshold'?
{LINE} --return-time 100 => The return of the carriers takes 100 s from t = 5.11191 s
{LINE} --set end_effector_mass=1 --motion circle => At the singular pose
{CORNER} --dt 0 => dt is 0 s
{CORNER} --speed 1,2 => speed is [1.0
{CORNER} --acceleration 0 => acceleration is 0.0
{CORNER} --track 1,-1 => track is [1.0
{CORNER} --track 1,2,3 => track is [1.0
{CORNER} --start 0,0 => start is [0.0
{CORNER} --start 5 => start puts carrier_1 at 5 m
{CORNER} --least-margin 2 => The motion comes too close to a type II singularity
{CORNER} --robot five_bar --working-mode +- --backend virtual-work => Virtual work is written out for the 2-RPR and
{CORNER} --motion corner:radius=10 => The pose of sample 415 (t = 8.28 s
{CIRCLE} --objective efort => objective is ['efort']
{CIRCLE} --objective peak=1 --objective peak=2 => objective has 'peak' twice
{CIRCLE} --objective peak=-1 => A weight of the objective is -1.0
{CIRCLE} --objective peak=0 => Nothing to minimise
{CIRCLE} --objective tracking --lam 0.5 => lam = 0.5 asks for a fraction of the baseline effort
{CIRCLE} --end resting => end is 'resting'
{CIRCLE} --starts 1.5 => starts is '1.5'
{CIRCLE} --starts 0 => starts is 0
{CIRCLE} --refinements -1 => refinements is -1
{CIRCLE} --seconds 0 => seconds is 0 s
{CIRCLE} --datum 0.5 => datum puts carrier_1 at 0.5 m
{CIRCLE} --effort 1,2,3 => effort is [1.0
{CIRCLE} --jerk 0 => jerk is 0.0
{CIRCLE} --carrier-force big => carrier_force is 'big'
{CIRCLE} --threshold 5 => No such option '--threshold'
plan --out x.npz switch-off --robot 2rpr --motion line --threshold 4 --dt 0.01 => Options before the name of the
plan stepwise --robot 3rrr --motion corner.csv:ramp_time=0.2 => ramp_time does not apply to a motion from a file that
plan stepwise --robot 3rrr --motion corner.csv --dt 0.2 => dt does not apply
plan stepwise --robot 3rrr --set carriers=false --motion corner => 3rrr has no carriers to plan for
inverse-dynamics --robot 3rrr --motion corner.csv --out e9.csv --wrench end_effector=1,0,0 => The model has no link
{EFFORTS} --payload end_effector => payload is 'end_effector'
{EFFORTS} --wrench end_effector=1,2,x => wrench of end_effector is 'x'
{EFFORTS} --payload end_efector=1 => The model has no link 'end_efector'
{EFFORTS} --lower 3 --upper 1 => error: --lower: lower is above upper for actuator 0 (first at sample 0)
{EFFORTS} --upper nan => upper has 2 value(s) that are not finite
{EFFORTS} --upper 1,2,3 => error: --upper: upper has shape (3,), expected (2,)
{EFFORTS} --preferred 1,2,3 => preferred has shape (3,)
{OTHERS} --motion nowhere.csv => nowhere.csv cannot be read
{OTHERS} --set carrier_mass => 'carrier_mass' is not NAME=VALUE. Write carrier_mass=2.0
{OTHERS} --set carrier_mass=inf => The argument 'carrier_mass' is inf
{OTHERS} --set gravity=1 => gravity is no parameter of the robot
{OTHERS} --working-mode abc => working_mode is 'abc'
{OTHERS} --gravity 0,-9.81 => gravity is '0,-9.81'
{OTHERS} --backend lagrange => Invalid value for '--backend'
{OTHERS} --bakend rnea => No such option '--bakend'
{OTHERS} --out nowhere/o.csv => Cannot write nowhere/o.csv
{OTHERS} --out . => --out . does not end in .csv
{OTHERS} --out / => --out / does not end in .csv
{OTHERS} --motion bad1.csv => bad1.csv has no column 'xd1'
{OTHERS} --motion bad2.csv => bad2.csv has 0 rows of numbers
{OTHERS} --out corner.csv => --out is the file corner.csv to read from
{OTHERS} --motion circle.csv => The motion has 2 coordinates
{SING} => No task given
{SING} --plot l.txt => Cannot write l.txt
singularities --robot 3rrr --motion circle => The motion has 2 coordinates
singularities --robot gough --plot l.png => The singular locus of gough cannot be drawn
singularities --robot gough --motion circle => The motion has 2 coordinates
{SPACE} --free q => free is ('q',)
{SPACE} --bounds a => bounds is 'a'
{SPACE} --at x => at is 'x'
workspace --robot gough --at 0,0,1 => at has shape (3,)
{SPACE} --out w.txt => --out w.txt does not end in .csv
{SPACE} --resolution 1 => resolution is 1
validate --robot 4rrr => There is no robot '4rrr'
validate --robot 3rrr --samples -1 => samples is -1
check nowhere.npz => nowhere.npz does not exist
export plan.npz --to l.txt => --to l.txt does not end in .csv or .json or .mat or .yaml or
export plan.npz --to l.csv --rate 0 => rate is 0 Hz
export plan.npz --to l.csv --rate 1e12 => at most 10000000 are possible. Use a lower rate
plan stepwise --robot 2rpr --motion circle --lam 0.5 => load_robot("2rpr", carriers=False)
export plan.npz --to l.csv --ros => --ros does not go with .csv
export plan.npz --to l.yaml --two-sided => A JointTrajectory has one point at a time
export plan.npz --to nowhere/l.csv => Cannot write nowhere/l.csv
export plan.npz --to plan.npz => --to plan.npz does not end in .csv or .json or .mat or .yaml
{RUN} --motion circle => --plan and --motion are both given
{RUN} --park 0.1 => --plan and --park are both given
{RUN} --set carrier_mass=2 => --set
{RUN} --machine charm=2 => 3rrr.urdf.xacro has no argument 'charm'
{RUN} --noise 1 => error: --noise: noise goes with a sampled controller
{RUN} --noise -1 --period 0.01 => noise is -1.0
{RUN} --delay 1 => error: --delay: delay goes with a sampled controller
{RUN} --encoders => error: --encoders: encoders goes with a sampled controller
{RUN} --period -1 => --period: period is -1 s, expected a positive number
{RUN} --period 2 => error: --period: period is 2 s, and the whole motion takes
{RUN} --dt 1 => error: --dt: dt is 1 s, and the whole motion takes
{RUN} --backend virtual-work => 'virtual-work' is not one of 'rnea', 'compiled'
{RUN} --friction 0.1 => Write revolute_coulomb=0.02
{RUN} --friction coulomb=1 => error: --friction: friction has no 'coulomb'
{RUN} --friction revolute_coulomb=-1 => revolute_coulomb is -1.0
{RUN} --effort-limit 1,2 => effort_limit is [1.0
{RUN} --duration -1 => --duration: duration is -1 s
{RUN} --dt -1 => dt is -1 s
{RUN} --noise 1 --period 0.01 --seed -3 => error: --seed: seed is -3
{RUN} --out run.txt => --out run.txt does not end in .npz or .csv
{RUN} --out plan.npz => --out is the file plan.npz to read from
{RUN} --plot run.txt => Cannot write run.txt
simulate => There is nothing to simulate
simulate --robot 3rrr => A simulation without a plan needs a motion
simulate --robot five_bar --motion circle --park 0.1 => is [0.1], but the robot has no carriers
simulate --robot 2rpr --motion circle --park 0,0,0 => The place of parked carriers has 3 values for 2 carriers
simulate --robot 2rpr --motion circle => The motion has no finite efforts at t = 0.519414238 s
simulate --robot gough --motion circle => The motion has 2 coordinates
show --html x.html => There is nothing to show
show four_bar --robot 3rrr --html x.html => The robot is given twice
show --plan plan.npz --motion in.csv --html x.html => --plan and a motion are both given
show --plan plan.npz --working-mode ++ --html x.html => --set
show --plan plan.npz --robot 2rpr --html x.html => The robot 2rpr at 2rpr is not the one the plan was made for, 3rrr
show --robot 3rrr --html none/x.html => no folder
show --robot 3rrr --html x.png => Cannot write x.png
show --robot 3rrr --force-scale 0 --html x.html => force_scale is 0
codegen --robot four_bar => Missing option '--out'
codegen --robot four_bar --out code --prefix 1a => prefix is '1a'
{OTHERS} --upper 1,2 => upper has shape (2,), expected (3,)
{WALK} way.csv => Neither times nor speed
{WALK} way.csv:times=soon => times of the trajectory way.csv is 'soon'
{WALK} way.csv:spead=1 => Did you mean 'speed'
{WALK} timed.csv:speed=1 => times of its own
{WALK} way.csv:speed=0.2,ends=rest => ends is given, and has no effect
{WALK} timed.csv:ends=soon => ends is 'soon'
{WALK} circle:ends=rest => has no key 'ends'
{WALK} way.csv:times=time-optimal,max_speed=0.5,max_acceleration='2 3' => different numbers
inverse-dynamics --robot 2rpr --motion timed.csv --dt 0 --out o.csv => dt is 0 s
{EFFORTS} --dt 0.1 => dt does not apply
inverse-dynamics --robot 2rpr --motion timed.csv --out timed.csv => --out is the file timed.csv to read from
{SPACE} --free x,x => Name each once
{SPACE} --bounds 0:1,a:b => LOW:HIGH
{SPACE} --at 3,3 => chains stay open
workspace --robot gough --at 0,0,0.6,0,0,0,2 => norm
codegen --robot four_bar --out plan.npz => plan.npz
validate --samples 0 => samples is 0
validate --samples many => many
validate --robot 3rrr --set carrier_mas=1 --samples 5 => no argument 'carrier_mas'
new nowhere.xml => it does not exist
new corner.csv => no model of a robot
new crank.urdf --guess crank => guess is 'crank', not JOINT=VALUE
info --robot 3rrr --set base_radius=30 => does not close
info 3rrr => 3rrr
info --robot twice.yaml => line 3
plan --problem nowhere.yaml => cannot be read
{EFFORTS} --motion backwards.csv => increase
{EFFORTS} --motion off_track.csv => leaves its track
""".strip().splitlines()
]
"""Command line, and what its one line on stderr has in it."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the files that the table names."""
    folder = tmp_path_factory.mktemp("mistakes")
    write_motion(folder / "corner.csv", reference.corner(), 0.05)
    write_motion(folder / "circle.csv", reference.circle(), 0.5)
    head = "t,x0,x1,xd0,xd1,xdd0,xdd1"
    texts = {
        "far.csv": f"{head}\n0,0.25,0.7,0,0,0,0\n1,5.0,0,0,0,0,0\n2,0.3,0.7,0,0,0,0\n",
        "bad1.csv": "t,x0,x1,xd0\n0,1,1,0\n",
        "bad2.csv": "",
        "backwards.csv": f"{head}\n1,0.2,0.3,0,0,0,0\n0,0.2,0.3,0,0,0,0\n",
        "off_track.csv": f"{head},s0,s1,sd0,sd1,sdd0,sdd1\n0,0.2,0.3,0,0,0,0,0.5,0,0,0,0,0\n",
        "way.csv": "x,y\n0.15,0.3\n0.2,0.25\n0.25,0.3\n",
        "timed.csv": "t,x,y\n0,0.15,0.3\n0.6,0.2,0.25\n1.1,0.25,0.3\n",
        "twice.yaml": "name: x\nurdf: x.urdf\nname: y\n",
        "crank.urdf": "<robot name='crank'/>",
    }
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    rp.plan_stepwise("3rrr", reference.corner(), mesh=rp.Mesh(dt=0.2)).save(folder / "plan.npz")
    return folder


@pytest.mark.parametrize(("line", "says"), MISTAKES, ids=[" ".join(case)[:90] for case in MISTAKES])
def test_mistakes_are_one_line_and_nothing_is_written(
    line: str, says: str, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    assert says in refused(*shlex.split(line.format(**BASES)))
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


@pytest.mark.parametrize(
    ("line", "remedy", "done"),
    [
        ("{OTHERS} --out o.txt", "Write --out o.csv.", "--out o.csv"),
        ("{CORNER} --lam 0.5", "on the command line --baseline carriers=false", "--baseline carriers=false"),
        ("{OTHERS} --robot five_bar --motion far.csv", 'unreachable="mark"', "--unreachable mark"),
        ("{OTHERS} --robot five_bar --motion near.csv --backend virtual-work", "the backend rnea", "--backend rnea"),
        ("{OTHERS} --working-mode ++", "Give one sign per leg: +++", "--working-mode +++"),
        ("{OTHERS} --set carrier_mas=2", "Did you mean 'carrier_mass'?", ""),
        ("{RUN} --duration 0.02 --noise 0.1", "(--period 0.001)", "--period 0.001"),
        ("{LIGHT} --duration 0.02", "or --set end_effector_mass=0.1", "--set end_effector_mass=0.1"),
        ("{TURN} '{ROUND}'", "Add alpha=0 to the trajectory", "--motion '{ROUND},alpha=0'"),
        ("{TURN} 'circle:radius=0.02,centre=1,0.45,alpha=0'", "'centre=1 0.45'", "--motion '{ROUND},alpha=0'"),
        ("{RUN} --duration 0.02 --stop-at never --stop-at track", "Give one or the other", ""),
    ],
)
def test_what_a_remedy_says_works(
    line: str, remedy: str, done: str, folder: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    shutil.copytree(folder, tmp_path / "copy")
    monkeypatch.chdir(tmp_path / "copy")
    Path("near.csv").write_text("t,x0,x1,xd0,xd1,xdd0,xdd1\n0,0.25,0.7,0,0,0,0\n", encoding="utf-8")
    line = line.format(**BASES)
    assert remedy in refused(*shlex.split(line))
    for mistake, right in (("carrier_mas=", "carrier_mass="), ("--stop-at never ", "")):  # fmt: skip
        line = line if done else line.replace(mistake, right)
    assert call(*shlex.split(f"{line} {done.format(**BASES)}")).exit_code in (0, 3, 4)


def test_what_is_said_to_suffice_suffices() -> None:
    """As it is read: every limit by that much more, not one alone; a free end is no advice where it is free."""
    line = "plan whole-trajectory --robot 3rrr --working-mode +++ --motion corner --dt 0.03 --end"
    efforts = [0.3, 0.4, 0.4]
    said = refused(*line.split(), "free", "--effort", ",".join(map(str, efforts)))
    found = re.search(r"every effort limit by (\S+) % \(most needed by base_(\d), from (\S+) to (\S+) N·m, at", said)
    assert found is not None, said
    share, joint, before, after = 0.01 * float(found[1]), int(found[2]) - 1, float(found[3]), float(found[4])
    assert (before, after) == (efforts[joint], pytest.approx(before * (1.0 + share), rel=5e-3))
    assert "the end free" not in said
    wider = [limit * (1.0 + 1.04 * share) for limit in efforts]
    done = call(*line.split(), "free", "--effort", ",".join(map(str, wider)))
    assert done.exit_code == 0, done.stderr
    alone = [*efforts[:joint], wider[joint], *efforts[joint + 1 :]]
    assert "every effort limit" in refused(*line.split(), "free", "--effort", ",".join(map(str, alone)))
    assert "or leave the end free" in refused(*line.split(), "datum", "--effort", "0.5")


def test_a_coarse_mesh_does_not_promise_a_few_per_cent() -> None:
    """With 2 % more than what is said the plan is refused again; a mesh that is fine says what suffices."""
    line = ["plan", "whole-trajectory", "--robot", "2rpr", "--motion", "circle:speed=1"]
    needed = {}
    for dt, more in (("0.03", "by more than that (how much is found with a shorter dt)"),
                     ("0.0075", "by a few per cent more than that")):  # fmt: skip
        said = refused(*line, "--dt", dt, "--effort", "0.3")
        found = re.search(r"every effort limit .* from 0.3 to (\S+) N", said)
        assert found is not None
        assert more in said
        coarse = re.search("of a coarse mesh: efforts between its nodes are up to [1-9.]+ times as large", said)
        assert (coarse is not None) == (dt == "0.03")
        needed[dt] = str(1.02 * float(found[1]))
    refused(*line, "--dt", "0.03", "--effort", needed["0.03"])
    assert call(*line, "--dt", "0.0075", "--effort", needed["0.0075"]).exit_code == 0


def test_values_are_completed() -> None:
    def of(*given: str, begun: str) -> set[str]:
        shell = ShellComplete(main, {}, "redundancy-pin", "_REDUNDANCY_PIN_COMPLETE")
        return {item.value for item in shell.get_completions(list(given), begun) if item.type == "plain"}

    whole = ("plan", "whole-trajectory")
    assert of(*whole, "--end", begun="") == {"free", "rest", "datum", "periodic"}
    assert of(*whole, "--objective", begun="base_") == {"base_force", "base_moment", "base_wrench"}
    assert of(*whole, "--robot", begun="2") == {"2rpr"}
    assert of("simulate", "--motion", begun="c") == {"circle", "corner"}
    assert of("validate", "--robot", begun="g") == {"gough"}
    assert of("inverse-dynamics", "--unreachable", begun="m") == {"mark"}


@pytest.mark.parametrize("name", ["circle", "line", "corner", "square"])
def test_joints_do_not_follow_a_point_in_a_plane(name: str, tmp_path: Path) -> None:
    """Metres taken for radians would give numbers that look right."""
    said = refused("inverse-dynamics", "--robot", "four_bar", "--motion", name, "--out", tmp_path / "out.csv")
    assert "leads a point along x and y" in said
    assert f"are joints: {', '.join(rp.load_robot('four_bar').independent_joints)}." in said
