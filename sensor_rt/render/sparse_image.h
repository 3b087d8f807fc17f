// Light in the few pixels of an image that receive any.
#pragma once

#include <cstdint>
#include <vector>

namespace sensor_rt {

/// Pixels that receive light, each once; index = row * width + column.
struct SparseImage {
  std::vector<std::uint32_t> pixels;
  std::vector<float> electrons;

  void clear() {
    pixels.clear();
    electrons.clear();
  }
  /// Appends a pixel unless its light is negligible.
  void append(std::uint32_t pixel, float light) {
    constexpr float kFaint = 1e-3f;  // electrons
    if (light < kFaint) return;
    pixels.push_back(pixel);
    electrons.push_back(light);
  }
};

}  // namespace sensor_rt
