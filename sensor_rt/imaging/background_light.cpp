#include "sensor_rt/imaging/background_light.h"

#include <algorithm>
#include <cmath>
#include <cstddef>

#include "sensor_rt/geometry/multiversion.h"

namespace sensor_rt {
namespace {

constexpr int kSamples = 64;          // rows and columns of the sample
constexpr int kCellColumns = 16;      // a cell of the smooth background has four columns of the sample ...
constexpr int kMostCellRows = 16;     // ... and four rows or more
constexpr int kLeastCellPixels = 48;  // rows of an image: a stripe must not fill a cell
constexpr int kPasses = 4;
constexpr float kQuartile = 0.674490f;  // of the normal distribution, standard deviations below its mean

/// Returns the value of rank `share` of the values, which are reordered.
float quantile(std::vector<float>& values, double share) {
  const auto at = values.begin() + static_cast<std::ptrdiff_t>(share * static_cast<double>(values.size()));
  std::nth_element(values.begin(), at, values.end());
  return *at;
}

/// Returns the mean of the middle half of the values, which are reordered.
float middle_mean(std::vector<float>& values) {
  std::sort(values.begin(), values.end());
  const std::size_t quarter = values.size() / 4;
  double sum = 0.0;
  for (std::size_t i = quarter; i < values.size() - quarter; ++i) sum += static_cast<double>(values[i]);
  return static_cast<float>(sum / static_cast<double>(values.size() - 2 * quarter));
}

/// Place of a pixel between the centres of two cells in a row, beyond them at the border.
struct Between {
  int first;
  float share;

  Between(int pixel, int pixels, int cells) {
    const float place =
        (static_cast<float>(pixel) + 0.5f) / static_cast<float>(pixels) * static_cast<float>(cells) - 0.5f;
    first = std::clamp(static_cast<int>(std::floor(place)), 0, std::max(0, cells - 2));
    share = cells > 1 ? place - static_cast<float>(first) : 0.0f;
  }
  float mix(const float* cells) const { return (1.0f - share) * cells[first] + share * cells[first + 1]; }
};

/// Computes the image less the background between two lines, plus `offset`, from 0 to `largest`.
SENSOR_RT_MULTIVERSION void subtract_row(const std::uint16_t* image, const float* above, const float* below,
                                         float share, float offset, int largest, int width,
                                         std::uint16_t* out) {
  for (int x = 0; x < width; ++x) {
    const float light = above[x] + share * (below[x] - above[x]);
    const int value = static_cast<int>(static_cast<float>(image[x]) - light + offset);
    out[x] = static_cast<std::uint16_t>(std::min(std::max(value, 0), largest));
  }
}

int place_of_sample(int number, int pixels) {
  return static_cast<int>((static_cast<long>(2 * number + 1) * pixels) / (2 * kSamples));
}

}  // namespace

void BackgroundLight::measure(ImageRows image, float black, const PixelNoise& noise) {
  width_ = image.width;
  height_ = image.height;
  sample_.clear();
  for (int j = 0; j < kSamples; ++j) {
    const std::uint16_t* row = image.row(place_of_sample(j, height_));
    for (int i = 0; i < kSamples; ++i) sample_.push_back(static_cast<float>(row[place_of_sample(i, width_)]));
  }
  sorted_ = sample_;
  const float median = quantile(sorted_, 0.5);
  const float light = std::max(0.0f, median - black);
  const float sigma = std::sqrt(noise.variance_floor + (noise.gain + noise.pattern * light) * light);
  double sum = 0.0;
  double squares = 0.0;
  int around = 0;
  for (const float value : sample_) {
    const float distance = std::fabs(value - median);
    if (distance > 4.0f * sigma + 1.0f) continue;
    sum += static_cast<double>(value - median);
    squares += static_cast<double>(distance * distance);
    ++around;
  }
  const double mean = sum / around;
  variance_ = std::min(sigma * sigma, static_cast<float>(squares / around - mean * mean));
  // The median of digital numbers is an integer, the mean of those near it is not. The halo of a stripe is on
  // one side: the window is narrow, and follows the mean.
  const float tolerance = 1.5f * sigma + 0.5f;
  int near = 0;
  level_ = median;
  for (int pass = 0; pass < kPasses; ++pass) {
    sum = 0.0;
    near = 0;
    for (const float value : sample_) {
      if (std::fabs(value - level_) > tolerance) continue;
      sum += static_cast<double>(value - median);
      ++near;
    }
    level_ = median + static_cast<float>(sum / std::max(1, near));
  }
  if (std::fabs(level_ - black) <= 4.0f * sigma / std::sqrt(static_cast<float>(std::max(1, near))))
    level_ = black;
  uniform_ = 4 * near >= 3 * kSamples * kSamples;
  if (uniform_) return;
  fit_cells(sigma);
  uniform_ = !is_better(median, tolerance);
}

/// Sets the cells, between whose centres the background is linear, to what their pixels have beyond it.
void BackgroundLight::fit_cells(float sigma) {
  cell_rows_ = std::clamp(height_ / kLeastCellPixels, 1, kMostCellRows);
  cells_.assign(static_cast<std::size_t>(cell_rows_ * kCellColumns), 0.0f);
  std::vector<float> next(cells_.size());
  for (int pass = 0; pass < kPasses; ++pass) {
    for (int v = 0; v < cell_rows_; ++v) {
      for (int u = 0; u < kCellColumns; ++u) {
        sorted_.clear();
        for (int j = v * kSamples / cell_rows_; j < (v + 1) * kSamples / cell_rows_; ++j) {
          for (int i = u * kSamples / kCellColumns; i < (u + 1) * kSamples / kCellColumns; ++i) {
            sorted_.push_back(sample_[static_cast<std::size_t>(j * kSamples + i)] -
                              at(place_of_sample(i, width_), place_of_sample(j, height_)));
          }
        }
        // Other light only adds: the lower quartile is the least disturbed, once the slope is known.
        const auto cell = static_cast<std::size_t>(v * kCellColumns + u);
        next[cell] =
            cells_[cell] + (pass == 0 ? quantile(sorted_, 0.5) : quantile(sorted_, 0.25) + kQuartile * sigma);
      }
    }
    cells_.swap(next);
  }
}

/// Whether the smooth background explains clearly more pixels of the sample than one level. Where a wide halo
/// of the stripe governs the cells it does not.
bool BackgroundLight::is_better(float level, float tolerance) const {
  int by_level = 0;
  int by_light = 0;
  for (int j = 0; j < kSamples; ++j) {
    for (int i = 0; i < kSamples; ++i) {
      const float value = sample_[static_cast<std::size_t>(j * kSamples + i)];
      const float light = at(place_of_sample(i, width_), place_of_sample(j, height_));
      by_level += std::fabs(value - level) <= tolerance ? 1 : 0;
      by_light += std::fabs(value - light) <= tolerance ? 1 : 0;
    }
  }
  return by_light > by_level + by_level / 8;
}

float BackgroundLight::at(int column, int row) const {
  const Between x(column, width_, kCellColumns);
  const Between y(row, height_, cell_rows_);
  const float* above = &cells_[static_cast<std::size_t>(y.first * kCellColumns)];
  const float* below = cell_rows_ > 1 ? above + kCellColumns : above;
  return (1.0f - y.share) * x.mix(above) + y.share * x.mix(below);
}

ImageRows BackgroundLight::subtract(ImageRows image, int pedestal, int largest) {
  const auto width = static_cast<std::size_t>(width_);
  difference_.resize(width * static_cast<std::size_t>(height_));
  lines_.resize(width * static_cast<std::size_t>(cell_rows_));
  for (int x = 0; x < width_; ++x) {
    const Between between(x, width_, kCellColumns);
    for (int v = 0; v < cell_rows_; ++v) {
      lines_[static_cast<std::size_t>(v) * width + static_cast<std::size_t>(x)] =
          between.mix(&cells_[static_cast<std::size_t>(v * kCellColumns)]);
    }
  }
  const auto offset = static_cast<float>(pedestal) + 0.5f;
  for (int y = 0; y < height_; ++y) {
    const Between between(y, height_, cell_rows_);
    const float* above = &lines_[static_cast<std::size_t>(between.first) * width];
    const float* below = cell_rows_ > 1 ? above + width : above;
    subtract_row(image.row(y), above, below, between.share, offset, largest, width_,
                 &difference_[static_cast<std::size_t>(y) * width]);
  }
  return {difference_.data(), width_, height_, width_};
}

void BackgroundLight::place(Candidate& c) const {
  const int last = std::max(c.last_row, c.first_row + 1);
  const float level = at(c.column, c.first_row);
  c.background_slope = (at(c.column, last) - level) / static_cast<float>(last - c.first_row);
  c.background = level - c.background_slope * static_cast<float>(c.first_row);
}

void measure_background(ImageRows image, const PixelNoise& noise, float threshold, Candidate& c) {
  constexpr float kStripe = 4.0f;  // standard deviations of the stripe that are left out ...
  constexpr float kMargin = 2.0f;  // ... plus rows
  constexpr int kRows = 16;        // on either side
  constexpr int kLeastRows = 6;
  const float reach = kStripe * c.width + kMargin;
  float level[2];
  float row[2];
  std::vector<float> values;
  for (int side = 0; side < 2; ++side) {
    const int step = side == 0 ? -1 : 1;
    const int first = static_cast<int>(std::lround(c.row + static_cast<float>(step) * reach));
    values.clear();
    for (int y = first; static_cast<int>(values.size()) < kRows && y >= c.lower_limit && y <= c.upper_limit;
         y += step) {
      const auto value = static_cast<float>(image.at(y, c.column));
      if (!(value > 0.0f) || !(value < noise.saturation)) break;  // clipped: its light is not known
      values.push_back(value);
    }
    if (static_cast<int>(values.size()) < kLeastRows) return;
    row[side] =
        static_cast<float>(first) + 0.5f * static_cast<float>(step * (static_cast<int>(values.size()) - 1));
    level[side] = middle_mean(values);
  }
  c.background_slope = (level[1] - level[0]) / (row[1] - row[0]);
  c.background = level[0] - c.background_slope * row[0];
  const auto is_lit = [&](int y) {
    float sum = 0.0f;
    for (int k = y - 1; k <= y + 1; ++k) {
      sum += static_cast<float>(image.at(k, c.column)) - c.background_at(k);
    }
    return sum > threshold;
  };
  const int centre = std::clamp(static_cast<int>(std::lround(c.row)), c.first_row, c.last_row);
  const int low = c.first_row;
  const int high = c.last_row;
  for (c.first_row = centre; c.first_row > low && is_lit(c.first_row - 1);) --c.first_row;
  for (c.last_row = centre; c.last_row < high && is_lit(c.last_row + 1);) ++c.last_row;
}

}  // namespace sensor_rt
