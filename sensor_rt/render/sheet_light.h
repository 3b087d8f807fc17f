// How brightly the laser sheet lights the points that camera rays have met.
#pragma once

#include "sensor_rt/optics/laser_sheet.h"
#include "sensor_rt/scene/packet.h"

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

  struct Constants {
    double source_z, waist_depth, sigma2, divergence2, reach2, tangent, power_per_radian;
  };

 private:
  Constants constants_;
};

}  // namespace sensor_rt
