#include "sensor_rt/render/photons/planar_mirrors.h"

#include <algorithm>
#include <cmath>

namespace sensor_rt {
namespace {

constexpr std::size_t kMaxPlanes = 32;  ///< largest number of planes of a mesh
constexpr double kSameNormal = 1.0 - 1e-9;

Eigen::Vector3d mirrored(const Eigen::Vector3d& normal, double offset, const Eigen::Vector3d& point) {
  return point - 2.0 * (normal.dot(point) - offset) * normal;
}

}  // namespace

PlanarMirrors::PlanarMirrors(const ExposureViews& views) : views_(views) {
  const std::vector<Shape>& shapes = views.query.scene().shapes();
  for (std::size_t s = 0; s < shapes.size(); ++s) {
    if (!shapes[s].surface->is_specular()) continue;
    const Eigen::Vector3d& half = shapes[s].half_size;
    if (shapes[s].kind == ShapeKind::kMesh) add_mesh(s);
    if (shapes[s].kind == ShapeKind::kRectangle) planes_.push_back({s, Eigen::Vector3d::UnitZ(), 0.0});
    const bool is_box = shapes[s].kind == ShapeKind::kBox;
    const bool has_ends = is_box || shapes[s].kind == ShapeKind::kFrustum;
    for (int axis = is_box ? 0 : 2; has_ends && axis < 3; ++axis) {
      planes_.push_back({s, Eigen::Vector3d::Unit(axis), half[axis]});
      planes_.push_back({s, -Eigen::Vector3d::Unit(axis), half[axis]});
    }
  }
}

void PlanarMirrors::add_mesh(std::size_t shape) {
  const std::size_t before = planes_.size();
  const Shape& mesh = views_.query.scene().shapes()[shape];
  for (const FacePlane& face : mesh.planes) {
    const Eigen::Vector3d normal(face.normal[0], face.normal[1], face.normal[2]);
    if (normal.isZero()) continue;
    // Faces of either winding reflect on both sides.
    const auto same = [&](const Plane& known) {
      const double cosine = known.normal.dot(normal);
      const double offset = cosine < 0.0 ? -face.offset : face.offset;
      return std::abs(cosine) > kSameNormal && std::abs(known.offset - offset) < mesh.ray_offset();
    };
    if (std::any_of(planes_.begin() + static_cast<std::ptrdiff_t>(before), planes_.end(), same)) continue;
    if (planes_.size() == before + kMaxPlanes) {
      planes_.resize(before);
      return;
    }
    planes_.push_back({shape, normal, face.offset});
  }
}

PlanarMirrors::PosedPlane PlanarMirrors::posed_plane(std::size_t number, std::size_t instant) const {
  const Plane& plane = planes_[number];
  const Rigid3& shape_from_reference = views_.query.track().shape_from_reference(plane.shape, instant);
  return {shape_from_reference.rotation.transpose() * plane.normal,
          plane.offset - plane.normal.dot(shape_from_reference.translation)};
}

Eigen::Vector3d PlanarMirrors::image(std::size_t number, std::size_t instant,
                                     const Eigen::Vector3d& point) const {
  const PosedPlane posed = posed_plane(number, instant);
  return mirrored(posed.normal, posed.offset, point);
}

/// Reflects a lane at the expected plane; returns false when it hits something else.
bool PlanarMirrors::reflect(const Plane& plane, const PosedPlane& posed, const PacketHits& hits, int l,
                            Eigen::Vector3d& origin, Eigen::Vector3d& to_image, double& share) const {
  if (hits.shape[l] != static_cast<std::int32_t>(plane.shape) || !(hits.t[l] < 1.0)) return false;
  const Eigen::Vector3d at = origin + hits.t[l] * to_image;
  const double offset = views_.query.scene().shapes()[plane.shape].ray_offset();
  if (std::abs(lane(hits.normal, l).dot(posed.normal)) < kSameNormal ||
      std::abs(posed.normal.dot(at) - posed.offset) > offset)
    return false;
  const Eigen::Vector3d target = mirrored(posed.normal, posed.offset, origin + to_image);
  const double side = posed.normal.dot(to_image) < 0.0 ? offset : -offset;
  origin = at + side * posed.normal;
  to_image = target - origin;
  share *= views_.brdf(hits.shape[l]).albedo(1.0);
  return true;
}

void PlanarMirrors::follow(std::size_t camera, std::size_t packet, const std::vector<std::size_t>& chain,
                           const Lanes3& viewpoints, const Lanes3& to_image, int* unoccluded,
                           double* share) const {
  const std::size_t* instants = views_.instants(packet);
  Lanes3 origin = viewpoints;
  Lanes3 rest = to_image;
  std::fill_n(share, kLanes, 1.0);
  PacketHits hits;
  for (std::size_t k = 0; k < chain.size(); ++k) {
    if (k == 0) {
      views_.cameras[camera].intersect(packet, rest, unoccluded, hits, 1.0);
    } else {
      views_.query.intersect(instants, origin, rest, unoccluded, hits);
    }
    for (int l = 0; l < kLanes; ++l) {
      if (unoccluded[l] == 0) continue;
      Eigen::Vector3d from = lane(origin, l);
      Eigen::Vector3d towards = lane(rest, l);
      const PosedPlane posed = posed_plane(chain[k], instants[l]);
      unoccluded[l] = reflect(planes_[chain[k]], posed, hits, l, from, towards, share[l]) ? -1 : 0;
      set_lane(origin, l, from);
      set_lane(rest, l, towards);
    }
  }
  views_.query.occlude(instants, origin, rest, unoccluded);
}

}  // namespace sensor_rt
