// Set of pixels to trace in an image.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace sensor_rt {

/// One bit per pixel, column-major: a stripe covers a few pixels of each column.
class PixelMask {
 public:
  void resize(int width, int height);
  void mark_all();

  /// Marks columns first_column..last_column of rows first_row..last_row, clipped to the image.
  void mark(int first_column, int last_column, int first_row, int last_row);

  bool test(int column, int row) const;

  /// Calls visit(edge, row) for each corner of a marked pixel between `first_edge` and the few edges that
  /// follow, in ascending rows, then edges. A corner lies above the pixel of its row and to the left of that
  /// of its edge.
  template <int kEdges, typename Visit>
  void for_each_corner(int first_edge, const Visit& visit) const {
    std::uint64_t above[kEdges] = {};  // last row of the previous word
    for (int word = 0; word <= words_; ++word) {
      std::uint64_t corners[kEdges];
      std::uint64_t any = 0;
      for (int k = 0; k < kEdges; ++k) {
        const std::uint64_t pixels = bits(first_edge + k - 1, word) | bits(first_edge + k, word);
        corners[k] = pixels | pixels << 1 | above[k];
        above[k] = pixels >> 63;
        any |= corners[k];
      }
      for (; any != 0; any &= any - 1) {
        const int row = __builtin_ctzll(any);
        for (int k = 0; k < kEdges; ++k) {
          if ((corners[k] >> row & 1u) != 0) visit(first_edge + k, 64 * word + row);
        }
      }
    }
  }

  /// Calls visit(column, row) in ascending columns, then rows.
  template <typename Visit>
  void for_each(const Visit& visit) const {
    for (int column = 0; column < width_; ++column) {
      for (int word = 0; word < words_; ++word) {
        std::uint64_t bits = bits_[index(column, word)];
        for (; bits != 0; bits &= bits - 1) visit(column, 64 * word + __builtin_ctzll(bits));
      }
    }
  }

  /// Calls visit(column, row) in ascending rows, then columns.
  template <typename Visit>
  void for_each_by_row(const Visit& visit) const {
    for (int row = 0; row < height_; ++row) {
      for (int column = 0; column < width_; ++column) {
        if (test(column, row)) visit(column, row);
      }
    }
  }

 private:
  std::size_t index(int column, int word) const {
    return static_cast<std::size_t>(column) * static_cast<std::size_t>(words_) +
           static_cast<std::size_t>(word);
  }

  /// Returns 64 rows of a column; 0 outside the image.
  std::uint64_t bits(int column, int word) const {
    return column >= 0 && column < width_ && word < words_ ? bits_[index(column, word)] : 0;
  }

  int width_ = 0;
  int height_ = 0;
  int words_ = 0;  ///< per column
  std::vector<std::uint64_t> bits_;
};

}  // namespace sensor_rt
