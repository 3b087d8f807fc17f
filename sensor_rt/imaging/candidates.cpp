// Detection of stripe candidates, row by row so that the columns are vectorised.
#include <algorithm>
#include <cmath>
#include <numeric>

#include "sensor_rt/geometry/multiversion.h"
#include "sensor_rt/imaging/stripe.h"

namespace sensor_rt {
namespace {

constexpr int kBlock = 64;             // columns that are skipped together when all are dark
constexpr float kValleySigmas = 5.0f;  // a dip between two maxima must exceed the noise by this much ...
constexpr float kValleyShare = 0.1f;   // ... and this share of the higher maximum
constexpr int kLongFlatTop = 6;        // rows; the flanks of shorter ones do not determine the width

/// Computes the largest sum of three rows in each block of columns.
template <typename Sum>
inline void block_maxima(const std::uint16_t* a, const std::uint16_t* b, const std::uint16_t* c, int width,
                         Sum* out) {
  for (int begin = 0; begin < width; begin += kBlock) {
    Sum largest = 0;
    if (begin + kBlock <= width) {
      for (int i = 0; i < kBlock; ++i) {
        const Sum sum = static_cast<Sum>(static_cast<Sum>(a[begin + i] + b[begin + i]) + c[begin + i]);
        largest = sum > largest ? sum : largest;
      }
    } else {
      for (int i = begin; i < width; ++i) {
        const Sum sum = static_cast<Sum>(static_cast<Sum>(a[i] + b[i]) + c[i]);
        largest = sum > largest ? sum : largest;
      }
    }
    *out++ = largest;
  }
}

SENSOR_RT_MULTIVERSION void maxima(const std::uint16_t* a, const std::uint16_t* b, const std::uint16_t* c,
                                   int width, std::uint16_t* out) {
  block_maxima(a, b, c, width, out);
}

SENSOR_RT_MULTIVERSION void maxima(const std::uint16_t* a, const std::uint16_t* b, const std::uint16_t* c,
                                   int width, std::uint32_t* out) {
  block_maxima(a, b, c, width, out);
}

/// Returns the longest run of saturated rows of a candidate that has some.
RowWindow flat_top(ImageRows image, float saturation, const Candidate& c) {
  RowWindow longest{0, -1};
  RowWindow run{0, -1};
  for (int y = std::max(c.lower_limit, c.first_row - 1); y <= std::min(c.upper_limit, c.last_row + 1); ++y) {
    if (static_cast<float>(image.at(y, c.column)) < saturation) {
      run = {0, -1};
      continue;
    }
    run = {run.last < 0 ? y : run.first, y};
    if (run.last - run.first > longest.last - longest.first) longest = run;
  }
  return longest;
}

/// Sets centre and width from the brightest rows, which are saturated or one, and the flanks at half of their
/// signal.
///
/// A bright stripe, and one on a translucent surface, has a halo over tens of rows, uneven and rarely
/// symmetric, which would govern the moments. A Gaussian that is saturated over 2 w rows and exceeds half of
/// the saturation over 2 h rows has the variance (h² - w²) / (2 ln 2).
void estimate_from_flanks(ImageRows image, const RowWindow& flat, Candidate& c) {
  constexpr float kTwoLogTwo = 1.38629436f;
  constexpr float kLeastVariance = 0.1f;  // of h²: a stripe exp(5) times as bright as the saturation
  const float half = 0.5f * c.amplitude;
  const auto signal = [&](int y) { return static_cast<float>(image.at(y, c.column)) - c.background_at(y); };
  const auto edge = [&](int row, int step, int limit) {
    while (row != limit && signal(row + step) > half) row += step;
    const auto at = static_cast<float>(row);
    if (row == limit) return at;
    const float inside = signal(row);
    return at + static_cast<float>(step) * (inside - half) / (inside - signal(row + step));
  };
  const float lower = edge(flat.first, -1, c.lower_limit);
  const float upper = edge(flat.last, 1, c.upper_limit);
  const float h = 0.5f * (upper - lower);
  const auto rows = static_cast<float>(flat.last - flat.first + 1);
  const float w = rows > 1.0f ? 0.5f * rows : 0.0f;
  c.row = 0.5f * (lower + upper);
  c.has_halo = true;
  c.flat_top = w;
  c.width = std::sqrt(std::max(kLeastVariance * h * h, (h * h - w * w) / kTwoLogTwo) + w * w / 3.0f);
}

}  // namespace

std::vector<Candidate>& CandidateFinder::find(ImageRows image, const PixelNoise& noise, float threshold,
                                              int bit_depth) {
  found_.clear();
  runs_.assign(static_cast<std::size_t>(image.width), Run{});
  runs_in_block_.assign(static_cast<std::size_t>((image.width + kBlock - 1) / kBlock), 0);
  if (bit_depth <= 14) {
    scan<std::uint16_t>(image, noise, threshold);
  } else {
    scan<std::uint32_t>(image, noise, threshold);
  }
  for (int x = 0; x < image.width; ++x) {
    if (runs_[static_cast<std::size_t>(x)].first_row >= 0) close(x, image.height - 2, x / kBlock);
  }
  sort_by_column(image.width);
  return sorted_;
}

template <typename Sum>
void CandidateFinder::scan(ImageRows image, const PixelNoise& noise, float threshold) {
  const int blocks = static_cast<int>(runs_in_block_.size());
  std::vector<Sum> largest(static_cast<std::size_t>(blocks));
  const float level = 3.0f * noise.background + threshold;
  for (int y = 1; y + 1 < image.height; ++y) {
    maxima(image.row(y - 1), image.row(y), image.row(y + 1), image.width, largest.data());
    for (int block = 0; block < blocks; ++block) {
      const auto b = static_cast<std::size_t>(block);
      if (static_cast<float>(largest[b]) > level || runs_in_block_[b] > 0)
        visit(image, noise, level, y, block);
    }
  }
}

void CandidateFinder::visit(ImageRows image, const PixelNoise& noise, float level, int row, int block) {
  const int end = std::min(image.width, (block + 1) * kBlock);
  for (int x = block * kBlock; x < end; ++x) {
    const auto sum =
        static_cast<float>(static_cast<int>(image.at(row - 1, x)) + image.at(row, x) + image.at(row + 1, x));
    Run& run = runs_[static_cast<std::size_t>(x)];
    if (sum <= level) {
      if (run.first_row >= 0) close(x, row - 1, block);
      continue;
    }
    if (run.first_row < 0) {
      run = {row, row, sum, sum};
      ++runs_in_block_[static_cast<std::size_t>(block)];
    } else if (sum < run.valley) {
      run.valley = sum;
      run.valley_row = row;
    } else if (sum > run.highest && run.valley == run.highest) {
      run.highest = run.valley = sum;
      run.valley_row = row;
    } else {
      const float signal = run.highest - 3.0f * noise.background;
      const float speckle = noise.speckle.covariance[0] * signal * signal;
      const float noise_sum = std::sqrt(3.0f * noise.variance_floor + noise.gain * signal + speckle);
      const float dip = std::max(kValleySigmas * noise_sum, kValleyShare * signal);
      if (sum - run.valley > dip && run.highest - run.valley > dip) {
        const int valley_row = run.valley_row;
        close(x, valley_row, block);
        run = {valley_row, row, sum, sum};
        ++runs_in_block_[static_cast<std::size_t>(block)];
      } else if (sum > run.highest) {
        run.highest = run.valley = sum;  // the dip was not significant
        run.valley_row = row;
      }
    }
  }
}

void CandidateFinder::close(int column, int last_row, int block) {
  Run& run = runs_[static_cast<std::size_t>(column)];
  Candidate candidate;
  candidate.column = column;
  candidate.first_row = run.first_row;
  candidate.last_row = last_row;
  candidate.strength = run.highest;
  found_.push_back(candidate);
  run.first_row = -1;
  --runs_in_block_[static_cast<std::size_t>(block)];
}

void CandidateFinder::sort_by_column(int width) {
  starts_.assign(static_cast<std::size_t>(width) + 1, 0);
  for (const Candidate& c : found_) ++starts_[static_cast<std::size_t>(c.column) + 1];
  std::partial_sum(starts_.begin(), starts_.end(), starts_.begin());
  sorted_.resize(found_.size());
  for (const Candidate& c : found_) {
    sorted_[static_cast<std::size_t>(starts_[static_cast<std::size_t>(c.column)]++)] = c;
  }
}

void set_limits(std::vector<Candidate>& candidates, int height) {
  for (std::size_t i = 0; i < candidates.size(); ++i) {
    Candidate& c = candidates[i];
    c.lower_limit = 0;
    c.upper_limit = height - 1;
    if (c.first_row <= 1 || c.last_row >= height - 2) c.flags |= kPeakBorder;
    if (i > 0 && candidates[i - 1].column == c.column) {
      Candidate& before = candidates[i - 1];
      c.lower_limit = (before.last_row + c.first_row) / 2;
      before.upper_limit = c.lower_limit;
      c.flags |= kPeakMultiple;
      before.flags |= kPeakMultiple;
    }
  }
}

void estimate_shape(ImageRows image, const PixelNoise& noise, float max_sigma, Candidate& c) {
  c.flat_top = 0.0f;
  c.has_halo = false;
  const int first = std::max(c.lower_limit, c.first_row - 1);
  const int last = std::min(c.upper_limit, c.last_row + 1);
  float sum = 0.0f;
  float moment = 0.0f;
  float moment2 = 0.0f;
  float highest = 0.0f;
  int brightest = first;
  for (int y = first; y <= last; ++y) {
    const float signal = std::max(0.0f, static_cast<float>(image.at(y, c.column)) - c.background_at(y));
    const auto offset = static_cast<float>(y - first);
    sum += signal;
    moment += signal * offset;
    moment2 += signal * offset * offset;
    if (signal > highest) brightest = y;
    highest = std::max(highest, signal);
  }
  if (sum <= 0.0f) sum = 1.0f;
  const float centre = moment / sum;
  c.row = static_cast<float>(first) + centre;
  // Integration over the pixel adds 1/12 px² to the variance.
  c.width = std::sqrt(std::max(0.09f, moment2 / sum - centre * centre - 1.0f / 12.0f));
  c.amplitude = std::max(highest, 1.0f);
  if (static_cast<float>(image.at(brightest, c.column)) < noise.saturation) {
    if (c.width > max_sigma) estimate_from_flanks(image, {brightest, brightest}, c);
    return;
  }
  const RowWindow flat = flat_top(image, noise.saturation, c);
  const bool above_half =
      noise.saturation - c.background_at(brightest) > 0.5f * c.amplitude;  // not in saturated ambient light
  if (above_half && flat.last - flat.first + 1 >= kLongFlatTop) {
    estimate_from_flanks(image, flat, c);
  }
}

RowWindow window(const Candidate& c, float reach, int height) {
  const int half = static_cast<int>(std::ceil(reach));
  const int centre = static_cast<int>(std::lround(c.row));
  return {std::max({c.lower_limit, centre - half, 0}), std::min({c.upper_limit, centre + half, height - 1})};
}

}  // namespace sensor_rt
