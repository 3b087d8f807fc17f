// Counter-based random numbers: a function of the key only, independent of the order of calls.
#pragma once

#include <cmath>
#include <cstdint>

namespace robotcell {

/// Finaliser of SplitMix64 (Steele, Lea, Flood, "Fast splittable pseudorandom number generators", OOPSLA
/// 2014).
inline std::uint64_t mixed(std::uint64_t x) {
  x += 0x9E3779B97F4A7C15u;
  x = (x ^ (x >> 30)) * 0xBF58476D1CE4E5B9u;
  x = (x ^ (x >> 27)) * 0x94D049BB133111EBu;
  return x ^ (x >> 31);
}

/// Uniform in the open interval (0, 1).
inline double uniform(std::uint64_t bits) { return (static_cast<double>(bits >> 12) + 0.5) * 0x1p-52; }

/// Standard normal number (Box-Muller transform).
inline double normal(std::uint64_t key) {
  constexpr double kTwoPi = 6.283185307179586;
  const double radius = std::sqrt(-2 * std::log(uniform(mixed(key))));
  return radius * std::cos(kTwoPi * uniform(mixed(~key)));
}

/// Key of all random numbers of an instance, from the seeds of its description and of the instance.
inline std::uint64_t key_of_seeds(std::int32_t description_seed, std::int32_t instance_seed) {
  return mixed(mixed(static_cast<std::uint32_t>(description_seed)) ^
               static_cast<std::uint32_t>(instance_seed));
}

}  // namespace robotcell
