// What is expensive to make and the same for equal keys, shared between its users.
#pragma once

#include <cstddef>
#include <deque>
#include <memory>
#include <mutex>
#include <utility>

namespace sensor_rt {

/// Keeps the values that were made last, one for each key. Of several threads that ask for the same value one
/// makes it.
template <typename Key, typename Value>
class Recent {
 public:
  /// `count`: number of values to keep.
  explicit Recent(std::size_t count) : count_(count) {}

  /// Returns the value of a key, which `make()` returns if it is not kept.
  template <typename Make>
  std::shared_ptr<const Value> get(const Key& key, const Make& make) {
    const std::lock_guard<std::mutex> lock(mutex_);
    for (const auto& [known, value] : kept_) {
      if (known == key) return value;
    }
    kept_.emplace_front(key, std::make_shared<const Value>(make()));
    if (kept_.size() > count_) kept_.pop_back();
    return kept_.front().second;
  }

 private:
  std::size_t count_;
  std::mutex mutex_;
  std::deque<std::pair<Key, std::shared_ptr<const Value>>> kept_;
};

}  // namespace sensor_rt
