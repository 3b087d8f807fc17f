"""Public names: one list, all of them there and documented, and nothing deeper in docs and examples."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

import scancell

ROOT = Path(__file__).resolve().parents[2]
STUB = ROOT / "orchestrator" / "scancell" / "__init__.pyi"
USERS = [
    ROOT / "README.md",
    *sorted((ROOT / "docs").rglob("*.md")),
    *sorted((ROOT / "docs" / "examples").rglob("*.py")),
]
SCRIPT = ROOT / "tests" / "typing" / "user_script.py"
MARKDOWN = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")), *sorted((ROOT / "docs" / "fmu").glob("*.md"))]
FILE_ENDINGS = {"toml", "sif", "tar"}


def listed() -> set[str]:
    """Names that the stub gives to type checkers."""
    statements = ast.parse(STUB.read_text(encoding="utf-8")).body
    imported = {name.asname for one in statements if isinstance(one, ast.ImportFrom) for name in one.names}
    annotated = {
        one.target.id for one in statements if isinstance(one, ast.AnnAssign) and isinstance(one.target, ast.Name)
    }
    return {name for name in imported | annotated if name is not None}


def test_names_are_those_of_the_stub() -> None:
    assert set(scancell.__all__) == set(dir(scancell)) == listed() - {"__version__"}
    assert re.fullmatch(r"\d+\.\d+\.\d+", scancell.__version__)
    assert len(scancell.__all__) == len(set(scancell.__all__))
    with pytest.raises(AttributeError, match="orchestrate"):
        _ = scancell.orchestrate  # type: ignore[attr-defined]


def test_module_is_found_before_any_other_name() -> None:
    subprocess.run([sys.executable, "-c", "import scancell; scancell.pose.inverse"], check=True)


@pytest.mark.parametrize("module", ["scancell", "scancell.cli"])
def test_import_is_light(module: str) -> None:
    heavy = "('numpy', 'scipy', 'fmpy', 'cv2', 'pydantic', 'rich')"
    loaded = f"import sys, {module}; print([name for name in {heavy} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", loaded], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize("file", USERS, ids=lambda file: file.name)
def test_docs_and_examples_use_public_names_only(file: Path) -> None:
    text = file.read_text(encoding="utf-8")
    assert re.findall(r"^\s*(?:from|import) scancell\.\S+", text, re.MULTILINE) == []
    imported = re.findall(r"^\s*from scancell import (\([^)]*\)|[^\n]*)", text, re.MULTILINE)
    names = {name for group in imported for name in re.findall(r"\w+", group)}
    assert names <= set(scancell.__all__)


@pytest.mark.parametrize("file", MARKDOWN, ids=lambda file: file.name)
def test_names_in_docs_are_public(file: Path) -> None:
    """``NAME`` is a placeholder; commands of a shell are left out. Styles of Matplotlib are named as modules are."""
    styles = {path.stem for path in Path(scancell.__file__).parent.glob("*.mplstyle")}
    text = re.sub(r"^```(?:sh|console)$.*?^```$", "", file.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    names = set(re.findall(r"(?<![\w./-])scancell\.([A-Za-z_]\w*)", text))
    assert names <= {*scancell.__all__, "NAME", "__version__"} | FILE_ENDINGS | styles


def test_script_of_a_user_passes_the_type_checker_but_for_its_mistakes() -> None:
    command = [sys.executable, "-m", "mypy", "--strict", "--config-file=", "--no-error-summary", str(SCRIPT)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    found = {int(number) for number in re.findall(r"user_script\.py:(\d+): error", done.stdout)}
    lines = SCRIPT.read_text(encoding="utf-8").splitlines()
    assert found == {number for number, line in enumerate(lines, start=1) if "# error:" in line}, done.stdout
    assert len(lines) >= 95
