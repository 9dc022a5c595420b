"""What of a result its schema does not allow, or, closed, does not describe."""

from collections.abc import Callable, Iterable, Iterator
from functools import cache
from typing import Any

from jsonschema import Draft202012Validator, ValidationError

import robacc

Document = dict[str, Any]


@cache
def validator(name: str) -> Draft202012Validator:
    return Draft202012Validator(robacc.schema(name))


@cache
def closed(name: str) -> Draft202012Validator:
    """The schema with every object closed that lists its keys: it takes described keys only."""
    return Draft202012Validator(_closed(robacc.schema(name)))


def _closed(schema: Any) -> Any:
    if isinstance(schema, list):
        return [_closed(one) for one in schema]
    if not isinstance(schema, dict):
        return schema
    found = {key: _closed(value) for key, value in schema.items()}
    if "properties" in found and "required" in found and isinstance(found["required"], list):
        found.setdefault("additionalProperties", False)
    return found


def wrong(name: str, document: Document, by: Callable[[str], Draft202012Validator] = validator) -> list[str]:
    return [f"{one.json_path}: {one.message[:200]}" for one in _causes(by(name).iter_errors(document))]


def _causes(errors: Iterable[ValidationError]) -> Iterator[ValidationError]:
    """What is wrong with a value that may be null too stands below the error itself."""
    for one in errors:
        yield from [cause for cause in one.context or () if cause.schema.get("type") != "null"] or [one]
