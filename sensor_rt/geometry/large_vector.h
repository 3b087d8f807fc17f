// Vectors of many megabytes.
#pragma once

#include <cstddef>
#include <cstdlib>
#include <limits>
#include <new>
#include <vector>

#if defined(__linux__)
#include <sys/mman.h>
#endif

namespace sensor_rt {

/// Allocator that requests huge pages for large blocks. Page faults dominate the cost of memory that is
/// written only once.
template <typename T>
struct LargePageAllocator {
  using value_type = T;

  LargePageAllocator() = default;
  template <typename U>
  LargePageAllocator(const LargePageAllocator<U>&) {}

  T* allocate(std::size_t count) {
    if (count > std::numeric_limits<std::size_t>::max() / (2 * sizeof(T))) throw std::bad_alloc();
    const std::size_t bytes = count * sizeof(T);
    const bool large = bytes >= kLargePage;
    const std::size_t alignment = large ? kLargePage : alignof(T);
    constexpr bool kPlain = alignof(T) <= alignof(std::max_align_t);
    const std::size_t padded = large || !kPlain ? (bytes + alignment - 1) / alignment * alignment : bytes;
    void* memory = large || !kPlain ? std::aligned_alloc(alignment, padded) : std::malloc(bytes);
    if (memory == nullptr) throw std::bad_alloc();
#if defined(__linux__)
    // The advice may be refused; normal pages work too.
    if (large) madvise(memory, padded, MADV_HUGEPAGE);
#endif
    return static_cast<T*>(memory);
  }
  void deallocate(T* memory, std::size_t) { std::free(memory); }

  bool operator==(const LargePageAllocator&) const { return true; }
  bool operator!=(const LargePageAllocator&) const { return false; }

 private:
  static constexpr std::size_t kLargePage = std::size_t{2} << 20;
};

template <typename T>
using LargeVector = std::vector<T, LargePageAllocator<T>>;

}  // namespace sensor_rt
