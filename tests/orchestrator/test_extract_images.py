"""From image files of a sensor to profiles."""

from __future__ import annotations

import csv
import json

import cv2
import numpy as np
import pytest

from scancell import sensor as sensor_rt
from scancell.cli import app
from scancell.config.loading import assets_dir, load_setup
from scancell.config.sensor import DetectorDescription
from scancell.errors import ImageError
from scancell.output.extract_images import extract
from scancell.output.image_files import ImageSet
from scancell.reconstruction.cloud_files import read_ply

HEIGHT, WIDTH = 1024, 1280


def stripe_image(row, peak=150.0, black=4.0):
    """8-bit image of a level Gaussian stripe, sigma 1.4 px."""
    profile = black + peak * np.exp(-0.5 * ((np.arange(HEIGHT) - row) / 1.4) ** 2)
    return np.repeat(profile.round().astype(np.uint8)[:, None], WIDTH, axis=1)


def write_pair(folder, name, row, suffix=".png", **shape):
    for camera in ("plus", "minus"):
        assert cv2.imwrite(str(folder / f"{name}_{camera}{suffix}"), stripe_image(row, **shape))


def run(images, out, *overrides, peaks=False, laser_off=()):
    setup = load_setup(settings=overrides)
    return extract(images, out, sensor=setup.sensor, laser_off=laser_off, peaks=peaks, threads=1)


def table(path):
    with path.open() as stream:
        return list(csv.DictReader(stream))


@pytest.mark.parametrize("suffix", [".png", ".tif", ".bmp"])
def test_points_lie_where_the_rays_of_the_stripe_meet_the_sheet(tmp_path, suffix):
    """Closed form for a level stripe: z = a (f cos φ + p sin φ) / (f sin φ - p cos φ)."""
    write_pair(tmp_path, "flat", 400.3, suffix)
    report = run([tmp_path], tmp_path / "out")
    rows = table(tmp_path / "out" / "profiles.csv")
    assert report.figures["exposures"] == 1
    assert report.figures["by_camera"] == [len(rows) // 2] * 2
    assert len(rows) > 2500
    tilt, focal, p = np.radians(29.3), HEIGHT / (2 * np.tan(np.radians(9.34))), 400.3 - (HEIGHT - 1) / 2
    z = 60.0 * (focal * np.cos(tilt) + p * np.sin(tilt)) / (focal * np.sin(tilt) - p * np.cos(tilt))
    assert np.abs(np.array([float(row["z_mm"]) for row in rows]) - z).max() < 0.002
    cloud = read_ply(tmp_path / "out" / "profiles.ply")
    assert len(cloud) == len(rows)
    np.testing.assert_allclose(cloud.points_in_part[:, 1] * 1e3, [float(row["y_mm"]) for row in rows], atol=1e-6)
    assert np.abs(cloud.points_in_part[:, 0]).max() == 0.0


def test_described_sheet_gives_points_on_it(tmp_path):
    """A sheet turned about Y through the source: x = z tan(angle), by either camera."""
    write_pair(tmp_path, "flat", 400.3)
    described = ("sensor.laser.turn_y_deg=0.3", "sensor.extraction.triangulation=sheet")
    run([tmp_path], tmp_path / "out", *described)
    rows = table(tmp_path / "out" / "profiles.csv")
    x, z, camera = (np.array([float(row[key]) for row in rows]) for key in ("x_mm", "z_mm", "camera"))
    np.testing.assert_allclose(x, z * np.tan(np.radians(0.3)), rtol=0, atol=1e-5)
    assert z[camera == 1].mean() - z[camera == 0].mean() > 1.0  # equal rows are different ranges now
    cloud = read_ply(tmp_path / "out" / "profiles.ply")
    np.testing.assert_allclose(cloud.points_in_part[:, 0] * 1e3, x, atol=1e-5)


def test_exposures_come_in_natural_order_and_know_their_names(tmp_path):
    for number in (2, 10, 1):
        write_pair(tmp_path, f"scan_{number}", 300.0 + 10 * number)
    run([tmp_path], tmp_path / "out")
    rows = table(tmp_path / "out" / "profiles.csv")
    names = dict.fromkeys((int(row["exposure"]), row["name"]) for row in rows)
    assert list(names) == [(0, "scan_1"), (1, "scan_2"), (2, "scan_10")]
    heights = [float(next(row["row_px"] for row in rows if int(row["exposure"]) == k)) for k in range(3)]
    np.testing.assert_allclose(heights, [310.0, 320.0, 400.0], atol=0.01)


def test_every_peak_on_request(tmp_path):
    for camera in ("plus", "minus"):
        both = np.maximum(stripe_image(300.0), stripe_image(500.0, peak=60.0))
        cv2.imwrite(str(tmp_path / f"{camera}.png"), both)
    report = run([tmp_path / "plus.png", tmp_path / "minus.png"], tmp_path / "out", peaks=True)
    rows = table(tmp_path / "out" / "peaks.csv")
    assert len(rows) == 4 * WIDTH == report.figures["peaks"]
    passed_over = [row for row in rows if "passed_over" in row["flags"]]
    assert {round(float(row["row_px"])) for row in passed_over} == {500}
    assert len(table(tmp_path / "out" / "profiles.csv")) <= 2 * WIDTH


def test_fusion_follows_the_sensor_description(tmp_path):
    write_pair(tmp_path, "flat", 400.3)
    both = run([tmp_path], tmp_path / "apart")
    fused = run([tmp_path], tmp_path / "fused", 'sensor.extraction.fusion="weighted"')
    assert fused.figures["points"] < 0.52 * both.figures["points"]


def test_images_without_a_stripe_give_a_warning(tmp_path):
    write_pair(tmp_path, "a", 400.0)
    write_pair(tmp_path, "b", 400.0, peak=0.0)
    assert run([tmp_path], tmp_path / "out").warnings == ["1 of 2 exposures give no point"]
    dark = [tmp_path / f"b_{camera}.png" for camera in ("plus", "minus")]
    assert run(dark, tmp_path / "dark").warnings == ["no stripe was found in any image"]


def test_twelve_bit_images_and_greys_stored_as_colours(tmp_path):
    deep = stripe_image(400.3).astype(np.uint16) * 16
    cv2.imwrite(str(tmp_path / "plus.tif"), deep)
    cv2.imwrite(str(tmp_path / "minus.tif"), deep)
    overrides = [
        "sensor.detector.bit_depth=12",
        "sensor.detector.gain_dn_per_e=0.36",
        "sensor.detector.black_level_dn=64",
    ]
    assert run([tmp_path], tmp_path / "deep", *overrides).figures["points"] > 2500
    grey = cv2.cvtColor(stripe_image(400.3), cv2.COLOR_GRAY2BGR)
    files = [tmp_path / "plus.bmp", tmp_path / "minus.bmp"]
    for file in files:
        cv2.imwrite(str(file), grey)
    assert run(files, tmp_path / "colour").figures["points"] > 2500


@pytest.mark.parametrize(("wavelength", "channel"), [(450.0, 0), (520.0, 1), (660.0, 2), (850.0, 2)])
def test_channel_of_the_laser_is_taken_of_colours(tmp_path, wavelength, channel):
    colour = np.stack([stripe_image(row) for row in (200.0, 500.0, 800.0)], axis=-1)
    for camera in ("plus", "minus"):
        cv2.imwrite(str(tmp_path / f"{camera}.png"), colour)
    report = run([tmp_path], tmp_path / "out", f"sensor.laser.wavelength_nm={wavelength}")
    rows = [float(row["row_px"]) for row in table(tmp_path / "out" / "profiles.csv")]
    np.testing.assert_allclose(rows, (200.0, 500.0, 800.0)[channel], atol=0.02)
    assert ("blue", "green", "red")[channel] in "".join(report.lines)


def test_images_of_all_formats_in_a_folder_are_read_and_pages_are_refused(tmp_path):
    for name, suffix in (("a", ".png"), ("b", ".jpg"), ("c", ".tif"), ("d", ".jpeg"), ("e", ".pgm")):
        write_pair(tmp_path, name, 400.3, suffix)
    assert run([tmp_path], tmp_path / "out").figures["exposures"] == 5
    pages = tmp_path / "pages_plus.tif"
    cv2.imwritemulti(str(pages), [stripe_image(400.0)] * 3)
    write_pair(tmp_path, "pages", 400.0)
    (tmp_path / "pages_plus.png").unlink()
    with pytest.raises(ImageError, match=r"pages_plus\.tif: holds 3 images"):
        run([tmp_path], tmp_path / "more")


def test_images_beyond_full_scale_name_the_gain_that_reads_them(tmp_path):
    deep = stripe_image(400.3).astype(np.uint16) * 16
    for camera in ("plus", "minus"):
        cv2.imwrite(str(tmp_path / f"{camera}.png"), deep)
    with pytest.raises(ImageError, match="gain_dn_per_e of this camera") as caught:
        run([tmp_path], tmp_path / "out", "sensor.detector.bit_depth=12")
    gain = str(caught.value).partition("camera, ")[2].split()[0]
    more = ("sensor.detector.bit_depth=12", f"sensor.detector.gain_dn_per_e={gain}")
    assert run([tmp_path], tmp_path / "out", *more).figures["points"] > 2500


@pytest.mark.parametrize("bits", [8, 10, 12, 16])
def test_bit_depth_sets_full_scale_without_a_gain(bits):
    words = load_setup().sensor.detector.model_dump(exclude={"gain_dn_per_e"}) | {"bit_depth": bits}
    made = DetectorDescription.model_validate(words)
    assert made.black_level_dn + made.full_well_e * made.gain_dn_per_e == pytest.approx(2**bits - 1)


def test_rejected_columns_are_counted_with_the_key_that_accepts_them(tmp_path):
    """A wide stripe is found in all columns; the proposed limit gives its points."""
    write_pair(tmp_path, "a", 400.3)
    strict = "sensor.extraction.max_sigma_px=1"
    report = run([tmp_path], tmp_path / "out", strict)
    (warning,) = report.warnings
    assert "2560 of 2560 columns" in warning
    assert "2560 wide (sensor.extraction.max_sigma_px = 1; " in warning
    proposed = warning.partition("max_sigma_px = 1; ")[2].split()[0]
    accepted = run([tmp_path], tmp_path / "more", f"sensor.extraction.max_sigma_px={proposed}")
    assert accepted.figures["points"] > 0.9 * 2560
    some = stripe_image(400.3)
    some[:, 600:700] = cv2.GaussianBlur(some, (1, 41), 12)[:, 600:700]
    cv2.imwrite(str(tmp_path / "a_plus.png"), some)
    partial = run([tmp_path], tmp_path / "some")
    assert "columns with a peak give no point" in partial.lines[1]
    assert "sensor.extraction." in partial.lines[1]


def wrong_cases():
    image = stripe_image(400.0)
    return [
        ({"a_plus.png": image}, "no image of camera 'minus'"),
        ({"a_plus.png": image, "a_minus.png": image[:100]}, "a_minus.png: is 1280 x 100 pixels, camera 'minus' has"),
        ({"a_plus.png": image, "a_minus.png": image.astype(np.uint16) * 16}, r"holds the value 2\d+, but detector"),
        ({"a_plus.png": image, "b.png": image}, "b.png: names no camera; expected one of the words plus, minus"),
        ({"a_plus_minus.png": image}, "names several cameras"),
        ({"a_plus.png": image, "a_plus.tif": image}, "is .*a_plus.* already"),
        ({}, "holds no image"),
    ]


@pytest.mark.parametrize(("files", "message"), wrong_cases(), ids=lambda value: value if isinstance(value, str) else "")
def test_wrong_files_are_refused_by_name(tmp_path, files, message):
    folder = tmp_path / "images"
    folder.mkdir()
    for name, image in files.items():
        cv2.imwrite(str(folder / name), image)
    with pytest.raises(ImageError, match=message):
        run([folder], tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_files_that_are_no_images_are_refused(tmp_path):
    write_pair(tmp_path, "a", 400.0)
    (tmp_path / "a_minus.png").write_text("not an image")
    with pytest.raises(ImageError, match=r"a_minus.png: cannot be read as an image"):
        run([tmp_path], tmp_path / "out")
    with pytest.raises(ImageError, match=r"nowhere\.png: no such file"):
        run([tmp_path / "nowhere.png"], tmp_path / "out")


def test_one_camera_needs_no_word_and_camera_names_are_whole_words(tmp_path):
    paths = [tmp_path / name for name in ("plus_1.png", "surplus.png")]
    for path in paths:
        path.touch()
    assert ImageSet.from_files(paths, ["only"]).names == ("plus_1", "surplus")
    with pytest.raises(ImageError, match=r"surplus\.png: names no camera"):
        ImageSet.from_files(paths, ["plus", "minus"])


def write_index(folder, *rows, header="exposure,camera,laser,file"):
    (folder / "frames.csv").write_text("\n".join([header, *rows]) + "\n")


def test_only_indexed_frames_of_a_folder_are_used(tmp_path):
    write_pair(tmp_path, "raw_1", 400.3)
    write_pair(tmp_path, "raw_2", 420.3)
    write_pair(tmp_path, "mask_1", 10.0)
    write_pair(tmp_path, "dark_1", 500.0)
    for name in ("profile_1.png", "plus_minus.tif"):
        cv2.imwrite(str(tmp_path / name), stripe_image(200.0)[:50])
    lit = [f"shot {n},{camera},on,raw_{n}_{camera}.png" for n in (2, 1) for camera in ("minus", "plus")]
    write_index(tmp_path, *lit, *(f"shot 1,{camera},off,dark_1_{camera}.png" for camera in ("plus", "minus")))
    report = run([tmp_path], tmp_path / "out")
    rows = table(tmp_path / "out" / "profiles.csv")
    assert {(row["name"], round(float(row["row_px"]))) for row in rows} == {("shot 1", 400), ("shot 2", 420)}
    aside = ["dark_1_minus.png", "dark_1_plus.png", "mask_1_minus.png", "mask_1_plus.png", "plus_minus.tif"]
    assert report.figures["ignored_files"] == [str(tmp_path / name) for name in [*aside, "profile_1.png"]]
    assert "ignored 6 files that frames.csv does not list with the laser on: dark_1_minus.png" in report.lines[1]
    dark = ImageSet.from_files([tmp_path], ["plus", "minus"], "off")
    assert (dark.names, [file.name for file in dark.files[0]]) == (("shot 1",), ["dark_1_plus.png", "dark_1_minus.png"])


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ([], "lists no image with the laser on"),
        (["a,plus,off,a_plus.png"], "lists no image with the laser on"),
        (["a,plus,on,a_plus.png"], "no image of camera 'minus'"),
        (["a,left,on,a_plus.png"], r"frames\.csv: camera 'left' is not one of the sensor's \(plus, minus\)"),
        (["a,plus,on,b_plus.png"], r"frames\.csv: lists b_plus\.png: no such file"),
        (["a,plus,lit,a_plus.png"], r"line 2: laser = 'lit': expected on or off"),
        (["a,plus,on,a_plus.png", "a,minus,on"], r"line 3: has no file; expected the columns exposure, camera"),
    ],
)
def test_wrong_indices_are_refused(tmp_path, rows, message):
    write_pair(tmp_path, "a", 400.0)
    write_index(tmp_path, *rows)
    with pytest.raises(ImageError, match=message):
        run([tmp_path], tmp_path / "out")


def test_an_index_that_is_no_text_is_refused(tmp_path):
    (tmp_path / "frames.csv").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ImageError, match=r"frames\.csv: cannot be read"):
        run([tmp_path], tmp_path / "out")


def test_command_prints_json(tmp_path, capsys):
    write_pair(tmp_path, "flat", 400.3)
    sensor = assets_dir() / "sensors" / "two_camera_probe.toml"
    words = ["extract", str(tmp_path), "--sensor", str(sensor), "--out", str(tmp_path / "out"), "--json"]
    app(words, standalone_mode=False)
    answer = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert answer["ok"]
    assert sorted(answer["files"]) == [str(tmp_path / "out" / name) for name in ("profiles.csv", "profiles.ply")]
    assert answer["figures"]["points"] > 2500
    assert set(answer["figures"]["peaks_by_flag"]) == set(sensor_rt.PEAK_FLAGS)


def test_laser_off_images_are_subtracted(tmp_path):
    """A second, brighter stripe that stays when the laser is off: gone, and the right one is found."""
    lit, background = tmp_path / "lit", tmp_path / "background"
    for folder in (lit, background):
        folder.mkdir()
    for camera in ("plus", "minus"):
        strange = stripe_image(700.0, 180.0).astype(int) - 4
        assert cv2.imwrite(str(lit / f"a_{camera}.png"), (stripe_image(400.3, 60.0) + strange).astype(np.uint8))
        assert cv2.imwrite(str(background / f"a_{camera}.png"), (strange + 4).astype(np.uint8))
    run([lit], tmp_path / "wrong")
    run([lit], tmp_path / "right", laser_off=[background])
    wrong, right = (
        np.array([float(r["row_px"]) for r in table(tmp_path / n / "profiles.csv")]) for n in ("wrong", "right")
    )
    assert np.abs(wrong - 700.0).max() < 0.02
    assert len(right) > 2500
    assert np.abs(right - 400.3).max() < 0.02
    (background / "a_plus.png").rename(background / "b_plus.png")
    (background / "a_minus.png").rename(background / "b_minus.png")
    with pytest.raises(ImageError, match="exposure 'a' has no image of that name with the laser off"):
        run([lit], tmp_path / "none", laser_off=[background])
