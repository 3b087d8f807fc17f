#include "sensor_rt/render/lamps.h"

#include <algorithm>
#include <cmath>

namespace sensor_rt {

Lamps::Lamps(const RenderPlan& plan) : plan_(plan) {}

double Lamps::received(const LightPiece& piece, const SurfacePoint& at, const Reflection& reflection) const {
  const Eigen::Vector3d way = piece.position - at.position;
  const double distance2 = way.squaredNorm();
  if (!(distance2 > 0.0)) return 0.0;
  const Eigen::Vector3d towards = way / std::sqrt(distance2);
  const double cosine = at.normal.dot(towards);
  if (!(cosine > 0.0)) return 0.0;
  return piece.intensity(-towards) * cosine / distance2 *
         reflection.diffuse_equivalent(at.normal, towards, at.back);
}

double Lamps::brightness(const SurfacePoint& at, const Reflection& reflection, std::size_t instant) const {
  const SensorModel& model = plan_.settings.model;
  const std::vector<Light>& lights = views_->scene->lights();
  std::size_t instants[kLanes];
  std::fill_n(instants, kLanes, instant);
  double sum = 0.0;
  for (std::size_t number = 0; number < lights.size(); ++number) {
    static_assert(kLightPieces <= kLanes);
    LightPiece pieces[kLightPieces];
    const int count =
        light_pieces(lights[number], views_->track->reference_from_light(number, instant), pieces);
    Lanes3 origin;
    Lanes3 way;
    double light[kLanes];
    alignas(64) int open[kLanes] = {};
    bool any = false;
    for (int l = 0; l < kLanes; ++l) {
      const LightPiece& piece = pieces[std::min(l, count - 1)];
      set_lane(origin, l, at.above());
      set_lane(way, l, piece.position - at.above());
      light[l] = l < count ? received(piece, at, reflection) : 0.0;
      open[l] = light[l] > 0.0 ? -1 : 0;
      any = any || open[l] != 0;
    }
    if (!any) continue;
    views_->free.occlude(instants, origin, way, 1.0, open);
    const double share = in_band_share(lights[number], model.band_pass, model.laser.wavelength);
    for (int l = 0; l < count; ++l) sum += open[l] != 0 ? share * light[l] : 0.0;
  }
  return sum;
}

double Lamps::sample(std::size_t number, const SurfacePoint& at, const Reflection& reflection,
                     std::size_t instant, double u, double v, Eigen::Vector3d& way) const {
  const SensorModel& model = plan_.settings.model;
  const Light& light = views_->scene->lights()[number];
  const LightPiece piece = random_piece(light, views_->track->reference_from_light(number, instant), u, v);
  way = piece.position - at.above();
  return in_band_share(light, model.band_pass, model.laser.wavelength) * received(piece, at, reflection);
}

}  // namespace sensor_rt
