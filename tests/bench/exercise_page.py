"""Texts of the exercises in their page, from the declarations: ``python -m bench.exercise_page docs/exercises.md``."""

from __future__ import annotations

import re
import sys
import textwrap
from pathlib import Path

from scancell.exercises import Exercise, Item, Question, find_exercise

_WIDTH = 120
_SECTION = re.compile(r"(<!-- exercise (\w+) -->\n).*?(?=<!-- end -->)", re.DOTALL)


def updated(page: str) -> str:
    """The text of a page with the texts of the declarations between its marks."""
    return _SECTION.sub(lambda found: found[1] + section(find_exercise(found[2])), page)


def section(exercise: Exercise) -> str:
    """Heading, task and checklist of an exercise."""
    parts = [
        f"## {exercise.number}. {exercise.title}",
        textwrap.fill(exercise.task, _WIDTH),
        f"`scancell workspace --exercise {exercise.number}` checks:",
        "\n".join(textwrap.fill(_line(item), _WIDTH, subsequent_indent="  ") for item in exercise.items),
    ]
    return "\n".join(f"{part}\n" for part in parts)


def _line(item: Item) -> str:
    text = f"figure: {item.text}" if isinstance(item, Question) else item.text
    return f"- {text} ({item.limit})"


if __name__ == "__main__":
    file = Path(sys.argv[1])
    file.write_text(updated(file.read_text(encoding="utf-8")), encoding="utf-8")
