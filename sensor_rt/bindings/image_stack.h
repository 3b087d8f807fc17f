// Checked access to arrays of images (frames, cameras, height, width).
#pragma once

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <stdexcept>
#include <string>

#include "sensor_rt/bindings/arrays.h"
#include "sensor_rt/geometry/image.h"
#include "sensor_rt/pipeline/sensor.h"

namespace sensor_rt {

/// Returns dtype and shape of an array, for messages: "float64 (3, 4)".
inline std::string describe(const pybind11::array& array) {
  return pybind11::str(array.dtype()).cast<std::string>() + " " + shape_text(array);
}

/// Whether the elements are T in native byte order. Equal types need not be one object: a pickled array has
/// its own.
template <typename T>
bool has_type(const pybind11::array& array) {
  return pybind11::dtype::of<T>().equal(array.dtype());
}

/// Images of all frames and cameras of a sensor, contiguous.
template <typename T>
class ImageStack {
 public:
  /// Throws std::invalid_argument unless `array` is a T array (n, cameras, height, width) that matches the
  /// sensor.
  ImageStack(const char* name, const pybind11::array& array, const Sensor& sensor) {
    const auto wrong = [&](const std::string& expected) {
      throw std::invalid_argument(std::string(name) + ": expected " + expected + ", got " + describe(array));
    };
    if (!has_type<T>(array) || array.ndim() != 4) {
      wrong(pybind11::str(pybind11::dtype::of<T>()).cast<std::string>() +
            " (frames, cameras, height, width)");
    }
    if (array.shape(1) != static_cast<pybind11::ssize_t>(sensor.cameras.size())) {
      wrong("images of " + std::to_string(sensor.cameras.size()) + " cameras");
    }
    for (const Camera& camera : sensor.cameras) {
      if (array.shape(2) != camera.height_px || array.shape(3) != camera.width_px) {
        wrong("images of " + std::to_string(camera.height_px) + " rows and " +
              std::to_string(camera.width_px) + " columns for camera " + camera.name);
      }
    }
    array_ = pybind11::array_t<T, pybind11::array::c_style>::ensure(array);
    data_ = array_.data();
    cameras_ = sensor.cameras.size();
    height_ = static_cast<int>(array.shape(2));
    width_ = static_cast<int>(array.shape(3));
    frames_ = static_cast<std::size_t>(array.shape(0));
  }

  std::size_t frames() const { return frames_; }
  std::size_t cameras() const { return cameras_; }
  int height() const { return height_; }
  int width() const { return width_; }
  std::size_t pixels() const { return static_cast<std::size_t>(height_) * static_cast<std::size_t>(width_); }

  /// Image number frame * cameras + camera. Needs no GIL.
  ImageView<const T> image(std::size_t index) const {
    return {data_ + index * pixels(), width_, height_, width_};
  }

 private:
  pybind11::array_t<T, pybind11::array::c_style> array_;
  const T* data_ = nullptr;
  std::size_t frames_ = 0;
  std::size_t cameras_ = 0;
  int height_ = 0;
  int width_ = 0;
};

}  // namespace sensor_rt
