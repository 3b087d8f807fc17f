// Vibration in closed form, so that it does not depend on the step size.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <vector>

#include "fmu/model/vibration_parameters.h"

namespace robotcell {

/// Displacement of a frame along its nominal axes, and its rate.
struct Displacement {
  Eigen::Vector3d position = Eigen::Vector3d::Zero();  // m
  Eigen::Vector3d velocity = Eigen::Vector3d::Zero();  // m/s
};

/// A sine along each axis plus a random part: a sum of sines of equal amplitude with random phases and
/// stratified random frequencies in a band.
class Vibration {
 public:
  /// Throws std::invalid_argument for invalid parameters; `name` is their name in messages.
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
