#include "sensor_rt/pipeline/stripe_response.h"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "sensor_rt/geometry/image.h"
#include "sensor_rt/geometry/multiversion.h"
#include "sensor_rt/geometry/recent.h"

namespace sensor_rt {
namespace {

constexpr int kPhases = 8;               // number of sub-pixel positions
constexpr float kMinSigma = 0.25f;       // px
constexpr int kWidthOctaves = 6;         // up to 16 px, twice the largest max_sigma_px
constexpr double kOverexposure = 128.0;  // times the full scale; brighter stripes are not measurable
/// Flags that reject a stripe independently of its noise.
constexpr std::uint32_t kRejected = kPeakRejected & ~(kPeakWeak | kPeakNarrow | kPeakWide);
constexpr double kRootTwoPi = 2.5066282746310002;

double normal_cdf(double x) { return 0.5 * std::erfc(-x * M_SQRT1_2); }

/// Columns to either side over which Steger's detector averages.
int margin(PeakDetector detector) { return detector == PeakDetector::kSteger ? 18 : 0; }

/// Treats every column separately.
ExtractionOptions without_neighbours(ExtractionOptions options) {
  constexpr double kAny = 1e9;
  options.peak = PeakChoice::kBrightest;
  options.max_row_jump_px = options.max_amplitude_jump = options.max_width_jump = kAny;
  options.end_columns = 0;
  options.min_run_columns = 1;
  return options;
}

/// Image in counts finer than digital numbers, so that noise-free images are not rounded. The rounding noise
/// is added to the read noise, and the full well keeps the saturation level where it was.
struct FineImage {
  ExtractionOptions options;
  ImageNoise noise;
  double per_dn = 1.0;
  double clipped = 0.0;  ///< value of a saturated pixel, fine counts

  FineImage(const ExtractionOptions& given, const ImageNoise& coarse)
      : options(without_neighbours(given)), noise(coarse) {
    constexpr int kFinest = 14;
    noise.bit_depth = std::max(kFinest, coarse.bit_depth);
    per_dn = std::exp2(noise.bit_depth - coarse.bit_depth);
    options.min_amplitude_dn *= per_dn;
    const double gain = coarse.gain_dn_per_e;
    noise.read_noise_e = std::hypot(coarse.read_noise_e, 1.0 / (std::sqrt(12.0) * gain));
    noise.full_well_e = coarse.full_well_e + 4.0 * (noise.read_noise_e - coarse.read_noise_e);
    noise.black_level_dn = per_dn * coarse.black_level_dn;
    noise.gain_dn_per_e = per_dn * gain;
    clipped = std::min(std::exp2(noise.bit_depth) - 1.0,
                       per_dn * (coarse.black_level_dn + gain * coarse.full_well_e));
  }
};

SENSOR_RT_MULTIVERSION
void locate_on_axis(float scale, float end, const float* __restrict values, std::int32_t* __restrict index,
                    float* __restrict share) {
  constexpr std::int32_t kStepBits = 21;  // of 23 mantissa bits, below the two that give the step index
  constexpr std::int32_t kOne = 127 << 2;
  for (int l = 0; l < kLanes; ++l) {
    const float raised = values[l] * scale > 1.0f ? values[l] * scale : 1.0f;
    const float scaled = raised < end ? raised : end;
    std::int32_t bits = 0;
    std::memcpy(&bits, &scaled, sizeof bits);
    index[l] = (bits >> kStepBits) - kOne;
    share[l] = static_cast<float>(bits & ((1 << kStepBits) - 1)) * 0x1p-21f;
  }
}

/// `values`: those of Node as arrays; `limits`: smallest and largest height and largest width.
SENSOR_RT_MULTIVERSION
void finish_reading(const float* __restrict height, const float* __restrict width,
                    const float* __restrict limits, const float (&values)[4][kLanes],
                    StripeResponse::Reading& __restrict out) {
  for (int l = 0; l < kLanes; ++l) {
    const float share = values[3][l];
    const bool found =
        (share >= 0.5f) & (height[l] >= limits[0]) & (height[l] <= limits[1]) & (width[l] <= limits[2]);
    const float inverse = 1.0f / (found ? share : 1.0f);
    out.row_sigma[l] = found ? values[0][l] * inverse / height[l] : 0.0f;
    out.amplitude[l] = values[1][l] * inverse * height[l];
    out.saturated[l] = values[2][l] * inverse;
  }
}

}  // namespace

float StripeResponse::Axis::node(int i) const {
  return first * std::ldexp(1.0f + 0.25f * static_cast<float>(i % 4), i / 4);
}

void StripeResponse::find_positions(const Axis& axis, const float* values, AxisPositions& positions) {
  locate_on_axis(1.0f / axis.first, std::ldexp(0.9999999f, axis.octaves), values, positions.index,
                 positions.share);
}

StripeResponse::StripeResponse(const ExtractionOptions& options, const ImageNoise& noise,
                               const Camera& camera, bool laser_off, bool background)
    : height_(height_axis(noise)),
      width_{kMinSigma, kWidthOctaves},
      per_level_(static_cast<std::size_t>(width_.nodes() * height_.nodes())),
      background_e_{0.0} {
  for (double share = 1.0 / 1024.0; background && share <= 1.0; share *= 4.0) {
    background_e_.push_back(share * noise.full_well_e);
  }
  nodes_.resize(background_e_.size() * per_level_);
  for (std::size_t level = 0; level < background_e_.size(); ++level) {
    fill(level, options, noise, camera, laser_off);
  }
}

StripeResponse::Axis StripeResponse::height_axis(const ImageNoise& noise) {
  // Stripes below half of the noise are never detected.
  const double lowest = 0.5 * std::hypot(noise.gain_dn_per_e * noise.read_noise_e, 1.0 / std::sqrt(12.0));
  const double highest = kOverexposure * std::exp2(noise.bit_depth);
  return {static_cast<float>(lowest), static_cast<int>(std::ceil(std::log2(highest / lowest)))};
}

void StripeResponse::fill(std::size_t level, const ExtractionOptions& options, const ImageNoise& noise,
                          const Camera& camera, bool laser_off) {
  const FineImage fine(options, noise);
  const double dark =
      std::min(fine.noise.black_level_dn + fine.noise.gain_dn_per_e * background_e_[level], fine.clipped);
  const auto background = static_cast<std::uint16_t>(std::lround(dark));
  Extractor extractor(fine.options, fine.noise, {{camera}, {}, 0.0, 0.0, 1.0}, false);
  const int skipped = margin(options.detector);
  const int cell = kPhases + 2 * skipped;
  const int heights = height_.nodes();
  Image<std::uint16_t> image;
  Image<std::uint16_t> off;
  std::vector<double> shape;
  Peaks peaks;
  for (int w = 0; w < width_.nodes(); ++w) {
    const double width = static_cast<double>(width_.node(w));
    const int lit = static_cast<int>(std::ceil(6.0 * width)) + 2;  // rows to either side
    const int rows = 6 * lit + 48;                                 // most of them dark
    const int middle = rows / 2;
    image.resize(heights * cell, rows, background);
    shape.resize(static_cast<std::size_t>(2 * lit + 1));
    for (int k = 0; k < cell; ++k) {
      const double phase = (k - skipped + 0.5) / kPhases - 0.5;
      for (int y = -lit; y <= lit; ++y) {
        shape[static_cast<std::size_t>(y + lit)] =
            kRootTwoPi * width *
            (normal_cdf((y + 0.5 - phase) / width) - normal_cdf((y - 0.5 - phase) / width));
      }
      for (int h = 0; h < heights; ++h) {
        const double height = fine.per_dn * static_cast<double>(height_.node(h));
        for (int y = -lit; y <= lit; ++y) {
          const double value = dark + height * shape[static_cast<std::size_t>(y + lit)];
          image.view().at(middle + y, h * cell + k) =
              static_cast<std::uint16_t>(std::lround(std::min(value, fine.clipped)));
        }
      }
    }
    if (laser_off) {
      off.resize(heights * cell, rows, background);
      extractor.measure(std::as_const(image).view(), std::as_const(off).view(), 0);
    } else {
      extractor.measure(std::as_const(image).view(), 0);
    }
    peaks.clear();
    extractor.finish(0, peaks);
    Node* to = &nodes_[level * per_level_ + static_cast<std::size_t>(w * heights)];
    for (std::size_t i = 0; i < peaks.size(); ++i) {
      const int k = peaks.column[i] % cell - skipped;
      if (k < 0 || k >= kPhases || (peaks.flags[i] & kRejected) != 0) continue;
      const int h = peaks.column[i] / cell;
      const float height = height_.node(h);
      float* node = to[h].v;
      node[Node::kScaledSigma] += peaks.row_sigma[i] * height / kPhases;
      node[Node::kAmplitude] += peaks.amplitude[i] / (static_cast<float>(fine.per_dn) * height) / kPhases;
      node[Node::kSaturated] += (peaks.flags[i] & kPeakSaturated) != 0 ? 1.0f / kPhases : 0.0f;
      node[Node::kFound] += 1.0f / kPhases;
    }
  }
}

StripeResponse::Node StripeResponse::mean(std::size_t level, const AxisPositions& height,
                                          const AxisPositions& width, int l) const {
  const int heights = height_.nodes();
  const Node* narrow =
      &nodes_[level * per_level_ + static_cast<std::size_t>(width.index[l] * heights + height.index[l])];
  const Node* wide = narrow + heights;
  const float b = (1.0f - width.share[l]) * height.share[l];
  const float d = width.share[l] * height.share[l];
  const float a = (1.0f - width.share[l]) - b;
  const float c = width.share[l] - d;
  Node result;
  for (int k = 0; k < Node::kValues; ++k) {
    result.v[k] = a * narrow[0].v[k] + b * narrow[1].v[k] + c * wide[0].v[k] + d * wide[1].v[k];
  }
  return result;
}

StripeResponse::Node StripeResponse::mean(double background_e, const AxisPositions& height,
                                          const AxisPositions& width, int l) const {
  const auto above = std::upper_bound(background_e_.begin() + 1, background_e_.end() - 1, background_e);
  const auto level = static_cast<std::size_t>(above - background_e_.begin());
  const double low = background_e_[level - 1];
  const auto share = static_cast<float>(std::min(1.0, (background_e - low) / (background_e_[level] - low)));
  const Node dark = mean(level - 1, height, width, l);
  const Node bright = mean(level, height, width, l);
  Node result;
  for (int k = 0; k < Node::kValues; ++k) result.v[k] = (1.0f - share) * dark.v[k] + share * bright.v[k];
  // The variance grows in proportion to the background.
  const auto square = [](const Node& node) {
    return node.v[Node::kScaledSigma] * node.v[Node::kScaledSigma];
  };
  result.v[Node::kScaledSigma] = std::sqrt((1.0f - share) * square(dark) + share * square(bright));
  return result;
}

void StripeResponse::read(const float* height_dn, const float* width_px, const float* background_e,
                          Reading& reading) const {
  AxisPositions height;
  AxisPositions width;
  find_positions(height_, height_dn, height);
  find_positions(width_, width_px, width);
  alignas(64) float values[Node::kValues][kLanes];
  for (int l = 0; l < kLanes; ++l) {
    const Node node = background_e_.size() > 1 ? mean(static_cast<double>(background_e[l]), height, width, l)
                                               : mean(std::size_t{0}, height, width, l);
    for (int k = 0; k < Node::kValues; ++k) values[k][l] = node.v[k];
  }
  const float limits[] = {height_.first, height_.last(), width_.last()};
  finish_reading(height_dn, width_px, limits, values, reading);
}

std::shared_ptr<const StripeResponse> StripeResponse::shared(const ExtractionOptions& o, const ImageNoise& n,
                                                             const Camera& camera, bool laser_off,
                                                             bool background) {
  using Key = std::vector<double>;
  constexpr std::size_t kKept = 8;
  static Recent<Key, StripeResponse> recent(kKept);
  Key key{static_cast<double>(o.detector),
          o.threshold_sigma,
          o.min_amplitude_dn,
          o.min_sigma_px,
          o.max_sigma_px,
          o.max_asymmetry,
          o.max_residual,
          n.black_level_dn,
          n.gain_dn_per_e,
          n.read_noise_e,
          n.full_well_e,
          static_cast<double>(n.bit_depth),
          n.dsnu_e,
          n.prnu,
          laser_off ? 1.0 : 0.0,
          background ? 1.0 : 0.0};
  if (n.speckle_contrast > 0.0) {  // without speckle the response does not depend on the camera
    key.insert(key.end(), {n.speckle_contrast, n.wavelength, camera.f_number, camera.pixel_pitch});
  }
  return recent.get(key, [&] { return StripeResponse(o, n, camera, laser_off, background); });
}

}  // namespace sensor_rt
