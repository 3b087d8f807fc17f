#include "fmu/model/devices/gripper.h"

#include "fmu/model/description/json_reader.h"
#include "fmu/model/description/value_limits.h"

namespace robotcell {

Eigen::Isometry3d GripperDescription::flange_from_finger(std::size_t finger, double opening) const {
  Eigen::Isometry3d half_turn = Eigen::Isometry3d::Identity();
  if (finger == 1) half_turn.linear().diagonal() << -1, -1, 1;
  return flange_from_gripper * half_turn * Eigen::Translation3d(opening, 0, 0);
}

GripperDescription parse_gripper(const JsonReader& json) {
  json.expect_keys({"flange_from_gripper", "stroke", "finger_length", "finger_width", "finger_thickness",
                    "finger_mass", "max_force", "max_speed", "friction", "centring_stiffness", "start"});
  GripperDescription gripper;
  gripper.flange_from_gripper = json.at("flange_from_gripper").pose();
  gripper.stroke = json.at("stroke").positive();
  gripper.finger = {json.at("finger_thickness").positive(), json.at("finger_width").positive(),
                    json.at("finger_length").positive()};
  gripper.finger_mass = json.at("finger_mass").mass();
  gripper.max_force = json.at("max_force").positive();
  gripper.max_speed = json.at("max_speed").positive();
  gripper.friction = json.at("friction").number(0, kMaxFriction);
  gripper.centring_stiffness = json.at("centring_stiffness").positive();
  gripper.start = json.at("start").number(0, gripper.stroke);
  return gripper;
}

}  // namespace robotcell
