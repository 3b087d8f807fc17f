#include "fmu/model/part_description.h"

#include "fmu/model/json_reader.h"

namespace robotcell {
namespace {

constexpr double kHuge = 1e6;

void parse_hull(const JsonReader& json, bool collides, PartDescription& part) {
  json.expect_keys({"vertices", "faces"});
  part.hull_vertices = json.at("vertices").vectors3();
  part.hull_faces = json.at("faces").triangles(part.hull_vertices.size());
  if (collides && part.hull_faces.size() < 4) json.at("faces").fail("at least 4 faces for a free part");
}

StandsOn parse_support(const JsonReader& json, std::size_t conveyors) {
  const std::string text = json.text();
  if (text == "table") return {StandsOn::Kind::kTable, 0};
  if (text == "world") return {StandsOn::Kind::kWorld, 0};
  for (std::size_t i = 0; i < conveyors; ++i) {
    if (text == "conveyor[" + std::to_string(i + 1) + "]") return {StandsOn::Kind::kConveyor, i};
  }
  json.fail("\"table\", \"world\" or \"conveyor[i]\", i being from 1 to " + std::to_string(conveyors));
}

SoftDescription parse_soft(const JsonReader& json) {
  json.expect_keys({"stiffness", "damping_ratio", "longest_edge"});
  return {json.at("stiffness").positive(), json.at("damping_ratio").number(0, kHuge),
          json.at("longest_edge").positive()};
}

}  // namespace

std::string cost_of_soft_parts(const std::vector<PartDescription>& parts) {
  std::string names;
  for (const PartDescription& part : parts) {
    if (part.soft) names += (names.empty() ? "'" : ", '") + part.name + "'";
  }
  if (names.empty()) return names;
  return "soft parts (" + names +
         "): the collision detector for soft bodies is at work; these parts creep where a rigid one is held, "
         "do not touch each other, and are not bound by contact.points; a step takes longer";
}

PartDescription parse_part(const JsonReader& json, std::size_t conveyors) {
  json.expect_keys({"name", "fixture", "stands_on", "support_from_part", "mass", "friction", "soft", "hull",
                    "centre_of_mass", "inertia"});
  PartDescription part;
  part.name = json.at("name").text();
  const std::string fixture = json.at("fixture").text();
  if (fixture != "clamped" && fixture != "free") json.at("fixture").fail("\"clamped\" or \"free\"");
  part.free = fixture == "free";
  part.stands_on = parse_support(json.at("stands_on"), conveyors);
  if (!part.free && part.stands_on.kind == StandsOn::Kind::kConveyor) {
    json.at("stands_on").fail("\"table\" or \"world\" for a clamped part: nothing can be clamped to a belt");
  }
  part.support_from_part = json.at("support_from_part").pose();
  part.mass = json.at("mass").mass();
  part.friction = json.at("friction").number(0, kHuge);
  if (!json.at("soft").is_null()) {
    part.soft = parse_soft(json.at("soft"));
    if (!part.free) json.at("soft").fail("null for a clamped part");
  }
  part.centre_of_mass = json.at("centre_of_mass").coordinates();
  const auto rows = json.at("inertia").items(3);
  for (int i = 0; i < 3; ++i) part.inertia.row(i) = rows[static_cast<std::size_t>(i)].vector3();
  if (part.free && part.inertia.llt().info() != Eigen::Success) {
    json.at("inertia").fail("a positive definite matrix");
  }
  parse_hull(json.at("hull"), part.free, part);
  return part;
}

}  // namespace robotcell
