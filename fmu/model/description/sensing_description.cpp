#include "fmu/model/description/sensing_description.h"

#include "fmu/model/description/json_reader.h"

namespace robotcell {
namespace {

proximity::TriangleMesh parse_mesh(const JsonReader& json) {
  json.expect_keys({"vertices", "faces"});
  proximity::TriangleMesh mesh;
  mesh.vertices = json.at("vertices").vertices();
  mesh.faces = json.at("faces").faces(mesh.vertices.size());
  if (mesh.faces.empty()) json.at("faces").fail("at least one triangle");
  return mesh;
}

std::size_t body_number(const JsonReader& json, const std::vector<BodyDescription>& bodies) {
  const std::string name = json.text();
  for (std::size_t i = 0; i < bodies.size(); ++i) {
    if (bodies[i].name == name) return i;
  }
  json.fail("the name of one of the cell's bodies");
}

CollisionDescription parse_collision(const JsonReader& json, const std::vector<BodyDescription>& bodies) {
  json.expect_keys({"outputs", "stops_arm", "swept", "range", "pairs"});
  CollisionDescription collision;
  collision.outputs = json.at("outputs").boolean();
  collision.stops_arm = json.at("stops_arm").boolean();
  collision.swept = json.at("swept").boolean();
  collision.range = json.at("range").positive();
  for (const JsonReader& pair : json.at("pairs").items()) {
    const auto names = pair.items(2);
    const std::size_t a = body_number(names[0], bodies);
    const std::size_t b = body_number(names[1], bodies);
    if (a == b) pair.fail("two different bodies");
    collision.pairs.emplace_back(a, b);
  }
  if (collision.outputs && collision.pairs.empty()) json.at("pairs").fail("at least one pair of bodies");
  return collision;
}

}  // namespace

SensingDescription parse_sensing(const JsonReader& cell, const SensorContext& context) {
  SensingDescription sensing;
  for (const JsonReader& body : cell.at("bodies").items()) {
    body.expect_keys({"name", "frame", "mesh"});
    sensing.bodies.push_back({body.at("name").text(), context.frames.parse(body.at("frame"))});
    sensing.meshes.push_back(parse_mesh(body.at("mesh")));
  }
  for_each_sensor_kind([&](auto kind) {
    for (const JsonReader& sensor : cell.items_at(SensorKind<kind>::kKey)) {
      std::get<kind>(sensing.sensors).emplace_back(sensor, context);
    }
  });
  sensing.collision = parse_collision(cell.at("collision"), sensing.bodies);
  return sensing;
}

}  // namespace robotcell
