// Pipeline stages and the time spent in each.
#pragma once

#include <array>
#include <chrono>

namespace sensor_rt {

enum Stage { kCast, kRender, kDetect, kExtract, kTriangulate, kStageCount };
constexpr std::array<const char*, kStageCount> kStageNames{"cast", "render", "detect", "extract",
                                                           "triangulate"};

using StageSeconds = std::array<double, kStageCount>;

/// Adds the time from its construction to its destruction to an account.
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
