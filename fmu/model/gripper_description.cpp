#include "fmu/model/gripper_description.h"

#include "fmu/model/json_reader.h"

namespace robotcell {

GripperDescription parse_gripper(const JsonReader& json) {
  json.expect_keys({"flange_from_gripper", "stroke", "finger_length", "finger_width", "finger_thickness",
                    "finger_mass", "max_force", "max_speed", "friction", "centring_stiffness", "start"});
  GripperDescription gripper;
  gripper.flange_from_gripper = json.at("flange_from_gripper").pose();
  gripper.stroke = json.at("stroke").positive();
  gripper.finger = {json.at("finger_thickness").positive(), json.at("finger_width").positive(),
                    json.at("finger_length").positive()};
  gripper.finger_mass = json.at("finger_mass").positive();
  gripper.max_force = json.at("max_force").positive();
  gripper.max_speed = json.at("max_speed").positive();
  gripper.friction = json.at("friction").number(0, 1e6);
  gripper.centring_stiffness = json.at("centring_stiffness").positive();
  gripper.start = json.at("start").number(0, gripper.stroke);
  return gripper;
}

}  // namespace robotcell
