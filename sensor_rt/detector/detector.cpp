#include "sensor_rt/detector/detector.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string>

#include "sensor_rt/detector/dark_signal.h"
#include "sensor_rt/detector/electrons.h"

namespace sensor_rt {
namespace {

constexpr double kMinReadNoise = 0.3;  // below it the dark signal is too discrete for a continuous table
constexpr std::size_t kTablesKept = 16;

void require(bool condition, const char* name, double value, const char* expected) {
  if (!condition) {
    throw std::invalid_argument(std::string("detector.") + name + " = " + std::to_string(value) +
                                ": expected " + expected);
  }
}

void validate(const DetectorParameters& p) {
  const auto not_negative = [](const char* name, double value) {
    require(value >= 0.0 && std::isfinite(value), name, value, "a finite number >= 0");
  };
  not_negative("exposure", p.exposure);
  not_negative("read_noise_e", p.read_noise_e);
  not_negative("dark_current_e_per_s", p.dark_current_e_per_s);
  not_negative("black_level_dn", p.black_level_dn);
  not_negative("prnu", p.prnu);
  not_negative("dsnu_e", p.dsnu_e);
  not_negative("row_noise_e", p.row_noise_e);
  not_negative("hot_pixel_e_per_s", p.hot_pixel_e_per_s);
  require(p.hot_pixels >= 0.0 && p.hot_pixels <= 1.0, "hot_pixels", p.hot_pixels, "a number from 0 to 1");
  require(p.full_well_e > 0.0 && std::isfinite(p.full_well_e), "full_well_e", p.full_well_e,
          "a finite number > 0");
  require(p.gain_dn_per_e > 0.0 && std::isfinite(p.gain_dn_per_e), "gain_dn_per_e", p.gain_dn_per_e,
          "a finite number > 0");
  require(p.bit_depth >= 8 && p.bit_depth <= 16, "bit_depth", p.bit_depth, "8 to 16");
}

}  // namespace

Detector::Detector(const DetectorParameters& parameters, bool noise, std::uint64_t seed)
    : parameters_(parameters), noise_(noise), seed_(seed) {
  validate(parameters);
}

PixelModel Detector::pixel_model(const FrameId& id) const {
  require(id.exposure >= 0.0 && std::isfinite(id.exposure), "exposure", id.exposure, "a finite number >= 0");
  return {parameters_, noise_, seed_, id};
}

void Detector::expose_dark(const PixelModel& model, int camera, ImageView<std::uint16_t> out) const {
  expose_usual(model, camera, out);
  if (!model.has_hot_pixels()) return;
  const auto width = static_cast<std::uint32_t>(out.width);
  for (const std::uint32_t pixel :
       *hot_pixels(model, camera, std::size_t{width} * static_cast<std::size_t>(out.height))) {
    out.at(static_cast<int>(pixel / width), static_cast<int>(pixel % width)) =
        model.lit(static_cast<int>(pixel / width), pixel, 0.0f);
  }
}

void Detector::expose_usual(const PixelModel& model, int camera, ImageView<std::uint16_t> out) const {
  const double dark = model.dark_e();
  if (!noise_) {
    const std::uint16_t value = model.without_noise(0.0);
    for (int y = 0; y < out.height; ++y) std::fill_n(out.row(y), out.width, value);
    return;
  }
  const bool discrete = dark > 0.0 && parameters_.read_noise_e < kMinReadNoise;
  if (discrete || dark > 0.5 * parameters_.full_well_e) {
    for (int y = 0; y < out.height; ++y) {
      const auto first = static_cast<std::uint32_t>(y) * static_cast<std::uint32_t>(out.width);
      for (int x = 0; x < out.width; ++x)
        out.at(y, x) = model.lit(y, first + static_cast<std::uint32_t>(x), 0.0f);
    }
    return;
  }
  const std::shared_ptr<const QuantileTable> table = dark_table(dark);
  const auto size = static_cast<std::size_t>(out.width) * static_cast<std::size_t>(out.height);
  const std::shared_ptr<const std::vector<float>> pattern =
      model.is_patterned() ? dark_pattern(model, camera, size) : nullptr;
  model.dark_pixels(*table, pattern ? pattern->data() : nullptr, out);
}

std::shared_ptr<const QuantileTable> Detector::dark_table(double dark) const {
  const std::lock_guard<std::mutex> lock(mutex_);
  for (const auto& [key, table] : tables_) {
    if (key == dark) return table;
  }
  if (tables_.size() >= kTablesKept) tables_.erase(tables_.begin());
  tables_.emplace_back(
      dark, std::make_shared<const QuantileTable>(dark_signal_table(dark, parameters_.read_noise_e)));
  return tables_.back().second;
}

std::shared_ptr<const std::vector<float>> Detector::dark_pattern(const PixelModel& model, int camera,
                                                                 std::size_t pixels) const {
  const std::lock_guard<std::mutex> lock(mutex_);
  std::shared_ptr<const std::vector<float>>& kept = patterns_[camera];
  if (!kept || kept->size() < pixels) {
    kept = std::make_shared<const std::vector<float>>(model.dark_pattern(pixels));
  }
  return kept;
}

std::shared_ptr<const std::vector<std::uint32_t>> Detector::hot_pixels(const PixelModel& model, int camera,
                                                                       std::size_t pixels) const {
  const std::lock_guard<std::mutex> lock(mutex_);
  std::shared_ptr<const std::vector<std::uint32_t>>& kept = hot_[{camera, pixels}];
  if (!kept) {
    std::vector<std::uint32_t> found;
    for (std::uint32_t pixel = 0; pixel < pixels; ++pixel) {
      if (model.is_hot(pixel)) found.push_back(pixel);
    }
    kept = std::make_shared<const std::vector<std::uint32_t>>(std::move(found));
  }
  return kept;
}

void Detector::expose(const FrameId& id, const std::uint32_t* pixels, const float* electrons,
                      std::size_t count, ImageView<std::uint16_t> out) const {
  const PixelModel model = pixel_model(id);
  expose_dark(model, id.camera, out);
  const auto width = static_cast<std::uint32_t>(out.width);
  const auto size = width * static_cast<std::uint32_t>(out.height);
  for (std::size_t i = 0; i < count; ++i) {
    if (!(electrons[i] > 0.0f)) continue;
    if (pixels[i] >= size) {
      throw std::invalid_argument("pixel index " + std::to_string(pixels[i]) + " lies outside the image");
    }
    const auto row = static_cast<int>(pixels[i] / width);
    out.at(row, static_cast<int>(pixels[i] % width)) = model.lit(row, pixels[i], electrons[i]);
  }
}

void Detector::expose(const FrameId& id, ImageView<const float> electrons,
                      ImageView<std::uint16_t> out) const {
  if (electrons.width != out.width || electrons.height != out.height) {
    throw std::invalid_argument("the plane of electrons and the image differ in size");
  }
  const PixelModel model = pixel_model(id);
  expose_dark(model, id.camera, out);
  for (int y = 0; y < out.height; ++y) {
    const float* light = electrons.row(y);
    const auto first = static_cast<std::uint32_t>(y) * static_cast<std::uint32_t>(out.width);
    for (int x = 0; x < out.width; ++x) {
      if (light[x] > 0.0f) out.at(y, x) = model.lit(y, first + static_cast<std::uint32_t>(x), light[x]);
    }
  }
}

}  // namespace sensor_rt
