"""Description of a batch: the scans of every part and the differences between its variants."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from scancell.config.choices import Engine
from scancell.config.description import validate
from scancell.config.loading import read_toml
from scancell.config.variation import DesignDescription, VaryingScansDescription
from scancell.errors import DescriptionError

# Designs whose number of points follows from the factors.
_COUNTED = ("full_factorial", "one_at_a_time")
CloudFormat = Literal["ply", "npz", "laz", "e57", "pcd", "xyz"]


class BatchDescription(VaryingScansDescription):
    """A batch of parts. Without factors, the variants of a part differ only in their noise."""

    engine: Engine = Field(
        default="ray-traced", description="ray-traced: rendered camera images; geometric: ray intersections"
    )
    design: DesignDescription = Field(
        default=DesignDescription(kind="monte_carlo", trials=1), description="variants of every part"
    )
    formats: Annotated[tuple[CloudFormat, ...], Field(min_length=1)] = Field(
        default=("ply",), description="file formats of the clouds"
    )
    images: bool = Field(default=False, description="keep the images of all cameras; ray-traced engine only")
    truth: bool = Field(default=True, description="write the ground truth of points, pixels and poses")

    @model_validator(mode="after")
    def _possible(self) -> Self:
        if self.images and self.engine != "ray-traced":
            raise ValueError(f'images: engine = "{self.engine}" renders none; use "ray-traced"')
        if not self.labels and self.design.kind != "monte_carlo":
            raise ValueError(f"design {self.design.kind} needs at least one [[factor]]; otherwise use monte_carlo")
        return self


def load_batch(path: Path | None, changes: Mapping[str, Any], variants: int | None = None) -> BatchDescription:
    """Read and check a batch, or take all defaults; `changes` replace keys, `variants` the trials of its design.

    Raises `DescriptionError` naming file, key, value and what was expected.
    """
    source = "batch" if path is None else str(path)
    raw = {**({} if path is None else read_toml(path)), **changes}
    design = raw.setdefault("design", {"kind": "monte_carlo", "trials": 1})
    if variants is not None and isinstance(design, dict):
        if design.get("kind") in _COUNTED:
            raise DescriptionError(
                f"{source}: a {design['kind']} design fixes their number", key="variants", value=variants
            )
        design["trials"] = variants
    return validate(BatchDescription, raw, source)
