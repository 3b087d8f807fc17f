#include "sensor_rt/render/pixels/pixel_mask.h"

#include <algorithm>

namespace sensor_rt {

void PixelMask::resize(int width, int height) {
  width_ = width;
  height_ = height;
  words_ = (height + 63) / 64;
  bits_.assign(static_cast<std::size_t>(width) * static_cast<std::size_t>(words_), 0);
}

void PixelMask::mark_all() { mark(0, width_ - 1, 0, height_ - 1); }

void PixelMask::mark(int first_column, int last_column, int first_row, int last_row) {
  first_column = std::max(first_column, 0);
  last_column = std::min(last_column, width_ - 1);
  first_row = std::max(first_row, 0);
  last_row = std::min(last_row, height_ - 1);
  if (first_row > last_row) return;
  for (int word = first_row / 64; word <= last_row / 64; ++word) {
    const int low = std::max(first_row - 64 * word, 0);
    const int high = std::min(last_row - 64 * word, 63);
    const std::uint64_t bits = (~std::uint64_t{0} >> (63 - (high - low))) << low;
    for (int column = first_column; column <= last_column; ++column) bits_[index(column, word)] |= bits;
  }
}

bool PixelMask::test(int column, int row) const {
  return (bits_[index(column, row / 64)] >> (row % 64)) & 1u;
}

}  // namespace sensor_rt
