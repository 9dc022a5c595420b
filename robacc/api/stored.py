"""Results as calls take them that read results: stored ones by their path, or those of other calls as they are."""

from __future__ import annotations

import json
import os
from hashlib import sha256

from robacc.api.inputs import StrPath
from robacc.api.result import Result
from robacc.documents.read_result import StoredResult, read_result


def stored(source: StrPath | Result | StoredResult) -> StoredResult:
    """The result in a file, or as given; one just computed as its file would be, named by its command.

    Raises:
        InputError: The file cannot be read or holds no result.
    """
    if isinstance(source, StoredResult):
        return source
    if isinstance(source, Result):
        text = source.to_json()
        return StoredResult(json.loads(text), source.command, sha256(text.encode()).hexdigest(), source.command)
    return read_result(os.fspath(source))
