#include "fmu/model/sensing_description.h"

#include "fmu/model/json_reader.h"
#include "fmu/model/value_limits.h"

namespace robotcell {
namespace {

constexpr std::int64_t kMaxPeriodUs = 1000000;

proximity::TriangleMesh parse_mesh(const JsonReader& json) {
  json.expect_keys({"vertices", "faces"});
  proximity::TriangleMesh mesh;
  mesh.vertices = json.at("vertices").vertices();
  mesh.faces = json.at("faces").faces(mesh.vertices.size());
  if (mesh.faces.empty()) json.at("faces").fail("at least one triangle");
  return mesh;
}

std::int64_t parse_period(const JsonReader& json, std::int64_t time_step_us) {
  const std::int64_t period = json.integer(1, kMaxPeriodUs);
  if (period % time_step_us != 0) json.fail("a multiple of time_step_us");
  return period;
}

PresenceSensorDescription parse_presence(const JsonReader& json, const FrameCounts& counts,
                                         std::int64_t step_us) {
  json.expect_keys({"name", "frame", "frame_from_sensor", "size", "period_us"});
  PresenceSensorDescription sensor;
  sensor.name = json.at("name").text();
  sensor.frame = parse_frame(json.at("frame"), counts);
  sensor.frame_from_sensor = json.at("frame_from_sensor").pose();
  sensor.size = json.at("size").coordinates();
  if (!(sensor.size.minCoeff() > 0)) json.at("size").fail("three positive numbers");
  sensor.period_us = parse_period(json.at("period_us"), step_us);
  return sensor;
}

DistanceSensorDescription parse_distance(const JsonReader& json, const FrameCounts& counts,
                                         std::int64_t step_us) {
  json.expect_keys({"name", "frame", "frame_from_sensor", "lens", "nearest", "farthest", "noise",
                    "resolution", "period_us"});
  DistanceSensorDescription sensor;
  sensor.name = json.at("name").text();
  sensor.frame = parse_frame(json.at("frame"), counts);
  sensor.frame_from_sensor = json.at("frame_from_sensor").pose();
  sensor.lens = json.at("lens").coordinates();
  sensor.nearest = json.at("nearest").number(0, kMaxCoordinate);
  sensor.farthest = json.at("farthest").number(sensor.nearest, kMaxCoordinate);
  sensor.noise = json.at("noise").number(0, kMaxCoordinate);
  sensor.resolution = json.at("resolution").number(0, kMaxCoordinate);
  sensor.period_us = parse_period(json.at("period_us"), step_us);
  return sensor;
}

std::size_t body_number(const JsonReader& json, const std::vector<BodyDescription>& bodies) {
  const std::string name = json.text();
  for (std::size_t i = 0; i < bodies.size(); ++i) {
    if (bodies[i].name == name) return i;
  }
  json.fail("the name of one of the cell's bodies");
}

CollisionDescription parse_collision(const JsonReader& json, const std::vector<BodyDescription>& bodies) {
  json.expect_keys({"outputs", "stops_arm", "range", "pairs"});
  CollisionDescription collision;
  collision.outputs = json.at("outputs").boolean();
  collision.stops_arm = json.at("stops_arm").boolean();
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

SensingDescription parse_sensing(const JsonReader& cell, const FrameCounts& counts,
                                 std::int64_t time_step_us) {
  SensingDescription sensing;
  for (const JsonReader& body : cell.at("bodies").items()) {
    body.expect_keys({"name", "frame", "mesh"});
    sensing.bodies.push_back({body.at("name").text(), parse_frame(body.at("frame"), counts)});
    sensing.meshes.push_back(parse_mesh(body.at("mesh")));
  }
  for (const JsonReader& sensor : cell.at("presence_sensors").items()) {
    sensing.presence.push_back(parse_presence(sensor, counts, time_step_us));
  }
  for (const JsonReader& sensor : cell.at("distance_sensors").items()) {
    sensing.distance.push_back(parse_distance(sensor, counts, time_step_us));
  }
  sensing.collision = parse_collision(cell.at("collision"), sensing.bodies);
  return sensing;
}

}  // namespace robotcell
