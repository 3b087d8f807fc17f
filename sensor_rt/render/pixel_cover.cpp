#include "sensor_rt/render/pixel_cover.h"

#include <algorithm>
#include <limits>
#include <utility>

namespace sensor_rt {
namespace {

constexpr double kFarthestMotion = 1.0;  // px
/// Cosine of incidence below which every facet may shadow the next, and light is left to rays of its own.
constexpr double kGrazing = 0.1;
constexpr double kInfinity = std::numeric_limits<double>::infinity();

bool share_a_vertex(const std::uint32_t* a, const std::uint32_t* b) {
  return std::any_of(a, a + 3, [&](std::uint32_t vertex) { return std::find(b, b + 3, vertex) != b + 3; });
}

/// Adds a face to a patch. False when it does not touch all that are there already.
bool extend(const Shape& shape, std::uint32_t face, Patch& patch) {
  const std::uint32_t* end = patch.face + patch.count;
  if (std::find(static_cast<const std::uint32_t*>(patch.face), end, face) != end) return true;
  if (patch.count == Patch::kMost) return false;
  for (int k = 0; k < patch.count; ++k) {
    if (!share_a_vertex(shape.faces + 3 * std::size_t{face}, shape.faces + 3 * std::size_t{patch.face[k]})) {
      return false;
    }
  }
  patch.face[patch.count++] = face;
  return true;
}

}  // namespace

double largest_motion_px(const SensorModel& model, const PoseTrack& track,
                         const std::vector<std::size_t>& shapes) {
  const std::size_t last = track.instants() - 1;
  if (last == 0) return 0.0;
  double farthest_px = 0.0;
  for (const std::size_t s : shapes) {
    const Rigid3 moved = track.shape_from_reference(s, last).inverse() * track.shape_from_reference(s, 0);
    for (const double z : {model.near, model.far}) {
      const Eigen::Vector3d point(0.0, 0.0, z);
      for (const Camera& camera : model.cameras) {
        const double distance = (point - camera.sensor_from_camera.translation).norm();
        farthest_px = std::max(farthest_px, (moved * point - point).norm() * camera.focal_px / distance);
      }
    }
  }
  return farthest_px;
}

PixelCover::PixelCover(const RenderPlan& plan) : plan_(plan), rays_(plan) {}

void PixelCover::set(const Scene& scene, const PoseTrack& track) {
  scene_ = &scene;
  track_ = &track;
}

bool PixelCover::select_camera(std::size_t number) {
  rays_.select_camera(number);
  const Camera& camera = plan_.settings.model.cameras[number];
  lane_instants_.assign(kLanes, 0);
  if (track_->instants() > 1) lane_instants_.resize(2 * kLanes, track_->instants() - 1);
  view_.set(*scene_, *track_, {camera.sensor_from_camera.translation}, lane_instants_,
            plan_.camera_regions[number]);
  laser_.set(*scene_, *track_, {plan_.source(0, 0)}, lane_instants_, plan_.laser_region);
  const std::size_t corners = (static_cast<std::size_t>(camera.height_px) + 1) * instants();
  left_.assign(corners, {});
  right_.assign(corners, {});
  column_ = -2;
  // A blurred pixel collects light from beyond its corners.
  const bool sharp = rays_.share_eye() && camera.psf_sigma_px == 0.0;
  return sharp && largest_motion_px(plan_.settings.model, *track_, view_.shapes()) <= kFarthestMotion;
}

Patch PixelCover::patch(int column, int row, const PixelMask& mask) {
  if (column != column_) {
    if (column == column_ + 1) {
      std::swap(left_, right_);
    } else {
      look_along(column, mask, left_);
    }
    look_along(column + 1, mask, right_);
    column_ = column;
  }
  const std::size_t above = static_cast<std::size_t>(row) * instants();
  const Corner& first = left_[above];
  if (first.id.shape < 0) return {};
  const Shape& shape = scene_->shapes()[static_cast<std::size_t>(first.id.shape)];
  Patch patch{first.id.shape, 1, {first.id.face}, plan_.lane_sources.size() == 1};
  for (const Corners* side : {&left_, &right_}) {
    for (std::size_t k = above; k < above + 2 * instants(); ++k) {
      const Corner& corner = (*side)[k];
      if (corner.id.shape != first.id.shape || corner.from_front != first.from_front) return {};
      if (!(corner.id == first.id) && !extend(shape, corner.id.face, patch)) return {};
      patch.in_light = patch.in_light && corner.in_light;
    }
  }
  return patch;
}

void PixelCover::look_along(int edge, const PixelMask& mask, Corners& corners) {
  int rows[kLanes];
  int count = 0;
  const auto add = [&](int row) {
    rows[count++] = row;
    if (count < kLanes) return;
    look_along_packet(edge, rows, count, corners);
    count = 0;
  };
  int next = 0;  // corners before this one are looked along
  mask.for_each_row(edge - 1, edge, [&](int row) {
    if (row >= next) add(row);
    add(row + 1);
    next = row + 2;
  });
  if (count > 0) look_along_packet(edge, rows, count, corners);
}

void PixelCover::look_along_packet(int edge, const int* rows, int count, Corners& corners) {
  Lanes3 direction;
  rays_.through_corners(edge, rows, count, direction);
  alignas(64) int valid[kLanes];
  for (int l = 0; l < kLanes; ++l) valid[l] = l < count ? -1 : 0;
  const Eigen::Vector3d from_source = Eigen::Map<const Eigen::Vector3d>(rays_.eye()) - plan_.source(0, 0);
  for (std::size_t instant = 0; instant < instants(); ++instant) {
    PacketHits hits;
    view_.intersect(instant, direction, valid, kInfinity, hits);
    Lanes3 way;
    alignas(64) int open[kLanes];
    for (int l = 0; l < kLanes; ++l) {
      open[l] = hits.shape[l] >= 0 ? -1 : 0;
      const double t = open[l] != 0 ? hits.t[l] : 0.0;
      set_lane(way, l, from_source + t * lane(direction, l));
    }
    laser_.occlude(instant, way, kBeforeSurface, open);
    for (int l = 0; l < count; ++l) {
      const double to_eye = -lane(hits.normal, l).dot(lane(direction, l));
      const double to_source = -lane(hits.normal, l).dot(lane(way, l).normalized());
      const bool steep = (to_eye > 0.0 ? to_source : -to_source) > kGrazing;
      corners[static_cast<std::size_t>(rows[l]) * instants() + instant] = {
          {hits.shape[l], hits.face[l]}, to_eye > 0.0, steep && open[l] != 0};
    }
  }
}

}  // namespace sensor_rt
