#include "sensor_rt/imaging/extract.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "sensor_rt/imaging/agreement.h"
#include "sensor_rt/imaging/background_light.h"
#include "sensor_rt/imaging/background_subtraction.h"
#include "sensor_rt/imaging/choose.h"
#include "sensor_rt/imaging/interpolation_error.h"
#include "sensor_rt/imaging/stripe.h"

namespace sensor_rt {
namespace {

void require(bool condition, const char* name, double value, const char* expected) {
  if (!condition) {
    throw std::invalid_argument(std::string("extraction.") + name + " = " + std::to_string(value) +
                                ": expected " + expected);
  }
}

void validate(const ExtractionOptions& o, const ImageNoise& n, const SheetGeometry& g) {
  const auto positive = [](const char* name, double value) {
    require(value > 0.0 && std::isfinite(value), name, value, "a finite number > 0");
  };
  positive("threshold_sigma", o.threshold_sigma);
  positive("continuity_px", o.continuity_px);
  positive("agreement_px", o.agreement_px);
  if (o.peak == PeakChoice::kAgreement && g.cameras.size() < 2) {
    throw std::invalid_argument("extraction.peak = agreement: expected two cameras or more, the sensor has " +
                                std::to_string(g.cameras.size()));
  }
  positive("max_asymmetry", o.max_asymmetry);
  positive("max_residual", o.max_residual);
  positive("max_row_jump_px", o.max_row_jump_px);
  positive("max_amplitude_jump", o.max_amplitude_jump);
  positive("max_width_jump", o.max_width_jump);
  require(o.min_amplitude_dn >= 0.0, "min_amplitude_dn", o.min_amplitude_dn, "a number >= 0");
  require(o.min_sigma_px >= 0.0, "min_sigma_px", o.min_sigma_px, "a number >= 0");
  require(o.max_sigma_px > o.min_sigma_px && o.max_sigma_px <= 8.0, "max_sigma_px", o.max_sigma_px,
          "more than min_sigma_px and at most 8");
  require(o.end_columns >= 0, "end_columns", o.end_columns, "0 or more");
  require(o.min_run_columns >= 1, "min_run_columns", o.min_run_columns, "1 or more");
  require(n.bit_depth >= 8 && n.bit_depth <= 16, "bit_depth", n.bit_depth, "8 to 16");
  positive("gain_dn_per_e", n.gain_dn_per_e);
  positive("full_well_e", n.full_well_e);
  require(n.read_noise_e >= 0.0, "read_noise_e", n.read_noise_e, "a number >= 0");
  require(n.dsnu_e >= 0.0, "dsnu_e", n.dsnu_e, "a number >= 0");
  require(n.prnu >= 0.0 && n.prnu < 1.0, "prnu", n.prnu, "a number from 0 to below 1");
  require(n.speckle_contrast >= 0.0 && n.speckle_contrast <= 1.0, "speckle_contrast", n.speckle_contrast,
          "a number from 0 to 1");
  require(n.black_level_dn >= 0.0, "black_level_dn", n.black_level_dn, "a number >= 0");
}

/// Returns the saturation level: four standard deviations of read noise below full scale.
float saturation_level(const ImageNoise& n) {
  const double clipped = std::exp2(n.bit_depth) - 1.0;
  const double full = n.black_level_dn + n.gain_dn_per_e * (n.full_well_e - 4.0 * n.read_noise_e) - 0.5;
  return static_cast<float>(std::min(clipped, full) - 0.25);
}

/// In the order of PeakDetector.
constexpr LocateFunction* kLocators[] = {locate_gaussian,
                                         locate_centre_of_gravity,
                                         locate_parabola,
                                         locate_log_parabola,
                                         locate_blais_rioux_4,
                                         locate_blais_rioux_8,
                                         locate_derivative_of_gaussian,
                                         locate_steger};

bool chosen_by_rank(PeakChoice choice) {
  return choice == PeakChoice::kBrightest || choice == PeakChoice::kFirst || choice == PeakChoice::kLast;
}

}  // namespace

class Extractor::Impl {
 public:
  Impl(const ExtractionOptions& options, const ImageNoise& noise, SheetGeometry geometry, bool all_peaks)
      : options_(options),
        image_noise_(noise),
        geometry_(std::move(geometry)),
        all_peaks_(all_peaks),
        interpolation_error_(*kLocators[static_cast<std::size_t>(options.detector)]) {
    validate(options, noise, geometry_);
    const double dark_dn = noise.gain_dn_per_e * std::hypot(noise.read_noise_e, noise.dsnu_e);
    noise_.variance_floor = static_cast<float>(dark_dn * dark_dn + 1.0 / 12.0);
    noise_.gain = static_cast<float>(noise.gain_dn_per_e);
    noise_.pattern = static_cast<float>(noise.prnu * noise.prnu);
    noise_.saturation = saturation_level(noise);
    difference_ = std::make_unique<BackgroundSubtraction>(noise, noise_.saturation);
    for (const Camera& camera : geometry_.cameras) {
      speckle_.push_back(speckle_noise(camera, noise.wavelength, noise.speckle_contrast));
    }
  }

  void measure(ImageView<const std::uint16_t> image, int camera) {
    PixelNoise noise = noise_;
    const auto black = static_cast<float>(image_noise_.black_level_dn);
    light_.measure(image, black, noise);
    noise.background = light_.level();
    // Background light adds shot noise, and is modulated by the pixel sensitivities as the stripe is.
    const float light = noise.background - black;
    noise.variance_floor += (noise.gain + noise.pattern * light) * light;
    noise.gain += 2.0f * noise.pattern * light;
    noise.dark_variance = light_.is_uniform() ? light_.variance() : noise.variance_floor;
    measure_stripe(image, noise, nullptr, 1.0f, camera);
  }

  void measure(ImageRows image, ImageRows background, int camera) {
    measure_stripe(difference_->subtract(image, background), difference_->noise(), &background,
                   difference_->dn_per_count(), camera);
  }

  void finish(std::int64_t frame, Peaks& out) {
    cameras_.resize(measured_);
    if (options_.peak == PeakChoice::kAgreement) compare_cameras(cameras_, geometry_, options_.agreement_px);
    for (CameraPeaks& peaks : cameras_) {
      flag_chosen(peaks, choose(peaks));
      store(peaks, frame, out);
    }
    measured_ = 0;
  }

 private:
  /// `background` is not null when the image is a difference from it. `image` and `noise` are in counts of
  /// `dn_per_count`, `background` in digital numbers.
  void measure_stripe(ImageRows image, PixelNoise noise, const ImageRows* background, float dn_per_count,
                      int camera) {
    if (image.width < 1 || image.height < 3) {
      throw std::invalid_argument("image of " + std::to_string(image.width) + " x " +
                                  std::to_string(image.height) + " pixels: expected at least 1 x 3");
    }
    noise.speckle = speckle_[static_cast<std::size_t>(camera)];
    const auto black = static_cast<float>(image_noise_.black_level_dn);
    if (background != nullptr) noise.dark_variance = noise.variance_floor;
    PixelNoise lit_noise = noise;
    if (background != nullptr) {
      light_.measure(*background, black, noise_);
      lit_noise.variance_floor += 2.0f * noise.gain * std::max(0.0f, light_.level() - black) / dn_per_count;
    }
    const double noise_of_sum = std::sqrt(3.0 * static_cast<double>(lit_noise.variance_floor));
    // A stripe of the minimum amplitude has a sum over three rows of at least about its amplitude.
    const double least = options_.min_amplitude_dn / static_cast<double>(dn_per_count);
    const auto threshold = static_cast<float>(std::max(options_.threshold_sigma * noise_of_sum, least));
    CameraPeaks& peaks = next();
    peaks.camera = camera;
    std::vector<Candidate>& found = finder_.find(image, lit_noise, threshold, image_noise_.bit_depth);
    if (background != nullptr)
      add_background_noise(*background, black, dn_per_count, noise, options_.threshold_sigma, found);
    measure_candidates(image, noise, threshold, found, false, peaks);
    if (background == nullptr && !light_.is_uniform()) {
      // The halo of a stripe varies as well, but its core lies on one level.
      above_light_.camera = camera;
      measure_candidates(image, noise, threshold, find_above_light(image, lit_noise, threshold), true,
                         above_light_);
      if (valid(above_light_) >= valid(peaks)) std::swap(above_light_, peaks);
    }
    for (StripeFit& fit : peaks.fits) fit.amplitude *= dn_per_count;
    for (StripeFit& fit : peaks.fits) flag_shape(options_, fit);
  }

  /// Measures the candidates `found` on one level, or each on the line through the levels beside it.
  void measure_candidates(ImageRows image, const PixelNoise& noise, float threshold,
                          std::vector<Candidate>& found, bool varies, CameraPeaks& peaks) {
    set_limits(found, image.height);
    peaks.candidates = found;
    // Candidates that cannot be chosen are not measured.
    if (chosen_by_rank(options_.peak) && !all_peaks_) keep_by_rank(options_.peak, peaks.candidates);
    const auto max_sigma = static_cast<float>(options_.max_sigma_px);
    for (Candidate& candidate : peaks.candidates) {
      if (!varies) candidate.background = noise.background;
      estimate_shape(image, noise, max_sigma, candidate);
      // Width and background depend on each other.
      for (int pass = 0; varies && pass < 2; ++pass) {
        measure_background(image, noise, threshold, candidate);
        estimate_shape(image, noise, max_sigma, candidate);
      }
    }
    peaks.fits.resize(peaks.candidates.size());
    LocateFunction* const locate = kLocators[static_cast<std::size_t>(options_.detector)];
    locate(image, noise, peaks.candidates.data(), peaks.candidates.size(), peaks.fits.data());
    for (StripeFit& fit : peaks.fits) {
      fit.row_sigma = std::hypot(fit.row_sigma, interpolation_error_.at(fit.width));
    }
  }

  /// Returns the number of peaks that are not rejected by their shape.
  std::size_t valid(const CameraPeaks& peaks) const {
    std::size_t count = 0;
    for (StripeFit fit : peaks.fits) {
      flag_shape(options_, fit);
      count += (fit.flags & kPeakRejected) == 0 ? 1 : 0;
    }
    return count;
  }

  /// Finds candidates in the image less its smooth background, which their `background` follows.
  std::vector<Candidate>& find_above_light(ImageRows image, PixelNoise noise, float threshold) {
    const int full = (1 << image_noise_.bit_depth) - 1;
    const int pedestal = full / 8;  // exceeds any noise
    const int largest = std::min(full + pedestal, 0xFFFF);
    const auto variance = [&](float level) {
      const float light = std::max(0.0f, level - static_cast<float>(image_noise_.black_level_dn));
      return (noise_.gain + noise_.pattern * light) * light;
    };
    noise.background = static_cast<float>(pedestal);
    std::vector<Candidate>& found =
        finder_.find(light_.subtract(image, pedestal, largest), noise, threshold, image_noise_.bit_depth + 1);
    std::size_t kept = 0;
    for (Candidate& c : found) {
      light_.place(c);
      c.light_variance = variance(c.background_at((c.first_row + c.last_row) / 2)) - variance(light_.level());
      const float deviation = std::sqrt(3.0f * (noise.variance_floor + c.light_variance));
      if (c.strength - 3.0f * noise.background > static_cast<float>(options_.threshold_sigma) * deviation) {
        found[kept++] = c;
      }
    }
    found.resize(kept);
    return found;
  }

  CameraPeaks& next() {
    if (measured_ == cameras_.size()) cameras_.emplace_back();
    return cameras_[measured_++];
  }

  std::vector<std::size_t> choose(const CameraPeaks& peaks) const {
    return chosen_by_rank(options_.peak) ? choose_by_rank(options_.peak, peaks.candidates)
                                         : choose_continuous(peaks, options_.continuity_px);
  }

  /// Flags the chosen peaks by their neighbours and all others as passed over; removes the others unless all
  /// peaks are requested.
  void flag_chosen(CameraPeaks& peaks, const std::vector<std::size_t>& chosen) {
    candidates_.clear();
    fits_.clear();
    for (const std::size_t i : chosen) {
      candidates_.push_back(peaks.candidates[i]);
      fits_.push_back(peaks.fits[i]);
      if (options_.peak == PeakChoice::kAgreement && peaks.agreement[i] == CameraAgreement::kContradicted) {
        fits_.back().flags |= kPeakUnconfirmed;
      }
    }
    flag_neighbours(options_, candidates_, fits_);
    if (!all_peaks_) {
      std::swap(peaks.candidates, candidates_);
      std::swap(peaks.fits, fits_);
      return;
    }
    for (StripeFit& fit : peaks.fits) fit.flags |= kPeakPassedOver;
    for (std::size_t k = 0; k < chosen.size(); ++k) peaks.fits[chosen[k]] = fits_[k];
  }

  static void store(const CameraPeaks& peaks, std::int64_t frame, Peaks& out) {
    for (std::size_t i = 0; i < peaks.fits.size(); ++i) {
      const StripeFit& fit = peaks.fits[i];
      out.frame.push_back(frame);
      out.camera.push_back(peaks.camera);
      out.column.push_back(peaks.candidates[i].column);
      out.row.push_back(fit.row);
      out.amplitude.push_back(fit.amplitude);
      out.width.push_back(fit.width);
      out.row_sigma.push_back(fit.row_sigma);
      out.asymmetry.push_back(fit.asymmetry);
      out.residual.push_back(fit.residual);
      out.flags.push_back(fit.flags);
    }
  }

  ExtractionOptions options_;
  ImageNoise image_noise_;
  SheetGeometry geometry_;
  bool all_peaks_;
  PixelNoise noise_;
  std::unique_ptr<BackgroundSubtraction> difference_;
  std::vector<SpeckleNoise> speckle_;  // per camera
  InterpolationError interpolation_error_;
  CandidateFinder finder_;
  BackgroundLight light_;
  CameraPeaks above_light_;
  std::vector<CameraPeaks> cameras_;
  std::size_t measured_ = 0;  // number of entries of cameras_ of this exposure
  std::vector<Candidate> candidates_;
  std::vector<StripeFit> fits_;
};

Extractor::Extractor(const ExtractionOptions& options, const ImageNoise& noise, const SheetGeometry& geometry,
                     bool all_peaks)
    : impl_(std::make_unique<Impl>(options, noise, geometry, all_peaks)) {}
Extractor::~Extractor() = default;
Extractor::Extractor(Extractor&&) noexcept = default;
Extractor& Extractor::operator=(Extractor&&) noexcept = default;

void Extractor::measure(ImageView<const std::uint16_t> image, int camera) { impl_->measure(image, camera); }

void Extractor::measure(ImageView<const std::uint16_t> image, ImageView<const std::uint16_t> background,
                        int camera) {
  impl_->measure(image, background, camera);
}

void Extractor::finish(std::int64_t frame, Peaks& out) { impl_->finish(frame, out); }

}  // namespace sensor_rt
