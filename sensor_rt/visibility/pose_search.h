// Search for sensor poses that measure surface samples.
#pragma once

#include <cstdint>
#include <vector>

#include "sensor_rt/scene/embree.h"
#include "sensor_rt/scene/mesh_view.h"
#include "sensor_rt/visibility/pose_grid.h"
#include "sensor_rt/visibility/reach_map.h"

namespace sensor_rt {

class FreeDistances;

/// A pose found for a sample. Positions are rotated by minus the azimuth of the pose, so that they depend
/// only on the pose at azimuth 0.
struct FoundPose {
  std::int64_t sample;
  PoseKey key;
  Eigen::Vector3d sample_position;
  Eigen::Vector3d source_position;
  Eigen::Vector3d camera_position;
};

/// Surface samples with unit normals, in the frame of the mesh.
struct SurfaceSamples {
  std::vector<Eigen::Vector3d> points;
  std::vector<Eigen::Vector3d> normals;
};

/// Enumerates the poses of a grid for every sample, in an order that depends only on the grid. A pose is
/// accepted when the laser ray and the ray to a camera are unobstructed and hit the sample within the
/// incidence limit, and the housing stays above z = 0. Rays are first looked up in a grid of directions (2.5°
/// for azimuths of 15°), and cast exactly for the poses that pass.
class PoseSearch {
 public:
  /// `mesh`: all occluders, including the sampled surface. `position_step`: grid of the sensor positions in
  /// `FoundPose::key`, m. Throws std::invalid_argument for an invalid mesh or samples that are not finite.
  PoseSearch(const MeshView& mesh, SurfaceSamples samples, PoseGrid grid, double incidence_limit,
             double position_step);

  /// Returns the next pose of each of the given samples, if there is one. Each sample may be given once.
  /// Throws std::out_of_range for an invalid sample.
  std::vector<FoundPose> next(const std::int64_t* samples, std::size_t count, unsigned threads);

  /// Continues the search of these samples with the next tile of laser ray directions.
  void skip_directions(const std::int64_t* samples, std::size_t count);

  /// Records whether the robot reaches the poses with this key. Unreachable poses are no longer returned, nor
  /// are those in the same cube of a `ReachMap`.
  void record_reachability(const PoseKey& key, bool reached) { reach_.record(key, reached); }

 private:
  /// State of the search of a sample.
  struct Cursor {
    std::uint32_t cell = 0;  ///< in the order of the search
    std::uint32_t pose = 0;  ///< in the list of the cell
  };

  void check_numbers(const std::int64_t* samples, std::size_t count) const;
  bool find(std::size_t sample, FreeDistances& free_distances, FoundPose& found);
  bool try_pose(std::size_t sample, std::size_t number, int azimuth, const Eigen::Vector3d& at,
                FreeDistances& free_distances, FoundPose& found) const;
  bool is_free(std::size_t sample, const Eigen::Vector3d& source, const Eigen::Vector3d& camera) const;

  SurfaceSamples samples_;
  PoseGrid grid_;
  double min_cosine_;
  ReachMap reach_;
  Eigen::Vector3d centre_;
  double lift_ = 0.0;  ///< offset of ray origins from the surface, m
  SceneHandle scene_;
  std::vector<int> order_;  ///< tiles of the direction grid
  std::vector<Eigen::Matrix3d> azimuth_rotations_;
  std::vector<Cursor> cursors_;
};

}  // namespace sensor_rt
