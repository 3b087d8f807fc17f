#include "sensor_rt/render/paths/subsurface_walks.h"

#include <algorithm>
#include <cmath>

#include "sensor_rt/scene/bsdf/subsurface.h"

namespace sensor_rt {
namespace {

constexpr std::uint32_t kLongest = 1u << 14;  ///< steps of a walk

/// Returns the direction, on the same side of the surface, of which `outside` is the continuation beyond it.
Eigen::Vector3d refracted(const Eigen::Vector3d& outside, const Eigen::Vector3d& normal, double index) {
  const double cosine = normal.dot(outside);
  return (outside - cosine * normal) / index + refracted_cosine(cosine, index) * normal;
}

}  // namespace

SubsurfaceWalks::SubsurfaceWalks(const RenderPlan& plan, const ExposureViews& views, std::size_t packet,
                                 const PathRandom& random, std::uint32_t pixel)
    : plan_(plan), views_(views), packet_(packet), random_(random), pixel_(pixel) {
  for (int l = 0; l < kLanes; ++l) {
    set_lane(position_, l, Eigen::Vector3d::Zero());
    for (Lanes3* unit : {&direction_, &normal_, &towards_}) set_lane(*unit, l, Eigen::Vector3d::UnitZ());
  }
}

void SubsurfaceWalks::start(int l, const SurfacePoint& at, std::int32_t shape, double carried) {
  const Subsurface& medium = *views_.brdf(shape).subsurface();
  const double index = medium.refractive_index();
  medium_[l] = &medium;
  shape_[l] = shape;
  offset_[l] = at.offset;
  set_lane(position_, l, at.position - at.offset * at.normal);
  set_lane(direction_, l, -refracted(at.back, at.normal, index));
  set_lane(normal_, l, at.normal);
  // Radiance outside is the transmitted share of that inside over index², of which isotropic scattering of an
  // irradiance yields 1 / (4 pi).
  carried_[l] = carried * medium.transmission(at.normal.dot(at.back)) / (4.0 * index * index);
  alive_[l] = -1;
}

void SubsurfaceWalks::add_light(double* light) {
  for (std::uint32_t event = 0; event < kLongest && any_lane(alive_); ++event) {
    advance(event);
    if (any_lane(scattered_)) connect(light);
  }
}

/// Moves all lanes to their next points of scattering, or to the surface if it is nearer.
void SubsurfaceWalks::advance(std::uint32_t event) {
  const std::size_t* instants = views_.instants(packet_);
  PacketHits hits;
  views_.query.intersect(instants, position_, direction_, alive_, hits);
  for (int l = 0; l < kLanes; ++l) {
    scattered_[l] = 0;
    if (alive_[l] == 0) continue;
    const Subsurface& medium = *medium_[l];
    const auto sample = static_cast<std::uint32_t>(packet_) * kLanes + static_cast<std::uint32_t>(l);
    const auto u = random_.at(pixel_, sample, (1u << 16) + 2 * event);
    const double path = -medium.mean_free_path() * std::log(u[0]);
    Eigen::Vector3d direction = lane(direction_, l);
    if (path < hits.t[l]) {
      set_lane(position_, l, lane(position_, l) + path * direction);
      if (u[1] >= medium.albedo()) {
        alive_[l] = 0;
        continue;
      }
      scattered_[l] = -1;
      const auto v = random_.at(pixel_, sample, (1u << 16) + 2 * event + 1);
      const double z = 2.0 * v[0] - 1.0;
      const double across = std::sqrt(1.0 - z * z);
      set_lane(direction_, l,
               {across * std::cos(2.0 * M_PI * v[1]), across * std::sin(2.0 * M_PI * v[1]), z});
      continue;
    }
    Eigen::Vector3d normal = lane(hits.normal, l);
    if (normal.dot(direction) < 0.0) normal = -normal;
    const double cosine = normal.dot(direction);
    if (hits.shape[l] != shape_[l] || u[1] < medium.transmission_from_inside(cosine)) {
      alive_[l] = 0;
      continue;
    }
    set_lane(normal_, l, normal);
    set_lane(position_, l, lane(position_, l) + hits.t[l] * direction - offset_[l] * normal);
    direction -= 2.0 * cosine * normal;
    set_lane(direction_, l, direction);
  }
}

/// Sets the direction in which light of the source arrives inside, if the surface has this normal.
void SubsurfaceWalks::refract_towards_source(int l, const Eigen::Vector3d& from,
                                             const Eigen::Vector3d& normal) {
  const Eigen::Vector3d to_source = (plan_.source(packet_, l) - from).normalized();
  if (normal.dot(to_source) > 0.0) {
    set_lane(towards_, l, refracted(to_source, normal, medium_[l]->refractive_index()));
  } else {
    scattered_[l] = 0;
  }
}

/// Adds the laser light that is scattered at the present points.
void SubsurfaceWalks::connect(double* light) {
  const std::size_t* instants = views_.instants(packet_);
  PacketHits hits;
  for (int l = 0; l < kLanes; ++l) {
    if (scattered_[l] != 0) refract_towards_source(l, lane(position_, l), lane(normal_, l));
  }
  // The point of the surface determines the direction, and this the point: a fixed point, found at once on a
  // plane far from the source.
  constexpr int kRounds = 3;
  for (int round = 0; round < kRounds; ++round) {
    views_.query.intersect(instants, position_, towards_, scattered_, hits);
    for (int l = 0; l < kLanes; ++l) {
      if (scattered_[l] == 0) continue;
      if (hits.shape[l] != shape_[l]) {
        scattered_[l] = 0;
        continue;
      }
      Eigen::Vector3d normal = lane(hits.normal, l);
      if (normal.dot(lane(towards_, l)) < 0.0) normal = -normal;
      set_lane(hits.normal, l, normal);
      if (round + 1 < kRounds) {
        refract_towards_source(l, lane(position_, l) + hits.t[l] * lane(towards_, l), normal);
      }
    }
  }
  Lanes3 from_source;
  double scattered[kLanes];
  alignas(64) int unoccluded[kLanes] = {};
  for (int l = 0; l < kLanes; ++l) {
    set_lane(from_source, l, Eigen::Vector3d::UnitZ());
    if (scattered_[l] == 0) continue;
    const Subsurface& medium = *medium_[l];
    const Eigen::Vector3d entry = lane(position_, l) + hits.t[l] * lane(towards_, l);
    const Eigen::Vector3d segment = entry - plan_.source(packet_, l);
    const IncidentLight incident = plan_.laser.at(segment);
    const double cosine = lane(hits.normal, l).dot(incident.towards);
    if (!(cosine > 0.0) || !(incident.irradiance > 0.0)) continue;
    // A beam is wider inside by the ratio of the cosines.
    scattered[l] = carried_[l] * incident.irradiance * medium.transmission(cosine) * cosine /
                   refracted_cosine(cosine, medium.refractive_index()) *
                   std::exp(-hits.t[l] / medium.mean_free_path());
    set_lane(from_source, l, segment);
    unoccluded[l] = -1;
  }
  if (!any_lane(unoccluded)) return;
  views_.laser.occlude(packet_, from_source, unoccluded);
  for (int l = 0; l < kLanes; ++l) light[l] += unoccluded[l] != 0 ? scattered[l] : 0.0;
}

}  // namespace sensor_rt
