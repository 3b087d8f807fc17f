#include "sensor_rt/fmi/profile_sensor_description.h"

#include <algorithm>
#include <array>
#include <cstdint>

#include "fmu/model/description/json_reader.h"

namespace sensor_rt {
namespace {

using robotcell::JsonReader;

Eigen::Vector2d vector2(const JsonReader& json) {
  const auto items = json.items(2);
  return {items[0].number(), items[1].number()};
}

/// A pose from the sixteen numbers of its matrix, row by row.
Rigid3 pose(const JsonReader& json) {
  const auto items = json.items(16);
  Rigid3 result;
  for (int row = 0; row < 3; ++row) {
    for (int column = 0; column < 3; ++column) {
      result.rotation(row, column) = items[static_cast<std::size_t>(4 * row + column)].number();
    }
    result.translation(row) = items[static_cast<std::size_t>(4 * row + 3)].number();
  }
  if (!(result.rotation.transpose() * result.rotation).isIdentity(1e-6) ||
      result.rotation.determinant() < 0) {
    json.fail("the matrix of a rigid transform");
  }
  return result;
}

Material material(const JsonReader& json) {
  json.expect_keys({"model", "reflectance", "roughness", "refractive_index", "roughness_along", "groove_axis",
                    "groove_centre", "scattering"});
  Material result{json.at("model").text(),
                  json.at("reflectance").number(),
                  json.at("roughness").number(),
                  json.at("refractive_index").number(),
                  json.at("roughness_along").number(),
                  {},
                  json.at("scattering").number()};
  if (!json.at("groove_axis").is_null()) result.grooves.axis = json.at("groove_axis").vector3();
  result.grooves.around = !json.at("groove_centre").is_null();
  if (result.grooves.around) result.grooves.centre = json.at("groove_centre").vector3();
  return result;
}

/// The index of a text in `choices`.
template <std::size_t n>
std::size_t choice(const JsonReader& json, const std::array<const char*, n>& choices) {
  const auto* found = std::find(choices.begin(), choices.end(), json.text());
  if (found == choices.end()) json.fail("a known name");
  return static_cast<std::size_t>(found - choices.begin());
}

void add_mesh(Scene& scene, const std::string& body, const JsonReader& json) {
  const std::vector<Eigen::Vector3d> vertices = json.at("vertices").vertices();
  if (vertices.empty()) json.at("vertices").fail("at least three vertices");
  const auto faces = json.at("faces").faces(vertices.size());
  std::vector<std::uint32_t> corners;
  corners.reserve(3 * faces.size());
  for (const auto& face : faces) {
    for (const int corner : face) corners.push_back(static_cast<std::uint32_t>(corner));
  }
  ExactFaces exact;
  constexpr std::array<const char*, 4> kKinds{"cylinder", "cone", "sphere", "torus"};
  for (const JsonReader& face : json.at("curved").items()) {
    face.expect_keys({"kind", "body_from_face", "radius", "second"});
    exact.curved.push_back({static_cast<CurvedKind>(choice(face.at("kind"), kKinds)),
                            pose(face.at("body_from_face")).inverse(), face.at("radius").number(),
                            face.at("second").number()});
  }
  const auto most = static_cast<std::int64_t>(exact.curved.size()) - 1;
  for (const JsonReader& number : json.at("curved_of_face").items()) {
    exact.curved_of_face.push_back(static_cast<std::int32_t>(number.integer(-1, most)));
  }
  scene.add_mesh(body, {vertices.front().data(), vertices.size(), corners.data(), faces.size()},
                 material(json.at("material")), exact);
}

void add_light(Scene& scene, const std::string& body, const JsonReader& json) {
  constexpr std::array<const char*, 3> kKinds{"point", "rectangle", "disc"};
  Light light;
  light.kind = static_cast<LightKind>(choice(json.at("kind"), kKinds));
  light.body_from_light = pose(json.at("body_from_light"));
  light.size = vector2(json.at("size"));
  light.power = json.at("power").number();
  if (!json.at("in_band").is_null()) light.in_band = json.at("in_band").number();
  if (!json.at("spectrum").is_null()) {
    const Eigen::Vector2d spectrum = vector2(json.at("spectrum"));
    light.spectrum = {spectrum.x(), spectrum.y()};
  }
  scene.add_light(body, light);
}

/// Adds a shape or a lamp as the function of the scene named `shape` does, whose arguments are the other
/// keys.
void add_shape(Scene& scene, const JsonReader& json) {
  const std::string shape = json.at("shape").text();
  const std::string body = json.at("name").text();
  const auto number = [&](const char* key) { return json.at(key).number(); };
  if (shape == "mesh") {
    json.expect_keys({"shape", "name", "vertices", "faces", "material", "curved", "curved_of_face"});
    add_mesh(scene, body, json);
  } else if (shape == "light") {
    json.expect_keys({"shape", "name", "kind", "body_from_light", "size", "power", "in_band", "spectrum"});
    add_light(scene, body, json);
  } else if (shape == "sphere") {
    json.expect_keys({"shape", "name", "centre", "radius", "material"});
    scene.add_sphere(body, json.at("centre").vector3(), number("radius"), material(json.at("material")));
  } else if (shape == "box") {
    json.expect_keys({"shape", "name", "body_from_box", "size", "material"});
    scene.add_box(body, pose(json.at("body_from_box")), json.at("size").vector3(),
                  material(json.at("material")));
  } else if (shape == "plane") {
    json.expect_keys({"shape", "name", "body_from_plane", "size", "material"});
    scene.add_plane(body, pose(json.at("body_from_plane")), vector2(json.at("size")),
                    material(json.at("material")));
  } else if (shape == "cylinder") {
    json.expect_keys({"shape", "name", "body_from_cylinder", "radius", "height", "material"});
    scene.add_cylinder(body, pose(json.at("body_from_cylinder")), number("radius"), number("height"),
                       material(json.at("material")));
  } else if (shape == "cone") {
    json.expect_keys(
        {"shape", "name", "body_from_cone", "bottom_radius", "top_radius", "height", "material"});
    scene.add_cone(body, pose(json.at("body_from_cone")), number("bottom_radius"), number("top_radius"),
                   number("height"), material(json.at("material")));
  } else if (shape == "ring") {
    json.expect_keys(
        {"shape", "name", "body_from_ring", "inner_radius", "outer_radius", "height", "material"});
    scene.add_ring(body, pose(json.at("body_from_ring")), number("inner_radius"), number("outer_radius"),
                   number("height"), material(json.at("material")));
  } else {
    json.at("shape").fail("mesh, light, sphere, box, plane, cylinder, cone or ring");
  }
}

/// A sensor from the object of its own description.
Sensor sensor_at(const nlohmann::json& document, const char* key) {
  return parse_sensor(document.at(key).dump());
}

}  // namespace

ProfileSensorDescription parse_profile_sensor(const std::string& text) {
  const nlohmann::json document = robotcell::parse_json(text);
  const JsonReader json(document, "");
  json.expect_keys({"format", "name", "frame", "every", "delay", "exposure", "step", "sensor", "as_built",
                    "bodies", "shapes"});
  json.at("format").integer(1, 1);
  ProfileSensorDescription result;
  result.name = json.at("name").text();
  result.frame = json.at("frame").text();
  result.every = static_cast<int>(json.at("every").integer(1, 1 << 20));
  result.delay = json.at("delay").number(-1, 1);
  if (!json.at("exposure").is_null()) result.exposure = json.at("exposure").positive();
  result.step = json.at("step").positive();
  result.sensor = sensor_at(document, "sensor");
  if (!json.at("as_built").is_null()) result.as_built = sensor_at(document, "as_built");
  for (const JsonReader& shape : json.at("shapes").items()) add_shape(result.scene, shape);
  std::vector<std::string> names;
  for (const JsonReader& body : json.at("bodies").items()) {
    body.expect_keys({"name", "frame"});
    names.push_back(body.at("name").text());
    result.frames.push_back(body.at("frame").is_null() ? "" : body.at("frame").text());
  }
  if (names != result.scene.bodies()) json.at("bodies").fail("the bodies of the shapes, in their order");
  return result;
}

}  // namespace sensor_rt
