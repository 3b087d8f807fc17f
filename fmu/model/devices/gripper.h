// Gripper with two parallel fingers: description, inputs, outputs and state.
#pragma once

#include <Eigen/Geometry>
#include <array>
#include <cstdint>

#include "fmu/model/fields.h"

namespace robotcell {

class JsonReader;

/// The gripper frame lies between the bases of the fingers: x along the closing direction, z towards the
/// tips. The frame of finger 1 is the gripper frame displaced along +x by half the width, so that the pad is
/// its plane x = 0; that of finger 2 is rotated about z by pi.
struct GripperDescription {
  Eigen::Isometry3d flange_from_gripper = Eigen::Isometry3d::Identity();
  double stroke = 0;                                 // m, maximum width between the pads
  Eigen::Vector3d finger = Eigen::Vector3d::Zero();  // m: thickness (x), width (y), length (z)
  double finger_mass = 0;
  double max_force = 0;           // N, of each finger
  double max_speed = 0;           // m/s, of each finger
  double friction = 0;            // of the pads
  double centring_stiffness = 0;  // N/m, for the difference of the finger positions
  double start = 0;               // m, initial width between the pads

  /// Frame of a finger (0 or 1) at a distance (m) from the middle.
  Eigen::Isometry3d flange_from_finger(std::size_t finger, double opening) const;
};

/// Throws DescriptionError.
GripperDescription parse_gripper(const JsonReader& json);

enum class GripperMode : std::int32_t { kKeep, kWidth, kForce };
inline constexpr EnumerationItem kGripperModeItems[] = {
    {"keep", "keep the last command (at the start: hold the width)"},
    {"width", "move to command.gripper.width"},
    {"force", "close with command.gripper.force"},
};
template <>
inline constexpr Enumeration enumeration_of<GripperMode> = make_enumeration("GripperMode", kGripperModeItems);

/// Force and width are clamped to the range of the gripper.
struct GripperCommand {
  std::int32_t mode = 0;
  double width = 0;  // m
  double force = 0;  // N, of each finger

  bool is(GripperMode other) const { return static_cast<GripperMode>(mode) == other; }

  template <class Visitor>
  static void declare(Visitor& visit, GripperCommand& c) {
    visit(
        c,
        choice_field<GripperMode>(c.mode, {"mode", kNone, "Gripper mode, read at the next controller cycle"}),
        field(c.width,
              bounded({"width", kMetre,
                       "Commanded distance between the pads in gripper mode 1, clamped to the stroke; the "
                       "fingers move at their maximum speed with up to their maximum force"},
                      0)),
        field(c.force,
              bounded({"force", kNewton,
                       "Commanded grip force of each finger in gripper mode 2, clamped to the maximum "
                       "force; the fingers close at their maximum speed"},
                      0)));
  }
};

struct GripperOutputs {
  double width = 0;  // m
  double force = 0;  // N
  bool gripped = false;
  std::array<double, 2> normal_force{};  // N, of each pad on the parts
  std::array<std::array<double, 3>, 2>
      contact_force{};  // N, of each pad on the parts, friction included, world axes

  template <class Visitor>
  static void declare(Visitor& visit, GripperOutputs& o) {
    visit(o,
          field(o.width, initially(Initial::kDescription,
                                   continuous({"measured.gripper.width", kMetre,
                                               "Measured distance between the pads of the two fingers"}))),
          field(o.force, {"measured.gripper.force", kNewton,
                          "Measured closing force, mean of the two finger drives; negative while opening"}),
          field(o.gripped,
                {"measured.gripper.gripped", kNone,
                 "True if the gripper holds an object: the fingers press with the commanded force and stand "
                 "still without being closed"}),
          field(o.normal_force,
                {"truth.finger[{i}].normal_force", kNewton,
                 "Normal force of the pad of finger {i} on all parts that it touches in the current "
                 "dynamics step"}),
          field(o.contact_force,
                {"truth.finger[{i}].contact_force[{k}]", kNewton,
                 "Contact force on all parts that it touches, friction included, in the current dynamics "
                 "step: {x} component, world frame, of the pad of finger {i}"}));
  }
};

/// Complete state of a gripper between two steps.
struct GripperState {
  GripperCommand command;           // active command; never kKeep
  std::array<double, 2> opening{};  // m, of each finger from the middle
  std::array<double, 2> speed{};    // m/s
  double drive_force = 0;           // N, mean closing force of the drives

  template <class Visitor>
  static void declare(Visitor& visit, GripperState& s) {
    visit(s, command_state(s.command, "command"), state(s.opening, "opening"), state(s.speed, "speed"),
          state(s.drive_force, "drive_force"));
  }
};

/// Readings of a gripper at a point of the dynamics grid.
struct GripperPoint {
  std::array<double, 2> opening{};  // m, of each finger from the middle
  GripperOutputs outputs;           // except the width, which follows from the openings

  template <class Visitor>
  static void declare(Visitor& visit, GripperPoint& p) {
    visit(p, state(p.opening, "opening"), state(p.outputs, "outputs"));
  }
};

}  // namespace robotcell
