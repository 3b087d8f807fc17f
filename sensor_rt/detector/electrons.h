// Signal chain of a pixel: charge, noise, quantisation. Internal to the detector.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "sensor_rt/detector/detector.h"
#include "sensor_rt/detector/quantile_table.h"

namespace sensor_rt {

/// Returns a Poisson number with mean `mean` by inversion of 32 uniformly distributed bits: exact search
/// below a mean of 16, Giles's asymptotic expansion above.
double poisson(double mean, std::uint32_t bits);

/// Parameters that are constant over an image.
class PixelModel {
 public:
  PixelModel(const DetectorParameters& parameters, bool noise, std::uint64_t seed, const FrameId& id);

  /// Returns the mean dark charge, electrons.
  double dark_e() const { return dark_e_; }

  /// Returns the digital number of a pixel (index row * width + column) of a row that collects `electrons` on
  /// average.
  std::uint16_t lit(int row, std::uint32_t pixel, float electrons) const;
  /// Returns that of any pixel without noise, fixed pattern and hot pixels.
  std::uint16_t without_noise(double electrons) const;

  /// Fills an image with dark pixels, sampled from the table of the dark signal. `pattern`: their fixed
  /// offsets (electrons), or null.
  void dark_pixels(const QuantileTable& table, const float* pattern, ImageView<std::uint16_t> out) const;

  /// Whether there is a fixed pattern (DSNU), and its values (electrons) for an image of `pixels`.
  bool is_patterned() const { return dsnu_e_ > 0.0f; }
  std::vector<float> dark_pattern(std::size_t pixels) const;

  /// Whether a pixel has an additional dark current. Without noise none has.
  bool has_hot_pixels() const { return noise_ && hot_below_ > 0; }
  bool is_hot(std::uint32_t pixel) const;

 private:
  using Key = std::array<std::uint32_t, 2>;

  std::uint16_t quantise(double electrons) const;
  double hot_charge(std::uint32_t pixel) const;
  float row_offset(int row) const;

  bool noise_ = false;
  double dark_e_ = 0.0;
  double full_well_e_ = 0.0;
  double read_noise_e_ = 0.0;
  double gain_ = 0.0;
  double black_ = 0.0;
  double max_dn_ = 0.0;
  float prnu_ = 0.0f;
  float dsnu_e_ = 0.0f;
  float row_noise_e_ = 0.0f;
  std::uint64_t hot_below_ = 0;  ///< random bits of hot pixels; 0: none
  double hot_e_ = 0.0;           ///< mean additional charge of hot pixels
  Key dark_key_{};
  Key lit_key_{};
  Key dsnu_key_{};
  Key prnu_key_{};
  Key row_key_{};
  Key hot_key_{};
};

}  // namespace sensor_rt
