// Lamps: external sources of light.
#pragma once

#include <Eigen/Dense>
#include <optional>

#include "sensor_rt/geometry/band.h"
#include "sensor_rt/geometry/incident_light.h"
#include "sensor_rt/geometry/rigid3.h"

namespace sensor_rt {

enum class LightKind { kPoint, kRectangle, kDisc };

/// A lamp. Point lights are isotropic; area lights lie in z = 0 of their own frame and emit towards +z with
/// Lambertian radiance. Lamps cast no shadows and are not visible themselves, not even in mirrors.
struct Light {
  LightKind kind = LightKind::kPoint;
  int body = 0;
  Rigid3 body_from_light;
  Eigen::Vector2d size =
      Eigen::Vector2d::Zero();  ///< edges of a rectangle; diameter of a disc, given twice; m
  double power = 0.0;           ///< W, over the whole spectrum
  /// Fraction of the power that the band-pass filter transmits, relative to the laser's; derived from
  /// `spectrum` when not given.
  std::optional<double> in_band;
  Band spectrum;
};

/// Returns the transmission of a lamp's power through a filter, relative to that of the laser.
double in_band_share(const Light& light, const Band& filter, double laser_wavelength);

/// A sample point of a lamp.
struct LightSample {
  Eigen::Vector3d position = Eigen::Vector3d::Zero();
  Eigen::Vector3d normal = Eigen::Vector3d::Zero();  ///< zero: isotropic
  double power = 0.0;                                ///< W

  /// Returns the radiant intensity (W/sr) in a unit direction away from the lamp.
  double intensity(const Eigen::Vector3d& direction) const;

  /// Returns the light at a point, over the whole spectrum; none at the sample itself.
  IncidentLight at(const Eigen::Vector3d& point) const;
};

constexpr int kLightSamples = 16;  ///< quadrature points of a part of an area light

/// Returns a uniformly distributed sample point, with the power of the entire lamp.
LightSample random_light_sample(const Light& light, const Rigid3& reference_from_light, double u, double v);

}  // namespace sensor_rt
