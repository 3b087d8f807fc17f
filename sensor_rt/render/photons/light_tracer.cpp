#include "sensor_rt/render/photons/light_tracer.h"

#include <algorithm>
#include <cmath>

#include "sensor_rt/render/paths/path_random.h"
#include "sensor_rt/tracing/surface_point.h"

namespace sensor_rt {
namespace {

/// Largest number of consecutive mirrors in front of a camera: the number of chains grows by a factor of the
/// number of planes with each.
constexpr std::size_t kMaxMirrors = 2;

/// Patch size relative to the photon spacing: sixteen neighbouring photons overlap.
constexpr double kPatchPerSpacing = 4.0;

/// Roberts' R sequence in five dimensions: an additive recurrence with low discrepancy at any length.
double recurrence(std::uint32_t index, int dimension) {
  constexpr double kRoot = 1.1347241384015194;  // x^6 = x + 1
  double step = 1.0;
  for (int k = 0; k <= dimension; ++k) step /= kRoot;
  const double value = 0.5 + step * index;
  return value - std::floor(value);
}

double wrap(double value) { return value - std::floor(value); }

}  // namespace

/// State of sixteen photons.
struct LightTracer::Packet {
  std::size_t number = 0;  ///< packet index within a pixel, which determines the instants of the lanes
  std::uint32_t first = 0;
  int depth = 0;  ///< number of reflections so far minus one
  Lanes3 origin;
  Lanes3 direction;
  PacketHits hits;
  alignas(64) int alive[kLanes];
  double power[kLanes];
  double spacing[kLanes];      ///< distance of neighbouring photons at the current point, m
  double cone_spread[kLanes];  ///< angle between the directions of neighbouring photons, rad
  double slope[kLanes];
  bool counts[kLanes];  ///< whether the following hits are connected to cameras
};

LightTracer::LightTracer(const RenderPlan& plan, const ExposureViews& views, std::int64_t frame,
                         bool mirrors_first)
    : plan_(plan),
      views_(views),
      frame_(frame),
      mirrors_first_(mirrors_first),
      photons_(static_cast<std::uint32_t>(plan.settings.photons)),
      mirrors_(views) {}

void LightTracer::trace(std::vector<SplatImage>& images) const {
  if (views_.laser.empty()) return;
  Packet packet;
  for (std::uint32_t first = 0; first < photons_; first += kLanes) {
    emit(packet, first);
    views_.laser.intersect(packet.number, packet.direction, packet.alive, packet.hits);
    weight_first_hits(packet);
    for (int depth = 0; depth < plan_.settings.bounces && reflect(packet, depth); ++depth) {
      views_.query.intersect(views_.instants(packet.number), packet.origin, packet.direction, packet.alive,
                             packet.hits);
      for (int l = 0; l < kLanes; ++l) packet.alive[l] = packet.hits.shape[l] < 0 ? 0 : packet.alive[l];
      packet.depth = depth;
      connect(packet, images);
    }
  }
}

void LightTracer::emit(Packet& packet, std::uint32_t first) const {
  const LaserSheet& laser = plan_.laser.sheet;
  const PathRandom random(plan_.settings.seed, frame_, PathRandom::kPhotons);
  const auto shift = random.at(0, 0, ~0u);
  const double scale = 0.6 * plan_.slope / kSheetReach;  // the logistic distribution closest to the Gaussian
  packet.number = first / kLanes % views_.packets();
  packet.first = first;
  for (int l = 0; l < kLanes; ++l) {
    const std::uint32_t photon = first + static_cast<std::uint32_t>(l);
    const double angle = laser.fan_half_angle * (2.0 * wrap(recurrence(photon, 0) + shift[0]) - 1.0);
    const double u = std::clamp(wrap(recurrence(photon, 1) + shift[1]), 1e-9, 1.0 - 1e-9);
    const Eigen::Vector3d direction =
        plan_.laser.direction(std::sin(angle), std::cos(angle), scale * std::log(u / (1.0 - u)));
    packet.slope[l] = direction.x();
    const double pdf = u * (1.0 - u) / scale / (2.0 * laser.fan_half_angle);
    packet.power[l] = 1.0 / (photons_ * pdf);
    packet.alive[l] = photon < photons_ ? -1 : 0;
    packet.spacing[l] = packet.cone_spread[l] = 0.0;
    set_lane(packet.origin, l, plan_.source(packet.number, l));
    set_lane(packet.direction, l, direction);
  }
}

/// Converts the pdf to power: a step of angle and slope covers t² / sqrt(1 + slope²) across the ray.
void LightTracer::weight_first_hits(Packet& packet) const {
  for (int l = 0; l < kLanes; ++l) {
    if (packet.alive[l] == 0) continue;
    packet.alive[l] = 0;
    if (packet.hits.shape[l] < 0) continue;
    const double t = packet.hits.t[l];
    const double across = t * t / std::sqrt(1.0 + packet.slope[l] * packet.slope[l]);
    packet.power[l] *= across * plan_.laser.at(t * lane(packet.direction, l)).irradiance;
    packet.counts[l] = !mirrors_first_ || views_.brdf(packet.hits.shape[l]).is_specular();
    packet.alive[l] = packet.power[l] > 0.0 && packet.counts[l] ? -1 : 0;
  }
}

/// Returns false when no photon is left.
bool LightTracer::reflect(Packet& packet, int depth) const {
  const PathRandom random(plan_.settings.seed, frame_, PathRandom::kPhotons);
  const auto shift = random.at(1, 0, ~0u);
  bool any = false;
  for (int l = 0; l < kLanes; ++l) {
    if (packet.alive[l] == 0) continue;
    packet.alive[l] = 0;
    const std::uint32_t photon = packet.first + static_cast<std::uint32_t>(l);
    auto u = random.at(photon, 0, static_cast<std::uint32_t>(depth));
    for (int k = 0; depth == 0 && k < 3; ++k) {
      u[static_cast<std::size_t>(k)] = wrap(recurrence(photon, 2 + k) + shift[static_cast<std::size_t>(k)]);
    }
    const SurfacePoint at(views_.query, views_.instants(packet.number)[l], packet.origin, packet.direction,
                          packet.hits, l);
    const Bsdf& brdf = views_.brdf(packet.hits.shape[l]);
    const BsdfSample out = brdf.sample(at.surface, at.back, u[0], u[1], u[2]);
    if (!(out.weight > 0.0)) continue;
    packet.power[l] *= out.weight;
    packet.spacing[l] += packet.cone_spread[l] * (at.position - lane(packet.origin, l)).norm();
    if (out.pdf > 0.0)
      packet.cone_spread[l] = std::hypot(packet.cone_spread[l], 1.0 / std::sqrt(photons_ * out.pdf));
    set_lane(packet.origin, l, at.above());
    set_lane(packet.direction, l, out.towards);
    packet.alive[l] = -1;
    any = true;
  }
  return any;
}

/// Computes the pixel coordinates of light through the lane's lens sample, blurred by diffraction.
void LightTracer::blur(std::size_t number, const Packet& packet, const Lanes3& points, double* column,
                       double* row) const {
  const Camera& camera = plan_.settings.model.cameras[number];
  if (!camera.has_depth_of_field() && camera.psf_sigma_px == 0.0) return;
  const Rigid3 camera_from_reference = camera.sensor_from_camera.inverse();
  const PathRandom random(plan_.settings.seed, frame_, PathRandom::kPhotons);
  for (int l = 0; l < kLanes; ++l) {
    if (packet.alive[l] == 0 || column[l] == kNotVisible) continue;
    if (camera.has_depth_of_field()) {
      const Eigen::Vector3d lens = camera_from_reference * plan_.viewpoint(number, packet.number, l);
      const Eigen::Vector2d pixel =
          camera.project_through(lens.head<2>(), camera_from_reference * lane(points, l));
      column[l] = pixel.x();
      row[l] = pixel.y();
    }
    const std::uint32_t photon = packet.first + static_cast<std::uint32_t>(l);
    const auto u =
        random.at(photon, 1 + static_cast<std::uint32_t>(number), static_cast<std::uint32_t>(packet.depth));
    const double radius = camera.psf_sigma_px * std::sqrt(-2.0 * std::log(u[0]));
    column[l] += radius * std::cos(2.0 * M_PI * u[1]);
    row[l] += radius * std::sin(2.0 * M_PI * u[1]);
  }
}

/// Connects the packet to all cameras, directly and via mirrors.
void LightTracer::connect(const Packet& packet, std::vector<SplatImage>& images) const {
  for (std::size_t c = 0; c < plan_.projectors.size(); ++c) {
    const Eigen::Vector3d& middle = plan_.settings.model.cameras[c].sensor_from_camera.translation;
    Lanes3 points;
    for (int l = 0; l < kLanes; ++l) {
      const bool there = packet.alive[l] != 0;
      set_lane(points, l,
               there ? lane(packet.origin, l) + packet.hits.t[l] * lane(packet.direction, l) : middle);
    }
    std::vector<std::size_t> chain;
    splat(packet, c, points, chain, images[c]);
    connect_by_mirrors(packet, c, points, chain, images[c]);
  }
}

/// Extends the `chain` by each plane in front of the points seen so far, recursively.
void LightTracer::connect_by_mirrors(const Packet& packet, std::size_t number, const Lanes3& seen,
                                     std::vector<std::size_t>& chain, SplatImage& image) const {
  if (chain.size() == kMaxMirrors ||
      static_cast<int>(chain.size()) + packet.depth + 1 >= plan_.settings.bounces)
    return;
  for (std::size_t plane = 0; plane < mirrors_.count(); ++plane) {
    if (!chain.empty() && chain.front() == plane) continue;
    Lanes3 mirrored = seen;
    for (int l = 0; l < kLanes; ++l) {
      if (packet.alive[l] == 0) continue;
      const std::size_t instant = views_.lane_instants[packet.number * kLanes + static_cast<std::size_t>(l)];
      set_lane(mirrored, l, mirrors_.image(plane, instant, lane(seen, l)));
    }
    chain.insert(chain.begin(), plane);
    splat(packet, number, mirrored, chain, image);
    connect_by_mirrors(packet, number, mirrored, chain, image);
    chain.erase(chain.begin());
  }
}

/// Connects the packet's points to a camera, which sees them at `seen` in the mirrors of `chain`.
void LightTracer::splat(const Packet& packet, std::size_t number, const Lanes3& seen,
                        const std::vector<std::size_t>& chain, SplatImage& image) const {
  const Camera& camera = plan_.settings.model.cameras[number];
  const Eigen::Vector3d forward = camera.sensor_from_camera.rotation.col(2);
  alignas(64) double column[kLanes];
  alignas(64) double row[kLanes];
  plan_.projectors[number].project(seen, column, row);
  blur(number, packet, seen, column, row);
  Lanes3 viewpoints;
  Lanes3 from_viewpoint;
  alignas(64) int unoccluded[kLanes];
  double amount[kLanes];
  double size[kLanes];
  double share[kLanes];
  bool any = false;
  for (int l = 0; l < kLanes; ++l) {
    unoccluded[l] = 0;
    set_lane(viewpoints, l, plan_.viewpoint(number, packet.number, l));
    set_lane(from_viewpoint, l, forward);
    if (packet.alive[l] == 0 || !(column[l] > -0.5) || !(column[l] < camera.width_px - 0.5) ||
        !(row[l] > -0.5) || !(row[l] < camera.height_px - 0.5)) {
      continue;
    }
    const SurfacePoint at(views_.query, views_.instants(packet.number)[l], packet.origin, packet.direction,
                          packet.hits, l);
    const Eigen::Vector3d to_image = lane(seen, l) - lane(viewpoints, l);
    const double distance = to_image.norm();
    const std::size_t instant = views_.lane_instants[packet.number * kLanes + static_cast<std::size_t>(l)];
    Eigen::Vector3d viewpoint_in_mirrors = lane(viewpoints, l);
    for (const std::size_t plane : chain)
      viewpoint_in_mirrors = mirrors_.image(plane, instant, viewpoint_in_mirrors);
    const Eigen::Vector3d towards = (viewpoint_in_mirrors - at.position) / distance;
    const double facing = at.normal.dot(towards);
    if (!(facing > 0.0)) continue;
    const double depth = to_image.dot(forward);
    const Eigen::Vector3d ray = camera.ray({column[l], row[l]});
    const double px_per_slope2 =
        camera.tilt_area({column[l], row[l]}) / std::abs(camera.ray_jacobian(ray).determinant());
    // A point of intensity I = power * brdf * cosine gives the irradiance I / distance² per steradian of the
    // pixels; their share of the aperture's cos⁴ is reduced by the cos³ of their solid angle.
    amount[l] = packet.power[l] * facing / (distance * distance) * (depth / distance) * px_per_slope2 *
                views_.brdf(packet.hits.shape[l]).pi_brdf(at.surface, at.back, towards) *
                plan_.electrons_per_irradiance[number];
    const double spacing = packet.spacing[l] + packet.cone_spread[l] *
                                                   (at.position - lane(packet.origin, l)).norm() /
                                                   std::sqrt(std::max(0.05, at.normal.dot(at.back)));
    // At grazing view the patch is foreshortened; the short side is used, or the patch would extend over
    // edges.
    size[l] = mirrors_first_ ? 0.0 : kPatchPerSpacing * spacing * facing * std::sqrt(px_per_slope2) / depth;
    if (!(amount[l] > 0.0)) continue;
    set_lane(from_viewpoint, l, to_image);
    unoccluded[l] = -1;
    any = true;
  }
  if (!any) return;
  if (chain.empty()) {
    std::fill_n(share, kLanes, 1.0);
    views_.cameras[number].occlude(packet.number, from_viewpoint, unoccluded);
  } else {
    mirrors_.follow(number, packet.number, chain, viewpoints, from_viewpoint, unoccluded, share);
  }
  for (int l = 0; l < kLanes; ++l) {
    if (unoccluded[l] != 0) image.add(column[l], row[l], share[l] * amount[l], size[l]);
  }
}

}  // namespace sensor_rt
