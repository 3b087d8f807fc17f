#include "sensor_rt/imaging/extract.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string>
#include <vector>

#include "sensor_rt/imaging/stripe.h"

namespace sensor_rt {
namespace {

void require(bool condition, const char* name, double value, const char* expected) {
  if (!condition) {
    throw std::invalid_argument(std::string("extraction.") + name + " = " + std::to_string(value) +
                                ": expected " + expected);
  }
}

void validate(const ExtractionOptions& o, const ImageNoise& n) {
  const auto positive = [](const char* name, double value) {
    require(value > 0.0 && std::isfinite(value), name, value, "a finite number > 0");
  };
  positive("threshold_sigma", o.threshold_sigma);
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
  require(n.black_level_dn >= 0.0, "black_level_dn", n.black_level_dn, "a number >= 0");
}

/// Everything from four standard deviations of read noise below saturation on is not trusted.
float saturation_level(const ImageNoise& n) {
  const double clipped = std::exp2(n.bit_depth) - 1.0;
  const double full = n.black_level_dn + n.gain_dn_per_e * (n.full_well_e - 4.0 * n.read_noise_e) - 0.5;
  return static_cast<float>(std::min(clipped, full) - 0.25);
}

/// Background of the image: the black level, unless the median of a sample of pixels shows that light is
/// everywhere.
float background_level(ImageRows image, double black, std::vector<std::uint16_t>& sample) {
  constexpr int kRows = 64;
  constexpr int kColumns = 64;
  sample.clear();
  for (int i = 0; i < kRows; ++i) {
    const int y = static_cast<int>((static_cast<long>(2 * i + 1) * image.height) / (2 * kRows));
    for (int j = 0; j < kColumns; ++j) {
      const int x = static_cast<int>((static_cast<long>(2 * j + 1) * image.width) / (2 * kColumns));
      sample.push_back(image.at(y, x));
    }
  }
  const auto middle = sample.begin() + static_cast<std::ptrdiff_t>(sample.size() / 2);
  std::nth_element(sample.begin(), middle, sample.end());
  const auto median = static_cast<double>(*middle);
  return static_cast<float>(std::fabs(median - black) <= 1.0 ? black : median);
}

LocateFunction locator(PeakDetector detector) {
  return detector == PeakDetector::kGaussian ? locate_gaussian : locate_centre_of_gravity;
}

}  // namespace

class Extractor::Impl {
 public:
  Impl(const ExtractionOptions& options, const ImageNoise& noise) : options_(options), image_noise_(noise) {
    validate(options, noise);
    const double dark_dn = noise.gain_dn_per_e * std::hypot(noise.read_noise_e, noise.dsnu_e);
    noise_.variance_floor = static_cast<float>(dark_dn * dark_dn + 1.0 / 12.0);
    noise_.gain = static_cast<float>(noise.gain_dn_per_e);
    noise_.saturation = saturation_level(noise);
  }

  void extract(ImageView<const std::uint16_t> image, std::int64_t frame, int camera, Peaks& out) {
    if (image.width < 1 || image.height < 3) {
      throw std::invalid_argument("image of " + std::to_string(image.width) + " x " +
                                  std::to_string(image.height) + " pixels: expected at least 1 x 3");
    }
    noise_.background = background_level(image, image_noise_.black_level_dn, sample_);
    const double noise_of_sum = std::sqrt(3.0 * static_cast<double>(noise_.variance_floor));
    // A stripe of the least amplitude lights three rows by at least about its own amplitude.
    const auto threshold =
        static_cast<float>(std::max(options_.threshold_sigma * noise_of_sum, options_.min_amplitude_dn));
    choose(finder_.find(image, noise_, threshold, image_noise_.bit_depth));
    for (Candidate& candidate : chosen_) guess(image, noise_.background, candidate);
    fits_.resize(chosen_.size());
    locator(options_.detector)(image, noise_, chosen_.data(), chosen_.size(), fits_.data());
    judge(options_, chosen_, fits_);
    store(frame, camera, out);
  }

 private:
  /// One candidate per column.
  void choose(const std::vector<Candidate>& candidates) {
    chosen_.clear();
    for (const Candidate& c : candidates) {
      if (chosen_.empty() || chosen_.back().column != c.column) {
        chosen_.push_back(c);
      } else if (options_.peak == PeakChoice::kLast ||
                 (options_.peak == PeakChoice::kBrightest && c.strength > chosen_.back().strength)) {
        chosen_.back() = c;
      }
    }
  }

  void store(std::int64_t frame, int camera, Peaks& out) const {
    for (std::size_t i = 0; i < fits_.size(); ++i) {
      const StripeFit& fit = fits_[i];
      out.frame.push_back(frame);
      out.camera.push_back(camera);
      out.column.push_back(chosen_[i].column);
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
  PixelNoise noise_;
  CandidateFinder finder_;
  std::vector<std::uint16_t> sample_;
  std::vector<Candidate> chosen_;
  std::vector<StripeFit> fits_;
};

Extractor::Extractor(const ExtractionOptions& options, const ImageNoise& noise)
    : impl_(std::make_unique<Impl>(options, noise)) {}
Extractor::~Extractor() = default;
Extractor::Extractor(Extractor&&) noexcept = default;
Extractor& Extractor::operator=(Extractor&&) noexcept = default;

void Extractor::extract(ImageView<const std::uint16_t> image, std::int64_t frame, int camera, Peaks& out) {
  impl_->extract(image, frame, camera, out);
}

}  // namespace sensor_rt
