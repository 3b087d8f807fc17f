// Hit point of a ray.
#pragma once

#include <Eigen/Dense>
#include <utility>

#include "sensor_rt/tracing/packet.h"

namespace sensor_rt {

struct SurfacePoint {
  Eigen::Vector3d position;
  Eigen::Vector3d normal;  ///< unit, towards the side of the incoming ray
  Eigen::Vector3d back;    ///< unit, towards the origin of the ray

  SurfacePoint(const Lanes3& origin, const Lanes3& direction, const PacketHits& hits, int l)
      : position(lane(origin, l) + hits.t[l] * lane(direction, l)),
        normal(lane(hits.normal, l)),
        back(-lane(direction, l).normalized()) {
    if (normal.dot(back) < 0.0) normal = -normal;
  }
  SurfacePoint(Eigen::Vector3d at, Eigen::Vector3d towards_viewer, Eigen::Vector3d to_viewer)
      : position(std::move(at)), normal(std::move(towards_viewer)), back(std::move(to_viewer)) {}

  /// Returns an origin for secondary rays: offset by 1 µm along the normal to avoid self-intersection.
  Eigen::Vector3d above() const { return position + 1e-6 * normal; }
};

}  // namespace sensor_rt
