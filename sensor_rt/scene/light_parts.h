// Parts of area lights, for adaptive integration, and rays that meet them.
#pragma once

#include <Eigen/Dense>
#include <optional>

#include "sensor_rt/geometry/rigid3.h"
#include "sensor_rt/scene/light.h"

namespace sensor_rt {

/// Part of an area light, which itself is the box from -1 to 1: u chooses a line along y, v a point of the
/// line as a share of its half length.
using LightPart = Eigen::AlignedBox2d;

/// Line of an area light along y.
struct LightLine {
  double x;
  double half_length;
  double width;  ///< dx / du
};
LightLine line_at(const Light& light, double u);

/// Height of the points of a light's plane above a surface: middle + slope · (x, y).
struct LightHeight {
  double middle;
  Eigen::Vector2d slope;

  double at(const Eigen::Vector2d& point) const { return middle + slope.dot(point); }
  double highest_in(const Eigen::AlignedBox2d& box) const {
    return at(box.center()) + 0.5 * slope.cwiseAbs().dot(box.sizes());
  }
};

/// Returns the part that consists of the lines which reach above the surface; an empty one if there is none.
LightPart part_above(const Light& light, const LightHeight& height);

/// Returns the box of x and y around a part.
Eigen::AlignedBox2d box_around(const Light& light, const LightPart& part);

/// Writes the kLightSamples quadrature points of what lies above the surface in a part of an area light.
void light_samples(const Light& light, const Rigid3& reference_from_light, const LightPart& part,
                   const LightHeight& height, LightSample* samples);

/// Returns the point in which a ray meets the bright side of an area light, with the power of the entire
/// lamp.
std::optional<LightSample> light_sample_met(const Light& light, const Rigid3& reference_from_light,
                                            const Eigen::Vector3d& origin, const Eigen::Vector3d& direction);

/// Returns the emitting area of an area light, m².
double light_area(const Light& light);

}  // namespace sensor_rt
