// Light in the few pixels of an image that receive any.
#pragma once

#include <cstdint>
#include <vector>

namespace sensor_rt {

/// Pixels that receive light, each once; index = row * width + column.
struct SparseImage {
  std::vector<std::uint32_t> pixels;
  std::vector<float> electrons;
};

}  // namespace sensor_rt
