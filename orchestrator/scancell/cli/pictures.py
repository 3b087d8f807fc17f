"""`scancell picture`, `animate`, `page` and `export`: a recorded run, rendered, as a page in 3D or as an MCAP file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from scancell.cli.common import Outcome, command, show_progress
from scancell.cli.options import ThreadsOption

if TYPE_CHECKING:
    from scancell.views.recorded_run import RecordedRun

_LARGE_MB = 20.0
# The words of scancell.views, which is slow to import.
_View = Literal["cell", "part", "orbit", "sensor"]
_Colour = Literal["deviation", "intensity"]

_Run = Annotated[Path, typer.Argument(help="run folder of a scan or robot program")]
_ViewOption = Annotated[
    _View, typer.Option("--view", help="whole cell, part, once around the cell, or following the sensor")
]
_SizeOption = Annotated[str, typer.Option("--size", metavar="WIDTHxHEIGHT", help="size in pixels")]
_ColourOption = Annotated[_Colour, typer.Option("--colour", help="quantity that the colours of the cloud show")]


@command("picture")
def picture(
    run_folder: _Run,
    out: Annotated[Path, typer.Option("--out", help="file for the picture (PNG)")] = Path("out/picture.png"),
    time: Annotated[
        float | None,
        typer.Option("--time", help="time in the run, s; default: that of the last exposure, else the end"),
    ] = None,
    view: _ViewOption = "cell",
    size: _SizeOption = "1280x720",
    colour: _ColourOption = "deviation",
    threads: ThreadsOption = 0,
) -> Outcome:
    """Render the cell of a run at one time: arm, sensor, table, part, laser, and the cloud measured until then."""
    from scancell.views import pictures  # noqa: PLC0415

    options: dict[str, Any] = {"view": view, "size": _size(size), "colour": colour, "threads": threads}
    opened, warnings = _opened(run_folder)
    at = pictures.picture(opened, out, time=time, **options)
    return Outcome([f"{out}: {opened.name} at {at:.2f} s"], {"time_s": at}, [str(out)], warnings)


@command("animate")
def animate(
    run_folder: _Run,
    out: Annotated[Path, typer.Option("--out", help="file of the animation, .webm or .webp")] = Path("out/scan.webm"),
    view: _ViewOption = "cell",
    size: _SizeOption = "1280x720",
    fps: Annotated[float, typer.Option("--fps", min=1, max=120, help="pictures per second")] = 25.0,
    seconds: Annotated[
        float | None, typer.Option("--seconds", min=0.01, help="length of the animation, s; default: 10")
    ] = None,
    speed: Annotated[
        float | None, typer.Option("--speed", min=1e-3, help="seconds of the run in one second; instead of --seconds")
    ] = None,
    colour: _ColourOption = "deviation",
    threads: ThreadsOption = 0,
    as_json: bool = False,
) -> Outcome:
    """Render a whole run as a video (WebM, VP9) or animated WebP: the cloud grows as it is measured."""
    from scancell.views import pictures  # noqa: PLC0415

    options: dict[str, Any] = {"view": view, "size": _size(size), "colour": colour, "threads": threads}
    opened, warnings = _opened(run_folder)
    with show_progress(as_json) as progress:
        frames = pictures.animate(opened, out, fps=fps, seconds=seconds, speed=speed, progress=progress, **options)
    length = frames / fps
    figures = {"frames": frames, "seconds": length}
    return Outcome([f"{out}: {frames} frames, {length:.1f} s"], figures, [str(out)], warnings)


@command("page")
def page(
    run_folder: _Run,
    out: Annotated[Path, typer.Option("--out", help="file for the page (HTML)")] = Path("out/run.html"),
    points: Annotated[
        int, typer.Option("--points", min=1, max=900_000, help="points of the cloud at most, evenly chosen")
    ] = 500_000,
    colour: _ColourOption = "deviation",
    threads: ThreadsOption = 0,
) -> Outcome:
    """Write a run as one HTML file with a time slider, which opens in a browser without a network."""
    from scancell.views.pictures import write_page  # noqa: PLC0415

    opened, warnings = _opened(run_folder, points)
    megabytes = write_page(opened, out, colour=colour, threads=threads) / 1e6
    if megabytes > _LARGE_MB:
        warnings.append(f"{out}: {megabytes:.1f} MB are large for an e-mail; --points {points // 2} makes it smaller")
    shown = 0 if opened.cloud is None else len(opened.cloud)
    figures = {"megabytes": megabytes, "points": shown}
    text = f"{out}: {megabytes:.1f} MB, {shown:,} of {opened.cloud_points:,} points"
    return Outcome([text], figures, [str(out)], warnings)


@command("export")
def export(
    run_folder: _Run,
    out: Annotated[Path, typer.Option("--out", help="file for the recording (MCAP)")] = Path("out/scan.mcap"),
    points: Annotated[
        int, typer.Option("--points", min=1, help="points of the cloud at most, evenly chosen")
    ] = 1_000_000,
    threads: ThreadsOption = 0,
    as_json: bool = False,
) -> Outcome:
    """Write a run as an MCAP file, which Foxglove and rerun open: poses and meshes of all bodies, and the points.

    Point clouds for other programs are written by `scan`, `rerun` and `batch` with --format: PLY, NPZ, LAZ, E57,
    PCD, XYZ.
    """
    from scancell.views.mcap_export import export_run  # noqa: PLC0415

    opened, warnings = _opened(run_folder, points)
    with show_progress(as_json) as progress:
        messages = export_run(opened, out, threads, progress)
    shown = 0 if opened.cloud is None else len(opened.cloud)
    figures = {"messages": messages, "points": shown}
    text = f"{out}: {messages} messages, {shown:,} of {opened.cloud_points:,} points"
    return Outcome([text], figures, [str(out)], warnings)


def _opened(folder: Path, *most_points: int) -> tuple[RecordedRun, list[str]]:
    """The run, and a warning where it has no cloud to show."""
    from scancell.views.recorded_run import open_run  # noqa: PLC0415

    opened = open_run(folder, *most_points)
    missing = opened.cloud is None
    return opened, [f"{folder / 'cloud.ply'}: no such file: no cloud is shown"] if missing else []


def _size(text: str) -> tuple[int, int]:
    from scancell.errors import DescriptionError  # noqa: PLC0415

    words = text.lower().split("x")
    if len(words) != 2 or not all(word.isascii() and word.isdigit() for word in words):
        raise DescriptionError(key="size", value=text, expected="WIDTHxHEIGHT in pixels, such as 1280x720")
    width, height = map(int, words)
    if not (64 <= width <= 7680 and 64 <= height <= 7680):
        raise DescriptionError(key="size", value=text, expected="64 to 7680 pixels each way")
    return width, height
