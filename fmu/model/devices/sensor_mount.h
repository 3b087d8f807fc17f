// Common part of all sensors of the cell: pose, sampling times, and what they detect.
#pragma once

#include <Eigen/Geometry>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "fmu/model/description/frame_numbers.h"

namespace robotcell {

class JsonReader;

/// What the description of a sensor may refer to, and the time step.
struct SensorContext {
  FrameNumbers frames;
  std::int64_t time_step_us = 0;
};

/// The keys "name", "frame", "frame_from_sensor" and "period_us".
struct SensorMount {
  std::string name;
  std::size_t frame = kWorld;
  Eigen::Isometry3d frame_from_sensor = Eigen::Isometry3d::Identity();
  std::int64_t period_us = 0;
};

/// Reads the mount, and requires the other keys of a sensor; throws DescriptionError.
SensorMount parse_mount(const JsonReader& json, const SensorContext& context,
                        const std::vector<const char*>& other_keys);

/// The bodies of the cell at the instant of a reading, seen by one sensor.
class SensorView {
 public:
  virtual ~SensorView() = default;

  virtual Eigen::Isometry3d world_from_sensor() const = 0;
  /// s, from the start.
  virtual double time() const = 0;
  /// Standard normal number of this sensor at this instant; it depends on the seeds only.
  virtual double noise() const = 0;
  /// Whether any body intersects a box, or encloses it; `size` holds its edge lengths. Bodies in the sensor's
  /// own frame are not seen, unless that is the world.
  virtual bool body_in_box(const Eigen::Isometry3d& world_from_box, const Eigen::Vector3d& size) const = 0;
  /// Distance to the nearest surface along a ray (world, unit direction) between two distances, of the
  /// same bodies.
  virtual std::optional<double> cast_ray(const Eigen::Vector3d& origin, const Eigen::Vector3d& direction,
                                         double nearest, double farthest) const = 0;
};

}  // namespace robotcell
