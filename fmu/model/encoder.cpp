#include "fmu/model/encoder.h"

#include <cmath>

namespace robotcell {
namespace {

constexpr double kTwoPi = 6.283185307179586;

/// Finaliser of SplitMix64 (Steele, Lea, Flood, "Fast splittable pseudorandom number generators", OOPSLA
/// 2014).
std::uint64_t mixed(std::uint64_t x) {
  x += 0x9E3779B97F4A7C15u;
  x = (x ^ (x >> 30)) * 0xBF58476D1CE4E5B9u;
  x = (x ^ (x >> 27)) * 0x94D049BB133111EBu;
  return x ^ (x >> 31);
}

/// Uniform in (0, 1), never 0 or 1.
double uniform(std::uint64_t bits) { return (static_cast<double>(bits >> 12) + 0.5) * 0x1p-52; }

/// Standard normal number by Box and Muller's transform.
double normal(std::uint64_t key) {
  const double radius = std::sqrt(-2 * std::log(uniform(mixed(key))));
  return radius * std::cos(kTwoPi * uniform(mixed(~key)));
}

}  // namespace

Encoders::Encoders(const CellDescription& cell, std::int32_t instance_seed)
    : key_(mixed(mixed(static_cast<std::uint32_t>(cell.seed)) ^ static_cast<std::uint32_t>(instance_seed))) {
  for (std::size_t i = 0; i < kJoints; ++i) encoders_[i] = cell.joints[i].encoder;
  encoders_[kTableAxis] = cell.table.encoder;
}

std::array<double, kAxes> Encoders::read(const std::array<double, kAxes>& position,
                                         std::int64_t time_us) const {
  std::array<double, kAxes> measured = position;
  for (std::size_t i = 0; i < kAxes; ++i) {
    const EncoderDescription& encoder = encoders_[i];
    if (encoder.noise > 0) {
      measured[i] += encoder.noise * normal(mixed(mixed(key_ + i) ^ static_cast<std::uint64_t>(time_us)));
    }
    if (encoder.resolution > 0) {
      measured[i] = encoder.resolution * std::nearbyint(measured[i] / encoder.resolution);
    }
  }
  return measured;
}

}  // namespace robotcell
