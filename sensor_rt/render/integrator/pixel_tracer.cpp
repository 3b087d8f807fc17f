#include "sensor_rt/render/integrator/pixel_tracer.h"

#include <cmath>

namespace sensor_rt {

PixelTracer::PixelTracer(const RenderPlan& plan, const ExposureViews& views, RowViews* rows,
                         std::size_t camera)
    : plan_(plan),
      views_(views),
      rows_(rows),
      rays_(plan, camera),
      sheet_(plan.laser),
      speckle_(plan, views, camera) {
  for (const Shape& shape : views.query.scene().shapes()) {
    const bool lambert = shape.surface->is_lambert();
    surfaces_.push_back({shape.reflectance, lambert ? nullptr : shape.surface.get()});
  }
}

double PixelTracer::brightness(const PacketHits& hits, int l, const Lanes3& direction,
                               const Lanes3& from_source, double irradiance) const {
  const Bsdf& brdf = *surfaces_[static_cast<std::size_t>(hits.shape[l])].brdf;
  const Eigen::Vector3d to_viewpoint = -lane(direction, l).normalized();
  Eigen::Vector3d normal = lane(hits.normal, l);
  if (normal.dot(to_viewpoint) < 0.0) normal = -normal;
  double sum = plan_.settings.model.ambient_irradiance * brdf.albedo(normal.dot(to_viewpoint));
  if (irradiance > 0.0) {
    const Eigen::Vector3d to_source = -lane(from_source, l).normalized();
    sum += irradiance * brdf.pi_brdf(normal, to_source, to_viewpoint);
  }
  return sum;
}

void PixelTracer::light(std::size_t packet, const Lanes3& direction, const PacketHits& hits,
                        Lanes3& from_source, double* irradiance, int* lit) const {
  if (sheet_.is_simple() && rays_.share_viewpoint()) {
    sheet_.light(rays_.viewpoint(), direction, hits, from_source, irradiance, lit);
  } else {
    sheet_.light(rays_.viewpoints(packet), plan_.sources[packet], direction, hits, from_source, irradiance,
                 lit);
  }
}

double PixelTracer::sum_reflected(const PacketHits& hits, const Lanes3& direction, const int* valid,
                                  const Lanes3& from_source, const double* irradiance, const int* lit) const {
  const double ambient = plan_.settings.model.ambient_irradiance;
  double sum = 0.0;
  for (int l = 0; l < kLanes; ++l) {
    if (valid[l] == 0 || hits.shape[l] < 0) continue;
    const Surface& surface = surfaces_[static_cast<std::size_t>(hits.shape[l])];
    const double laser = lit[l] != 0 ? irradiance[l] : 0.0;
    sum += surface.brdf == nullptr ? surface.reflectance * (laser + ambient)
                                   : brightness(hits, l, direction, from_source, laser);
  }
  return sum;
}

double PixelTracer::sum_packet(const ExposureViews& views, int column, int row, std::size_t packet,
                               const Lanes3& direction, const int* valid, const Patch& patch) const {
  PacketHits hits;
  const RayView& view = views.cameras[rays_.camera()];
  const bool on_patch = patch.shape >= 0 && view.intersect_patch(packet, patch, direction, valid, hits);
  if (!on_patch) view.intersect(packet, direction, valid, hits);
  Lanes3 from_source;
  alignas(64) double irradiance[kLanes];
  alignas(64) int lit[kLanes];
  light(packet, direction, hits, from_source, irradiance, lit);
  const bool any = any_lane(lit);
  if (any && !(on_patch && patch.in_light)) views.laser.occlude(packet, from_source, lit);
  if (!any && plan_.settings.model.ambient_irradiance == 0.0) return 0.0;
  if (any && speckle_.enabled())
    speckle_.modulate(views, column, row, packet, direction, hits, lit, irradiance);
  return sum_reflected(hits, direction, valid, from_source, irradiance, lit);
}

double PixelTracer::beyond_first_face(int column, int row, const Patch& patch) const {
  const RayView& view = views_.cameras[rays_.camera()];
  Patch first = patch;
  first.count = 1;
  first.is_open = false;
  const std::size_t samples = plan_.pattern.size();
  double sum = 0.0;
  for (std::size_t packet = 0; packet * kLanes < samples; ++packet) {
    Lanes3 direction;
    rays_.through_samples(column, row, packet, direction);
    alignas(64) int valid[kLanes];
    activate_lanes(samples - packet * kLanes, valid);
    PacketHits hits;
    PacketHits on_first;
    if (!view.intersect_patch(packet, patch, direction, valid, hits))
      view.intersect(packet, direction, valid, hits);
    if (!view.intersect_patch(packet, first, direction, valid, on_first)) continue;
    for (const PacketHits* side : {&hits, &on_first}) {
      Lanes3 from_source;
      alignas(64) double irradiance[kLanes];
      alignas(64) int lit[kLanes];
      light(packet, direction, *side, from_source, irradiance, lit);
      const double light = sum_reflected(*side, direction, valid, from_source, irradiance, lit);
      sum += side == &hits ? light : -light;
    }
  }
  if (sum == 0.0) return 0.0;
  return rays_.electrons(column, row, sum / static_cast<double>(samples));
}

double PixelTracer::trace(int column, int row, const Patch& patch) const {
  const ExposureViews& views = views_of(row);
  const std::size_t samples = plan_.pattern.size();
  double sum = 0.0;
  for (std::size_t first = 0; first < samples; first += kLanes) {
    Lanes3 direction;
    rays_.through_samples(column, row, first / kLanes, direction);
    alignas(64) int valid[kLanes];
    activate_lanes(samples - first, valid);
    sum += sum_packet(views, column, row, first / kLanes, direction, valid, patch);
  }
  if (sum == 0.0) return 0.0;
  return electrons(column, row, sum / static_cast<double>(samples));
}

PixelTracer::Middle PixelTracer::trace_middle(int column, int row) const {
  Middle middle{views_of(row), {}, {}};
  rays_.through_middle(column, row, middle.direction);
  alignas(64) const int valid[kLanes] = {-1};
  middle.views.middles[rays_.camera()].intersect(0, middle.direction, valid, middle.hits);
  return middle;
}

double PixelTracer::reflectance(int column, int row) const {
  const Middle middle = trace_middle(column, row);
  if (middle.hits.shape[0] < 0) return 0.0;
  const Surface& surface = surfaces_[static_cast<std::size_t>(middle.hits.shape[0])];
  if (surface.brdf == nullptr) return surface.reflectance;
  return surface.brdf->albedo(
      std::abs(lane(middle.hits.normal, 0).dot(lane(middle.direction, 0).normalized())));
}

LampView PixelTracer::lamp_light(int column, int row) const {
  const Middle middle = trace_middle(column, row);
  const std::int32_t shape = middle.hits.shape[0];
  if (shape < 0) return {};
  Lanes3 origin;
  set_lane(origin, 0, Eigen::Map<const Eigen::Vector3d>(rays_.viewpoint()));
  const SceneQuery& query = middle.views.query;
  const SurfacePoint at(query.scene(), origin, middle.direction, middle.hits, 0);
  const SensorModel& model = plan_.settings.model;
  const Lamps lamps(query, model.band_pass, model.laser.wavelength);
  const double light = lamps.brightness(at, query.brdf(shape), middle.views.middle_instant());
  return {light > 0.0 ? electrons(column, row, light) : 0.0, shape, at.normal};
}

std::int32_t PixelTracer::shape_at(int column, int row) const {
  const Middle middle = trace_middle(column, row);
  return middle.hits.shape[0];
}

}  // namespace sensor_rt
