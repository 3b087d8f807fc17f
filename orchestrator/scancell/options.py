"""Options that functions of `scancell.api` share with the methods of `Scanner`, which state their meaning."""

from __future__ import annotations

from pathlib import Path
from typing import TypedDict

from scancell.arguments import Length, Seed
from scancell.config.cell import EstimatedDescription
from scancell.config.choices import Engine, FlangeConvention
from scancell.config.files import Assignments
from scancell.config.sensor import SensorDescription
from scancell.config.study import CloudFormat
from scancell.planning.plan import Plan
from scancell.progress import Progress, ProgressCallback
from scancell.scanning.pipeline import PreScanHook
from scancell.scanning.sense import OnImages


class PartOptions(TypedDict, total=False):
    """Of every call with a part."""

    unit: str
    as_built: Assignments
    seed: Seed


class ShotOptions(PartOptions, total=False):
    """Of `Scanner.shot`."""

    engine: Engine


class RenderOptions(ShotOptions, total=False):
    """Of `Scanner.render`."""

    estimated: EstimatedDescription | None
    estimated_sensor: SensorDescription | None
    on_images: OnImages | None
    progress: Progress | ProgressCallback | None


class ScanOptions(RenderOptions, total=False):
    """Of `Scanner.scan`."""

    plan: Plan | str | Path | None
    normals: bool
    samples: bool
    hook: PreScanHook | None


class SurveyOptions(PartOptions, total=False):
    """Of `Scanner.survey`."""

    radius: Length | None
    height: Length
    voxel: Length
    pitch: Length
    inflation: float
    progress: Progress | ProgressCallback | None


class CalibrateOptions(ShotOptions, total=False):
    """Of `Scanner.calibrate`."""

    from_points: str | Path | None
    flange: str | Path | None
    convention: FlangeConvention | None
    table_format: str | Path | None
    progress: Progress | ProgressCallback | None


class CalibrateSensorOptions(TypedDict, total=False):
    """Of `Scanner.calibrate_sensor`."""

    as_built: Assignments
    seed: Seed
    progress: Progress | ProgressCallback | None


class BatchOptions(TypedDict, total=False):
    """Keys of a batch description (docs/batch.md)."""

    cell: str | Path
    sensor: str | Path
    scan: str | Path
    ideal: bool
    unit: str
    engine: Engine
    seed: Seed
    formats: tuple[CloudFormat, ...] | list[CloudFormat]
    images: bool
    truth: bool
