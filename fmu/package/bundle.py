"""Bundle a shared library with its dependencies in one folder, so that it loads on machines without them.

Every dependency except the C and C++ run-time libraries is copied beside the binary, renamed with a hash of the build
in its soname, and found only there (RPATH ``$ORIGIN``). FMUs of different builds therefore share no library in one
process, FMUs of the same build share all of them, and none is shared with the host program.

Run by CMake; needs only the standard library: ``bundle.py LIBRARY PROGRAM FOLDER --patchelf PATCHELF``.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import re
import shutil
import struct
import subprocess
import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path

# glibc and the run-time libraries of the compiler, expected on every Linux system.
SYSTEM_LIBRARIES = re.compile(
    r"^(linux-vdso|ld-linux.*|libc|libm|libdl|librt|libpthread|libresolv|libstdc\+\+|libgcc_s)\.so(\.|$)"
)


def run(*command: str | Path) -> str:
    """Run a command and return its output; raise when it fails."""
    return subprocess.run([str(part) for part in command], check=True, capture_output=True, text=True).stdout


def closure(library: Path) -> dict[str, Path]:
    """Direct and indirect dependencies by soname, without system libraries."""
    found: dict[str, Path] = {}
    for line in run("ldd", library).splitlines():
        match = re.match(r"\s*(\S+) => (\S.*?) \(0x", line)
        if "not found" in line:
            raise SystemExit(f"{library}: {line.strip()}")
        if match and not SYSTEM_LIBRARIES.match(match[1]):
            found[match[1]] = Path(match[2]).resolve()
    return found


def own_names(library: Path, needed: dict[str, Path]) -> dict[str, str]:
    """Unique names with a hash of the whole build: ``libode.so.8`` becomes ``libode-1a2b3c4d.so.8``.

    The hash covers all libraries, because FMUs that share one must share all, including the library with the locks.
    """
    digest = hashlib.sha256(b"".join(path.read_bytes() for path in [library, *needed.values()])).hexdigest()[:8]
    return {soname: f"-{digest}.so".join(soname.split(".so", 1)) for soname in needed}


def make_unique_symbols_ordinary(library: Path) -> None:
    """Change GNU-unique dynamic symbols to weak ones.

    The loader merges unique symbols of all libraries in a process and never unloads a library that has them. Another
    copy of the engine in the process (a second FMU, a Python binding of another version) would share its static
    variables with ours.
    """
    data = bytearray(library.read_bytes())
    section_table, entry_size, count = (
        struct.unpack_from("<Q", data, 0x28)[0],
        struct.unpack_from("<H", data, 0x3A)[0],
        struct.unpack_from("<H", data, 0x3C)[0],
    )
    dynamic_symbols, unique, weak = 11, 10, 2
    for section in range(count):
        header = section_table + section * entry_size
        if struct.unpack_from("<I", data, header + 4)[0] != dynamic_symbols:
            continue
        offset, size = struct.unpack_from("<QQ", data, header + 0x18)
        symbol_size = struct.unpack_from("<Q", data, header + 0x38)[0]
        for symbol in range(offset, offset + size, symbol_size):
            if data[symbol + 4] >> 4 == unique:
                data[symbol + 4] = weak << 4 | data[symbol + 4] & 0xF
    library.write_bytes(data)


def version_needs(libraries: Iterable[Path]) -> dict[str, str]:
    """Newest required symbol version of each run-time library: ``{"GLIBC": "2.34", ...}``.

    A system with these or later versions can load the libraries.
    """
    needs: dict[str, tuple[int, ...]] = {}
    for library in libraries:
        section = run("readelf", "--version-info", "--wide", library).partition("Version needs section")[2]
        for name, number in re.findall(r"Name: (GLIBC|GLIBCXX|CXXABI|GCC)_([0-9.]+)", section):
            version = tuple(int(part) for part in number.split("."))
            needs[name] = max(needs.get(name, ()), version)
    return {name: ".".join(map(str, version)) for name, version in sorted(needs.items())}


def package_of(library: Path) -> str:
    """Debian package that contains a library."""
    # Searched by name, because with a merged /usr the package database lists either /lib or /usr/lib.
    return run("dpkg-query", "--search", f"*/{library.name}").partition(":")[0]


def copy_license(package: str, folder: Path) -> dict[str, str]:
    """Copy the licence text of a Debian package; return source, licence name and file name."""
    text = (Path("/usr/share/doc") / package / "copyright").read_text(errors="replace")
    folder.mkdir(exist_ok=True)
    (folder / f"{package}.txt").write_text(text)
    main = re.search(r"^Files:\s*\*.*?^License:\s*([^\n]+)", text, re.MULTILINE | re.DOTALL)
    version = run("dpkg-query", "--show", "--showformat=${Version}", package)
    return {"source": f"{package} {version}", "license": main[1] if main else "see text", "text": f"{package}.txt"}


def bundle(library: Path, folder: Path, patchelf: str, own: Sequence[str], headers: Iterable[str]) -> list[str]:
    """Write the library, its dependencies, their licences and a list of components into the folder.

    The list, ``bundle.json``, contains every component (file, source, licence, name of the licence text) and the
    required symbol versions. ``own`` and ``headers`` come from the command line: see ``main``. Returns the arguments
    with which patchelf renames the dependencies.
    """
    needed = closure(library)
    names = own_names(library, needed)
    replacements = [part for old, new in names.items() for part in ("--replace-needed", old, new)]
    targets = []
    for soname, path in [(None, library), *needed.items()]:
        target = folder / (names[soname] if soname else library.name)
        shutil.copyfile(path, target)
        target.chmod(0o755)
        run("strip", "--strip-unneeded", target)
        # One change per run: patchelf 0.14 corrupts names when given several at once.
        if soname:
            run(patchelf, "--set-soname", names[soname], target)
        run(patchelf, *replacements, target)
        run(patchelf, "--set-rpath", "$ORIGIN", target)
        make_unique_symbols_ordinary(target)
        targets.append(target)
    licenses = folder / "licenses"
    parts = [{"file": library.name, **copy_own(description, licenses)} for description in own]
    parts += [{"file": library.name, **copy_license(package, licenses)} for package in headers]
    for soname, path in needed.items():
        built_here = path.parent == library.resolve().parent
        source = copy_own(own[0], licenses) if built_here else copy_license(package_of(path), licenses)
        parts.append({"file": names[soname], **source})
    listing = {"needs": version_needs(targets), "components": parts}
    (folder / "bundle.json").write_text(json.dumps(listing, indent=1) + "\n")
    return replacements


def copy_own(description: str, folder: Path) -> dict[str, str]:
    """Copy a licence text of the source tree; return source, licence name and file name."""
    name, license_name, text = description.split("=")
    folder.mkdir(exist_ok=True)
    shutil.copyfile(text, folder / f"{name}.txt")
    return {"source": name, "license": license_name, "text": f"{name}.txt"}


def main() -> None:
    parser = argparse.ArgumentParser(description="Bundle a library with its dependencies and a program in one folder.")
    parser.add_argument("library", type=Path)
    parser.add_argument("program", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--patchelf", default="patchelf")
    parser.add_argument(
        "--own", action="append", default=[], metavar="NAME=LICENSE=TEXT", help="code of the source tree"
    )
    parser.add_argument(
        "--headers", action="append", default=[], metavar="PACKAGE", help="Debian package with headers compiled in"
    )
    arguments = parser.parse_args()

    arguments.folder.parent.mkdir(parents=True, exist_ok=True)
    fresh = Path(tempfile.mkdtemp(dir=arguments.folder.parent))
    fresh.chmod(0o755)
    try:
        replacements = bundle(arguments.library, fresh, arguments.patchelf, arguments.own, arguments.headers)
        program = fresh / arguments.program.name
        shutil.copyfile(arguments.program, program)
        program.chmod(0o755)
        run("strip", program)
        if closure(arguments.program):
            run(arguments.patchelf, *replacements, program)
            run(arguments.patchelf, "--set-rpath", "$ORIGIN", program)
        shutil.rmtree(arguments.folder, ignore_errors=True)
        fresh.rename(arguments.folder)
    finally:
        shutil.rmtree(fresh, ignore_errors=True)


if __name__ == "__main__":
    main()
