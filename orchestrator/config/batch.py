"""Description of a batch: what is made of every part, and in what its variants differ."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from orchestrator.config.description import validate
from orchestrator.config.loading import read_toml
from orchestrator.config.scan import Engine
from orchestrator.config.variation import DesignDescription, VaryingScansDescription
from orchestrator.errors import DescriptionError

# Designs whose number of points follows from the factors.
_COUNTED = ("full_factorial", "one_at_a_time")
CloudFormat = Literal["ply", "npz", "laz", "e57", "pcd", "xyz"]


class BatchDescription(VaryingScansDescription):
    """A batch of parts. Without factors, the variants of a part differ in their noise alone."""

    engine: Engine = "ray-traced"
    design: DesignDescription = Field(
        default=DesignDescription(kind="monte_carlo", trials=1), description="which variants are made of every part"
    )
    formats: Annotated[tuple[CloudFormat, ...], Field(min_length=1)] = Field(
        default=("ply",), description="of the clouds"
    )
    images: bool = Field(default=False, description="keep the images of all cameras; ray-traced engine only")
    truth: bool = Field(default=True, description="write what every point, pixel and pose truly was")

    @model_validator(mode="after")
    def _possible(self) -> Self:
        if self.images and self.engine != "ray-traced":
            raise ValueError(f'images: engine = "{self.engine}" makes none; take "ray-traced"')
        if not self.labels and self.design.kind != "monte_carlo":
            raise ValueError(f"design {self.design.kind} needs at least one [[factor]]; without, take monte_carlo")
        return self


def load_batch(path: Path | None, changes: Mapping[str, Any], variants: int | None = None) -> BatchDescription:
    """Read and check a batch, or take all defaults; `changes` replace keys, `variants` the trials of its design.

    Raises
    ------
    DescriptionError
        Naming file, key, value and what was expected.
    """
    source = "batch" if path is None else str(path)
    raw = {**({} if path is None else read_toml(path)), **changes}
    design = raw.setdefault("design", {"kind": "monte_carlo", "trials": 1})
    if variants is not None and isinstance(design, dict):
        if design.get("kind") in _COUNTED:
            raise DescriptionError(f"--variants {variants}: {source}: design {design['kind']} has as many as it has")
        design["trials"] = variants
    return validate(BatchDescription, raw, source)
