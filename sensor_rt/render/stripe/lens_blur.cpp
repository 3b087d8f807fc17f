#include "sensor_rt/render/stripe/lens_blur.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>

#include "sensor_rt/geometry/multiversion.h"
#include "sensor_rt/optics/region.h"

namespace sensor_rt {
namespace {

constexpr int kGrid = 16;                 // px between nodes of the defocus
constexpr double kRadiusStep = 1.0 / 64;  // px between tabulated discs, or
constexpr int kDiscs = 512;               // number of discs up to the largest radius in the image
constexpr double kLargestRadius = 500.0;

/// Returns the area of a disc of radius 1 between x = -1 and x.
double area_below(double x) {
  const double within = std::clamp(x, -1.0, 1.0);
  return within * std::sqrt(1.0 - within * within) + std::asin(within) + 0.5 * M_PI;
}

/// Returns half of a symmetric kernel that has the variance of a Gaussian, from the centre outwards. No
/// weight is negative, and their sum is one.
std::vector<float> gaussian_kernel(double sigma) {
  if (sigma == 0.0) return {1.0f};
  constexpr double kWellSampled = 0.8;
  const double variance = sigma * sigma;
  if (sigma < kWellSampled) {
    // Second and fourth moments; below sqrt(1/3) px no kernel without negative weights has both.
    const double outer = std::max(0.0, (3.0 * variance * variance - variance) / 24.0);
    const double inner = 0.5 * variance - 4.0 * outer;
    return {static_cast<float>(1.0 - 2.0 * (inner + outer)), static_cast<float>(inner),
            static_cast<float>(outer)};
  }
  std::vector<double> values;
  double sum = 0.0;
  for (int k = 0; k <= std::ceil(4.5 * sigma); ++k) {
    values.push_back(std::exp(-0.5 * k * k / variance));
    sum += (k == 0 ? 1.0 : 2.0) * values.back();
  }
  std::vector<float> kernel;
  for (const double value : values) kernel.push_back(static_cast<float>(value / sum));
  return kernel;
}

/// Returns the variance of a uniformly lit run, from -half to half, sampled by pixels.
double variance_of_run(double half) {
  double sum = 0.0;
  for (int row = 1; row - 0.5 < half; ++row) {
    sum += 2.0 * row * row * (std::min(half, row + 0.5) - (row - 0.5));
  }
  return half > 0.0 ? sum / (2.0 * half) : 0.0;
}

/// Returns where `is_low` changes from true to false.
template <typename IsLow>
double solve(double low, double high, const IsLow& is_low) {
  constexpr int kBisections = 16;
  for (int i = 0; i < kBisections; ++i) {
    const double middle = 0.5 * (low + high);
    (is_low(middle) ? low : high) = middle;
  }
  return 0.5 * (low + high);
}

/// Adds share * light to `sum`.
SENSOR_RT_MULTIVERSION
void add_share(float share, const float* __restrict light, int count, float* __restrict sum) {
  for (int i = 0; i < count; ++i) sum[i] += share * light[i];
}

/// Returns the radius of the disc of defocus at a pixel, px; negative for points beyond the focus.
double defocus(const Camera& camera, double column, double row) {
  const Eigen::Vector3d direction = camera.ray({column, row});
  const double towards_sheet = (camera.sensor_from_camera.rotation * direction).x();
  const double inverse_depth =
      std::max(-towards_sheet / camera.sensor_from_camera.translation.x(), 1.0 / kFarthest);
  const double per_slope = std::sqrt(1.0 / std::abs(camera.ray_jacobian(direction).determinant()));
  return per_slope * camera.aperture_radius() *
         (camera.vergence(direction.x(), direction.y()) - inverse_depth);
}

/// Returns the largest radius of the disc of defocus in the image, px.
double largest_defocus(const Camera& camera) {
  double largest = 0.0;
  for (const double column : {-0.5, camera.width_px - 0.5}) {
    for (const double row : {-0.5, camera.height_px - 0.5}) {
      largest = std::max(largest, std::abs(defocus(camera, column, row)));
    }
  }
  return largest;
}

}  // namespace

bool LensBlur::is_accurate(const Camera& camera) {
  constexpr double kNarrowest = 0.5;      // px
  constexpr double kTiltedDefocus = 1.0;  // px
  if (camera.psf_sigma_px > 0.0 && camera.psf_sigma_px < kNarrowest) return false;
  return !camera.has_depth_of_field() || !camera.is_tilted() || largest_defocus(camera) < kTiltedDefocus;
}

LensBlur::LensBlur(const Camera& camera) : camera_(camera), gaussian_(gaussian_kernel(camera.psf_sigma_px)) {
  const int spread = static_cast<int>(gaussian_.size()) - 1;
  double largest = 0.0;
  if (camera.has_depth_of_field()) {
    largest = std::min(largest_defocus(camera), kLargestRadius);
    radius_step_ = std::max(kRadiusStep, largest / kDiscs);
    for (int k = 0; k * radius_step_ <= 1.25 * largest + 1.0; ++k)
      discs_.push_back(make_disc(k * radius_step_));
  }
  margin_ = spread + static_cast<int>(std::ceil(largest)) + 1;
  padding_ = spread + (discs_.empty() ? 0 : discs_.back().reach) + 2;
  if (discs_.empty()) return;
  const Camera sharp = sharp_camera();
  grid_columns_ = sharp.width_px / kGrid + 2;
  for (int j = 0; j < sharp.height_px / kGrid + 2; ++j) {
    for (int i = 0; i < grid_columns_; ++i)
      defocus_.push_back(defocus(camera_, i * kGrid - margin_, j * kGrid - margin_));
  }
}

Camera LensBlur::sharp_camera() const {
  Camera sharp = camera_;
  sharp.focus = 0.0;
  sharp.psf_sigma_px = 0.0;
  sharp.width_px += 2 * margin_;
  sharp.height_px += 2 * margin_;
  sharp.cx_px += margin_;
  sharp.cy_px += margin_;
  return sharp;
}

/// Returns a disc, sampled by pixels, whose variances by row and column are those of a disc of `radius`.
LensBlur::Disc LensBlur::make_disc(double radius) {
  const double wanted = 0.25 * radius * radius;
  const auto shares = [](double r) {  // of the columns from the middle one outwards
    std::vector<double> found;
    for (int k = 0; k == 0 || k - 0.5 < r; ++k) {
      found.push_back((area_below((k + 0.5) / r) - area_below((k - 0.5) / r)) / M_PI);
    }
    return found;
  };
  const auto by_column = [](const std::vector<double>& share) {
    double sum = 0.0;
    for (std::size_t k = 1; k < share.size(); ++k) sum += 2.0 * share[k] * static_cast<double>(k * k);
    return sum;
  };
  const std::vector<double> share =
      shares(solve(0.5, radius + 1.0, [&](double r) { return by_column(shares(r)) < wanted; }));
  // Half lengths of the chords are in proportion to the shares.
  const auto by_row = [&](double longest) {
    double sum = 0.0;
    for (std::size_t k = 0; k < share.size(); ++k) {
      sum += (k == 0 ? 1.0 : 2.0) * share[k] * variance_of_run(longest * share[k] / share[0]);
    }
    return sum;
  };
  const double longest = solve(0.5, radius + 1.0, [&](double half) { return by_row(half) < wanted; });
  Disc disc;
  disc.reach = static_cast<int>(share.size()) - 1;
  for (int k = -disc.reach; k <= disc.reach; ++k) {
    const double part = share[static_cast<std::size_t>(std::abs(k))];
    const double half = std::max(longest * part / share[0], 1e-6);
    const double start = std::floor(0.5 - half);
    const double end = std::floor(0.5 + half);
    disc.chords.push_back({static_cast<int>(start), static_cast<float>(0.5 - half - start),
                           static_cast<int>(end), static_cast<float>(0.5 + half - end),
                           static_cast<float>(0.5 * part / half)});
  }
  return disc;
}

const LensBlur::Disc& LensBlur::disc(int column, int row) const {
  const double x = static_cast<double>(column) / kGrid;
  const double y = static_cast<double>(row) / kGrid;
  const auto i = static_cast<std::size_t>(x);
  const auto j = static_cast<std::size_t>(y);
  const double* node = &defocus_[j * static_cast<std::size_t>(grid_columns_) + i];
  const double u = x - static_cast<double>(i);
  const double v = y - static_cast<double>(j);
  const double radius = std::abs((1.0 - v) * ((1.0 - u) * node[0] + u * node[1]) +
                                 v * ((1.0 - u) * node[grid_columns_] + u * node[grid_columns_ + 1]));
  return discs_[std::min(static_cast<std::size_t>(radius / radius_step_ + 0.5), discs_.size() - 1)];
}

/// Adds each pixel's light to the columns of `out`, spread over its disc; clears `image`.
void LensBlur::spread(ColumnImage& image, ColumnImage& out) const {
  const int width = image.columns();
  for (int column = 0; column < width; ++column) {
    for (int row = image.first(column); row <= image.last(column); ++row) {
      const float light = image.column(column)[row];
      if (light == 0.0f) continue;
      if (discs_.empty()) {
        out.column(column)[row + padding_] = light;
        out.touch(column, row + padding_, row + padding_);
        continue;
      }
      // The chords as differences from row to row, which are summed below.
      const Disc& disc = this->disc(column, row);
      const int from = std::max(-disc.reach, -column);
      const int to = std::min(disc.reach, width - 1 - column);
      for (int k = from; k <= to; ++k) {
        const Chord& chord = disc.chords[static_cast<std::size_t>(k + disc.reach)];
        const float density = light * chord.density;
        float* start = out.column(column + k) + row + padding_ + chord.start;
        float* end = out.column(column + k) + row + padding_ + chord.end;
        start[0] += (1.0f - chord.start_share) * density;
        start[1] += chord.start_share * density;
        end[0] -= (1.0f - chord.end_share) * density;
        end[1] -= chord.end_share * density;
        out.touch(column + k, row + padding_ + chord.start, row + padding_ + chord.end + 1);
      }
    }
    image.clear(column);
  }
  if (discs_.empty()) return;
  for (int column = 0; column < width; ++column) {
    float* light = out.column(column);
    float sum = 0.0f;
    for (int row = out.first(column); row <= out.last(column); ++row) light[row] = sum += light[row];
  }
}

/// Convolves with the point spread function by columns, then by rows; clears `in`.
void LensBlur::convolve(ColumnImage& in, ColumnImage& out, std::vector<float>& column) const {
  const int reach = static_cast<int>(gaussian_.size()) - 1;
  const int width = in.columns();
  const auto weight = [&](int k) { return gaussian_[static_cast<std::size_t>(std::abs(k))]; };
  for (int c = 0; c < width; ++c) {
    if (in.last(c) < 0) continue;
    const int first = in.first(c) - reach;
    const int count = in.last(c) + reach - first + 1;
    column.assign(static_cast<std::size_t>(count), 0.0f);
    const float* light = in.column(c) + in.first(c);
    for (int k = 0; k <= 2 * reach; ++k) {
      add_share(weight(k - reach), light, count - 2 * reach, &column[static_cast<std::size_t>(k)]);
    }
    for (int to = std::max(0, c - reach); to <= std::min(width - 1, c + reach); ++to) {
      add_share(weight(to - c), column.data(), count, out.column(to) + first);
      out.touch(to, first, first + count - 1);
    }
    in.clear(c);
  }
}

/// Multiplies blurred light by the factors of speckle and clears them. Light that was blurred beyond the
/// sharp stripe gets the mirrored factors of its edge.
void LensBlur::add_grains(ColumnImage& factors, ColumnImage& light) const {
  for (int column = 0; column < factors.columns(); ++column) {
    const int first = factors.first(column);
    const int last = factors.last(column);
    if (last < 0) continue;
    for (int row = light.first(column); row <= light.last(column); ++row) {
      int from = row - padding_;
      if (from < first) from = std::min(2 * first - 1 - from, last);
      if (from > last) from = std::max(2 * last + 1 - from, first);
      light.column(column)[row] *= factors.column(column)[from];
    }
    factors.clear(column);
  }
}

void LensBlur::apply(StripeImage& sharp, float scale, Buffers& buffers, SparseImage& out) const {
  const int columns = sharp.even.columns();
  const int rows = sharp.even.rows() + 2 * padding_;
  for (int column = 0; column < sharp.grainy.columns(); ++column) {  // from light to factors
    const float* even = sharp.even.column(column);
    float* grains = sharp.grainy.column(column);
    for (int row = sharp.grainy.first(column); row <= sharp.grainy.last(column); ++row) {
      grains[row] = even[row] > 0.0f ? grains[row] / even[row] : 1.0f;
    }
  }
  buffers.spread.resize(columns, rows);
  spread(sharp.even, buffers.spread);
  ColumnImage* light = &buffers.spread;
  if (gaussian_.size() > 1) {
    buffers.blurred.resize(columns, rows);
    convolve(buffers.spread, buffers.blurred, buffers.column);
    light = &buffers.blurred;
  }
  if (sharp.has_speckle()) add_grains(sharp.grainy, *light);
  light->move_to(out, margin_, margin_ + padding_, camera_.width_px, camera_.height_px, scale);
}

}  // namespace sensor_rt
