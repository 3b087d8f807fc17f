// Parts of area lights, for adaptive integration, and rays that meet them.
#pragma once

#include <Eigen/Dense>
#include <optional>

#include "sensor_rt/geometry/rigid3.h"
#include "sensor_rt/scene/light.h"

namespace sensor_rt {

/// Part of an area light: x and y of a rectangle, radius and azimuth of a disc, from `low` to `high`.
struct LightPart {
  Eigen::Vector2d low;
  Eigen::Vector2d high;

  /// Returns one of the four quarters.
  LightPart quarter(int number) const;
};
LightPart whole(const Light& light);

/// Returns the coordinates of a part that are nearest to given ones; azimuths are periodic.
Eigen::Vector2d nearest_in_part(const Light& light, const LightPart& part, Eigen::Vector2d at);

/// Writes the kLightSamples quadrature points of a part of an area light.
void light_samples(const Light& light, const Rigid3& reference_from_light, const LightPart& part,
                   LightSample* samples);

/// Returns the coordinates, as those of parts, of the point of an area light that is nearest to where a ray
/// towards its bright side meets its plane; none for a ray that does not.
std::optional<Eigen::Vector2d> nearest_on_light(const Light& light, const Rigid3& reference_from_light,
                                                const Eigen::Vector3d& origin,
                                                const Eigen::Vector3d& direction);

/// Returns the point of an area light at coordinates of its parts, with the power of the entire lamp.
LightSample light_sample_at(const Light& light, const Rigid3& reference_from_light,
                            const Eigen::Vector2d& at);

/// Returns the emitting area of an area light, m².
double light_area(const Light& light);

}  // namespace sensor_rt
