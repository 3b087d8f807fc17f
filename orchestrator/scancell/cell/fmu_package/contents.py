"""The files of an FMU, by their path in the archive."""

from __future__ import annotations

import io
import subprocess
import tempfile
import zipfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import IO, Any, Literal

import fmpy

from scancell.arguments import checked_fields
from scancell.cell.fmu_package.bundle import (
    Bundle,
    dependencies_text,
    license_files,
    license_text,
    read_bundle,
    windows_dll,
)
from scancell.cell.fmu_package.pages import index_page
from scancell.cell.fmu_package.reference import Reference, record_reference
from scancell.cell.fmu_package.terminals import terminals_xml
from scancell.config.loading import assets_dir
from scancell.errors import CellError

FmiVersion = Literal[2, 3]
_LINUX = {2: "linux64", 3: "x86_64-linux"}
_WINDOWS = {2: "win64", 3: "x86_64-windows"}
# Zip entries carry a fixed date, so that the same cell gives the same bytes.
_EPOCH = (1980, 1, 1, 0, 0, 0)


@checked_fields
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
    integers
        Describe modes, states and errors as integers instead of enumerations, which libcosim and ecos do not support.
    ahead
        Describe `controller.ahead`, the 64 next points of the path of a motion, which a guard reads: an array in FMI 3,
        64 scalars for each axis in FMI 2.
    records
        Describe arrays `trigger.records.*` of all records that became complete in a communication step (FMI 3).

    Examples
    --------
    >>> import zipfile
    >>> setup = scancell.load_setup()
    >>> nominal = scancell.nominal_cell(setup.cell, scancell.load_part("part.stl"))
    >>> description = scancell.cell_json(setup.cell, nominal, seed=0)
    >>> scancell.build_fmu(description, "cell.fmu", version=3, options=scancell.FmuOptions(arrays=True))
    >>> b'name="measured.q"' in zipfile.ZipFile("cell.fmu").read("modelDescription.xml")
    True
    """

    clock: bool = False
    arrays: bool = False
    integers: bool = False
    ahead: bool = False
    records: bool = False


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
        contents[f"binaries/{_LINUX[version]}/{library.name}"] = library.read_bytes()
    contents |= _optional_binary(runtime, "RobotCell", version) | dict(sorted(_licenses(runtime, bundle).items()))
    with tempfile.TemporaryDirectory(prefix="scancell-") as folder:
        fmu = Path(folder) / "RobotCell"
        write_unpacked(fmu, runtime, cell, version, FmuOptions())
        reference = record_reference(fmu)
    return {**contents, **_documents(contents["modelDescription.xml"], version, bundle, reference)}


def sequencer_contents(runtime: Path, cell: str, version: FmiVersion = 2) -> dict[str, bytes]:
    """All files of the FMU of the sequencer of a cell.

    Parameters
    ----------
    runtime
        Folder with the native library, its closure and the description printer.
    cell
        Description of the cell (JSON).

    Raises
    ------
    CellError
        If the native part refuses the description.
    """
    library = runtime / "sequencer" / "CellSequencer.so"
    bundle = read_bundle(runtime, "CellSequencer")
    return {
        "modelDescription.xml": _printed(
            [runtime / "sequencer" / "sequencer-describe", "-", "--fmi", str(version)], cell
        ),
        "resources/cell.json": cell.encode(),
        "documentation/licenses/license.txt": license_text(bundle).encode(),
        f"binaries/{_LINUX[version]}/{library.name}": library.read_bytes(),
        **_optional_binary(runtime, "CellSequencer", version),
        **_licenses(runtime, bundle),
    }


def _optional_binary(runtime: Path, binary: str, version: FmiVersion) -> dict[str, bytes]:
    """The binary for Windows, if it was built."""
    dll = windows_dll(runtime, binary)
    return {} if dll is None else {f"binaries/{_WINDOWS[version]}/{dll.name}": dll.read_bytes()}


def _licenses(runtime: Path, bundle: Bundle) -> dict[str, bytes]:
    texts = license_files(runtime, bundle)
    return {f"documentation/licenses/{name}": text for name, text in texts.items()}


def write_unpacked(folder: Path, runtime: Path, cell: str, version: FmiVersion, options: FmuOptions) -> None:
    """Create a folder with the files of an FMU that an instance needs; libraries are linked.

    Raises
    ------
    CellError
        If the native part refuses the description.
    """
    description = _describe(runtime, cell, version, options, read_bundle(runtime))
    (folder / "resources").mkdir(parents=True)
    (folder / "binaries").mkdir()
    (folder / "modelDescription.xml").write_bytes(description)
    (folder / "resources" / "cell.json").write_text(cell)
    (folder / "binaries" / _LINUX[version]).symlink_to(runtime.resolve(), target_is_directory=True)


def _documents(model_description: bytes, version: FmiVersion, bundle: Bundle, reference: Reference) -> dict[str, bytes]:
    """Files for users and tools, which an instance does not need."""
    description = read_description(model_description)
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


def read_description(model_description: bytes) -> Any:
    """Read it with FMPy, which requires an archive."""
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w") as file:
        file.writestr("modelDescription.xml", model_description)
    return fmpy.read_model_description(archive, validate=False)


def write_archive(path: Path | IO[bytes], contents: Mapping[str, bytes]) -> None:
    """Zip the contents; the same contents give the same bytes.

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in contents.items():
            entry = zipfile.ZipInfo(name, _EPOCH)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = (0o755 if name.startswith("binaries/") else 0o644) << 16
            archive.writestr(entry, content)


def _describe(runtime: Path, cell: str, version: FmiVersion, options: FmuOptions, bundle: Bundle) -> bytes:
    """The model description, printed by the same variable table that the library answers from."""
    command: list[str | Path] = [runtime / "robotcell-describe", "-", "--fmi", str(version), "--needs", bundle.machine]
    command += [f"--{variant}" for variant, wanted in asdict(options).items() if wanted]
    return _printed(command, cell)


def _printed(command: list[str | Path], cell: str) -> bytes:
    """What a description printer prints for a description of a cell."""
    result = subprocess.run(command, input=cell.encode(), capture_output=True, check=False)
    if result.returncode:
        raise CellError(f"the native robot cell refuses the description: {result.stderr.decode().strip()}")
    return result.stdout
