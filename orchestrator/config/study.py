"""Description of a study: which trials are made of a part, and which figures are asked for."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from orchestrator.config.description import Description, Finite, Positive, validate
from orchestrator.config.loading import override, read_toml
from orchestrator.config.scan import Engine
from orchestrator.config.variation import VaryingScansDescription, refuse_twins


class SphereDescription(Description):
    """A ball of the part whose fitted place, size and form are figures; in the mesh file's own coordinates."""

    name: str = "sphere"
    centre_mm: tuple[Finite, Finite, Finite]
    radius_mm: Positive
    reach_mm: Positive = Field(default=1.0, description="points this far from the nominal surface are taken")
    above_mm: Finite | None = Field(default=None, description="points lower than this are none of the ball's")


class StudyDescription(VaryingScansDescription):
    """A study of one part. Paths of files are relative to the study's own."""

    name: str
    part: str = Field(description="mesh of the part")
    engine: Engine = "geometric"
    ray_traced_trials: Annotated[int, Field(ge=0)] = Field(
        default=0, description="so many of the first trials of a geometric study are made with images as well"
    )
    noise: Literal["per_trial", "common"] = Field(
        default="per_trial", description="common: all trials see the same random numbers of sensor and encoders"
    )
    trials_per_task: Annotated[int, Field(ge=1, le=10_000)] = Field(
        default=1, description="results are kept in files of so many trials"
    )
    coverage_samples: Annotated[int, Field(ge=0, le=1_000_000)] = Field(
        default=4000, description="places that stand for the surface when its covered share is worked out; 0: it is not"
    )
    probability: Annotated[float, Field(gt=0.0, lt=1.0)] = Field(default=0.95, description="of all intervals")
    sphere: tuple[SphereDescription, ...] = ()

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if not self.labels:
            raise ValueError("nothing varies: give at least one [[factor]] or [[block]]")
        refuse_twins([*self.labels, *(sphere.name for sphere in self.sphere)])
        if self.ray_traced_trials and self.engine == "ray-traced":
            raise ValueError('ray_traced_trials repeats trials of engine = "geometric"; all trials are ray-traced here')
        return self


def load_study(path: Path, overrides: Sequence[str] = ()) -> StudyDescription:
    """Read and check a study; `overrides` are words like ``design.trials=20``.

    Raises
    ------
    DescriptionError
        Naming file, key, value and what was expected.
    """
    raw = read_toml(path)
    for word in overrides:
        override(raw, word, "--set")
    return validate(StudyDescription, raw, str(path))
