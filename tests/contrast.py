"""Contrast of colours."""

from __future__ import annotations

import re

Rgb = tuple[float, float, float]


def rgb(colour: str) -> Rgb:
    """Values, 0 to 255, of ``#rrggbb`` or ``rgb(r, g, b)``."""
    if colour.startswith("#"):
        return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)
    red, green, blue, *_ = (float(value) for value in re.findall(r"[\d.]+", colour))
    return red, green, blue


def contrast(first: Rgb, second: Rgb) -> float:
    """Contrast ratio, 1 to 21, of WCAG 2.2."""
    high, low = sorted((_luminance(first), _luminance(second)), reverse=True)
    return (high + 0.05) / (low + 0.05)


def _luminance(colour: Rgb) -> float:
    linear = [v / 12.92 if v <= 0.04045 else ((v + 0.055) / 1.055) ** 2.4 for v in (one / 255 for one in colour)]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]
