"""What the reports of both calibrations have in common: the picture, the manifest, and the comparison with truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scancell.config.loading import Setup
from scancell.files import png_bytes
from scancell.output.residual_picture import residual_picture
from scancell.output.run_files import write_json
from scancell.output.run_folder import RunFolder, command_words, manifest
from scancell.values import Result


class SavedCalibration(Result):
    """A calibration from a setup; `inputs` and `run` are the files and settings for the manifest."""

    setup: Setup
    inputs: Sequence[Path]
    run: Mapping[str, Any]

    @property
    def _distances(self) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
        """Distances (n,) of the points from the measured surface, m, and the exposure of each."""
        raise NotImplementedError

    def _write(self, folder: RunFolder) -> None:
        """Write all files but the manifest."""
        raise NotImplementedError

    def picture(self) -> bytes:
        """Distances of the points from the measured surface by exposure, as PNG."""
        return png_bytes(lambda path: residual_picture(path, *self._distances))

    def save(self, folder: str | Path, command_line: Sequence[str] | None = None) -> list[Path]:
        """Write the calibrated description, figures, measured points, picture and manifest; return the files.

        `command_line`: words that the manifest keeps; by default those of this process.

        Raises
        ------
        OutputError
            If the `folder` cannot be written.
        """
        with RunFolder(Path(folder)) as run:
            self._write(run)
            entries = {**self.run, "command_line": command_words(command_line)}
            write_json(run.path("manifest.json"), manifest(self.setup, self.inputs, entries))
        return run.paths


def comparison_text(true: float | None, value: float, half_width: float) -> str:
    """Columns of a true value and the error of an estimate, and whether its interval misses it; empty if unknown."""
    if true is None:
        return ""
    inside = "" if abs(value - true) <= half_width else "  outside"
    return f" {true:10.5f} {value - true:10.5f}{inside}"
