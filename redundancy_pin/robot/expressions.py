"""Expressions in models, evaluated without ``eval``: a model is data, and what it may cost is bounded.

The language is Python's: numbers, texts, lists, tuples, dictionaries, sets, arithmetic, comparisons, conditionals,
comprehensions, and calls of functions that are listed. There are no lambdas, assignments, f-strings or attributes,
save the listed methods of texts and containers, and the keys of namespaces and of YAML's mappings.
"""

from __future__ import annotations

import ast
import functools
import math
import operator
import re
import string
import typing
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

LONGEST = 10_000
"""Characters of an expression. CPython's parser takes longer rows of brackets and signs badly."""

LARGEST = 100_000
"""Characters of a text, or elements of a container, those of the containers in it included."""

LARGEST_BITS = 4096
"""Bits of an integer: more than a float can hold, fewer than make arithmetic slow."""


LARGEST_HASHED = 500
"""Elements of a set or dictionary: of numbers with equal hashes each is compared with all."""

_LONGEST_KEPT = 200
"""Characters of an expression whose syntax tree is kept: trees are a hundred times as large as their texts."""


class ExpressionError(ValueError):
    """An expression is not one, uses what models may not, or costs too much."""


@dataclass
class Budget:
    """What is left of the work that the expressions of one model may make: a step is about a microsecond."""

    steps: int = 400_000

    def charge(self, steps: int) -> None:
        """Take steps off the budget.

        Raises:
            ExpressionError: none is left.
        """
        self.steps -= steps
        if self.steps < 0:
            raise ExpressionError("the model takes more work to evaluate than a model may")


@dataclass(frozen=True, repr=False)
class Function:
    """A function that expressions may call: of the evaluation that calls it, and of the arguments."""

    name: str
    call: Callable[..., object]
    kind: type | tuple[type, ...] = ()

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
    budget.charge(1 + len(text) // 8)  # the parser
    if len(text) > LONGEST:
        raise ExpressionError(f"it has {len(text)} characters, more than {LONGEST}")
    try:
        return _Evaluation(names, budget, dotted).value((_kept if len(text) < _LONGEST_KEPT else _parsed)(text.strip()))
    except (RecursionError, MemoryError):
        raise ExpressionError("it is nested too deeply") from None


def _parsed(text: str) -> ast.expr:
    try:
        return ast.parse(text, mode="eval").body
    except (SyntaxError, ValueError) as error:
        raise ExpressionError(f"it is no expression ({error.args[0] if error.args else error})") from None


_kept = functools.lru_cache(maxsize=2048)(_parsed)


def _contains(container: Any, value: Any) -> bool:
    """Return ``value in container``; Python walks through a range for what is no integer."""
    if isinstance(container, range):
        return isinstance(value, (int, float)) and value == value // 1 and int(value) in container
    return operator.contains(container, value)


_BINARY: Mapping[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.FloorDiv: operator.floordiv,
    ast.Mod: operator.mod,
    ast.Pow: operator.pow,
    ast.LShift: operator.lshift,
    ast.RShift: operator.rshift,
    ast.BitAnd: operator.and_,
    ast.BitOr: operator.or_,
    ast.BitXor: operator.xor,
}

_UNARY: Mapping[type[ast.unaryop], Callable[[Any], Any]] = {
    ast.Not: operator.not_,
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
    ast.Invert: operator.invert,
}

_COMPARE: Mapping[type[ast.cmpop], Callable[[Any, Any], Any]] = {
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.Is: operator.is_,
    ast.IsNot: operator.is_not,
    ast.In: lambda a, b: _contains(b, a),
    ast.NotIn: lambda a, b: not _contains(b, a),
}

_VIEWS: tuple[type, ...] = (type({}.keys()), type({}.values()), type({}.items()))
_CONTAINERS: Any = (list, tuple, dict, set, frozenset, *_VIEWS)
_LISTED: Any = type(iter([]))


def _words(text: str) -> frozenset[str]:
    return frozenset(text.split())


_METHODS: Mapping[tuple[type, ...], frozenset[str]] = {
    (str,): _words(
        "lower upper strip lstrip rstrip split rsplit splitlines join replace startswith endswith title capitalize "
        "swapcase find rfind index rindex count isdigit isalpha isalnum isnumeric isdecimal islower isupper isspace "
        "isidentifier zfill center ljust rjust partition rpartition removeprefix removesuffix format"
    ),
    (dict,): _words("keys values items get copy"),
    (list, tuple): _words("index count copy"),
    (set, frozenset): _words("union intersection difference symmetric_difference issubset issuperset isdisjoint copy"),
    (float, int): _words("is_integer"),
}
"""Methods that change nothing and look at nothing but their object and their arguments."""


class _Evaluation:
    """One evaluation: a walk over the syntax tree."""

    def __init__(self, names: Mapping[str, Any], budget: Budget, dotted: tuple[type, ...]) -> None:
        self._scopes: tuple[Mapping[str, Any], ...] = (names,)
        self._budget = budget
        self._dotted = dotted

    def value(self, node: ast.AST) -> Any:
        """Return the value of a node."""
        self._budget.charge(1)
        visit = getattr(self, f"_{type(node).__name__}", None)
        if visit is None:
            raise ExpressionError(f"models may not use {_what(node)}")
        return visit(node)

    def measured(self, value: Any) -> Any:
        """Return a new value, refused where it is larger than a value of a model may be.

        Elements shared by many containers count in each: texts and comparisons of such a value go through them all.
        """
        if isinstance(value, str):
            _require(len(value), LARGEST, "characters")
            self._budget.charge(len(value) // 64)
            return value
        if isinstance(value, (bool, float)) or value is None:
            return value
        if isinstance(value, int):
            _require(value.bit_length(), LARGEST_BITS, "bits")
            return value
        if isinstance(value, complex):
            raise ExpressionError("it is not a real number")
        if isinstance(value, (*_CONTAINERS, _LISTED)):
            if isinstance(value, (dict, set, frozenset)):
                _require(len(value), LARGEST_HASHED, "elements")
            size = 0
            waiting: list[Iterable[Any]] = [[value]] if isinstance(value, _CONTAINERS) else []
            while waiting:
                for element in waiting.pop():
                    size += 1 + (len(element) // 64 if isinstance(element, str) else 0)
                    if isinstance(element, _CONTAINERS):
                        _require(size + len(element), LARGEST, "elements")
                        waiting.append(element.items() if isinstance(element, dict) else element)
            _require(size, LARGEST, "elements")
            self._budget.charge(size // 2)
        return value

    def elements(self, value: Any) -> list[Any]:
        """Return the elements of something that can be run through."""
        if not isinstance(value, (str, range, *_CONTAINERS, _LISTED)):
            raise TypeError(f"{type(value).__name__!r} object is not iterable")
        _require(operator.length_hint(value), LARGEST, "elements")
        listed = [*typing.cast(Iterable[Any], value)]
        self._budget.charge(1 + len(listed) // 8)
        return listed

    def apply(self, function: Any, /, *arguments: Any, **named: Any) -> Any:
        """Return the value of a function that an expression names."""
        if not isinstance(function, Function):
            raise ExpressionError(f"{_shown(function)} is no function that models may call")
        self._budget.charge(1)
        return self.measured(function.call(self, *arguments, **named))

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
        for kinds, methods in _METHODS.items():
            if isinstance(owner, kinds) and name in methods:
                return Function(name, functools.partial(_method, owner, name))
        if isinstance(owner, self._dotted):
            return owner[name]  # type: ignore[index]
        raise ExpressionError(f"models may not use the attribute {name!r} of {_shown(owner)}")

    def _Call(self, node: ast.Call) -> Any:
        function = self.value(node.func)
        named: dict[str, Any] = {}
        for keyword in node.keywords:
            value = self.value(keyword.value)
            if keyword.arg is None and not isinstance(value, dict):
                raise TypeError("the argument after ** is no dictionary")
            named.update({str(key): value[key] for key in value} if keyword.arg is None else {keyword.arg: value})
        return self.apply(function, *self._row(node.args), **named)

    def _row(self, nodes: Iterable[ast.expr]) -> list[Any]:
        row: list[Any] = []
        for node in nodes:
            if isinstance(node, ast.Starred):
                row += self.elements(self.value(node.value))
            else:
                row.append(self.value(node))
        return row

    def _List(self, node: ast.List) -> Any:
        return self.measured(self._row(node.elts))

    def _Tuple(self, node: ast.Tuple) -> Any:
        return self.measured(tuple(self._row(node.elts)))

    def _Set(self, node: ast.Set) -> Any:
        return self.measured(set(_hashable(self, self._row(node.elts))))

    def _Dict(self, node: ast.Dict) -> Any:
        result: dict[Any, Any] = {}
        for key, entry in zip(node.keys, node.values, strict=True):
            value = self.value(entry)
            if key is not None:
                result[self.value(key)] = value
            elif isinstance(value, dict):
                result.update(value)
                _require(len(result), LARGEST_HASHED, "elements")
            else:
                raise TypeError("what follows ** is no dictionary")
        return self.measured(result)

    def _Subscript(self, node: ast.Subscript) -> Any:
        owner, index = self.value(node.value), self.value(node.slice)
        if not isinstance(owner, (str, range, list, tuple, dict)):
            raise TypeError(f"{_shown(owner)} has no elements")
        return self.measured(owner[index]) if isinstance(index, slice) else owner[index]

    def _Slice(self, node: ast.Slice) -> Any:
        return slice(*(None if part is None else self.value(part) for part in (node.lower, node.upper, node.step)))

    def _UnaryOp(self, node: ast.UnaryOp) -> Any:
        operand = self.value(node.operand)
        if not isinstance(node.op, ast.Not) and not isinstance(operand, (bool, int, float)):
            raise TypeError(f"{_shown(operand)} is no number")
        return self.measured(_UNARY[type(node.op)](operand))

    def _BoolOp(self, node: ast.BoolOp) -> Any:
        wanted = isinstance(node.op, ast.Or)
        value: Any = None
        for operand in node.values:
            value = self.value(operand)
            if bool(value) is wanted:
                break
        return value

    def _BinOp(self, node: ast.BinOp) -> Any:
        if type(node.op) not in _BINARY:
            raise ExpressionError(f"models may not use {_what(node.op)}")
        left, right = self.value(node.left), self.value(node.right)
        _require_affordable(node.op, left, right)
        return self.measured(_BINARY[type(node.op)](left, right))

    def _Compare(self, node: ast.Compare) -> Any:
        left, result = self.value(node.left), True
        for comparison, other in zip(node.ops, node.comparators, strict=True):
            right = self.value(other)
            self.measured(left)  # a comparison goes through both
            self.measured(right)
            result = _COMPARE[type(comparison)](left, right)
            if not result:
                break
            left = right
        return result

    def _IfExp(self, node: ast.IfExp) -> Any:
        return self.value(node.body if self.value(node.test) else node.orelse)

    def _ListComp(self, node: ast.ListComp) -> Any:
        return self.measured([self.value(node.elt) for _ in self._loops(node.generators)])

    def _SetComp(self, node: ast.SetComp) -> Any:
        return self.measured({self.value(node.elt) for _ in self._loops(node.generators, LARGEST_HASHED)})

    def _DictComp(self, node: ast.DictComp) -> Any:
        return self.measured(
            {self.value(node.key): self.value(node.value) for _ in self._loops(node.generators, LARGEST_HASHED)}
        )

    def _GeneratorExp(self, node: ast.GeneratorExp) -> Any:
        return iter(self.measured([self.value(node.elt) for _ in self._loops(node.generators)]))

    def _loops(self, generators: list[ast.comprehension], most: int = LARGEST) -> Iterator[None]:
        """Run the loops of a comprehension; its names are gone afterwards."""
        outer = self._scopes
        own: dict[str, Any] = {}
        self._scopes = (own, *outer)
        count = 0
        try:
            for _ in self._loop(generators, own):
                count += 1
                _require(count, most, "elements")
                yield
        finally:
            self._scopes = outer

    def _loop(self, generators: list[ast.comprehension], own: dict[str, Any]) -> Iterator[None]:
        if not generators:
            yield
            return
        first, *inner = generators
        if first.is_async:
            raise ExpressionError("models may not use async")
        for element in self.elements(self.value(first.iter)):
            self._budget.charge(1)
            self._bind(first.target, element, own)
            if all(self.value(condition) for condition in first.ifs):
                yield from self._loop(inner, own)

    def _bind(self, target: ast.expr, value: Any, own: dict[str, Any]) -> None:
        if isinstance(target, ast.Name) and not target.id.startswith("__"):
            own[target.id] = value
        elif isinstance(target, (ast.Tuple, ast.List)):
            values = self.elements(value)
            if len(values) != len(target.elts):
                raise ValueError(f"{len(target.elts)} names for {len(values)} values")
            for part, element in zip(target.elts, values, strict=True):
                self._bind(part, element, own)
        else:
            raise ExpressionError(f"models may not assign to {_what(target)}")


def _require(size: int, most: int, unit: str) -> None:
    if size > most:
        raise ExpressionError(f"a value has more than {most} {unit}")


def _what(node: ast.AST) -> str:
    names = {"Lambda": "lambda", "NamedExpr": "assignments (:=)", "JoinedStr": "f-strings", "Starred": "* here"}
    return names.get(type(node).__name__, type(node).__name__)


def _shown(value: object) -> str:
    """Return a value as it is shown in a message, short whatever its size."""
    if isinstance(value, str):
        return repr(value if len(value) < 60 else value[:57] + "...")
    return str(value) if isinstance(value, (bool, float, Function)) or value is None else f"a {type(value).__name__}"


def _require_affordable(operation: ast.operator, left: Any, right: Any) -> None:
    """Refuse an operation whose result would be too large, before there is one."""
    allowed = (bool, int, float, str, *_CONTAINERS)
    for operand in (left, right):
        if not isinstance(operand, allowed):
            raise TypeError(f"there is no arithmetic with {_shown(operand)}")
    if isinstance(operation, ast.Mult):
        for sequence, count in ((left, right), (right, left)):
            if isinstance(sequence, (str, list, tuple)) and isinstance(count, int):
                _require(len(sequence) * count, LARGEST, "elements")
        if isinstance(left, int) and isinstance(right, int):
            _require(left.bit_length() + right.bit_length(), LARGEST_BITS + 1, "bits")
    elif isinstance(operation, ast.Pow) and isinstance(left, int) and isinstance(right, int):
        # 0 and ±1 to any power are small; the bound is on the last bit that the power could have
        if abs(left) > 1:
            _require((abs(left).bit_length() - 1) * abs(right), LARGEST_BITS, "bits")
    elif isinstance(operation, ast.LShift) and isinstance(left, int) and isinstance(right, int):
        _require(left.bit_length() + right, LARGEST_BITS, "bits")
    elif isinstance(operation, ast.Mod) and isinstance(left, str):
        if re.search(r"\d{4}|\*", left):
            raise ExpressionError(f"the width of {_shown(left)} is too large, or not in it")
        _require(left.count("%") * 1000, 10 * LARGEST, "characters")
        values = right.values() if isinstance(right, dict) else right if isinstance(right, tuple) else (right,)
        _require_formattable(left.count("%"), values)
    elif isinstance(left, _VIEWS) or isinstance(right, _VIEWS):  # which make sets of lists, too
        for operand in (left, right):
            _require(operator.length_hint(operand), LARGEST_HASHED, "elements")


def _method(owner: Any, name: str, run: _Evaluation, /, *arguments: Any, **named: Any) -> Any:
    """Call a listed method, where its result is not too large."""
    if isinstance(owner, str):
        if name == "format":
            return _formatted(owner, arguments, named)
        if name == "join":
            parts = run.elements(*arguments)
            _require(sum(len(p) if isinstance(p, str) else 0 for p in parts) + len(owner) * len(parts), LARGEST, "")
            return owner.join(parts)
        if name == "replace" and len(arguments) >= 2 and all(isinstance(part, str) for part in arguments[:2]):
            old, new = arguments[:2]
            _require(len(owner) + owner.count(old) * len(new), LARGEST, "characters")
        if name in ("zfill", "center", "ljust", "rjust") and arguments and isinstance(arguments[0], int):
            _require(arguments[0], LARGEST, "characters")
    for argument in arguments:
        run.measured(argument)
    if isinstance(owner, (set, frozenset)):
        arguments = tuple(_hashable(run, argument) for argument in arguments)
        _require(sum(map(len, arguments)), LARGEST_HASHED, "elements")
    return getattr(owner, name)(*arguments, **named)


def _formatted(text: str, arguments: tuple[Any, ...], named: Mapping[str, Any]) -> str:
    """Return ``text.format``, whose fields are names and numbers: no attributes, no elements, no fields in fields."""
    for _, field, layout, _ in string.Formatter().parse(text):
        if field and not (field.isidentifier() and not field.startswith("__")) and not field.isdecimal():
            raise ExpressionError(f"models may not use the field {field!r} in a format")
        if layout and re.search(r"\d{4}|[{}]", layout):
            raise ExpressionError(f"models may not use the layout {layout!r} in a format")
    _require(text.count("{") * 1000, 10 * LARGEST, "characters")
    _require_formattable(text.count("{"), (*arguments, *named.values()))
    return text.format(*arguments, **named)


def _require_formattable(fields: int, values: Iterable[Any]) -> None:
    """Refuse containers, whose texts may be megabytes in each field, and texts too long for so many fields."""
    for value in values:
        if not isinstance(value, (bool, int, float, str)) and value is not None:
            raise ExpressionError(f"models may not format {_shown(value)}")
        _require(fields * len(value) if isinstance(value, str) else 0, LARGEST, "characters")


def simple(name: str, function: Callable[..., object], kind: type | tuple[type, ...] = ()) -> Function:
    """Return a function of values that costs no more than they do."""

    def call(run: _Evaluation, /, *arguments: Any, **named: Any) -> object:
        for value in (*arguments, *named.values()):
            run.measured(value)
        return function(*arguments, **named)

    return Function(name, call, kind)


def numeric(name: str, function: Callable[..., object]) -> Function:
    """Return a function of numbers, or of rows of them."""

    def call(run: _Evaluation, /, *arguments: Any) -> object:
        row = [run.elements(each) if isinstance(each, (list, tuple, _LISTED, range)) else each for each in arguments]
        for each in row:
            for number in each if isinstance(each, list) else (each,):
                if not isinstance(number, (bool, int, float)):
                    raise TypeError(f"{name} takes numbers, not {_shown(number)}")
        return function(*row)

    return Function(name, call)


def _list(run: _Evaluation, /, *values: Any) -> list[Any]:
    return run.elements(*values) if values else []


def _hashable(run: _Evaluation, /, *values: Any) -> list[Any]:
    listed = _list(run, *values)
    _require(len(listed), LARGEST_HASHED, "elements")
    return listed


def _dict(run: _Evaluation, /, *pairs: Any, **named: Any) -> dict[Any, Any]:
    if pairs and not isinstance(pairs[0], dict):
        _require(operator.length_hint(pairs[0]), LARGEST_HASHED, "elements")
        pairs = ([tuple(run.elements(pair)) for pair in run.elements(pairs[0])], *pairs[1:])
    return dict(*pairs, **named)


def _map(run: _Evaluation, function: Any, *rows: Any) -> Iterator[Any]:
    columns = zip(*(run.elements(row) for row in rows), strict=False)
    return iter(run.measured([run.apply(function, *column) for column in columns]))


def _filter(run: _Evaluation, function: Any, row: Any) -> Iterator[Any]:
    kept = [each for each in run.elements(row) if (each if function is None else run.apply(function, each))]
    return iter(run.measured(kept))


def _sorted(run: _Evaluation, row: Any, *, key: Any = None, reverse: bool = False) -> list[Any]:
    elements = run.elements(row)
    run.measured(elements)
    return sorted(elements, key=_key(run, key), reverse=reverse)


def _extreme(function: Callable[..., Any]) -> Callable[..., Any]:
    def call(run: _Evaluation, /, *values: Any, key: Any = None, **named: Any) -> Any:
        candidates = run.elements(*values) if len(values) == 1 else list(values)
        run.measured(candidates)
        return function(candidates, key=_key(run, key), **named)

    return call


def _key(run: _Evaluation, key: Any) -> Callable[[Any], Any] | None:
    return None if key is None else functools.partial(run.apply, key)


def _int(run: _Evaluation, /, *values: Any, **named: Any) -> int:
    if values and isinstance(values[0], str):
        _require(len(values[0]), 1000, "digits")
    return int(*values, **named)


def _round(run: _Evaluation, number: Any, ndigits: Any = None) -> Any:
    if ndigits is not None and not (isinstance(ndigits, int) and abs(ndigits) <= 400):
        raise ExpressionError(f"round takes at most 400 digits, not {_shown(ndigits)}")
    if not isinstance(number, (bool, int, float)):
        raise TypeError(f"round takes a number, not {_shown(number)}")
    return round(number, ndigits)


def _sum(run: _Evaluation, row: Any, start: Any = 0) -> Any:
    total = start
    for each in run.elements(row):
        if not isinstance(each, (bool, int, float)) or not isinstance(total, (bool, int, float)):
            raise TypeError(f"sum takes numbers, not {_shown(each)}")
        total = total + each
    return total


def _isinstance(run: _Evaluation, value: Any, kinds: Any) -> bool:
    functions = kinds if isinstance(kinds, tuple) else (kinds,)
    for function in functions:
        if not isinstance(function, Function) or not function.kind:
            raise ExpressionError(f"{_shown(function)} is no kind of value")
    return any(isinstance(value, function.kind) for function in functions)


def _listing(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function of rows that gives one (zip, enumerate, reversed), which is made at once."""

    def call(run: _Evaluation, /, *rows: Any, **named: Any) -> Iterator[Any]:
        listed = [run.elements(row) if isinstance(row, (str, range, *_CONTAINERS, _LISTED)) else row for row in rows]
        return iter(run.measured(list(function(*listed, **named))))

    return call


def _prod(run: _Evaluation, row: Any) -> Any:
    product: Any = 1
    for each in run.elements(row):
        _require_affordable(ast.Mult(), product, each)
        product = run.measured(product * each)
    return product


def _lcm(run: _Evaluation, /, *numbers: Any) -> Any:
    multiple = 1
    for number in numbers:
        multiple = run.measured(math.lcm(multiple, number))
    return multiple


def _bounded(name: str, function: Callable[..., object], most: int) -> Function:
    """Return a function of integers whose value would be too large beyond some argument."""

    def call(run: _Evaluation, /, *arguments: Any) -> object:
        for argument in arguments:
            if isinstance(argument, int):
                _require(argument, most, "in its arguments")
        return function(*arguments)

    return Function(name, call)


BUILTINS: Mapping[str, object] = {
    function.name: function
    for function in (
        Function("list", _list, list),
        Function("dict", _dict, dict),
        Function("map", _map),
        simple("len", len),
        simple("str", str, str),
        simple("float", float, float),
        Function("int", _int, int),
        simple("bool", bool, bool),
        Function("min", _extreme(min)),
        Function("max", _extreme(max)),
        Function("round", _round),
        Function("sorted", _sorted),
        simple("range", range),
        Function("tuple", lambda run, *values: tuple(_list(run, *values)), tuple),
        Function("set", lambda run, *values: set(_hashable(run, *values)), set),
        Function("frozenset", lambda run, *values: frozenset(_hashable(run, *values)), frozenset),
        simple("abs", abs),
        Function("all", lambda run, row: all(run.elements(row))),
        Function("any", lambda run, row: any(run.elements(row))),
        simple("divmod", divmod),
        Function("enumerate", _listing(enumerate)),
        Function("filter", _filter),
        Function("isinstance", _isinstance),
        simple("ord", ord),
        simple("repr", repr),
        Function("reversed", _listing(reversed)),
        Function("sum", _sum),
        Function("zip", _listing(functools.partial(zip, strict=False))),
    )
}
"""Functions by the names that Python has for them."""


def _mathematics() -> dict[str, object]:
    """Return what the module ``math`` has; functions that could be slow are bounded."""
    special = {
        "factorial": _bounded("factorial", math.factorial, 170),
        "comb": _bounded("comb", math.comb, 1000),
        "perm": _bounded("perm", math.perm, 300),
        "prod": Function("prod", _prod),
        "lcm": Function("lcm", _lcm),
    }
    names = {name: value for name, value in vars(math).items() if not name.startswith("_")}
    return {name: numeric(name, value) if callable(value) else value for name, value in names.items()} | special


MATHEMATICS: Mapping[str, object] = _mathematics()
"""The functions and constants of the module ``math``."""
