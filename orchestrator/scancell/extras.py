"""Optional dependencies: packages that only an extra of the distribution installs."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from scancell.errors import MissingExtraError


def require(module: str, extra: str) -> Any:
    """Import `module`, which ``pip install "scancell[extra]"`` provides.

    Raises `MissingExtraError` if the package is not installed, with the command that installs it.
    """
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        package = module.partition(".")[0]
        if (error.name or "").partition(".")[0] != package:
            raise  # the package is there; one of its own dependencies is missing
        raise MissingExtraError(
            f'{package} is not installed; install it with: pip install "scancell[{extra}]"'
        ) from None
