// Vibration of what should stand still: a closed form of time, so that it is the same at any step.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <vector>

#include "fmu/model/vibration_parameters.h"

namespace robotcell {

/// Displacement of a frame along its own nominal axes, and its rate.
struct Displacement {
  Eigen::Vector3d position = Eigen::Vector3d::Zero();  // m
  Eigen::Vector3d velocity = Eigen::Vector3d::Zero();  // m/s
};

/// A sine along each axis, and a random part: a sum of sines whose frequencies lie evenly in a band, each
/// somewhere in its own slot, with random phases and equal power.
class Vibration {
 public:
  /// Throws std::invalid_argument where a number makes no sense; `name` is the parameters' own.
  Vibration(const VibrationParameters& parameters, const char* name, std::uint64_t key);

  bool active() const { return !waves_.empty(); }
  Displacement at(std::int64_t time_us) const;

 private:
  struct Wave {
    Eigen::Vector3d amplitude;
    double angular_frequency, phase;
  };
  void add_random_waves(const VibrationParameters& parameters, std::uint64_t key);

  std::vector<Wave> waves_;
};

}  // namespace robotcell
