"""Draws the FMU's icon, as SVG and as PNG: `python assets/make_icon.py` (needs Pillow)."""

from __future__ import annotations

from pathlib import Path

from PIL import Image, ImageDraw

SIZE = 256
_SMOOTHING = 8  # drawn so much larger, then reduced
ARM, JOINT, TABLE, PART, LASER, FRAME = "#e8862e", "#3a4654", "#7b8794", "#4f8fc0", "#e0344a", "#f3f6fa"

Point = tuple[float, float]
# Drawn in this order: thick lines with round ends (colour, width, points), polygons, discs (colour, centre, radius).
BOX = [(6.0, 6.0), (250.0, 6.0), (250.0, 250.0), (6.0, 250.0)]
POLYGONS: list[tuple[str, list[Point]]] = [
    (TABLE, [(134, 206), (236, 206), (236, 218), (134, 218)]),
    (TABLE, [(172, 218), (198, 218), (206, 240), (164, 240)]),
    (LASER, [(168, 120), (150, 206), (222, 206)]),
    (PART, [(158, 206), (158, 182), (172, 166), (190, 178), (206, 160), (214, 206)]),
    (JOINT, [(22, 240), (28, 212), (76, 212), (82, 240)]),
]
LINES: list[tuple[str, float, list[Point]]] = [(ARM, 24, [(52, 208), (64, 104), (138, 56), (166, 96)])]
DISCS: list[tuple[str, Point, float]] = [
    (JOINT, (52, 206), 15), (JOINT, (64, 104), 14), (JOINT, (138, 56), 12), (JOINT, (167, 106), 16),
]  # fmt: skip


def svg() -> str:
    """The picture as text."""

    def points(path: list[Point]) -> str:
        return " ".join(f"{x:g},{y:g}" for x, y in path)

    shapes = [f'<polygon fill="{FRAME}" stroke="{JOINT}" stroke-width="4" points="{points(BOX)}"/>']
    shapes += [f'<polygon fill="{colour}" points="{points(path)}"/>' for colour, path in POLYGONS]
    shapes += [
        f'<polyline fill="none" stroke="{colour}" stroke-width="{width:g}" stroke-linecap="round" '
        f'stroke-linejoin="round" points="{points(path)}"/>'
        for colour, width, path in LINES
    ]
    shapes += [f'<circle fill="{colour}" cx="{x:g}" cy="{y:g}" r="{r:g}"/>' for colour, (x, y), r in DISCS]
    return "\n".join([f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {SIZE} {SIZE}">', *shapes, "</svg>", ""])


def png(path: Path) -> None:
    """The picture in pixels."""
    image = Image.new("RGBA", (SIZE * _SMOOTHING,) * 2)
    draw = ImageDraw.Draw(image)

    def scaled(points: list[Point]) -> list[Point]:
        return [(x * _SMOOTHING, y * _SMOOTHING) for x, y in points]

    def disc(colour: str, centre: Point, radius: float) -> None:
        (x, y), r = scaled([centre])[0], radius * _SMOOTHING
        draw.ellipse((x - r, y - r, x + r, y + r), fill=colour)

    draw.polygon(scaled(BOX), fill=FRAME, outline=JOINT, width=4 * _SMOOTHING)
    for colour, points in POLYGONS:
        draw.polygon(scaled(points), fill=colour)
    for colour, width, points in LINES:
        draw.line(scaled(points), fill=colour, width=round(width * _SMOOTHING))
        for point in points:
            disc(colour, point, width / 2)
    for colour, centre, radius in DISCS:
        disc(colour, centre, radius)
    image.resize((SIZE, SIZE), Image.Resampling.LANCZOS).save(path, optimize=True)


def main() -> None:
    folder = Path(__file__).parent / "fmu"
    folder.mkdir(exist_ok=True)
    (folder / "icon.svg").write_text(svg())
    png(folder / "icon.png")


if __name__ == "__main__":
    main()
