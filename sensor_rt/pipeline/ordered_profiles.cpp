#include "sensor_rt/pipeline/ordered_profiles.h"

#include <algorithm>
#include <utility>

namespace sensor_rt {

OrderedProfiles::OrderedProfiles(std::size_t points) {
  // Memory that is never written costs nothing; the bound prevents a failing allocation on overestimates.
  constexpr std::size_t kCapacity = 4'000'000;
  all_.reserve(std::min(points, kCapacity));
}

Profiles OrderedProfiles::acquire() {
  const std::lock_guard<std::mutex> lock(guard_);
  if (free_.empty()) return {};
  Profiles profiles = std::move(free_.back());
  free_.pop_back();
  profiles.clear();
  return profiles;
}

void OrderedProfiles::submit(std::size_t number, Profiles&& profiles) {
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
