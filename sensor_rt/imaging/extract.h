// Stripe image -> Peaks.
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "sensor_rt/geometry/image.h"
#include "sensor_rt/imaging/peaks.h"
#include "sensor_rt/optics/camera.h"

namespace sensor_rt {

/// How the centre of a stripe is measured in a column. Each has a file, or shares one with its like.
enum class PeakDetector {
  kGaussian,              ///< least squares with a pixel-integrated Gaussian
  kCentreOfGravity,       ///< first moment
  kParabola,              ///< through the three highest pixels
  kLogParabola,           ///< weighted least squares through the logarithms of nine pixels
  kBlaisRioux4,           ///< zero crossing of two rows less the next two
  kBlaisRioux8,           ///< the same with four and four
  kDerivativeOfGaussian,  ///< zero crossing of a filter as wide as the stripe
  kSteger                 ///< ridge of the smoothed image
};

/// Which of several peaks in a column is taken.
enum class PeakChoice {
  kBrightest,
  kFirst,
  kLast,
  kContinuity,  ///< of the path over the columns that is bright and jumps little
  kAgreement    ///< what the cameras agree on, then as by continuity; needs two cameras
};

/// Options of the stripe search: the section "extraction" of the sensor description.
struct ExtractionOptions {
  PeakDetector detector = PeakDetector::kGaussian;
  PeakChoice peak = PeakChoice::kBrightest;
  double continuity_px = 0.0;  ///< rows per column that count as a jump, for the choice by continuity
  double agreement_px = 0.0;   ///< two cameras agree when they differ by no more than this and noise
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
  double dsnu_e = 0.0;            ///< spread of the pixels' offsets: noise of an unknown but fixed pattern
  double speckle_contrast = 0.0;  ///< of fully resolved grains
  double wavelength = 0.0;        ///< m, of the light that has the speckle
};

/// Where the cameras and the laser stand, for comparing cameras.
struct SheetGeometry {
  std::vector<Camera> cameras;
  double source_z = 0.0;  ///< sensor Z of the laser's point source, m
  double near = 0.0;      ///< measuring range along sensor Z, m
  double far = 0.0;       ///< m
};

/// Finds the stripe in the images of an exposure: measure() for each camera in ascending order, which needs
/// its image only while it runs, then finish(). Keeps its scratch memory: one Extractor per thread.
class Extractor {
 public:
  /// `all_peaks`: give the peaks that were not chosen as well, flagged so. Throws std::invalid_argument
  /// naming the option that is out of bounds.
  Extractor(const ExtractionOptions& options, const ImageNoise& noise, const SheetGeometry& geometry,
            bool all_peaks);
  ~Extractor();
  Extractor(Extractor&&) noexcept;
  Extractor& operator=(Extractor&&) noexcept;

  /// Finds and measures the peaks in the image of a camera.
  void measure(ImageView<const std::uint16_t> image, int camera);

  /// The same in what the laser added: `unlit` is an image of the same camera with the laser off.
  void measure(ImageView<const std::uint16_t> image, ImageView<const std::uint16_t> unlit, int camera);

  /// Appends the chosen peak of every column that has one, flags included, sorted by camera and column, and
  /// begins a new exposure.
  void finish(std::int64_t frame, Peaks& out);

 private:
  class Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace sensor_rt
