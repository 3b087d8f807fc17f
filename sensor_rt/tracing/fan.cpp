#include "sensor_rt/tracing/fan.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

namespace sensor_rt {
namespace {

constexpr float kInfinity = std::numeric_limits<float>::infinity();
constexpr double kMaxBend = 0.01;
constexpr float kRoom = 0.01f;  ///< tolerance for rounding, in ray indices

}  // namespace

constexpr int Fan::kAllLanes[];

Fan::Fan(std::vector<Lanes3> directions, std::size_t count)
    : directions_(std::move(directions)), count_(count) {
  for (std::size_t l = 0; l < kLanes; ++l) {
    last_packet_[l] = (directions_.size() - 1) * kLanes + l < count ? -1 : 0;
  }
  for (std::size_t i = 0; i < directions_.size() * kLanes; ++i) {
    const Eigen::Vector3d direction = lane(directions_[i / kLanes], static_cast<int>(i % kLanes));
    even_ = even_ && direction.x() == 0.0 && direction.z() > 0.0;
    across_.push_back(i < count ? static_cast<float>(direction.y() / direction.z()) : kInfinity);
    towards_.push_back(static_cast<float>(direction.z()));
  }
  across_.push_back(kInfinity);
  measure_rates();
}

void Fan::measure_rates() {
  const auto across = [this](std::size_t i) {
    const Eigen::Vector3d direction = lane(directions_[i / kLanes], static_cast<int>(i % kLanes));
    return direction.y() / direction.z();
  };
  rate_.assign(count_, 0.0f);
  double least_step = std::numeric_limits<double>::infinity();
  double most_change = 0.0;
  for (std::size_t i = 0; i < count_ && count_ > 1; ++i) {
    const std::size_t before = i > 0 ? i - 1 : i;
    const std::size_t after = std::min(i + 1, count_ - 1);
    const double step = (across(after) - across(before)) / static_cast<double>(after - before);
    rate_[i] = static_cast<float>(1.0 / step);
    least_step = std::min(least_step, step);
    if (after - before == 2) {
      most_change = std::max(most_change, std::abs(across(after) - 2.0 * across(i) + across(before)));
    }
  }
  // Taylor remainder: half of the largest second difference per square of the distance.
  const double bend = 0.5 * most_change / least_step;
  even_ = even_ && least_step > 0.0 && bend <= kMaxBend;
  bend_ = static_cast<float>(bend);
}

Fan::Numbering Fan::numbering(std::int32_t first, std::int32_t end) const {
  const std::int32_t middle = (first + end) / 2;
  const auto m = static_cast<std::size_t>(std::min(middle, static_cast<std::int32_t>(count_) - 1));
  const float farthest = 0.5f * static_cast<float>(end - first) + 2.0f;
  const float room = kRoom + bend_ * farthest * farthest;
  const float number = static_cast<float>(m) + 1.0f - across_[m] * rate_[m];
  return {rate_[m], number - room, number + room, static_cast<float>(first), static_cast<float>(end)};
}

}  // namespace sensor_rt
