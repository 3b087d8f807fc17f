// Parallel loops over threads.
#pragma once

#include <algorithm>
#include <atomic>
#include <cstddef>
#include <exception>
#include <mutex>
#include <system_error>
#include <thread>
#include <vector>

namespace sensor_rt {

/// Returns the number of threads to use: `requested`, or one per hardware thread for 0; never more than there
/// are tasks.
inline unsigned thread_count(unsigned requested, std::size_t tasks) {
  const unsigned available = requested > 0 ? requested : std::max(1u, std::thread::hardware_concurrency());
  return static_cast<unsigned>(std::max<std::size_t>(1, std::min<std::size_t>(available, tasks)));
}

/// Calls body(task, worker) for each task below `tasks` on up to `threads` threads; tasks start in ascending
/// order. The first exception stops the distribution of tasks and is rethrown here.
template <typename Body>
void parallel_for(std::size_t tasks, unsigned threads, const Body& body) {
  std::atomic<std::size_t> next{0};
  std::exception_ptr failure;
  std::mutex failure_guard;
  const auto work = [&](unsigned worker) {
    try {
      for (std::size_t task = next++; task < tasks; task = next++) body(task, worker);
    } catch (...) {
      const std::lock_guard<std::mutex> lock(failure_guard);
      if (!failure) failure = std::current_exception();
      next = tasks;
    }
  };
  const unsigned workers = thread_count(threads, tasks);
  std::vector<std::thread> pool;
  pool.reserve(workers);
  try {
    for (unsigned worker = 1; worker < workers; ++worker) pool.emplace_back(work, worker);
  } catch (const std::system_error&) {
    // The system gives no further threads: those that run share the tasks.
  }
  work(0);
  for (std::thread& thread : pool) thread.join();
  if (failure) std::rethrow_exception(failure);
}

}  // namespace sensor_rt
