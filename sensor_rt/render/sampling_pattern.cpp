#include "sensor_rt/render/sampling_pattern.h"

#include <algorithm>
#include <cmath>
#include <numeric>

namespace sensor_rt {
namespace {

/// Returns the squared length of the shortest wave (p, q) that aliases to a constant on the lattice {(i,
/// generator * i) / n}.
long long shortest_hidden_wave(long long n, long long generator) {
  long long shortest = n * n;
  for (long long q = 1; q * q < shortest; ++q) {
    const long long p = (generator * q) % n;  // p + generator * (-q) = 0 (mod n)
    const long long nearest = std::min(p, n - p);
    shortest = std::min(shortest, nearest * nearest + q * q);
  }
  return shortest;
}

/// Returns the generator that maximises `quality` among those that visit every stratum.
template <typename Quality>
long long best_generator(long long n, const Quality& quality) {
  long long best = 1;
  for (long long g = 2; g < n; ++g) {
    if (std::gcd(g, n) == 1 && quality(g) > quality(best)) best = g;
  }
  return best;
}

/// Returns the generator of an additional dimension that is well distributed against each of the previous
/// ones: dimensions with generators a and g form a lattice whose generator r satisfies r * a = g.
long long next_generator(long long n, const std::vector<long long>& so_far) {
  return best_generator(n, [&](long long g) {
    long long worst = n * n;
    for (const long long a : so_far) {
      long long r = 0;
      while (r < n && (r * a - g) % n != 0) ++r;
      worst = std::min(worst, g == a ? 0 : shortest_hidden_wave(n, r));
    }
    return worst;
  });
}

/// Returns x where an increasing function has the value `wanted`.
template <typename Function>
double solve(double low, double high, double wanted, const Function& function) {
  for (int i = 0; i < 60; ++i) {
    const double middle = 0.5 * (low + high);
    (function(middle) < wanted ? low : high) = middle;
  }
  return 0.5 * (low + high);
}

/// Returns the height below which the fraction `share` of a disc of radius 1 lies.
double disc_quantile(double share) {
  return solve(-1.0, 1.0, share,
               [](double y) { return 0.5 + (y * std::sqrt(1.0 - y * y) + std::asin(y)) / M_PI; });
}

}  // namespace

double blurred_pixel_quantile(double share, double sigma_px) {
  if (sigma_px == 0.0) return share - 0.5;
  // Integral of the normal cumulative distribution.
  const auto ramp = [](double z) {
    return 0.5 * z * std::erfc(-z * M_SQRT1_2) + std::exp(-0.5 * z * z) / std::sqrt(2.0 * M_PI);
  };
  const double farthest = 0.5 + 8.0 * sigma_px;
  return solve(-farthest, farthest, share, [&](double x) {
    return sigma_px * (ramp((x + 0.5) / sigma_px) - ramp((x - 0.5) / sigma_px));
  });
}

double normal_quantile(double share) {
  return solve(-9.0, 9.0, share, [](double x) { return 0.5 * std::erfc(-x * M_SQRT1_2); });
}

SamplingPattern make_sampling_pattern(std::size_t samples) {
  const auto n = static_cast<long long>(samples);
  const long long to_column = best_generator(n, [&](long long g) { return shortest_hidden_wave(n, g); });
  // Time against row is as important as time against column.
  const long long to_time = next_generator(n, {1, to_column});
  const long long to_source = next_generator(n, {1, to_column, to_time});
  const long long to_lens_y = next_generator(n, {1, to_column, to_time, to_source});
  const long long to_lens_x = next_generator(n, {1, to_column, to_lens_y});
  SamplingPattern pattern;
  for (long long i = 0; i < n; ++i) {
    const auto middle = [&](long long generator) {
      return (static_cast<double>(i * generator % n) + 0.5) / static_cast<double>(n) - 0.5;
    };
    pattern.row.push_back(middle(1));
    pattern.column.push_back(middle(to_column));
    pattern.instant.push_back(static_cast<std::size_t>(i * to_time % n));
    pattern.source.push_back(middle(to_source));
    // Strips of the disc of equal area, then a position along the strip.
    const double y = disc_quantile(middle(to_lens_y) + 0.5);
    pattern.lens_y.push_back(y);
    pattern.lens_x.push_back(2.0 * middle(to_lens_x) * std::sqrt(1.0 - y * y));
  }
  return pattern;
}

std::vector<double> instants_of_exposure(std::size_t samples) {
  std::vector<double> fractions;
  for (std::size_t i = 0; i < samples; ++i) {
    fractions.push_back((static_cast<double>(i) + 0.5) / static_cast<double>(samples));
  }
  return fractions;
}

}  // namespace sensor_rt
