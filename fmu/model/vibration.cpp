#include "fmu/model/vibration.h"

#include <cmath>
#include <stdexcept>
#include <string>

#include "fmu/control/time_units.h"
#include "fmu/model/as_built.h"
#include "fmu/model/random.h"

namespace robotcell {
namespace {

constexpr double kTwoPi = 6.283185307179586;
constexpr int kRandomWaves = 32;  // per axis

void check(const VibrationParameters& parameters, const std::string& name) {
  const std::string group = "as_built.vibration." + name;
  if (parameters.random_rms > 0 && parameters.random_width <= 0) {
    throw std::invalid_argument(group + ".random_width must be positive where .random_rms is, but is " +
                                std::to_string(parameters.random_width));
  }
}

}  // namespace

Vibration::Vibration(const VibrationParameters& parameters, const char* name, std::uint64_t key) {
  check(parameters, name);
  const Eigen::Vector3d amplitude(parameters.amplitude[0], parameters.amplitude[1], parameters.amplitude[2]);
  if (!amplitude.isZero(0)) waves_.push_back({amplitude, kTwoPi * parameters.frequency, parameters.phase});
  if (parameters.random_rms > 0) add_random_waves(parameters, key);
}

void Vibration::add_random_waves(const VibrationParameters& parameters, std::uint64_t key) {
  // n sines of amplitude a have the mean square n a^2 / 2.
  const double amplitude = parameters.random_rms * std::sqrt(2.0 / kRandomWaves);
  const double slot = parameters.random_width / kRandomWaves;
  for (int axis = 0; axis < 3; ++axis) {
    for (int i = 0; i < kRandomWaves; ++i) {
      const std::uint64_t own = mixed(key + static_cast<std::uint64_t>(axis * kRandomWaves + i));
      const double frequency = parameters.random_low + slot * (i + uniform(mixed(own)));
      waves_.push_back(
          {amplitude * Eigen::Vector3d::Unit(axis), kTwoPi * frequency, kTwoPi * uniform(mixed(~own))});
    }
  }
}

Displacement Vibration::at(std::int64_t time_us) const {
  const double time = static_cast<double>(time_us) * kSecondsPerMicrosecond;
  Displacement sum;
  for (const Wave& wave : waves_) {
    const double angle = wave.angular_frequency * time + wave.phase;
    sum.position += wave.amplitude * std::sin(angle);
    sum.velocity += wave.amplitude * (wave.angular_frequency * std::cos(angle));
  }
  return sum;
}

double residual_share(double elapsed) { return std::exp(-elapsed / kResidualDecayTime); }

CellVibration::CellVibration(const AsBuilt& as_built, std::uint64_t key)
    : base_(as_built.base_vibration, "base", key + 1000),
      flange_(as_built.flange_vibration, "flange", key + 2000),
      table_(as_built.table_vibration, "table", key + 3000) {}

VibrationDisplacements CellVibration::at(std::int64_t time_us) const {
  return {base_.at(time_us), flange_.at(time_us), table_.at(time_us)};
}

}  // namespace robotcell
