"""Fits of geometric elements to points: least squares and minimum zone, with covariance."""

from scancell.geometry.fits.fit import (
    CircleFit,
    ConeFit,
    Criterion,
    CylinderFit,
    Fit,
    LineFit,
    PlaneFit,
    SphereFit,
    fit_circle,
    fit_cone,
    fit_cylinder,
    fit_line,
    fit_plane,
    fit_sphere,
)

__all__ = [
    "CircleFit",
    "ConeFit",
    "Criterion",
    "CylinderFit",
    "Fit",
    "LineFit",
    "PlaneFit",
    "SphereFit",
    "fit_circle",
    "fit_cone",
    "fit_cylinder",
    "fit_line",
    "fit_plane",
    "fit_sphere",
]
