#include "sensor_rt/scene/light.h"

#include <algorithm>
#include <cmath>

namespace sensor_rt {
namespace {

/// Nodes and weights of Gauss-Legendre quadrature on [-1, 1].
constexpr double kNode4[] = {-0.8611363115940526, -0.3399810435848563, 0.3399810435848563,
                             0.8611363115940526};
constexpr double kWeight4[] = {0.3478548451374538, 0.6521451548625461, 0.6521451548625461,
                               0.3478548451374538};
constexpr double kNode2 = 0.5773502691896258;

/// Returns the sample at (x, y) of an area light, in its own frame.
LightSample sample_at(const Rigid3& reference_from_light, double x, double y, double power) {
  return {reference_from_light * Eigen::Vector3d(x, y, 0.0), reference_from_light.rotation.col(2), power};
}

}  // namespace

double in_band_share(const Light& light, const Band& filter, double laser_wavelength) {
  if (light.in_band.has_value()) return *light.in_band;
  // A camera's transmission is specified at the laser wavelength.
  return light.spectrum.passed_share(filter) / std::max(1e-12, filter.transmission(laser_wavelength));
}

double LightSample::intensity(const Eigen::Vector3d& direction) const {
  if (normal.isZero()) return power / (4.0 * M_PI);
  return power / M_PI * std::max(0.0, normal.dot(direction));
}

IncidentLight LightSample::at(const Eigen::Vector3d& point) const {
  const Eigen::Vector3d to_light = position - point;
  const double distance2 = to_light.squaredNorm();
  if (!(distance2 > 0.0)) return {};
  const Eigen::Vector3d towards = to_light / std::sqrt(distance2);
  return {towards, intensity(-towards) / distance2};
}

int light_samples(const Light& light, const Rigid3& reference_from_light, LightSample* samples) {
  if (light.kind == LightKind::kPoint) {
    samples[0] = {reference_from_light.translation, Eigen::Vector3d::Zero(), light.power};
    return 1;
  }
  for (int k = 0; k < kLightSamples; ++k) {
    if (light.kind == LightKind::kRectangle) {
      const double x = 0.5 * light.size.x() * kNode4[k / 4];
      const double y = 0.5 * light.size.y() * kNode4[k % 4];
      samples[k] =
          sample_at(reference_from_light, x, y, light.power * kWeight4[k / 4] * kWeight4[k % 4] / 4.0);
    } else {
      // Two rings of equal area, rotated against each other by half a step.
      const double ring2 = 0.5 * (1.0 + (k < 8 ? -kNode2 : kNode2));
      const double angle = M_PI * (k % 8 + (k < 8 ? 0.0 : 0.5)) / 4.0;
      const double radius = 0.5 * light.size.x() * std::sqrt(ring2);
      samples[k] = sample_at(reference_from_light, radius * std::cos(angle), radius * std::sin(angle),
                             light.power / kLightSamples);
    }
  }
  return kLightSamples;
}

LightSample random_light_sample(const Light& light, const Rigid3& reference_from_light, double u, double v) {
  if (light.kind == LightKind::kPoint)
    return {reference_from_light.translation, Eigen::Vector3d::Zero(), light.power};
  if (light.kind == LightKind::kRectangle) {
    return sample_at(reference_from_light, light.size.x() * (u - 0.5), light.size.y() * (v - 0.5),
                     light.power);
  }
  const double radius = 0.5 * light.size.x() * std::sqrt(u);
  const double angle = 2.0 * M_PI * v;
  return sample_at(reference_from_light, radius * std::cos(angle), radius * std::sin(angle), light.power);
}

}  // namespace sensor_rt
