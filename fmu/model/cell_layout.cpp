#include "fmu/model/cell_layout.h"

namespace robotcell {
namespace {

void compare(std::string& text, const char* what, std::size_t count, std::size_t expected) {
  if (count == expected) return;
  text += (text.empty() ? "" : ", ") + std::to_string(count) + " " + what + " instead of " +
          std::to_string(expected);
}

}  // namespace

std::string difference(const CellLayout& layout, const CellLayout& expected) {
  std::string text;
  compare(text, "joints", layout.joints.size(), expected.joints.size());
  for (std::size_t i = 0; i < std::min(layout.joints.size(), expected.joints.size()); ++i) {
    if (layout.joints[i].parallel_to_next == expected.joints[i].parallel_to_next) continue;
    text += (text.empty() ? "" : ", ") + std::string("the axis of joint ") + std::to_string(i + 1) +
            (layout.joints[i].parallel_to_next ? " parallel" : " not parallel") + " to the next one";
  }
  compare(text, "further axes", layout.axes.size(), expected.axes.size());
  for (std::size_t i = 0; i < std::min(layout.axes.size(), expected.axes.size()); ++i) {
    if (layout.axes[i] == expected.axes[i]) continue;
    const auto kind = [](const AxisLayout& axis) {
      return std::string(axis.slides ? " that slides" : " that turns") + " on frame " +
             std::to_string(axis.moves_with);
    };
    text += (text.empty() ? "axis '" : ", axis '") + layout.axes[i].name + "'" + kind(layout.axes[i]) +
            " instead of '" + expected.axes[i].name + "'" + kind(expected.axes[i]);
  }
  if (layout.robot_moves_with != expected.robot_moves_with ||
      layout.table_moves_with != expected.table_moves_with) {
    text += (text.empty() ? "" : ", ") + std::string("arm or table on another axis");
  }
  if (layout.sensor_moves_with != expected.sensor_moves_with) {
    text += (text.empty() ? "" : ", ") + std::string("the sensor on another body or axis");
  }
  compare(text, "further sensors", layout.further_sensors.size(), expected.further_sensors.size());
  for (std::size_t i = 0; i < std::min(layout.further_sensors.size(), expected.further_sensors.size()); ++i) {
    if (layout.further_sensors[i] == expected.further_sensors[i]) continue;
    text += (text.empty() ? "sensor[" : ", sensor[") + std::to_string(i + 2) + "] on another frame";
  }
  compare(text, "parts", layout.parts.size(), expected.parts.size());
  compare(text, "conveyors", layout.conveyors, expected.conveyors);
  compare(text, "grippers", layout.gripper ? 1 : 0, expected.gripper ? 1 : 0);
  for_each_sensor_kind([&](auto kind) {
    const std::string devices = SensorKind<kind>::kName + std::string("s");
    compare(text, devices.c_str(), layout.sensors[kind], expected.sensors[kind]);
  });
  if (layout.collision_outputs != expected.collision_outputs) {
    text +=
        (text.empty() ? "" : ", ") + std::string(layout.collision_outputs ? "" : "no ") + "collision outputs";
  } else if (layout.bodies != expected.bodies) {
    text += (text.empty() ? "" : ", ") + std::string("other bodies in the collision outputs");
  }
  if (layout.dynamic_drives != expected.dynamic_drives) {
    text += (text.empty() ? "" : ", ") + std::string(layout.dynamic_drives
                                                         ? "dynamic drives instead of kinematic ones"
                                                         : "kinematic drives instead of dynamic ones");
  }
  for (std::size_t i = 0; i < std::min(layout.parts.size(), expected.parts.size()); ++i) {
    if (layout.parts[i] == expected.parts[i]) continue;
    text += (text.empty() ? "part[" : ", part[") + std::to_string(i + 1) + "] on another support";
  }
  return text;
}

}  // namespace robotcell
