"""Signatures as a reader needs them: without the conditions that `scancell` checks, and with short names of arrays."""

from __future__ import annotations

import re
from typing import Any

# Sphinx writes `~package.Name` for a name that is shown without its package.
_CONDITIONS = re.compile(
    r"~?(?:typing\.)?Annotated\[((?:[^\[\]]|\[(?:[^\[\]]|\[[^\]]*\])*\])*?), ~?[\w.]+\((?:[^()]|\([^()]*\))*\)\]"
)
_ARRAY = re.compile(
    r"~?(?:numpy\.)?ndarray\[tuple\[~?(?:typing\.)?Any, \.\.\.\], ~?(?:numpy\.)?dtype\[~?(?:numpy\.)?(\w+)\]\]"
)


def readable(signature: str | None) -> str | None:
    """A signature or type with ``NDArray[T]`` for arrays, and ``T`` for ``Annotated[T, Condition(…)]``."""
    return signature and _CONDITIONS.sub(r"\1", _ARRAY.sub(r"NDArray[\1]", signature))


def _process(*event: Any) -> tuple[str | None, str | None]:
    signature, returned = event[-2:]
    return readable(signature), readable(returned)


def setup(app: Any) -> dict[str, Any]:
    """Register the change with autodoc."""
    app.connect("autodoc-process-signature", _process)
    return {"parallel_read_safe": True}
