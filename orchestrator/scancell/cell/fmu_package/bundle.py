"""Bundled libraries of the native part, and its system requirements."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

from scancell.errors import CellError

_RUN_TIME = {
    "GLIBC": "glibc (libc.so.6, libm.so.6)",
    "GLIBCXX": "libstdc++.so.6",
    "CXXABI": "libstdc++.so.6",
    "GCC": "libgcc_s.so.1",
}


@dataclass(frozen=True)
class Component:
    """A bundled library, or code that is compiled in."""

    file: str
    source: str
    license: str
    text: str


@dataclass(frozen=True)
class Bundle:
    """Components, and the newest symbol version that they need of each run-time library."""

    components: tuple[Component, ...]
    needs: dict[str, str]

    @property
    def glibc(self) -> str:
        """Oldest version of glibc that loads the FMU."""
        return self.needs["GLIBC"]

    def dependencies(self) -> list[str]:
        """System requirements, one per line."""
        return [f"{_RUN_TIME[name]} with {name}_{version} or later" for name, version in sorted(self.needs.items())]


def read_bundle(runtime: Path) -> Bundle:
    """Read the list that was written when the native part was built.

    Raises
    ------
    CellError
        If the list is missing.
    """
    file = runtime / "bundle.json"
    try:
        listing = json.loads(file.read_text())
    except OSError as error:
        raise CellError(f"cannot be read: {error.strerror}; run `make setup`", file=file) from error
    return Bundle(tuple(Component(**entry) for entry in listing["components"]), listing["needs"])


def license_text(bundle: Bundle) -> str:
    """Entry point of the licence folder: which text applies to which file."""
    lines = [
        "Licences of everything in this FMU. Each line: file, where it comes from, licence, name of the text beside",
        "this file. The FMU itself is scancell; the other libraries are bundled unchanged but for names and paths.",
        "",
    ]
    lines += [f"{part.file}: {part.source}; {part.license}; {part.text}" for part in bundle.components]
    return "\n".join([*lines, ""])


def dependencies_text(bundle: Bundle) -> str:
    """External dependencies of the FMU."""
    lines = ["The binaries need a 64-bit x86 Linux that provides:", ""]
    lines += [f"- {line}" for line in bundle.dependencies()]
    lines += ["", "Everything else lies beside the binary. The FMU opens no network connection."]
    return "\n".join([*lines, ""])
