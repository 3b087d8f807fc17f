#include "sensor_rt/scene/scene.h"

#include <algorithm>
#include <cmath>
#include <memory>
#include <stdexcept>
#include <utility>

namespace sensor_rt {
namespace {

void validate_exact_faces(const ExactFaces& exact, std::size_t faces, const std::string& what) {
  const auto require = [&](bool holds, const char* expected) {
    if (!holds) throw std::invalid_argument(what + ": " + expected);
  };
  require(exact.curved_of_face.empty() || exact.curved_of_face.size() == faces,
          "expected the number of an exact surface for each face, or none");
  const auto count = static_cast<std::int32_t>(exact.curved.size());
  for (const std::int32_t number : exact.curved_of_face) {
    require(number >= -1 && number < count, "the number of an exact surface is out of range");
  }
  for (const CurvedFace& face : exact.curved) {
    require(face.face_from_shape.translation.allFinite() && face.face_from_shape.rotation.allFinite(),
            "the pose of an exact surface is not finite");
    const bool is_cone = face.kind == CurvedKind::kCone;
    require(std::isfinite(face.radius) && (face.radius > 0.0 || (is_cone && face.radius == 0.0)),
            "radii of exact surfaces must be finite and positive");
    require(!is_cone || std::abs(face.second) < 1.57, "the half angle of a cone must be below 1.57 rad");
    require(face.kind != CurvedKind::kTorus || (std::isfinite(face.second) && face.second > 0.0),
            "the radius of the tube of a torus must be finite and positive");
  }
}

}  // namespace

void Scene::add_mesh(const std::string& body, const MeshView& mesh, const Material& material,
                     const ExactFaces& exact) {
  validate_material(material, "body " + body);
  validate_mesh(mesh, "body " + body);
  validate_exact_faces(exact, mesh.face_count, "body " + body);
  add_shape(body, make_mesh_shape(mesh, exact), material);
}

void Scene::add_sphere(const std::string& body, const Eigen::Vector3d& centre, double radius,
                       const Material& material) {
  Rigid3 body_from_shape;
  body_from_shape.translation = centre;
  add_primitive(body, ShapeKind::kSphere, body_from_shape, Eigen::Vector3d::Constant(radius), material);
}

void Scene::add_box(const std::string& body, const Rigid3& body_from_box, const Eigen::Vector3d& size,
                    const Material& material) {
  add_primitive(body, ShapeKind::kBox, body_from_box, 0.5 * size, material);
}

void Scene::add_cylinder(const std::string& body, const Rigid3& body_from_cylinder, double radius,
                         double height, const Material& material) {
  add_cone(body, body_from_cylinder, radius, radius, height, material);
}

void Scene::add_cone(const std::string& body, const Rigid3& body_from_cone, double bottom_radius,
                     double top_radius, double height, const Material& material) {
  if (!(bottom_radius >= 0.0 && top_radius >= 0.0)) {
    throw std::invalid_argument("body " + body + ": radii must be positive, or one of them 0");
  }
  const double largest = std::max(bottom_radius, top_radius);
  const Frustum frustum{0.5 * (bottom_radius + top_radius), (top_radius - bottom_radius) / height,
                        0.5 * height};
  add_primitive(body, ShapeKind::kFrustum, body_from_cone, {largest, largest, 0.5 * height}, material,
                frustum);
}

void Scene::add_ring(const std::string& body, const Rigid3& body_from_ring, double inner_radius,
                     double outer_radius, double height, const Material& material) {
  if (!(inner_radius > 0.0 && inner_radius < outer_radius)) {
    throw std::invalid_argument("body " + body + ": the bore must be positive and smaller than the ring");
  }
  add_primitive(body, ShapeKind::kFrustum, body_from_ring, {outer_radius, outer_radius, 0.5 * height},
                material, {outer_radius, 0.0, 0.5 * height, inner_radius});
}

void Scene::add_plane(const std::string& body, const Rigid3& body_from_plane, const Eigen::Vector2d& size,
                      const Material& material) {
  // A rectangle has no size along z; any positive value passes the check.
  add_primitive(body, ShapeKind::kRectangle, body_from_plane, {0.5 * size.x(), 0.5 * size.y(), 1e-6},
                material);
}

void Scene::add_primitive(const std::string& body, ShapeKind kind, const Rigid3& body_from_shape,
                          const Eigen::Vector3d& half_size, const Material& material,
                          const Frustum& frustum) {
  validate_material(material, "body " + body);
  if (!half_size.allFinite() || !(half_size.minCoeff() > 0.0)) {
    throw std::invalid_argument("body " + body + ": sizes must be finite and positive");
  }
  if (!body_from_shape.translation.allFinite()) {
    throw std::invalid_argument("body " + body + ": the position of a primitive is not finite");
  }
  Shape shape;
  shape.kind = kind;
  shape.half_size = half_size;
  shape.frustum = frustum;
  shape.shape_from_body = body_from_shape.inverse();
  add_shape(body, std::move(shape), material);
}

void Scene::add_shape(const std::string& body, Shape shape, const Material& material) {
  shape.body = body_number(body);
  shape.surface = make_bsdf(material);
  shape.reflectance = shape.surface->albedo(1.0);
  shape.grooves = material.grooves;
  shape.grooves.axis = shape.shape_from_body.rotation * material.grooves.axis;
  shape.grooves.centre = shape.shape_from_body * material.grooves.centre;
  shapes_.push_back(std::move(shape));
}

int Scene::body_number(const std::string& body) {
  if (body.empty()) throw std::invalid_argument("a body needs a name");
  const auto found = std::find(bodies_.begin(), bodies_.end(), body);
  const auto number = static_cast<int>(found - bodies_.begin());
  if (found == bodies_.end()) bodies_.push_back(body);
  return number;
}

void Scene::remove_shapes(const std::string& body) {
  const auto found = std::find(bodies_.begin(), bodies_.end(), body);
  if (found == bodies_.end()) throw std::invalid_argument("there is no body " + body);
  const auto number = static_cast<int>(found - bodies_.begin());
  const auto is_its = [number](const Shape& shape) { return shape.body == number; };
  shapes_.erase(std::remove_if(shapes_.begin(), shapes_.end(), is_its), shapes_.end());
}

void Scene::add_light(const std::string& body, Light light) {
  const auto require = [&](bool holds, const char* what) {
    if (!holds) throw std::invalid_argument("light " + body + ": " + what);
  };
  require(std::isfinite(light.power) && light.power >= 0.0, "power must be finite and not negative");
  require(light.body_from_light.translation.allFinite(), "its position is not finite");
  if (light.kind != LightKind::kPoint)
    require(light.size.allFinite() && light.size.minCoeff() > 0.0, "sizes must be finite and positive");
  if (light.in_band.has_value()) {
    require(*light.in_band >= 0.0 && *light.in_band <= 1.0, "in_band must lie in 0..1");
  } else {
    require(std::isfinite(light.spectrum.centre) && light.spectrum.centre > 0.0,
            "wavelength must be finite and positive");
    require(std::isfinite(light.spectrum.width) && light.spectrum.width > 0.0,
            "bandwidth must be finite and positive");
  }
  light.body = body_number(body);
  lights_.push_back(light);
}

}  // namespace sensor_rt
