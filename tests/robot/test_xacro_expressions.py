"""Expressions of models: as Python calculates them, and nothing that runs code, looks around, or costs the earth."""

from __future__ import annotations

import math
import os
import random
import time
from pathlib import Path
from typing import Any

import pytest
import xacro
from hypothesis import given, settings
from hypothesis import strategies as st

from redundancy_pin import load_robot
from redundancy_pin.errors import InputError, ModelFileError
from redundancy_pin.robot.formats import xacro_engine
from redundancy_pin.robot.formats.expressions import (
    BUILTINS,
    LARGEST,
    MATHEMATICS,
    Budget,
    ExpressionError,
    Namespace,
    evaluate,
)
from redundancy_pin.robot.urdf import known_values, models_root, render

NAMES: dict[str, Any] = {
    **BUILTINS,
    **MATHEMATICS,
    "python": Namespace(BUILTINS),
    "math": Namespace(MATHEMATICS),
}
VALUES: dict[str, Any] = {"a": 3, "b": -0.25, "word": "th ff mf", "row": [1, 2.5, "x"], "table": {"k": [1, 2], "m": 4}}
PYTHON: dict[str, Any] = {
    **{name: getattr(math, name) for name in MATHEMATICS},
    **{name: __builtins__[name] for name in BUILTINS},  # type: ignore[index]
    **VALUES,
    "__builtins__": {},
}
"""The same names as Python has them."""


def calculated(text: str) -> Any:
    return evaluate(text, {**NAMES, **VALUES}, Budget())


def doc(body: str) -> str:
    """Return a xacro file with a root link."""
    return f'<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro"><link name="base"/>{body}</robot>'


def link(text: str) -> str:
    """Return a xacro file that evaluates an expression where it has no effect but its value."""
    return doc(f'<!-- --><xacro:property name="v" value="{text}"/><xacro:if value="${{v == 0}}"/>')


def rendered(folder: Path, text: str, **arguments: object) -> str:
    path = folder / "r.urdf.xacro"
    path.write_text(text)
    return render(path, known_values(path, arguments))[0]


# ---- what is calculated --------------------

NUMBERS = st.one_of(
    st.integers(-50, 50).map(str),
    st.floats(-20, 20, allow_nan=False).map(repr),
    st.sampled_from(["a", "b", "pi", "True"]),
)


def _combined(inner: st.SearchStrategy[str]) -> st.SearchStrategy[str]:
    pairs = st.tuples(inner, inner)
    return st.one_of(
        st.tuples(pairs, st.sampled_from(["+", "-", "*", "/", "//", "%", "<", "<=", "==", "!=", "and", "or"])).map(
            lambda p: f"({p[0][0]} {p[1]} {p[0][1]})"
        ),
        inner.map(lambda x: f"(-{x})"),
        inner.map(lambda x: f"(not {x})"),
        st.tuples(inner, st.integers(-3, 3)).map(lambda p: f"({p[0]} ** {p[1]})"),
        st.tuples(inner, inner, inner).map(lambda p: f"({p[0]} if {p[1]} else {p[2]})"),
        pairs.map(lambda p: f"max({p[0]}, {p[1]})"),
        pairs.map(lambda p: f"sum([x * {p[0]} for x in [1, {p[1]}] if x != 2])"),
        pairs.map(lambda p: f"dict(k={p[0]}, m={p[1]})['k']"),
        pairs.map(lambda p: f"[{p[0]}, ({p[1]}, 1), 'c'][1][0]"),
        st.tuples(
            inner, st.sampled_from(["sin", "cos", "atan", "fabs", "float", "round", "str", "degrees", "sqrt"])
        ).map(lambda p: f"{p[1]}({p[0]})"),
        st.tuples(inner, st.integers(-1, 2)).map(lambda p: f"round(float({p[0]}), {p[1]})"),
        inner.map(lambda x: f"len('{{}}:{{n:.3f}}'.format(str({x}), n=1.5))"),
    )


@settings(deadline=None)
@given(st.recursive(NUMBERS, _combined, max_leaves=12))
def test_expressions_have_the_values_that_python_gives_them(text: str) -> None:
    try:
        expected = eval(text, dict(PYTHON))  # the oracle; the text is ours
    except (ArithmeticError, ValueError, TypeError) as error:
        with pytest.raises((type(error), ExpressionError)):
            calculated(text)
        return
    if isinstance(expected, complex):
        with pytest.raises(ExpressionError, match="not a real number"):
            calculated(text)
        return
    value = calculated(text)
    assert type(value) is type(expected)
    assert value == expected or (math.isnan(value) and math.isnan(expected))


@pytest.mark.parametrize(
    "text",
    [
        "word.split()[1] + word.upper()[-2:]",
        "[f.upper() for f in word.split() if f != 'ff']",
        "dict([(k, v) for k, v in zip(word.split(), range(3))])",
        "sorted(word.split(), reverse=True)",
        "row + list(range(2)) + list(range(5, 0, -2))",
        "list(map(float, ['1', '2.5']))",
        "list(map(len, word.split()))",
        "list(enumerate(word.split()))",
        "list(reversed(row))",
        "min(word.split()) + max('a', 'b')",
        "'%s is %.2f' % (word, b)",
        "'{name} {owner} {run} {function}'.format(name=1, owner=2, run=3, function=4)",
        "dict(run=1, name=2, function=3, self=4)",
        "gcd(4, 6) + round(2.345, ndigits=2)",
        "'{0} {x:>5}'.format(a, x=b)",
        "' '.join([str(x) for x in row])",
        "table['k'][::-1]",
        "table.get('z', 7) + len(table.keys())",
        "list(table.items())",
        "1 < a < 4 < 5",
        "[1 < a < 2 < 9, 5 > a > 4 > 2, 1 < a == 3 > 2]",
        "a in [3, 4] and 'ff' in word and a not in row",
        "None is None and (a or 1 / 0)",
        "[x * y for x in range(3) for y in range(x)]",
        "dict([(x, x**2) for x in range(3)])",
        "any(x > 2 for x in [1, 2, 3])",
        "[i for i in [1, 2] for i in [i + 1]]",
        "hypot(3, 4) + factorial(5) + fsum([0.1] * 10)",
        "-a + +a",
        "[x in range(5) for x in [2, 2.5, 'a']]",
        "'%5.1f%% %s %03d' % (b, word, a) + '{{{0:>9.3f}|{x:s}}}'.format(b, x=word)",
        "int('ff', 16) + int('7') + ord('x')",
        "(7 // 3, 7 % 3) + (1,)",
        "'abc'.replace('b', 'xx').zfill(8).startswith('0')",
    ],
)
def test_expressions_of_the_kinds_that_models_have(text: str) -> None:
    assert calculated(text) == eval(text, dict(PYTHON))


def test_shipped_models_are_the_same_by_full_python() -> None:
    for path in sorted(models_root().glob("*/*.xacro")):
        assert render(path, {}) == render(path, {}, trust=True), path.name


# ---- what is refused --------------------

ATTACKS = {
    # classes and what they lead to
    "().__class__.__base__.__subclasses__()": "__class__",
    "''.__class__.__mro__[1]": "__class__",
    "(1).real": "'real'",
    "[].append.__self__": "'append'",
    "len.__globals__": "__globals__",
    "len.call": "'call'",
    "python.len.kind": "'kind'",
    "math.__dict__": "__dict__",
    "table.__getattr__('k')": "__getattr__",
    "[c for c in ().__class__.__bases__]": "__class__",
    "[x.__class__ for x in [1]]": "__class__",
    "word.format.__func__": "__func__",
    # code
    "(lambda: 1)()": "lambda",
    "list(map(lambda x: x, [1]))": "lambda",
    "(lambda x: x.__class__)(1)": "lambda",
    "(x := 1)": ":=",
    "[y := 1, y]": ":=",
    "f'{a.__class__}'": "f-strings",
    "(yield 1)": "Yield",
    "(await a)": "Await",
    "[x async for x in row]": "async",
    "__import__('os').system('true')": "__import__",
    "getattr(a, 'real')": "getattr",
    "eval('1')": "eval",
    "exec('1')": "exec",
    "compile('1', '', 'eval')": "compile",
    "open('/etc/passwd')": "open",
    "globals()": "globals",
    "vars()": "vars",
    "type(a)": "type",
    "type('X', (), {})": "type",
    "breakpoint()": "breakpoint",
    "print(1)": "print",
    "__builtins__": "__builtins__",
    "__name__": "__name__",
    "'a'()": "no function",
    "[].append(1)": "'append'",
    "table.update(k=1)": "'update'",
    "table.pop('k')": "'pop'",
    "[0 for len.x in [1]]": "assign",
    "[0 for table['k'] in [1]]": "assign",
    "b'bytes'": "models may not use b'bytes'",
    "...": "Ellipsis",
    "1j": "1j",
    "a @ b": "MatMult",
    # formats
    "'{0.__class__}'.format(a)": "layout",
    "'{0[k]}'.format(table)": "layout",
    "'{x.real}'.format(x=1)": "layout",
    "'{!s:{w}}'.format(1, w=9999999)": "layout",
    "'{:99999999}'.format(1)": "layout",
    "'{a.__init__.__globals__}'.format(a=len)": "layout",
    "'{}'.format(len)": "may not format",
    "'%9999999d' % 1": "layout",
    "'%*d' % (9999999, 1)": "layout",
    "len('%(a)s' * 999 % dict(a=[['a' * 63] * 300] * 300))": "layout",
    "len(('{0}' * 999).format([['a' * 63] * 300] * 300))": "may not format a list",
    "len('%s' % ([['a' * 63] * 300] * 300))": "may not format a list",
    "len('%(a)s' * 999 % dict(a='a' * 90000))": "layout",
    "len(('{0}' * 999).format('a' * 90000))": "characters",
    "'{}'.format_map(table)": "'format_map'",
    "word.translate(table)": "'translate'",
    "word.encode()": "'encode'",
    # size
    "9**9**9": "bits",
    "2**1000000": "bits",
    "10**-99999999": "bits",
    "99999999999**99999999999": "bits",
    "1 << 10**9": "LShift",
    "10**1200 * 10**1200": "bits",
    "'{}'.format('a' * 99999) + '{}{}'.format('a' * 99999, 1)": "characters",
    "('%d' * 80 % 10**1200)": "",
    "('{0}' * 80).format(10**1200)": "characters",
    "('{:00}' * 40 + '{').format(1)": "layout",
    "'%' * 3000 % 1": "",
    # what no model was seen to use
    "{1, 2}": "Set",
    "set([1])": "'set'",
    "{x: 0 for x in range(3)}": "DictComp",
    "{**table}": "**",
    "dict(**table)": "**",
    "[*row]": "* here",
    "max(*row)": "* here",
    "~a": "Invert",
    "a | 1": "BitOr",
    "prod([10**1000] * 99)": "'prod'",
    "comb(10**6, 10**5)": "'comb'",
    "[0 for x in range(99999) for y in range(99999)]": "",
    "[d[t] for d in [{tuple(range(40000)): 0}] for t in d for x in range(40000)]": "more work",
    "dict([[x * (2**61 - 1), 0] for x in range(2000)])": "elements",
    "factorial(10**6)": "arguments",
    "'a' * 10**9": "elements",
    "10**9 * [0]": "elements",
    "[0] * 10**10": "elements",
    "list(range(10**9))": "elements",
    "sorted(range(10**9))": "elements",
    "sum(range(10**9))": "elements",
    "tuple(range(10**9))": "elements",
    "max(range(10**9))": "elements",
    "[x for x in range(10**9)]": "elements",
    "[[0] * 1000] * 1000": "elements",
    "[[0] * 10**4] * 10**4": "elements",
    "'a'.join(['b' * 1000] * 1000)": "",
    "'a'.replace('', 'b' * 99999)": "characters",
    "'a'.zfill(10**9)": "characters",
    "round(5, -10**9)": "digits",
    "int('9' * 5000)": "digits",
    "all(0 == 1 for x in range(99999) for y in range(99999))": "",
    "1 if " + "not " * 2400 + "a else 2": "nested",
    "(" * 5000 + ")" * 5000: "parentheses",
    "-" * 9000 + "1": "nested",
    "1+" * 4999 + "1": "nested",
    "1 " * 6000: "characters",
    "a" + ".a" * 2000: "",
    "(-8)**0.5": "real",
    "1 +": "no expression",
    "import os": "no expression",
    "a; b": "no expression",
    "a\x00b": "no expression",
}


@pytest.mark.parametrize("text", ATTACKS, ids=lambda text: text[:30])
def test_attacks_are_refused_at_once(text: str) -> None:
    start = time.process_time()
    with pytest.raises((ExpressionError, NameError), match=None) as caught:
        calculated(text)
    assert ATTACKS[text] in str(caught.value)
    assert len(str(caught.value)) < 1000
    assert time.process_time() - start < 2.0


@pytest.mark.parametrize("text", [each for each in ATTACKS if not {"\x00", "}"} & {*each}][::4], ids=lambda t: t[:40])
def test_attacks_in_a_file_are_one_error_that_names_file_and_expression(tmp_path: Path, text: str) -> None:
    escaped = text.replace("&", "&amp;").replace("<", "&lt;").replace('"', "&quot;")
    with pytest.raises(ModelFileError, match="cannot render") as caught:
        rendered(tmp_path, link("${" + escaped + "}"))
    assert "r.urdf.xacro" in caught.value.message
    assert str(caught.value.details["expression"])[2:-1] == text.strip()
    assert len(str(caught.value)) < 1500


def test_long_expressions_are_parsed_at_their_own_cost() -> None:
    text = f"[1{', 0' * 3000}] and 0 if False else 0"
    left = Budget()
    assert evaluate(text, {}, left) == 0
    assert Budget().steps - left.steps > 4000  # its parser takes some milliseconds
    with pytest.raises(ExpressionError, match="more work"):
        evaluate(text, {}, Budget(4000))


def test_every_function_refuses_or_returns_for_any_arguments() -> None:
    """No function of the list leads anywhere, whatever it is given: random calls end in values or errors, quickly."""
    rng = random.Random(1)
    functions = [*BUILTINS, *(name for name, value in MATHEMATICS.items() if not isinstance(value, float))]
    values = [
        "a",
        "b",
        "word",
        "row",
        "table",
        "len",
        "10**300",
        "-1",
        "[1, [2, 3]]",
        "''",
        "None",
        "range(5)",
        "10**9",
    ]
    allowed = (bool, int, float, str, list, tuple, dict, type(None))
    for _ in range(1500):
        text = f"{rng.choice(functions)}({', '.join(rng.choices(values, k=rng.randint(0, 3)))})"
        try:
            assert isinstance(calculated(text), allowed), text
        except (ArithmeticError, LookupError, TypeError, ValueError, NameError):
            continue


def test_names_with_two_underscores_are_refused_even_where_they_stand_for_something() -> None:
    with pytest.raises(ExpressionError, match="the name '__x'"):
        evaluate("__x", {"__x": 1}, Budget())
    with pytest.raises(ExpressionError, match="assign"):
        evaluate("[1 for __x in [1]]", {}, Budget())


def test_shared_parts_count_wherever_they_are() -> None:
    """[p, p] of [p, p] of ...: two hundred characters stand for 2**50 elements."""
    names = dict(NAMES, p=[1, 2])
    for _ in range(12):
        names["p"] = evaluate("[p, p]", names, Budget())
    assert 2**15 < LARGEST < 2**17  # a text of so many parts is still written out quickly
    with pytest.raises(ExpressionError, match="elements"):
        evaluate("[[[[p, p], [p, p]] * 2] * 2] * 4", names, Budget())


def test_the_work_of_a_model_is_bounded_as_a_whole() -> None:
    budget, text = Budget(), "sum([x for x in range(1000)])"
    for _ in range(10):
        assert evaluate(text, NAMES, budget) == 499_500
    assert 10_000 < Budget().steps - budget.steps < 100_000
    budget.steps = 1000
    with pytest.raises(ExpressionError, match="more work"):
        evaluate(text, NAMES, budget)


# ---- what xacro does --------------------

BOMBS = {
    "a macro that calls itself": (doc('<xacro:macro name="m"><xacro:m/></xacro:macro><xacro:m/>'), "levels deep"),
    "a macro that calls itself by name": (
        doc('<xacro:macro name="m"><xacro:call macro="m"/></xacro:macro><xacro:m/>'),
        "levels deep",
    ),
    "macros that double": (
        doc(
            "".join(f'<xacro:macro name="m{i}"><xacro:m{i + 1}/><xacro:m{i + 1}/></xacro:macro>' for i in range(60))
            + '<xacro:macro name="m60"><a/></xacro:macro><xacro:m0/>'
        ),
        "more work",
    ),
    "a large macro, often": (
        doc('<xacro:macro name="m">' + "<a/>" * 9000 + "</xacro:macro>" + "<xacro:m/>" * 9000),
        "more work",
    ),
    "a large block, often": (
        doc(
            '<xacro:macro name="m" params="**b">'
            + '<xacro:insert_block name="b"/>' * 5000
            + "</xacro:macro><xacro:m><b>"
            + "<a/>" * 5000
            + "</b></xacro:m>"
        ),
        "more work",
    ),
    "texts that double": (
        doc(
            '<xacro:property name="p0" value="xxxxxxxxxx"/>'
            + "".join(f'<xacro:property name="p{i + 1}" value="${{p{i}}}${{p{i}}}"/>' for i in range(50))
            + '<link name="${p50}"/>'
        ),
        "characters",
    ),
    "a long text, often": (
        doc('<xacro:property name="p" value="${\'x\' * 99999}"/>' + '<a n="${p}"/>' * 9000),
        "more work",
    ),
    "many dollars": (doc('<a n="' + "$a" * 90_000 + '"/>'), "more work"),
    "many switches": (doc('<xacro:if value="0"/>' * 45_000), "elements"),
    "many comments": (doc(("<!--a-->" * 30_000 + '<xacro:property name="a" value="1"/>') * 5), "comments"),
    "many parameters": (
        doc('<xacro:macro name="m" params="' + " ".join(f"p{i}:=1" for i in range(99_999)) + '"/>'),
        "parameters of a macro",
    ),
    "properties in a circle": (
        doc('<xacro:property name="p" value="${q}"/><xacro:property name="q" value="${p}"/><a n="${p}"/>'),
        "circular",
    ),
    "properties in a long row": (
        doc(
            "".join(f'<xacro:property name="p{i}" value="${{p{i + 1}}}"/>' for i in range(3000))
            + '<xacro:property name="p3000" value="1"/><a n="${p0}"/>'
        ),
        "nested too deeply",
    ),
    "an expansion without end": (doc('<a n="' + "$" * 30 + '{1}"/>'), "does not come to an end"),
    "a file that includes itself": (doc('<xacro:include filename="r.urdf.xacro"/>'), "without end"),
    "a file that includes itself, by an expression": (
        doc("<xacro:include filename=\"${'r.urdf' + '.xacro'}\"/>"),
        "without end",
    ),
    "a device": (doc('<xacro:include filename="/dev/zero"/>'), "no file /dev/zero"),
    "wildcards in folders": (doc('<xacro:include filename="/*/*/*/*.xacro"/>'), "wildcards"),
    "entities": (
        '<!DOCTYPE r [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">]>' + doc('<a n="&b;"/>'),
        "document type",
    ),
    "the environment": (doc('<a n="$(env HOME)"/>'), "environment"),
    "the environment, as a default": (
        doc('<xacro:arg name="a" default="$(optenv HOME none)"/><a n="$(arg a)"/>'),
        "environment",
    ),
    "the environment, by eval": (doc('<a n="$(eval env)"/>' + "<a n=\"$(eval optenv('HOME'\"/>"), ""),
    "code by eval": (doc('<a n="$(eval [].__class__)"/>'), "__class__"),
    "powers by eval": (doc('<a n="$(eval 9**9**9)"/>'), "bits"),
    "code by an argument": (doc('<xacro:arg name="a" default="().__class__"/><a n="${$(arg a)}"/>'), "__class__"),
    "code in the name of a macro": (doc('<xacro:call macro="${().__class__}"/>'), "__class__"),
    "code in a default": (
        doc('<xacro:macro name="m" params="a:=${().__class__}"/><xacro:m/>'),
        "__class__",
    ),
    "code in a comment": (
        doc("<!-- xacro:eval-comments --><!-- ${().__class__} --><link name='x'/>"),
        "__class__",
    ),
    "a separator that is a pattern": (
        doc("<a n=\"${xacro.tokenize('a' * 40 + 'b', '](a+)+c[')}\"/>") + "<!",
        "well-formed",
    ),
}


@pytest.mark.parametrize("name", BOMBS)
def test_xacro_files_that_would_take_forever_or_look_around(tmp_path: Path, name: str) -> None:
    text, reason = BOMBS[name]
    start = time.process_time()
    with pytest.raises(ModelFileError) as caught:
        rendered(tmp_path, text)
    assert reason in str(caught.value)
    assert "r.urdf.xacro" in str(caught.value)
    assert time.process_time() - start < 2.0


@pytest.mark.parametrize("quote", ["x" * 60 + "'", "'a'a" * 40 + "'"])
def test_an_open_quote_in_the_parameters_of_a_macro_takes_no_time(tmp_path: Path, quote: str) -> None:
    """xacro's own pattern tries 2**60 ways to read it."""
    start = time.process_time()
    rendered(tmp_path, doc(f'<xacro:macro name="m" params="a:={quote}"/>'))
    assert time.process_time() - start < 1.0


@pytest.mark.parametrize(
    "parameters", ["a b:=1 c:='two words' d:=^ e:=^|3 f:=${1+2} *block **blocks", "x:=$(arg y) y=\"a 'b' c\"", "  a  "]
)
def test_parameters_of_macros_are_read_as_by_xacro(parameters: str) -> None:
    own: Any = xacro_engine.engine_for_models()
    rest, theirs = parameters, parameters
    while theirs:
        *here, rest = own.xacro.parse_macro_arg(rest)
        *there, theirs = xacro.parse_macro_arg(theirs)
        assert (here, rest) == (there, theirs)


def test_a_variable_that_is_not_set_gives_its_default(tmp_path: Path) -> None:
    assert "NO_SUCH_VARIABLE_HERE" not in os.environ
    text = doc('<xacro:if value="$(optenv NO_SUCH_VARIABLE_HERE 0)"><a/></xacro:if>')
    assert "<a" not in rendered(tmp_path, text)


def test_yaml_of_models_is_data(tmp_path: Path) -> None:
    (tmp_path / "v.yaml").write_text("a: {b: [1, 2.5]}\nangle: !degrees 90 * 2\nlength: !inches 1\n")
    body = (
        '<xacro:property name="v" value="${xacro.load_yaml(\'v.yaml\')}"/>'
        "<a n=\"${v.a.b[1]} ${v['a']['b'][0]} ${v.angle} ${v.length}\"/>"
    )
    assert f'n="2.5 1 {math.pi} 0.0254"' in rendered(tmp_path, doc(body))
    for content, reason in {
        "a: !!python/object/apply:os.system ['true']": "python/object",
        "a: &a [1, *a]": "holds itself",
        "a: &a [1,1,1,1,1,1,1,1]\nb: &b [*a,*a,*a,*a,*a,*a]\nc: &c [*b,*b,*b,*b,*b,*b,*b]\nd: &d [*c,*c,*c,*c,*c]\n"
        "e: [*d,*d,*d,*d,*d,*d,*d,*d,*d,*d,*d,*d,*d]": "aliases",
        "angle: !degrees (lambda 1)()": "no expression",
        "angle: !degrees ().__class__": "__class__",
        "[" * 500: "deep",
    }.items():
        (tmp_path / "v.yaml").write_text(content)
        with pytest.raises(ModelFileError, match=r"v\.yaml") as caught:
            rendered(tmp_path, doc(body))
        assert reason in str(caught.value)


@pytest.mark.parametrize("link", ["../outside.{}", "{folder}/outside.{}", "linked.{}"])
@pytest.mark.parametrize("kind", ["xacro", "yaml"])
def test_models_read_files_of_their_folder_or_package_only(tmp_path: Path, link: str, kind: str) -> None:
    """What else is on a machine, in YAML or XML, could end up in the arguments of a plan that is passed on."""
    inside = tmp_path / "package" / "urdf"
    inside.mkdir(parents=True)
    outside = tmp_path / "package" / f"outside.{kind}"
    outside.write_text(doc("") if kind == "xacro" else "secret: 5\n")
    (inside / f"linked.{kind}").symlink_to(outside)
    name = link.format(kind, folder=outside.parent)
    if kind == "xacro":
        text = doc("").replace('<link name="base"/>', f'<xacro:include filename="{name}"/>')
    else:
        text = doc(f"<a n=\"${{xacro.load_yaml('{name}').secret}}\"/>")
    with pytest.raises(ModelFileError, match=r"outside.* neither in its folder or package .*--trust|linked.*--trust"):
        rendered(inside, text)
    assert "<robot" in render(inside / "r.urdf.xacro", {}, trust=True)[0]
    (tmp_path / "package" / "package.xml").write_text("<package><name>p</name></package>")
    assert "<robot" in rendered(inside, text)


def test_messages_of_models_cannot_steer_a_terminal(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    rendered(tmp_path, doc('<xacro:property name="v" value="${xacro.warning(\'old \\x1b[2J one\')}"/><a n="${v}"/>'))
    assert caplog.messages == ["old  [2J one"]


# ---- trust --------------------


def test_python_runs_only_with_trust(tmp_path: Path) -> None:
    path = tmp_path / "r.urdf.xacro"
    path.write_text(doc('<a n="${(lambda x: x + 1)(1)} $(env HOME)"/>'))
    with pytest.raises(ModelFileError, match=r"lambda.* trust=True \(--trust\)"):
        render(path, {})
    assert f'n="2 {os.environ["HOME"]}"' in render(path, {}, trust=True)[0]
    with pytest.raises(ModelFileError, match="lambda"):  # trust is of one file, once
        render(path, {})


def test_trust_is_no_argument_that_a_file_could_name(tmp_path: Path) -> None:
    """Files name xacro arguments, which load_robot takes as keywords beside ``trust``."""
    from redundancy_pin.loading import load_with

    with pytest.raises(InputError, match="no argument 'trust'"):
        load_with("3rrr", {"trust": True})
    assert load_robot("3rrr", trust=True).name == "3rrr"


def test_the_users_xacro_stays_as_it_is(tmp_path: Path) -> None:
    before = {name: getattr(xacro, name) for name in ("safe_eval", "eval_text", "parse", "_global_symbols")}
    with pytest.raises(ModelFileError):
        rendered(tmp_path, link("${().__class__}"))
    assert all(getattr(xacro, name) is value for name, value in before.items())
    assert xacro.safe_eval("(lambda: 5)()", {}) == 5


@pytest.mark.parametrize("version", ["2.0.13", "2.2.0", "3.0"])
def test_a_xacro_of_another_version_is_not_guessed_at(monkeypatch: pytest.MonkeyPatch, version: str) -> None:
    monkeypatch.setattr(xacro_engine.importlib.metadata, "version", lambda name: version)
    with pytest.raises(ModelFileError, match=f"xacro is {version}.*Install xacro 2.1"):
        xacro_engine.copy_of_xacro()


def test_a_xacro_whose_insides_are_others_is_not_guessed_at(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(xacro_engine.INSIDES, "safe_eval", ("expression",))
    with pytest.raises(ModelFileError, match="its safe_eval is another"):
        xacro_engine.copy_of_xacro()


def test_files_of_numbers_are_paid_for_by_their_length(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "v.yaml").write_text("\n".join(f"k{i}: {i}" for i in range(300)))
    spent: list[int] = []
    spend = Budget.spend
    monkeypatch.setattr(Budget, "spend", lambda self, steps: spent.append(steps) or spend(self, steps))
    body = '<xacro:property name="v" value="${xacro.load_yaml(\'v.yaml\')}"/><a n="${v[\'k7\']}"/>'
    assert 'n="7"' in rendered(tmp_path, doc(body))
    assert max(spent) >= 600
