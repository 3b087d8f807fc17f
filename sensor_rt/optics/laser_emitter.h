// Light of the laser sheet; its equations are implemented only here.
#pragma once

#include <Eigen/Dense>
#include <cmath>

#include "sensor_rt/geometry/incident_light.h"
#include "sensor_rt/optics/laser_sheet.h"

namespace sensor_rt {

/// Emission of a laser sheet without shadows and speckle, as inline expressions that scalar code and
/// vectorised loops share.
///
/// (x, y, depth) is the vector from a source point: x across the sheet, y along its line, depth along z.
/// Power P is emitted within the fan angles ±a. At the distance r = |(y, depth)| it covers an arc of r per
/// radian, and a Gaussian of standard deviation sigma(depth) across the sheet, so that the irradiance of a
/// surface normal to the light is
///
///   E = P p(angle) / (2 a) / r * exp(-(x - centre)² / (2 sigma²)) / (sqrt(2 pi) sigma),
///
/// with the relative power p of LaserSheet.
struct LaserEmitter {
  explicit LaserEmitter(const LaserSheet& laser);

  LaserSheet sheet;
  double waist_depth;
  double sigma2;       ///< variance across the sheet at the waist, m²
  double divergence2;  ///< its growth per squared distance from the waist
  double tangent;      ///< of the fan's half angle
  double power_scale;  ///< P / (2 a sqrt(2 pi)), W/rad

  /// Returns the variance across the sheet, m².
  [[gnu::always_inline]] double variance(double depth) const {
    const double from_waist = depth - waist_depth;
    return sigma2 + divergence2 * from_waist * from_waist;
  }

  /// Returns the x of the sheet's centre.
  [[gnu::always_inline]] double centre(double y, double depth) const {
    const double ahead = depth > 1e-9 ? depth : 1e-9;
    return ahead * sheet.bend_at(y / (ahead * tangent));
  }

  /// Returns whether the fan contains a point.
  [[gnu::always_inline]] bool in_fan(double y, double depth) const { return std::abs(y) <= tangent * depth; }

  /// Returns the irradiance (W/m²) of a surface element at the centre of a sheet of even power. `facing`: dot
  /// product of its unit normal and the vector to the source, m.
  [[gnu::always_inline]] double peak_irradiance(double facing, double variance, double x, double y,
                                                double depth) const {
    const double in_fan2 = y * y + depth * depth;
    // The Gaussian's 1/sigma, the fan's 1/r and the cosine's 1/distance share one square root, whose argument
    // is kept positive.
    return power_scale * facing * (1.0 / std::sqrt(variance * in_fan2 * (in_fan2 + x * x) + 1e-200));
  }

  /// Returns the power per radian relative to an even sheet.
  double relative_power(double y, double depth) const {
    return sheet.is_even() ? 1.0 : sheet.relative_power(std::atan2(y, depth));
  }

  /// Returns the light at the end of a vector from a source point.
  IncidentLight at(const Eigen::Vector3d& from_source) const;

  /// Returns the direction, not normalised, of the light at the unit vector (y, z) of the fan and `slope` (x
  /// per distance) beside the centre of the sheet.
  Eigen::Vector3d direction(double y, double z, double slope) const {
    return {slope + z * sheet.bend_at(y / (z * tangent)), y, z};
  }
};

}  // namespace sensor_rt
