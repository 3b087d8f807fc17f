#include "sensor_rt/scene/light.h"

#include <algorithm>
#include <cmath>

#include "sensor_rt/scene/light_parts.h"

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

LightPart LightPart::quarter(int number) const {
  const Eigen::Vector2d middle = 0.5 * (low + high);
  LightPart part{low, middle};
  for (int k = 0; k < 2; ++k) {
    if ((number >> k & 1) == 0) continue;
    part.low[k] = middle[k];
    part.high[k] = high[k];
  }
  return part;
}

LightPart whole(const Light& light) {
  if (light.kind == LightKind::kDisc) return {Eigen::Vector2d::Zero(), {0.5 * light.size.x(), 2.0 * M_PI}};
  return {-0.5 * light.size, 0.5 * light.size};
}

Eigen::Vector2d nearest_in_part(const Light& light, const LightPart& part, Eigen::Vector2d at) {
  if (light.kind == LightKind::kDisc) {
    const double middle = 0.5 * (part.low.y() + part.high.y());
    at.y() = middle + std::remainder(at.y() - middle, 2.0 * M_PI);
  }
  return at.cwiseMax(part.low).cwiseMin(part.high);
}

double light_area(const Light& light) {
  return light.size.x() * light.size.y() * (light.kind == LightKind::kDisc ? 0.25 * M_PI : 1.0);
}

LightSample light_sample_at(const Light& light, const Rigid3& reference_from_light,
                            const Eigen::Vector2d& at) {
  if (light.kind == LightKind::kRectangle)
    return sample_at(reference_from_light, at.x(), at.y(), light.power);
  return sample_at(reference_from_light, at.x() * std::cos(at.y()), at.x() * std::sin(at.y()), light.power);
}

void light_samples(const Light& light, const Rigid3& reference_from_light, const LightPart& part,
                   LightSample* samples) {
  const Eigen::Vector2d middle = 0.5 * (part.low + part.high);
  const Eigen::Vector2d half = 0.5 * (part.high - part.low);
  const double density = half.x() * half.y() / light_area(light);
  for (int k = 0; k < kLightSamples; ++k) {
    const Eigen::Vector2d at(middle.x() + half.x() * kNode4[k / 4], middle.y() + half.y() * kNode4[k % 4]);
    samples[k] = light_sample_at(light, reference_from_light, at);
    samples[k].power *= density * kWeight4[k / 4] * kWeight4[k % 4];
    if (light.kind == LightKind::kDisc) samples[k].power *= at.x();
  }
}

std::optional<Eigen::Vector2d> nearest_on_light(const Light& light, const Rigid3& reference_from_light,
                                                const Eigen::Vector3d& origin,
                                                const Eigen::Vector3d& direction) {
  const Rigid3 light_from_reference = reference_from_light.inverse();
  const Eigen::Vector3d from = light_from_reference * origin;
  const Eigen::Vector3d way = light_from_reference.rotation * direction;
  if (!(from.z() > 0.0) || !(way.z() < 0.0)) return std::nullopt;
  const Eigen::Vector2d met = (from - from.z() / way.z() * way).head<2>();
  if (light.kind == LightKind::kRectangle) return met.cwiseMax(-0.5 * light.size).cwiseMin(0.5 * light.size);
  return Eigen::Vector2d(std::min(met.norm(), 0.5 * light.size.x()), std::atan2(met.y(), met.x()));
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
