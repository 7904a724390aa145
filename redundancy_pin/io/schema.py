"""Files of keys and values against a schema of pydantic: a bad one is refused with key, value and allowed values."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from typing import Any, TypeVar, get_args

from pydantic import BaseModel, ConfigDict, TypeAdapter, ValidationError
from pydantic.fields import FieldInfo

from redundancy_pin.errors import DeclarationError, did_you_mean, shown

_Model = TypeVar("_Model", bound=BaseModel)


class Schema(BaseModel):
    """A mapping with known keys; the description of a field lists its allowed values, and messages quote it."""

    model_config = ConfigDict(extra="forbid", frozen=True, defer_build=True)


def validated(
    kind: type[_Model], data: object, *, key: str = "", context: object = None, of: str = "declaration"
) -> _Model:
    """Return the data as a model.

    Args:
        kind: the model; its validators raise ``ValueError`` with the allowed values.
        data: as a reader of YAML or JSON gives it.
        key: where the data are in their file, for messages.
        context: handed to the validators.
        of: what the data are, for messages.

    Raises:
        DeclarationError: the first bad key, its value and the allowed values; for an unknown key the nearest known.
    """
    try:
        return kind.model_validate(data, context=context)
    except ValidationError as error:
        # a misspelt key is also a missing one: name the spelling
        first = min(error.errors(include_url=False), key=lambda entry: entry["type"] != "extra_forbidden")
    path, reason = first["loc"], first["type"]
    field, inner = _at(kind, path)
    if reason == "extra_forbidden":
        require_known_keys([str(path[-1])], list(inner.model_fields), _joined(key, path[:-1]))
    value = None if reason == "missing" else first["input"]
    if reason == "value_error":
        allowed = str(first["ctx"]["error"])
    elif reason == "model_type" or (reason == "missing" and field and _model_in(field.annotation)):
        allowed = f"a mapping with the keys {', '.join(inner.model_fields)}"
    else:
        allowed = (field.description if field else None) or first["msg"]
    raise bad_value(_joined(key, path), value, allowed, of)


_T = TypeVar("_T")


@functools.cache
def _adapter(kind: Any) -> TypeAdapter[Any]:
    return TypeAdapter(kind)


def record_of(kind: type[_T], data: object) -> _T:
    """Return a dataclass of numbers and text from a mapping of its fields; ValueError for other data."""
    try:
        known: Any = kind  # hashable, as every class, which its type does not say
        made: _T = _adapter(known).validate_python(data)
        return made
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = ".".join(map(str, first["loc"]))
        raise ValueError(f"{kind.__name__} {place}: {first['msg']}, not {shown(first['input'])}") from error


def bad_value(key: str, value: object, allowed: str, of: str = "declaration") -> DeclarationError:
    """Return the error for a value that is not allowed."""
    return DeclarationError(
        f"The {of}'s `{key}` is {shown(value)}.", remedy=f"It must be {allowed}.", key=key, value=value
    )


def require_known_keys(given: Sequence[str] | Mapping[str, Any], known: Sequence[str], where: str) -> None:
    """Check that every key is known.

    Raises:
        DeclarationError: with the nearest known key.
    """
    for key in given:
        if key not in known:
            place = f" in `{where}`" if where else ""
            remedy = f"{did_you_mean(key, known)}Allowed: {', '.join(known)}."
            inner = f"{where}.{key}" if where else key
            raise DeclarationError(f"Unknown key `{shown(key)[1:-1]}`{place}.", remedy=remedy, key=inner)


def _joined(key: str, path: Sequence[int | str]) -> str:
    for part in path:
        key = f"{key}[{part}]" if isinstance(part, int) else f"{key}.{part}" if key else part
    return key


def _at(kind: type[BaseModel], path: Sequence[int | str]) -> tuple[FieldInfo | None, type[BaseModel]]:
    """Return the innermost field on a path (of a root model: its root), and the innermost model."""
    field = kind.model_fields.get("root")
    for part in path:
        if part in kind.model_fields:
            field = kind.model_fields[str(part)]
            kind = _model_in(field.annotation) or kind
    return field, kind


def _model_in(annotation: Any) -> type[BaseModel] | None:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next((model for part in get_args(annotation) if (model := _model_in(part))), None)
