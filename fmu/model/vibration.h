// Vibration of robot base, flange and table, in closed form, so that it does not depend on the step size.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <vector>

#include "fmu/model/fields.h"

namespace robotcell {

struct AsBuilt;

/// Vibration of one body of the cell.
struct VibrationParameters {
  std::array<double, 3> amplitude{};        // m, of a sine along each axis of the body
  double frequency = 0;                     // Hz
  double phase = 0;                         // rad, at time 0
  double random_rms = 0;                    // m, along each axis
  double random_low = 0, random_width = 0;  // Hz, lower limit and width of the band of the random part

  template <class Visitor>
  static void declare(Visitor& visit, VibrationParameters& v) {
    visit(v, state(v.amplitude, "amplitude"), state(v.frequency, "frequency"), state(v.phase, "phase"),
          state(v.random_rms, "random_rms"), state(v.random_low, "random_low"),
          state(v.random_width, "random_width"));
  }
};

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

/// s. When a part passes from one vibrating body to another, the difference of their displacements decays
/// with this time constant.
constexpr double kResidualDecayTime = 0.02;

/// Share of a residual displacement that is left after a time (s).
double residual_share(double elapsed);

/// Displacements of robot base, flange and table, each along its own axes.
struct VibrationDisplacements {
  Displacement base, flange, table;
};

/// Vibration of robot base, flange and table, superimposed on their motion.
/// Affects true poses only, neither encoder readings nor the dynamics: the displacements are too small to
/// move what lies there.
class CellVibration {
 public:
  /// Throws std::invalid_argument for invalid parameters.
  CellVibration(const AsBuilt& as_built, std::uint64_t key);

  VibrationDisplacements at(std::int64_t time_us) const;

 private:
  Vibration base_, flange_, table_;
};

}  // namespace robotcell
