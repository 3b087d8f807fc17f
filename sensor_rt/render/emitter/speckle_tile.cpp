#include "sensor_rt/render/emitter/speckle_tile.h"

#include <algorithm>
#include <cmath>
#include <complex>
#include <numeric>
#include <utility>

#include "sensor_rt/geometry/random.h"
#include "sensor_rt/geometry/recent.h"

namespace sensor_rt {
namespace {

using Complex = std::complex<double>;

constexpr std::size_t kSide = SpeckleTile::kSteps;
constexpr int kMaxPatterns = 16;

/// exp(2 pi i k / kSide)
std::vector<Complex> roots_of_unity() {
  std::vector<Complex> roots;
  for (std::size_t k = 0; k < kSide; ++k)
    roots.push_back(std::polar(1.0, 2.0 * M_PI * static_cast<double>(k) / static_cast<double>(kSide)));
  return roots;
}

/// Computes the unscaled inverse Fourier transform in place; the length is a power of two and divides kSide.
void inverse_fourier(std::vector<Complex>& values) {
  static const std::vector<Complex> roots = roots_of_unity();
  const std::size_t count = values.size();
  for (std::size_t i = 1, j = 0; i < count; ++i) {
    std::size_t bit = count >> 1;
    for (; (j & bit) != 0; bit >>= 1) j ^= bit;
    j ^= bit;
    if (i < j) std::swap(values[i], values[j]);
  }
  for (std::size_t length = 2; length <= count; length <<= 1) {
    for (std::size_t k = 0; k < length / 2; ++k) {
      const Complex twiddle = roots[k * (kSide / length)];
      for (std::size_t first = k; first < count; first += length) {
        const Complex odd = twiddle * values[first + length / 2];
        values[first + length / 2] = values[first] - odd;
        values[first] += odd;
      }
    }
  }
}

/// Writes waves of equal amplitude and random phase on a disc whose diameter is the number of grains per
/// tile.
std::vector<Complex> random_waves(int steps, int grains, std::uint32_t number) {
  std::vector<Complex> waves(static_cast<std::size_t>(steps) * static_cast<std::size_t>(steps));
  for (int v = -grains / 2; v <= grains / 2; ++v) {
    for (int u = -grains / 2; u <= grains / 2; ++u) {
      if (4 * (u * u + v * v) > grains * grains) continue;
      const auto bits = philox4x32({static_cast<std::uint32_t>(u), static_cast<std::uint32_t>(v), number, 0},
                                   {0x59EC41Eu, 0});
      const double phase = 2.0 * M_PI * static_cast<double>(uniform01(bits[0]));
      waves[static_cast<std::size_t>(((v + steps) % steps) * steps + (u + steps) % steps)] =
          std::polar(1.0, phase);
    }
  }
  return waves;
}

/// Changes each row, then each column, of a square of kSide values.
template <typename Value, typename Change>
void for_lines(std::vector<Value>& values, const Change& change) {
  std::vector<Value> line(kSide);
  for (const auto& [start, step] : {std::pair{kSide, std::size_t{1}}, std::pair{std::size_t{1}, kSide}}) {
    for (std::size_t k = 0; k < kSide; ++k) {
      for (std::size_t i = 0; i < kSide; ++i) line[i] = values[k * start + i * step];
      change(line);
      for (std::size_t i = 0; i < kSide; ++i) values[k * start + i * step] = line[i];
    }
  }
}

/// Computes the `number`-th fully developed pattern.
std::vector<double> pattern(std::uint32_t number) {
  std::vector<Complex> field =
      random_waves(SpeckleTile::kSteps, SpeckleTile::kSteps / SpeckleTile::kPerGrain, number);
  for_lines(field, inverse_fourier);
  std::vector<double> intensity;
  for (const Complex& value : field) intensity.push_back(std::norm(value));
  return intensity;
}

/// Returns the weights of independent patterns whose mean has the contrast: as many equal ones as available,
/// and a remainder.
std::vector<double> shares(double contrast) {
  const double square = contrast * contrast;
  if (square * kMaxPatterns <= 1.0) return std::vector<double>(kMaxPatterns, 1.0 / kMaxPatterns);
  const double equal = std::ceil(1.0 / square - 1e-9) - 1.0;
  if (equal == 0.0) return {1.0};
  // equal * share + rest = 1 and equal * share² + rest² = contrast²
  const double root = std::sqrt(std::max(0.0, equal * ((equal + 1.0) * square - 1.0)));
  const double share = (equal + root) / (equal * (equal + 1.0));
  std::vector<double> all(static_cast<std::size_t>(equal), share);
  all.push_back(1.0 - equal * share);
  return all;
}

/// Replaces the values of a periodic sequence by their means over `width` steps around each.
void average(double width, std::vector<double>& values) {
  const std::size_t count = values.size();
  std::vector<double> sum(count + 1, 0.0);
  std::partial_sum(values.begin(), values.end(), sum.begin() + 1);
  const auto integral = [&](double to) {  // from the start of step 0
    const double periods = std::floor(to / static_cast<double>(count));
    const double rest = to - periods * static_cast<double>(count);
    const auto step = std::min(static_cast<std::size_t>(rest), count - 1);
    return periods * sum[count] + sum[step] + (rest - static_cast<double>(step)) * values[step];
  };
  std::vector<double> means;
  for (std::size_t i = 0; i < count; ++i) {
    const double middle = static_cast<double>(i) + 0.5;
    means.push_back((integral(middle + 0.5 * width) - integral(middle - 0.5 * width)) / width);
  }
  values.swap(means);
}

/// Compensates for what linear interpolation takes from the contrast: to second order in frequency.
void sharpen(std::vector<double>& values) {
  constexpr double kShare = 1.0 / 12.0;
  const std::size_t count = values.size();
  const std::vector<double> given = values;
  for (std::size_t i = 0; i < count; ++i) {
    values[i] -= kShare * (given[(i + count - 1) % count] - 2.0 * given[i] + given[(i + 1) % count]);
  }
}

}  // namespace

SpeckleTile::SpeckleTile(double contrast) {
  std::vector<double> sum(kSide * kSide, 0.0);
  const std::vector<double> parts = shares(contrast);
  for (std::size_t k = 0; k < parts.size(); ++k) {
    const std::vector<double> part = pattern(static_cast<std::uint32_t>(k));
    const double mean = std::accumulate(part.begin(), part.end(), 0.0) / static_cast<double>(part.size());
    for (std::size_t i = 0; i < sum.size(); ++i) sum[i] += parts[k] * part[i] / mean;
  }
  double square = 0.0;
  for (const double value : sum) square += (value - 1.0) * (value - 1.0);
  // Corrects the deviation of the contrast caused by the finite number of grains.
  const double scale = contrast / std::sqrt(square / static_cast<double>(sum.size()));
  for (double& value : sum) value = 1.0 + scale * (value - 1.0);
  for_lines(sum, sharpen);
  for (const double value : sum) steps_.push_back(static_cast<float>(std::max(0.0, value)));
}

SpeckleTile SpeckleTile::averaged(double width) const {
  std::vector<double> values(steps_.begin(), steps_.end());
  for_lines(values, [&](std::vector<double>& line) { average(width, line); });
  SpeckleTile tile;
  tile.steps_.assign(values.begin(), values.end());
  return tile;
}

std::shared_ptr<const SpeckleTile> SpeckleTile::shared(double contrast, double width) {
  constexpr std::size_t kKept = 4;
  static Recent<double, SpeckleTile> sharp(kKept);
  static Recent<std::pair<double, double>, SpeckleTile> averaged(kKept);
  const auto tile = [&] { return sharp.get(contrast, [&] { return SpeckleTile(contrast); }); };
  return width == 0.0 ? tile() : averaged.get({contrast, width}, [&] { return tile()->averaged(width); });
}

}  // namespace sensor_rt
