// Fan of rays from one point.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "sensor_rt/geometry/lanes.h"

namespace sensor_rt {

/// Rays from one point within the half-space z > 0 of a reference frame, sorted by y: y / z increases from
/// ray to ray. "Across" is y / z.
class Fan {
 public:
  /// `count` rays in packets of sixteen; lanes past the end are ignored.
  Fan(std::vector<Lanes3> directions, std::size_t count);

  std::size_t count() const { return count_; }
  const std::vector<Lanes3>& directions() const { return directions_; }
  /// Returns -1 for the lanes of a packet that hold rays, else 0.
  const int* valid(std::size_t packet) const {
    return packet + 1 < directions_.size() ? kAllLanes : last_packet_;
  }
  /// Returns true when all rays lie exactly in the plane x = 0 and their spacing varies slowly.
  bool is_even() const { return even_; }
  /// y / z of each ray; infinite past the end.
  const float* across() const { return across_.data(); }
  /// z of each direction.
  const float* towards() const { return towards_.data(); }

  /// Maps an interval of y / z to the rays within it: all of [first(low), end(high)), plus few others.
  struct Numbering {
    float rate;  ///< rays per unit of y / z
    float from;
    float until;
    float least;  ///< smallest ray index
    float most;

    std::int32_t first(float low) const { return limited(low * rate + from); }
    std::int32_t end(float high) const { return limited(high * rate + until); }

   private:
    std::int32_t limited(float number) const {
      const float above = number > least ? number : least;
      return static_cast<std::int32_t>(above < most ? above : most);
    }
  };
  /// Returns the mapping for intervals that contain only rays of [first, end), for an even fan. It is linear
  /// about the middle ray; its tolerance grows with the number of rays.
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
  std::vector<float> rate_;  ///< rays per unit of y / z, at each ray
  float bend_ = 0.0f;        ///< error of the linear mapping, per square of the distance in rays
};

}  // namespace sensor_rt
