// The set of pixels to trace in one image.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace sensor_rt {

/// One bit per pixel, column by column: stripes are a few pixels high in each of many columns.
class PixelMask {
 public:
  void resize(int width, int height);
  void clear();
  void mark_all();

  /// Marks columns first_column..last_column by rows first_row..last_row; what lies outside the image is left
  /// out.
  void mark(int first_column, int last_column, int first_row, int last_row);

  bool test(int column, int row) const;
  std::size_t count() const;

  /// Calls visit(row) for each row that is marked in either of two neighbouring columns, ascending; a column
  /// outside the image has none.
  template <typename Visit>
  void for_each_row(int first_column, int last_column, const Visit& visit) const {
    for (int word = 0; word < words_; ++word) {
      std::uint64_t bits = first_column >= 0 ? bits_[index(first_column, word)] : 0;
      if (last_column < width_) bits |= bits_[index(last_column, word)];
      for (; bits != 0; bits &= bits - 1) visit(64 * word + __builtin_ctzll(bits));
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

 private:
  std::size_t index(int column, int word) const {
    return static_cast<std::size_t>(column) * static_cast<std::size_t>(words_) +
           static_cast<std::size_t>(word);
  }

  int width_ = 0;
  int height_ = 0;
  int words_ = 0;  ///< per column
  std::vector<std::uint64_t> bits_;
};

}  // namespace sensor_rt
