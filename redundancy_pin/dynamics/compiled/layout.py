"""Structures that Python and C share, each written once: from one table the C declaration and the ctypes structure.

Example:
    >>> from redundancy_pin.dynamics.compiled.layout import Member, Struct
    >>> point = Struct("Point", (Member("x", "double", "m"), Member("count", "int", "of neighbours")))
    >>> print(point.declaration)
    typedef struct {
      double x; /* m */
      int count; /* of neighbours */
    } Point;
    >>> point.type(x=1.5).x
    1.5
"""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from types import MappingProxyType
from typing import Any, NamedTuple

_TYPES: Mapping[str, Any] = MappingProxyType(
    {
        "int": ctypes.c_int,
        "long": ctypes.c_long,
        "double": ctypes.c_double,
        "const double *": ctypes.c_void_p,
        "double *": ctypes.c_void_p,
    }
)
"""By C type that of ctypes."""


class Member(NamedTuple):
    """A member of a structure.

    Attributes:
        name: in C and in Python.
        kind: its C type, one of int, long, double, const double *, double *; or the name of a function type.
        meaning: quantity, unit and shape: the comment in C.
    """

    name: str
    kind: str
    meaning: str


@dataclass(frozen=True)
class Struct:
    """A structure that Python and C share.

    Args:
        name: of its type in C.
        members: in the order in which they lie in memory.
        functions: ctypes types of pointers to functions among them, by the name of their type in C.
    """

    name: str
    members: tuple[Member, ...]
    functions: Mapping[str, Any] = field(default_factory=dict)

    @property
    def declaration(self) -> str:
        """The declaration in C."""
        lines = [f"  {_declared(member)}; /* {member.meaning} */" for member in self.members]
        return "\n".join(["typedef struct {", *lines, f"}} {self.name};"])

    @cached_property
    def type(self) -> Any:
        """The ctypes structure."""
        known = {**_TYPES, **self.functions}
        fields = [(member.name, known[member.kind]) for member in self.members]
        return type(self.name, (ctypes.Structure,), {"_fields_": fields, "__doc__": f"``{self.name}`` of the C."})


def _declared(member: Member) -> str:
    return f"{member.kind}{'' if member.kind.endswith('*') else ' '}{member.name}"
