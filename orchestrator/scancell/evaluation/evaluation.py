"""What the results of comparisons have in common."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from scancell.arguments import checked_arguments
from scancell.files import png_bytes
from scancell.values import Result


class Evaluation(Result):
    """A comparison of a cloud with a mesh or an artefact; its files and its picture are made by `scancell.output`."""

    def rows(self) -> list[dict[str, Any]]:
        """One mapping for each characteristic or region, as in ``evaluation.csv``."""
        raise NotImplementedError

    @checked_arguments
    def save(self, folder: str | Path) -> list[Path]:
        """Write ``evaluation.json``, ``.csv`` and ``.png`` into `folder`, all or none, and return their paths.

        Raises `OutputError` if the folder cannot be written.
        """
        from scancell.output.evaluation_files import save_evaluation  # noqa: PLC0415

        return save_evaluation(self, Path(folder))

    def picture(self) -> bytes:
        """The deviations on the part, as PNG."""
        from scancell.output.evaluation_files import draw_evaluation  # noqa: PLC0415

        return png_bytes(lambda path: draw_evaluation(self, path))
