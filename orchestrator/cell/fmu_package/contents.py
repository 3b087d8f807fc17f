"""The files of an FMU, by their path in the archive."""

from __future__ import annotations

import io
import subprocess
import tempfile
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import fmpy

from orchestrator.cell.fmu_package.bundle import Bundle, dependencies_text, license_text, read_bundle
from orchestrator.cell.fmu_package.pages import index_page
from orchestrator.cell.fmu_package.reference import record_reference
from orchestrator.cell.fmu_package.terminals import terminals_xml
from orchestrator.config.loading import assets_dir
from orchestrator.errors import CellError

FmiVersion = Literal[2, 3]
_PLATFORM = {2: "linux64", 3: "x86_64-linux"}
# Zip entries carry a fixed date, so that the same cell gives the same bytes.
_EPOCH = (1980, 1, 1, 0, 0, 0)


@dataclass(frozen=True)
class FmuOptions:
    """Variants of an FMU.

    Attributes
    ----------
    clock
        Describe the clock of the exposures (FMI 3). Several importers fail on any clock (ecos frees memory twice,
        fmi-sim reads it as a Boolean), so it is off by default; event mode works without.
    arrays
        Merge indexed scalars into arrays (FMI 3): `measured.q` instead of `measured.q[1]` to `measured.q[6]`. Few
        importers read arrays.
    documents
        What people and tools read: documentation, terminals, icon, reference trajectory, the cell line by line.
    compressed
        Make the file small; packing and unpacking then take most of the time that it takes to start a cell.
    """

    clock: bool = False
    arrays: bool = False
    documents: bool = True
    compressed: bool = True


# Of an FMU that its maker runs and throws away.
THROWN_AWAY = FmuOptions(documents=False, compressed=False)


def fmu_contents(runtime: Path, cell: str, version: FmiVersion, options: FmuOptions) -> dict[str, bytes]:
    """All files of the FMU.

    Parameters
    ----------
    runtime
        Folder with the native library, its closure and the description printer.
    cell
        Description of the cell (JSON).

    Raises
    ------
    CellError
        If the native part refuses the description, or the cell cannot make its reference trajectory.
    """
    bundle = read_bundle(runtime)
    contents = {
        "modelDescription.xml": _describe(runtime, cell, version, options, bundle),
        "resources/cell.json": cell.encode(),
        "documentation/licenses/license.txt": license_text(bundle).encode(),
        "documentation/externalDependencies.txt": dependencies_text(bundle).encode(),
    }
    for library in sorted(runtime.glob("*.so*")):
        contents[f"binaries/{_PLATFORM[version]}/{library.name}"] = library.read_bytes()
    for text in sorted((runtime / "licenses").iterdir()):
        contents[f"documentation/licenses/{text.name}"] = text.read_bytes()
    if not options.documents:
        return contents
    # The same binary, described without arrays: what it does is the same.
    plain = _describe(runtime, cell, version, FmuOptions(), bundle)
    return {**contents, **_documents(contents, plain, version, bundle)}


def _documents(contents: Mapping[str, bytes], plain: bytes, version: FmiVersion, bundle: Bundle) -> dict[str, bytes]:
    """What people and tools read; the contents so far make an FMU that runs."""
    with tempfile.TemporaryDirectory(prefix="scancell-") as folder:
        fmu = Path(folder) / "RobotCell.fmu"
        write_archive(fmu, {**contents, "modelDescription.xml": plain}, compressed=False)
        reference = record_reference(fmu)
    description = _read(contents["modelDescription.xml"])
    icon = assets_dir() / "fmu" / "icon.png"
    documents = {name: text.encode() for name, text in reference.files().items()}
    documents["documentation/index.html"] = index_page(description, bundle, reference).encode()
    if version == 2:
        return {**documents, "model.png": icon.read_bytes()}
    return {
        **documents,
        "terminalsAndIcons/terminalsAndIcons.xml": terminals_xml(description.modelVariables),
        "terminalsAndIcons/icon.png": icon.read_bytes(),
        "terminalsAndIcons/icon.svg": icon.with_suffix(".svg").read_bytes(),
    }


def _read(model_description: bytes) -> Any:
    """As FMPy reads it; it wants an archive."""
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w") as file:
        file.writestr("modelDescription.xml", model_description)
    return fmpy.read_model_description(archive, validate=False)


def write_archive(path: Path, contents: Mapping[str, bytes], *, compressed: bool) -> None:
    """Zip the contents; the same contents give the same bytes.

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in contents.items():
            entry = zipfile.ZipInfo(name, _EPOCH)
            entry.compress_type = zipfile.ZIP_DEFLATED if compressed else zipfile.ZIP_STORED
            entry.external_attr = (0o755 if name.startswith("binaries/") else 0o644) << 16
            archive.writestr(entry, content)


def _describe(runtime: Path, cell: str, version: FmiVersion, options: FmuOptions, bundle: Bundle) -> bytes:
    """The model description, printed by the same variable table that the library answers from."""
    needs = f"64-bit x86 Linux with glibc {bundle.glibc} or later"
    command = [str(runtime / "robotcell-describe"), "-", "--fmi", str(version), "--needs", needs]
    command += [word for word, wanted in (("--clock", options.clock), ("--arrays", options.arrays)) if wanted]
    result = subprocess.run(command, input=cell.encode(), capture_output=True, check=False)
    if result.returncode:
        raise CellError(f"the native robot cell refuses the description: {result.stderr.decode().strip()}")
    return result.stdout
