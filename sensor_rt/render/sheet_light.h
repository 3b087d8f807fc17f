// How brightly the laser sheet lights the points that camera rays have met.
#pragma once

#include <array>

#include "sensor_rt/optics/laser_sheet.h"
#include "sensor_rt/tracing/packet.h"

namespace sensor_rt {

/// The sheet's constants as the loops over lanes want them.
class SheetLight {
 public:
  explicit SheetLight(const LaserSheet& laser);

  /// For each hit of rays from `eye`: vector from the laser's source to the point (reference frame) and the
  /// irradiance on the surface element there, 0 outside the sheet, on the side turned away from source or
  /// eye, or without a hit
  /// (whose normal is 0); lit[lane] is -1 where it is not 0. Shadows are left to the caller.
  void light(const double* eye, const Lanes3& direction, const PacketHits& hits, Lanes3& from_source,
             double* irradiance, int* lit) const;

  /// The same for rays with an eye each and a point of the source each, and for sheets of any shape.
  void light(const Lanes3& eye, const Lanes3& source, const Lanes3& direction, const PacketHits& hits,
             Lanes3& from_source, double* irradiance, int* lit) const;

  /// Whether the first form will do, for rays that share their eye.
  bool is_simple() const { return laser_.is_straight() && laser_.is_even() && laser_.opening == 0.0; }

  struct Constants {
    double source_z, waist_depth, sigma2, divergence2, reach2, tangent, power_per_radian;
    std::array<double, LaserSheet::kStraightness> straightness;
  };

 private:
  LaserSheet laser_;
  Constants constants_;
};

}  // namespace sensor_rt
