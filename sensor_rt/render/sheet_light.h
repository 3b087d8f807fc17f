// Irradiance of the laser sheet at the hits of camera rays.
#pragma once

#include <array>

#include "sensor_rt/optics/laser_sheet.h"
#include "sensor_rt/tracing/packet.h"

namespace sensor_rt {

/// Evaluates the irradiance of the sheet with constants prepared for vectorised loops.
class SheetLight {
 public:
  explicit SheetLight(const LaserSheet& laser);

  /// Computes for each hit of rays from `viewpoint` the vector from the laser source to the point (reference
  /// frame) and the irradiance there; the irradiance is 0 outside the sheet, on surfaces that do not face
  /// both source and viewpoint, and without a hit (whose normal is 0). lit[lane] is -1 where it is not 0.
  /// Shadows are left to the caller.
  void light(const double* viewpoint, const Lanes3& direction, const PacketHits& hits, Lanes3& from_source,
             double* irradiance, int* lit) const;

  /// Computes the same for individual viewpoints and source points, and for sheets of any shape.
  void light(const Lanes3& viewpoint, const Lanes3& source, const Lanes3& direction, const PacketHits& hits,
             Lanes3& from_source, double* irradiance, int* lit) const;

  /// Whether the first overload applies, for rays that share their viewpoint.
  bool is_simple() const { return laser_.is_straight() && laser_.is_even() && laser_.source_length == 0.0; }

  /// Constants of the first overload.
  struct Constants {
    double source_z, waist_depth, sigma2, divergence2, reach2, tangent, power_per_radian;
    std::array<double, LaserSheet::kStraightness> straightness;
  };
  const Constants& constants() const { return constants_; }

 private:
  LaserSheet laser_;
  Constants constants_;
};

}  // namespace sensor_rt
