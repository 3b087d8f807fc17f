// The part of the laser sheet that a camera sees.
#pragma once

#include <Eigen/Dense>

#include "sensor_rt/optics/camera.h"

namespace sensor_rt {

/// Corners (y, z) of the measuring field in the sheet: near -y, near +y, far +y, far -y; metres.
using Trapezoid = Eigen::Matrix<double, 4, 2>;

/// Dumitrache & Borangiu, Eq. 5, with the width corrected for the perspective of the tilted camera and for
/// images that are not square: z = b + a / tan(phi ± gamma), y = a (W/H) sin gamma / sin(phi ± gamma), where
/// tan gamma = H / (2 f). Holds for a centred principal point without distortion; for a camera with a tilted
/// sensor the image corners are projected onto the sheet. Throws std::invalid_argument when the field of view
/// is unbounded (phi <= gamma).
Trapezoid range_trapezoid(const Camera& camera);

/// Eq. 5 as printed, kept for comparison: y = a tan gamma / sin(phi ± gamma), for a square image and an
/// untilted sensor. Throws as range_trapezoid does.
Trapezoid range_trapezoid_as_printed(const Camera& camera);

}  // namespace sensor_rt
