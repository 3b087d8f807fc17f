"""Builds the site from the pages in docs/ and from what the program says of itself.

    python docs/site/build.py build/docs

copies the pages to ``build/docs/source``, adds the generated ones, and writes ``build/docs/site``; open ``index.html``
there. Notebooks are executed. Warnings, among them links that lead nowhere, are errors.
"""

from __future__ import annotations

import logging
import os
import re
import shutil
import sys
from pathlib import Path

from reference import reference_pages
from sphinx.cmd.build import main as sphinx

ROOT = Path(__file__).resolve().parents[2]
INDEX = ROOT / "docs" / "README.md"
_LINK = re.compile(r"(\]\()([^)#\s:]+)(#[^)\s]*)?(\))")


def local_links(text: str) -> list[str]:
    """Targets of links to files, without anchors."""
    return [match[2] for match in _LINK.finditer(text)]


def navigation(index: str, added: dict[str, list[str]]) -> str:
    """Hidden tables of contents: one for each section of the index, with the pages in the order of its links.

    Parameters
    ----------
    added
        Further pages, without suffix, by title of the section.
    """
    trees, seen = [], set[str]()
    for section in re.split(r"^## ", index, flags=re.MULTILINE)[1:]:
        title = section.partition("\n")[0].strip()
        links = [link.removesuffix(".md") for link in local_links(section) if link.endswith(".md")]
        pages = [page for page in dict.fromkeys([*links, *added.get(title, [])]) if page not in seen]
        seen.update(pages)
        trees.append("\n".join(["```{toctree}", ":hidden:", f":caption: {title}", "", *pages, "```", ""]))
    return "\n".join(trees)


def _relinked(text: str, page: Path, moved: Path) -> str:
    """Text of a page of the repository as another file of the sources, its links as before."""

    def link(match: re.Match[str]) -> str:
        target = (page.parent / match[2]).resolve()
        target = ROOT / "index.md" if target == INDEX else target
        return f"{match[1]}{os.path.relpath(target, moved.parent)}{match[3] or ''}{match[4]}"

    return _LINK.sub(link, text)


def collect(source: Path) -> None:
    """Write the sources of the site: the pages of the repository, the files they link to, and generated pages."""
    shutil.rmtree(source, ignore_errors=True)
    pages = [*ROOT.glob("*.md"), *(path for path in (ROOT / "docs").rglob("*.md") if path != INDEX)]
    texts = {page: page.read_text(encoding="utf-8") for page in [*pages, INDEX]}
    for page, text in texts.items():
        for link in local_links(text):
            linked = (page.parent / link).resolve()
            if linked.is_file() and linked.suffix != ".md":
                copy = source / linked.relative_to(ROOT)
                copy.parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(linked, copy)
    generated = reference_pages(ROOT)
    reference = [name.rpartition(".")[0] for name in generated]
    for page, text in texts.items():
        moved = ROOT / "index.md" if page == INDEX else page
        relinked = _relinked(text, page, moved)
        if page == INDEX:
            relinked += "\n" + navigation(relinked, {"Reference": reference})
        generated[str(moved.relative_to(ROOT))] = relinked
    for name, text in generated.items():
        (source / name).parent.mkdir(parents=True, exist_ok=True)
        (source / name).write_text(text, encoding="utf-8")


def quiet_kernels(folder: Path) -> None:
    """Settings of the kernels that execute notebooks: none of the user's, and no messages but errors."""
    profile = folder / "profile_default"
    profile.mkdir(parents=True, exist_ok=True)
    (profile / "ipython_kernel_config.py").write_text('c.IPKernelApp.log_level = "ERROR"\n', encoding="utf-8")
    os.environ["IPYTHONDIR"] = str(folder.absolute())
    logging.getLogger("traitlets").setLevel(logging.WARNING)


def main(folder: str) -> int:
    """Build the site into `folder`; returns the exit code."""
    source, site = Path(folder, "source"), Path(folder, "site")
    collect(source)
    quiet_kernels(Path(folder, "ipython"))
    options = ["-q", "-W", "--keep-going", "-E", "-c", str(Path(__file__).parent), "-d", str(Path(folder, "doctrees"))]
    code = sphinx([*options, "-b", "html", str(source), str(site)])
    if code == 0:
        print(f"scancell: {site / 'index.html'}")
    return code


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
