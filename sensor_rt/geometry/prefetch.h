// Cache prefetching.
#pragma once

#include <cstddef>

namespace sensor_rt {

/// Prefetches all cache lines of an object.
template <typename T>
inline void prefetch(const T& what) {
  constexpr std::size_t kLine = 64;
  const char* at = reinterpret_cast<const char*>(&what);
  for (std::size_t i = 0; i < sizeof(T); i += kLine) __builtin_prefetch(at + i);
}

}  // namespace sensor_rt
