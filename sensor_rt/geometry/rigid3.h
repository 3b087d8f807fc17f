// Rigid transforms. A variable is named target_from_source, and neighbours in a product must match.
#pragma once

#include <Eigen/Dense>

namespace sensor_rt {

/// Maps a point in the source frame to the target frame: p_target = rotation * p_source + translation (metres).
struct Rigid3 {
  Eigen::Matrix3d rotation = Eigen::Matrix3d::Identity();
  Eigen::Vector3d translation = Eigen::Vector3d::Zero();

  Eigen::Vector3d operator*(const Eigen::Vector3d& point) const { return rotation * point + translation; }

  Rigid3 operator*(const Rigid3& other) const {
    return {rotation * other.rotation, rotation * other.translation + translation};
  }

  Rigid3 inverse() const {
    return {rotation.transpose(), -(rotation.transpose() * translation)};
  }
};

}  // namespace sensor_rt
