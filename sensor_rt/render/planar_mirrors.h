// Flat mirrors of a scene: what an eye sees in them, at mirrored places.
#pragma once

#include <cstdint>
#include <vector>

#include "sensor_rt/render/exposure_views.h"

namespace sensor_rt {

/// The planes in which ideal mirrors lie. Points are seen in a plane at their mirror images, so that light
/// which arrives at a point can be led to an eye by way of mirrors, which no random path from the point would
/// find. Curved mirrors, and meshes of more planes than a flat-faced part has, are left out.
class PlanarMirrors {
 public:
  /// `views` must stay.
  void set(const ExposureViews& views);

  std::size_t count() const { return planes_.size(); }

  /// Mirror image of a point in plane `number` at an instant.
  Eigen::Vector3d image(std::size_t number, std::size_t instant, const Eigen::Vector3d& point) const;

  /// Follows lanes from the eyes of a camera along `way` to the images of points, by way of the planes of
  /// `chain` in the order in which the eye meets them. Clears open[lane] where a plane is not there, or
  /// something else is. Returns the share of light that the mirrors send on, per lane, in `share`.
  void follow(std::size_t camera, std::size_t packet, const std::vector<std::size_t>& chain,
              const Lanes3& eyes, const Lanes3& way, int* open, double* share) const;

 private:
  struct Plane {
    std::size_t shape;
    Eigen::Vector3d normal;  ///< in the frame of the shape
    double offset;
  };
  /// In the reference frame at an instant.
  struct Placed {
    Eigen::Vector3d normal;
    double offset;
  };

  Placed place(std::size_t number, std::size_t instant) const;
  void add_mesh(std::size_t shape);
  bool reflect(const Plane& plane, const Placed& placed, const PacketHits& hits, int l,
               Eigen::Vector3d& origin, Eigen::Vector3d& way, double& share) const;

  const ExposureViews* views_ = nullptr;
  std::vector<Plane> planes_;
};

}  // namespace sensor_rt
