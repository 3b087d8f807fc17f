// Quality assessment of peaks. A stripe that is partially occluded, clipped by an edge or merged with another
// one is detected by its shape in its own column or by its deviation from the neighbouring columns.
#include <algorithm>
#include <cmath>

#include "sensor_rt/imaging/stripe.h"

namespace sensor_rt {
namespace {

constexpr float kColumnNoiseSigmas = 4.0f;  // allowance for noise in comparisons between columns
constexpr float kShapeSigmas = 3.0f;        // allowance for noise in the asymmetry of one column
constexpr float kMultipleSigmas = 1.0f;     // the same when a second peak suggests a split stripe

/// The peaks of an image as a chain over the columns.
class Chain {
 public:
  Chain(const ExtractionOptions& options, const std::vector<Candidate>& candidates,
        std::vector<StripeFit>& fits)
      : options_(options), candidates_(candidates), fits_(fits), linked_(fits.size(), false) {}

  /// Flags jumps of amplitude, width or direction from column to column.
  void flag_neighbours() {
    for (std::size_t i = 0; i + 1 < fits_.size(); ++i) {
      linked_[i] = candidates_[i + 1].column == candidates_[i].column + 1 && within_reach(i);
    }
    for (std::size_t i = 0; i + 1 < fits_.size(); ++i) {
      if (!linked_[i]) continue;
      if (jumps(fits_[i], fits_[i + 1])) {
        fits_[i].flags |= kPeakStep;
        fits_[i + 1].flags |= kPeakStep;
      }
      if (i > 0 && linked_[i - 1] && std::fabs(bend(i)) > tolerance(i)) fits_[i].flags |= kPeakStep;
    }
  }

  /// Flags the ends of runs of trusted, linked peaks, and runs that are too short.
  void flag_runs() {
    std::size_t begin = 0;
    while (begin < fits_.size()) {
      if (fits_[begin].flags & kPeakRejected) {
        ++begin;
        continue;
      }
      std::size_t end = begin + 1;
      while (end < fits_.size() && linked_[end - 1] && !(fits_[end].flags & kPeakRejected)) ++end;
      trim(begin, end);
      begin = end;
    }
  }

 private:
  double step(std::size_t i) const { return fits_[i + 1].row - fits_[i].row; }
  double bend(std::size_t i) const { return step(i) - step(i - 1); }

  double tolerance(std::size_t i) const {
    const double noise = kColumnNoiseSigmas * std::sqrt(6.0) * static_cast<double>(fits_[i].row_sigma);
    return options_.max_row_jump_px + noise;
  }

  bool adjacent(std::size_t i) const {
    return i + 1 < fits_.size() && candidates_[i + 1].column == candidates_[i].column + 1;
  }

  /// Returns true when peak i + 1 continues peak i: along the slope before or behind, or with slope 0 where
  /// neither is known.
  bool within_reach(std::size_t i) const {
    const bool before = i > 0 && adjacent(i - 1);
    const bool behind = adjacent(i + 1);
    if (std::fabs(step(i)) <= tolerance(i)) return true;
    return (before && std::fabs(bend(i)) <= tolerance(i)) ||
           (behind && std::fabs(bend(i + 1)) <= tolerance(i));
  }

  bool jumps(const StripeFit& a, const StripeFit& b) const {
    // The relative uncertainties of amplitude and width are about that of the row relative to the width.
    const float noise = kColumnNoiseSigmas * std::hypot(a.row_sigma / a.width, b.row_sigma / b.width);
    // The peak of a saturated stripe is extrapolated from its flanks, so that its amplitude is unreliable.
    const bool comparable = ((a.flags | b.flags) & kPeakSaturated) == 0;
    const float amplitude =
        comparable ? std::fabs(a.amplitude - b.amplitude) / std::max(a.amplitude, b.amplitude) : 0.0f;
    const float width = std::fabs(a.width - b.width) / std::max(a.width, b.width);
    return amplitude > static_cast<float>(options_.max_amplitude_jump) + noise ||
           width > static_cast<float>(options_.max_width_jump) + noise;
  }

  void trim(std::size_t begin, std::size_t end) {
    const std::size_t length = end - begin;
    const auto ends = static_cast<std::size_t>(options_.end_columns);
    const bool too_short = length < static_cast<std::size_t>(options_.min_run_columns) || length <= 2 * ends;
    for (std::size_t i = begin; i < end; ++i) {
      if (too_short || i - begin < ends || end - 1 - i < ends) fits_[i].flags |= kPeakEnd;
    }
  }

  const ExtractionOptions& options_;
  const std::vector<Candidate>& candidates_;
  std::vector<StripeFit>& fits_;
  std::vector<bool> linked_;
};

}  // namespace

void flag_shape(const ExtractionOptions& o, StripeFit& fit) {
  if (fit.amplitude < o.min_amplitude_dn) fit.flags |= kPeakWeak;
  if (fit.width < o.min_sigma_px) fit.flags |= kPeakNarrow;
  if (fit.width > o.max_sigma_px) fit.flags |= kPeakWide;
  const float sigmas = (fit.flags & kPeakMultiple) != 0 ? kMultipleSigmas : kShapeSigmas;
  if (!(std::fabs(fit.asymmetry) <= static_cast<float>(o.max_asymmetry) + sigmas * fit.asymmetry_sigma)) {
    fit.flags |= kPeakAsymmetric;
  }
  // With few contributing pixels the squared residual fluctuates by about its expectation.
  const auto allowed = static_cast<float>(o.max_residual);
  const float noise = 1.5f * fit.residual_noise;
  if (fit.residual * fit.residual > allowed * allowed + noise * noise) fit.flags |= kPeakResidual;
}

void flag_neighbours(const ExtractionOptions& options, const std::vector<Candidate>& candidates,
                     std::vector<StripeFit>& fits) {
  Chain chain(options, candidates, fits);
  chain.flag_neighbours();
  chain.flag_runs();
}

}  // namespace sensor_rt
