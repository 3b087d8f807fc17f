#include "sensor_rt/visibility/pose_search.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <stdexcept>
#include <string>
#include <utility>

#include "sensor_rt/geometry/parallel.h"
#include "sensor_rt/scene/mesh_shape.h"
#include "sensor_rt/visibility/free_distances.h"

namespace sensor_rt {
namespace {

constexpr double kPi = 3.14159265358979323846;

/// Returns the offset of ray origins from the surface, m: above the rounding of single precision at the rim
/// of the mesh.
double lift_above(const MeshView& mesh, const Eigen::Vector3d& centre) {
  constexpr double kLeast = 10e-6;
  double radius = 0.0;
  for (std::size_t i = 0; i < mesh.vertex_count; ++i) {
    radius = std::max(radius, (mesh.vertex(i) - centre).norm());
  }
  return std::max(kLeast, 1e-6 * radius);
}

/// Returns all tiles in strides of about the golden section of their number, so that the first ones are
/// spread over the sphere.
std::vector<int> spread_order(int tiles) {
  int stride = std::max(1, static_cast<int>(std::lround(0.618 * tiles)));
  while (std::gcd(stride, tiles) != 1) ++stride;
  std::vector<int> order(static_cast<std::size_t>(tiles));
  for (int i = 0; i < tiles; ++i) {
    order[static_cast<std::size_t>(i)] =
        static_cast<int>(static_cast<std::int64_t>(i) * stride % static_cast<std::int64_t>(tiles));
  }
  return order;
}

void check(const SurfaceSamples& samples) {
  if (samples.points.size() != samples.normals.size())
    throw std::invalid_argument("normals: expected one for each sample");
  for (std::size_t i = 0; i < samples.points.size(); ++i) {
    if (!samples.points[i].allFinite() || !samples.normals[i].allFinite())
      throw std::invalid_argument("sample " + std::to_string(i) + " is not finite");
  }
}

/// Returns the map for all sensor origins from which a pose of the grid measures one of the samples, at
/// azimuth 0.
ReachMap reach_map(const SurfaceSamples& samples, const PoseGrid& grid, double step) {
  check(samples);
  double radius = 0.0;
  double low = 0.0;
  double high = 0.0;
  for (const Eigen::Vector3d& point : samples.points) {
    radius = std::max(radius, point.head<2>().norm());
    low = std::min(low, point.z());
    high = std::max(high, point.z());
  }
  const double far = grid.farthest_origin();
  return ReachMap(grid.orientations().frame_from_sensor.size(), {-radius - far, -radius - far, low - far},
                  {radius + far, radius + far, high + far}, step);
}

}  // namespace

PoseSearch::PoseSearch(const MeshView& mesh, SurfaceSamples samples, PoseGrid grid, double incidence_limit,
                       double position_step)
    : samples_(std::move(samples)),
      grid_(std::move(grid)),
      min_cosine_(std::cos(incidence_limit)),
      reach_(reach_map(samples_, grid_, position_step)) {
  if (!(incidence_limit > 0.0) || !(incidence_limit <= 0.5 * kPi))
    throw std::invalid_argument("incidence_limit: expected more than 0 and at most 90 degrees");
  validate_mesh(mesh, "mesh");
  centre_ = mesh_centre(mesh);
  lift_ = lift_above(mesh, centre_);
  scene_ = build_triangle_scene(mesh, centre_);
  order_ = spread_order(grid_.directions().tiles());
  for (int k = 0; k < grid_.orientations().azimuths; ++k) {
    const double angle = 2.0 * kPi * k / grid_.orientations().azimuths;
    azimuth_rotations_.push_back(Eigen::AngleAxisd(angle, Eigen::Vector3d::UnitZ()).toRotationMatrix());
  }
  cursors_.resize(samples_.points.size());
}

std::vector<FoundPose> PoseSearch::next(const std::int64_t* samples, std::size_t count, unsigned threads) {
  check_numbers(samples, count);
  constexpr std::size_t kBlock = 16;
  const std::size_t blocks = (count + kBlock - 1) / kBlock;
  std::vector<FreeDistances> free_distances;
  for (unsigned w = 0; w < thread_count(threads, blocks); ++w)
    free_distances.emplace_back(scene_.get(), grid_.directions(), grid_.farthest());
  std::vector<FoundPose> found(count);
  std::vector<std::uint8_t> is_found(count, 0);
  parallel_for(blocks, threads, [&](std::size_t block, unsigned worker) {
    for (std::size_t i = block * kBlock; i < std::min(count, (block + 1) * kBlock); ++i) {
      is_found[i] = find(static_cast<std::size_t>(samples[i]), free_distances[worker], found[i]) ? 1 : 0;
    }
  });
  std::vector<FoundPose> result;
  for (std::size_t i = 0; i < count; ++i) {
    if (is_found[i] != 0) result.push_back(found[i]);
  }
  return result;
}

void PoseSearch::skip_directions(const std::int64_t* samples, std::size_t count) {
  check_numbers(samples, count);
  for (std::size_t i = 0; i < count; ++i) {
    Cursor& cursor = cursors_[static_cast<std::size_t>(samples[i])];
    cursor.cell = (cursor.cell / DirectionGrid::kTileCells + 1) * DirectionGrid::kTileCells;
    cursor.pose = 0;
  }
}

void PoseSearch::check_numbers(const std::int64_t* samples, std::size_t count) const {
  for (std::size_t i = 0; i < count; ++i) {
    if (samples[i] < 0 || static_cast<std::size_t>(samples[i]) >= cursors_.size())
      throw std::out_of_range("sample " + std::to_string(samples[i]) + " does not exist");
  }
}

bool PoseSearch::find(std::size_t sample, FreeDistances& free_distances, FoundPose& found) {
  const DirectionGrid& directions = grid_.directions();
  const Eigen::Vector3d& normal = samples_.normals[sample];
  const Eigen::Vector3d origin = samples_.points[sample] + lift_ * normal - centre_;
  // Directions within a cell differ from its centre by less than the cell size.
  const double slack = std::max(0.0, std::cos(std::min(kPi, std::acos(min_cosine_) + directions.step())));
  free_distances.start(origin.cast<float>(), normal.cast<float>(), static_cast<float>(std::max(slack, 1e-6)));
  std::vector<Eigen::Vector3d> rotated_samples;  // the sample, rotated to azimuth 0, per azimuth
  for (const Eigen::Matrix3d& rotation : azimuth_rotations_)
    rotated_samples.push_back(rotation.transpose() * samples_.points[sample]);
  Cursor& cursor = cursors_[sample];
  const auto height = static_cast<float>(samples_.points[sample].z());
  const auto cells = static_cast<std::uint32_t>(order_.size() * DirectionGrid::kTileCells);
  for (; cursor.cell < cells; ++cursor.cell, cursor.pose = 0) {
    const int cell = order_[cursor.cell / DirectionGrid::kTileCells] * DirectionGrid::kTileCells +
                     static_cast<int>(cursor.cell % DirectionGrid::kTileCells);
    const float free = free_distances.distance(cell);
    if (free < grid_.nearest_source()) continue;
    const int column = directions.column_of_cell(cell);
    const PoseGrid::Range list = grid_.poses_at(directions.row_of_cell(cell), column);
    for (std::size_t i = list.begin + cursor.pose; i < list.end; ++i) {
      const RelativePose& pose = grid_.pose(i);
      if (height + pose.lowest < 0.0f) break;
      if (free < grid_.laser_distance(pose.point)) continue;
      const int azimuth = grid_.azimuth(pose, column);
      const Eigen::Vector3d& at = rotated_samples[static_cast<std::size_t>(azimuth)];
      if (reach_.is_cube_unreachable(pose.orientation, at + pose.origin.cast<double>())) continue;
      if (!try_pose(sample, i, azimuth, at, free_distances, found)) continue;
      cursor.pose = static_cast<std::uint32_t>(i + 1 - list.begin);
      return true;
    }
  }
  return false;
}

bool PoseSearch::try_pose(std::size_t sample, std::size_t number, int azimuth, const Eigen::Vector3d& at,
                          FreeDistances& free_distances, FoundPose& found) const {
  const RelativePose& pose = grid_.pose(number);
  const SensorField& field = grid_.field();
  for (std::size_t camera = 0; camera < field.cameras.size(); ++camera) {
    const int cell = grid_.camera_cell(number, camera, azimuth);
    if (cell < 0 || free_distances.distance(cell) < grid_.camera_distance(pose.point, camera)) continue;
    const Eigen::Matrix3d& rotation = grid_.orientations().frame_from_sensor[pose.orientation];
    const Eigen::Vector2d& in_sheet = field.points[pose.point];
    const Eigen::Vector3d origin = at - in_sheet.x() * rotation.col(1) - in_sheet.y() * rotation.col(2);
    found.key = reach_.key(pose.orientation, origin);
    if (reach_.is_unreachable(found.key)) return false;
    found.sample = static_cast<std::int64_t>(sample);
    found.sample_position = at;
    found.source_position = origin + field.source_z * rotation.col(2);
    found.camera_position = origin + rotation * field.cameras[camera];
    const Eigen::Matrix3d& turn = azimuth_rotations_[static_cast<std::size_t>(azimuth)];
    if (is_free(sample, turn * found.source_position, turn * found.camera_position)) return true;
  }
  return false;
}

bool PoseSearch::is_free(std::size_t sample, const Eigen::Vector3d& source,
                         const Eigen::Vector3d& camera) const {
  const Eigen::Vector3d& normal = samples_.normals[sample];
  const Eigen::Vector3d start = samples_.points[sample] + lift_ * normal;
  alignas(64) int valid[16] = {-1, -1};
  RTCRay16 rays{};
  for (int l = 0; l < 2; ++l) {
    const Eigen::Vector3d segment = (l == 0 ? source : camera) - start;
    if (segment.dot(normal) < min_cosine_ * segment.norm()) return false;
    rays.org_x[l] = static_cast<float>(start.x() - centre_.x());
    rays.org_y[l] = static_cast<float>(start.y() - centre_.y());
    rays.org_z[l] = static_cast<float>(start.z() - centre_.z());
    rays.dir_x[l] = static_cast<float>(segment.x());
    rays.dir_y[l] = static_cast<float>(segment.y());
    rays.dir_z[l] = static_cast<float>(segment.z());
    rays.tfar[l] = 1.0f;
    rays.mask[l] = ~0u;
  }
  occluded16(scene_.get(), valid, false, rays);
  return rays.tfar[0] >= 0.0f && rays.tfar[1] >= 0.0f;
}

}  // namespace sensor_rt
