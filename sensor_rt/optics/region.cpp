#include "sensor_rt/optics/region.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <string>

namespace sensor_rt {
namespace {

/// Calls visit(pixel) for points along the image border, `margin` px outside it.
template <typename Visit>
void visit_border_pixels(const Camera& camera, double margin, const Visit& visit) {
  const double first = -0.5 - margin;
  const double right = camera.width_px - 0.5 + margin;
  const double bottom = camera.height_px - 0.5 + margin;
  constexpr int kSteps = 64;  // with distortion the border is curved
  for (int i = 0; i <= kSteps; ++i) {
    const double u = first + (right - first) * i / kSteps;
    const double v = first + (bottom - first) * i / kSteps;
    visit(Eigen::Vector2d(u, first));
    visit(Eigen::Vector2d(u, bottom));
    visit(Eigen::Vector2d(first, v));
    visit(Eigen::Vector2d(right, v));
  }
}

/// Calls visit(direction in the camera frame) for the same points.
template <typename Visit>
void visit_border(const Camera& camera, double margin, const Visit& visit) {
  visit_border_pixels(camera, margin, [&](const Eigen::Vector2d& pixel) { visit(camera.ray(pixel)); });
}

/// Returns the distance along a direction in the camera frame to the sheet X = 0; infinite when the direction
/// points away from it.
double distance_to_sheet(const Camera& camera, const Eigen::Vector3d& in_camera) {
  const double towards = -camera.side * (camera.sensor_from_camera.rotation * in_camera).x();
  const double away = camera.side * camera.sensor_from_camera.translation.x();
  return towards > 0.0 ? away / towards : std::numeric_limits<double>::infinity();
}

/// Returns the width, px, of the margin around the image from which blurred laser light may reach it.
double spill_px(const Camera& camera) {
  constexpr double kReach = 5.0;  // standard deviations: more than any pattern of samples has
  double spill = kReach * camera.psf_sigma_px;
  if (!camera.has_depth_of_field()) return spill;
  double largest = 0.0;
  visit_border(camera, 0.0, [&](const Eigen::Vector3d& d) {
    const double sheet_distance = distance_to_sheet(camera, d);
    largest = std::max(largest, camera.blur_radius_px(std::min(sheet_distance, kFarthest) * d));
  });
  return spill + 1.1 * largest;
}

}  // namespace

void require_inverse(const Camera& camera) {
  if (!camera.is_distorted()) return;
  const double reach_px = camera.reach().image_px;
  const auto require = [&](double margin) {
    double farthest_px = 0.0;
    visit_border_pixels(camera, margin, [&](const Eigen::Vector2d& pixel) {
      farthest_px = std::max(farthest_px, camera.axis_distance_px(pixel));
    });
    if (farthest_px < reach_px) return;
    const auto rounded = [](double px) { return std::to_string(std::lround(px)); };
    throw std::invalid_argument("has no inverse from a radius of " + rounded(reach_px) +
                                " px about the optical axis on; expected one in the whole image, up to " +
                                rounded(farthest_px) + " px");
  };
  require(0.0);
  require(spill_px(camera));
}

std::vector<HalfSpace> laser_region(const LaserSheet& laser, double slope) {
  const Eigen::Vector3d source(0.0, 0.0, laser.source_z);
  const double c = std::cos(laser.fan_half_angle);
  const double s = std::sin(laser.fan_half_angle);
  const double bent = slope + laser.max_bend();
  constexpr double kSlack = 1e-9;
  std::vector<HalfSpace> region;
  for (const Eigen::Vector3d& normal :
       {Eigen::Vector3d(0, 0, 1), Eigen::Vector3d(0, -c, s), Eigen::Vector3d(0, c, s),
        Eigen::Vector3d(-1, 0, bent), Eigen::Vector3d(1, 0, bent)}) {
    const double from_its_ends = 0.5 * laser.source_length * std::abs(normal.y());
    region.push_back({normal, normal.dot(source) - from_its_ends - kSlack});
  }
  return region;
}

std::vector<HalfSpace> camera_field(const Camera& camera) {
  constexpr double kInfinity = std::numeric_limits<double>::infinity();
  double left = kInfinity, right = -kInfinity, top = kInfinity, bottom = -kInfinity;
  const double spill = spill_px(camera);
  visit_border(camera, spill, [&](const Eigen::Vector3d& d) {
    left = std::min(left, d.x());
    right = std::max(right, d.x());
    top = std::min(top, d.y());
    bottom = std::max(bottom, d.y());
  });
  constexpr double kBorder = 1e-3;  // margin: the border is sampled
  // Rays through the rim and through the centre of the lens intersect in the plane of focus.
  const double rim = camera.has_depth_of_field() ? camera.aperture_radius() : 0.0;
  const double slack = kBorder + (rim > 0.0 ? 1.5 * rim / camera.focus : 0.0);
  std::vector<HalfSpace> region;
  for (const Eigen::Vector3d& in_camera :
       {Eigen::Vector3d(0, 0, 1), Eigen::Vector3d(1, 0, slack - left), Eigen::Vector3d(-1, 0, slack + right),
        Eigen::Vector3d(0, 1, slack - top), Eigen::Vector3d(0, -1, slack + bottom)}) {
    const Eigen::Vector3d normal = camera.sensor_from_camera.rotation * in_camera;
    region.push_back({normal, normal.dot(camera.sensor_from_camera.translation) - 1.5 * rim});
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
  visit_border(camera, spill_px(camera), [&](const Eigen::Vector3d& in_camera) {
    const Eigen::Vector3d d = camera.sensor_from_camera.rotation * in_camera;
    const double z = camera.sensor_from_camera.translation.z() + distance_to_sheet(camera, in_camera) * d.z();
    depth.near = std::min(depth.near, z);
    depth.far = std::max(depth.far, z);
  });
  return depth;
}

}  // namespace sensor_rt
