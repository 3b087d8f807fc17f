// Hit point of a ray.
#pragma once

#include <Eigen/Dense>
#include <utility>

#include "sensor_rt/geometry/incident_light.h"
#include "sensor_rt/scene/scene.h"
#include "sensor_rt/tracing/packet.h"

namespace sensor_rt {

struct SurfacePoint {
  Eigen::Vector3d position;
  Eigen::Vector3d normal;  ///< unit, towards the side of the incoming ray
  Eigen::Vector3d back;    ///< unit, towards the origin of the ray
  double offset;           ///< m, see Shape::ray_offset

  SurfacePoint(const Scene& scene, const Lanes3& origin, const Lanes3& direction, const PacketHits& hits,
               int l)
      : position(lane(origin, l) + hits.t[l] * lane(direction, l)),
        normal(lane(hits.normal, l)),
        back(-lane(direction, l).normalized()),
        offset(scene.shapes()[static_cast<std::size_t>(hits.shape[l])].ray_offset()) {
    if (normal.dot(back) < 0.0) normal = -normal;
  }
  SurfacePoint(const Shape& shape, Eigen::Vector3d at, Eigen::Vector3d towards_viewer,
               Eigen::Vector3d to_viewer)
      : position(std::move(at)),
        normal(std::move(towards_viewer)),
        back(std::move(to_viewer)),
        offset(shape.ray_offset()) {}

  /// Returns the light reflected towards the origin of the ray, as the equivalent irradiance on a white
  /// diffuse surface.
  double reflected(const IncidentLight& light, const Bsdf& brdf) const {
    const double cosine = normal.dot(light.towards);
    if (!(cosine > 0.0) || !(light.irradiance > 0.0)) return 0.0;
    return light.irradiance * cosine * brdf.pi_brdf(normal, light.towards, back);
  }

  /// Returns an origin for secondary rays, moved along the normal to avoid self-intersection.
  Eigen::Vector3d above() const { return position + offset * normal; }
};

}  // namespace sensor_rt
