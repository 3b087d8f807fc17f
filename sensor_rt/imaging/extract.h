// Stripe image -> Peaks.
#pragma once

#include <cstdint>
#include <memory>

#include "sensor_rt/geometry/image.h"
#include "sensor_rt/imaging/peaks.h"

namespace sensor_rt {

/// How the centre of a stripe is measured in a column.
enum class PeakDetector { kGaussian, kCentreOfGravity };

/// Which of several peaks in a column is taken.
enum class PeakChoice { kBrightest, kFirst, kLast };

/// Options of the stripe search: the section "extraction" of the sensor description.
struct ExtractionOptions {
  PeakDetector detector = PeakDetector::kGaussian;
  PeakChoice peak = PeakChoice::kBrightest;
  double threshold_sigma =
      0.0;  ///< a candidate rises this many noise standard deviations above the background
  double min_amplitude_dn = 0.0;
  double min_sigma_px = 0.0;
  double max_sigma_px = 0.0;     ///< at most 8
  double max_asymmetry = 0.0;    ///< largest |asymmetry| that is not flagged
  double max_residual = 0.0;     ///< largest relative residual that is not flagged
  double max_row_jump_px = 0.0;  ///< neighbouring columns further apart than their slopes predict break a run
  double max_amplitude_jump = 0.0;  ///< largest relative change of amplitude from column to column
  double max_width_jump = 0.0;      ///< largest relative change of width from column to column
  int end_columns = 0;              ///< columns distrusted at either end of a continuous run
  int min_run_columns = 0;          ///< shorter runs are distrusted altogether
};

/// What is known about the noise of an image (EMVA 1288 terms), for thresholds, weights and uncertainties.
struct ImageNoise {
  double black_level_dn = 0.0;
  double gain_dn_per_e = 0.0;
  double read_noise_e = 0.0;
  double full_well_e = 0.0;
  int bit_depth = 0;
  double dsnu_e = 0.0;  ///< spread of the pixels' offsets: noise of an unknown but fixed pattern
};

/// Finds the stripe in images. Keeps its scratch memory: one Extractor per thread.
class Extractor {
 public:
  /// Throws std::invalid_argument naming the option that is out of bounds.
  Extractor(const ExtractionOptions& options, const ImageNoise& noise);
  ~Extractor();
  Extractor(Extractor&&) noexcept;
  Extractor& operator=(Extractor&&) noexcept;

  /// Appends the chosen peak of every column that has one, flags included, in ascending columns.
  void extract(ImageView<const std::uint16_t> image, std::int64_t frame, int camera, Peaks& out);

 private:
  class Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace sensor_rt
