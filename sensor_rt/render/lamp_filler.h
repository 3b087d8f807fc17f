// The light of lamps on whole images.
#pragma once

#include <vector>

#include "sensor_rt/render/pixel_tracer.h"

namespace sensor_rt {

/// Fills an image with the light of lamps, one ray through the middle of a pixel at mid-exposure. Blocks of
/// 8 x 8 pixels that show one flat face, lit smoothly at their corners and their middle, are interpolated to
/// half a per cent; a detail that lies within one block is missed there.
class LampFiller {
 public:
  /// `out`: electrons per second, row by row. The tracer's camera must be selected.
  void fill(PixelTracer& tracer, int width, int height, float* out);

 private:
  struct Block {
    int left, top, right, bottom;  ///< pixels of the corners; those at the right and bottom belong to others
  };

  bool interpolate(PixelTracer& tracer, const Block& block, const LampView* const* corners, int width,
                   float* out) const;

  std::vector<LampView> corners_;
};

}  // namespace sensor_rt
