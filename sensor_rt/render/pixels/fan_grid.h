// Laser rays, their hits with the scene, and the projections of these into the cameras.
#pragma once

#include <Eigen/Dense>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "sensor_rt/render/render_plan.h"
#include "sensor_rt/tracing/ray_view.h"

namespace sensor_rt {

/// A laser ray: unit vector (y, z) across the fan, slope from the centre of the sheet (x per distance),
/// instant of the exposure, and index of the source point.
struct FanRay {
  double y = 0.0;
  double z = 1.0;
  double slope = 0.0;
  std::size_t instant = 0;
  std::size_t source = 0;

  /// Returns the ray midway between two rays of one source point.
  static FanRay middle(const FanRay& a, const FanRay& b) {
    const double y = a.y + b.y;
    const double z = a.z + b.z;
    const double scale = 1.0 / std::sqrt(y * y + z * z);
    return {scale * y, scale * z, 0.5 * (a.slope + b.slope), (a.instant + b.instant) / 2, a.source};
  }
  bool shares_packet_with(const FanRay& other) const {
    return instant == other.instant && source == other.source;
  }
};

/// Hit of a ray. Single precision is sufficient: the coordinates only serve to mark pixels.
struct FanHit {
  std::int32_t shape = -1;  ///< -1: no hit
  float across = 0.0f;      ///< position across the sheet in units of its half width; lit within [-1, 1]
  Eigen::Vector3f point = Eigen::Vector3f::Zero();
  Eigen::Vector3f normal = Eigen::Vector3f::Zero();

  bool hit() const { return shape >= 0; }
};

/// Hits of rays; pixel coordinates per camera at [ray * cameras + camera].
struct FanHits {
  std::vector<FanHit> hit;
  std::vector<float> column;
  std::vector<float> row;
  std::vector<float> blur;  ///< defocus radius, px

  void resize(std::size_t rays, std::size_t cameras);
  void append(const FanHits& other);
};

/// Casts laser rays in packets and projects the hits into all cameras.
class FanGrid {
 public:
  /// The scene at the instants of an exposure. All must outlive it.
  FanGrid(const RenderPlan& plan, const SceneQuery& query);

  /// Returns the indices of the shapes that the laser can reach.
  const std::vector<std::size_t>& shapes() const { return view_.shapes(); }

  /// Returns the number of points that sample the source.
  std::size_t sources() const { return source_y_.size(); }

  /// Casts `rays`; each packet of sixteen must share instant and source.
  void cast(const std::vector<FanRay>& rays, FanHits& out) const;

 private:
  const RenderPlan& plan_;
  std::vector<double> source_y_;
  RayView view_;  ///< with packets [instant][source]
};

}  // namespace sensor_rt
