#include "sensor_rt/render/pixels/pixel_cover.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "sensor_rt/scene/planar_radii.h"

namespace sensor_rt {
namespace {

constexpr double kMaxMotion = 1.0;  // px
/// Cosine of incidence below which neighbouring facets may shadow each other, so that shadow rays are needed.
constexpr double kGrazing = 0.1;
// Limits of a planar proxy:
constexpr double kFlat = 0.02;  ///< px: distance between the pixel centre and the planes of its corners

bool share_a_vertex(const std::uint32_t* a, const std::uint32_t* b) {
  bool any = false;
  for (int i = 0; i < 3; ++i) any |= (a[i] == b[0]) | (a[i] == b[1]) | (a[i] == b[2]);
  return any;
}

bool are_linked(const Shape& shape, std::uint32_t a, std::uint32_t b) {
  return a == b || share_a_vertex(shape.faces + 3 * std::size_t{a}, shape.faces + 3 * std::size_t{b});
}

/// Returns true when the planar discs around a vertex of each face overlap.
bool are_bridged(const Shape& shape, std::uint32_t a, std::uint32_t b) {
  using Vertex = Eigen::Map<const Eigen::Vector3f>;
  for (std::size_t i = 0; i < 3; ++i) {
    const std::size_t from = shape.faces[3 * std::size_t{a} + i];
    if (!(shape.planar_radii[from] > 0.0f)) continue;
    const Vertex start(shape.vertices + 3 * from);
    for (std::size_t k = 0; k < 3; ++k) {
      const std::size_t to = shape.faces[3 * std::size_t{b} + k];
      const float together = shape.planar_radii[from] + shape.planar_radii[to];
      const float distance2 = (Vertex(shape.vertices + 3 * to) - start).squaredNorm();
      if (shape.planar_radii[to] > 0.0f && distance2 < together * together) return true;
    }
  }
  return false;
}

bool are_continuous(const Shape& shape, std::uint32_t a, std::uint32_t b) {
  return are_linked(shape, a, b) || are_bridged(shape, a, b);
}

/// Adds a face to a patch. Returns false when it does not touch all faces of the patch.
bool extend(const Shape& shape, std::uint32_t face, Patch& patch) {
  const std::uint32_t* end = patch.face + patch.count;
  if (std::find(static_cast<const std::uint32_t*>(patch.face), end, face) != end) return true;
  if (patch.count == Patch::kCapacity) return false;
  for (int k = 0; k < patch.count; ++k) {
    if (!are_linked(shape, face, patch.face[k])) return false;
  }
  patch.face[patch.count++] = face;
  return true;
}

struct LinePoint {
  Eigen::Vector3d point;  ///< in the reference frame
  double px_per_m;        ///< largest motion in the image per motion of the point
};

/// Returns the ends of the part of the laser line that a camera sees, at both ends of the measuring range.
/// The motion of a rigid body is linear in the point, so that it is largest there.
std::vector<LinePoint> ends_of_seen_line(const SensorModel& model, const Camera& camera) {
  const Rigid3& pose = camera.sensor_from_camera;
  const Eigen::Vector3d forward = pose.rotation.col(2);
  std::vector<LinePoint> ends;
  for (const double z : {model.near, model.far}) {
    const double depth = forward.dot(Eigen::Vector3d(0.0, 0.0, z) - pose.translation);
    if (!(depth > 0.0)) continue;
    double low = std::numeric_limits<double>::infinity();
    double high = -low;
    for (const double column : {-0.5, camera.width_px - 0.5}) {
      for (const double row : {-0.5, camera.height_px - 0.5}) {
        const double y = pose.translation.y() + depth * (pose.rotation * camera.ray({column, row})).y();
        low = std::min(low, y);
        high = std::max(high, y);
      }
    }
    const double lit =
        (z - model.laser.source_z) * std::tan(model.laser.fan_half_angle) + 0.5 * model.laser.source_length;
    for (const double y : {std::clamp(low, -lit, lit), std::clamp(high, -lit, lit)}) {
      const Eigen::Vector3d point(0.0, y, z);
      const double distance = (point - pose.translation).norm();
      ends.push_back({point, camera.focal_px * distance / (depth * depth)});
    }
  }
  return ends;
}

}  // namespace

double max_motion_px(const SensorModel& model, const PoseTrack& track,
                     const std::vector<std::size_t>& shapes) {
  double farthest_px = 0.0;
  for (const Camera& camera : model.cameras) {
    for (const LinePoint& end : ends_of_seen_line(model, camera)) {
      for (const std::size_t s : shapes) {
        const Eigen::Vector3d in_shape = track.shape_from_reference(s, 0) * end.point;
        for (std::size_t instant = 1; instant < track.instants(); ++instant) {
          const Eigen::Vector3d meanwhile = track.shape_from_reference(s, instant) * end.point;
          farthest_px = std::max(farthest_px, (meanwhile - in_shape).norm() * end.px_per_m);
        }
      }
    }
  }
  return farthest_px;
}

PixelCover::PixelCover(const RenderPlan& plan, const SceneQuery& query, std::size_t number,
                       const PixelMask& mask, Corners& corners)
    : plan_(plan),
      query_(query),
      mask_(mask),
      rays_(plan, number),
      lane_instants_(kLanes, 0),
      corners_(corners) {
  const Camera& camera = plan.settings.model.cameras[number];
  const std::size_t last = query.track().instants() - 1;
  if (last > 0) lane_instants_.resize(2 * kLanes, last);
  view_.set(query, {camera.sensor_from_camera.translation}, lane_instants_, plan.camera_regions[number]);
  laser_.set(query, {plan.source(0, 0)}, lane_instants_, plan.laser_region);
  corners_per_edge_ = (static_cast<std::size_t>(camera.height_px) + 1) * instants();
  corners_.assign(kEdgesKept * corners_per_edge_, {});
}

bool PixelCover::applies() const {
  // Blurred pixels receive light from beyond their corners.
  const Camera& camera = plan_.settings.model.cameras[rays_.camera()];
  const bool sharp = rays_.share_viewpoint() && camera.psf_sigma_px == 0.0;
  return sharp && max_motion_px(plan_.settings.model, query_.track(), view_.shapes()) <= kMaxMotion;
}

Patch PixelCover::patch(int column, int row) {
  column_ = column;
  // An even edge ends each group, so that the odd ones lie between traced edges.
  if (next_edge_ < column)
    next_edge_ = (column + kEdgesAtOnce - 1) / kEdgesAtOnce * kEdgesAtOnce - kEdgesAtOnce + 1;
  while (next_edge_ <= column + 1) {
    trace_edges(next_edge_);
    next_edge_ += kEdgesAtOnce;
  }
  const Corner& first = *around(row, 0)[0];
  if (first.id.shape < 0) return {};
  const Shape& shape = query_.scene().shapes()[static_cast<std::size_t>(first.id.shape)];
  Patch patch{first.id.shape, 1, {first.id.face}, plan_.lane_sources.size() == 1};
  bool few = true;
  for (std::size_t instant = 0; instant < instants(); ++instant) {
    for (const Corner* corner : around(row, instant)) {
      if (corner->id.shape != first.id.shape || corner->from_front != first.from_front) return {};
      few = few && extend(shape, corner->id.face, patch);
      patch.in_light = patch.in_light && corner->in_light;
    }
  }
  if (few && patch.count <= 2) return patch;
  patch.is_flat = flatten(shape, row, patch);
  // Three or four small faces often enclose another one: the planar proxy is preferred.
  const bool many = patch.is_flat && patch.count > 2 && is_fine(shape, patch.face[0]);
  if (patch.is_flat && (!few || many)) patch.count = 0;
  patch.is_open = !few && !patch.is_flat;
  return patch;
}

std::array<const PixelCover::Corner*, 4> PixelCover::around(int row, std::size_t instant) const {
  const std::size_t above = static_cast<std::size_t>(row) * instants() + instant;
  const std::size_t below = above + instants();
  const Corner* left = corners_of(column_);
  const Corner* right = corners_of(column_ + 1);
  return {left + above, left + below, right + below, right + above};
}

/// Returns true when the neighbouring faces are about as small as pixels.
bool PixelCover::is_fine(const Shape& shape, std::uint32_t face) const {
  constexpr double kFine = 2.0;  // px
  const double reach = static_cast<double>(shape.planar_radii[shape.faces[3 * std::size_t{face}]]);
  return reach > 0.0 && reach < kFine * plan_.pixel_size;
}

/// Returns true when the surface is continuous from each corner's face to the next, around the pixel and
/// between the instants.
bool PixelCover::is_ring(const Shape& shape, int row) const {
  const auto start = around(row, 0);
  for (std::size_t instant = 0; instant < instants(); ++instant) {
    const auto ring = around(row, instant);
    for (std::size_t k = 0; k < ring.size(); ++k) {
      const std::uint32_t face = ring[k]->id.face;
      if (!are_continuous(shape, face, ring[(k + 1) % ring.size()]->id.face)) return false;
      if (!are_continuous(shape, face, start[k]->id.face)) return false;
    }
  }
  return true;
}

/// Computes the planar proxy of the corner faces. Returns false when they are not coplanar.
bool PixelCover::flatten(const Shape& shape, int row, Patch& patch) const {
  const auto number = static_cast<std::size_t>(patch.shape);
  Eigen::Vector3d middle = Eigen::Vector3d::Zero();
  Eigen::Vector3d normal = Eigen::Vector3d::Zero();
  for (std::size_t instant = 0; instant < instants(); ++instant) {
    const std::size_t at = lane_instants_[instant * kLanes];
    const Rigid3& shape_from_reference = query_.track().shape_from_reference(number, at);
    for (const Corner* corner : around(row, instant)) {
      middle += shape_from_reference * corner->point;
      normal += Eigen::Map<const Eigen::Vector3d>(shape.planes[corner->id.face].normal);
    }
  }
  const double corners = 4.0 * static_cast<double>(instants());
  middle /= corners;
  normal.normalize();
  double bulge = 0.0;  // mean height of the planes over the centre of the corners
  for (std::size_t instant = 0; instant < instants(); ++instant) {
    for (const Corner* corner : around(row, instant)) {
      const FacePlane& plane = shape.planes[corner->id.face];
      const Eigen::Map<const Eigen::Vector3d> its(plane.normal);
      const double height = plane.offset - its.dot(middle);
      if (!(its.dot(normal) > kParallel && std::abs(height) < kFlat * plan_.pixel_size)) return false;
      bulge += height / corners;
    }
  }
  if (!is_ring(shape, row)) return false;
  // The mean height of a paraboloid over a square is a third of that above the centre of its corners.
  patch.plane = {{normal.x(), normal.y(), normal.z()}, normal.dot(middle) + bulge / 3.0};
  return true;
}

/// Finds the corners of kEdgesAtOnce edges.
void PixelCover::trace_edges(int first_edge) {
  CornerIndex indices[kLanes];
  int count = 0;
  const auto trace = [&](int edge, int row) {
    indices[count++] = {edge, row};
    if (count < kLanes) return;
    trace_corners(indices, count);
    count = 0;
  };
  const auto is_even = [](int edge, int row) { return edge % 2 == 0 && row % 2 == 0; };
  mask_.for_each_corner<kEdgesAtOnce>(first_edge, [&](int edge, int row) {
    if (is_even(edge, row)) trace(edge, row);
  });
  if (count > 0) trace_corners(indices, count);
  count = 0;
  mask_.for_each_corner<kEdgesAtOnce>(first_edge, [&](int edge, int row) {
    if (!is_even(edge, row) && !interpolate(edge, row)) trace(edge, row);
  });
  if (count > 0) trace_corners(indices, count);
}

/// Sets a corner between traced corners of even edge and row. Returns false where these do not hit one lit
/// face, or are unknown.
bool PixelCover::interpolate(int edge, int row) {
  const int across = edge % 2;
  const int along = row % 2;
  const CornerIndex around[] = {{edge - across, row - along},
                                {edge + across, row + along},
                                {edge - across, row + along},
                                {edge + across, row - along}};
  const int count = across != 0 && along != 0 ? 4 : 2;
  for (std::size_t instant = 0; instant < instants(); ++instant) {
    const Corner* first = nullptr;
    for (int k = 0; k < count; ++k) {
      const CornerIndex& at = around[k];
      if (at.edge < 0 || static_cast<std::size_t>(at.row + 1) * instants() > corners_per_edge_) return false;
      const Corner& corner = corners_of(at.edge)[static_cast<std::size_t>(at.row) * instants() + instant];
      if (k == 0) first = &corner;
      if (corner.edge != at.edge || !corner.in_light || !(corner.id == first->id)) return false;
    }
  }
  for (std::size_t instant = 0; instant < instants(); ++instant) {
    const auto at = [&](const CornerIndex& index) -> Corner& {
      return corners_of(index.edge)[static_cast<std::size_t>(index.row) * instants() + instant];
    };
    Corner& corner = at({edge, row});
    corner = at(around[0]);
    corner.edge = edge;
    corner.point = 0.5 * (corner.point + at(around[1]).point);
  }
  return true;
}

void PixelCover::trace_corners(const CornerIndex* indices, int count) {
  Lanes3 direction;
  int edges[kLanes];
  int rows[kLanes];
  for (int l = 0; l < kLanes; ++l) {
    const CornerIndex& corner = indices[std::min(l, count - 1)];
    edges[l] = corner.edge;
    rows[l] = corner.row;
  }
  rays_.through_corners(edges, rows, direction);
  alignas(64) int valid[kLanes];
  activate_lanes(static_cast<std::size_t>(count), valid);
  const Eigen::Vector3d from_source =
      Eigen::Map<const Eigen::Vector3d>(rays_.viewpoint()) - plan_.source(0, 0);
  for (std::size_t instant = 0; instant < instants(); ++instant) {
    PacketHits hits;
    view_.intersect(instant, direction, valid, hits);
    Lanes3 to_point;
    alignas(64) int unoccluded[kLanes];
    for (int l = 0; l < kLanes; ++l) {
      unoccluded[l] = hits.shape[l] >= 0 ? -1 : 0;
      const double t = unoccluded[l] != 0 ? hits.t[l] : 0.0;
      set_lane(to_point, l, from_source + t * lane(direction, l));
    }
    laser_.occlude(instant, to_point, unoccluded);
    for (int l = 0; l < count; ++l) {
      const double to_viewpoint = -lane(hits.normal, l).dot(lane(direction, l));
      const double to_source = -lane(hits.normal, l).dot(lane(to_point, l).normalized());
      const bool steep = (to_viewpoint > 0.0 ? to_source : -to_source) > kGrazing;
      corners_of(edges[l])[static_cast<std::size_t>(rows[l]) * instants() + instant] = {
          {hits.shape[l], hits.face[l]},
          plan_.source(0, 0) + lane(to_point, l),
          to_viewpoint > 0.0,
          steep && unoccluded[l] != 0,
          edges[l]};
    }
  }
}

}  // namespace sensor_rt
