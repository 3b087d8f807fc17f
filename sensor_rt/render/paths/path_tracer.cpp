#include "sensor_rt/render/paths/path_tracer.h"

#include <numeric>

#include "sensor_rt/render/paths/path_random.h"
#include "sensor_rt/render/paths/subsurface_walks.h"

namespace sensor_rt {

/// State of sixteen paths.
struct PathTracer::Packet {
  explicit Packet(const ExposureViews& of_row) : views(of_row) {}

  const ExposureViews& views;
  std::size_t number = 0;  ///< packet index within a pixel
  std::uint32_t pixel = 0;
  double sum = 0.0;
  Lanes3 origin;
  Lanes3 direction;
  PacketHits hits;
  alignas(64) int alive[kLanes];
  double carried[kLanes];  ///< throughput from the last surface to the camera
};

PathTracer::PathTracer(const RenderPlan& plan, Mode mode, const ExposureViews& views, RowViews* rows,
                       std::size_t camera, std::int64_t frame)
    : plan_(plan),
      mode_(mode),
      views_(views),
      rows_(rows),
      frame_(frame),
      rays_(plan, camera),
      speckle_(plan, views.query.scene(), views.query.track(), camera) {}

SurfacePoint PathTracer::surface(const Packet& packet, int l) const {
  const std::size_t instant = packet.views.instants(packet.number)[l];
  return {packet.views.query, instant, packet.origin, packet.direction, packet.hits, l};
}

double PathTracer::laser_light(const Packet& packet, int depth) const {
  Lanes3 from_source;
  double light[kLanes];
  alignas(64) int unoccluded[kLanes];
  bool any = false;
  for (int l = 0; l < kLanes; ++l) {
    unoccluded[l] = 0;
    set_lane(from_source, l, Eigen::Vector3d::UnitZ());
    if (packet.alive[l] == 0) continue;
    const SurfacePoint at = surface(packet, l);
    const Eigen::Vector3d segment = at.position - plan_.source(packet.number, l);
    const Bsdf& bsdf = packet.views.brdf(packet.hits.shape[l]);
    const IncidentLight incident = plan_.laser.at(segment);
    light[l] = packet.carried[l] * at.reflected(incident, bsdf);
    if (depth == 0 && bsdf.subsurface() != nullptr && light[l] > 0.0) {
      light[l] -= packet.carried[l] * incident.irradiance * at.normal.dot(incident.towards) *
                  bsdf.pi_subsurface(at.surface, incident.towards, at.back);
    }
    if (!(light[l] > 0.0)) continue;
    unoccluded[l] = -1;
    any = true;
    set_lane(from_source, l, segment);
  }
  if (!any) return 0.0;
  packet.views.laser.occlude(packet.number, from_source, unoccluded);
  for (int l = 0; l < kLanes; ++l) light[l] = unoccluded[l] != 0 ? light[l] : 0.0;
  if (depth == 0) return sum_with_grains(packet, light);
  return std::accumulate(light, light + kLanes, 0.0);
}

double PathTracer::sum_with_grains(const Packet& packet, const double* light) const {
  if (!speckle_.enabled()) return std::accumulate(light, light + kLanes, 0.0);
  const auto width = static_cast<std::uint32_t>(plan_.settings.model.cameras[rays_.camera()].width_px);
  const Eigen::Vector2d pixel(packet.pixel % width, packet.pixel / width);
  const std::size_t* instants = packet.views.instants(packet.number);
  Speckle::Cell cell;
  double sum = 0.0;
  for (int l = 0; l < kLanes; ++l) {
    if (!(light[l] > 0.0)) continue;
    const std::size_t sample = plan_.pattern.sample_of(packet.number * kLanes + static_cast<std::size_t>(l));
    const Eigen::Vector2d offset(plan_.pattern.column[sample], plan_.pattern.row[sample]);
    sum += light[l] * speckle_.at_point(instants[l], packet.hits.shape[l], surface(packet, l).position,
                                        pixel + offset, cell);
  }
  return sum;
}

double PathTracer::light_below(const Packet& packet) const {
  const PathRandom random(plan_.settings.seed, frame_, PathRandom::kSight + static_cast<int>(rays_.camera()));
  SubsurfaceWalks walks(plan_, packet.views, packet.number, random, packet.pixel);
  for (int l = 0; l < kLanes; ++l) {
    if (packet.alive[l] == 0 || packet.views.brdf(packet.hits.shape[l]).subsurface() == nullptr) continue;
    walks.start(l, surface(packet, l), packet.hits.shape[l], packet.carried[l]);
  }
  double light[kLanes] = {};
  walks.add_light(light);
  return sum_with_grains(packet, light);
}

double PathTracer::ambient_light(const Packet& packet, int depth) const {
  const double ambient = plan_.settings.model.ambient_irradiance;
  double sum = 0.0;
  for (int l = 0; l < kLanes; ++l) {
    if (packet.alive[l] == 0) continue;
    if (packet.hits.shape[l] < 0) {
      sum += depth > 0 ? packet.carried[l] * ambient : 0.0;  // a primary ray without a hit sees no light
    } else if (mode_ == Mode::kMirrorsOnly) {
      const Bsdf& brdf = packet.views.brdf(packet.hits.shape[l]);
      const SurfacePoint at = surface(packet, l);
      if (!brdf.is_specular()) sum += packet.carried[l] * ambient * brdf.albedo(at.normal.dot(at.back));
    }
  }
  return sum;
}

double PathTracer::lamp_light(const Packet& packet, int depth) const {
  const PathRandom random(plan_.settings.seed, frame_, PathRandom::kLamps - static_cast<int>(rays_.camera()));
  const SceneQuery& query = packet.views.query;
  const SensorModel& model = plan_.settings.model;
  const Lamps lamps(query, model.band_pass, model.laser.wavelength);
  const std::size_t* instants = packet.views.instants(packet.number);
  double sum = 0.0;
  for (std::size_t number = 0; number < query.scene().lights().size(); ++number) {
    for (const bool on_lamp : {true, false}) {
      Lanes3 origin;
      Lanes3 segment;
      double light[kLanes];
      alignas(64) int unoccluded[kLanes] = {};
      bool any = false;
      for (int l = 0; l < kLanes; ++l) {
        set_lane(origin, l, Eigen::Vector3d::Zero());
        set_lane(segment, l, Eigen::Vector3d::UnitZ());
        if (packet.alive[l] == 0) continue;
        const SurfacePoint at = surface(packet, l);
        const Bsdf& brdf = packet.views.brdf(packet.hits.shape[l]);
        const auto path = static_cast<std::uint32_t>(packet.number) * kLanes + static_cast<std::uint32_t>(l);
        const auto u = random.at(packet.pixel, path,
                                 512 * static_cast<std::uint32_t>(number) + (on_lamp ? 0u : 256u) +
                                     static_cast<std::uint32_t>(depth));
        const Lamps::Sample sample = on_lamp ? lamps.sample(number, at, brdf, instants[l], u[0], u[1])
                                             : lamps.sample_reflection(number, at, brdf, instants[l], u);
        light[l] = packet.carried[l] * sample.light;
        if (!(light[l] > 0.0)) continue;
        set_lane(origin, l, at.above());
        set_lane(segment, l, sample.to_light);
        unoccluded[l] = -1;
        any = true;
      }
      if (!any) continue;
      query.occlude(instants, origin, segment, unoccluded);
      for (int l = 0; l < kLanes; ++l) sum += unoccluded[l] != 0 ? light[l] : 0.0;
    }
  }
  return sum;
}

void PathTracer::reflect(Packet& packet, int depth) const {
  const PathRandom random(plan_.settings.seed, frame_, PathRandom::kSight + static_cast<int>(rays_.camera()));
  for (int l = 0; l < kLanes; ++l) {
    if (packet.alive[l] == 0) continue;
    packet.alive[l] = 0;
    const Bsdf& brdf = packet.views.brdf(packet.hits.shape[l]);
    const bool is_mirror = brdf.is_specular();
    if (mode_ == Mode::kMirrorsOnly && !is_mirror) continue;
    if (mode_ == Mode::kReflectedLamps && depth == 0 && is_mirror) continue;
    const SurfacePoint at = surface(packet, l);
    const auto sample = static_cast<std::uint32_t>(packet.number) * kLanes + static_cast<std::uint32_t>(l);
    const auto u = random.at(packet.pixel, sample, static_cast<std::uint32_t>(depth));
    const BsdfSample out = brdf.sample(at.surface, at.back, u[0], u[1], u[2]);
    if (!(out.weight > 0.0)) continue;
    packet.carried[l] *= out.weight;
    packet.alive[l] = -1;
    set_lane(packet.origin, l, at.above());
    set_lane(packet.direction, l, out.towards);
  }
}

void PathTracer::trace_packet(Packet& packet) const {
  const int last = plan_.settings.bounces;
  const bool lamps_alone = mode_ == Mode::kReflectedLamps;
  const bool ambient = plan_.settings.model.ambient_irradiance > 0.0 && !lamps_alone;
  packet.views.cameras[rays_.camera()].intersect(packet.number, packet.direction, packet.alive, packet.hits);
  for (int depth = 0;; ++depth) {
    if (ambient) packet.sum += ambient_light(packet, depth);
    for (int l = 0; l < kLanes; ++l) packet.alive[l] = packet.hits.shape[l] < 0 ? 0 : packet.alive[l];
    if (depth > last) return;  // after the last reflection only environment light is left
    // Of pixels that show mirrors, the light that they see directly is drawn from the mesh of the stripe.
    if (!lamps_alone && (depth > 0 || mode_ == Mode::kAllBounces)) packet.sum += laser_light(packet, depth);
    if (depth == 0 && mode_ == Mode::kAllBounces && plan_.settings.laser_on)
      packet.sum += light_below(packet);
    if (depth > 0 || !lamps_alone) packet.sum += lamp_light(packet, depth);
    if (depth == last && !ambient) return;
    reflect(packet, depth);
    if (!any_lane(packet.alive)) return;
    packet.views.query.intersect(packet.views.instants(packet.number), packet.origin, packet.direction,
                                 packet.alive, packet.hits);
  }
}

double PathTracer::trace(int column, int row) const {
  const std::size_t samples = plan_.pattern.size();
  const Camera& camera = plan_.settings.model.cameras[rays_.camera()];
  Packet packet(rows_ != nullptr ? rows_->of_row(rays_.camera(), row) : views_);
  packet.pixel = static_cast<std::uint32_t>(row * camera.width_px + column);
  for (std::size_t first = 0; first < samples; first += kLanes) {
    packet.number = first / kLanes;
    rays_.through_samples(column, row, packet.number, packet.direction);
    activate_lanes(samples - first, packet.alive);
    for (int l = 0; l < kLanes; ++l) {
      packet.carried[l] = 1.0;
      set_lane(packet.origin, l, lane(rays_.viewpoints(packet.number), l));
    }
    trace_packet(packet);
  }
  return packet.sum > 0.0 ? rays_.electrons(column, row, packet.sum / static_cast<double>(samples)) : 0.0;
}

}  // namespace sensor_rt
