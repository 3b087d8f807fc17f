#include "fmu/model/description/part_description.h"

#include "fmu/model/description/json_reader.h"
#include "fmu/model/description/value_limits.h"

namespace robotcell {
namespace {

constexpr double kMaxDampingRatio = 1e6;

SoftDescription parse_soft(const JsonReader& json) {
  json.expect_keys({"stiffness", "damping_ratio", "longest_edge"});
  return {json.at("stiffness").positive(), json.at("damping_ratio").number(0, kMaxDampingRatio),
          json.at("longest_edge").positive()};
}

}  // namespace

std::string soft_part_warning(const std::vector<PartDescription>& parts) {
  std::string names;
  for (const PartDescription& part : parts) {
    if (part.soft) names += (names.empty() ? "'" : ", '") + part.name + "'";
  }
  if (names.empty()) return names;
  return "soft parts (" + names +
         "): the collision detector for soft bodies is used; soft parts creep where rigid parts stick, do "
         "not collide with each other and are not limited by contact.points; a step takes longer";
}

PartDescription parse_part(const JsonReader& json, const FrameNumbers& frames) {
  json.expect_keys(
      {"name", "fixture", "stands_on", "support_from_part", "friction", "soft", "inertial", "hull"});
  PartDescription part;
  part.name = json.at("name").text();
  const std::string fixture = json.at("fixture").text();
  if (fixture != "clamped" && fixture != "free") json.at("fixture").fail("\"clamped\" or \"free\"");
  part.free = fixture == "free";
  part.stands_on = frames.parse(json.at("stands_on"));
  if (part.stands_on > kWorld && part.stands_on < frames.base()) json.at("stands_on").fail("no \"axis[i]\"");
  if (!part.free && part.stands_on >= frames.conveyor(0)) {
    json.at("stands_on").fail("no \"conveyor[i]\" for a clamped part (a part cannot be clamped to a belt)");
  }
  part.support_from_part = json.at("support_from_part").pose();
  part.friction = json.at("friction").number(0, kMaxFriction);
  if (!json.at("soft").is_null()) {
    part.soft = parse_soft(json.at("soft"));
    if (!part.free) json.at("soft").fail("null for a clamped part");
  }
  for (const char* key : {"inertial", "hull"}) {
    if (part.free && json.at(key).is_null()) json.at(key).fail("an object for a free part");
  }
  if (!json.at("inertial").is_null()) part.inertial = parse_inertia(json.at("inertial"));
  if (!json.at("hull").is_null()) part.hull = parse_hull(json.at("hull"));
  return part;
}

}  // namespace robotcell
