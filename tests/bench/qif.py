"""Validate QIF documents against the schemas of QIF 3.0: ``PYTHONPATH=tests python -m bench.qif FOLDER FILE...``.

FOLDER is a checkout of https://github.com/QualityInformationFramework/qif-community (Boost Software License 1.0), whose
bindings hold the schemas.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from lxml import etree

_APPLICATIONS = {
    *("QIFDocument", "QIFPlan", "QIFProduct", "QIFResults", "QIFRules", "QIFStatistics", "QIFMeasurementResources")
}


def load_schema(folder: Path) -> etree.XMLSchema:
    """The schemas as published, which one of the bindings holds under other names."""
    with TemporaryDirectory() as name:
        arranged = Path(name)
        for kind in ("QIFApplications", "QIFLibrary"):
            (arranged / kind).mkdir()
        for file in (folder / "bindings/CPP-Kramer/schema").glob("*.xsdOrig"):
            kind = "QIFApplications" if file.stem in _APPLICATIONS else "QIFLibrary"
            (arranged / kind / f"{file.stem}.xsd").write_bytes(file.read_bytes())
        # The signature of XML documents, in the namespace of QIF; the published schema fetches it.
        for file in (folder / "bindings/Python").glob("*/*.xsd"):
            (arranged / file.parent.name / file.name).write_bytes(file.read_bytes())
        return etree.XMLSchema(etree.parse(arranged / "QIFApplications/QIFDocument.xsd"))


def faults(schema: etree.XMLSchema, file: Path) -> list[str]:
    """What a document violates, with its lines."""
    schema.validate(etree.parse(file))
    return [f"{file}:{one.line}: {one.message}" for one in schema.error_log]


def main() -> None:
    """Print the faults of all files."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="checkout of qif-community")
    parser.add_argument("files", type=Path, nargs="+", help="QIF documents")
    options = parser.parse_args()
    schema = load_schema(options.folder)
    found = [fault for file in options.files for fault in faults(schema, file)]
    print("\n".join(found) or f"{len(options.files)} valid")
    sys.exit(bool(found))


if __name__ == "__main__":
    main()
