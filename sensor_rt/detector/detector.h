// The image sensor: expected photo-electrons per pixel -> digital numbers, in the terms of EMVA 1288 (linear
// model).
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>

#include "sensor_rt/geometry/image.h"

namespace sensor_rt {

/// Camera constants in EMVA 1288 terms. Electrons where the name ends in _e, digital numbers where it ends in
/// _dn.
struct DetectorParameters {
  double exposure = 0.0;            ///< s, used when a frame does not bring its own
  double quantum_efficiency = 0.0;  ///< electrons per photon; the renderer applies it, the detector does not
  double full_well_e = 0.0;
  double read_noise_e = 0.0;  ///< temporal dark noise, standard deviation
  double dark_current_e_per_s = 0.0;
  double gain_dn_per_e = 0.0;
  int bit_depth = 0;            ///< 8..16
  double black_level_dn = 0.0;  ///< mean digital number without light and without dark current
  double prnu = 0.0;            ///< standard deviation of the pixels' relative sensitivity
  double dsnu_e = 0.0;          ///< standard deviation of the pixels' dark offset
};

/// Which frame of which camera is exposed. Together with the seed and the pixel this keys every random
/// number.
struct FrameId {
  std::int64_t frame = 0;
  int camera = 0;
  double exposure = 0.0;  ///< s
};

/// Turns expected electrons into digital numbers. Immutable, safe to share between threads; the same seed and
/// FrameId give the same bytes in any order of calls.
///
/// Pixels without light are drawn from the exact distribution of dark current plus read noise by one
/// inverse-CDF look-up per pixel. Lit pixels get a Poisson number of electrons (exact inversion below a mean
/// of 16; above it the asymptotic inverse of M. B. Giles, "Algorithm 955", ACM TOMS 42 (2016), which keeps
/// skewness and is off by less than 1e-4 in probability), clipped at the full well, then read noise. Fixed
/// patterns depend on seed, camera and pixel only.
class Detector {
 public:
  /// Throws std::invalid_argument naming the parameter that is out of bounds.
  Detector(const DetectorParameters& parameters, bool noise, std::uint64_t seed);
  ~Detector();
  Detector(Detector&&) noexcept;
  Detector& operator=(Detector&&) noexcept;

  /// Exposes the whole image `out`: `count` pixels (index = row * width + column, each at most once) collect
  /// `electrons` on average, all others none.
  void expose(const FrameId& id, const std::uint32_t* pixels, const float* electrons, std::size_t count,
              ImageView<std::uint16_t> out) const;

  /// The same from a dense plane of expected electrons of the size of `out`. Same bytes as the sparse form.
  void expose(const FrameId& id, ImageView<const float> electrons, ImageView<std::uint16_t> out) const;

  const DetectorParameters& parameters() const;

 private:
  class Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace sensor_rt
