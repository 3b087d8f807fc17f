#include "sensor_rt/detector/electrons.h"

#include <algorithm>
#include <cmath>

#include "sensor_rt/geometry/multiversion.h"
#include "sensor_rt/geometry/random.h"

namespace sensor_rt {
namespace {

enum Purpose : std::uint32_t { kDark = 1, kLit = 2, kDsnu = 3, kPrnu = 4, kRow = 5, kHot = 6 };

/// Returns an independent random key for a purpose, camera and frame.
std::array<std::uint32_t, 2> purpose_key(std::uint64_t seed, Purpose purpose, int camera,
                                         std::int64_t frame) {
  const auto bits = static_cast<std::uint64_t>(frame);
  const auto block = philox4x32({purpose, static_cast<std::uint32_t>(camera),
                                 static_cast<std::uint32_t>(bits), static_cast<std::uint32_t>(bits >> 32)},
                                {static_cast<std::uint32_t>(seed), static_cast<std::uint32_t>(seed >> 32)});
  return {block[0], block[1]};
}

/// Finaliser of MurmurHash3 (Appleby, public domain): a bijection that mixes 32 bits.
inline std::uint32_t mix(std::uint32_t h) {
  h ^= h >> 16;
  h *= 0x85EBCA6Bu;
  h ^= h >> 13;
  h *= 0xC2B2AE35u;
  return h ^ (h >> 16);
}

/// Returns 32 random bits for a pixel. Mixed twice with a key in between: otherwise images whose first keys
/// are close would be shifted copies.
inline std::uint32_t pixel_bits(std::uint32_t pixel, std::uint32_t key0, std::uint32_t key1) {
  return mix(mix(pixel + key0) ^ key1);
}

/// Parameters of the conversion from electrons to digital number for dark pixels.
struct DarkScale {
  float gain;
  float black;
  float max_dn;
};

inline std::uint16_t quantise_dark(const DarkScale& s, float electrons) {
  const float value = s.black + s.gain * electrons;
  const float positive = value < 0.0f ? 0.0f : value;
  const float clipped = positive > s.max_dn ? s.max_dn : positive;
  return static_cast<std::uint16_t>(static_cast<std::int32_t>(clipped + 0.5f));
}

/// Block size of the sampling of dark pixels. Three loops per block: table positions, gathers, quantisation.
/// Only the gathers are scalar.
constexpr int kBlock = 128;

struct alignas(64) Draw {
  std::uint32_t segment[kBlock];
  float along[kBlock];
  QuantileTable::Segment segments[kBlock];
};

SENSOR_RT_MULTIVERSION void find_positions(std::uint32_t first, std::uint32_t key0, std::uint32_t key1,
                                           Draw& draw) {
  for (int i = 0; i < kBlock; ++i) {
    const QuantileTable::Position at =
        QuantileTable::position(pixel_bits(first + static_cast<std::uint32_t>(i), key0, key1));
    draw.segment[i] = at.segment;
    draw.along[i] = at.along;
  }
}

void look_up(const QuantileTable& table, Draw& draw) {
  for (int i = 0; i < kBlock; ++i) draw.segments[i] = table.segment(draw.segment[i]);
}

/// Random bits that may give another digital number than the most frequent one: those with a tail probability
/// below these limits.
struct RareBits {
  std::uint32_t lower;
  std::uint32_t upper;

  double probability() const { return 0x1p-32 * (static_cast<double>(lower) + static_cast<double>(upper)); }
  /// Returns the rare bits that belong to uniformly distributed bits.
  std::uint32_t draw(std::uint32_t bits) const {
    const auto at = static_cast<std::uint32_t>(bits * (std::uint64_t{lower} + upper) >> 32);
    return at < lower ? at : (1u << 31) | (at - lower);
  }
};

/// Returns the rare bits of pixels whose fixed offset is at most `farthest` electrons.
RareBits rare_bits(const DarkScale& s, const QuantileTable& table, float farthest, std::uint16_t usual) {
  constexpr float kRounding = 1e-3f;  // electrons: samples depend on the tail monotonically but for rounding
  farthest += kRounding;
  const auto limit = [&](std::uint32_t tail) {
    std::uint32_t rare = 0;
    for (std::uint32_t step = 1u << 30; step > 0; step >>= 1) {
      const float electrons = table.sample(tail | (rare + step));
      const bool is_usual =
          quantise_dark(s, electrons - farthest) == usual && quantise_dark(s, electrons + farthest) == usual;
      if (!is_usual) rare += step;
    }
    return rare + 1;
  };
  return {limit(0), limit(1u << 31)};
}

SENSOR_RT_MULTIVERSION void write_uniform(const DarkScale& s, const Draw& __restrict draw, float offset,
                                          int count, std::uint16_t* __restrict out) {
  for (int i = 0; i < count; ++i) {
    out[i] = quantise_dark(s, draw.segments[i].value + draw.segments[i].slope * draw.along[i] + offset);
  }
}

SENSOR_RT_MULTIVERSION void write_patterned(const DarkScale& s, const Draw& __restrict draw,
                                            const float* __restrict pattern, float offset, int count,
                                            std::uint16_t* __restrict out) {
  for (int i = 0; i < count; ++i) {
    const float electrons = draw.segments[i].value + draw.segments[i].slope * draw.along[i];
    out[i] = quantise_dark(s, electrons + (pattern[i] + offset));
  }
}

SENSOR_RT_MULTIVERSION void write_pattern(float deviation, const Draw& __restrict draw, int count,
                                          float* __restrict out) {
  for (int i = 0; i < count; ++i) {
    out[i] = deviation * (draw.segments[i].value + draw.segments[i].slope * draw.along[i]);
  }
}

}  // namespace

double poisson(double mean, std::uint32_t bits) {
  if (mean < 16.0) {
    const double u = (bits + 0.5) * 0x1p-32;
    double probability = std::exp(-mean);
    double cdf = probability;
    double k = 0.0;
    while (u > cdf && probability > 0.0) {
      k += 1.0;
      probability *= mean / k;
      cdf += probability;
    }
    return k;
  }
  const double w = standard_normal().sample(bits);
  const double w2 = w * w;
  const double root = std::sqrt(mean);
  const double x = mean + root * w + (1.0 / 3.0 + w2 / 6.0) - w * (1.0 / 36.0 + w2 / 72.0) / root +
                   (-8.0 / 405.0 + w2 * (7.0 / 810.0 + w2 / 270.0)) / mean;
  return std::max(0.0, std::floor(x));
}

PixelModel::PixelModel(const DetectorParameters& p, bool noise, std::uint64_t seed, const FrameId& id)
    : noise_(noise),
      dark_e_(p.dark_current_e_per_s * id.exposure),
      full_well_e_(p.full_well_e),
      read_noise_e_(p.read_noise_e),
      gain_(p.gain_dn_per_e),
      black_(p.black_level_dn),
      max_dn_(std::exp2(p.bit_depth) - 1.0),
      prnu_(static_cast<float>(p.prnu)),
      dsnu_e_(static_cast<float>(p.dsnu_e)),
      row_noise_e_(static_cast<float>(p.row_noise_e)),
      hot_below_(static_cast<std::uint64_t>(0x1p32 * p.hot_pixels)),
      hot_e_(p.hot_pixel_e_per_s * id.exposure),
      dark_key_(purpose_key(seed, kDark, id.camera, id.frame)),
      lit_key_(purpose_key(seed, kLit, id.camera, id.frame)),
      dsnu_key_(purpose_key(seed, kDsnu, id.camera, 0)),
      prnu_key_(purpose_key(seed, kPrnu, id.camera, 0)),
      row_key_(purpose_key(seed, kRow, id.camera, id.frame)),
      hot_key_(purpose_key(seed, kHot, id.camera, 0)) {}

std::uint16_t PixelModel::quantise(double electrons) const {
  return static_cast<std::uint16_t>(std::clamp(black_ + gain_ * electrons, 0.0, max_dn_) + 0.5);
}

std::uint16_t PixelModel::without_noise(double electrons) const {
  return quantise(std::min(electrons + dark_e_, full_well_e_));
}

bool PixelModel::is_hot(std::uint32_t pixel) const {
  return pixel_bits(pixel, hot_key_[0], hot_key_[1]) < hot_below_;
}

/// Returns the mean additional charge of a pixel, electrons.
double PixelModel::hot_charge(std::uint32_t pixel) const {
  if (hot_below_ == 0 || !is_hot(pixel)) return 0.0;
  const auto random = philox4x32({pixel, 0, 0, 0}, hot_key_);
  return -hot_e_ * std::log((random[0] + 0.5) * 0x1p-32);
}

/// Returns what the read-out of a row adds to all of its pixels, electrons.
float PixelModel::row_offset(int row) const {
  if (row_noise_e_ == 0.0f) return 0.0f;
  const auto random = philox4x32({static_cast<std::uint32_t>(row), 0, 0, 0}, row_key_);
  return row_noise_e_ * standard_normal().sample(random[0]);
}

std::uint16_t PixelModel::lit(int row, std::uint32_t pixel, float electrons) const {
  // Saturates for certain above this bound, which keeps the arithmetic finite.
  const double light = std::min(static_cast<double>(electrons), 16.0 * full_well_e_ + 1e4);
  if (!noise_) return without_noise(light);
  const QuantileTable& normal = standard_normal();
  double mean = light;
  if (prnu_ > 0.0f) {
    mean *= std::max(0.0f, 1.0f + prnu_ * normal.sample(pixel_bits(pixel, prnu_key_[0], prnu_key_[1])));
  }
  const auto random = philox4x32({pixel, 0, 0, 0}, lit_key_);
  const double dark = std::min(dark_e_ + hot_charge(pixel), 16.0 * full_well_e_ + 1e4);
  double charge = poisson(mean + dark, random[0]);
  if (dsnu_e_ > 0.0f) charge += dsnu_e_ * normal.sample(pixel_bits(pixel, dsnu_key_[0], dsnu_key_[1]));
  return quantise(std::min(charge, full_well_e_) + read_noise_e_ * normal.sample(random[1]) +
                  row_offset(row));
}

void PixelModel::dark_pixels(const QuantileTable& table, const float* pattern,
                             ImageView<std::uint16_t> out) const {
  constexpr double kRare = 0.02;
  const DarkScale scale{static_cast<float>(gain_), static_cast<float>(black_), static_cast<float>(max_dn_)};
  const std::uint16_t usual = quantise_dark(scale, table.sample(0x7FFFFFFFu));
  const float farthest = (dsnu_e_ + row_noise_e_) * standard_normal().sample(1u << 31);
  const RareBits rare = rare_bits(scale, table, farthest, usual);
  if (rare.probability() < kRare) {
    // The gaps between independent rare pixels are distributed geometrically.
    const double pixels_per_log = 1.0 / std::log1p(-rare.probability());
    const double size = static_cast<double>(out.width) * out.height;
    for (int y = 0; y < out.height; ++y) std::fill_n(out.row(y), out.width, usual);
    double next = 0.0;
    for (std::uint32_t k = 0;; ++k) {
      const auto random = philox4x32({k, 0, 0, 0}, dark_key_);
      next += std::floor(pixels_per_log * std::log((random[0] + 0.5) * 0x1p-32));
      if (!(next < size)) return;
      const auto pixel = static_cast<int>(next);
      const int row = pixel / out.width;
      const float offset = (pattern == nullptr ? 0.0f : pattern[pixel]) + row_offset(row);
      out.at(row, pixel % out.width) = quantise_dark(scale, table.sample(rare.draw(random[1])) + offset);
      next += 1.0;
    }
  }
  Draw draw;
  for (int y = 0; y < out.height; ++y) {
    const float offset = row_offset(y);
    for (int x = 0; x < out.width; x += kBlock) {
      const int block = std::min(kBlock, out.width - x);
      const auto first = static_cast<std::uint32_t>(y * out.width + x);
      find_positions(first, dark_key_[0], dark_key_[1], draw);
      look_up(table, draw);
      if (pattern != nullptr) {
        write_patterned(scale, draw, pattern + first, offset, block, out.row(y) + x);
      } else {
        write_uniform(scale, draw, offset, block, out.row(y) + x);
      }
    }
  }
}

std::vector<float> PixelModel::dark_pattern(std::size_t pixels) const {
  std::vector<float> pattern(pixels);
  Draw draw;
  for (std::size_t i = 0; i < pixels; i += kBlock) {
    find_positions(static_cast<std::uint32_t>(i), dsnu_key_[0], dsnu_key_[1], draw);
    look_up(standard_normal(), draw);
    write_pattern(dsnu_e_, draw, static_cast<int>(std::min<std::size_t>(kBlock, pixels - i)), &pattern[i]);
  }
  return pattern;
}

}  // namespace sensor_rt
