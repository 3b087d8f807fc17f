#include "sensor_rt/render/grain_tile.h"

#include <algorithm>
#include <cmath>
#include <complex>
#include <utility>

#include "sensor_rt/geometry/random.h"

namespace sensor_rt {
namespace {

using Complex = std::complex<double>;

/// Unscaled inverse Fourier transform in place; the length is a power of two.
void inverse_fourier(std::vector<Complex>& values) {
  const std::size_t count = values.size();
  for (std::size_t i = 1, j = 0; i < count; ++i) {
    std::size_t bit = count >> 1;
    for (; (j & bit) != 0; bit >>= 1) j ^= bit;
    j ^= bit;
    if (i < j) std::swap(values[i], values[j]);
  }
  for (std::size_t length = 2; length <= count; length <<= 1) {
    for (std::size_t k = 0; k < length / 2; ++k) {
      const Complex turn = std::polar(1.0, 2.0 * M_PI * static_cast<double>(k) / static_cast<double>(length));
      for (std::size_t first = k; first < count; first += length) {
        const Complex odd = turn * values[first + length / 2];
        values[first + length / 2] = values[first] - odd;
        values[first] += odd;
      }
    }
  }
}

/// Waves of equal strength and random phase from a disc as wide as the tile has grains.
std::vector<Complex> random_waves(int steps, int grains) {
  std::vector<Complex> waves(static_cast<std::size_t>(steps) * static_cast<std::size_t>(steps));
  for (int v = -grains / 2; v <= grains / 2; ++v) {
    for (int u = -grains / 2; u <= grains / 2; ++u) {
      if (4 * (u * u + v * v) > grains * grains) continue;
      const auto bits =
          philox4x32({static_cast<std::uint32_t>(u), static_cast<std::uint32_t>(v), 0, 0}, {0x59EC41Eu, 0});
      const double phase = 2.0 * M_PI * static_cast<double>(uniform01(bits[0]));
      waves[static_cast<std::size_t>(((v + steps) % steps) * steps + (u + steps) % steps)] =
          std::polar(1.0, phase);
    }
  }
  return waves;
}

}  // namespace

GrainTile::GrainTile() {
  constexpr std::size_t kSide = kSteps;
  std::vector<Complex> field = random_waves(kSteps, kSteps / kPerGrain);
  std::vector<Complex> line(kSide);
  for (std::size_t row = 0; row < kSide; ++row) {
    std::copy_n(&field[row * kSide], kSide, line.begin());
    inverse_fourier(line);
    std::copy_n(line.begin(), kSide, &field[row * kSide]);
  }
  for (std::size_t column = 0; column < kSide; ++column) {
    for (std::size_t i = 0; i < kSide; ++i) line[i] = field[i * kSide + column];
    inverse_fourier(line);
    for (std::size_t i = 0; i < kSide; ++i) field[i * kSide + column] = line[i];
  }
  double mean = 0.0;
  double square = 0.0;
  for (const Complex& value : field) {
    mean += std::norm(value);
    square += std::norm(value) * std::norm(value);
  }
  const double count = static_cast<double>(field.size());
  mean /= count;
  // A tile has finitely many grains; what its contrast misses of 1 by chance is made up for.
  const double contrast = std::sqrt(square / count / (mean * mean) - 1.0);
  for (const Complex& value : field) {
    steps_.push_back(static_cast<float>(std::max(0.0, 1.0 + (std::norm(value) / mean - 1.0) / contrast)));
  }
}

const GrainTile& GrainTile::shared() {
  static const GrainTile tile;
  return tile;
}

}  // namespace sensor_rt
