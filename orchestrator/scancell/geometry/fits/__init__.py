"""Fits of geometric elements to points: least squares and minimum zone, with covariance."""

from scancell.geometry.fits.fit import (
    Criterion,
    fit_circle,
    fit_cone,
    fit_cylinder,
    fit_line,
    fit_plane,
    fit_sphere,
)
from scancell.geometry.fits.results import CircleFit, ConeFit, CylinderFit, Fit, LineFit, PlaneFit, SphereFit

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
