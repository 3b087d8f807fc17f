#include "sensor_rt/scene/mesh_shape.h"

#include <atomic>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <vector>

#include "sensor_rt/scene/face_order.h"
#include "sensor_rt/scene/flat_reach.h"

namespace sensor_rt {
namespace {

std::atomic<std::uint64_t> builds{0};

FacePlane face_plane(const MeshView& mesh, std::size_t face, const Eigen::Vector3d& centre) {
  const Eigen::Vector3d a = mesh.corner(face, 0) - centre;
  const Eigen::Vector3d b = mesh.corner(face, 1) - centre;
  const Eigen::Vector3d c = mesh.corner(face, 2) - centre;
  const Eigen::Vector3d cross = (b - a).cross(c - a);
  const double length = cross.norm();
  // A face without area keeps a zero normal: it reflects nothing.
  const Eigen::Vector3d normal = length > 0.0 ? Eigen::Vector3d(cross / length) : Eigen::Vector3d::Zero();
  return {{normal.x(), normal.y(), normal.z()}, normal.dot(a)};
}

}  // namespace

void validate_mesh(const MeshView& mesh, const std::string& what) {
  if (mesh.vertex_count == 0 || mesh.face_count == 0)
    throw std::invalid_argument(what + ": the mesh is empty");
  constexpr std::size_t kMost = std::numeric_limits<std::uint32_t>::max() / 4;
  if (mesh.vertex_count > kMost || mesh.face_count > kMost)
    throw std::invalid_argument(what + ": the mesh is too large");
  for (std::size_t i = 0; i < 3 * mesh.vertex_count; ++i) {
    if (!std::isfinite(mesh.vertices[i]) || std::abs(mesh.vertices[i]) > 1e6) {
      throw std::invalid_argument(what + ": vertex " + std::to_string(i / 3) +
                                  " is not finite or beyond 1000 km");
    }
  }
  for (std::size_t i = 0; i < 3 * mesh.face_count; ++i) {
    if (mesh.faces[i] >= mesh.vertex_count) {
      throw std::invalid_argument(what + ": face " + std::to_string(i / 3) + " names vertex " +
                                  std::to_string(mesh.faces[i]) + " of " + std::to_string(mesh.vertex_count));
    }
  }
}

Eigen::Vector3d mesh_centre(const MeshView& mesh) {
  Eigen::Vector3d low = mesh.vertex(0);
  Eigen::Vector3d high = low;
  for (std::size_t i = 1; i < mesh.vertex_count; ++i) {
    low = low.cwiseMin(mesh.vertex(i));
    high = high.cwiseMax(mesh.vertex(i));
  }
  return 0.5 * (low + high);
}

SceneHandle build_triangle_scene(const MeshView& mesh, const Eigen::Vector3d& centre) {
  const RTCDevice device = shared_device();
  const GeometryHandle geometry(rtcNewGeometry(device, RTC_GEOMETRY_TYPE_TRIANGLE));
  auto* vertices = static_cast<float*>(rtcSetNewGeometryBuffer(
      geometry.get(), RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, 3 * sizeof(float), mesh.vertex_count));
  auto* faces = static_cast<std::uint32_t*>(
      rtcSetNewGeometryBuffer(geometry.get(), RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3,
                              3 * sizeof(std::uint32_t), mesh.face_count));
  check_device("allocate a mesh");
  for (std::size_t i = 0; i < mesh.vertex_count; ++i) {
    for (int k = 0; k < 3; ++k) {
      const std::size_t at = 3 * i + static_cast<std::size_t>(k);
      vertices[at] = static_cast<float>(mesh.vertices[at] - centre[k]);
    }
  }
  std::copy_n(mesh.faces, 3 * mesh.face_count, faces);
  rtcCommitGeometry(geometry.get());

  SceneHandle scene(rtcNewScene(device));
  // Robust: no ray slips through between two triangles that share an edge.
  rtcSetSceneFlags(scene.get(), RTC_SCENE_FLAG_ROBUST);
  rtcAttachGeometry(scene.get(), geometry.get());
  rtcCommitScene(scene.get());
  check_device("build a mesh");
  ++builds;
  return scene;
}

std::uint64_t tree_builds() { return builds; }

Shape make_mesh_shape(const MeshView& mesh) {
  const Eigen::Vector3d centre = mesh_centre(mesh);
  Shape shape;
  shape.kind = ShapeKind::kMesh;
  shape.shape_from_body.translation = -centre;
  shape.planes.reserve(mesh.face_count);
  for (std::size_t face = 0; face < mesh.face_count; ++face)
    shape.planes.push_back(face_plane(mesh, face, centre));
  for (std::size_t i = 0; i < mesh.vertex_count; ++i) {
    shape.half_size = shape.half_size.cwiseMax((mesh.vertex(i) - centre).cwiseAbs());
  }
  shape.reach = flat_reach(mesh, shape.planes);
  const bool closed = is_closed(mesh);
  const bool fine = mesh.face_count >= FanTree::kFine;
  if (closed || fine) {
    const std::vector<std::uint32_t> order = order_in_space(mesh, centre);
    if (closed) shape.facing = FacingTree(mesh, centre, shape.planes, order);
    if (fine) shape.fan_tree = FanTree(mesh, centre, order);
  }
  shape.embree = build_triangle_scene(mesh, centre);
  const RTCGeometry geometry = rtcGetGeometry(shape.embree.get(), 0);
  shape.faces =
      static_cast<const std::uint32_t*>(rtcGetGeometryBufferData(geometry, RTC_BUFFER_TYPE_INDEX, 0));
  shape.vertices = static_cast<const float*>(rtcGetGeometryBufferData(geometry, RTC_BUFFER_TYPE_VERTEX, 0));
  return shape;
}

}  // namespace sensor_rt
