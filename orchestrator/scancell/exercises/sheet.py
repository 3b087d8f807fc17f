"""Result sheet of an exercise: one HTML file without resources from elsewhere."""

from __future__ import annotations

import base64
from datetime import datetime
from html import escape
from pathlib import Path

from scancell import __version__
from scancell.errors import DescriptionError
from scancell.exercises.attempt import Attempt, Result
from scancell.files import atomic_write
from scancell.output.manifest import command_words

_SUFFIX = ".html"
_LONGEST_NAME = 200  # bytes
_STYLE = """body{font-family:sans-serif;max-width:60em;margin:2em auto;padding:0 1em}
table{border-collapse:collapse}td,th{border:1px solid #999;padding:0.3em 0.6em;text-align:left}
img{max-width:100%}"""


def sheet_file(folder: Path, name: str) -> Path:
    """Path of a sheet in a folder; the suffix is added where it is missing.

    Raises
    ------
    DescriptionError
        If `name` is no file name.
    """
    name = name.strip()
    name = name if name.lower().endswith(_SUFFIX) else name + _SUFFIX
    is_plain = name.isprintable() and not set(name) & set('/\\:*?"<>|') and not name.startswith(".")
    if not is_plain or len(name.encode()) > _LONGEST_NAME:
        expected = f"a file name without folders, of at most {_LONGEST_NAME} bytes, such as exercise_1{_SUFFIX}"
        raise DescriptionError(key="file", value=name, expected=expected)
    return folder / name


def write_sheet(file: Path, attempt: Attempt, student: str, picture: bytes | None = None) -> None:
    """Write the results of an attempt.

    Parameters
    ----------
    student
        Name, may be empty.
    picture
        Of the scene (PNG).

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    text = sheet_html(attempt, student, picture)
    with atomic_write(file) as temporary:
        temporary.write_text(text, encoding="utf-8")


def sheet_html(attempt: Attempt, student: str, picture: bytes | None = None) -> str:
    """The text of a sheet; parameters as of `write_sheet`."""
    exercise, world, results = attempt.exercise, attempt.world, attempt.results
    is_passed = all(result.is_reached for result in results)
    title = escape(f"Exercise {exercise.number}: {exercise.title}")
    facts = {
        "student": student,
        "date": datetime.now().astimezone().isoformat(" ", "seconds"),
        "result": "passed" if is_passed else "not passed",
        "seed": str(world.seed),
        "deviations of the cell": " ".join(world.as_built) or "none",
        "scancell": __version__,
        "command": " ".join(command_words(None)),
    }
    rows = "".join(f"<tr><th>{escape(name)}</th><td>{escape(value)}</td></tr>\n" for name, value in facts.items())
    shown = base64.b64encode(picture).decode() if picture else ""
    image = f'<p><img alt="the scene" src="data:image/png;base64,{shown}"></p>\n' if shown else ""
    return (
        f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>{title}</title>\n'
        f"<style>{_STYLE}</style></head>\n<body><h1>{title}</h1>\n<p>{escape(exercise.task)}</p>\n"
        f"<table>\n{rows}</table>\n<h2>Items</h2>\n<table>\n"
        f"<tr><th>item</th><th>value</th><th>limit</th><th>result</th></tr>\n{''.join(map(_row, results))}</table>\n"
        f"{image}</body></html>\n"
    )


def _row(result: Result) -> str:
    reached = "passed" if result.is_reached else "not passed"
    cells = (result.item.text, result.value_text or "none", result.item.limit, reached)
    return f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in cells)}</tr>\n"
