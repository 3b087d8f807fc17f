#include "sensor_rt/detector/dark_signal.h"

#include <algorithm>
#include <cmath>
#include <vector>

namespace sensor_rt {
namespace {

/// Cumulative distribution of Poisson(dark) + Normal(0, read) on a grid; both tails have full relative
/// precision.
struct Cumulative {
  std::vector<double> x;
  std::vector<double> lower;  // P(X <= x)
  std::vector<double> upper;  // P(X > x)
};

constexpr double kReach = 7.0;  // standard deviations; P beyond is below 2^-33

std::vector<double> poisson_probabilities(double mean, int first, int last) {
  std::vector<double> p;
  for (int k = first; k <= last; ++k) {
    p.push_back(std::exp(k * std::log(mean) - mean - std::lgamma(k + 1.0)));
  }
  return p;
}

Cumulative cdf(double dark, double read) {
  const double deviation = std::sqrt(dark + read * read);
  // The upper tail of a Poisson distribution is longer than that of the normal distribution: by (z² - 1) / 6
  // and, for small means, a few more.
  const int first = static_cast<int>(std::max(0.0, std::floor(dark - kReach * std::sqrt(dark) - 1.0)));
  const int last = static_cast<int>(std::ceil(dark + kReach * std::sqrt(dark) + 16.0));
  const std::vector<double> p = poisson_probabilities(dark, first, last);
  const std::size_t n = p.size();
  std::vector<double> below(n + 1, 0.0);  // sum of the first k probabilities
  std::vector<double> above(n + 1, 0.0);  // sum of the probabilities from k on
  for (std::size_t k = 0; k < n; ++k) below[k + 1] = below[k] + p[k];
  for (std::size_t k = n; k-- > 0;) above[k] = above[k + 1] + p[k];
  const double begin = first - kReach * read;
  const double end = last + kReach * read;
  const double step = std::max(read / 32.0, deviation / 512.0);
  const auto points = static_cast<std::size_t>(std::ceil((end - begin) / step)) + 1;
  Cumulative c;
  for (std::size_t i = 0; i < points; ++i) {
    const double x = begin + step * static_cast<double>(i);
    const double centre = x - first;  // further than kReach * read away, P(p[k] < x) is 0 or 1
    const auto from =
        static_cast<std::size_t>(std::clamp(centre - kReach * read, 0.0, static_cast<double>(n)));
    const auto to =
        static_cast<std::size_t>(std::clamp(centre + kReach * read + 1.0, 0.0, static_cast<double>(n)));
    double lower = below[from];
    double upper = above[to];
    for (std::size_t k = from; k < to; ++k) {
      const double z = (centre - static_cast<double>(k)) / (read * std::sqrt(2.0));
      lower += 0.5 * p[k] * std::erfc(-z);
      upper += 0.5 * p[k] * std::erfc(z);
    }
    c.x.push_back(x);
    c.lower.push_back(lower);
    c.upper.push_back(upper);
  }
  return c;
}

double interpolate(double p, double p0, double p1, double x0, double x1) {
  return p1 == p0 ? x0 : x0 + (x1 - x0) * (p - p0) / (p1 - p0);
}

}  // namespace

QuantileTable dark_signal_table(double dark_e, double read_noise_e) {
  if (dark_e <= 0.0) {
    return {[=](double p) { return -read_noise_e * normal_upper_tail(p); },
            [=](double p) { return read_noise_e * normal_upper_tail(p); }};
  }
  const Cumulative c = cdf(dark_e, read_noise_e);
  const auto lower = [&c](double p) {
    const auto it = std::lower_bound(c.lower.begin(), c.lower.end(), p);
    const auto i = static_cast<std::size_t>(
        std::clamp<std::ptrdiff_t>(it - c.lower.begin(), 1, static_cast<std::ptrdiff_t>(c.x.size()) - 1));
    return interpolate(p, c.lower[i - 1], c.lower[i], c.x[i - 1], c.x[i]);
  };
  const auto upper = [&c](double p) {
    const auto it = std::lower_bound(c.upper.begin(), c.upper.end(), p, std::greater<double>());
    const auto i = static_cast<std::size_t>(
        std::clamp<std::ptrdiff_t>(it - c.upper.begin(), 1, static_cast<std::ptrdiff_t>(c.x.size()) - 1));
    return interpolate(p, c.upper[i - 1], c.upper[i], c.x[i - 1], c.x[i]);
  };
  return {lower, upper};
}

}  // namespace sensor_rt
