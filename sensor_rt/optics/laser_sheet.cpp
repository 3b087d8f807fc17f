#include "sensor_rt/optics/laser_sheet.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>

namespace sensor_rt {
namespace {

/// Linear interpolation between nodes, 0 outside them.
double interpolate(const std::vector<double>& at, const std::vector<double>& value, double x) {
  if (!(x >= at.front() && x <= at.back())) return 0.0;
  const auto above = std::upper_bound(at.begin() + 1, at.end() - 1, x);
  const auto i = static_cast<std::size_t>(above - at.begin());
  const double share = (x - at[i - 1]) / (at[i] - at[i - 1]);
  return (1.0 - share) * value[i - 1] + share * value[i];
}

}  // namespace

SheetSurface::SheetSurface(const Rigid3& sensor_from_sheet, double source_z, double tangent,
                           const std::array<double, kStraightness>& straightness)
    : is_nominal_(straightness == std::array<double, kStraightness>{} && sensor_from_sheet == Rigid3{}),
      sensor_from_sheet_(sensor_from_sheet),
      source_z_(source_z),
      tangent_(tangent),
      straightness_(straightness) {}

SheetSurface::Offset SheetSurface::offset(const Eigen::Vector3d& point_in_sensor) const {
  const Eigen::Vector3d in_sheet =
      sensor_from_sheet_.rotation.transpose() * (point_in_sensor - sensor_from_sheet_.translation);
  const double depth = in_sheet.z() - source_z_;
  const double position = in_sheet.y() / (depth * tangent_);
  double bend = 0.0;
  double slope = 0.0;  // d bend / d position, by Horner's scheme
  for (auto c = straightness_.rbegin(); c != straightness_.rend(); ++c) {
    slope = slope * position + bend;
    bend = bend * position + *c;
  }
  const Eigen::Vector3d gradient(1.0, -slope / tangent_, slope * position - bend);
  return {in_sheet.x() - depth * bend, sensor_from_sheet_.rotation * gradient};
}

SheetSurface LaserSheet::surface() const {
  return {sensor_from_sheet, source_z, std::tan(fan_half_angle), straightness};
}

double LaserSheet::sigma_at(double z) const { return std::hypot(sheet_sigma, divergence * (z - waist_z)); }

double LaserSheet::max_bend() const {
  double sum = 0.0;
  for (const double coefficient : straightness) sum += std::abs(coefficient);
  return sum;
}

double LaserSheet::relative_power(double angle) const {
  return is_even() ? 1.0 : interpolate(profile_angle, profile_power, angle);
}

void LaserSheet::normalise_profile() {
  if (is_even()) return;
  std::vector<double> nodes{-fan_half_angle, fan_half_angle};
  for (const double angle : profile_angle) {
    if (std::abs(angle) < fan_half_angle) nodes.push_back(angle);
  }
  std::sort(nodes.begin(), nodes.end());
  double integral =
      0.0;  // the profile drops to 0 outside its nodes, so each interval is evaluated at its midpoint
  for (std::size_t i = 1; i < nodes.size(); ++i) {
    integral += (nodes[i] - nodes[i - 1]) *
                interpolate(profile_angle, profile_power, 0.5 * (nodes[i] + nodes[i - 1]));
  }
  if (!(integral > 0.0)) throw std::invalid_argument("the laser profile is zero within the fan");
  for (double& value : profile_power) value *= 2.0 * fan_half_angle / integral;
}

}  // namespace sensor_rt
