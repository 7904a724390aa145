"""Array aliases, validation at the door, read-only results, and the named tolerances."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
from enum import IntEnum
from functools import cached_property, lru_cache
from itertools import pairwise
from types import MappingProxyType
from typing import Any, Literal, TypeAlias, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from redundancy_pin.errors import InputError, did_you_mean, shown

Array: TypeAlias = NDArray[np.float64]
BoolArray: TypeAlias = NDArray[np.bool_]
IntArray: TypeAlias = NDArray[np.intp]

LARGEST = 1e100
"""Numbers beyond it are refused as infinite, for their products are; so are positive ones below its inverse."""

CLOSURE_TOLERANCE = 1e-11
"""Largest closure residual, in characteristic lengths (radians for rotation rows), of a configuration that counts as
closed: a hundred roundings above what Newton reaches."""

SINGULAR_MARGIN = float(np.sqrt(2.0 * CLOSURE_TOLERANCE))
"""Scaled margin below which a pose counts as a type I singularity. At a stretched leg two configurations meet in a
square root: one that is closed to within the tolerance is known no better than this."""

RANK_TOLERANCE = 1e-9
"""Scaled singular values below this fraction of the largest one count as zero. The square root of
the rounding unit is 1.5e-8; poses found by root finding reach 1e-12."""

FILE_TOLERANCE = 1e-3
"""Largest contradiction between the numbers of a file, rad or characteristic lengths. Placements rounded to 1e-4 miss
by up to 5e-4 in the loops of the shipped planar robots; placements that are wrong by 1e-2, by 3e-3 and more."""

AGREEMENT_TOLERANCE = 1e-8
"""Largest contradiction between positions of redundant motors, characteristic lengths or rad: a thousand times the
closure tolerance, for what margins of 1e-3 make of it. Of their velocities, as a fraction."""

ROUNDED_SHARE = 1e-16 / 1e-5
"""Rounding of a configuration, rad, over the share of accelerations that it may take. Accelerations err by the rounding
times rates squared over the cube of K's margin: below its cube root, 2e-4, margins next to a rank loss of the closures
are too small."""

NEAR_SINGULAR_MARGIN = 0.05
"""Scaled margin below which a pose is reported as near-singular; on the 2-RPR it is reached at a
condition number of 28, just above the largest threshold the thesis works with (20)."""


_DECIMAL = re.compile(r"\s*([+-]?((\d+\.?\d*|\.\d+)(e[+-]?\d+)?|inf(inity)?|nan))\s*", re.ASCII | re.IGNORECASE)


def decimal(text: str) -> float:
    """Return a decimal number from text; ValueError for other text.

    ``float`` also reads 1_0 as ten, and digits of any script; other readers of the same file do not.
    """
    if not _DECIMAL.fullmatch(text):
        raise ValueError(f"{text!r} is no decimal number")
    return float(text)


class Labelled(IntEnum):
    """Numbers with names: for arrays of statuses."""

    @property
    def label(self) -> str:
        """The name in lower case, as tables and files show it: ``near_singular``."""
        return self.name.lower()


def frozen(values: ArrayLike) -> Array:
    """Return ``values`` as a read-only float64 array that shares no memory with its source."""
    array = np.array(values, dtype=np.float64)
    array.setflags(write=False)
    return array


def read_only(array: NDArray[Any]) -> NDArray[Any]:
    """Mark a freshly computed array read-only, without a copy, and return it."""
    array.setflags(write=False)
    return array


_Self = TypeVar("_Self", bound="Frozen")


class Frozen:
    """Base of types with read-only arrays: copies of them, and what other processes get, are read-only too.

    What is computed again when it is needed stays behind (pools of Pinocchio data are among it).
    """

    def __getstate__(self) -> dict[str, Any]:
        """Return what travels: attributes, mapping proxies as the mappings behind them."""
        again = [name for name in vars(self) if isinstance(getattr(type(self), name, None), cached_property)]
        state = {name: value for name, value in vars(self).items() if name not in again}
        return {
            name: _Proxied(value) if isinstance(value, MappingProxyType) else value for name, value in state.items()
        }

    def __copy__(self: _Self) -> _Self:
        """Return a shallow copy: the same arrays, read-only where they are."""
        other = object.__new__(type(self))
        assign(other, **vars(self))
        return other

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Take the attributes over, arrays read-only."""
        assign(self, **{name: _as_it_was(value) for name, value in state.items()})


class ByValue(Frozen):
    """Base of frozen dataclasses with arrays that are equal where their fields have the same numbers."""

    def __eq__(self, other: object) -> bool:
        """Return whether the fields are the same."""
        if type(other) is not type(self):
            return NotImplemented
        return self._values == other._values

    def __hash__(self) -> int:
        """Equal values have equal hashes."""
        return hash(self._values)

    @property
    def _values(self) -> tuple[object, ...]:
        """The fields in a form that can be compared: bytes of arrays would not do, 0.0 and -0.0 differ in them."""
        return tuple(_comparable(getattr(self, field.name)) for field in fields(self))  # type: ignore[arg-type]


def _comparable(value: Any) -> object:
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, Mapping):
        return frozenset((name, _comparable(part)) for name, part in value.items())
    return tuple(_comparable(part) for part in value) if isinstance(value, (list, tuple)) else value


def detached(value: Any) -> Any:
    """Return what an argument holds, out of reach of its owner: arrays copied, read-only, lists as tuples, mappings."""
    if isinstance(value, np.ndarray):
        return read_only(value.copy())
    if isinstance(value, Mapping):
        return MappingProxyType({name: detached(part) for name, part in value.items()})
    return tuple(detached(part) for part in value) if isinstance(value, (list, tuple)) else value


class _Proxied(dict[str, Any]):
    """The mapping behind a proxy, which itself can be neither pickled nor copied."""


def _as_it_was(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return read_only(value)
    if isinstance(value, _Proxied):
        return MappingProxyType(dict(value))
    for part in value if isinstance(value, (tuple, list)) else value.values() if isinstance(value, dict) else ():
        _as_it_was(part)
    return value


def assign(target: object, **values: object) -> None:
    """Set the fields of a frozen dataclass, once, in an ``__init__`` that checks them first."""
    for name, value in values.items():
        object.__setattr__(target, name, value)


def numbers(values: ArrayLike, name: str, shape: Sequence[int | str]) -> Array:
    """Return ``values`` as an array of doubles after checking its shape; they need not be finite.

    Args:
        values: anything numpy can turn into an array of floats; an array of doubles is returned as it is.
        name: what to call it in an error.
        shape: expected length of each axis; a string means any length.

    Raises:
        InputError: not real numbers (complex ones, text, None, masked ones), wrong number of axes, wrong length.
    """
    try:
        array = np.asarray(values)
        kind = array.dtype.kind
        # naming numpy.ma imports it, which takes 8 ms: no array is masked before somebody has imported it
        masked = "numpy.ma" in sys.modules and np.ma.is_masked(values)
        if kind in "cSU" or masked or (kind == "O" and None in array.ravel().tolist()):
            # numpy makes numbers of text, of what is masked, a real part of complex numbers, and NaN of None
            kinds = {"c": "complex numbers", "S": "text", "U": "text", "O": "None"}
            raise TypeError(f"it holds {kinds.get(kind, 'masked values')}")
        array = np.asarray(array, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(
            f"{name} is not an array of numbers: {error}.",
            remedy="Pass a rectangular array of finite floats.",
            name=name,
        ) from error
    if array.shape != shape and not (
        array.ndim == len(shape)
        and all(isinstance(want, str) or got == want for got, want in zip(array.shape, shape, strict=True))
    ):
        expected = "(" + ", ".join(str(length) for length in shape) + ("," if len(shape) == 1 else "") + ")"
        raise InputError(
            f"{name} has shape {array.shape}, expected {expected}.",
            remedy="Rows are samples, columns are coordinates.",
            name=name,
            shape=array.shape,
            expected=tuple(shape),
        )
    return array


def checked(values: ArrayLike, name: str, shape: Sequence[int | str]) -> Array:
    """Return a read-only float64 copy of ``values`` after checking shape and finiteness.

    Args:
        values: anything numpy can turn into an array of floats.
        name: what to call it in an error.
        shape: expected length of each axis; a string means any length.

    Raises:
        InputError: as ``numbers``; a NaN or infinity, or a number beyond 1e100.
    """
    array = frozen(numbers(values, name, shape))
    bad = ~(np.abs(array) <= LARGEST)
    if bad.any():
        where = tuple(int(i) for i in np.argwhere(bad)[0])
        what = f"beyond {LARGEST:g}" if np.isfinite(array[bad]).all() else "not finite"
        raise InputError(
            f"{name} has {int(bad.sum())} value(s) that are {what}, the first at index {where}: {array[where]}.",
            remedy="Remove or repair those samples.",
            name=name,
            index=where,
        )
    return array


_BLOCK = 4000
"""Samples in a block unless a caller passes its own number, which depends on what it keeps for each sample."""


@lru_cache(maxsize=1)
def lapack() -> Any:
    """Return scipy's LAPACK, which takes a quarter of the time of numpy.linalg; scipy is imported when first used.

    Example:
        >>> factored, pivots, solution, failed = lapack().dgesv(A, b)
    """
    from scipy.linalg import lapack as functions

    return functions


def blocks(samples: int, size: int = _BLOCK) -> list[slice]:
    """Return the parts in which many samples are worked on, so that what a part takes stays in the cache.

    They are alike in length: of a single sample left over numpy would sum in another order than of many.
    """
    edges = np.linspace(0, samples, -(-samples // size) + 1).round().astype(int).tolist()
    return [slice(first, last) for first, last in pairwise(edges)]


def runs(flags: BoolArray) -> list[tuple[int, int]]:
    """Return start and stop of each run of true values among (N,) flags."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(int)))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def stretches(values: NDArray[Any]) -> list[tuple[int, int]]:
    """Return start and stop of each stretch of (N,) values in which all are the same."""
    edges = [0, *(np.flatnonzero(np.diff(values)) + 1).tolist(), len(values)]
    return list(pairwise(edges))


def largest(values: Array) -> Array:
    """Return (m,) the largest magnitude in each column of (N, m), NaN left out; zero where nothing is left."""
    return np.asarray(np.nanmax(np.abs(values), axis=0, initial=0.0))


def peak(name: str, values: Array, unit: str) -> str:
    """Return the largest magnitude in each column of (N, m) as text for a ``repr``: ``peak |tau| 0.31, 0.28 N``."""
    return (
        f"peak |{name}| {', '.join(f'{value:.4g}' for value in largest(values))} {unit}"
        if values.size
        else f"no {name}"
    )


Side: TypeAlias = Literal["left", "right"]
"""Which limit to take where a function jumps: before the jump, or after it."""

ROUNDING = 1e-12
"""Relative distance below which two times or two arc lengths count as the same: a thousand times
what a few dozen additions of doubles lose, and far below any sampling interval."""


def require_type(value: object, kind: type | tuple[type, ...], what: str, remedy: str) -> None:
    """Check the type of an argument, before a missing attribute raises AttributeError.

    Raises:
        InputError: another type; ``what`` was expected, such as "A plan".
    """
    if not isinstance(value, kind):
        raise InputError(f"{what} was expected, not {type(value).__name__}.", remedy=remedy)


def require_few(count: float, most: int, what: str, remedy: str, **details: object) -> None:
    """Check a count before time and memory are spent.

    Raises:
        InputError: ``count``, which replaces the braces in ``what`` ("The map has {} cells"), is above ``most``.
    """
    if not count <= most:
        message = what.replace("{}", f"{min(count, 1e300):.4g}")  # no float is as large as some integers
        raise InputError(f"{message}; at most {most} are possible.", remedy=remedy, most=most, **details)


def rows_of(values: ArrayLike, name: str, shape: tuple[int | str, int | str]) -> Array:
    """Return what ``checked`` does of rows (N, k), of which a single one may be given as (k,)."""
    try:
        one = np.ndim(values) < 2
    except ValueError:  # rows of several lengths, which the check says
        one = False
    return checked(np.atleast_2d(np.asanyarray(values)) if one else values, name, shape)


def real(value: Any) -> float:
    """Return a single number as a float; TypeError for text and flags, which ``float`` takes too."""
    if isinstance(value, (str, bytes, bool, np.bool_)):
        raise TypeError(f"{type(value).__name__} is no number")
    return float(value)


def positive(value: float, name: str, unit: str) -> float:
    """Return ``value`` as a float after checking that it is positive and finite: from 1e-100 to 1e100.

    Args:
        value: the number.
        name: what to call it in an error.
        unit: its unit; empty for a number without.

    Raises:
        InputError: not a number (text neither), zero, negative, NaN or infinite.
    """
    try:
        number = real(value)
    except (TypeError, ValueError, OverflowError) as error:
        of = f" of {unit}" if unit else ""
        raise InputError(f"{name} is {shown(value)}, expected a number{of}.", name=name) from error
    if not 1.0 / LARGEST <= number <= LARGEST:
        wanted = f"one from {1.0 / LARGEST:g} to {LARGEST:g}" if 0.0 < number < np.inf else "a positive number"
        raise InputError(f"{name} is {f'{number:g} {unit}'.rstrip()}, expected {wanted}.", name=name, value=number)
    return number


def not_negative(value: float, name: str) -> float:
    """Return a number as a float after checking that it is finite and not negative."""
    return _within(value, name, sys.float_info.max, "that is not negative")


def fraction(value: float, name: str) -> float:
    """Return a number after checking that it is from 0 to 1."""
    return _within(value, name, 1.0, "in [0, 1]")


def _within(value: float, name: str, most: float, allowed: str) -> float:
    try:
        number = real(value)
    except (TypeError, ValueError, OverflowError):
        number = np.nan
    if not 0.0 <= number <= most:
        raise InputError(f"{name} is {shown(value)}, expected a number {allowed}.", name=name, value=value)
    return number


def whole(value: Any, name: str, least: int, most: int) -> int:
    """Return a whole number after checking that it is from ``least`` to ``most``."""
    number = isinstance(value, (int, float, np.integer)) and not isinstance(value, bool)
    if not number or not least <= value <= most or int(value) != value:
        raise InputError(
            f"{name} is {shown(value)}, expected a whole number from {least} to {most}.", name=name, value=value
        )
    return int(value)


def each(
    values: ArrayLike, name: str, shape: tuple[int, ...], *, above_zero: bool = False, finite: bool = False
) -> Array:
    """Return numbers of a shape, given as such or as one for all.

    Args:
        values: one number, or as many as the shape has.
        name: what to call them in an error.
        shape: (k,) of numbers for each of k carriers or actuators, (k, 2) of two ends for each.
        above_zero: whether they have to be positive.
        finite: whether they have to be finite.

    Raises:
        InputError: no numbers (text and flags neither), another number of them, NaN, or one that is not positive or
            not finite.
    """
    text = shown(values.tolist() if isinstance(values, np.ndarray) else values)  # as a user typed it
    count = f"two ends, or two for each of {shape[0]} carriers" if len(shape) == 2 else f"{shape[0]} numbers or one"
    try:
        if np.asarray(values).dtype.kind in "SUb":
            raise TypeError("numpy makes numbers of text and of flags")
        numbers = np.broadcast_to(np.asarray(values, dtype=np.float64), shape)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{name} is {text}, expected {count}.", name=name, value=values) from error
    if np.isnan(numbers).any() or (finite and np.isinf(numbers).any()):
        raise InputError(f"{name} is {text}, expected {count}, {'finite' if finite else 'no NaN'}.", name=name)
    if above_zero and not (numbers > 0.0).all():
        remedy = "" if finite else "Pass inf for no limit."
        raise InputError(
            f"{name} is {text}, but {'scales' if finite else 'limits'} must be positive.",
            remedy=remedy,
            name=name,
            value=values,
        )
    return numbers


def one_of(value: object, name: str, allowed: Iterable[object]) -> None:
    """Check that an option is one of its choices.

    Raises:
        InputError: another value.
    """
    if not any(type(value) is type(choice) and value == choice for choice in allowed):
        choices = [*map(str, allowed)]
        remedy = f"{did_you_mean(value, choices)}Use one of {', '.join(choices)}."
        raise InputError(f"{name} is {shown(value)}.", remedy=remedy, name=name, value=value)


def inside(values: ArrayLike, lower: float, upper: float, name: str, unit: str) -> Array:
    """Return ``values`` clipped to [lower, upper] after checking that only rounding is clipped away.

    Args:
        values: times or arc lengths, any shape.
        lower: start of the interval.
        upper: end of the interval.
        name: what to call the values in an error.
        unit: their unit.

    Raises:
        InputError: a value is NaN or lies outside by more than rounding.
    """
    array = np.asarray(values, dtype=np.float64)
    slack = ROUNDING * max(upper - lower, abs(lower), abs(upper))
    outside = ~((array >= lower - slack) & (array <= upper + slack))
    if outside.any():
        value = float(array[outside][0])
        raise InputError(
            f"{name} = {value:.9g} {unit} is outside [{lower:.9g}, {upper:.9g}] {unit}.",
            remedy="Nothing is extrapolated: stay inside the interval.",
            name=name,
            value=value,
            lower=lower,
            upper=upper,
        )
    clipped: Array = np.clip(array, lower, upper)
    return clipped


def require_side(side: str) -> None:
    """Check the name of a one-sided limit.

    Raises:
        InputError: neither "left" nor "right".
    """
    if side not in ("left", "right"):
        raise InputError(f"side is {side!r}, expected 'left' or 'right'.", side=side)
