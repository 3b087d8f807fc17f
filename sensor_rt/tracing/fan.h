// Rays from one point, side by side.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "sensor_rt/geometry/lanes.h"

namespace sensor_rt {

/// Rays from one point within the half-space z > 0 of a reference frame, side by side along its y: y / z
/// grows from one to the next. "Across" means y / z.
class Fan {
 public:
  /// `count` rays in packets of sixteen; lanes past the end are not looked at.
  Fan(std::vector<Lanes3> directions, std::size_t count);

  std::size_t count() const { return count_; }
  const std::vector<Lanes3>& directions() const { return directions_; }
  /// -1 for the lanes of a packet that are rays, else 0.
  const int* valid(std::size_t packet) const {
    return packet + 1 < directions_.size() ? kAllLanes : last_packet_;
  }
  /// True when all rays lie in the plane x = 0 exactly and from one to the next hardly change their distance.
  bool is_even() const { return even_; }
  /// Of each ray; infinite past the end.
  const float* across() const { return across_.data(); }
  /// z of each direction.
  const float* towards() const { return towards_.data(); }

  /// Tells which of a few rays pass between two places across: all of [first(low), end(high)), and hardly any
  /// others.
  struct Numbering {
    float rate;  ///< rays per place across
    float from;
    float until;
    float least;  ///< number of a ray
    float most;

    std::int32_t first(float low) const { return limited(low * rate + from); }
    std::int32_t end(float high) const { return limited(high * rate + until); }

   private:
    std::int32_t limited(float number) const {
      const float above = number > least ? number : least;
      return static_cast<std::int32_t>(above < most ? above : most);
    }
  };
  /// For places that no rays but [first, end) pass, of an even fan. About the middle one rays are numbered in
  /// proportion; the more there are, the more room that needs.
  Numbering numbering(std::int32_t first, std::int32_t end) const;

 private:
  void measure_rates();

  alignas(64) static constexpr int kAllLanes[kLanes] = {-1, -1, -1, -1, -1, -1, -1, -1,
                                                        -1, -1, -1, -1, -1, -1, -1, -1};

  std::vector<Lanes3> directions_;
  std::size_t count_;
  alignas(64) int last_packet_[kLanes] = {};
  bool even_ = true;
  std::vector<float> across_;
  std::vector<float> towards_;
  std::vector<float> rate_;  ///< rays per place across, at each ray
  float bend_ = 0.0f;        ///< error of a number in proportion, per square of the distance in rays
};

}  // namespace sensor_rt
