"""Description of a study: the trials of a part and the figures to evaluate."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from scancell.config.choices import CalibrationTarget, Engine
from scancell.config.description import Coordinate, Description, Size, validate
from scancell.config.loading import override, read_toml
from scancell.config.variation import VaryingScansDescription, refuse_twins
from scancell.errors import DescriptionError


class FittedSphereDescription(Description):
    """A sphere of the part whose fitted position, size and form are figures; in the coordinates of the mesh file."""

    name: str = Field(default="sphere", description="prefix of the figures")
    centre_mm: tuple[Coordinate, Coordinate, Coordinate] = Field(description="nominal centre")
    radius_mm: Size = Field(description="nominal radius")
    reach_mm: Size = Field(default=1.0, description="largest distance of used points from the nominal surface")
    above_mm: Coordinate | None = Field(default=None, description="smallest z of used points; all unless given")


class CalibrateDescription(Description):
    """Calibration of every trial's cell before its scan; the scan is reconstructed with the result."""

    what: CalibrationTarget = Field(default="all", description="what is calibrated: tool, table, latency, or all")
    artefact: str | None = Field(
        default=None, description="file of the artefact (TOML) or of the mesh of any part; default: a shipped one"
    )
    also: tuple[str, ...] = Field(default=(), description="further deviations to estimate, such as dh[3].theta")
    wobble: bool = Field(default=False, description="whether the wobble of the table axis is also estimated")
    poses: Annotated[int, Field(ge=0, le=10_000)] | None = Field(
        default=None, description="exposures at rest; default 24, none for latency"
    )
    passes: Annotated[int, Field(ge=0, le=1000)] | None = Field(
        default=None, description="passes in motion; default 8 for latency and all, else none"
    )
    pose: Literal["described", "unknown"] | None = Field(
        default=None,
        description="whether the pose of the artefact is taken from the cell or estimated; default as in the command",
    )


class StudyDescription(VaryingScansDescription):
    """A study of one part. Paths of files are relative to the study's own."""

    name: str = Field(description="title of the report, and name of the default folder of the results")
    part: str = Field(description="mesh file of the part")
    engine: Engine = Field(
        default="geometric", description="ray-traced: rendered camera images; geometric: ray intersections"
    )
    ray_traced_trials: Annotated[int, Field(ge=0, le=10_000_000)] = Field(
        default=0, description="number of first trials of a geometric study to repeat with rendered images"
    )
    noise: Literal["per_trial", "common"] = Field(
        default="per_trial", description="common: the noise of sensor and encoders is the same in all trials"
    )
    trials_per_task: Annotated[int, Field(ge=1, le=10_000)] = Field(
        default=1, description="trials per task and file of results"
    )
    coverage_samples: Annotated[int, Field(ge=0, le=1_000_000)] = Field(
        default=4000, description="surface samples for coverage; 0 disables"
    )
    probability: Annotated[float, Field(gt=0.0, lt=1.0)] = Field(
        default=0.95, description="coverage probability of all intervals"
    )
    calibrate: CalibrateDescription | None = Field(
        default=None, description="calibration of the cell in every trial, before the scan"
    )
    sphere: tuple[FittedSphereDescription, ...] = Field(default=(), description="spheres to fit")

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if not self.labels:
            raise ValueError("nothing varies: add at least one [[factor]] or [[block]]")
        refuse_twins([*self.labels, *(sphere.name for sphere in self.sphere)])
        if self.ray_traced_trials and self.engine == "ray-traced":
            raise ValueError('ray_traced_trials repeats trials of engine = "geometric"; here all trials are ray-traced')
        return self


def load_study(path: Path, settings: Sequence[str] = ()) -> StudyDescription:
    """Read and check a study; `settings` are words like ``design.trials=20``.

    Raises `DescriptionError` naming file, key, value and what was expected.
    """
    raw = read_toml(path)
    origins = [override(raw, word, "settings") for word in settings]
    study = validate(StudyDescription, raw, str(path), origins)
    if study.calibrate is None or study.calibrate.artefact is None:
        return study
    artefact = (path.parent / study.calibrate.artefact).resolve()
    if not artefact.is_file():
        raise DescriptionError(
            f"no such file ({artefact})", file=path, key="calibrate.artefact", value=study.calibrate.artefact
        )
    return study.replace({"calibrate.artefact": str(artefact)})
