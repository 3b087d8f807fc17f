// Hit point of a ray.
#pragma once

#include <Eigen/Dense>

#include "sensor_rt/geometry/incident_light.h"
#include "sensor_rt/scene/scene.h"
#include "sensor_rt/tracing/packet.h"
#include "sensor_rt/tracing/scene_query.h"

namespace sensor_rt {

struct SurfacePoint {
  Eigen::Vector3d position;
  Eigen::Vector3d normal;  ///< unit, towards the side of the incoming ray
  Eigen::Vector3d back;    ///< unit, towards the origin of the ray
  double offset;           ///< m, see Shape::ray_offset
  SurfaceFrame surface;    ///< of `normal`

  /// Where ray `l`, of an instant, hits.
  SurfacePoint(const SceneQuery& query, std::size_t instant, const Lanes3& origin, const Lanes3& direction,
               const PacketHits& hits, int l)
      : SurfacePoint(query.scene().shapes()[static_cast<std::size_t>(hits.shape[l])],
                     query.track().shape_from_reference(static_cast<std::size_t>(hits.shape[l]), instant),
                     lane(origin, l) + hits.t[l] * lane(direction, l),
                     facing(lane(hits.normal, l), lane(direction, l)), -lane(direction, l).normalized()) {}
  SurfacePoint(const Shape& shape, const Rigid3& shape_from_reference, const Eigen::Vector3d& at,
               const Eigen::Vector3d& towards_viewer, const Eigen::Vector3d& to_viewer)
      : position(at),
        normal(towards_viewer),
        back(to_viewer),
        offset(shape.ray_offset()),
        surface(shape.frame(shape_from_reference, at, towards_viewer)) {}

  /// Returns the light reflected towards the origin of the ray, as the equivalent irradiance on a white
  /// diffuse surface.
  double reflected(const IncidentLight& light, const Bsdf& brdf) const {
    const double cosine = normal.dot(light.towards);
    if (!(cosine > 0.0) || !(light.irradiance > 0.0)) return 0.0;
    return light.irradiance * cosine * brdf.pi_brdf(surface, light.towards, back);
  }

  /// Returns an origin for secondary rays, moved along the normal to avoid self-intersection.
  Eigen::Vector3d above() const { return position + offset * normal; }

 private:
  static Eigen::Vector3d facing(const Eigen::Vector3d& normal, const Eigen::Vector3d& ray) {
    return normal.dot(ray) > 0.0 ? Eigen::Vector3d(-normal) : normal;
  }
};

}  // namespace sensor_rt
