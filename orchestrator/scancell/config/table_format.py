"""Description of the files in which profile sensors write their profiles: the table `[format]` of a TOML file."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, field_validator, model_validator

from scancell.config.description import Description, Number, validate
from scancell.config.files import assets_dir, read_toml
from scancell.errors import DescriptionError

Column = Annotated[int, Field(ge=1, le=100_000)] | str
Layout = Literal["points", "profiles_in_rows", "profiles_in_columns", "sequence", "image", "ros_bag"]
_HEAD = 1 << 13


class AxisDescription(Description):
    """Coordinate by the numbers of a file, ``offset_mm + scale_mm × number``, or by even steps."""

    column: Column | None = Field(
        default=None, description="name or number (from 1) of the column of the coordinate; by default see the layout"
    )
    scale_mm: Number = Field(default=1.0, description="mm per unit of the numbers; negative if the axis is opposite")
    offset_mm: Number = Field(default=0.0, description="coordinate at the number 0, or of the first step")
    pitch_mm: Number | None = Field(
        default=None, description="step to the next point (x) or profile (y), in place of numbers in the file"
    )

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if self.scale_mm == 0.0 or self.pitch_mm == 0.0:
            raise ValueError("scale_mm and pitch_mm must not be 0")
        if self.column is not None and self.pitch_mm is not None:
            raise ValueError("give either column or pitch_mm")
        return self


class BagDescription(Description):
    """Topics, joints and frames of a ROS 2 bag that give profiles and the readings at their time stamps."""

    profiles: tuple[str, ...] = Field(
        default=(),
        description="topics of PointCloud2 or LaserScan, of sensor 1, 2, …; by default the only one of the bag",
    )
    joints: tuple[str, ...] = Field(
        default=(),
        description="names of the joints in JointState, from the base to the flange; by default those that end with"
        " 1, 2, …",
    )
    axes: dict[Annotated[str, Field(pattern="_(deg|mm)$")], str] = Field(
        default={},
        description="names in JointState of the table and further axes, by the columns table_deg, NAME_mm, NAME_deg",
    )
    base_frame: str = Field(default="base_link", description="frame of the robot's base, with flange_frame")
    flange_frame: str | None = Field(
        default=None, description="frame of the flange, whose transforms count instead of joints"
    )


class FormatDescription(Description):
    """Format of files of profiles: x along the profile, y of the travel, z the height."""

    name: str = Field(description="name of the format for messages")
    source: str = Field(default="", description="manual or file that states the format")
    layout: Layout = Field(
        description="points: a row per point; profiles_in_rows, profiles_in_columns: heights of one profile per row or"
        " column; sequence: one list of numbers, as OpenCV writes it; image: 16-bit image whose rows are profiles;"
        " ros_bag: messages of a ROS 2 bag"
    )
    content: str | None = Field(
        default=None, description="regular expression in the first 8 KiB of text by which files are recognised"
    )
    files: str = Field(default="*", description="names of the files in a folder of profiles, such as p*.csv")
    begin: str | None = Field(
        default=None, description="regular expression at the beginning of the line before the header or the first row"
    )
    end: str | None = Field(default=None, description="regular expression at the beginning of the line behind the rows")
    skip_lines: Annotated[int, Field(ge=0, le=10_000)] = Field(
        default=0, description="lines to skip at the beginning of the file, or behind that of `begin`"
    )
    has_header: bool = Field(
        default=True, description="whether a line above the rows names the columns, or states the values of x"
    )
    delimiter: Literal["comma", "semicolon", "tab", "blank"] | None = Field(
        default=None, description="between numbers; by default found from the content"
    )
    decimal: Literal["point", "comma"] | None = Field(default=None, description="decimal mark; found by default")
    first_height: Column = Field(
        default=1, description="profiles_in_rows, profiles_in_columns: first column of heights, by name or number"
    )
    kind_column: Column | None = Field(
        default=None, description="profiles_in_rows: column with X, Z or I, where rows hold x, heights or intensities"
    )
    list_name: str | None = Field(
        default=None, description="sequence: regular expression of the list's name; by default the only list"
    )
    values_per_point: Annotated[int, Field(ge=1, le=16)] = Field(
        default=3, description="sequence: how many numbers a point has; the columns of the axes count them from 1"
    )
    invalid: tuple[float, ...] = Field(
        default=(), description="numbers that mark points without a height, in units of the file"
    )
    profile_column: Column | None = Field(
        default=None, description="points: column with the number of the profile; one profile without"
    )
    time_column: Column | None = Field(default=None, description="column of the time stamp")
    time_unit_s: Annotated[float, Field(gt=0.0, le=1e6)] = Field(default=1.0, description="unit of the time stamp, s")
    intensity_column: Column | None = Field(default=None, description="points: column of the intensity")
    x: AxisDescription = Field(default=AxisDescription(), description="along the profile")
    y: AxisDescription | None = Field(
        default=None, description="travel from profile to profile: by steps, or by a column, such as encoder counts"
    )
    z: AxisDescription = Field(default=AxisDescription(), description="z of the points, the height")
    bag: BagDescription = Field(default=BagDescription(), description="ros_bag: topics, joints and frames")

    @field_validator("content", "begin", "end", "list_name")
    @classmethod
    def _compiles(cls, value: str | None) -> str | None:
        try:
            re.compile(value or "")
        except re.error as error:
            raise ValueError(f"no regular expression: {error}") from None
        return value

    @model_validator(mode="after")
    def _columns_of_points(self) -> Self:
        if self.layout in ("points", "sequence", "ros_bag") and (self.x.column is None or self.z.column is None):
            raise ValueError(f"x.column and z.column are needed with the layout {self.layout}")
        return self

    def recognises(self, head: str) -> bool:
        """Whether a file with the beginning `head`, see `head_of`, is of the format."""
        return self.content is not None and re.search(self.content, head, re.MULTILINE) is not None


class FormatFileDescription(Description):
    """File of a format of profiles: the table ``[format]``, which may change a shipped format by its ``preset``."""

    format: FormatDescription = Field(description="how the files are laid out")


def head_of(path: Path) -> str:
    """Text at the beginning of a file, by which its format is recognised; empty for a folder."""
    if not path.is_file():
        return ""
    with path.open("rb") as stream:
        head = stream.read(_HEAD)
    encoding = "utf-16" if head[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig"
    return head.decode(encoding, errors="replace")


def shipped_formats() -> dict[str, FormatDescription]:
    """The formats of ``assets/formats`` by name."""
    return {file.stem: read_format(file) for file in sorted((assets_dir() / "formats").glob("*.toml"))}


def read_format(named: str | Path) -> FormatDescription:
    """Format by the name of a shipped one, or of a TOML file, which may change a shipped one: ``preset = "NAME"``.

    Raises `DescriptionError` naming file, key, value and what was expected.
    """
    folder, path = assets_dir() / "formats", Path(named)
    names = [file.stem for file in sorted(folder.glob("*.toml"))]
    if str(named) in names:
        path = folder / f"{named}.toml"
    elif not path.is_file():
        raise DescriptionError(key="table_format", value=str(named), expected=f"a file, or one of {', '.join(names)}")
    file = read_toml(path)
    data = file.get("format", {})
    if not isinstance(data, dict):
        raise DescriptionError(file=path, key="format", value=data, expected="a table")
    if (preset := data.pop("preset", None)) is not None:
        if preset not in names:
            raise DescriptionError(file=path, key="format.preset", value=preset, expected=f"one of {', '.join(names)}")
        file["format"] = _merged(read_toml(folder / f"{preset}.toml")["format"], data)
    return validate(FormatFileDescription, file, str(path)).format


def recognised_format(path: Path) -> FormatDescription | None:
    """The shipped format of a file, or of the files of a folder, by the content; None if there is none."""
    heads = map(head_of, sorted(path.iterdir()) if path.is_dir() else [path])
    formats = shipped_formats().values()
    return next((form for head in heads for form in formats if form.recognises(head)), None)


def _merged(base: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    """The values of `changes` in place of those of `base`; tables key by key, except the source of a coordinate."""
    made, source = dict(base), {"column", "pitch_mm"}
    for key, value in changes.items():
        own = made.get(key)
        if isinstance(own, dict) and isinstance(value, dict):
            made[key] = {k: v for k, v in own.items() if k not in source or not source & {*value}} | value
        else:
            made[key] = value
    return made
