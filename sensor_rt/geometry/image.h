// Non-owning and owning row-major images.
#pragma once

#include <cstddef>
#include <vector>

namespace sensor_rt {

/// View of a row-major image; pixel (row, column) is at data[row * stride + column].
template <typename T>
struct ImageView {
  T* data = nullptr;
  int width = 0;
  int height = 0;
  std::ptrdiff_t stride = 0;

  T* row(int y) const { return data + y * stride; }
  T& at(int y, int x) const { return data[y * stride + x]; }
};

/// Image that owns its pixels. Resizing to a smaller size keeps the allocation.
template <typename T>
class Image {
 public:
  Image() = default;
  Image(int width, int height, T value = T{}) { resize(width, height, value); }

  void resize(int width, int height, T value = T{}) {
    width_ = width;
    height_ = height;
    pixels_.assign(static_cast<std::size_t>(width) * static_cast<std::size_t>(height), value);
  }

  int width() const { return width_; }
  int height() const { return height_; }
  ImageView<T> view() { return {pixels_.data(), width_, height_, width_}; }
  ImageView<const T> view() const { return {pixels_.data(), width_, height_, width_}; }

 private:
  int width_ = 0;
  int height_ = 0;
  std::vector<T> pixels_;
};

}  // namespace sensor_rt
