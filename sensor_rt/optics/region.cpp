#include "sensor_rt/optics/region.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace sensor_rt {
namespace {

/// Calls visit(direction in the camera frame) along the outer border of the image.
template <typename Visit>
void visit_border(const Camera& camera, const Visit& visit) {
  const double right = camera.width_px - 0.5;
  const double bottom = camera.height_px - 0.5;
  constexpr int kSteps = 64;  // with distortion the border is curved
  for (int i = 0; i <= kSteps; ++i) {
    const double u = -0.5 + (right + 0.5) * i / kSteps;
    const double v = -0.5 + (bottom + 0.5) * i / kSteps;
    visit(camera.ray({u, -0.5}));
    visit(camera.ray({u, bottom}));
    visit(camera.ray({-0.5, v}));
    visit(camera.ray({right, v}));
  }
}

}  // namespace

std::vector<HalfSpace> laser_region(const LaserSheet& laser, double slope) {
  const Eigen::Vector3d source(0.0, 0.0, laser.source_z);
  const double c = std::cos(laser.fan_half_angle);
  const double s = std::sin(laser.fan_half_angle);
  const double bent = slope + laser.largest_bend();
  constexpr double kSlack = 1e-9;
  std::vector<HalfSpace> region;
  for (const Eigen::Vector3d& normal :
       {Eigen::Vector3d(0, 0, 1), Eigen::Vector3d(0, -c, s), Eigen::Vector3d(0, c, s),
        Eigen::Vector3d(-1, 0, bent), Eigen::Vector3d(1, 0, bent)}) {
    const double from_its_ends = 0.5 * laser.opening * std::abs(normal.y());
    region.push_back({normal, normal.dot(source) - from_its_ends - kSlack});
  }
  return region;
}

std::vector<HalfSpace> camera_field(const Camera& camera) {
  constexpr double kInfinity = std::numeric_limits<double>::infinity();
  double left = kInfinity, right = -kInfinity, top = kInfinity, bottom = -kInfinity;
  visit_border(camera, [&](const Eigen::Vector3d& d) {
    left = std::min(left, d.x());
    right = std::max(right, d.x());
    top = std::min(top, d.y());
    bottom = std::max(bottom, d.y());
  });
  constexpr double kSlack = 1e-3;  // the border is sampled, not followed
  std::vector<HalfSpace> region;
  for (const Eigen::Vector3d& in_camera :
       {Eigen::Vector3d(0, 0, 1), Eigen::Vector3d(1, 0, kSlack - left),
        Eigen::Vector3d(-1, 0, kSlack + right), Eigen::Vector3d(0, 1, kSlack - top),
        Eigen::Vector3d(0, -1, kSlack + bottom)}) {
    const Eigen::Vector3d normal = camera.sensor_from_camera.rotation * in_camera;
    region.push_back({normal, normal.dot(camera.sensor_from_camera.translation)});
  }
  return region;
}

std::vector<HalfSpace> camera_region(const Camera& camera, double beyond) {
  std::vector<HalfSpace> region = camera_field(camera);
  region.push_back({Eigen::Vector3d(camera.side, 0, 0), -beyond});
  return region;
}

DepthRange visible_depth(const Camera& camera) {
  DepthRange depth{std::numeric_limits<double>::infinity(), -std::numeric_limits<double>::infinity()};
  visit_border(camera, [&](const Eigen::Vector3d& in_camera) {
    const Eigen::Vector3d d = camera.sensor_from_camera.rotation * in_camera;
    const double towards = -camera.side * d.x();  // rays that run away from the sheet never meet it
    const double away = camera.side * camera.sensor_from_camera.translation.x();
    const double t = towards > 0.0 ? away / towards : std::numeric_limits<double>::infinity();
    const double z = camera.sensor_from_camera.translation.z() + t * d.z();
    depth.near = std::min(depth.near, z);
    depth.far = std::max(depth.far, z);
  });
  return depth;
}

}  // namespace sensor_rt
