// The stations of the line and the time spent at each.
#pragma once

#include <array>
#include <chrono>

namespace sensor_rt {

enum Station { kCast, kRender, kDetect, kExtract, kTriangulate, kStationCount };
constexpr std::array<const char*, kStationCount> kStationNames{"cast", "render", "detect", "extract",
                                                               "triangulate"};

using StationSeconds = std::array<double, kStationCount>;

/// Adds the time from its construction to its end to an account.
class Stopwatch {
 public:
  explicit Stopwatch(double& account) : account_(account), start_(Clock::now()) {}
  ~Stopwatch() { account_ += std::chrono::duration<double>(Clock::now() - start_).count(); }
  Stopwatch(const Stopwatch&) = delete;
  Stopwatch& operator=(const Stopwatch&) = delete;

 private:
  using Clock = std::chrono::steady_clock;

  double& account_;
  Clock::time_point start_;
};

}  // namespace sensor_rt
