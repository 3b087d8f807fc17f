// Planar mirrors of a scene and the mirror images seen in them.
#pragma once

#include <cstdint>
#include <vector>

#include "sensor_rt/render/exposure_views.h"

namespace sensor_rt {

/// Planes of the ideal mirrors of a scene. Points are seen in a plane at their mirror images; this connects a
/// point to a camera via mirrors, which random paths from the point cannot do. Curved mirrors and meshes with
/// more planes than a simple part are not supported.
class PlanarMirrors {
 public:
  /// `views` must outlive it.
  explicit PlanarMirrors(const ExposureViews& views);

  std::size_t count() const { return planes_.size(); }

  /// Returns the mirror image of a point in plane `number` at an instant.
  Eigen::Vector3d image(std::size_t number, std::size_t instant, const Eigen::Vector3d& point) const;

  /// Traces lanes from the viewpoints of a camera along `to_image` to the mirror images of points, via the
  /// planes of `chain` in the order from the camera. Clears unoccluded[lane] where the mirror is missed or
  /// occluded. `share` returns the product of the reflectances per lane.
  void follow(std::size_t camera, std::size_t packet, const std::vector<std::size_t>& chain,
              const Lanes3& viewpoints, const Lanes3& to_image, int* unoccluded, double* share) const;

 private:
  struct Plane {
    std::size_t shape;
    Eigen::Vector3d normal;  ///< in the frame of the shape
    double offset;
  };
  /// Plane in the reference frame at an instant.
  struct PosedPlane {
    Eigen::Vector3d normal;
    double offset;
  };

  PosedPlane posed_plane(std::size_t number, std::size_t instant) const;
  void add_mesh(std::size_t shape);
  bool reflect(const Plane& plane, const PosedPlane& posed, const PacketHits& hits, int l,
               Eigen::Vector3d& origin, Eigen::Vector3d& to_image, double& share) const;

  const ExposureViews& views_;
  std::vector<Plane> planes_;
};

}  // namespace sensor_rt
