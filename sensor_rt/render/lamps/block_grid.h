// Values on a coarse grid over an image.
#pragma once

#include <algorithm>
#include <cassert>
#include <cstddef>
#include <vector>

namespace sensor_rt {

constexpr int kBlock = 8;  ///< edge of a block, px

/// Values at the corners of blocks of 8 x 8 pixels; the last corners lie in the last column and row.
template <typename Value>
class BlockGrid {
 public:
  /// Sets the corners, row by row, to evaluate(column, row) of their pixels.
  template <typename Evaluate>
  BlockGrid(int width, int height, const Evaluate& evaluate)
      : width_(width),
        height_(height),
        columns_((width + kBlock - 1) / kBlock + 1),
        rows_((height + kBlock - 1) / kBlock + 1) {
    values_.reserve(static_cast<std::size_t>(columns_) * static_cast<std::size_t>(rows_));
    for (int j = 0; j < rows_; ++j) {
      for (int i = 0; i < columns_; ++i) {
        values_.push_back(evaluate(std::min(i * kBlock, width - 1), std::min(j * kBlock, height - 1)));
      }
    }
  }

  int columns() const { return columns_; }
  int rows() const { return rows_; }
  /// Precondition: 0 <= i < columns() and 0 <= j < rows().
  const Value& at(int i, int j) const { return values_[index(i, j)]; }
  Value& at(int i, int j) { return values_[index(i, j)]; }

  /// Returns the place of a pixel's column, or row, among the corners, linear between them.
  double place_of_column(int column) const { return place(column, width_); }
  double place_of_row(int row) const { return place(row, height_); }

 private:
  std::size_t index(int i, int j) const {
    assert(i >= 0 && i < columns_ && j >= 0 && j < rows_);
    return static_cast<std::size_t>(j * columns_ + i);
  }
  static double place(int pixel, int size) {
    const int block = pixel / kBlock;
    const int edge = std::min(kBlock, size - 1 - block * kBlock);  // the last block may be narrower
    return edge > 0 ? block + static_cast<double>(pixel - block * kBlock) / edge : block;
  }

  int width_;
  int height_;
  int columns_;
  int rows_;
  std::vector<Value> values_;
};

}  // namespace sensor_rt
