// Vectors of many megabytes.
#pragma once

#include <cstddef>
#include <cstdint>
#include <limits>
#include <memory>
#include <new>
#include <vector>

#if defined(__linux__)
#include <sys/mman.h>
#endif

namespace sensor_rt {

constexpr std::size_t kLargePage = std::size_t{2} << 20;

#if defined(__linux__)
/// Returns `bytes`, a multiple of kLargePage and aligned to it, in huge pages if the system grants them.
inline void* map_pages(std::size_t bytes) {
  void* const mapped =
      mmap(nullptr, bytes + kLargePage, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
  if (mapped == MAP_FAILED) throw std::bad_alloc();
  char* const begin = static_cast<char*>(mapped);
  const std::size_t before = (kLargePage - reinterpret_cast<std::uintptr_t>(begin) % kLargePage) % kLargePage;
  if (before > 0) munmap(begin, before);
  munmap(begin + before + bytes, kLargePage - before);
  madvise(begin + before, bytes, MADV_HUGEPAGE);  // may be refused; normal pages work too
  return begin + before;
}
inline void unmap_pages(void* memory, std::size_t bytes) { munmap(memory, bytes); }
#else
inline void* map_pages(std::size_t bytes) { return ::operator new(bytes, std::align_val_t(kLargePage)); }
inline void unmap_pages(void* memory, std::size_t) {
  ::operator delete(memory, std::align_val_t(kLargePage));
}
#endif

/// Allocator that maps huge pages for large blocks. Page faults dominate the cost of memory that is written
/// only once; blocks of the heap would leave gaps behind.
template <typename T>
struct LargePageAllocator {
  using value_type = T;

  LargePageAllocator() = default;
  template <typename U>
  LargePageAllocator(const LargePageAllocator<U>&) {}

  T* allocate(std::size_t count) {
    if (count > std::numeric_limits<std::size_t>::max() / (2 * sizeof(T))) throw std::bad_alloc();
    if (is_large(count)) return static_cast<T*>(map_pages(padded(count)));
    return std::allocator<T>().allocate(count);
  }
  void deallocate(T* memory, std::size_t count) {
    if (is_large(count)) {
      unmap_pages(memory, padded(count));
    } else {
      std::allocator<T>().deallocate(memory, count);
    }
  }

  bool operator==(const LargePageAllocator&) const { return true; }
  bool operator!=(const LargePageAllocator&) const { return false; }

 private:
  static bool is_large(std::size_t count) { return count * sizeof(T) >= kLargePage; }
  static std::size_t padded(std::size_t count) {
    return (count * sizeof(T) + kLargePage - 1) / kLargePage * kLargePage;
  }
};

template <typename T>
using LargeVector = std::vector<T, LargePageAllocator<T>>;

}  // namespace sensor_rt
