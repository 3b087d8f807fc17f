// Image that is stored by columns, with the range of rows of each that hold light.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

#include "sensor_rt/geometry/large_vector.h"
#include "sensor_rt/render/sparse_image.h"

namespace sensor_rt {

/// Light by columns; all zero after `resize` and `clear`.
class ColumnImage {
 public:
  void resize(int columns, int rows) {
    if (first_.size() == static_cast<std::size_t>(columns) && rows_ == rows) return;
    rows_ = rows;
    light_.assign(static_cast<std::size_t>(columns) * static_cast<std::size_t>(rows), 0.0f);
    first_.assign(static_cast<std::size_t>(columns), std::numeric_limits<int>::max());
    last_.assign(static_cast<std::size_t>(columns), -1);
  }

  int columns() const { return static_cast<int>(first_.size()); }
  int rows() const { return rows_; }
  float* column(int number) {
    return &light_[static_cast<std::size_t>(number) * static_cast<std::size_t>(rows_)];
  }
  const float* column(int number) const {
    return &light_[static_cast<std::size_t>(number) * static_cast<std::size_t>(rows_)];
  }
  /// Returns the first and last row that hold light; the last one is -1 in a dark column.
  int first(int number) const { return first_[static_cast<std::size_t>(number)]; }
  int last(int number) const { return last_[static_cast<std::size_t>(number)]; }

  /// Records that rows `from` to `to` of a column hold light.
  void touch(int number, int from, int to) {
    const auto at = static_cast<std::size_t>(number);
    first_[at] = std::min(first_[at], from);
    last_[at] = std::max(last_[at], to);
  }

  /// Appends the part of width × height pixels from column `left` and row `above` on to `to`, times `scale`,
  /// and clears the image.
  void move_to(SparseImage& to, int left, int above, int width, int height, float scale) {
    for (int number = 0; number < columns(); ++number) {
      const int to_column = number - left;
      const bool in_image = to_column >= 0 && to_column < width;
      const int end = std::min(last(number), above + height - 1);
      for (int row = std::max(first(number), above); in_image && row <= end; ++row) {
        to.append(static_cast<std::uint32_t>((row - above) * width + to_column), scale * column(number)[row]);
      }
      clear(number);
    }
  }

  void clear(int number) {
    const auto at = static_cast<std::size_t>(number);
    if (last_[at] >= 0) std::fill(column(number) + first_[at], column(number) + last_[at] + 1, 0.0f);
    first_[at] = std::numeric_limits<int>::max();
    last_[at] = -1;
  }

 private:
  int rows_ = 0;
  LargeVector<float> light_;
  std::vector<int> first_;
  std::vector<int> last_;
};

}  // namespace sensor_rt
