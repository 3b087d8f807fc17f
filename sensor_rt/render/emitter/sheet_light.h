// Irradiance of the laser sheet at the hits of camera rays.
#pragma once

#include "sensor_rt/optics/laser_emitter.h"
#include "sensor_rt/tracing/packet.h"

namespace sensor_rt {

/// The laser as an emitter for packets of camera rays. The emitter must outlive it.
class SheetLight {
 public:
  explicit SheetLight(const LaserEmitter& laser) : laser_(laser) {}

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
  bool is_simple() const {
    return laser_.sheet.is_straight() && laser_.sheet.is_even() && laser_.sheet.source_length == 0.0;
  }

 private:
  const LaserEmitter& laser_;
};

}  // namespace sensor_rt
