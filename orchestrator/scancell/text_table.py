"""Tables of numbers as text, as programs of many countries write them.

Encoding, separator, decimal mark, comments and header are found from the content. Every line is accounted for: it is a
row, a comment, blank, or stands above the rows; any other line is refused by its number.
"""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from scancell.arrays import Array
from scancell.errors import DescriptionError
from scancell.files import read_file

_MARKS = ((b"\xef\xbb\xbf", "utf-8"), (b"\xff\xfe", "utf-16-le"), (b"\xfe\xff", "utf-16-be"))
_COMMENTS = ("#", "//", "%", "!")
# Separator and decimal mark; the first of equally good ones is taken. A blank is any number of blanks and tabs.
_DIALECTS = ((",", "."), (";", "."), ("\t", "."), (" ", "."), (";", ","), ("\t", ","), (" ", ","), ("|", "."))
_QUOTED = (",", ",")  # decimal commas within quotation marks
_NUMBER = {mark: re.compile(rf"[+-]?(\d+({re.escape(mark)}\d*)?|{re.escape(mark)}\d+)([eE][+-]?\d+)?\Z", re.ASCII)
           for mark in ".,"}  # fmt: skip
# A number with decimals, which is no version: what stands behind it has damaged its line.
_BEGINS_AS_ROW = re.compile(r"\s*[+-]?\d*[.,]\d+(?![\d.]*\.\d)", re.ASCII)
_SAMPLE = 100  # lines at the end, and in the middle, that tell the separator
_SHOWN = 40  # characters of a line in a message
SEPARATORS = {"comma": ",", "semicolon": ";", "tab": "\t", "blank": " "}
_SEPARATOR_NAMES = {",": "commas", ";": "semicolons", "\t": "tabs", " ": "blanks", "|": "vertical bars"}
# Values of missing numbers, in lower case, beside those of `float`.
MISSING = {
    "", "nan", "-nan", "+nan", "nan(ind)", "-nan(ind)", "1.#qnan", "-1.#ind", "1.#ind", "inf", "+inf", "-inf",
    "infinity", "-infinity", "1.#inf", "-1.#inf", "na", "n/a", "#n/a", "null", "none", "-", "--", "---", "invalid",
}  # fmt: skip
_UNITS = {"µm": "um", "μm": "um", "°": "deg", "deg/s": "deg_s", "°/s": "deg_s", "deg/s^2": "deg_s2", "deg/s²": "deg_s2"}


@dataclass(frozen=True)
class TextTable:
    """Rows of a text, and what the text was taken for.

    Attributes
    ----------
    encoding, separator, decimal
        Encoding, separator and decimal of the text; the separator blank is any number of blanks and tabs.
    names
        Names of the columns, as in `column_name`; empty without a header.
    rows
        (n,) lines.
    numbers
        (n,) of the lines in the file, from 1.
    comments
        Comment lines above the rows, without their mark.
    skipped
        Number of lines above the header or the first row that are neither blank nor comments.
    """

    path: Path
    encoding: str
    separator: str
    decimal: str
    names: tuple[str, ...]
    rows: Sequence[str]
    numbers: Sequence[int]
    comments: tuple[str, ...]
    skipped: int

    @property
    def kind(self) -> str:
        """Description of the format that was recognised."""
        details = [f"separated by {_SEPARATOR_NAMES[self.separator]}", *["decimal commas"] * (self.decimal == ",")]
        if self.encoding != "utf-8":
            details.append(self.encoding.upper().removesuffix("-LE").removesuffix("-BE"))
        if self.skipped:
            details.append(f"{self.skipped} line{'s' * (self.skipped > 1)} above the table")
        return f"text, {', '.join(details)}"

    def columns(self, chosen: Sequence[int]) -> Array:
        """Columns (n, k) of numbers, NaN where a value is missing.

        Raises `DescriptionError` naming the line whose value is no number.
        """
        return numbers_of_lines(self.rows, chosen, self.separator, self.decimal, self.path, self.numbers)


def column_name(text: str) -> str:
    """Name of a column in lower case with its unit behind it: ``X [mm]`` becomes ``x_mm``."""
    name = " ".join(text.strip().strip("\"'").strip().lower().split())
    if name.endswith(("]", ")", ">")):
        inner = name[:-1]
        behind = max(inner.rfind(mark) for mark in "])>") + 1
        opened = min((at for mark in "[(<" if (at := inner.find(mark, behind)) >= 0), default=-1)
        if opened >= 0:
            unit = inner[opened + 1 :].strip()
            name = f"{inner[:opened].rstrip()}_{_UNITS.get(unit, unit)}"
    return name.replace(" ", "_").removesuffix("_")


def decoded(data: bytes, path: Path) -> tuple[str, str]:
    """Text and its encoding: UTF-8, UTF-16 (marked or by its zero bytes), or else Latin-1.

    Raises `DescriptionError` if it is no text.
    """
    mark, name = next((one for one in _MARKS if data.startswith(one[0])), (b"", "utf-8"))
    head = data[:200]
    if not mark and len(head) >= 4 and b"\0" in head:
        name = "utf-16-le" if not any(head[1:-1:2]) else "utf-16-be"
    try:
        text = data[len(mark) :].decode(name)
    except UnicodeDecodeError:
        name = "latin-1"
        text = data.decode(name)
    if re.search(r"[\0-\x08\x0e-\x1f]", text[:4096]):
        raise DescriptionError("is no text", file=path, expected="a text table")
    return text, name


def read_text_table(path: Path) -> TextTable:
    """The table of a text file.

    Raises `DescriptionError` if the file is missing, no text, has no rows, or a line has another number of values.
    """
    return text_table(*decoded(read_file(path), path), path)


def lines_of(text: str) -> list[str]:
    """Lines of a text with any line ends."""
    return text.replace("\r\n", "\n").replace("\r", "\n").split("\n")


def text_table(text: str, encoding: str, path: Path, dialect: tuple[str, str] | None = None) -> TextTable:
    """The table of a text, see `read_text_table`; separator and decimal mark are found unless given."""
    comments: list[str] = []
    lines: list[str] = []
    numbers: list[int] = []
    for number, line in enumerate(lines_of(text), 1):
        stripped = line.strip()
        if not stripped:
            continue
        if stripped.startswith(_COMMENTS):
            comments.append(stripped.lstrip("#/%! \t"))
            continue
        lines.append(line.partition("#")[0] if " #" in line and line.count("#") == 1 else line)
        numbers.append(number)
    if not lines:
        raise DescriptionError("holds no rows", file=path, expected="a table of numbers")
    separator, decimal = dialect or dialect_of(lines, path)
    counts = _counts(lines, separator)
    width, _ = Counter(counts).most_common(1)[0]
    if separator != " " and all(line.rstrip(" ").endswith(separator) for line, n in zip(lines, counts, strict=True)
                                if n == width) and width > 1:  # fmt: skip
        width -= 1
        lines = [_without_end(line, separator, width) for line in lines]
        counts = _counts(lines, separator)
    start = _first_row(lines, counts, width, separator, decimal)
    names: tuple[str, ...] = ()
    fields = split_line(lines[start], separator)
    if not _is_row(fields, decimal):
        names = tuple(column_name(field) for field in fields)
        start += 1
    above = lines[: start - bool(names)]
    _require_words_above(above, numbers, len(lines) - start, (separator, decimal), path, has_header=bool(names))
    other = np.flatnonzero(np.asarray(counts[start:]) != width)
    if len(other):
        row = start + int(other[0])
        raise DescriptionError(
            file=path, key=f"line {numbers[row]}", value=lines[row].strip()[:_SHOWN],
            expected=f"{width} values separated by {_SEPARATOR_NAMES[separator]} as in the other lines",
        )  # fmt: skip
    twice = [name for name, count in Counter(names).items() if count > 1 and name]
    if twice:
        raise DescriptionError("is there twice", file=path, key=f"column '{twice[0]}'")
    return TextTable(path, encoding, separator, decimal, names, lines[start:], numbers[start:], tuple(comments),
                     start - bool(names))  # fmt: skip


def numbers_of_lines(
    lines: Sequence[str], columns: Sequence[int], separator: str, decimal: str, path: Path, numbers: Iterable[int]
) -> Array:
    """Columns (n, k) of numbers of lines, NaN where a value is missing or not finite.

    Raises `DescriptionError` naming the line, of `numbers` (n,), whose value is no number.
    """
    if not lines:
        return np.zeros((0, len(columns)))
    texts = lines if decimal == "." else [line.replace(",", ".") for line in lines]
    if separator != decimal and not any('"' in line for line in lines):
        try:
            found = np.loadtxt(
                texts, delimiter=None if separator == " " else separator, usecols=columns, ndmin=2, comments=None
            )
            if len(found) == len(lines):
                return np.where(np.isfinite(found), found, np.nan)
        except ValueError:
            pass  # a missing value, or one that is no number: looked at one by one
    made = np.full((len(lines), len(columns)), np.nan)
    for row, (line, number) in enumerate(zip(lines, numbers, strict=True)):
        fields = split_line(line, separator)
        for k, column in enumerate(columns):
            field = fields[column] if column < len(fields) else ""
            if _NUMBER[decimal].match(field):
                value = float(field.replace(",", "."))
                made[row, k] = value if np.isfinite(value) else np.nan
            elif field.lower() not in MISSING:
                raise DescriptionError(
                    file=path, key=f"line {number}, value {column + 1}", value=field[:_SHOWN], expected="a number"
                )
    return made


def split_line(line: str, separator: str) -> list[str]:
    """Values of a line as words."""
    if separator == " ":
        return line.split()
    if '"' in line:
        return [field.strip() for field in next(csv.reader([line], delimiter=separator, skipinitialspace=True))]
    return [field.strip() for field in line.split(separator)]


def _without_end(line: str, separator: str, width: int) -> str:
    """The line without the separator at its end, if it has more than `width` values."""
    stripped = line.rstrip(" ")
    return stripped[:-1] if stripped.endswith(separator) and len(split_line(line, separator)) > width else line


def _counts(lines: Sequence[str], separator: str) -> list[int]:
    if separator == " ":
        return [len(line.split()) for line in lines]
    return [len(split_line(line, separator)) if '"' in line else line.count(separator) + 1 for line in lines]


def _numeric(fields: Sequence[str], decimal: str) -> int:
    """Number of fields that are numbers."""
    return sum(_NUMBER[decimal].match(field) is not None for field in fields)


def dialect_of(lines: Sequence[str], path: Path) -> tuple[str, str]:
    """Separator and decimal mark by which the most values are numbers."""
    middle = len(lines) // 2
    sample = [*lines[-_SAMPLE:], *lines[middle : middle + _SAMPLE]]
    dialects = [*_DIALECTS, *[_QUOTED] * any('"' in line for line in sample)]

    def score(dialect: tuple[str, str]) -> tuple[int, int]:
        separator, decimal = dialect
        split = [split_line(line, separator) for line in sample]
        width, same = Counter(map(len, split)).most_common(1)[0]
        if width < 2:
            return (0, 0)
        return (sum(_numeric(fields, decimal) for fields in split if len(fields) == width), same)

    best = max(dialects, key=score)
    if best == (",", ".") and all(re.search(r"\d,\d", line) and re.search(r"\d,\s", line) for line in sample):
        raise DescriptionError(
            "separates values by commas and seems to use commas as decimal marks, too", file=path,
            key=f"'{sample[0].strip()[:_SHOWN]}'",
            expected="semicolons, tabs or blanks between values with decimal commas",
        )  # fmt: skip
    return best


def _first_row(lines: Sequence[str], counts: Sequence[int], width: int, separator: str, decimal: str) -> int:
    """The header: the first line of words of the table's width, if it stands above all rows; else the first row."""
    for index, count in enumerate(counts):
        if count != width:
            continue
        fields = split_line(lines[index], separator)
        if _is_row(fields, decimal) or all(fields):
            return index
    return counts.index(width)


def _is_row(fields: Sequence[str], decimal: str) -> bool:
    """Whether at least one field is a number, or all are marks of missing values."""
    return _numeric(fields, decimal) > 0 or all(field.lower() in MISSING for field in fields)


def _require_words_above(
    above: Sequence[str], numbers: Sequence[int], rows: int, dialect: tuple[str, str], path: Path, *, has_header: bool
) -> None:
    """Refuse lines above the table that may be damaged rows; the number of rows alone is none of them."""
    separator, decimal = dialect
    for line, number in zip(above, numbers, strict=False):
        fields = [field for field in split_line(line, separator) if field]
        is_count = len(fields) == 1 and fields[0].isdecimal()
        if is_count and int(fields[0]) != rows:
            raise DescriptionError(
                file=path, key=f"line {number}", value=fields[0], expected=f"the number of rows, which is {rows}"
            )
        found = _numeric(fields, decimal)
        if has_header:
            is_row = found == len(fields)
        else:
            is_row = found > 1 or _numeric(fields[:1], decimal) == 1 or _BEGINS_AS_ROW.match(line) is not None
        if fields and not is_count and is_row:
            raise DescriptionError(
                file=path, key=f"line {number}", value=line.strip()[:_SHOWN],
                expected="as many values as the lines below have",
            )  # fmt: skip
