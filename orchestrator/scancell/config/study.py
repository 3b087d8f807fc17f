"""Description of a study: the trials of a part and the figures to evaluate."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from scancell.config.choices import Engine
from scancell.config.description import Description, Finite, Positive, validate
from scancell.config.loading import override, read_toml
from scancell.config.variation import VaryingScansDescription, refuse_twins


class SphereDescription(Description):
    """A sphere of the part whose fitted position, size and form are figures; in the coordinates of the mesh file."""

    name: str = Field(default="sphere", description="prefix of the figures")
    centre_mm: tuple[Finite, Finite, Finite] = Field(description="nominal centre")
    radius_mm: Positive = Field(description="nominal radius")
    reach_mm: Positive = Field(default=1.0, description="largest distance of used points from the nominal surface")
    above_mm: Finite | None = Field(default=None, description="smallest z of used points; all unless given")


class StudyDescription(VaryingScansDescription):
    """A study of one part. Paths of files are relative to the study's own."""

    name: str = Field(description="title of the report, and name of the default folder of the results")
    part: str = Field(description="mesh file of the part")
    engine: Engine = Field(
        default="geometric", description="ray-traced: rendered camera images; geometric: ray intersections"
    )
    ray_traced_trials: Annotated[int, Field(ge=0)] = Field(
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
    sphere: tuple[SphereDescription, ...] = Field(default=(), description="spheres to fit")

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if not self.labels:
            raise ValueError("nothing varies: add at least one [[factor]] or [[block]]")
        refuse_twins([*self.labels, *(sphere.name for sphere in self.sphere)])
        if self.ray_traced_trials and self.engine == "ray-traced":
            raise ValueError('ray_traced_trials repeats trials of engine = "geometric"; here all trials are ray-traced')
        return self


def load_study(path: Path, overrides: Sequence[str] = ()) -> StudyDescription:
    """Read and check a study; `overrides` are words like ``design.trials=20``.

    Raises
    ------
    DescriptionError
        Naming file, key, value and what was expected.
    """
    raw = read_toml(path)
    origins = [override(raw, word, "--set") for word in overrides]
    return validate(StudyDescription, raw, str(path), origins)
