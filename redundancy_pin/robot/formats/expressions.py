"""Expressions of models, calculated without Python's ``eval``: a list of allowed syntax, functions and sizes.

The language is a part of Python's: numbers, texts, lists and tuples; arithmetic, comparisons, conditionals; calls of
the functions in ``FUNCTIONS`` and of the methods in ``_METHODS``; keys of mappings, with a dot where xacro allows it.
Everything else is refused by its name: comprehensions, lambdas, assignments, formats of texts, other attributes.

Libraries for this purpose (simpleeval 1.0.8, asteval 1.0.10) bound the size of some values, not the work.
"""

from __future__ import annotations

import ast
import functools
import math
import operator
import threading
from collections.abc import Callable, Collection, Iterable, Mapping
from typing import Any

from redundancy_pin.errors import shortened

LONGEST = 10_000
"""Characters of an expression: its tree takes memory before its work is counted."""

LARGEST = 50_000
"""Characters of a text, or elements of a container, those of the containers in it included."""

LARGEST_BITS = 4096
"""Bits of an integer: more than a float can hold, fewer than make arithmetic slow."""

_MOST_WORK = 1_000_000
"""Characters that a method of a text may write or look at."""

_MOST_DIGITS = 400
"""Digits that ``round`` keeps: a float has 324 behind its point at most."""

STEPS = 200_000
"""Work of one model; a step is a few microseconds. The largest public model tried, the PR2, takes 87,000."""


class ExpressionError(ValueError):
    """An expression is not one, uses what models may not use, or costs too much."""


def _round(number: Any, ndigits: int | None = None) -> Any:
    if ndigits is not None and abs(ndigits) > _MOST_DIGITS:
        raise ExpressionError(f"round keeps at most {_MOST_DIGITS} digits")
    return round(number, ndigits)


def _sum(numbers: Any, /, start: Any = 0) -> Any:
    if any(isinstance(each, Collection) for each in (start, *numbers)):  # copies all before each
        raise ExpressionError("sum adds numbers only")
    return sum(numbers, start)


_MATHEMATICS = (
    "acos acosh asin asinh atan atan2 atanh ceil copysign cos cosh degrees e exp fabs floor fmod fsum hypot inf "
    "isclose isfinite isinf isnan log log10 log2 nan pi pow radians sin sinh sqrt tan tanh tau trunc"
)
FUNCTIONS: Mapping[str, Any] = {
    **{each.__name__: each for each in (abs, all, any, bool, dict, float, int, isinstance, len, list, max, min)},
    **{each.__name__: each for each in (range, sorted, str, tuple)},
    "round": _round,
    "sum": _sum,
    **{name: getattr(math, name) for name in _MATHEMATICS.split()},
}
"""Functions and constants by their names in Python: none is slow, reaches anything but its arguments, or calls back."""

_METHODS: Mapping[type, tuple[str, ...]] = {
    str: ("lower", "upper", "strip", "lstrip", "rstrip", "split", "join", "replace", "startswith", "endswith", "title"),
    dict: ("keys", "values", "items", "get"),
}
"""Methods that change nothing."""

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


class Evaluator:
    """Calculates the expressions of one model, whose work is bounded as a whole.

    Args:
        names: what names in expressions stand for.

    Example:
        >>> Evaluator({**FUNCTIONS, "length": 2.0}).eval("max(length, 1) / 4")
        0.5
    """

    def __init__(self, names: Mapping[str, Any]) -> None:
        self.names = names
        self._left = STEPS
        self._trees: dict[str, ast.expr] = {}  # macros evaluate the same expressions time and again

    def spend(self, steps: int) -> None:
        """Count work.

        Raises:
            ExpressionError: the model has used ``STEPS``.
        """
        self._left -= steps
        if self._left < 0:
            raise ExpressionError("the model takes more work to evaluate than a model may")

    def eval(self, text: str, names: Any = None) -> Any:
        """Return the value of an expression.

        Args:
            text: the expression.
            names: what its names stand for, looked up by ``names[name]``; ``self.names`` when left out.

        Raises:
            ExpressionError: not an expression, or one that models may not use, unknown names among them.
            Exception: what Python raises for it (a division by zero, ...).
        """
        self.spend(1 + len(text) // 2)  # the parser
        if len(text) > LONGEST:
            raise ExpressionError(f"it has {len(text)} characters, more than {LONGEST}")
        try:
            if (tree := self._trees.get(text)) is None:
                tree = self._trees[text] = _parse(text.strip())
            return self._value(tree, self.names if names is None else names)
        except (RecursionError, MemoryError):
            raise ExpressionError("it is nested too deeply") from None

    def checked(self, value: Any) -> Any:
        """Return a value; one that is larger than a value of a model may be is refused."""
        if isinstance(value, complex):
            raise ExpressionError("it is not a real number")
        if isinstance(value, int) and value.bit_length() > LARGEST_BITS:
            raise ExpressionError(f"an integer has more than {LARGEST_BITS} bits")
        if isinstance(value, Collection):
            size = _size(value)
            if size > LARGEST:
                raise ExpressionError(f"a text or list has more than {LARGEST} characters or elements")
            self.spend(size // 16)
        return value

    def _value(self, node: ast.AST, names: Any) -> Any:
        self.spend(1)

        def value(part: ast.AST) -> Any:
            return self._value(part, names)

        match node:
            case ast.Constant(value=int() | float() | str() | None):
                return node.value
            case ast.Name():
                return _look_up(node.id, names)
            case ast.List():
                return self.checked([value(each) for each in node.elts])
            case ast.Tuple():
                return self.checked(tuple(value(each) for each in node.elts))
            case ast.Subscript():
                return _element(value(node.value), value(node.slice))
            case ast.Slice():
                return slice(*(part and value(part) for part in (node.lower, node.upper, node.step)))
            case ast.IfExp():
                return value(node.body if value(node.test) else node.orelse)
            case ast.BoolOp():
                return _decide(isinstance(node.op, ast.Or), map(value, node.values))
            case ast.UnaryOp() if type(node.op) in _OPERATORS:
                return _OPERATORS[type(node.op)](value(node.operand))
            case ast.BinOp() if type(node.op) in _OPERATORS:
                left, right = self.checked(value(node.left)), self.checked(value(node.right))
                _require_affordable(node.op, left, right)
                return self.checked(_OPERATORS[type(node.op)](left, right))
            case ast.Compare():
                return self._compare(node, value)
            case ast.Attribute():
                owner = value(node.value)
                if isinstance(owner, dict) and type(owner) is not dict:
                    return _look_up(node.attr, owner)
            case ast.Call() if all(keyword.arg for keyword in node.keywords):
                function = self._function(node.func, value)
                arguments = [self.checked(value(each)) for each in node.args]
                named = {keyword.arg or "": self.checked(value(keyword.value)) for keyword in node.keywords}
                return self.checked(function(*arguments, **named))
        raise ExpressionError(f"models may not use `{shortened(ast.unparse(node), 60)}` ({type(node).__name__})")

    def _function(self, node: ast.expr, value: Callable[[ast.AST], Any]) -> Callable[..., Any]:
        """Return what an expression calls: a listed method of its object, or the value of a name."""
        if isinstance(node, ast.Attribute):
            owner = value(node.value)
            if any(isinstance(owner, kind) and node.attr in methods for kind, methods in _METHODS.items()):
                return functools.partial(_call_method, self.checked(owner), node.attr)
        function: Callable[..., Any] = value(node)
        if not callable(function):
            raise TypeError(f"`{shortened(ast.unparse(node), 60)}` is no function")
        return function

    def _compare(self, node: ast.Compare, value: Callable[[ast.AST], Any]) -> Any:
        left, result = self.checked(value(node.left)), True
        for comparison, other in zip(node.ops, node.comparators, strict=True):
            right = self.checked(value(other))
            result = _OPERATORS[type(comparison)](left, right)
            if not result:
                break
            left = right
        return result


class Namespace(dict[str, Any]):
    """Names that are read with a dot, as ``math.pi``; so are mappings of xacro, of its YAML and includes."""


_PARSING = threading.Lock()
"""CPython 3.11 counts the depth of a tree for all threads together: two that parse at once may end in SystemError."""


def _parse(text: str) -> ast.expr:
    try:
        with _PARSING:
            return ast.parse(text, mode="eval").body
    except (SyntaxError, ValueError) as error:
        raise ExpressionError(f"it is no expression ({error.args[0] if error.args else error})") from None


def _look_up(name: str, names: Any) -> Any:
    try:
        return names[name]
    except KeyError:
        raise ExpressionError(f"the name {name!r} is not defined, or not for models") from None


def _element(owner: Any, index: Any) -> Any:
    if not isinstance(owner, Collection):  # Python gives types elements, too
        raise TypeError(f"a {type(owner).__name__} has no elements")
    return owner[index]  # type: ignore[index]


def _decide(wanted: bool, values: Iterable[Any]) -> Any:
    """Return the first value that decides: one that is true for ``or``, false for ``and``; otherwise the last."""
    value = None
    for value in values:
        if bool(value) is wanted:
            break
    return value


def _size(value: Any) -> int:
    """Return the size of a value, as ``LARGEST`` counts it; shared parts count wherever they occur."""
    if isinstance(value, str):
        return len(value)
    size, waiting = 0, [value]
    while waiting and size <= LARGEST:
        part = waiting.pop()
        if isinstance(part, str):
            size += len(part) // 16
        elif isinstance(part, Collection):
            size += len(part)
            if size <= LARGEST:
                waiting += [*part, *part.values()] if isinstance(part, Mapping) else part
    return size


def _require_affordable(operation: ast.operator, left: Any, right: Any) -> None:
    """Require that the result of an operation is not too large, before it is calculated."""
    if isinstance(operation, ast.Pow) and isinstance(left, int) and isinstance(right, int):
        if left.bit_length() * right > LARGEST_BITS:
            raise ExpressionError(f"a power has more than {LARGEST_BITS} bits")
    elif isinstance(operation, ast.Mod) and isinstance(left, str):
        raise ExpressionError("models may not format texts by %")
    elif isinstance(operation, ast.Mult):
        for many, count in ((left, right), (right, left)):
            if isinstance(many, (str, list, tuple)) and isinstance(count, int) and _size(many) * count > LARGEST:
                raise ExpressionError(f"a text or list has more than {LARGEST} characters or elements")


def _call_method(owner: Any, name: str, *arguments: Any) -> Any:
    work = max(len(owner), 1) * sum(_size(each) for each in arguments)  # of replacing and joining
    if work > _MOST_WORK:
        raise ExpressionError(f"{name} takes too much work here")
    return getattr(owner, name)(*arguments)
