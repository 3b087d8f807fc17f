"""The site of the documentation: built without warnings, complete, without the network, and its search answers."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

import pytest

from chromium import Watched, chromium

ROOT = Path(__file__).resolve().parents[2]
PARTS = ["Start", "How to", "Reference", "Theory", "Validation", "Architecture", "Contributing"]
# What a newcomer types, and the page and section that answer it.
QUESTIONS = {
    "what does as_built.tool.rx_deg turn about?": "docs/questions.html#what-does-as-built-tool-rx-deg-turn-about",
    "why is my coverage 26 %?": "docs/questions.html#why-is-my-coverage-26",
    "can I load this in Simulink on Windows?": "docs/questions.html#can-i-load-this-in-simulink-on-windows",
    "Simulink Windows": "docs/questions.html",
    "rx_deg turn about": "docs/questions.html",
}
NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.md"))

pytestmark = pytest.mark.docs


class Page(HTMLParser):
    """Identifiers of a page, its links, and the addresses of what a browser loads to show it."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.identifiers: set[str] = set()
        self.links: list[str] = []
        self.loaded: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = {key: value for key, value in attrs if value}
        self.identifiers |= {given[key] for key in ("id", "name") if key in given}
        if tag == "a" and "href" in given:
            self.links.append(given["href"])
        elif tag == "link" and given.get("rel") not in ("index", "search", "next", "prev"):
            self.loaded.append(given.get("href", ""))
        self.loaded += [given[key] for key in ("src", "srcset", "poster", "data") if key in given]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of the site; warnings are errors."""
    folder = tmp_path_factory.mktemp("docs")
    command = [sys.executable, str(ROOT / "docs" / "site" / "build.py"), str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-4000:]
    return folder / "site"


@pytest.fixture(scope="module")
def pages(site: Path) -> dict[str, Page]:
    return {str(path.relative_to(site)): Page(path.read_text(encoding="utf-8")) for path in site.rglob("*.html")}


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium() as opened:
        yield opened


def test_pages_load_nothing_from_the_network(site: Path, pages: dict[str, Page]) -> None:
    assert len(pages) > 50
    remote = {name: [url for url in page.loaded if re.match(r"(\w+:)?//", url)] for name, page in pages.items()}
    assert {name: urls for name, urls in remote.items() if urls} == {}
    styles = {path.name: path.read_text(encoding="utf-8") for path in site.rglob("*.css")}
    pattern = r"(?:url\(|@import)\s*[\"']?(?:https?:)?//"
    assert [name for name, text in styles.items() if re.search(pattern, text)] == []


def test_links_of_pages_lead_to_pages_and_sections(site: Path, pages: dict[str, Page]) -> None:
    broken = []
    for name, page in pages.items():
        for link in page.links:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            target = (site / name).parent / unquote(parts.path) if parts.path else site / name
            if not target.is_file():
                broken.append(f"{name}: {link}")
            elif parts.fragment and target.suffix == ".html":
                found = pages[str(target.resolve().relative_to(site.resolve()))].identifiers
                if unquote(parts.fragment) not in found:
                    broken.append(f"{name}: {link}")
    assert broken == []


def test_formulas_are_mathml(site: Path) -> None:
    source = (ROOT / "docs" / "theory.md").read_text(encoding="utf-8")
    text = (site / "docs" / "theory.html").read_text(encoding="utf-8")
    assert text.count("<math ") == source.count("$$") // 2 > 15
    assert "$$" not in text


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebooks_show_outputs_and_figures(notebook: Path, site: Path) -> None:
    if notebook.stem == "real_recordings" and "SCANCELL_RECORDINGS" not in os.environ:
        pytest.skip("needs a download: docs/notebooks/real_recordings.md")
    cells = notebook.read_text(encoding="utf-8").count("\n```{code-cell}\n")
    text = (site / "docs" / "notebooks" / f"{notebook.stem}.html").read_text(encoding="utf-8")
    assert text.count('<div class="cell_input ') == cells >= 3
    assert text.count('<div class="cell_output ') > cells / 2
    assert "<img " in text
    assert "Traceback" not in text


def test_signatures_show_types_without_conditions(site: Path) -> None:
    pages = (site / "docs" / "reference").glob("python_*.html")
    text = re.sub(r"<[^>]+>", "", "".join(path.read_text(encoding="utf-8") for path in pages))
    assert "NDArray[float64]" in text
    assert re.findall(r"Annotated.{40}", text) == []


def test_variables_of_every_device_are_listed(site: Path) -> None:
    text = (site / "docs" / "reference" / "fmu_variables.html").read_text(encoding="utf-8")
    groups = re.findall(r'<h2>(Parameters|Inputs|Outputs) <code[^>]*><span class="pre">(\w+)</span>', text)
    devices = {"conveyor", "presence", "distance", "light_curtain"}
    assert {name for kind, name in groups if kind == "Outputs"} >= devices | {
        "measured",
        "truth",
        "trigger",
        "controller",
    }
    for name in (
        "as_built.dh[6].theta",
        "command.gripper.force",
        "command.conveyor[1].speed",
        "truth.finger[2].position[1]",
    ):
        assert f">{name}<" in text


def test_index_opens_from_a_folder(site: Path, browser: Any) -> None:
    watched = Watched(browser, 1200, 900)
    watched.page.goto((site / "index.html").as_uri())
    captions = watched.page.locator(".sidebar-tree .caption-text").all_text_contents()
    assert captions == PARTS
    assert watched.errors == []
    assert [url for url in watched.requests if not url.startswith("file:")] == []
    watched.page.close()


def test_search_finds_the_answers_of_a_newcomer_first(site: Path, browser: Any) -> None:
    watched = Watched(browser, 1200, 900)
    found = {}
    for question in QUESTIONS:
        watched.page.goto((site / "index.html").as_uri())
        field = watched.page.locator("input[name=q]").first
        field.fill(question)
        field.press("Enter")
        watched.page.locator("#search-results h2", has_text="Search Results").wait_for()
        found[question] = watched.page.locator("#search-results li a").first.get_attribute("href")
    assert {question: page for question, page in found.items() if not str(page).startswith(QUESTIONS[question])} == {}
    assert watched.errors == []
    assert [url for url in watched.requests if not url.startswith("file:")] == []
    watched.page.close()
