// Reachability of sensor poses, from recorded results.
#pragma once

#include <Eigen/Dense>
#include <array>
#include <cstdint>
#include <unordered_set>
#include <vector>

namespace sensor_rt {

/// Orientation; sensor origin at azimuth 0 in steps of the position grid.
using PoseKey = std::array<std::int32_t, 4>;

/// Recorded unreachable poses, and cubes of positions that are regarded as unreachable: those with
/// `kVotesNeeded` unreachable poses and no reachable one. Their edge is `kCubeSteps` position steps, or 1/32
/// of the whole range if that is larger.
class ReachMap {
 public:
  /// All sensor origins lie between `low` and `high`, m.
  ReachMap(std::size_t orientations, const Eigen::Vector3d& low, const Eigen::Vector3d& high, double step);

  void record(const PoseKey& key, bool reached);

  PoseKey key(std::int32_t orientation, const Eigen::Vector3d& origin) const;
  bool is_unreachable(const PoseKey& key) const {
    return !unreachable_.empty() && unreachable_.count(packed(key)) != 0;
  }
  bool is_cube_unreachable(std::size_t orientation, const Eigen::Vector3d& origin) const {
    return !unreachable_.empty() && votes_[cube(orientation, origin)] >= kVotesNeeded;
  }

 private:
  static constexpr double kCubeSteps = 8.0;
  static constexpr double kMaxCubes = 32.0;  ///< along each axis
  static constexpr std::int8_t kVotesNeeded = 3;
  static constexpr std::int8_t kReached = -1;

  static std::uint64_t packed(const PoseKey& key);
  std::size_t cube(std::size_t orientation, const Eigen::Vector3d& origin) const;

  std::size_t orientations_;
  double step_;
  Eigen::Vector3d low_;
  double cubes_per_metre_;
  std::size_t size_[3];
  std::vector<std::int8_t> votes_;  ///< per orientation and cube: number of unreachable poses, or kReached
  std::unordered_set<std::uint64_t> unreachable_;
};

}  // namespace sensor_rt
