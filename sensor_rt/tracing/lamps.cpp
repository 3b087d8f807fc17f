#include "sensor_rt/tracing/lamps.h"

#include <algorithm>
#include <cmath>

namespace sensor_rt {

double Lamps::brightness(const SurfacePoint& at, const Bsdf& brdf, std::size_t instant) const {
  const std::vector<Light>& lights = query_.scene().lights();
  std::size_t instants[kLanes];
  std::fill_n(instants, kLanes, instant);
  double sum = 0.0;
  for (std::size_t number = 0; number < lights.size(); ++number) {
    static_assert(kLightSamples <= kLanes);
    LightSample samples[kLightSamples];
    const int count =
        light_samples(lights[number], query_.track().reference_from_light(number, instant), samples);
    Lanes3 origin;
    Lanes3 to_light;
    double light[kLanes];
    alignas(64) int unoccluded[kLanes] = {};
    bool any = false;
    for (int l = 0; l < kLanes; ++l) {
      const LightSample& sample = samples[std::min(l, count - 1)];
      set_lane(origin, l, at.above());
      set_lane(to_light, l, sample.position - at.above());
      light[l] = l < count ? at.reflected(sample.at(at.position), brdf) : 0.0;
      unoccluded[l] = light[l] > 0.0 ? -1 : 0;
      any = any || unoccluded[l] != 0;
    }
    if (!any) continue;
    query_.occlude(instants, origin, to_light, unoccluded);
    const double share = in_band_share(lights[number], filter_, laser_wavelength_);
    for (int l = 0; l < count; ++l) sum += unoccluded[l] != 0 ? share * light[l] : 0.0;
  }
  return sum;
}

double Lamps::sample(std::size_t number, const SurfacePoint& at, const Bsdf& brdf, std::size_t instant,
                     double u, double v, Eigen::Vector3d& to_light) const {
  const Light& light = query_.scene().lights()[number];
  const LightSample sample =
      random_light_sample(light, query_.track().reference_from_light(number, instant), u, v);
  to_light = sample.position - at.above();
  return in_band_share(light, filter_, laser_wavelength_) * at.reflected(sample.at(at.position), brdf);
}

}  // namespace sensor_rt
