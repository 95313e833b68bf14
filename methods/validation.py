"""Validation: plain values against the fields of a settings dataclass, by pydantic, with what was wrong in words."""

from __future__ import annotations

import dataclasses
import difflib
import typing
from collections.abc import Mapping
from functools import cache
from typing import Annotated, Any

from pydantic import ConfigDict, Field, PydanticUserError, TypeAdapter, ValidationError

Steps = Annotated[int, Field(ge=0)]  # of a run of 30,000
Count = Annotated[int, Field(ge=1)]
Limit = Annotated[int, Field(ge=0)]  # 0: none
Power = Annotated[int, Field(ge=1)]
Rate = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Amount = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Length = Amount  # world units
Factor = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Share = Annotated[float, Field(ge=0, le=1)]
Weight = Annotated[float, Field(gt=0, lt=1)]
Degree = Annotated[int, Field(ge=0, le=3)]  # of spherical harmonics
Size = Annotated[int, Field(ge=2)]  # samples along an edge

STRICT = ConfigDict(strict=True, arbitrary_types_allowed=True)


def checked(settings_type: type, values: Mapping[str, Any], where: str) -> dict[str, Any]:
    """`values` as the fields of the dataclass `settings_type` take them: a whole number where a float is, 1e3 where an
    integer is, a list where a tuple is.

    Args:
        where: what stands before a field's name in messages.

    Raises:
        ValueError: a key is none of its fields, or a value is none that the field's type allows. The message names all
            of these, what was given and what was expected.
    """
    adapters = _adapters(settings_type)
    accepted, problems = {}, [_unknown(where, key, list(adapters)) for key in values if key not in adapters]
    for key in values.keys() & adapters.keys():
        adapter, is_tuple = adapters[key]
        value = tuple(values[key]) if is_tuple and isinstance(values[key], list) else values[key]
        try:
            accepted[key] = _as_field(adapter, value)
        except ValidationError as error:
            expected = error.errors()[0]["msg"].removeprefix("Value error, ").replace("Input should be", "expected")
            problems.append(f"{where}{key} is {values[key]!r}, {expected}")
    if problems:
        raise ValueError("\n".join(sorted(problems)))
    return accepted


def _as_field(adapter: TypeAdapter[Any], value: Any) -> Any:
    """What the field takes of `value`; an integer field the whole numbers among floats, which YAML makes of 1e3."""
    try:
        return adapter.validate_python(value)
    except ValidationError:
        whole = _whole(value)
        if whole is value:
            raise
        return adapter.validate_python(whole)


def _whole(value: Any) -> Any:
    """Whole floats as integers, in tuples too; all else as it is."""
    if isinstance(value, tuple) and any(_whole(each) is not each for each in value):
        return tuple(map(_whole, value))
    return int(value) if isinstance(value, float) and value.is_integer() else value


@cache
def _adapters(settings_type: type) -> dict[str, tuple[TypeAdapter[Any], bool]]:
    """Of each field what checks it, and whether it is a tuple."""
    try:
        hints = typing.get_type_hints(settings_type, include_extras=True)
    except NameError:  # a name that only its author's type checker sees
        hints = {}
    found = {}
    for field in dataclasses.fields(settings_type):
        hint = hints.get(field.name, Any)
        try:
            adapter = TypeAdapter(hint, config=STRICT)
        except PydanticUserError:
            adapter = TypeAdapter(Any)
        found[field.name] = adapter, typing.get_origin(hint) is tuple
    return found


def _unknown(where: str, key: str, known: list[str]) -> str:
    close = difflib.get_close_matches(key, known, n=1)
    guess = f". Did you mean {close[0]!r}?" if close else ""
    return f"{where}{key}: there is no such setting; there are {', '.join(sorted(known))}{guess}"
