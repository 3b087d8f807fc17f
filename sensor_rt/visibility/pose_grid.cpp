#include "sensor_rt/visibility/pose_grid.h"

#include <algorithm>
#include <limits>
#include <stdexcept>
#include <tuple>
#include <utility>

namespace sensor_rt {
namespace {

Eigen::Vector3d in_sheet(const Eigen::Vector2d& point) { return {0.0, point.x(), point.y()}; }

void check(const SensorOrientations& orientations, const SensorField& field) {
  constexpr std::size_t kCapacity = std::numeric_limits<std::uint16_t>::max();
  const std::size_t count = orientations.frame_from_sensor.size();
  if (count == 0 || count > kCapacity || orientations.lowest.size() != count)
    throw std::invalid_argument("orientations: expected 1 to 65535, each with its lowest height");
  if (orientations.azimuths < 2 || orientations.azimuths > 1000 || orientations.azimuths % 2 != 0)
    throw std::invalid_argument("azimuths: expected an even number from 2 to 1000");
  if (field.points.empty() || field.points.size() > kCapacity)
    throw std::invalid_argument("field_points: expected 1 to 65535");
  if (field.cameras.empty() || field.seen.size() != field.points.size() * field.cameras.size())
    throw std::invalid_argument("field_seen: expected one value for each point and camera");
}

}  // namespace

PoseGrid::PoseGrid(SensorOrientations orientations, SensorField field)
    : orientations_((check(orientations, field), std::move(orientations))),
      field_(std::move(field)),
      directions_(orientations_.azimuths) {
  const Eigen::Vector3d source(0.0, 0.0, field_.source_z);
  for (const Eigen::Vector2d& point : field_.points) {
    farthest_origin_ = std::max(farthest_origin_, point.norm());
    laser_distance_.push_back((source - in_sheet(point)).norm());
    for (const Eigen::Vector3d& camera : field_.cameras)
      camera_distance_.push_back((camera - in_sheet(point)).norm());
  }
  nearest_source_ = *std::min_element(laser_distance_.begin(), laser_distance_.end());
  farthest_ = std::max(*std::max_element(laser_distance_.begin(), laser_distance_.end()),
                       *std::max_element(camera_distance_.begin(), camera_distance_.end()));
  list_poses();
}

void PoseGrid::list_poses() {
  const Eigen::Vector3d source(0.0, 0.0, field_.source_z);
  const std::size_t cameras = field_.cameras.size();
  std::vector<int> list_of;
  for (std::size_t o = 0; o < orientations_.frame_from_sensor.size(); ++o) {
    const Eigen::Matrix3d& rotation = orientations_.frame_from_sensor[o];
    for (std::size_t p = 0; p < field_.points.size(); ++p) {
      const std::uint8_t* seen = &field_.seen[p * cameras];
      if (std::none_of(seen, seen + cameras, [](std::uint8_t s) { return s != 0; })) continue;
      const Eigen::Vector3d point = in_sheet(field_.points[p]);
      const Eigen::Vector3d laser = rotation * (source - point).normalized();
      const int column = directions_.column_of(laser);
      const Eigen::Vector3d origin = -(rotation * point);
      poses_.push_back({static_cast<std::uint16_t>(o), static_cast<std::uint16_t>(p),
                        static_cast<std::uint16_t>(column),
                        static_cast<float>(orientations_.lowest[o] + origin.z()), origin.cast<float>()});
      list_of.push_back(directions_.row_of(laser) * DirectionGrid::kColumnsPerAzimuth +
                        column % DirectionGrid::kColumnsPerAzimuth);
    }
  }
  std::vector<std::size_t> order(poses_.size());
  for (std::size_t i = 0; i < order.size(); ++i) order[i] = i;
  std::sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) {
    return std::make_tuple(list_of[a], -poses_[a].lowest, a) <
           std::make_tuple(list_of[b], -poses_[b].lowest, b);
  });
  const std::vector<RelativePose> unsorted = std::move(poses_);
  poses_.clear();
  begin_.assign(static_cast<std::size_t>(directions_.rows() * DirectionGrid::kColumnsPerAzimuth) + 1, 0);
  for (const std::size_t i : order) {
    const RelativePose& pose = unsorted[i];
    poses_.push_back(pose);
    ++begin_[static_cast<std::size_t>(list_of[i]) + 1];
    const Eigen::Vector3d point = in_sheet(field_.points[pose.point]);
    for (std::size_t c = 0; c < cameras; ++c) {
      const Eigen::Vector3d to_camera =
          orientations_.frame_from_sensor[pose.orientation] * (field_.cameras[c] - point).normalized();
      const bool seen = field_.seen[pose.point * cameras + c] != 0;
      camera_cells_.push_back({static_cast<std::int16_t>(seen ? directions_.row_of(to_camera) : -1),
                               static_cast<std::int16_t>(directions_.column_of(to_camera))});
    }
  }
  for (std::size_t k = 1; k < begin_.size(); ++k) begin_[k] += begin_[k - 1];
}

}  // namespace sensor_rt
