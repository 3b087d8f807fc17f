#include "sensor_rt/pipeline/ordered_profiles.h"

#include <algorithm>
#include <utility>

namespace sensor_rt {

OrderedProfiles::OrderedProfiles(std::size_t points) {
  // Room that is never written to costs nothing; a bound keeps an overestimate from being refused.
  constexpr std::size_t kMost = 4'000'000;
  all_.reserve(std::min(points, kMost));
}

Profiles OrderedProfiles::borrow() {
  const std::lock_guard<std::mutex> lock(guard_);
  if (free_.empty()) return {};
  Profiles profiles = std::move(free_.back());
  free_.pop_back();
  profiles.clear();
  return profiles;
}

void OrderedProfiles::hand_in(std::size_t number, Profiles&& profiles) {
  const std::lock_guard<std::mutex> lock(guard_);
  waiting_.emplace(number, std::move(profiles));
  for (auto first = waiting_.begin(); first != waiting_.end() && first->first == next_;
       first = waiting_.begin()) {
    all_.append(first->second);
    free_.push_back(std::move(first->second));
    waiting_.erase(first);
    ++next_;
  }
}

}  // namespace sensor_rt
