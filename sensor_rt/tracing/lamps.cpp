#include "sensor_rt/tracing/lamps.h"

#include <algorithm>
#include <cmath>

namespace sensor_rt {
namespace {

// A part is as large as four points of Gauss-Legendre quadrature permit, which integrate 1 / (1 + x²)² within
// 0.5 % over parts whose half length is less than 0.75 + 0.4 |x| in the middle.
constexpr double kNear = 0.65;   // half an edge, of its distance
constexpr double kLobe = 0.65;   // half the turn of the half vector along an edge, of the width of the lobe,
constexpr double kBeside = 0.5;  // and of the distance of the part from the normal
constexpr double kRise = 2.0;    // the same of the elevation above the surface, of which less depends
constexpr double kWidest = 1.0;  // part of a disc, beyond which the lengths of lines vary too much
constexpr int kDivisions = 64;

}  // namespace

/// An area light that lights a point of a surface.
struct Lamps::AreaLight {
  const Light& light;
  const Rigid3& reference_from_light;
  const SurfacePoint& at;
  const Bsdf& brdf;
  std::size_t instant;
  double lobe_width;
  Eigen::Vector3d point, normal, view;  ///< in the light's frame; for half vectors with the lobe
  LightHeight height;

  AreaLight(const Light& lamp, const Rigid3& pose, const SurfacePoint& lit, const Bsdf& surface,
            std::size_t when)
      : light(lamp),
        reference_from_light(pose),
        at(lit),
        brdf(surface),
        instant(when),
        lobe_width(surface.lobe_width()),
        point(pose.inverse() * lit.position),
        normal(pose.rotation.transpose() * lit.normal),
        view(pose.rotation.transpose() * surface.lobe_view(lit.surface, lit.back)),
        height{-normal.dot(point), normal.head<2>()} {}

  /// Returns the axis along which a part is too long for the samples, and longer than along the other; -1:
  /// none.
  int too_long(const LightPart& part) const {
    if (light.kind == LightKind::kDisc && part.sizes().x() > kWidest) return 0;
    const auto longer = [](double u, double v) { return std::max(u, v) > 1.0 ? (v > u ? 1 : 0) : -1; };
    constexpr int kPlaces = 5;  // the corners, by u and v, and the middle
    Eigen::Vector3d ways[kPlaces];
    for (int k = 0; k < kPlaces; ++k) {
      const Eigen::Vector2d at = k < 4 ? part.corner(static_cast<LightPart::CornerType>(k)) : part.center();
      const LightLine line = line_at(light, at.x());
      ways[k] = Eigen::Vector3d(line.x, line.half_length * at.y(), 0.0) - point;
    }
    const auto along_edges = [](const auto& difference) {
      return Eigen::Vector2d(0.5 * std::max(difference(0, 1), difference(2, 3)),
                             0.5 * std::max(difference(0, 2), difference(1, 3)));
    };
    const Eigen::AlignedBox2d box = box_around(light, part);
    const double distance = std::hypot(box.exteriorDistance(point.head<2>().eval()), point.z());
    const Eigen::Vector2d half = along_edges([&](int a, int b) { return (ways[a] - ways[b]).norm(); });
    const int near = longer(half.x() / (kNear * distance), half.y() / (kNear * distance));
    if (near >= 0 || !std::isfinite(lobe_width)) return near;
    Eigen::Vector3d halfway[kPlaces];
    double elevation[kPlaces];
    double slope = 1.0;
    double lowest = 1.0;
    for (int k = 0; k < kPlaces; ++k) {
      const Eigen::Vector3d direction = ways[k].normalized();
      halfway[k] = (direction + view).normalized();
      elevation[k] = normal.dot(direction);
      slope = std::min(slope, halfway[k].cross(normal).norm());
      lowest = std::min(lowest, std::max(0.0, elevation[k]));
    }
    const auto limit = [&](double away) { return kLobe * lobe_width + kBeside * away; };
    const Eigen::Vector2d turn = along_edges([&](int a, int b) { return (halfway[a] - halfway[b]).norm(); });
    const Eigen::Vector2d rise =
        along_edges([&](int a, int b) { return std::abs(elevation[a] - elevation[b]); });
    const Eigen::Vector2d share = (turn / limit(slope)).cwiseMax(rise / (kRise * limit(lowest)));
    return longer(share.x(), share.y());
  }
};

double Lamps::visible(const SurfacePoint& at, std::size_t instant, const LightSample* samples,
                      const double* light, int count) const {
  static_assert(kLightSamples <= kLanes);
  std::size_t instants[kLanes];
  std::fill_n(instants, kLanes, instant);
  Lanes3 origin;
  Lanes3 to_light;
  alignas(64) int unoccluded[kLanes] = {};
  bool any = false;
  for (int l = 0; l < kLanes; ++l) {
    set_lane(origin, l, at.above());
    set_lane(to_light, l, samples[std::min(l, count - 1)].position - at.above());
    unoccluded[l] = l < count && light[l] > 0.0 ? -1 : 0;
    any = any || unoccluded[l] != 0;
  }
  if (!any) return 0.0;
  query_.occlude(instants, origin, to_light, unoccluded);
  double sum = 0.0;
  for (int l = 0; l < count; ++l) sum += unoccluded[l] != 0 ? light[l] : 0.0;
  return sum;
}

/// Returns the visible light of a part.
double Lamps::integral(const AreaLight& lamp, const LightPart& part, int divisions) const {
  if (!(lamp.height.highest_in(box_around(lamp.light, part)) > 0.0)) return 0.0;
  const int axis = divisions < kDivisions ? lamp.too_long(part) : -1;
  if (axis >= 0) {
    LightPart lower = part;
    LightPart upper = part;
    lower.max()[axis] = upper.min()[axis] = part.center()[axis];
    return integral(lamp, lower, divisions + 1) + integral(lamp, upper, divisions + 1);
  }
  LightSample samples[kLightSamples];
  double light[kLightSamples];
  light_samples(lamp.light, lamp.reference_from_light, part, lamp.height, samples);
  for (int k = 0; k < kLightSamples; ++k) {
    light[k] = lamp.at.reflected(samples[k].at(lamp.at.position), lamp.brdf);
  }
  return visible(lamp.at, lamp.instant, samples, light, kLightSamples);
}

double Lamps::brightness(const SurfacePoint& at, const Bsdf& brdf, std::size_t instant) const {
  const std::vector<Light>& lights = query_.scene().lights();
  double sum = 0.0;
  for (std::size_t number = 0; number < lights.size(); ++number) {
    const Light& light = lights[number];
    const Rigid3& reference_from_light = query_.track().reference_from_light(number, instant);
    double reflected = 0.0;
    if (light.kind == LightKind::kPoint) {
      const LightSample sample{reference_from_light.translation, Eigen::Vector3d::Zero(), light.power};
      const double direct = at.reflected(sample.at(at.position), brdf);
      reflected = visible(at, instant, &sample, &direct, 1);
    } else {
      const AreaLight lamp(light, reference_from_light, at, brdf, instant);
      const LightPart part = part_above(light, lamp.height);
      if (lamp.point.z() > 0.0 && !part.isEmpty()) reflected = integral(lamp, part, 0);
    }
    sum += in_band_share(light, filter_, laser_wavelength_) * reflected;
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
  const auto met = light_sample_met(light, reference_from_light, at.position, out.towards);
  if (!met) return {};
  const Eigen::Vector3d way = met->position - at.position;
  const double distance = way.norm();
  const double pdf = distance * distance * distance / (-way.dot(met->normal) * light_area(light));
  const double weight = out.pdf / (out.pdf + pdf);
  const double exitance = in_band_share(light, filter_, laser_wavelength_) * light.power / light_area(light);
  return {weight * exitance * out.weight, met->position - at.above()};
}

}  // namespace sensor_rt
