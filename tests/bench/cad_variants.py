"""Sample parts of `assets/cad_parts.py` with a planted deviation, as STEP files.

``PYTHONPATH=tests python -m bench.cad_variants drilled_block 0.03 out/block_off.step`` moves a bore of the block by
30 µm. Needs Open CASCADE (extra ``cad``).
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ASSETS = Path(__file__).parents[2] / "assets"
DEVIATIONS = {
    "drilled_block": 0.03,  # mm along x: bore_b
    "turned_part": 0.02,  # mm along x: axis of journal_b
    "bracket": 0.02,  # degrees about y: wall
    "free_form_cover": 0.05,  # mm: height of a bump on the skin
    "lobed_ring": 0.01,  # mm from valley to peak of three lobes of the bore
}

_WRITE = """
import sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
import cad_parts
cad_parts.write_step(cad_parts.PARTS[sys.argv[2]](float(sys.argv[3])), Path(sys.argv[4]))
"""


def write_variant(name: str, deviation: float, file: Path) -> Path:
    """Write the sample part of a name with a deviation (mm, degrees for ``bracket``), and return its file.

    The kernel runs in a process of its own. Raises `subprocess.CalledProcessError` with its message.
    """
    words = [sys.executable, "-c", _WRITE, str(ASSETS), name, str(deviation), str(file)]
    subprocess.run(words, check=True, capture_output=True, text=True)
    return file


def main() -> None:
    """Write the variant that the command line names."""
    name, deviation, file = sys.argv[1:]
    Path(file).parent.mkdir(parents=True, exist_ok=True)
    print(write_variant(name, float(deviation), Path(file)))


if __name__ == "__main__":
    main()
