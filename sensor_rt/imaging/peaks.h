// Result of the stripe extraction: one entry per peak, as a structure of arrays.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace sensor_rt {

/// Quality flags of a peak; bits may be combined.
enum PeakFlag : std::uint32_t {
  kPeakSaturated = 1u << 0,      ///< saturated pixels were excluded from the fit
  kPeakBorder = 1u << 1,         ///< the stripe is clipped by the image border
  kPeakAsymmetric = 1u << 2,     ///< skewed: partially occluded, truncated or merging
  kPeakWide = 1u << 3,           ///< wider than max_sigma_px
  kPeakNarrow = 1u << 4,         ///< narrower than min_sigma_px: noise or a hot pixel
  kPeakWeak = 1u << 5,           ///< below min_amplitude_dn
  kPeakMultiple = 1u << 6,       ///< the column contains other peaks
  kPeakStep = 1u << 7,           ///< amplitude or width differs from a neighbour: edge or step of reflectance
  kPeakResidual = 1u << 8,       ///< the stripe does not fit the model
  kPeakEnd = 1u << 9,            ///< within end_columns of the end of a continuous run, or in a too short run
  kPeakNotConverged = 1u << 10,  ///< the fit did not converge
  kPeakOverlap = 1u << 11,       ///< another peak overlaps the flank of this one
  kPeakPassedOver = 1u << 12,    ///< another peak of the column was chosen
  kPeakUnconfirmed = 1u << 13    ///< contradicted by other cameras: a reflection, or distorted by an edge
};

/// Peaks with any of these flags are not triangulated.
constexpr std::uint32_t kPeakRejected = kPeakBorder | kPeakAsymmetric | kPeakWide | kPeakNarrow | kPeakWeak |
                                        kPeakStep | kPeakResidual | kPeakEnd | kPeakNotConverged |
                                        kPeakOverlap | kPeakPassedOver | kPeakUnconfirmed;

/// Peaks of any number of images, in the order frame, camera, column, row.
struct Peaks {
  std::vector<std::int64_t> frame;
  std::vector<std::int32_t> camera;
  std::vector<std::int32_t> column;
  std::vector<double> row;  ///< px, integer = pixel centre
  /// Height of the stripe, not of the brightest pixel, above the background, DN.
  std::vector<float> amplitude;
  std::vector<float> width;  ///< standard deviation of the stripe, px
  /// Standard deviation of row from shot, read and quantisation noise, pixel sensitivities and speckle, px.
  std::vector<float> row_sigma;
  /// Third Hermite coefficient (skewness / 6); > 0: the tail lies at larger rows.
  std::vector<float> asymmetry;
  std::vector<float> residual;  ///< RMS misfit beyond the expected noise, relative to amplitude
  std::vector<std::uint32_t> flags;

  std::size_t size() const { return row.size(); }
  void clear();
  void append(const Peaks& other);
};

}  // namespace sensor_rt
