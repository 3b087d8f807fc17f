#include "sensor_rt/tracing/lamps.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace sensor_rt {
namespace {

constexpr double kSmooth = 3.0;       // ratio of the light of samples up to which these suffice
constexpr double kTolerance = 0.001;  // difference between a part and its quarters, of the lamp's light
constexpr double kHidden = 2.0;       // ratio of a highlight to the samples beside it
constexpr int kDeepest = 8;           // divisions

}  // namespace

/// An area light as seen from a point.
struct Lamps::AreaLight {
  const Light& light;
  const Rigid3& reference_from_light;
  const SurfacePoint& at;
  const Bsdf& brdf;
  std::size_t instant;
  double total = 0.0;  ///< present estimate of the reflected light
  int highlights = 0;
  Eigen::Vector2d highlight[2];  ///< where the light is likely to be brightest

  /// Mirrors reflect towards the camera what lies behind the surface, foils what lies behind the camera.
  void find_highlights() {
    const Eigen::Vector3d directions[] = {2.0 * at.normal.dot(at.back) * at.normal - at.back, at.back};
    for (const Eigen::Vector3d& direction : directions) {
      const auto met = nearest_on_light(light, reference_from_light, at.position, direction);
      if (met) highlight[highlights++] = *met;
    }
  }
  /// Returns the largest light per power at the points of a part that are nearest to the highlights: a
  /// highlight beside a part reaches into it.
  double brightest_in(const LightPart& part) const {
    double most = 0.0;
    for (int k = 0; k < highlights; ++k) {
      const LightSample sample =
          light_sample_at(light, reference_from_light, nearest_in_part(light, part, highlight[k]));
      most = std::max(most, at.reflected(sample.at(at.position), brdf) / sample.power);
    }
    return most;
  }
};

void Lamps::evaluate(const AreaLight& lamp, Part& part) const {
  part.sum = part.densest = 0.0;
  part.faintest = std::numeric_limits<double>::infinity();
  for (int k = 0; k < kLightSamples; ++k) {
    const LightSample& sample = part.samples[k];
    part.light[k] = lamp.at.reflected(sample.at(lamp.at.position), lamp.brdf);
    part.sum += part.light[k];
    const double density = part.light[k] / sample.power;
    part.densest = std::max(part.densest, density);
    part.faintest = std::min(part.faintest, density);
  }
}

double Lamps::visible(const AreaLight& lamp, const LightSample* samples, const double* light,
                      int count) const {
  static_assert(kLightSamples <= kLanes);
  std::size_t instants[kLanes];
  std::fill_n(instants, kLanes, lamp.instant);
  Lanes3 origin;
  Lanes3 to_light;
  alignas(64) int unoccluded[kLanes] = {};
  bool any = false;
  for (int l = 0; l < kLanes; ++l) {
    set_lane(origin, l, lamp.at.above());
    set_lane(to_light, l, samples[std::min(l, count - 1)].position - lamp.at.above());
    unoccluded[l] = l < count && light[l] > 0.0 ? -1 : 0;
    any = any || unoccluded[l] != 0;
  }
  if (!any) return 0.0;
  query_.occlude(instants, origin, to_light, unoccluded);
  double sum = 0.0;
  for (int l = 0; l < count; ++l) sum += unoccluded[l] != 0 ? light[l] : 0.0;
  return sum;
}

/// Returns the visible light of a part, divided until the light of the quarters agrees with that of the
/// whole.
double Lamps::refine(AreaLight& lamp, const Part& coarse, int depth) const {
  Part quarters[4];
  double sum = 0.0;
  bool hidden = false;
  for (int k = 0; k < 4; ++k) {
    quarters[k].part = coarse.part.quarter(k);
    light_samples(lamp.light, lamp.reference_from_light, quarters[k].part, quarters[k].samples);
    evaluate(lamp, quarters[k]);
    sum += quarters[k].sum;
    hidden = hidden || lamp.brightest_in(quarters[k].part) > kHidden * quarters[k].densest;
  }
  lamp.total += sum - coarse.sum;
  if (!hidden && std::abs(sum - coarse.sum) <= kTolerance * lamp.total) {
    return visible(lamp, coarse.samples, coarse.light, kLightSamples);
  }
  double light = 0.0;
  for (const Part& quarter : quarters) {
    light += depth < kDeepest ? refine(lamp, quarter, depth + 1)
                              : visible(lamp, quarter.samples, quarter.light, kLightSamples);
  }
  return light;
}

double Lamps::brightness(const SurfacePoint& at, const Bsdf& brdf, std::size_t instant) const {
  const std::vector<Light>& lights = query_.scene().lights();
  double sum = 0.0;
  for (std::size_t number = 0; number < lights.size(); ++number) {
    const Light& light = lights[number];
    const Rigid3& reference_from_light = query_.track().reference_from_light(number, instant);
    AreaLight lamp{light, reference_from_light, at, brdf, instant, 0.0, 0, {}};
    Part all;
    const double share = in_band_share(light, filter_, laser_wavelength_);
    if (light_samples(light, reference_from_light, all.samples) == 1) {
      const double direct = at.reflected(all.samples[0].at(at.position), brdf);
      sum += share * visible(lamp, all.samples, &direct, 1);
      continue;
    }
    evaluate(lamp, all);
    lamp.find_highlights();
    all.part = whole(light);
    if (std::max(all.densest, lamp.brightest_in(all.part)) <= kSmooth * all.faintest) {
      sum += share * visible(lamp, all.samples, all.light, kLightSamples);
    } else {
      lamp.total = all.sum;
      sum += share * refine(lamp, all, 0);
    }
  }
  return sum;
}

Lamps::Sample Lamps::sample(std::size_t number, const SurfacePoint& at, const Bsdf& brdf, std::size_t instant,
                            double u, double v) const {
  const Light& light = query_.scene().lights()[number];
  const LightSample sample =
      random_light_sample(light, query_.track().reference_from_light(number, instant), u, v);
  const Eigen::Vector3d way = sample.position - at.position;
  const double reflected =
      in_band_share(light, filter_, laser_wavelength_) * at.reflected(sample.at(at.position), brdf);
  double weight = 1.0;
  if (light.kind != LightKind::kPoint && !brdf.is_lambert() && reflected > 0.0) {
    const double distance = way.norm();
    const double pdf = distance * distance * distance / (-way.dot(sample.normal) * light_area(light));
    weight = pdf / (pdf + brdf.pdf(at.surface, at.back, way / distance));
  }
  return {weight * reflected, sample.position - at.above()};
}

Lamps::Sample Lamps::sample_reflection(std::size_t number, const SurfacePoint& at, const Bsdf& brdf,
                                       std::size_t instant, const std::array<double, 3>& u) const {
  const Light& light = query_.scene().lights()[number];
  if (light.kind == LightKind::kPoint || brdf.is_lambert()) return {};
  const BsdfSample out = brdf.sample(at.surface, at.back, u[0], u[1], u[2]);
  if (!(out.weight > 0.0) || !(out.pdf > 0.0)) return {};
  const Rigid3& reference_from_light = query_.track().reference_from_light(number, instant);
  const auto met = nearest_on_light(light, reference_from_light, at.position, out.towards);
  if (!met) return {};
  const LightSample sample = light_sample_at(light, reference_from_light, *met);
  const Eigen::Vector3d way = sample.position - at.position;
  const double distance = way.norm();
  constexpr double kSame = 1e-13;  // 1 - cosine: the ray meets the lamp itself, not only its plane
  if (!(way.dot(out.towards) >= (1.0 - kSame) * distance)) return {};
  const double pdf = distance * distance * distance / (-way.dot(sample.normal) * light_area(light));
  const double weight = out.pdf / (out.pdf + pdf);
  const double exitance = in_band_share(light, filter_, laser_wavelength_) * light.power / light_area(light);
  return {weight * exitance * out.weight, sample.position - at.above()};
}

}  // namespace sensor_rt
