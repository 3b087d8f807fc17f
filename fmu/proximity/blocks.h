// Work in blocks on several threads.
#pragma once

#include <algorithm>
#include <atomic>
#include <exception>
#include <mutex>
#include <system_error>
#include <thread>
#include <vector>

namespace robotcell::proximity {

/// Runs `work(first, last)` for all blocks of `block` items out of `count` on several threads, 0 for all
/// cores; rethrows the first exception.
template <typename Work>
void for_each_block(std::size_t count, std::size_t block, unsigned threads, const Work& work) {
  const std::size_t blocks = (count + block - 1) / block;
  const std::size_t cores = std::max(1u, threads > 0 ? threads : std::thread::hardware_concurrency());
  std::atomic<std::size_t> next{0};
  std::exception_ptr error;
  std::mutex error_mutex;
  const auto share = [&] {
    try {
      for (std::size_t i = next++; i < blocks; i = next++) {
        work(i * block, std::min(count, (i + 1) * block));
      }
    } catch (...) {
      const std::lock_guard<std::mutex> lock(error_mutex);
      error = std::current_exception();
    }
  };
  std::vector<std::thread> others;
  try {
    for (std::size_t i = 1; i < std::min(cores, blocks); ++i) others.emplace_back(share);
  } catch (const std::system_error&) {
    // The system gives no further threads: those that run share the blocks.
  }
  share();
  for (std::thread& other : others) other.join();
  if (error) std::rethrow_exception(error);
}

}  // namespace robotcell::proximity
