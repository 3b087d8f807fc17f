// The image sensor: expected photo-electrons per pixel to digital numbers, by the linear model of EMVA 1288.
#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>
#include <mutex>
#include <utility>
#include <vector>

#include "sensor_rt/geometry/image.h"

namespace sensor_rt {

class PixelModel;
class QuantileTable;

/// Camera constants in EMVA 1288 terms. Electrons where the name ends in _e, digital numbers where it ends in
/// _dn.
struct DetectorParameters {
  double exposure = 0.0;            ///< s, default for frames without their own exposure
  double quantum_efficiency = 0.0;  ///< electrons per photon; the renderer applies it, the detector does not
  double full_well_e = 0.0;
  double read_noise_e = 0.0;  ///< temporal dark noise, standard deviation
  double dark_current_e_per_s = 0.0;
  double gain_dn_per_e = 0.0;
  int bit_depth = 0;            ///< 8..16
  double black_level_dn = 0.0;  ///< mean digital number without light and dark current
  double prnu = 0.0;    ///< photo-response non-uniformity: standard deviation of the relative sensitivity
  double dsnu_e = 0.0;  ///< dark signal non-uniformity: standard deviation of the dark offset, electrons
  double row_noise_e = 0.0;        ///< temporal noise that all pixels of a row share, standard deviation
  double hot_pixels = 0.0;         ///< share of pixels with a large dark current
  double hot_pixel_e_per_s = 0.0;  ///< mean of their additional dark current; distributed exponentially
};

/// Frame and camera of an exposure. With the seed and the pixel index they determine every random number.
struct FrameId {
  std::int64_t frame = 0;
  int camera = 0;
  double exposure = 0.0;  ///< s
};

/// Converts expected electrons to digital numbers. Immutable, hence safe to share between threads; the same
/// seed and FrameId give the same bytes in any order of calls.
///
/// Dark pixels are sampled from the exact distribution of dark current plus read noise by one inverse-CDF
/// look-up per pixel; where quantisation gives nearly all of them one number, by one for each of the few that
/// may have another. Lit pixels get a Poisson number of electrons (exact inversion below a mean of 16; above
/// it the asymptotic inverse of M. B. Giles, "Algorithm 955", ACM TOMS 42 (2016), which reproduces the
/// skewness with an error below 1e-4 in probability), clipped at the full well, then read noise. Fixed
/// patterns and hot pixels depend on seed, camera and pixel only.
class Detector {
 public:
  /// Throws std::invalid_argument that names the parameter out of range.
  Detector(const DetectorParameters& parameters, bool noise, std::uint64_t seed);

  /// Exposes the image `out`: `count` pixels (index = row * width + column, each at most once) collect
  /// `electrons` on average, all others none.
  void expose(const FrameId& id, const std::uint32_t* pixels, const float* electrons, std::size_t count,
              ImageView<std::uint16_t> out) const;

  /// Exposes `out` from a dense image of expected electrons of the same size. Gives the same bytes as the
  /// sparse form.
  void expose(const FrameId& id, ImageView<const float> electrons, ImageView<std::uint16_t> out) const;

 private:
  PixelModel pixel_model(const FrameId& id) const;
  /// Fills the image with dark pixels.
  void expose_dark(const PixelModel& model, int camera, ImageView<std::uint16_t> out) const;
  /// Fills it without the additional current of hot pixels.
  void expose_usual(const PixelModel& model, int camera, ImageView<std::uint16_t> out) const;
  /// Returns the quantile table of this dark charge. Cached, because exposure times rarely differ.
  std::shared_ptr<const QuantileTable> dark_table(double dark) const;
  /// Returns the fixed pattern (DSNU) of this camera. Cached, because it is the same in every image.
  std::shared_ptr<const std::vector<float>> dark_pattern(const PixelModel& model, int camera,
                                                         std::size_t pixels) const;
  /// Returns the hot pixels of this camera, in ascending order. Cached like the pattern.
  std::shared_ptr<const std::vector<std::uint32_t>> hot_pixels(const PixelModel& model, int camera,
                                                               std::size_t pixels) const;

  DetectorParameters parameters_;
  bool noise_;
  std::uint64_t seed_;
  mutable std::mutex mutex_;
  mutable std::vector<std::pair<double, std::shared_ptr<const QuantileTable>>> tables_;
  mutable std::map<int, std::shared_ptr<const std::vector<float>>> patterns_;  ///< per camera
  mutable std::map<std::pair<int, std::size_t>, std::shared_ptr<const std::vector<std::uint32_t>>>
      hot_;  ///< per camera and size of its image
};

}  // namespace sensor_rt
