// Integrals of the laser sheet over area and exposure of pixels that show planes, sixteen at a time.
#pragma once

#include "sensor_rt/geometry/lanes.h"
#include "sensor_rt/optics/laser_emitter.h"

namespace sensor_rt {

/// Sixteen pixels: rays (see PixelRays) and planes.
struct alignas(64) PixelLanes {
  double x[kLanes], y[kLanes];
  double dx_du[kLanes], dx_dv[kLanes], dy_du[kLanes], dy_dv[kLanes];
  Lanes3 normal;  ///< of the first face, in the frame of the shape
  double offset[kLanes];
  Lanes3 other_normal;  ///< of the second face; the following are unused in pixels with one plane
  double other_offset[kLanes];
  /// 1: the second face lies on the side of the normal of the first one, else -1; 0: unknown.
  double rise[kLanes];
};

/// Light and geometry at the pixel centres at mid-exposure.
struct alignas(64) LightLanes {
  Lanes3 direction;
  Lanes3 normal;
  Lanes3 from_source;
  double distance[kLanes];  ///< of the hit, in units of the direction
  double irradiance[kLanes];
  double per_distance[kLanes];  ///< logarithmic derivative of the irradiance by the distance
  /// Changes of ray and point by one pixel times the change across the sheet, and the relative change of
  /// the light per relative change of another factor along them.
  Lanes3 change_of_direction;
  Lanes3 change_of_point;
  double per_change[kLanes];
  double needs_samples[kLanes];
  // At an edge:
  Lanes3 other_normal;
  double share[kLanes];        ///< of the second face
  double brightening[kLanes];  ///< relative, by the change of distance
  double cosines[kLanes];      ///< ratio of the second face's cosine to the first one's
  double is_edge[kLanes];      ///< 1: the second face is accounted for
};

/// What all pixels of a camera share.
struct IntegralConstants {
  double axes[9];  ///< of the camera, see PixelRays
  double viewpoint[3];
  const LaserEmitter& laser;
  double time_scale;  ///< exposure over the time between first and last instant
};

/// A plane's pose: rotation (column-major) and translation of shape_from_reference.
struct PlanePose {
  const double* rotation;
  const double* translation;
};

/// Integrates the light of the first faces; poses at the first and the last instant.
void integrate_planes(const IntegralConstants& constants, const PlanePose& first, const PlanePose& last,
                      const PixelLanes& pixels, LightLanes& light);

/// Adds a second face that meets the first one at an edge. The difference g of inverse distances is linear in
/// column, row and time; its sign determines which face is visible. Share and mean height of the second face
/// are the means of the step and of the ramp of g over the three intervals: differences of powers at their
/// eight corners.
void integrate_edges(const IntegralConstants& constants, const PlanePose& first, const PlanePose& last,
                     const PixelLanes& pixels, LightLanes& light);

}  // namespace sensor_rt
