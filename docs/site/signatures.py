"""Signatures as a reader needs them: without the conditions that `scancell` checks, and with short names of arrays.

Sphinx writes ``~package.Name`` for a name that is shown without its package.
"""

from __future__ import annotations

import re
from typing import Any

_ANNOTATED = re.compile(r"~?(?:typing\.)?Annotated\[")
_DTYPE = r"~?(?:numpy\.)?dtype\[~?(?:numpy\.)?(\w+(?:\[.*?\])?)\]"
_ARRAY = re.compile(rf"~?(?:numpy\.)?ndarray\[tuple\[~?(?:typing\.)?Any, \.\.\.\], {_DTYPE}\]")
_ARRAY_LIKE = re.compile(r"~?[\w.]*Buffer \| .*?NestedSequence\[[\w~. |]*complex \| bytes \| str\]")


def _without_conditions(text: str) -> str:
    """A text with ``T`` for each ``Annotated[T, Condition(…)]``."""
    while found := _ANNOTATED.search(text):
        depth, comma = 0, 0
        for end in range(found.end(), len(text)):
            letter = text[end]
            if letter == "]" and depth == 0:
                text = text[: found.start()] + text[found.end() : comma] + text[end + 1 :]
                break
            if letter == "," and depth == 0 and not comma:
                comma = end
            depth += (letter in "[(") - (letter in "])")
        else:
            raise ValueError(f"a bracket is open in '{text}'")
    return text


def readable(signature: str | None) -> str | None:
    """A signature or type with ``NDArray[T]``, ``ArrayLike`` and, without its conditions, ``T``."""
    if not signature:
        return signature
    return _without_conditions(_ARRAY_LIKE.sub("ArrayLike", _ARRAY.sub(r"NDArray[\1]", signature)))


def _process(*event: Any) -> tuple[str | None, str | None]:
    signature, returned = event[-2:]
    return readable(signature), readable(returned)


def setup(app: Any) -> dict[str, Any]:
    """Register the change with autodoc."""
    app.connect("autodoc-process-signature", _process)
    return {"parallel_read_safe": True}
