"""`scancell acceptance`: known deviations show up in the right figures; the report is complete and offline."""

from __future__ import annotations

import csv
import html
import json
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import scancell_here

from chromium import Watched, chromium
from scancell.config.loading import Setup, assets_dir, load_setup
from scancell.errors import DescriptionError
from scancell.geometry.fits import PlaneFit
from scancell.progress import NullProgress
from scancell.scanner import Scanner
from scancell.studies.acceptance import measure
from scancell.studies.acceptance.measure import ALL_ROUND, Programme
from scancell.studies.acceptance.report import AcceptanceReport, AcceptanceRequest, _decision, limits_of, run_acceptance

SENSOR = assets_dir() / "sensors" / "medium_range_50.toml"
STRAIGHT = "sensor.laser.straightness_mrad=[]"
BALLS = {"probing form", "probing size", "sphere spacing", "D95 %"}
# Artefacts of a report, and the names of their figures.
REPORTS = {
    "balls": (("sphere", "ball_bar"), BALLS),
    "all": (measure.QUICK.artefacts, BALLS | {"flatness", "step height", "form"}),
}
SMALL = Programme(("plane",), ("middle",), repeats=1, profiles=60, points=4000, exposures=2, steps=5)


def report_of(
    programme: Programme, as_built: Sequence[str] = (), setup: Setup | None = None, factors: Path | None = None
) -> AcceptanceReport:
    setup = setup or load_setup(sensor=SENSOR, settings=[STRAIGHT])
    request = AcceptanceRequest(programme, as_built=tuple(as_built), factors=factors)
    with Scanner(setup=setup) as scanner:
        return run_acceptance(scanner, request, NullProgress())


def mean(report: AcceptanceReport, name: str, position: str, mode: str = "dynamic") -> float:
    """Largest mean, by amount, over faces."""
    rows = [row for row in report.rows if (row["name"], row["position"], row["mode"]) == (name, position, mode)]
    return float(max((row["mean"] for row in rows), key=abs))


def test_turned_sheet_shows_in_bias_over_range_and_step_height() -> None:
    """A sheet turned by alpha about its source s leaves its plane by alpha (z - s): heights err by z/a times that."""
    alpha, baseline, source = np.radians(0.05), 55.0, -61.25
    steps = Programme(("step",), ("middle",), repeats=1, profiles=60, points=8000, exposures=2, steps=5)
    good, bad = report_of(steps), report_of(steps, ["sensor.laser.turn_y_deg=0.05"])
    over_range = bad.figures["sweeps"][0]
    assert over_range["name"] == "range"
    for row in over_range["rows"]:
        expected = 1e3 * alpha * (row["value"] - source) * row["value"] / baseline
        assert abs(row["bias_um"]) == pytest.approx(expected, rel=0.03)
    assert bad.sweeps.linearity.of_mean > 10 * good.sweeps.linearity.of_mean
    near = next(row["standoff_mm"] for row in bad.rows)
    step = 5.0 * bad.scale  # of the two highest levels, which one pass sees
    expected = 1e3 * step * alpha * (2 * near + step - source) / baseline
    for mode in ("dynamic", "stop-and-look"):
        assert abs(height_of_two_highest(good, mode)) < 3.0
        assert abs(height_of_two_highest(bad, mode)) == pytest.approx(expected, rel=0.1)


def height_of_two_highest(report: AcceptanceReport, mode: str) -> float:
    levels = "step5:+z - step10:+z"
    return float(next(row["mean"] for row in report.rows if (row["of"], row["mode"]) == (levels, mode)))


def test_tilted_table_shows_in_position_and_not_in_flatness() -> None:
    """A plane on a table tilted by 0.1 deg stays flat; it is found tilted, and D95 % counts that."""
    good, bad = report_of(SMALL), report_of(SMALL, ["table.ry_deg=0.1"])
    flat = "flatness, 95 % of the points"
    assert mean(bad, flat, "middle") == pytest.approx(mean(good, flat, "middle"), rel=0.1)
    fit = bad.pictured["plane"].faces[0].fit
    assert isinstance(fit, PlaneFit)
    assert np.degrees(np.arccos(fit.normal[2])) == pytest.approx(0.1, rel=0.02)
    assert mean(bad, "D95 %", "middle") > 5 * mean(good, "D95 %", "middle")


def test_tilted_axis_shows_in_the_size_of_a_sphere_from_all_sides() -> None:
    """The tilt moves the ball towards the sensor, whatever the angle of the table: it seems larger or smaller.

    Sweeps from 30 and 60 deg above the horizontal see their cosine of the displacement, passes from above none of it.
    """
    ball = Programme(("sphere",), ("middle",), repeats=1, profiles=60, points=4000, exposures=2, steps=3)
    good, bad = report_of(ball), report_of(ball, ["table.rx_deg=0.1"])
    moved = 1e3 * 60.0 * bad.scale * np.tan(np.radians(0.1))
    assert abs(mean(good, "probing size", ALL_ROUND)) < 5.0
    assert abs(mean(bad, "probing size", "middle")) < 5.0
    assert 0.3 * 2 * moved < abs(mean(bad, "probing size", ALL_ROUND)) < 2 * moved


def test_latency_shows_in_motion_and_not_at_rest() -> None:
    """At 50 mm/s, 2 ms between exposure and latched joints move the cloud by 0.1 mm: seen on the slopes of a ball."""
    ball = Programme(("sphere",), ("middle",), repeats=1, profiles=60, points=4000, exposures=2, steps=3)
    late = report_of(ball, ["trigger.latency_ms=2.0"])
    moving, still = (mean(late, "max - min", "middle", mode) for mode in ("dynamic", "stop-and-look"))
    assert moving > 3 * still


def test_positions_out_of_reach_are_named() -> None:
    """The far end of the longest range lies beyond the arm; what can be measured is."""
    setup = load_setup(sensor=assets_dir() / "sensors" / "long_range_400.toml")
    programme = Programme(("plane",), ("near", "far"), repeats=1, profiles=30, points=2000, exposures=1, steps=3)
    report = report_of(programme, setup=setup)
    assert {row["position"] for row in report.rows} == {"near"}
    assert any(text.startswith("plane, far, dynamic:") for text in report.warnings)


@pytest.fixture(scope="module", params=REPORTS)
def kind(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture(scope="module")
def report(kind: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of the report of the quick programme with fewer profiles and points."""
    folder = tmp_path_factory.mktemp("acceptance")
    quick = replace(measure.QUICK, artefacts=REPORTS[kind][0], profiles=30, points=2000, exposures=2)
    limits = ("--limit", "probing size=1000", "--limit", "sphere spacing=1e-6", "--limit", "diameter=5")
    words = ("--quick", "--repeats", "1", *limits, "--out", "report", "--json")
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(measure, "QUICK", quick)
        done = scancell_here("acceptance", SENSOR, *words, cwd=folder)
    assert done.code == 0, done.err
    assert done.last_line["files"][0] == "report/acceptance.json"
    return folder / "report"


def test_json_and_csv_hold_all_stations(kind: str, report: Path) -> None:
    artefacts, figures = REPORTS[kind]
    found = json.loads((report / "acceptance.json").read_text())
    stations = {(row["artefact"], row["position"], row["mode"]) for row in found["figures"]}
    # With so few profiles the points of the balls, which turn off the axis, do not determine them.
    undetermined = [text for text in found["not_measured"] if text.startswith("ball_bar, all round")]
    assert list(found["not_measured"]) == undetermined
    assert not {row["of"] for row in found["figures"] if row["position"] == ALL_ROUND} & {"ball1", "ball1 - ball2"}
    for artefact in artefacts:
        for mode in ("dynamic", "stop-and-look"):
            assert {(artefact, "near", mode), (artefact, "far", mode)} <= stations
    assert ("sphere", ALL_ROUND, "dynamic") in stations
    names = {row["name"] for row in found["figures"]}
    assert figures <= names
    assert {"max - min", "outlier rate", "missing-point rate"} <= names
    assert all(row["repeats"] == 1 and len(row["errors"]) == 1 for row in found["figures"])
    assert [one["name"] for one in found["sweeps"]] == [
        *("range", "in-plane angle", "out-of-plane angle", "reflectance", "speed")
    ]
    with (report / "acceptance.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == len(found["figures"])
    assert float(rows[0]["mean"]) == pytest.approx(found["figures"][0]["mean"], abs=1e-6)


def test_drawn_factors_take_part_in_the_contributions() -> None:
    """A displaced tool moves the artefact: bias comes from it, form does not."""
    study = assets_dir() / "studies" / "tool_misalignment.toml"
    found = report_of(replace(SMALL, positions=("near", "far"), repeats=4), factors=study).figures
    bias = next(one for one in found["contributions"] if (one["artefact"], one["name"]) == ("plane", "bias"))
    shares = {row["factor"]: row["share"] for row in bias["budget"]}
    assert sum(share for factor, share in shares.items() if "tool" in factor) > 0.5
    assert sum(shares.values()) == pytest.approx(1.0)


def test_report_opens_with_the_limits(kind: str, report: Path) -> None:
    """A limit is met where no mean error of its figure exceeds it; what no artefact gives is not measured."""
    held, page = json.loads((report / "acceptance.json").read_text()), (report / "acceptance.html").read_text()
    size, spacing, diameter = held["limits"]
    assert size["met"] and size["clear"]
    assert spacing["met"] is False
    for found in (size, spacing):
        means = [abs(row["mean"]) for row in held["figures"] if row["name"] == found["name"]]
        assert abs(found["largest"]) == max(means)
        assert found["met"] == (max(means) <= found["limit"])
    measured = any(row["name"] == "diameter" for row in held["figures"])
    assert (diameter["met"] is None) == (not measured)
    first = page.split("<h2>")[0]
    answer = re.search(r'<p class="answer">(.*?)</p>', first)[1]
    assert "not met: sphere spacing" in answer
    assert ("not measured: diameter" in answer) == (not measured)
    assert all(reason in html.unescape(first) for reason in held["not_measured"])


@pytest.mark.parametrize("words", [["size=5"], ["probing size=0"], ["probing size=x"], ["bias=1", "bias=2"], ["bias"]])
def test_wrong_limits_are_refused(words: list[str]) -> None:
    with pytest.raises(DescriptionError, match="limit"):
        limits_of(words)


def test_limit_within_the_interval_is_not_clear() -> None:
    row = {"name": "bias", "artefact": "plane", "of": "top", "position": "near", "mode": "dynamic", "unit": "um"}
    rows = [{**row, "mean": -4.0, "interval_symmetric": [-5.0, -3.0]}, {**row, "mean": 1.0, "interval_symmetric": None}]
    for limit, met, clear in ((4.5, True, False), (3.5, False, False), (6.0, True, True), (2.0, False, True)):
        found = _decision("bias", limit, rows)
        assert (found["met"], found["clear"], found["largest"]) == (met, clear, -4.0)
    assert _decision("flatness", 1.0, rows)["met"] is None


def test_page_needs_no_network(kind: str, report: Path) -> None:
    number = len(REPORTS[kind][0])
    text = (report / "acceptance.html").read_text()
    without_names = re.sub(r"xmlns(:\w+)?=\"[^\"]*\"|<!DOCTYPE[^>]*>|<rdf:RDF.*?</rdf:RDF>", "", text, flags=re.DOTALL)
    assert "http://" not in without_names
    assert "https://" not in without_names
    with chromium() as browser:
        watched = Watched(browser, 1200, 900)
        watched.page.context.set_offline(True)
        watched.page.goto((report / "acceptance.html").as_uri())
        assert watched.page.locator("h2").count() >= 5 + number
        assert watched.page.locator("svg").count() >= 10
        pictures = watched.page.evaluate("[...document.images].map(image => image.naturalWidth)")
        assert len(pictures) == number
        assert min(pictures) > 100
        assert watched.page.evaluate("document.documentElement.scrollWidth") <= 1200
        assert watched.errors == []
        assert all(url.startswith(("file:", "data:")) for url in watched.requests)


def test_wrong_sensor_leaves_no_report(tmp_path: Path) -> None:
    done = scancell_here("acceptance", "missing.toml", "--quick", "--out", "report", "--json", cwd=tmp_path)
    assert done.code == 1
    assert "missing.toml" in done.message
    assert not (tmp_path / "report").exists()
