"""Names from files of strangers, in every file that is written: nothing breaks, nothing runs, they come back."""

from __future__ import annotations

import csv
import functools
import html.parser
import io
import json
import re
import shutil
import subprocess
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from command_line import call
from hostile_names import NAMES, joints_of, plan_of, write_hostile
from scipy.io import loadmat

import redundancy_pin as rp
from redundancy_pin import codegen
from redundancy_pin.cli.errors import print_line
from redundancy_pin.io.csv_cells import escape_formula, unescape_formula
from redundancy_pin.motion import CarrierMotion
from redundancy_pin.planners.export import PlanTable
from redundancy_pin.planners.plan import Plan
from redundancy_pin.robot import Robot
from redundancy_pin.status import SampleStatus
from redundancy_pin.trajectory.csv_file import csv_rows, read_table
from redundancy_pin.view import show

HARMLESS = "plain"


@dataclass(frozen=True, eq=False)
class Named:
    """A robot with a name, a plan of it, and that as a table."""

    name: str
    robot: Robot
    plan: Plan
    table: PlanTable

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of its main actuators and carriers."""
        new = joints_of(self.name)
        return new["slide_1"], new["slide_2"], new["carrier_1"], "carrier_2"


@pytest.fixture(scope="module")
def named(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Named]:
    @functools.cache
    def make(name: str) -> Named:
        robot = rp.load_robot(write_hostile(tmp_path_factory.mktemp("robot"), name))
        assert robot.name == name
        assert (*robot.actuated, *robot.carriers) == Named(name, robot, None, None).joints  # type: ignore[arg-type]
        plan = plan_of(robot)
        return Named(name, robot, plan, plan.table(robot=robot))

    return make


def in_npz(one: Named, folder: Path) -> None:
    one.plan.save(folder / "plan.npz")
    read = rp.load_plan(folder / "plan.npz")
    assert read.robot == one.plan.robot
    assert (read.robot.name, *read.robot.actuated, *read.robot.carriers) == (one.name, *one.joints)


def no_formula(cell: str) -> bool:
    """Return whether no spreadsheet takes a cell, or what it may cut out of one, for a formula."""
    return not re.search(r"(^|[;\t|])\s*[=+\-@＝＋－＠]", cell)


def in_csv(one: Named, folder: Path) -> None:
    one.table.to_csv(folder / "plan.csv")
    with (folder / "plan.csv").open(encoding="utf-8", newline="") as stream:
        heading = next(csv.reader(stream))
        assert all(no_formula(cell) for cell in heading)
        rows = [[float(cell) for cell in row] for row in csv.reader(stream)]
    names = [unescape_formula(cell).rpartition(" [")[0] for cell in heading]
    for joint in one.joints:
        assert {f"tau:{joint}"} <= set(names)
    column = names.index(f"tau:{one.joints[0]}")
    np.testing.assert_array_equal([row[column] for row in rows], one.table.effort[:, 0])
    assert len(read_table(folder / "plan.csv").columns["t"]) == len(rows)  # it is read as a motion, too
    (text,) = list(csv.reader(io.StringIO(csv_rows({one.name: ("", np.array([one.name]))}))))[1]
    assert no_formula(text)
    assert unescape_formula(text) == one.name


def in_json(one: Named, folder: Path) -> None:
    one.table.to_json(folder / "plan.json")
    read = json.loads((folder / "plan.json").read_text(encoding="utf-8"))
    assert (read["robot"], tuple(read["joints"])) == (one.name, one.joints)
    assert read["columns"][f"s:{one.joints[2]}"] == one.table.position[:, 2].tolist()


def in_mat(one: Named, folder: Path) -> None:
    one.table.to_mat(folder / "plan.mat")
    read = loadmat(folder / "plan.mat", squeeze_me=True)
    assert (read["robot"], tuple(read["joints"])) == (one.name, one.joints)


def in_ros(one: Named, folder: Path) -> None:
    one.table.to_ros(folder / "plan.yaml")
    read = yaml.safe_load((folder / "plan.yaml").read_text(encoding="utf-8"))
    assert tuple(read["joint_names"]) == one.joints


class Tags(html.parser.HTMLParser):
    """What a browser makes of a page: tags with their attributes, scripts, and the text beside them."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.tags: list[Any] = []
        self.texts: list[str] = []
        self.scripts: list[str] = []
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: Any) -> None:
        self.tags.append((tag, attrs))
        self.scripts += [""] if tag == "script" else []

    def handle_endtag(self, tag: str) -> None:
        self.tags.append(tag)

    def handle_data(self, data: str) -> None:
        if self.cdata_elem == "script":
            self.scripts[-1] += data
        else:
            self.texts.append(data)


@functools.cache
def page_of(one: Named) -> Tags:
    return Tags(show(one.plan, robot=one.robot).html())


def in_html(one: Named, folder: Path, harmless: Named) -> None:
    page, usual = page_of(one), page_of(harmless)
    assert page.tags == usual.tags
    assert page.scripts[0] == usual.scripts[0]  # the viewer
    title = f"{one.name}: parked, ok"
    assert page.texts.count(title) == usual.texts.count(f"{HARMLESS}: parked, ok") == 2
    (line,) = [line for line in page.scripts[1].splitlines() if line.startswith("const data = ")]
    readings = json.loads(line.removeprefix("const data = ").removesuffix(";"))["readings"]
    assert {joint["name"] for joint in readings["joints"]} == {*one.joints, joints_of(one.name)["swivel_1"], "swivel_2"}
    assert len({path for path, _ in readings["parts"]}) == len(readings["parts"])


def names_in_legends(figure: Any) -> list[str]:
    legends = [axes.get_legend() for axes in figure.axes] + figure.legends
    return [text.get_text() for legend in legends if legend for text in legend.get_texts()]


def in_pictures(one: Named, folder: Path) -> None:
    drawn = rp.plot.efforts(one.plan)
    shown = names_in_legends(drawn)
    assert len(shown) == 4
    assert shown == [*one.joints] or len(one.name) > 100
    assert drawn.get_suptitle().startswith(one.name[:40])
    rp.plot.save(drawn, folder / "plan.svg", folder / "plan.png")
    tags = {element.tag.rpartition("}")[2] for element in ElementTree.parse(folder / "plan.svg").iter()}
    assert not tags & {"script", "a", "foreignObject", "image"}


def in_mjcf(one: Named, folder: Path) -> None:
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_path(str(rp.write_mjcf(one.robot, folder / "robot.xml")))
    assert {model.joint(i).name for i in range(model.njnt)} == {
        *one.joints,
        joints_of(one.name)["swivel_1"],
        "swivel_2",
    }
    assert [model.actuator(i).name for i in range(model.nu)] == [*one.joints]


def in_c(one: Named, folder: Path, harmless: Named) -> None:
    """What could end a comment, a string or a line is as often there as with harmless names."""
    written = codegen.write_c(one.robot, folder / "c", prefix="own")
    codegen.write_c(harmless.robot, folder / "usual", prefix="own")
    for file in written.files:
        if file.endswith((".c", ".h", ".txt", ".md")):
            ours, theirs = ((folder / where / file).read_text(encoding="utf-8") for where in ("c", "usual"))
            for mark in ("/*", "*/", "//", '"', "\\", "??", "\n", "<", "$"):
                assert ours.count(mark) == theirs.count(mark), (file, mark)
    assert re.fullmatch("[a-z][a-z0-9_]*", codegen.prefix_of(one.name, None))


WRITERS: dict[str, Callable[..., None]] = {
    "npz": in_npz,
    "csv": in_csv,
    "json": in_json,
    "mat": in_mat,
    "ros": in_ros,
    "html": in_html,
    "pictures": in_pictures,
    "mjcf": in_mjcf,
    "c": in_c,
}
"""What is written, and what it has to be when it is read."""

WITH_HARMLESS = ("html", "c")
"""Writers whose file is compared with that of a robot whose names are harmless."""

QUICK = {
    "html": {"mark of the page", "another mark", "end of a script", "attribute", "entities", "prototype", "slash",
             "name of the base", "as many letters as may be"},
    "pictures": {"mathtext that fails", "underscore first", "as many letters as may be"},
    "c": {"end of a comment", "macro"},
}  # fmt: skip
"""Names with which writers that take long are tried each time."""

LATER = [f"{name}-{writer}" for writer, quick in QUICK.items() for name in NAMES if name not in quick]


@pytest.mark.long_for(*LATER)
@pytest.mark.parametrize("writer", WRITERS)
@pytest.mark.parametrize("name", NAMES)
def test_a_name_comes_back_and_nothing_else(
    name: str, writer: str, named: Callable[[str], Named], tmp_path: Path
) -> None:
    harmless = (named(HARMLESS),) if writer in WITH_HARMLESS else ()
    WRITERS[writer](named(NAMES[name]), tmp_path, *harmless)


def test_all_names_in_figures(tmp_path: Path) -> None:
    """None is parsed as a formula, and no legend leaves one out."""
    t, names = np.linspace(0.0, 1.0, 3), [*NAMES.values()]
    values = np.outer(np.ones(3), np.arange(float(len(names))))
    drawn = rp.plot.efforts(
        rp.plot.Curves(
            title=" ".join(names), t=t, tau=values, main_unit=f"force of {names[0]} [N]", carrier_force=values[:, :1],
            carriers=CarrierMotion.parked(3, 1), limits=(), condition=np.ones(3), margin=np.ones(3),
            status=np.full(3, SampleStatus.OK), main_names=tuple(names), carrier_names=("_",),
        )
    )  # fmt: skip
    shown = names_in_legends(drawn)
    assert [text for text in shown if "…" not in text] == [*(name for name in names if len(name) < 255), "_"]
    assert len(shown) == len(names) + 1
    assert max(map(len, shown)) < 50
    rp.plot.save(drawn, tmp_path / "all.svg", tmp_path / "all.png")
    assert ElementTree.parse(tmp_path / "all.svg").getroot().tag.endswith("svg")


def test_a_picture_of_a_robot_with_a_dollar_is_drawn_and_its_plan_kept(tmp_path: Path) -> None:
    robot = write_hostile(tmp_path, NAMES["mathtext that fails"])
    out, plot = tmp_path / "plan.npz", tmp_path / "plan.png"
    points = tmp_path / "points.csv"
    points.write_text("t,x,y\n0,0.2,0.36\n0.1,0.21,0.36\n0.2,0.22,0.36\n")
    task = (
        "plan",
        "stepwise",
        "--backend",
        "rnea",
        "--robot",
        robot,
        "--motion",
        f"{points}:ends=rest",
        "--dt",
        "0.02",
    )
    result = call(*map(str, (*task, "--out", out, "--plot", plot)))
    assert result.exit_code in (0, 3, 4), result.stderr  # there is a plan, and it is written
    assert rp.load_plan(out).robot.actuated[0] == NAMES["mathtext that fails"]
    assert plot.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("text", ["", "a", "'", "''", "'=", "a;'=b", "=;=\t=|=,=", "'a", "+", "a=b", "−1"])
def test_a_guard_is_taken_away_again(text: str) -> None:
    assert no_formula(escape_formula(text))
    assert unescape_formula(escape_formula(text)) == text


def test_numbers_and_working_modes_need_no_guard() -> None:
    texts = ["-1.5", "+-+", "1e-05", "-inf", "nan", "=+-", "-x"]
    lines = csv_rows({"=a": ("", np.array(texts))}).splitlines()
    assert lines == ["'=a", "-1.5", "+-+", "1e-05", "-inf", "nan", "'=+-", "'-x"]


def test_a_robot_named_as_a_header_of_c(named: Callable[[str], Named], tmp_path: Path) -> None:
    """A file math.h beside the source would be read in place of the system's."""
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler")
    written = codegen.write_c(named("math").robot, tmp_path / "code")
    check = [compiler, "-std=c99", "-Wall", "-Wextra", "-Werror", "-fsyntax-only", "-I", str(tmp_path / "code")]
    done = subprocess.run([*check, str(tmp_path / "code" / f"{written.prefix}.c")], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")


def test_a_warning_is_one_line_that_no_terminal_obeys(capsys: pytest.CaptureFixture[str]) -> None:
    """Names of closures come from YAML, which may hold any letter."""
    print_line("warning", "loop \x1b[31m of\nit is open")
    assert capsys.readouterr().err == "warning: loop \N{REPLACEMENT CHARACTER}[31m of it is open\n"
