#include "sensor_rt/visibility/reach_map.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string>

namespace sensor_rt {

ReachMap::ReachMap(std::size_t orientations, const Eigen::Vector3d& low, const Eigen::Vector3d& high,
                   double step)
    : orientations_(orientations), step_(step), low_(low.array() - step) {
  if (!(step > 1e-6)) throw std::invalid_argument("position_step: expected more than 1 um");
  // Keys are rounded to the position step.
  const Eigen::Vector3d extent = high.array() + step - low_.array();
  cubes_per_metre_ = 1.0 / std::max(kCubeSteps * step, extent.maxCoeff() / kMaxCubes);
  std::size_t cubes = orientations;
  for (int k = 0; k < 3; ++k) {
    size_[k] = static_cast<std::size_t>(extent[k] * cubes_per_metre_) + 1;
    cubes *= size_[k];
  }
  votes_.assign(cubes, 0);
}

void ReachMap::record(const PoseKey& key, bool reached) {
  const Eigen::Vector3d origin(key[1] * step_, key[2] * step_, key[3] * step_);
  if (key[0] < 0 || static_cast<std::size_t>(key[0]) >= orientations_)
    throw std::out_of_range("orientation " + std::to_string(key[0]) + " does not exist");
  std::int8_t& votes = votes_[cube(static_cast<std::size_t>(key[0]), origin)];
  if (reached) {
    votes = kReached;
    return;
  }
  unreachable_.insert(packed(key));
  if (votes != kReached) votes = std::min<std::int8_t>(kVotesNeeded, static_cast<std::int8_t>(votes + 1));
}

PoseKey ReachMap::key(std::int32_t orientation, const Eigen::Vector3d& origin) const {
  PoseKey result{orientation, 0, 0, 0};
  for (int k = 0; k < 3; ++k)
    result[static_cast<std::size_t>(k) + 1] = static_cast<std::int32_t>(std::lround(origin[k] / step_));
  return result;
}

std::uint64_t ReachMap::packed(const PoseKey& key) {
  std::uint64_t number = 0;
  for (const std::int32_t value : key) number = number << 16 | (static_cast<std::uint32_t>(value) & 0xffffu);
  return number;
}

std::size_t ReachMap::cube(std::size_t orientation, const Eigen::Vector3d& origin) const {
  std::size_t number = orientation;
  for (int k = 0; k < 3; ++k) {
    const double at = (origin[k] - low_[k]) * cubes_per_metre_;
    number = number * size_[k] + static_cast<std::size_t>(std::clamp(at, 0.0, size_[k] - 1.0));
  }
  return number;
}

}  // namespace sensor_rt
