// Rigid transforms. A variable is named target_from_source, and neighbours in a product must match.
#pragma once

#include <Eigen/Dense>

namespace sensor_rt {

/// Maps a point in the source frame to the target frame: p_target = rotation * p_source + translation
/// (metres).
struct Rigid3 {
  Eigen::Matrix3d rotation = Eigen::Matrix3d::Identity();
  Eigen::Vector3d translation = Eigen::Vector3d::Zero();

  Eigen::Vector3d operator*(const Eigen::Vector3d& point) const { return rotation * point + translation; }

  Rigid3 operator*(const Rigid3& other) const {
    return {rotation * other.rotation, rotation * other.translation + translation};
  }

  bool operator==(const Rigid3& other) const {
    return rotation == other.rotation && translation == other.translation;
  }

  Rigid3 inverse() const { return {rotation.transpose(), -(rotation.transpose() * translation)}; }
};

/// Returns the pose between `from` (fraction 0) and `to` (fraction 1): linear translation, constant angular
/// velocity. Equal poses are returned unchanged to the last bit, so that the result of a still exposure does
/// not depend on the number of pose samples.
inline Rigid3 interpolate(const Rigid3& from, const Rigid3& to, double fraction) {
  if (from == to || fraction == 0.0) return from;
  const Eigen::AngleAxisd rotation(Eigen::Matrix3d(from.rotation.transpose() * to.rotation));
  Rigid3 result;
  result.rotation =
      from.rotation * Eigen::AngleAxisd(fraction * rotation.angle(), rotation.axis()).toRotationMatrix();
  result.translation = from.translation + fraction * (to.translation - from.translation);
  return result;
}

}  // namespace sensor_rt
