// Stripe extraction: image -> Peaks.
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "sensor_rt/geometry/image.h"
#include "sensor_rt/imaging/peaks.h"
#include "sensor_rt/optics/camera.h"
#include "sensor_rt/optics/laser_sheet.h"

namespace sensor_rt {

/// Estimators of the stripe centre in a column.
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

/// Selection among several peaks in a column.
enum class PeakChoice {
  kBrightest,
  kFirst,
  kLast,
  kContinuity,  ///< the path over the columns with high brightness and small jumps
  kAgreement    ///< peaks on which the cameras agree, then as kContinuity; needs two cameras
};

/// Options of the stripe extraction: the section "extraction" of the sensor description.
struct ExtractionOptions {
  PeakDetector detector = PeakDetector::kGaussian;
  PeakChoice peak = PeakChoice::kBrightest;
  double continuity_px = 0.0;    ///< rows per column regarded as a jump, for kContinuity
  double agreement_px = 0.0;     ///< largest difference of two cameras that agree, in addition to noise
  double threshold_sigma = 0.0;  ///< least sum of a candidate, in standard deviations of the noise
  double min_amplitude_dn = 0.0;
  double min_sigma_px = 0.0;
  double max_sigma_px = 0.0;        ///< at most 8
  double max_asymmetry = 0.0;       ///< largest |asymmetry| that is not flagged
  double max_residual = 0.0;        ///< largest relative residual that is not flagged
  double max_row_jump_px = 0.0;     ///< largest deviation from the predicted row in the next column of a run
  double max_amplitude_jump = 0.0;  ///< largest relative change of amplitude from column to column
  double max_width_jump = 0.0;      ///< largest relative change of width from column to column
  int end_columns = 0;              ///< columns rejected at either end of a continuous run
  int min_run_columns = 0;          ///< shorter runs are rejected
};

/// Noise parameters of an image (EMVA 1288 terms), for thresholds, weights and uncertainties.
struct ImageNoise {
  double black_level_dn = 0.0;
  double gain_dn_per_e = 0.0;
  double read_noise_e = 0.0;
  double full_well_e = 0.0;
  int bit_depth = 0;
  double dsnu_e = 0.0;            ///< dark signal non-uniformity: fixed but unknown pixel offsets
  double prnu = 0.0;              ///< photo response non-uniformity: fixed but unknown pixel sensitivities
  double speckle_contrast = 0.0;  ///< contrast of fully resolved speckle
  double wavelength = 0.0;        ///< laser wavelength, m
};

/// Geometry of cameras and laser, for the comparison of cameras.
struct SheetGeometry {
  std::vector<Camera> cameras;
  SheetSurface sheet;     ///< on which points are triangulated
  double source_z = 0.0;  ///< sensor Z of the laser's point source, m
  double near = 0.0;      ///< measuring range along sensor Z, m
  double far = 0.0;       ///< m
};

/// Extracts the stripe from the images of an exposure: measure() for each camera in ascending order, which
/// needs the image only during the call, then finish(). Keeps its scratch memory: use one Extractor per
/// thread.
class Extractor {
 public:
  /// `all_peaks`: also return the peaks that were not chosen, flagged as such. Throws std::invalid_argument
  /// that names the option out of range.
  Extractor(const ExtractionOptions& options, const ImageNoise& noise, const SheetGeometry& geometry,
            bool all_peaks);
  ~Extractor();
  Extractor(Extractor&&) noexcept;
  Extractor& operator=(Extractor&&) noexcept;

  /// Finds and measures the peaks in the image of a camera.
  void measure(ImageView<const std::uint16_t> image, int camera);

  /// Finds and measures the peaks in the difference from `background`, an image of the same camera with the
  /// laser off.
  void measure(ImageView<const std::uint16_t> image, ImageView<const std::uint16_t> background, int camera);

  /// Appends the chosen peak of every column, with flags, sorted by camera and column, and starts a new
  /// exposure.
  void finish(std::int64_t frame, Peaks& out);

 private:
  class Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace sensor_rt
