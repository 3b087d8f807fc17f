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

LightLine line_at(const Light& light, double u) {
  const Eigen::Vector2d half = 0.5 * light.size;
  if (light.kind == LightKind::kRectangle) return {half.x() * u, half.y(), half.x()};
  const double angle = 0.5 * M_PI * u;  // the ends of lines are a smooth function of it
  return {half.x() * std::sin(angle), half.x() * std::cos(angle), 0.5 * M_PI * half.x() * std::cos(angle)};
}

LightPart part_above(const Light& light, const LightHeight& height) {
  // The highest point of a line lies middle + rise.x x / half + rise.y times its share of the longest above
  // the surface.
  const Eigen::Vector2d rise(0.5 * light.size.x() * height.slope.x(),
                             0.5 * light.size.y() * std::abs(height.slope.y()));
  double low = -1.0;
  double high = 1.0;
  if (light.kind == LightKind::kDisc) {  // middle + |rise| cos(angle - steepest)
    const double share = -height.middle / std::max(rise.norm(), 1e-300);
    if (share >= 1.0) return {};
    const double steepest = std::atan2(rise.x(), rise.y());
    const double reach = std::acos(std::max(-1.0, share));
    low = std::max(low, (steepest - reach) / (0.5 * M_PI));
    high = std::min(high, (steepest + reach) / (0.5 * M_PI));
  } else {
    const double middle = height.middle + rise.y();
    if (middle + std::abs(rise.x()) <= 0.0) return {};
    if (middle < std::abs(rise.x())) (rise.x() > 0.0 ? low : high) = -middle / rise.x();
  }
  return {Eigen::Vector2d(low, -1.0), Eigen::Vector2d(high, 1.0)};
}

Eigen::AlignedBox2d box_around(const Light& light, const LightPart& part) {
  Eigen::AlignedBox2d box;
  const double longest = std::clamp(0.0, part.min().x(), part.max().x());
  for (const double u : {part.min().x(), longest, part.max().x()}) {
    const LightLine line = line_at(light, u);
    box.extend(Eigen::Vector2d(line.x, line.half_length * part.min().y()));
    box.extend(Eigen::Vector2d(line.x, line.half_length * part.max().y()));
  }
  return box;
}

double light_area(const Light& light) {
  return light.size.x() * light.size.y() * (light.kind == LightKind::kDisc ? 0.25 * M_PI : 1.0);
}

void light_samples(const Light& light, const Rigid3& reference_from_light, const LightPart& part,
                   const LightHeight& height, LightSample* samples) {
  const double half_u = 0.5 * part.sizes().x();
  for (int i = 0; i < 4; ++i) {
    const LightLine line = line_at(light, part.center().x() + half_u * kNode4[i]);
    double low = line.half_length * part.min().y();
    double high = line.half_length * part.max().y();
    const double from = height.at({line.x, low});
    const double to = height.at({line.x, high});
    if (std::min(from, to) < 0.0) {
      const double horizon = std::max(from, to) > 0.0 ? low + (high - low) * from / (from - to) : low;
      (to > 0.0 ? low : high) = horizon;
    }
    const double half = 0.5 * (high - low);
    const double power = light.power / light_area(light) * line.width * half_u * half * kWeight4[i];
    for (int j = 0; j < 4; ++j) {
      const double y = low + half + half * kNode4[j];
      samples[4 * i + j] = sample_at(reference_from_light, line.x, y, power * kWeight4[j]);
    }
  }
}

std::optional<LightSample> light_sample_met(const Light& light, const Rigid3& reference_from_light,
                                            const Eigen::Vector3d& origin, const Eigen::Vector3d& direction) {
  const Rigid3 light_from_reference = reference_from_light.inverse();
  const Eigen::Vector3d from = light_from_reference * origin;
  const Eigen::Vector3d way = light_from_reference.rotation * direction;
  if (!(from.z() > 0.0) || !(way.z() < 0.0)) return std::nullopt;
  const Eigen::Vector2d met = (from - from.z() / way.z() * way).head<2>();
  const Eigen::Array2d share = 2.0 * met.array() / light.size.array();
  if (!(light.kind == LightKind::kDisc ? share.matrix().norm() <= 1.0 : share.abs().maxCoeff() <= 1.0)) {
    return std::nullopt;
  }
  return sample_at(reference_from_light, met.x(), met.y(), light.power);
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
