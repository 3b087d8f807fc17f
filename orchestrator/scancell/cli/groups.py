"""The list of commands in groups by what they are for."""

from __future__ import annotations

from typing import Any

from typer.core import TyperGroup

GROUPS = {
    "Scan": ("scan", "shot", "plan", "place", "survey", "render", "rerun", "extract"),
    "Evaluate and calibrate": ("evaluate", "mesh", "calibrate", "acceptance"),
    "Many scans": ("study", "batch"),
    "Robot cell": ("workspace", "run", "guard", "fmu", "robot"),
    "Recorded runs": ("picture", "animate", "page", "export"),
    "About": ("schema", "version"),
}


class GroupedCommands(TyperGroup):
    """Help that lists commands by `GROUPS`, each with the first sentence of its own help."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the sections, all with one width of the names."""
        width = max(map(len, self.commands))
        for title, names in GROUPS.items():
            rows = [(name.ljust(width), _first_sentence(self.commands[name].help or "")) for name in names]
            with formatter.section(title):
                formatter.write_dl(rows)


def _first_sentence(text: str) -> str:
    return " ".join(text.split("\n\n", maxsplit=1)[0].split()).rstrip(".")
