// Lamp light on entire images.
#pragma once

#include <vector>

#include "sensor_rt/render/pixel_tracer.h"
#include "sensor_rt/render/reflected_lamps.h"

namespace sensor_rt {

/// Fills an image with lamp light, using one ray through the centre of a pixel at mid-exposure. Blocks of 8 x
/// 8 pixels that show one flat face with smooth illumination at their corners and centre are interpolated
/// with an error of half a per cent; a detail within one block is missed.
class LampFiller {
 public:
  /// `out`: electrons per second, row-major. The tracer's camera must be selected. `reflected`: adds light
  /// reflected between surfaces; may be null.
  void fill(PixelTracer& tracer, ReflectedLamps* reflected, int width, int height, float* out);

 private:
  struct Block {
    int left, top, right, bottom;  ///< corner pixels; the right and bottom ones belong to the next blocks
  };

  LampView trace_middle(int column, int row) const;
  bool interpolate(const Block& block, const LampView* const* corners, int width, float* out) const;

  PixelTracer* tracer_ = nullptr;
  ReflectedLamps* reflected_ = nullptr;
  std::vector<LampView> corners_;
};

}  // namespace sensor_rt
