"""Bundled libraries of the native part, and its system requirements."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

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
    windows: bool  # whether a binary for Windows is among the components

    @property
    def machine(self) -> str:
        """What loads the FMU."""
        linux = f"64-bit x86 Linux with glibc {self.needs['GLIBC']} or later"
        return f"{linux}, or 64-bit x86 Windows" if self.windows else linux

    def dependencies(self) -> list[str]:
        """System requirements, one per line."""
        return [f"{_RUN_TIME[name]} with {name}_{version} or later" for name, version in sorted(self.needs.items())]


def read_bundle(runtime: Path, binary: str = "RobotCell") -> Bundle:
    """Read the lists that were written when the native part was built.

    Parameters
    ----------
    runtime
        Folder with the native part; `windows_dll` of it is optional.
    binary
        Whose components to list: the cell's with its libraries, or ``CellSequencer``.

    Raises
    ------
    CellError
        If a list is missing.
    """
    listing = _read(runtime / "bundle.json")
    components = [Component(**entry) for entry in listing["components"]]
    if binary != "RobotCell":
        components = [replace(part, file=f"{binary}.so") for part in components if part.file == "RobotCell.so"]
    dll = windows_dll(runtime, binary)
    if dll is not None:
        compiled_in = _read(dll.with_name("components.json"))[dll.name]
        components += [Component(file=dll.name, **entry) for entry in compiled_in]
    return Bundle(tuple(components), listing["needs"], dll is not None)


def windows_dll(runtime: Path, binary: str) -> Path | None:
    """The binary for Windows, which ``fmu/windows/build`` makes; None without it."""
    dll = runtime / "windows" / f"{binary}.dll"
    return dll if dll.is_file() else None


def license_files(runtime: Path, bundle: Bundle) -> dict[str, bytes]:
    """Licence texts of all components, by file name, in the order of the components."""
    folders = {"so": runtime / "licenses", "dll": runtime / "windows" / "licenses"}
    texts = {
        part.text: folders["dll" if part.file.endswith(".dll") else "so"] / part.text for part in bundle.components
    }
    return {name: text.read_bytes() for name, text in texts.items()}


def _read(file: Path) -> dict[str, Any]:
    try:
        listing: dict[str, Any] = json.loads(file.read_text())
    except OSError as error:
        raise CellError(f"cannot be read: {error.strerror}; run `make setup`", file=file) from error
    return listing


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
    if bundle.windows:
        lines += ["", "or a 64-bit x86 Windows, of which they need KERNEL32.dll and msvcrt.dll."]
    lines += ["", "Everything else lies beside the binary. The FMU opens no network connection."]
    return "\n".join([*lines, ""])
