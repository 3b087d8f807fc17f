// Sensor poses relative to a surface sample that place the sample in the measuring field.
#pragma once

#include <Eigen/Dense>
#include <cstdint>
#include <vector>

#include "sensor_rt/visibility/direction_grid.h"

namespace sensor_rt {

/// Measurable positions in the laser sheet, sensor frame, metres.
struct SensorField {
  std::vector<Eigen::Vector2d> points;   ///< (y, z) in the sheet x = 0
  std::vector<Eigen::Vector3d> cameras;  ///< centres of projection
  std::vector<std::uint8_t> seen;        ///< points x cameras: whether the point is within the camera's image
  double source_z = 0.0;                 ///< the laser source is at (0, 0, source_z)
};

/// Orientations of the sensor at azimuth 0, in a frame whose z is the axis of the azimuths.
struct SensorOrientations {
  std::vector<Eigen::Matrix3d> frame_from_sensor;
  std::vector<double> lowest;  ///< z of the lowest point of the housing relative to the sensor origin, m
  int azimuths = 0;            ///< number of azimuth steps per turn
};

/// A pose at azimuth 0, relative to the measured sample.
struct RelativePose {
  std::uint16_t orientation;
  std::uint16_t point;     ///< index of the field point at which the sample lies
  std::uint16_t column;    ///< grid column of the direction from the sample to the laser source
  float lowest;            ///< z of the lowest point of the housing relative to the sample, m
  Eigen::Vector3f origin;  ///< sensor origin relative to the sample, m
};

/// Poses indexed by the cell of the direction grid that contains the direction from the sample to the laser
/// source.
class PoseGrid {
 public:
  /// Throws std::invalid_argument for sizes that are inconsistent or exceed 65535.
  PoseGrid(SensorOrientations orientations, SensorField field);

  struct Range {
    std::size_t begin;
    std::size_t end;
  };

  const DirectionGrid& directions() const { return directions_; }
  const SensorField& field() const { return field_; }
  const SensorOrientations& orientations() const { return orientations_; }

  /// Returns the range of the poses whose laser ray, at some azimuth, lies in this cell; highest housing
  /// first.
  Range poses_at(int row, int column) const {
    const auto list = static_cast<std::size_t>(row * DirectionGrid::kColumnsPerAzimuth +
                                               column % DirectionGrid::kColumnsPerAzimuth);
    return {begin_[list], begin_[list + 1]};
  }
  const RelativePose& pose(std::size_t number) const { return poses_[number]; }

  /// Returns the azimuth step at which the pose's laser ray lies in `column`.
  int azimuth(const RelativePose& pose, int column) const {
    return directions_.wrapped(column - pose.column) / DirectionGrid::kColumnsPerAzimuth;
  }
  /// Returns the cell of the direction from the sample to a camera; -1 when the sample is outside its image.
  int camera_cell(std::size_t number, std::size_t camera, int azimuth) const {
    const Cell& at = camera_cells_[number * field_.cameras.size() + camera];
    if (at.row < 0) return -1;
    return directions_.cell(at.row,
                            directions_.wrapped(at.column + azimuth * DirectionGrid::kColumnsPerAzimuth));
  }
  double laser_distance(std::size_t point) const { return laser_distance_[point]; }
  double camera_distance(std::size_t point, std::size_t camera) const {
    return camera_distance_[point * field_.cameras.size() + camera];
  }
  /// Returns the length of the shortest laser ray, m.
  double nearest_source() const { return nearest_source_; }
  /// Returns the length of the longest laser or camera ray, m.
  double farthest() const { return farthest_; }
  /// Returns the largest distance between sample and sensor origin, m.
  double farthest_origin() const { return farthest_origin_; }

 private:
  struct Cell {
    std::int16_t row;
    std::int16_t column;
  };

  void list_poses();

  SensorOrientations orientations_;
  SensorField field_;
  DirectionGrid directions_;
  std::vector<double> laser_distance_;   ///< of each point
  std::vector<double> camera_distance_;  ///< points x cameras
  double nearest_source_ = 0.0;
  double farthest_ = 0.0;
  double farthest_origin_ = 0.0;
  std::vector<RelativePose> poses_;
  std::vector<Cell> camera_cells_;  ///< poses x cameras
  std::vector<std::size_t> begin_;  ///< of the lists, rows x columns of an azimuth step
};

}  // namespace sensor_rt
