// The chain of one pixel: charge, noise, quantisation. Used by the detector only.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "sensor_rt/detector/detector.h"
#include "sensor_rt/detector/quantile_table.h"

namespace sensor_rt {

/// Poisson number with mean `mean` by inversion of 32 uniformly distributed bits: exact search below 16,
/// Giles's asymptotic expansion above.
double poisson(double mean, std::uint32_t bits);

/// All that is constant over one image.
class PixelModel {
 public:
  PixelModel(const DetectorParameters& parameters, bool noise, std::uint64_t seed, const FrameId& id);

  /// Mean dark charge, electrons.
  double dark_e() const { return dark_e_; }

  /// Digital number of a pixel (row * width + column) that collects `electrons` on average.
  std::uint16_t lit(std::uint32_t pixel, float electrons) const;

  /// Digital numbers of `count` pixels without light, the first of them `first`, drawn from the table of the
  /// dark signal. `pattern`: their fixed offsets (electrons), null for none.
  void dark_pixels(const QuantileTable& table, const float* pattern, std::uint32_t first, int count,
                   std::uint16_t* out) const;

  /// Whether the pixels' dark offsets differ, and what they are (electrons) for an image of `pixels`.
  bool is_patterned() const { return dsnu_e_ > 0.0f; }
  std::vector<float> dark_pattern(std::size_t pixels) const;

 private:
  using Key = std::array<std::uint32_t, 2>;

  std::uint16_t quantise(double electrons) const;

  bool noise_ = false;
  double dark_e_ = 0.0;
  double full_well_e_ = 0.0;
  double read_noise_e_ = 0.0;
  double gain_ = 0.0;
  double black_ = 0.0;
  double max_dn_ = 0.0;
  float prnu_ = 0.0f;
  float dsnu_e_ = 0.0f;
  Key dark_key_{};
  Key lit_key_{};
  Key dsnu_key_{};
  Key prnu_key_{};
};

}  // namespace sensor_rt
