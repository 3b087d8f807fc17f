// Scene of rigid bodies that consist of meshes and exact primitives. Built once; poses are given per
// exposure.
#pragma once

#include <string>
#include <vector>

#include "sensor_rt/scene/light.h"
#include "sensor_rt/scene/mesh_shape.h"
#include "sensor_rt/scene/shape.h"

namespace sensor_rt {

/// All surfaces and lamps. Several shapes may share a body. Shapes are two-sided. Sizes in metres. All add_*
/// throw std::invalid_argument for values that are not finite, not positive or out of range. Tracing a
/// finished scene is thread-safe.
class Scene {
 public:
  /// Adds a mesh given in the body frame; rays that meet a face with an exact surface hit that surface.
  void add_mesh(const std::string& body, const MeshView& mesh, const Material& material,
                const ExactFaces& exact = {});
  /// Adds a sphere around `centre` (body frame).
  void add_sphere(const std::string& body, const Eigen::Vector3d& centre, double radius,
                  const Material& material);
  /// Adds a box with edges `size`, centred in its own frame.
  void add_box(const std::string& body, const Rigid3& body_from_box, const Eigen::Vector3d& size,
               const Material& material);
  /// Adds a capped cylinder along its own z axis, centred in its own frame.
  void add_cylinder(const std::string& body, const Rigid3& body_from_cylinder, double radius, double height,
                    const Material& material);
  /// Adds a capped cone frustum along its own z axis, centred in its own frame; one of the radii may be 0.
  void add_cone(const std::string& body, const Rigid3& body_from_cone, double bottom_radius,
                double top_radius, double height, const Material& material);
  /// Adds a cylinder along its own z axis with a concentric bore through it, centred in its own frame.
  void add_ring(const std::string& body, const Rigid3& body_from_ring, double inner_radius,
                double outer_radius, double height, const Material& material);
  /// Adds a rectangle with edges `size` in the xy plane of its own frame, centred, visible from both sides.
  void add_plane(const std::string& body, const Rigid3& body_from_plane, const Eigen::Vector2d& size,
                 const Material& material);

  /// Removes the shapes of a body, which keeps its index: shapes added under its name later replace them.
  /// Other shapes are not rebuilt. Throws std::invalid_argument for an unknown body.
  void remove_shapes(const std::string& body);

  /// Adds a lamp that moves with `body`, which may have no shapes; sets `light.body`.
  void add_light(const std::string& body, Light light);

  /// Returns the body names in the order of the poses.
  const std::vector<std::string>& bodies() const { return bodies_; }
  const std::vector<Shape>& shapes() const { return shapes_; }
  const std::vector<Light>& lights() const { return lights_; }

 private:
  void add_primitive(const std::string& body, ShapeKind kind, const Rigid3& body_from_shape,
                     const Eigen::Vector3d& half_size, const Material& material, const Frustum& frustum = {});
  void add_shape(const std::string& body, Shape shape, const Material& material);
  int body_number(const std::string& body);

  std::vector<std::string> bodies_;
  std::vector<Shape> shapes_;
  std::vector<Light> lights_;
};

}  // namespace sensor_rt
