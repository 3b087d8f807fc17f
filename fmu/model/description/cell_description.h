// Resolved description of a cell: JSON in SI units, complete (no key has a default here).
#pragma once

#include <Eigen/Geometry>
#include <array>
#include <cstdint>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include "fmu/model/cell_layout.h"
#include "fmu/model/description/contact_description.h"
#include "fmu/model/description/part_description.h"
#include "fmu/model/description/sensing_description.h"
#include "fmu/model/devices/arm_drives.h"
#include "fmu/model/devices/belt.h"
#include "fmu/model/devices/encoder.h"
#include "fmu/model/devices/gripper.h"
#include "fmu/model/devices/table.h"

namespace robotcell {

/// Error in a description; the message names the key, its value and what was expected.
class DescriptionError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

struct JointDescription {
  double a = 0, d = 0, alpha = 0, beta = 0, theta = 0;  // Rz(q + theta) T(a, 0, d) Rx(alpha) Ry(beta)
  control::AxisLimits limits;
  double start = 0;
  EncoderDescription encoder;
};

/// A further axis: what it carries turns about z of its joint, or slides along it.
struct AxisDescription {
  std::string name;
  bool slides = false;
  std::size_t moves_with = kWorld;  // frame of the world or of an axis before it
  Eigen::Isometry3d parent_from_joint, joint_from_frame;
  control::AxisLimits limits;
  double start = 0;  // rad or m
  EncoderDescription encoder;
};

/// A sensor beside that of the tool.
struct FurtherSensorDescription {
  std::size_t moves_with = kWorld;  // frame of the world, of the table, of a link or of an axis
  Eigen::Isometry3d parent_from_sensor;
};

/// Speed limits of linear moves and jogs.
struct MotionDescription {
  double line_speed = 0, line_acceleration = 0;                // m/s, m/s^2
  double angular_speed = 0, angular_acceleration = 0;          // rad/s, rad/s^2
  double jog_speed = 0, jog_acceleration = 0;                  // m/s, m/s^2
  double jog_angular_speed = 0, jog_angular_acceleration = 0;  // rad/s, rad/s^2
  double jog_joint_share = 0;                                  // fraction of each axis' maximum speed
};

struct CellDescription {
  std::string name;
  std::int64_t time_step_us = 0;
  std::int64_t controller_cycle_us = 0;
  Eigen::Vector3d gravity;
  std::int32_t seed = 0;
  std::vector<AxisDescription> axes;                                 // beside joints and table
  std::size_t robot_moves_with = kWorld, table_moves_with = kWorld;  // frames of the world or of axes
  std::optional<std::size_t> sensor_moves_with;                      // likewise; empty: the flange
  Eigen::Isometry3d world_from_base;     // with axes at 0 where one carries the arm; so of the table
  std::vector<JointDescription> joints;  // 4 to kMaxJoints
  std::vector<int> held_joints;          // numbers of the joints, from 0, that Cartesian motion keeps still
  MotionDescription motion;
  std::optional<ArmDynamicsDescription> dynamics;  // empty: kinematic drives
  Eigen::Isometry3d carrier_from_sensor;
  std::vector<FurtherSensorDescription> further_sensors;
  TableDescription table;
  std::vector<PartDescription> parts;
  std::vector<ConveyorDescription> conveyors;
  std::optional<GripperDescription> gripper;
  ContactDescription contact;
  SensingDescription sensing;
};

CellLayout layout_of(const CellDescription& cell);

/// Positions of all axes at the start, rad or m.
control::Axes start_positions(const CellDescription& cell);

/// Parses a description; throws DescriptionError.
CellDescription parse_cell(const std::string& json);

/// Whether a path, not empty, does not depend on a folder; on Windows also one with a drive or backslash.
inline bool is_absolute(const std::string& path) {
#ifdef _WIN32
  if (path.front() == '\\' || (path.size() > 1 && path[1] == ':')) return true;
#endif
  return path.front() == '/';
}

/// Content of a regular file of limited size; throws DescriptionError that names the file.
std::string read_text_file(const std::string& path);

/// The same, or the standard input for "-".
std::string read_file_or_input(const std::string& path);

}  // namespace robotcell
