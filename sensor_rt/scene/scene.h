// Bodies that move as one, made of meshes and exact primitives. Built once; poses come with every exposure.
#pragma once

#include <string>
#include <vector>

#include "sensor_rt/scene/light.h"
#include "sensor_rt/scene/mesh_shape.h"
#include "sensor_rt/scene/shape.h"

namespace sensor_rt {

/// Everything that light can meet. Several shapes may share a body. Shapes are two-sided. Sizes
/// in metres. All add_* throw std::invalid_argument for what is not finite, not
/// positive or out of range. Tracing a finished scene is safe from any number of threads.
class Scene {
 public:
  /// Mesh given in the body frame.
  void add_mesh(const std::string& body, const MeshView& mesh, const Material& material);
  /// Sphere around `centre` (body frame).
  void add_sphere(const std::string& body, const Eigen::Vector3d& centre, double radius,
                  const Material& material);
  /// Box with edges `size`, centred in its own frame.
  void add_box(const std::string& body, const Rigid3& body_from_box, const Eigen::Vector3d& size,
               const Material& material);
  /// Cylinder along its own z, capped, centred in its own frame.
  void add_cylinder(const std::string& body, const Rigid3& body_from_cylinder, double radius, double height,
                    const Material& material);
  /// Rectangle with edges `size` in the xy plane of its own frame, centred, visible from both sides.
  void add_plane(const std::string& body, const Rigid3& body_from_plane, const Eigen::Vector2d& size,
                 const Material& material);

  /// Takes away the shapes of a body, which keeps its place among the bodies: shapes added under its name
  /// next replace them. Other shapes stay as they are built. Throws std::invalid_argument for an unknown
  /// body.
  void remove_shapes(const std::string& body);

  /// A lamp that moves with `body`, which need not have shapes; `light.body` is filled in.
  void add_light(const std::string& body, Light light);

  /// Names in the order in which poses are given.
  const std::vector<std::string>& bodies() const { return bodies_; }
  const std::vector<Shape>& shapes() const { return shapes_; }
  const std::vector<Light>& lights() const { return lights_; }

 private:
  void add_primitive(const std::string& body, ShapeKind kind, const Rigid3& body_from_shape,
                     const Eigen::Vector3d& half_size, const Material& material);
  void add_shape(const std::string& body, Shape shape, const Material& material);
  int body_number(const std::string& body);

  std::vector<std::string> bodies_;
  std::vector<Shape> shapes_;
  std::vector<Light> lights_;
};

}  // namespace sensor_rt
