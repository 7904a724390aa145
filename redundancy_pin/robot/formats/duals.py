"""Numbers of a model that know their derivatives by its arguments, through expressions and through text.

xacro writes numbers as text time and again. Here a number is written with 28 decimals, and six more that say where its
derivative is kept: a decimal is read as the same number by everybody, and with its derivative by ``read``.
"""

from __future__ import annotations

import cmath
import math
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from decimal import Decimal
from typing import Any

import numpy as np

from redundancy_pin.arrays import Array

_STEP = 1e-30
"""Of complex steps: nothing beside any number, so that derivatives are exact to rounding."""

_kept: ContextVar[list[tuple[float, Array]] | None] = ContextVar("kept", default=None)


class LostDerivativeError(ValueError):
    """A model makes something of a number of which the derivative is not known."""


class Dual(float):
    """A number with (d,) derivatives ``dot`` by d arguments."""

    dot: Array

    def __new__(cls, value: float, dot: Array) -> Dual:
        """Make one."""
        self = super().__new__(cls, value)
        self.dot = dot
        return self

    def __str__(self) -> str:
        """Return text that ``read`` makes the same number of, derivatives included."""
        kept = _kept.get()
        if kept is None:
            return float.__repr__(self)
        sign, digits, exponent = Decimal(float.__repr__(self)).as_tuple()
        kept.append((float(self), self.dot))
        mantissa = "".join(map(str, digits)).ljust(29, "0") + f"{len(kept) - 1:06d}"
        return f"{'-' * sign}{mantissa[0]}.{mantissa[1:]}e{int(exponent) + len(digits) - 1:+03d}"

    __repr__ = __str__

    def __format__(self, layout: str) -> str:
        """Return the text; a layout would cut it."""
        if layout:
            raise LostDerivativeError(f"a number is written as {layout}")
        return str(self)

    def __neg__(self) -> Dual:
        return Dual(-float(self), -self.dot)

    def __pos__(self) -> Dual:
        return self

    def __abs__(self) -> Dual:
        return -self if self < 0.0 else self

    def __pow__(self, other: Any, modulus: None = None) -> Any:
        return _of(float.__pow__, _by_power, self, other)

    def __rpow__(self, other: Any, modulus: None = None) -> Any:
        return _of(math.pow, _by_power, other, self)


def _by_power(base: float, exponent: float) -> tuple[float, float]:
    by_base = exponent * base ** (exponent - 1.0) if exponent else 0.0
    return by_base, base**exponent * math.log(base) if base > 0.0 else 0.0


Slopes = Callable[..., tuple[float, ...]]
"""Derivatives of a function of numbers by each of them."""

_ARITHMETIC: Mapping[str, tuple[Callable[[float, float], float], Slopes]] = {
    "add": (float.__add__, lambda a, b: (1.0, 1.0)),
    "sub": (float.__sub__, lambda a, b: (1.0, -1.0)),
    "mul": (float.__mul__, lambda a, b: (b, a)),
    "truediv": (float.__truediv__, lambda a, b: (1.0 / b, -a / b**2)),
}


def _arithmetic(function: Callable[[float, float], float], slopes: Slopes, *, swapped: bool) -> Callable[..., Any]:
    def operation(self: Dual, other: Any) -> Any:
        return _of(function, slopes, *((other, self) if swapped else (self, other)))

    return operation


for _name, (_function, _slopes) in _ARITHMETIC.items():
    setattr(Dual, f"__{_name}__", _arithmetic(_function, _slopes, swapped=False))
    setattr(Dual, f"__r{_name}__", _arithmetic(_function, _slopes, swapped=True))


def _lost(*_: Any) -> Any:
    raise LostDerivativeError("a number is rounded, or divided with a remainder")


for _name in ("floordiv", "rfloordiv", "mod", "rmod", "divmod", "rdivmod", "int", "round", "trunc", "floor", "ceil"):
    setattr(Dual, f"__{_name}__", _lost)


def _of(function: Callable[..., float], slopes: Slopes, *values: Any) -> Any:
    """Return a function of numbers, some of which are dual."""
    if not all(isinstance(value, (int, float)) for value in values):
        return NotImplemented
    numbers = [float(value) for value in values]
    parts = zip(slopes(*numbers), values, strict=True)
    dot = sum(slope * value.dot for slope, value in parts if isinstance(value, Dual))
    return Dual(function(*numbers), np.asarray(dot))


_FUNCTIONS: Mapping[str, Slopes] = {
    "atan2": lambda y, x: (x / (x * x + y * y), -y / (x * x + y * y)),
    "hypot": lambda *x: tuple(each / math.hypot(*x) for each in x),
    "pow": _by_power,
    "radians": lambda x: (math.pi / 180.0,),
    "degrees": lambda x: (180.0 / math.pi,),
    "fabs": lambda x: (math.copysign(1.0, x),),
}


def called(name: str, function: Callable[..., Any], arguments: tuple[Any, ...]) -> Any:
    """Return a function of ``math`` of numbers some of which are dual."""
    slopes = _FUNCTIONS.get(name)
    analytic = getattr(cmath, name, None)
    if slopes is None and callable(analytic) and len(arguments) == 1:

        def slopes(x: float) -> tuple[float, ...]:
            return (analytic(x + _STEP * 1j).imag / _STEP,)

    if slopes is None:
        raise LostDerivativeError(f"the derivative of {name} is not known")
    return _of(function, slopes, *arguments)


_WRITTEN = re.compile(r"[-+]?\d\.\d{28}(\d{6})e[-+]\d{2,3}")
_LITERAL = re.compile(r"\d\.\d{34}e[-+]\d{2,3}")


def read(text: str) -> float | None:
    """Return the number that a text is, with its derivatives where it was written with them; None if it is none."""
    kept, written = _kept.get(), _WRITTEN.fullmatch(text.strip())
    try:
        number = float(text)
    except ValueError:
        return None
    if kept is None or not (written or _LITERAL.search(text)):
        return number
    if written is None or int(written[1]) >= len(kept):
        raise LostDerivativeError(f"a number is part of another: {text}")
    value, dot = kept[int(written[1])]
    if value == 0.0:
        number = math.copysign(0.0, number)
    if abs(number) != abs(value):
        raise LostDerivativeError(f"a number is part of another: {text}")
    negated = text.strip().startswith("-") != (math.copysign(1.0, value) < 0.0)
    return Dual(number, -dot if negated else dot)


def is_written(text: object) -> bool:
    """Return whether a text is a number with derivatives."""
    return _kept.get() is not None and isinstance(text, str) and _WRITTEN.fullmatch(text.strip()) is not None


def named(expression: str) -> tuple[str, dict[str, Any]]:
    """Return an expression with names for the numbers in it that were written with derivatives, and what they are."""
    if _kept.get() is None:
        return expression, {}
    literals = {f"dual{i}_": text for i, text in enumerate(dict.fromkeys(_LITERAL.findall(expression)))}
    for name, text in literals.items():
        expression = expression.replace(text, name)
    return expression, {name: read(text) for name, text in literals.items()}


@contextmanager
def derivatives_kept() -> Iterator[None]:
    """Keep the derivatives of what is written, until the end."""
    token = _kept.set([])
    try:
        yield
    finally:
        _kept.reset(token)
