"""A plan in HTML: the configuration map of a sensor path, and the segments of a program."""

from __future__ import annotations

import base64
import io
from collections.abc import Iterable
from functools import lru_cache
from html import escape
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from scancell.browser.panels.colours import ALARM, CALM, DIMMED, MARKED
from scancell.live.plan import LivePlanState, MapPose
from scancell.output.map_picture import map_legend, map_pixels, motion_lines
from scancell.planning.path_map.configuration_map import ConfigurationMap
from scancell.planning.plan import Plan

ALONG, ANGLE = "along the path, %", "table angle, deg"  # inputs that a click on the map sets

_HEIGHT = 200  # px
_SEGMENTS = 7  # shown at a time: a scrolled list would jump back at every change
_NUMBER = "padding-right:0.5em;vertical-align:top"
_ONE_LINE = "max-width:0;width:100%;overflow:hidden;text-overflow:ellipsis;white-space:nowrap"
_RIGHT = "text-align:right;white-space:nowrap;padding-left:0.6em;vertical-align:top"
_TEXT = "padding:0 0.75em 0.4em;font-size:0.85em;line-height:1.4"
_CLICK = (
    Path(__file__).with_name("map.js").read_text(encoding="utf-8").replace("@ALONG@", ALONG).replace("@ANGLE@", ANGLE)
)


def map_html(map_: ConfigurationMap, motion: NDArray[np.float64] | None, picked: MapPose | None) -> str:
    """A map whose time goes to the right and whose table angle goes upwards, with a motion (n,), rad, and a pose.

    A click sets the inputs `ALONG` and `ANGLE`.
    """
    lines = [] if motion is None else motion_lines(motion)
    drawn = [_line(line, "#222831", 2.5) for line in lines]
    if picked is not None:
        x, y = picked.share, 1 - picked.angle / (2 * np.pi)
        for colour, width in (("#ffffff", 3.0), ("#0b57d0", 1.2)):
            drawn += [_line([(x, 0.0), (x, 1.0)], colour, width), _line([(0.0, y), (1.0, y)], colour, width)]
    marks = "".join(
        f'<span style="display:inline-block;margin-right:0.8em"><span style="display:inline-block;width:0.8em;height:'
        f'0.8em;background:{colour};border:1px solid #7d8590"></span> {escape(name)}</span>'
        for name, colour in map_legend(map_)
    )
    return (
        f'<div style="{_TEXT}"><div>↑ table angle, 0 to 360°</div><svg viewBox="0 0 1 1" preserveAspectRatio="none" '
        f'data-map="" onclick="{escape(_CLICK)}" style="width:100%;height:{_HEIGHT}px;cursor:crosshair;display:block">'
        f'<image href="{_picture(map_)}" width="1" height="1" preserveAspectRatio="none" '
        f'style="image-rendering:pixelated"/>{"".join(drawn)}</svg>'
        f'<div style="text-align:right">along the path →</div>{marks}</div>'
    )


def pose_html(picked: MapPose) -> str:
    """Quality of a pose of the map, or the reason why it is forbidden."""
    colour = ALARM if picked.reason else CALM
    verdict = f"forbidden: {picked.reason}" if picked.reason else f"free, quality {picked.quality:.2f}"
    where = f"{100 * picked.share:.1f} % of the way, table at {np.degrees(picked.angle):.0f}°"
    return f'<div style="{_TEXT}">{where}<br><b style="color:{colour}">{escape(verdict)}</b></div>'


def state_html(state: LivePlanState, plan: Plan | None) -> str:
    """Progress and contents of a plan."""
    lines = []
    if state.stage in ("planning", "evaluating"):
        what = "planning" if state.stage == "planning" else f"evaluating the map, {state.share:.0%}"
        lines.append(f"<b>{what}</b>, {state.seconds:.0f} s")
    if state.error:
        lines.append(f'<b style="color:{ALARM}">{escape(state.error)}</b>')
    if plan is not None:
        count, program = len(plan.segment), plan.program
        lines.append(f"{count} exposures in {len(program.segments)} segments, {program.duration:.1f} s of motion")
        if plan.coverage is not None:
            lines.append(f"sees {plan.coverage:.1%} of the surface")
        lines += [escape(warning) for warning in plan.warnings]
    return f'<div style="{_TEXT}">{"<br>".join(lines or ["no plan yet"])}</div>'


def segments_html(plan: Plan, now: int) -> str:
    """A table of names, durations and numbers of exposures of the segments around `now` (index)."""
    segments, most = plan.program.segments, _SEGMENTS
    exposures = dict(zip(*(values.tolist() for values in np.unique(plan.segment, return_counts=True)), strict=True))
    first = max(0, min(now - most // 2, len(segments) - most))
    rows = [
        f'<tr style="{f"background:{MARKED}" if number == now + 1 else ""}"><td style="{_NUMBER}">{number}</td>'
        f'<td style="{"" if number == now + 1 else _ONE_LINE}" title="{escape(item.name)}">{escape(item.name)}</td>'
        f'<td style="{_RIGHT}">{item.times[-1]:.1f}</td>'
        f'<td style="{_RIGHT}">{exposures.get(item.id, "-")}</td></tr>'
        for number, item in enumerate(segments[first : first + most], start=first + 1)
    ]
    more = f"segments {first + 1} to {first + len(rows)} of {len(segments)}" if len(rows) < len(segments) else ""
    return (
        f'<div style="{_TEXT}"><table style="width:100%;border-spacing:0"><thead><tr style="color:{DIMMED}"><td></td>'
        f'<td>segment</td><td style="{_RIGHT}">time, s</td><td style="{_RIGHT}">exposures</td></tr></thead>'
        f"<tbody>{''.join(rows)}</tbody></table>{more}</div>"
    )


def _line(points: Iterable[tuple[float, float]], colour: str, width: float) -> str:
    places = " ".join(f"{x:.4f},{y:.4f}" for x, y in points)
    return (
        f'<polyline points="{places}" fill="none" stroke="{colour}" stroke-width="{width}" '
        'vector-effect="non-scaling-stroke"/>'
    )


@lru_cache(maxsize=16)
def _picture(map_: ConfigurationMap) -> str:
    """A map as a data address; it is complete when it is shown."""
    file = io.BytesIO()
    Image.fromarray(map_pixels(map_)).save(file, "PNG")
    return f"data:image/png;base64,{base64.b64encode(file.getvalue()).decode()}"
