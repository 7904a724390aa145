"""Expressions in models, evaluated without ``eval``: a model is data, and what it may cost is bounded.

The language is the part of Python's that models are written in: numbers, texts, lists, tuples, dictionaries,
arithmetic, comparisons, conditionals, comprehensions of lists, and calls of functions that are listed. There are no
lambdas, assignments, sets, f-strings or attributes, save the listed methods of texts and containers, and the keys of
namespaces and of YAML's mappings. What Python makes step by step (``range``, ``map``, ...) is a list here.

simpleeval 1.0.8 and asteval 1.0.10 would not do: they bound the size of some values, not the work. Of nineteen hostile
expressions simpleeval let nine through (``'%999999999d' % 1``: 970 MB; ``factorial(10**6)``, ``sum(range(10**9))`` and
``[x for x in [[[0]*99999]*99999]]``: more than 6 s), asteval eleven; here all are
refused within 0.3 s and 5 MB.
"""

from __future__ import annotations

import ast
import functools
import math
import operator
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

LONGEST = 10_000
"""Characters of an expression. CPython's parser takes longer rows of brackets and signs badly."""

LARGEST = 100_000
"""Characters of a text, or elements of a container, those of the containers in it included."""

LARGEST_BITS = 4096
"""Bits of an integer: more than a float can hold, fewer than make arithmetic slow."""

LARGEST_HASHED = 200
"""Elements of a dictionary that an expression makes: of numbers with equal hashes each is compared with all."""


class ExpressionError(ValueError):
    """An expression is not one, uses what models may not, or costs too much."""


@dataclass
class Budget:
    """What is left of the work that the expressions of one model may make: a step is about a microsecond."""

    steps: int = 300_000

    def spend(self, steps: int) -> None:
        """Take steps off the budget.

        Raises:
            ExpressionError: none is left.
        """
        self.steps -= steps
        if self.steps < 0:
            raise ExpressionError("the model takes more work to evaluate than a model may")


@dataclass(frozen=True, repr=False)
class Function:
    """A function that expressions may call; where ``runs`` is set, it gets the evaluation that calls it first."""

    name: str
    call: Callable[..., object]
    runs: bool = False

    def __repr__(self) -> str:
        """Return what an expression that forgot to call it shows."""
        return f"<function {self.name}>"


class Namespace(dict[str, object]):
    """Names that are read with a dot: ``math.pi``."""


def evaluate(text: str, names: Mapping[str, Any], budget: Budget, dotted: tuple[type, ...] = (Namespace,)) -> Any:
    """Return the value of an expression.

    Args:
        text: the expression.
        names: what its names stand for; functions are ``Function``.
        budget: shared by all expressions of a model.
        dotted: the kinds of mappings whose items are read with a dot.

    Raises:
        ExpressionError: not an expression, or one that models may not use.
        Exception: what Python raises for it (a division by zero, an unknown name, ...).
    """
    budget.spend(1 + len(text) // 2)  # the parser
    _require(len(text), LONGEST, "characters")
    try:
        return _Evaluation((names,), budget, dotted).value(_parsed(text.strip()))
    except (RecursionError, MemoryError):
        raise ExpressionError("it is nested too deeply") from None


def _parsed(text: str) -> ast.expr:
    try:
        return ast.parse(text, mode="eval").body
    except (SyntaxError, ValueError) as error:
        raise ExpressionError(f"it is no expression ({error.args[0] if error.args else error})") from None


_OPERATORS: Mapping[type[ast.AST], Callable[..., Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.FloorDiv: operator.floordiv,
    ast.Mod: operator.mod,
    ast.Pow: operator.pow,
    ast.Not: operator.not_,
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.Is: operator.is_,
    ast.IsNot: operator.is_not,
    ast.In: lambda a, b: operator.contains(b, a),
    ast.NotIn: lambda a, b: not operator.contains(b, a),
}

_CONTAINERS = (list, tuple, dict)

_METHODS: Mapping[type, frozenset[str]] = {
    kind: frozenset(names.split())
    for kind, names in {
        str: "lower upper strip lstrip rstrip split rsplit join replace startswith endswith title capitalize find "
        "index count isdigit isalpha isalnum zfill format",
        dict: "keys values items get",
        list: "index count",
        tuple: "index count",
    }.items()
}
"""Methods that change nothing and look at nothing but their object and their arguments."""


class _Evaluation:
    """One evaluation: a walk over the syntax tree."""

    def __init__(self, scopes: tuple[Mapping[str, Any], ...], budget: Budget, dotted: tuple[type, ...]) -> None:
        self._scopes = scopes
        self._budget = budget
        self._dotted = dotted

    def value(self, node: ast.AST) -> Any:
        """Return the value of a node."""
        self._budget.spend(1)
        visit = getattr(self, f"_{type(node).__name__}", None)
        if visit is None:
            raise ExpressionError(f"models may not use {_what(node)}")
        return visit(node)

    def measured(self, value: Any) -> Any:
        """Return a value, refused where it is larger than a value of a model may be.

        Elements shared by many containers count in each: texts and comparisons of such a value go through them all.
        """
        if isinstance(value, str):
            _require(len(value), LARGEST, "characters")
            self._budget.spend(len(value) // 64)
        elif isinstance(value, int):
            _require(value.bit_length(), LARGEST_BITS, "bits")
        elif isinstance(value, complex):
            raise ExpressionError("it is not a real number")
        elif isinstance(value, _CONTAINERS):
            size, waiting = 0, [value]
            while waiting:
                part = waiting.pop()
                for element in part.items() if isinstance(part, dict) else part:
                    size += 1 + (len(element) // 64 if isinstance(element, str) else 0)
                    if isinstance(element, _CONTAINERS):
                        _require(size + len(element), LARGEST, "elements")
                        waiting.append(element)
                _require(size, LARGEST, "elements")  # of each part, or thousands of long ones were walked through
            self._budget.spend(size // 2)
        return value

    def apply(self, function: Any, /, *arguments: Any, **named: Any) -> Any:
        """Return the value of a function that an expression names."""
        if not isinstance(function, Function):
            raise ExpressionError(f"{_shown(function)} is no function that models may call")
        self._budget.spend(1)
        for argument in (*arguments, *named.values()):
            self.measured(argument)
        run = (self,) if function.runs else ()
        return self.measured(function.call(*run, *arguments, **named))

    def _Constant(self, node: ast.Constant) -> Any:
        if not (node.value is None or isinstance(node.value, (bool, int, float, str))):
            raise ExpressionError(f"models may not use {node.value!r}")
        return self.measured(node.value)

    def _Name(self, node: ast.Name) -> Any:
        if node.id.startswith("__"):
            raise ExpressionError(f"models may not use the name {node.id!r}")
        for scope in self._scopes:
            try:
                return scope[node.id]
            except KeyError:
                continue
        raise NameError(f"name {node.id!r} is not defined, or not for models")

    def _Attribute(self, node: ast.Attribute) -> Any:
        owner, name = self.value(node.value), node.attr
        if name.startswith("__"):
            raise ExpressionError(f"models may not use the attribute {name!r}")
        for kind, methods in _METHODS.items():
            if isinstance(owner, kind) and name in methods:
                return Function(name, functools.partial(_method, self.measured(owner), name))
        if isinstance(owner, self._dotted):
            return owner[name]  # type: ignore[index]
        raise ExpressionError(f"models may not use the attribute {name!r} of {_shown(owner)}")

    def _Call(self, node: ast.Call) -> Any:
        function = self.value(node.func)
        named: dict[str, Any] = {}
        for keyword in node.keywords:
            if keyword.arg is None:
                raise ExpressionError("models may not use ** here")
            named[keyword.arg] = self.value(keyword.value)
        return self.apply(function, *map(self.value, node.args), **named)

    def _List(self, node: ast.List) -> Any:
        return self.measured([self.value(each) for each in node.elts])

    def _Tuple(self, node: ast.Tuple) -> Any:
        return self.measured(tuple(self.value(each) for each in node.elts))

    def _Dict(self, node: ast.Dict) -> Any:
        if None in node.keys:
            raise ExpressionError("models may not use ** here")
        _require(len(node.keys), LARGEST_HASHED, "elements")
        pairs = zip(node.keys, node.values, strict=True)
        return self.measured({self.value(key): self.value(value) for key, value in pairs if key is not None})

    def _Subscript(self, node: ast.Subscript) -> Any:
        owner, index = self.value(node.value), self.value(node.slice)
        if not isinstance(owner, (str, *_CONTAINERS)):
            raise TypeError(f"{_shown(owner)} has no elements")
        self.measured(index)  # its hash goes through it
        return self.measured(owner[index]) if isinstance(index, slice) else owner[index]

    def _Slice(self, node: ast.Slice) -> Any:
        return slice(*(None if part is None else self.value(part) for part in (node.lower, node.upper, node.step)))

    def _UnaryOp(self, node: ast.UnaryOp) -> Any:
        operand = self.value(node.operand)
        if not isinstance(node.op, ast.Not) and not isinstance(operand, (int, float)):
            raise TypeError(f"{_shown(operand)} is no number")
        return self.measured(_operation(node.op)(operand))

    def _BoolOp(self, node: ast.BoolOp) -> Any:
        wanted = isinstance(node.op, ast.Or)
        value: Any = None
        for operand in node.values:
            value = self.value(operand)
            if bool(value) is wanted:
                break
        return value

    def _BinOp(self, node: ast.BinOp) -> Any:
        operation, left, right = _operation(node.op), self.value(node.left), self.value(node.right)
        _require_affordable(node.op, left, right)
        return self.measured(operation(left, right))

    def _Compare(self, node: ast.Compare) -> Any:
        left, result = self.value(node.left), True
        for comparison, other in zip(node.ops, node.comparators, strict=True):
            right = self.value(other)
            # which goes through both
            result = _operation(comparison)(self.measured(left), self.measured(right))
            if not result:
                break
            left = right
        return result

    def _IfExp(self, node: ast.IfExp) -> Any:
        return self.value(node.body if self.value(node.test) else node.orelse)

    def _ListComp(self, node: ast.ListComp | ast.GeneratorExp) -> Any:
        """Return the list of a comprehension, whose names are gone afterwards."""
        outer, own = self._scopes, dict[str, Any]()
        self._scopes = (own, *outer)
        row: list[Any] = []
        try:
            for _ in self._loop(node.generators, own):
                _require(len(row), LARGEST, "elements")
                row.append(self.value(node.elt))
        finally:
            self._scopes = outer
        return self.measured(row)

    _GeneratorExp = _ListComp

    def _loop(self, generators: list[ast.comprehension], own: dict[str, Any]) -> Iterator[None]:
        if not generators:
            yield
            return
        first, *inner = generators
        if first.is_async:
            raise ExpressionError("models may not use async")
        for element in _elements(self.measured(self.value(first.iter))):
            self._budget.spend(1)
            _bind(first.target, element, own)
            if all(self.value(condition) for condition in first.ifs):
                yield from self._loop(inner, own)


def _bind(target: ast.expr, value: Any, own: dict[str, Any]) -> None:
    if isinstance(target, ast.Name) and not target.id.startswith("__"):
        own[target.id] = value
    elif isinstance(target, (ast.Tuple, ast.List)):
        for part, element in zip(target.elts, _elements(value), strict=True):
            _bind(part, element, own)
    else:
        raise ExpressionError(f"models may not assign to {_what(target)}")


def _operation(node: ast.AST) -> Callable[..., Any]:
    if type(node) not in _OPERATORS:
        raise ExpressionError(f"models may not use {_what(node)}")
    return _OPERATORS[type(node)]


def _require(size: int, most: int, unit: str) -> None:
    if size > most:
        raise ExpressionError(f"a value has more than {most} {unit}")


def _what(node: ast.AST) -> str:
    names = {"Lambda": "lambda", "NamedExpr": "assignments (:=)", "JoinedStr": "f-strings", "Starred": "* here"}
    return names.get(type(node).__name__, type(node).__name__)


def _shown(value: object) -> str:
    """Return the text of a value for a message, short whatever its size."""
    if isinstance(value, str):
        return repr(value if len(value) < 60 else value[:57] + "...")
    return str(value) if isinstance(value, (bool, float, Function)) or value is None else f"a {type(value).__name__}"


def _elements(value: Any) -> list[Any]:
    if not isinstance(value, (str, *_CONTAINERS)):
        raise TypeError(f"{type(value).__name__!r} object is not iterable")
    return list(value)


def _require_affordable(operation: ast.operator, left: Any, right: Any) -> None:
    """Refuse an operation whose result would be too large, before there is one."""
    for operand in (left, right):
        if not isinstance(operand, (int, float, str, *_CONTAINERS)):
            raise TypeError(f"there is no arithmetic with {_shown(operand)}")
    integers = isinstance(left, int) and isinstance(right, int)
    if isinstance(operation, ast.Mult):
        for sequence, count in ((left, right), (right, left)):
            if isinstance(sequence, (str, list, tuple)) and isinstance(count, int):
                _require(len(sequence) * count, LARGEST, "elements")
        if integers:
            _require(left.bit_length() + right.bit_length(), LARGEST_BITS + 1, "bits")
    elif isinstance(operation, ast.Pow) and integers and abs(left) > 1:
        # the bound is on the last bit that the power could have
        _require((abs(left).bit_length() - 1) * abs(right), LARGEST_BITS, "bits")
    elif isinstance(operation, ast.Mod) and isinstance(left, str):
        _require_formattable(_PERCENT, left, right if isinstance(right, tuple) else (right,))


_LAYOUT = r"[-+ #<>^]*\d{0,3}(?:\.\d{1,3})?[a-zA-Z]"
_PERCENT = re.compile(rf"(?:[^%]|%%|%{_LAYOUT})*")
_BRACES = re.compile(rf"(?:[^{{}}]|\{{\{{|\}}\}}|\{{(?!_)\w*(?::{_LAYOUT}?)?\}})*")
"""Texts with fields to fill: no attributes, no elements, no fields in fields, and at most 999 characters wide."""

_FIELD = 1300
"""Characters that a number fills a field with, the most digits that an integer of ``LARGEST_BITS`` has."""


def _require_formattable(pattern: re.Pattern[str], text: str, values: Iterable[Any]) -> None:
    """Refuse layouts that are not listed, containers, whose texts may be megabytes, and texts too long or too often."""
    if not pattern.fullmatch(text):
        raise ExpressionError(f"models may not use the layout {_shown(text)} of a text")
    fields = text.count("%" if pattern is _PERCENT else "{")
    for value in values:
        if not isinstance(value, (int, float, str)) and value is not None:
            raise ExpressionError(f"models may not format {_shown(value)}")
        _require(fields * max(_FIELD, len(value) if isinstance(value, str) else 0), LARGEST, "characters")


def _method(owner: Any, name: str, /, *arguments: Any, **named: Any) -> Any:
    """Call a listed method, where its result is not too large."""
    if isinstance(owner, str):
        if name == "format":
            _require_formattable(_BRACES, owner, (*arguments, *named.values()))
        elif name == "join" and arguments:
            parts = _elements(arguments[0])
            lengths = sum(len(part) for part in parts if isinstance(part, str))
            _require(lengths + len(owner) * len(parts), LARGEST, "characters")
        elif name == "replace" and len(arguments) >= 2 and all(isinstance(part, str) for part in arguments[:2]):
            _require(len(owner) + owner.count(arguments[0]) * len(arguments[1]), LARGEST, "characters")
        elif name == "zfill" and arguments and isinstance(arguments[0], int):
            _require(arguments[0], LARGEST, "characters")
    result = getattr(owner, name)(*arguments, **named)
    return list(result) if name in ("keys", "values", "items") else result


def _map(run: _Evaluation, function: Any, *rows: Any) -> list[Any]:
    return [run.apply(function, *column) for column in zip(*map(_elements, rows), strict=False)]


def _range(*ends: int) -> list[int]:
    row = range(*ends)
    _require((row.stop - row.start) // row.step, LARGEST, "elements")
    return list(row)


def _dict(*pairs: Any, **named: Any) -> dict[Any, Any]:
    for given in pairs:
        _require(len(given), LARGEST_HASHED, "elements")
    return dict(*pairs, **named)


def _int(*values: Any, **named: Any) -> int:
    if values and isinstance(values[0], str):
        _require(len(values[0]), 1000, "digits")
    return int(*values, **named)


def _round(number: Any, ndigits: Any = None) -> Any:
    if ndigits is not None and not (isinstance(ndigits, int) and abs(ndigits) <= 400):
        raise ExpressionError(f"round takes at most 400 digits, not {_shown(ndigits)}")
    return round(number, ndigits)


def _numeric(function: Function) -> Function:
    """Return a function of numbers, or of rows of them."""

    def call(*arguments: Any, **named: Any) -> object:
        for each in (*arguments, *named.values()):
            for number in each if isinstance(each, (list, tuple)) else (each,):
                if not isinstance(number, (int, float)):
                    raise TypeError(f"{function.name} takes numbers, not {_shown(number)}")
        return function.call(*arguments, **named)

    return Function(function.name, call)


def _factorial(number: int) -> int:
    _require(number, 170, "in its arguments")
    return math.factorial(number)


def _listed(function: Callable[..., Iterable[Any]]) -> Callable[..., list[Any]]:
    return lambda *rows, **named: list(function(*rows, **named))


BUILTINS: Mapping[str, object] = {
    each.__name__: Function(each.__name__, each) for each in (len, str, bool, tuple, min, max, abs, all, any, ord)
} | {
    "dict": Function("dict", _dict),
    "enumerate": Function("enumerate", _listed(enumerate)),
    "float": Function("float", float),
    "int": Function("int", _int),
    "list": Function("list", list),
    "map": Function("map", _map, runs=True),
    "range": Function("range", _range),
    "reversed": Function("reversed", _listed(reversed)),
    "round": _numeric(Function("round", _round)),
    "sorted": Function("sorted", sorted),
    "sum": _numeric(Function("sum", sum)),
    "zip": Function("zip", _listed(zip)),
}
"""Functions by the names that Python has for them."""


_SLOW = ("comb", "perm", "prod", "lcm")

MATHEMATICS: Mapping[str, object] = {
    name: _numeric(Function(name, _factorial if name == "factorial" else value)) if callable(value) else value
    for name, value in vars(math).items()
    if not name.startswith("_") and name not in _SLOW
}
"""The functions and constants of the module ``math``, save those whose values grow beyond all bounds."""
