// The light of lamps on whole images.
#pragma once

#include <vector>

#include "sensor_rt/render/pixel_tracer.h"
#include "sensor_rt/render/reflected_lamps.h"

namespace sensor_rt {

/// Fills an image with the light of lamps, one ray through the middle of a pixel at mid-exposure. Blocks of
/// 8 x 8 pixels that show one flat face, lit smoothly at their corners and their middle, are interpolated to
/// half a per cent; a detail that lies within one block is missed there.
class LampFiller {
 public:
  /// `out`: electrons per second, row by row. The tracer's camera must be selected. `reflected`: light
  /// between surfaces to be added; may be null.
  void fill(PixelTracer& tracer, ReflectedLamps* reflected, int width, int height, float* out);

 private:
  struct Block {
    int left, top, right, bottom;  ///< pixels of the corners; those at the right and bottom belong to others
  };

  LampView look(int column, int row) const;
  bool interpolate(const Block& block, const LampView* const* corners, int width, float* out) const;

  PixelTracer* tracer_ = nullptr;
  ReflectedLamps* reflected_ = nullptr;
  std::vector<LampView> corners_;
};

}  // namespace sensor_rt
