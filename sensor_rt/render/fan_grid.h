// Laser rays that find out where the sheet lands, and where the cameras see that.
#pragma once

#include <Eigen/Dense>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "sensor_rt/optics/projector.h"
#include "sensor_rt/render/render_plan.h"
#include "sensor_rt/tracing/ray_view.h"

namespace sensor_rt {

/// A laser ray: unit vector (y, z) across the fan, slope off the middle of the sheet (x per distance),
/// instant of the exposure, and which point of the source it leaves.
struct FanRay {
  double y = 0.0;
  double z = 1.0;
  double slope = 0.0;
  std::size_t instant = 0;
  std::size_t source = 0;

  /// The ray half way between two of one source.
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

/// Where a ray landed. Pixel coordinates are kept as floats: they serve to mark pixels, not to measure.
struct Landing {
  std::int32_t shape = -1;  ///< -1: nowhere
  float across = 0.0f;      ///< place across the sheet in units of its half width: light within [-1, 1]
  Eigen::Vector3f point = Eigen::Vector3f::Zero();
  Eigen::Vector3f normal = Eigen::Vector3f::Zero();

  bool hit() const { return shape >= 0; }
};

/// Rays and their landings; pixel coordinates per camera at [ray * cameras + camera].
struct FanLandings {
  std::vector<Landing> landing;
  std::vector<float> column;
  std::vector<float> row;
  std::vector<float> blur;  ///< radius of what is out of focus, px

  void resize(std::size_t rays, std::size_t cameras);
};

/// Casts laser rays in packets and projects the landings into all cameras.
class FanGrid {
 public:
  explicit FanGrid(const RenderPlan& plan);

  /// Makes the scene at the instants of an exposure ready.
  void set(const Scene& scene, const PoseTrack& track);

  /// Numbers of the shapes that the laser can reach.
  const std::vector<std::size_t>& shapes() const { return view_.shapes(); }

  /// Number of points that stand for the source.
  std::size_t sources() const { return source_y_.size(); }

  /// Casts `rays`, which share instant and source with the first of each sixteen.
  void cast(const std::vector<FanRay>& rays, FanLandings& out);

 private:
  const RenderPlan& plan_;
  RayView view_;
  std::vector<Projector> projectors_;
  std::vector<Rigid3> camera_from_reference_;
  std::vector<double> source_y_;
  // Of packets [instant][source]:
  std::vector<std::size_t> lane_instants_;
  std::vector<Eigen::Vector3d> lane_sources_;
};

}  // namespace sensor_rt
