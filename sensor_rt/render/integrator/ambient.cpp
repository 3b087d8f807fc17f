#include "sensor_rt/render/integrator/ambient.h"

#include <algorithm>

namespace sensor_rt {

AmbientGrid::AmbientGrid(const PixelTracer& tracer, int width, int height)
    : columns_((width + kBlock - 1) / kBlock + 1) {
  const int rows = (height + kBlock - 1) / kBlock + 1;
  for (int row = 0; row < rows; ++row) {
    for (int column = 0; column < columns_; ++column) {
      corners_.push_back(
          tracer.reflectance(std::min(column * kBlock, width - 1), std::min(row * kBlock, height - 1)));
    }
  }
}

double AmbientGrid::block_reflectance(int block_column, int block_row) const {
  const double* top = &corners_[static_cast<std::size_t>(block_row * columns_ + block_column)];
  const double* bottom = top + columns_;
  const bool flat = top[0] == top[1] && top[0] == bottom[0] && top[0] == bottom[1];
  return flat ? top[0] : -1.0;
}

}  // namespace sensor_rt
