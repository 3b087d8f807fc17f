"""Checklists that show what has been done."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from scancell.browser.panels.colours import CALM
from scancell.browser.panels.handles import small_html


def checklist_html(title: str, what: str, texts: Sequence[str], done: Sequence[bool]) -> str:
    """Texts with their marks, under a title that counts `what` is done; the first one that is not done is bold."""
    following = done.index(False) if False in done else -1
    lines = [f"<b>{escape(title)}</b>, {sum(done)} of {len(done)} {what} done"]
    for number, (text, is_done) in enumerate(zip(texts, done, strict=True)):
        mark = f'<span style="color:{CALM}">&#9745;</span>' if is_done else "&#9744;"
        shown = f"<b>{escape(text)}</b>" if number == following else escape(text)
        lines.append(f"{mark} {shown}")
    return small_html(lines)
