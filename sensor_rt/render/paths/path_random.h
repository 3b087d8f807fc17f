// Random numbers for light paths.
#pragma once

#include <array>
#include <cstdint>

#include "sensor_rt/geometry/random.h"

namespace sensor_rt {

/// Generates three uniform numbers per reflection of a path, as a function of seed, frame and kind of path.
class PathRandom {
 public:
  static constexpr int kPhotons = 0;
  static constexpr int kLamps = -2;  ///< minus the camera index
  static constexpr int kSight = 1;   ///< plus the camera index

  PathRandom(std::uint64_t seed, std::int64_t frame, int kind)
      : key_{static_cast<std::uint32_t>(seed) ^ 0x9E3779B9u * static_cast<std::uint32_t>(kind + 1),
             static_cast<std::uint32_t>(seed >> 32) ^ static_cast<std::uint32_t>(frame)} {}

  std::array<double, 3> at(std::uint32_t pixel, std::uint32_t sample, std::uint32_t depth) const {
    const std::array<std::uint32_t, 4> bits = philox4x32({pixel, sample, depth, 0x5CA77E8u}, key_);
    return {static_cast<double>(uniform01(bits[0])), static_cast<double>(uniform01(bits[1])),
            static_cast<double>(uniform01(bits[2]))};
  }

 private:
  std::array<std::uint32_t, 2> key_;
};

}  // namespace sensor_rt
