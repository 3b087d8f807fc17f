"""Files of an evaluation: figures as JSON and CSV, and a picture."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from scancell.evaluation.artefact import ArtefactEvaluation
from scancell.evaluation.deviation import Deviation
from scancell.evaluation.mesh_evaluation import Evaluation, MeshEvaluation
from scancell.geometry.shapes import PartSurface
from scancell.output.deviation_picture import deviation_picture
from scancell.output.run_files import write_json
from scancell.output.run_folder import RunFolder
from scancell.output.tables import columns_of, write_csv


def save_evaluation(evaluation: Evaluation, out: Path) -> list[Path]:
    """Write ``evaluation.json``, ``.csv`` (one row per characteristic or region) and ``.png``, all or none.

    Raises
    ------
    OutputError
        If a file cannot be written.
    """
    with RunFolder(out) as folder:
        write_json(folder.path("evaluation.json"), evaluation.figures)
        write_csv(folder.path("evaluation.csv"), columns_of(evaluation.rows()))
        draw_evaluation(evaluation, folder.path("evaluation.png"))
    return folder.paths


def draw_evaluation(evaluation: Evaluation, path: Path) -> None:
    """Picture (PNG) of the deviations on the mesh, or on the measured faces of the artefact.

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    if isinstance(evaluation, MeshEvaluation):
        _draw_mesh(evaluation, path)
    elif isinstance(evaluation, ArtefactEvaluation):
        _draw_artefact(evaluation, path)


def _draw_mesh(evaluation: MeshEvaluation, path: Path) -> None:
    deviation = Deviation(evaluation.distance, evaluation.face, evaluation.statistics, {}, {}, evaluation.is_signed)
    name = Path(evaluation.mesh.source).stem
    deviation_picture(path, evaluation.points_in_part, deviation, evaluation.mesh, name=name)


def _draw_artefact(evaluation: ArtefactEvaluation, path: Path) -> None:
    mesh = evaluation.artefact.mesh()
    shown = np.flatnonzero(evaluation.face >= 0)
    points = evaluation.points_in_artefact[shown]
    face = PartSurface(mesh).distances(points)[1].astype(np.int32)
    deviation = Deviation(evaluation.distance[shown], face, evaluation.statistics, {}, {})
    deviation_picture(path, points, deviation, mesh, name=Path(evaluation.artefact.source).stem)
