#include <pybind11/eigen.h>
#include <pybind11/stl.h>

#include <algorithm>
#include <cmath>
#include <iterator>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include "sensor_rt/bindings/arrays.h"
#include "sensor_rt/bindings/bindings.h"
#include "sensor_rt/scene/closest_point.h"
#include "sensor_rt/scene/pose_track.h"
#include "sensor_rt/scene/scene.h"
#include "sensor_rt/tracing/cast.h"

namespace py = pybind11;

namespace sensor_rt {
namespace {

CurvedKind to_curved_kind(const std::string& name) {
  if (name == "cylinder") return CurvedKind::kCylinder;
  if (name == "cone") return CurvedKind::kCone;
  if (name == "sphere") return CurvedKind::kSphere;
  if (name == "torus") return CurvedKind::kTorus;
  throw std::invalid_argument("an exact surface '" + name + "': expected cylinder, cone, sphere or torus");
}

/// Kind, `body_from_face`, radius and second figure of each exact surface, and the number of that of each
/// face.
using CurvedFaceTuple = std::tuple<std::string, Doubles, double, double>;

void add_mesh(Scene& scene, const std::string& body, const Doubles& vertices, const py::object& faces,
              const py::object& material, const std::vector<CurvedFaceTuple>& curved,
              const Integers<std::int32_t>& curved_of_face) {
  const MeshArrays mesh(vertices, faces);
  const Material surface = to_material(material);
  ExactFaces exact;
  for (const auto& [kind, body_from_face, radius, second] : curved) {
    exact.curved.push_back(
        {to_curved_kind(kind), to_pose(body_from_face, "body_from_face").inverse(), radius, second});
  }
  exact.curved_of_face.assign(curved_of_face.data(), curved_of_face.data() + curved_of_face.size());
  const py::gil_scoped_release release;
  scene.add_mesh(body, mesh.view(), surface, exact);
}

void add_sphere(Scene& scene, const std::string& body, const Doubles& centre, double radius,
                const py::object& material) {
  scene.add_sphere(body, to_vector3(centre, "centre"), radius, to_material(material));
}

void add_box(Scene& scene, const std::string& body, const Doubles& body_from_box, const Doubles& size,
             const py::object& material) {
  scene.add_box(body, to_pose(body_from_box, "body_from_box"), to_vector3(size, "size"),
                to_material(material));
}

void add_cylinder(Scene& scene, const std::string& body, const Doubles& body_from_cylinder, double radius,
                  double height, const py::object& material) {
  scene.add_cylinder(body, to_pose(body_from_cylinder, "body_from_cylinder"), radius, height,
                     to_material(material));
}

void add_cone(Scene& scene, const std::string& body, const Doubles& body_from_cone, double bottom_radius,
              double top_radius, double height, const py::object& material) {
  scene.add_cone(body, to_pose(body_from_cone, "body_from_cone"), bottom_radius, top_radius, height,
                 to_material(material));
}

void add_ring(Scene& scene, const std::string& body, const Doubles& body_from_ring, double inner_radius,
              double outer_radius, double height, const py::object& material) {
  scene.add_ring(body, to_pose(body_from_ring, "body_from_ring"), inner_radius, outer_radius, height,
                 to_material(material));
}

void add_plane(Scene& scene, const std::string& body, const Doubles& body_from_plane, const Doubles& size,
               const py::object& material) {
  require_shape(size, "size", {2});
  scene.add_plane(body, to_pose(body_from_plane, "body_from_plane"), {size.at(0), size.at(1)},
                  to_material(material));
}

void add_light(Scene& scene, const std::string& body, const std::string& kind, const Doubles& body_from_light,
               const Doubles& size, double power, std::optional<double> in_band,
               std::optional<std::pair<double, double>> spectrum) {
  constexpr const char* kKinds[] = {"point", "rectangle", "disc"};
  const auto* found = std::find(std::begin(kKinds), std::end(kKinds), kind);
  if (found == std::end(kKinds))
    throw std::invalid_argument("kind: expected point, rectangle or disc, got " + kind);
  if (in_band.has_value() == spectrum.has_value())
    throw std::invalid_argument("light " + body + ": give either in_band or spectrum");
  require_shape(size, "size", {2});
  Light light;
  light.kind = static_cast<LightKind>(found - std::begin(kKinds));
  light.body_from_light = to_pose(body_from_light, "body_from_light");
  light.size = {size.at(0), size.at(1)};
  light.power = power;
  light.in_band = in_band;
  if (spectrum.has_value()) light.spectrum = {spectrum->first, spectrum->second};
  scene.add_light(body, light);
}

std::vector<Rigid3> to_poses(const Doubles& matrices, const char* name) {
  std::vector<Rigid3> poses(static_cast<std::size_t>(matrices.size() / 16));
  for (std::size_t i = 0; i < poses.size(); ++i) poses[i] = to_pose(matrices.data() + 16 * i, name);
  return poses;
}

std::unique_ptr<Exposures> make_exposures(const Doubles& world_from_sensor, const Doubles& world_from_body,
                                          const Doubles& duration,
                                          const py::array_t<std::int64_t, py::array::c_style>& index) {
  require_shape(world_from_sensor, "world_from_sensor", {-1, -1, 4, 4});
  const py::ssize_t count = world_from_sensor.shape(0);
  const py::ssize_t samples = world_from_sensor.shape(1);
  require_shape(world_from_body, "world_from_body", {count, -1, samples, 4, 4});
  require_shape(duration, "duration", {count});
  require_shape(index, "index", {count});
  if (count > 0 && samples == 0)
    throw std::invalid_argument("world_from_sensor: an exposure needs at least one pose");
  auto exposures = std::make_unique<Exposures>();
  exposures->count = static_cast<std::size_t>(count);
  exposures->samples = static_cast<std::size_t>(samples);
  exposures->bodies = static_cast<std::size_t>(world_from_body.shape(1));
  exposures->world_from_sensor = to_poses(world_from_sensor, "world_from_sensor");
  exposures->world_from_body = to_poses(world_from_body, "world_from_body");
  exposures->duration.assign(duration.data(), duration.data() + count);
  exposures->index.assign(index.data(), index.data() + count);
  for (const double seconds : exposures->duration) {
    if (!std::isfinite(seconds) || !(seconds > 0.0))
      throw std::invalid_argument("duration: must be finite and positive");
  }
  return exposures;
}

/// Arguments of a query of many rays.
struct RayQuery {
  std::vector<Rigid3> world_from_body;
  py::ssize_t count;

  RayQuery(const Doubles& matrices, const char* origins_name, const Doubles& origins, const char* ends_name,
           const Doubles& ends)
      : count(origins.ndim() > 0 ? origins.shape(0) : 0) {
    require_shape(matrices, "world_from_body", {-1, 4, 4});
    require_shape(origins, origins_name, {-1, 3});
    require_shape(ends, ends_name, {count, 3});
    world_from_body = to_poses(matrices, "world_from_body");
  }
};

py::tuple py_cast_rays(const Scene& scene, const Doubles& world_from_body, const Doubles& origins,
                       const Doubles& directions, unsigned threads) {
  const RayQuery query(world_from_body, "origins", origins, "directions", directions);
  const py::ssize_t count = query.count;
  CastResult result = without_gil([&] {
    return cast_rays(scene, query.world_from_body, origins.data(), directions.data(),
                     static_cast<std::size_t>(count), threads);
  });
  return py::make_tuple(to_array(std::move(result.distance), {count}),
                        to_array(std::move(result.body), {count}), to_array(std::move(result.face), {count}));
}

py::array py_occluded(const Scene& scene, const Doubles& world_from_body, const Doubles& starts,
                      const Doubles& ends, unsigned threads) {
  const RayQuery query(world_from_body, "starts", starts, "ends", ends);
  const auto count = static_cast<std::size_t>(query.count);
  const auto trace = [&] {
    return occluded(scene, query.world_from_body, starts.data(), ends.data(), count, threads);
  };
  return to_array(without_gil(trace), {query.count}).view("bool");
}

std::unique_ptr<MeshSurface> make_surface(const Doubles& vertices, const py::object& faces) {
  const MeshArrays mesh(vertices, faces);
  const py::gil_scoped_release release;
  return std::make_unique<MeshSurface>(mesh.view());
}

/// Returns the closest points (if requested), signed distance and face of each point.
py::tuple query_surface(const MeshSurface& surface, const Doubles& points, unsigned threads,
                        bool with_points) {
  require_shape(points, "points", {-1, 3});
  const py::ssize_t count = points.shape(0);
  const auto n = static_cast<std::size_t>(count);
  LargeVector<double> closest(with_points ? 3 * n : 0);
  LargeVector<std::uint32_t> face(n);
  LargeVector<double> distance(n);
  {
    const py::gil_scoped_release release;
    surface.closest_points(points.data(), n, threads,
                           {with_points ? closest.data() : nullptr, face.data(), distance.data()});
  }
  const py::array_t<double> signed_distance = to_array(std::move(distance), {count});
  const py::array_t<std::uint32_t> faces = to_array(std::move(face), {count});
  if (!with_points) return py::make_tuple(signed_distance, faces);
  return py::make_tuple(to_array(std::move(closest), {count, py::ssize_t{3}}), faces, signed_distance);
}

py::tuple py_closest_points(const Doubles& vertices, const py::object& faces, const Doubles& points,
                            unsigned threads) {
  return query_surface(*make_surface(vertices, faces), points, threads, true);
}

py::tuple py_signed_distances(const MeshSurface& surface, const Doubles& points, unsigned threads) {
  return query_surface(surface, points, threads, false);
}

py::tuple py_triangle_distances(const MeshSurface& surface, const Doubles& triangles, bool is_signed,
                                unsigned threads) {
  require_shape(triangles, "triangles", {-1, 3, 3});
  const py::ssize_t count = triangles.shape(0);
  const auto n = static_cast<std::size_t>(count);
  LargeVector<double> centre(n);
  LargeVector<double> bound(n);
  {
    const py::gil_scoped_release release;
    surface.triangle_distances(triangles.data(), n, threads, is_signed, centre.data(), bound.data());
  }
  return py::make_tuple(to_array(std::move(centre), {count}), to_array(std::move(bound), {count}));
}

}  // namespace

void bind_scene(py::module_& module) {
  py::class_<Scene>(module, "Scene", py::module_local())
      .def(py::init<>())
      .def("add_mesh", &add_mesh, py::arg("name"), py::arg("vertices"), py::arg("faces"), py::arg("material"),
           py::arg("curved") = std::vector<CurvedFaceTuple>(),
           py::arg("curved_of_face") = Integers<std::int32_t>(0))
      .def("add_sphere", &add_sphere, py::arg("name"), py::arg("centre"), py::arg("radius"),
           py::arg("material"))
      .def("add_box", &add_box, py::arg("name"), py::arg("body_from_box"), py::arg("size"),
           py::arg("material"))
      .def("add_cylinder", &add_cylinder, py::arg("name"), py::arg("body_from_cylinder"), py::arg("radius"),
           py::arg("height"), py::arg("material"))
      .def("add_cone", &add_cone, py::arg("name"), py::arg("body_from_cone"), py::arg("bottom_radius"),
           py::arg("top_radius"), py::arg("height"), py::arg("material"))
      .def("add_ring", &add_ring, py::arg("name"), py::arg("body_from_ring"), py::arg("inner_radius"),
           py::arg("outer_radius"), py::arg("height"), py::arg("material"))
      .def("add_plane", &add_plane, py::arg("name"), py::arg("body_from_plane"), py::arg("size"),
           py::arg("material"))
      .def("add_light", &add_light, py::arg("name"), py::arg("kind"), py::arg("body_from_light"),
           py::arg("size"), py::arg("power"), py::arg("in_band") = py::none(),
           py::arg("spectrum") = py::none())
      .def("remove_shapes", &Scene::remove_shapes, py::arg("name"))
      .def_property_readonly("bodies", &Scene::bodies);

  py::class_<Exposures>(module, "Exposures", py::module_local())
      .def(py::init(&make_exposures), py::arg("world_from_sensor"), py::arg("world_from_body"),
           py::arg("duration"), py::arg("index"))
      .def("__len__", [](const Exposures& e) { return e.count; })
      .def_readonly("samples", &Exposures::samples)
      .def_readonly("bodies", &Exposures::bodies);

  py::class_<MeshSurface>(module, "MeshSurface", py::module_local())
      .def(py::init(&make_surface), py::arg("vertices"), py::arg("faces"))
      .def("signed_distances", &py_signed_distances, py::arg("points"), py::arg("threads") = 0)
      .def("triangle_distances", &py_triangle_distances, py::arg("triangles"), py::arg("is_signed"),
           py::arg("threads") = 0);

  module.def("tree_builds", &tree_builds);
  module.def("cast_rays", &py_cast_rays, py::arg("scene"), py::arg("world_from_body"), py::arg("origins"),
             py::arg("directions"), py::arg("threads") = 0);
  module.def("occluded", &py_occluded, py::arg("scene"), py::arg("world_from_body"), py::arg("starts"),
             py::arg("ends"), py::arg("threads") = 0);
  module.def("closest_points", &py_closest_points, py::arg("vertices"), py::arg("faces"), py::arg("points"),
             py::arg("threads") = 0);
}

}  // namespace sensor_rt
