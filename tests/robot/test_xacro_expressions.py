"""xacro files: expanded as by xacro itself, and nothing that runs code, looks around, or costs the earth."""

from __future__ import annotations

import contextlib
import io
import json
import math
import os
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path
from xml.sax.saxutils import quoteattr

import pytest
import xacro
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from redundancy_pin import load_robot
from redundancy_pin.errors import DeclarationError, InputError, ModelFileError
from redundancy_pin.robot.formats import expressions as evaluation
from redundancy_pin.robot.formats import xacro_engine
from redundancy_pin.robot.formats.xacro_file import known_values, render
from redundancy_pin.robot.shipped import models_root

VALUES = {"a": "3", "b": "-0.25", "word": "th ff mf", "table": "${dict(k=[1, 2], m=4)}", "row": "${[1, 2.5, 'x']}"}
TABLE = yaml.safe_load((Path(__file__).parent / "files" / "xacro" / "expressions.yaml").read_text())
SECONDS = 2.0
"""s of processor time that a refusal may take. What is not bounded takes minutes, or never ends."""


def doc(body: str) -> str:
    """Return a xacro file with a root link and a few properties."""
    values = "".join(f"<xacro:property name={quoteattr(k)} value={quoteattr(v)}/>" for k, v in VALUES.items())
    return f'<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">{values}<link name="base"/>{body}</robot>'


def expressions(*texts: str) -> str:
    return doc("".join(f"<a n={quoteattr(f'${{{text}}}')}/>" for text in texts))


def written(folder: Path, text: str) -> Path:
    path = folder / "r.urdf.xacro"
    path.write_text(text, encoding="utf-8")
    return path


def rendered(folder: Path, text: str) -> str:
    return render(written(folder, text), {})[0]


def by_xacro(path: Path, **arguments: str) -> str:
    """Return what plain xacro makes of a file, by Python's ``eval``: the oracle."""
    with contextlib.redirect_stderr(io.StringIO()):
        return str(xacro.process_file(str(path.resolve()), mappings=dict(arguments)).toprettyxml(indent="  "))


def refused(folder: Path, text: str, seconds: float = SECONDS) -> str:
    """Return the one error of a file, which names it, and is short and quick."""
    start = time.process_time()
    with pytest.raises(ModelFileError) as caught:
        rendered(folder, text)
    assert time.process_time() - start < seconds
    assert "r.urdf.xacro" in str(caught.value)
    assert len(str(caught.value)) < 1500
    return str(caught.value)


def test_a_misspelt_argument_is_refused_whatever_the_file_includes(tmp_path: Path) -> None:
    """What includes with $ in their names declare is known to xacro alone, when it has expanded them."""
    (tmp_path / "inc.xacro").write_text(doc('<xacro:arg name="inner" default="1"/><a v="$(arg inner)"/>'))
    include = '<xacro:property name="name" value="inc"/><xacro:include filename="${name}.xacro"/>'
    unused = '<xacro:if value="false"><xacro:arg name="unused" default="1"/></xacro:if>'
    path = written(tmp_path, doc(f'<xacro:arg name="length" default="2"/>{include}{unused}'))
    for untrusted in (False, True):
        text, known = render(path, {"length": 3, "inner": 4, "unused": 5}, untrusted=untrusted)
        assert known == {"length": 3.0, "inner": 4.0, "unused": 5.0}
        assert '<a v="4"/>' in text
        with pytest.raises(InputError, match=r"no argument 'lenght'.*Did you mean 'length'"):
            render(path, {"lenght": 3}, untrusted=untrusted)


# --- as by xacro ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("path", sorted(models_root().rglob("*.xacro")), ids=lambda path: path.parent.name)
def test_shipped_models_are_those_of_plain_xacro(path: Path) -> None:
    assert render(path, {})[0] == by_xacro(path) == render(path, {}, trust=True)[0]


def test_the_standard_library_stays_as_it_is(tmp_path: Path) -> None:
    """xacro replaces the function of minidom that writes an element; a copy of it must not."""
    path = written(tmp_path, doc(""))
    program = (
        "from pathlib import Path; from xml.dom.minidom import Element; before = Element.writexml\n"
        "from redundancy_pin.robot.formats.xacro_engine import expand\n"
        f"for trust in (False, True): expand(Path({str(path)!r}), {{}}, trust=trust)\n"
        "assert Element.writexml is before"
    )
    subprocess.run([sys.executable, "-c", program], check=True)


def test_expressions_of_the_kinds_that_models_have(tmp_path: Path) -> None:
    path = written(tmp_path, expressions(*TABLE["allowed"]))
    assert render(path, {})[0] == by_xacro(path)


NUMBERS = st.one_of(
    st.integers(-50, 50).map(str), st.floats(-20, 20, allow_nan=False).map(repr), st.sampled_from(["a", "b", "pi"])
)
OPERATORS = ["+", "-", "*", "/", "//", "%", "**", "<", "<=", ">", ">=", "==", "!=", "and", "or"]


def _combined(inner: st.SearchStrategy[str]) -> st.SearchStrategy[str]:
    return st.one_of(
        st.tuples(inner, st.sampled_from(OPERATORS), inner).map(lambda p: f"({p[0]} {p[1]} {p[2]})"),
        st.tuples(st.sampled_from(["-", "+", "not "]), inner).map(lambda p: f"({p[0]}{p[1]})"),
        st.tuples(inner, inner, inner).map(lambda p: f"({p[0]} if {p[1]} else {p[2]})"),
        st.tuples(inner, inner).map(lambda p: f"[{p[0]}, ({p[1]}, 1), 'c'][1][0]"),
        st.tuples(st.sampled_from(["sin", "atan", "fabs", "float", "round", "str", "sqrt", "exp"]), inner).map(
            lambda p: f"{p[0]}({p[1]})"
        ),
    )


@settings(deadline=None, max_examples=60)
@given(text=st.recursive(NUMBERS, _combined, max_leaves=10))
def test_values_are_those_of_plain_xacro(tmp_path_factory: pytest.TempPathFactory, text: str) -> None:
    path = written(tmp_path_factory.mktemp("r"), expressions(text))
    try:
        expected = by_xacro(path)
    except Exception:  # wrong for Python, too
        expected = ""
    try:
        result = render(path, {})[0]
    except ModelFileError as error:  # so it is for large powers, and complex numbers that plain xacro carries on with
        result = expected if re.search("bits|real number|characters", error.message) else ""
    assert result == expected


# --- refused ----------------------------------------------------------------------------------------------------------

LONG = {
    "1 if " + "not " * 2400 + "a else 2": "nested",
    "1 if 0 else " * 800 + "2": "nested",
    "(" * 4000 + ")" * 4000: "parentheses",
    "1+" * 4999 + "1": "nested",
    "1 " * 6000: "characters",
}


def test_an_error_names_expression_file_and_line_of_macros_too(tmp_path: Path) -> None:
    inner = "<xacro:property name='v' value='${1 + nothing}'/>\n<a n='${2 * v}'/>"
    (tmp_path / "m.xacro").write_text(doc(f"\n\n<xacro:macro name='m'>\n{inner}</xacro:macro>"))
    message = refused(tmp_path, doc("<!-- ${1 + nothing} --><xacro:include filename='m.xacro'/>\n<xacro:m/>"))
    assert f"in {tmp_path / 'm.xacro'}, line 4: `1 + nothing`: the name 'nothing' is not defined" in message


def often(part: str, times: int) -> str:
    """Return a macro and its calls."""
    return f'<xacro:macro name="m">{part}</xacro:macro>' + "<xacro:m/>" * times


def off(part: str, times: int) -> str:
    """Return elements that are switched off."""
    return f'<xacro:if value="0">{part * times}</xacro:if>'


PARAMETERS = " ".join(f"p{i}:=1" for i in range(99_999))

BOMBS = {
    "a macro that calls itself": (often('<xacro:m/><xacro:call macro="m"/>', 1), "without end"),
    "macros that double": (
        "".join(f'<xacro:macro name="m{i}"><xacro:m{i + 1}/><xacro:m{i + 1}/></xacro:macro>' for i in range(60))
        + '<xacro:macro name="m60"/><xacro:m0/>',
        "more work",
    ),
    "a large macro, switched off": (often(off("<a/>", 9000), 1000), "more work"),
    "a large block": (
        '<xacro:macro name="m" params="**b">' + '<xacro:insert_block name="b"/>' * 1000 + "</xacro:macro>"
        "<xacro:m><b>" + "<a/>" * 5000 + "</b></xacro:m>",
        "more work",
    ),
    "texts that double": (
        "".join(f'<xacro:property name="p{i + 1}" value="${{p{i}}}${{p{i}}}"/>' for i in range(50))
        + '<xacro:property name="p0" value="xxxxxxxxxx"/><link name="${p50}"/>',
        "characters",
    ),
    "many switches": ('<a/><xacro:if value="0"/>' * 9_900, "more work"),
    "many comments": ("<!--a-->" * 30_000, "comments"),
    "many parameters": (f'<xacro:macro name="m" params="{PARAMETERS}"/>', "more work"),
    "properties in a circle": (
        '<xacro:property name="p" value="${q}"/><xacro:property name="q" value="${p}"/><a n="${p}"/>',
        "circular",
    ),
    "properties in a long row": (
        "".join(f'<xacro:property name="p{i}" value="${{p{i + 1}}}"/>' for i in range(3000)) + '<a n="${p0}"/>',
        "nested too deeply",
    ),
    "large values": ("<xacro:property name='l' value='${[0] * 49000}'/>" + "<a n='${len(l)}'/>" * 1000, "more work"),
    "a file that includes itself": ('<xacro:include filename="r.urdf.xacro"/>', "31 levels deep"),
}


REFUSED = {
    **{text[:30]: (expressions(text), reason) for text, reason in (TABLE["refused"] | LONG).items()},
    **{element: (doc(element), reason) for element, reason in TABLE["elements"].items()},
    **{name: (doc(body), reason) for name, (body, reason) in BOMBS.items()},
}


@pytest.mark.parametrize("name", [name for name in REFUSED if REFUSED[name][1] != "more work"])
def test_what_models_may_not_say_is_refused_at_once(tmp_path: Path, name: str) -> None:
    text, reason = REFUSED[name]
    assert reason in refused(tmp_path, text)


@pytest.mark.parametrize("share", [8, pytest.param(1, marks=pytest.mark.long)])
@pytest.mark.parametrize("name", [name for name in REFUSED if REFUSED[name][1] == "more work"])
def test_what_would_take_forever_is_refused_when_its_work_is_spent(
    tmp_path: Path, name: str, share: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With an eighth of the work that a model may take, in a quarter of the time; with all of it, in all of that."""
    monkeypatch.setattr(evaluation, "STEPS", evaluation.STEPS // share)
    text, reason = REFUSED[name]
    assert reason in refused(tmp_path, text, SECONDS / min(share, 4))


@pytest.mark.parametrize("quote", ["x" * 60 + "'", "'a'a" * 40 + "'"])
def test_an_open_quote_in_the_parameters_of_a_macro_takes_no_time(tmp_path: Path, quote: str) -> None:
    """The pattern of xacro tries 2**60 ways to read it."""
    start = time.process_time()
    rendered(tmp_path, doc(f'<xacro:macro name="m" params="a:={quote}"/>'))
    assert time.process_time() - start < 1.0


def test_what_xacro_has_besides_expressions(tmp_path: Path) -> None:
    """Parameters of all forms, blocks, elements and attributes made, namespaces, escapes, optional files, $(eval)."""
    (tmp_path / "n.xacro").write_text(doc('<xacro:property name="z" value="7"/>'))
    (tmp_path / "v.yaml").write_text("a:\na:\n  b: [1, 2.5]\nangle: !degrees 90 * 2\nlength: !inches 1\n")
    path = written(
        tmp_path,
        doc(
            """<xacro:arg name="n" default="5"/><xacro:include filename="n.xacro" ns="own"/>
            <xacro:include filename="none.xacro" optional="true"/><xacro:include filename="[n].xacro"/>
            <xacro:property name="f" value="4"/><xacro:property name="v" value="${xacro.load_yaml('v.yaml')}"/>
            <xacro:macro name="m" params="c d:=1 e:='two words' f:=^ g:=^|3 h:=${1+2} *block **blocks">
            <b c="${c}" d="${d}" e="${e}" f="${f}" g="${g}" h="${h}"/><xacro:insert_block name="block"/>
            <xacro:insert_block name="blocks"/></xacro:macro>
            <xacro:m c="$(arg n)"><x y="${a}"/><z><y/><y/></z></xacro:m>
            <xacro:element xacro:name="made_${a}"><xacro:attribute name="k" value="$${no} ${own.z}"/></xacro:element>
            <xacro:unless value="${own.z == z}"><c/></xacro:unless><d n="$(eval 2 * n + a_b)" m="$(optenv NOT_SET 3)"/>
            <e n="${v.a.b[1]} ${v['a']['b'][0]} ${v.angle} ${v.length}"/><f n="${xacro.arg('n')}"/>"""
        ).replace("a_b", "1"),
    )
    assert "NOT_SET" not in os.environ
    assert render(path, {})[0] == by_xacro(path)
    assert f'n="2.5 1 {math.pi} 0.0254"' in render(path, {})[0]


def test_yaml_of_models_is_data(tmp_path: Path) -> None:
    body = "<a n=\"${xacro.load_yaml('v.yaml').a}\"/>"
    for content, reason in {
        "a: !!python/object/apply:os.system ['true']": "python/object",
        "a: &a [1, *a]": "holds itself",
        "a: &a [1,1,1,1,1,1,1,1,1,1,1,1]\nb: &b [*a,*a,*a,*a,*a,*a,*a,*a,*a]\nc: &c [*b,*b,*b,*b,*b,*b,*b,*b]\n"
        "d: [*c,*c,*c,*c,*c,*c,*c,*c,*c,*c,*c,*c,*c,*c,*c,*c,*c,*c,*c,*c,*c,*c,*c,*c,*c,*c,*c,*c,*c]": "aliases",
        "a: !degrees ().__class__": "__class__",
        "[" * 500: "deep",
    }.items():
        (tmp_path / "v.yaml").write_text(content)
        with pytest.raises(ModelFileError) as caught:
            rendered(tmp_path, doc(body))
        assert reason in str(caught.value)


# --- folders ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["../outside.{}", "{folder}/outside.{}", "linked.{}", "named.xacro"])
@pytest.mark.parametrize("kind", ["xml", "yaml", "xacro"])
def test_models_read_files_of_their_folder_or_package_and_other_models(tmp_path: Path, name: str, kind: str) -> None:
    """What else is on a machine could end up in the arguments of a plan that is passed on."""
    inside = tmp_path / "package" / "urdf"
    inside.mkdir(parents=True)
    outside = tmp_path / "package" / f"outside.{kind}"
    outside.write_text("secret: 5\n" if kind == "yaml" else doc("<secret/>"))
    for link in (f"linked.{kind}", "named.xacro"):
        (inside / link).symlink_to(outside)
    name = name.format(kind, folder=outside.parent)
    text = doc(
        f"<a n=\"${{xacro.load_yaml('{name}').secret}}\"/>" if kind == "yaml" else f'<xacro:include filename="{name}"/>'
    )
    if kind == "xacro":
        assert "<secret/>" in rendered(inside, text)
        return
    assert "neither in its folder or package" in (message := refused(inside, text))
    assert "--trust" in message
    assert "<robot" in render(inside / "r.urdf.xacro", {}, trust=True)[0]
    (tmp_path / "package" / "package.xml").write_text("<package><name>p</name></package>")
    assert "<robot" in rendered(inside, text)


def test_packages_are_found_above_beside_and_where_the_environment_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for folder, name in {
        "ws/own-main": "own",
        "ws/beside": "beside",
        "far/away": "away",
        "share/share/as": "as",
    }.items():
        (tmp_path / folder).mkdir(parents=True)
        (tmp_path / folder / "package.xml").write_text(f"<package><name>{name}</name></package>")
        (tmp_path / folder / "v.yaml").write_text(f"from: {name}\n")
    (tmp_path / "ws" / "bare").mkdir()
    inside = tmp_path / "ws" / "own-main" / "urdf"
    inside.mkdir()
    text = doc(
        "".join(f"<a n=\"${{xacro.load_yaml('$(find {name})/v.yaml')['from']}}\"/>" for name in ("own", "beside"))
    )
    assert 'n="own"' in rendered(inside, text)
    assert 'n="beside"' in rendered(inside, text)
    message = refused(inside, doc('<a n="$(find away)"/>'))
    assert f"'away', which is not found: there is no package.xml in {inside / 'away'}, " in message
    assert str(tmp_path / "ws" / "away") in message
    assert "not found" in refused(inside, doc('<a n="$(find bare)"/>'))
    assert "not found" in refused(inside, doc('<a n="$(find ../../far/away)"/>'))
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path / "far"))
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "share"))
    urdf = rendered(inside, doc('<a n="$(find away)"/><b n="$(find as)"/>'))
    assert f'n="{tmp_path}/far/away"' in urdf
    assert f'n="{tmp_path}/share/share/as"' in urdf


# --- trust ------------------------------------------------------------------------------------------------------------


def test_python_runs_only_with_trust(tmp_path: Path) -> None:
    path = written(tmp_path, doc('<a n="${(lambda x: x + 1)(1)} $(env HOME)"/>'))
    for _ in range(2):  # trust is of one file, once
        with pytest.raises(ModelFileError, match=r"Lambda.* trust=True \(--trust\)"):
            render(path, {})
        assert "2 " + os.environ["HOME"] in render(path, {}, trust=True)[0]


def test_a_strangers_file_is_expanded_in_a_process_of_its_own(tmp_path: Path) -> None:
    path = written(tmp_path, doc('<xacro:arg name="n" default="${2 * 2}"/><a n="$(arg n)"/>'))
    xacro_engine._engine.cache_clear()
    result = render(path, known_values(path, {}), untrusted=True)
    assert xacro_engine._engine.cache_info().misses == 0  # nothing was expanded here
    assert result == render(path, {})
    path.write_text(doc('<a n="${().__class__}"/>'))
    with pytest.raises(ModelFileError, match="__class__"):
        render(path, {}, untrusted=True)


def test_the_users_xacro_stays_as_it_is(tmp_path: Path) -> None:
    before = {name: value for name, value in vars(xacro).items() if not name.startswith("__")}
    assert "__class__" in refused(tmp_path, expressions("().__class__"))
    rendered(tmp_path, expressions("1"))
    assert all(getattr(xacro, name) is value for name, value in before.items())
    assert "eval" not in vars(xacro)


def test_a_later_xacro_that_evaluates_elsewhere_is_refused(tmp_path: Path) -> None:
    """Its functions have other names: none of what is replaced is called."""
    shutil.copytree(Path(xacro.__file__).parent, tmp_path / "xacro")
    source = tmp_path / "xacro" / "__init__.py"
    source.write_text(source.read_text().replace("safe_eval(", "evaluate_safely("))
    paths = os.pathsep.join((str(tmp_path), *sys.path))
    command = [sys.executable, "-m", xacro_engine.__name__, str(written(tmp_path, expressions("1 + 1"))), "{}"]
    child = subprocess.run(command, capture_output=True, env={**os.environ, "PYTHONPATH": paths}, check=False)
    assert "install xacro 2.1" in json.loads(child.stdout)["message"]


def test_a_declaration_has_the_same_expressions(tmp_path: Path) -> None:
    for file in (models_root() / "four_bar").iterdir():
        shutil.copy(file, tmp_path)
    path, text = tmp_path / "robot.yaml", (models_root() / "four_bar" / "robot.yaml").read_text()
    path.write_text(f"{text}characteristic_length: max(ground_length, 2 * pi) - hypot(3, 4) + 5\n")
    assert load_robot(path).characteristic_length == pytest.approx(2 * math.pi)
    for expression in ("10**10**10", "().__class__", "[1][0].real", "nothing"):
        path.write_text(f"{text}characteristic_length: '{expression}'\n")
        with pytest.raises(DeclarationError, match="characteristic_length"):
            load_robot(path)
