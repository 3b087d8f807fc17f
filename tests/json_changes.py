"""Descriptions with one change, for tests of what rejects them."""

from __future__ import annotations

import copy
from typing import Any


def changed(description: Any, path: str, value: Any) -> Any:
    """Copy with the entry at a dotted path (``joints.2.max``) replaced, or removed when the value is `...`."""
    result = copy.deepcopy(description)
    *parents, last = (int(key) if key.isdigit() else key for key in path.split("."))
    target = result
    for key in parents:
        target = target[key]
    if value is ...:
        del target[last]
    else:
        target[last] = value
    return result
