#include "sensor_rt/scene/mesh_shape.h"

#include <atomic>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <vector>

namespace sensor_rt {
namespace {

std::atomic<std::uint64_t> builds{0};

}  // namespace

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
  // Robust mode: no ray passes between two triangles that share an edge.
  rtcSetSceneFlags(scene.get(), RTC_SCENE_FLAG_ROBUST);
  rtcAttachGeometry(scene.get(), geometry.get());
  rtcCommitScene(scene.get());
  check_device("build a mesh");
  ++builds;
  return scene;
}

std::uint64_t tree_builds() { return builds; }

Shape make_mesh_shape(const MeshView& mesh, const ExactFaces& exact) {
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
  shape.curved = exact.curved;
  shape.curved_of_face = exact.curved_of_face;
  for (CurvedFace& face : shape.curved) {
    face.face_from_shape.translation += face.face_from_shape.rotation * centre;
  }
  shape.embree = build_triangle_scene(mesh, centre);
  return shape;
}

}  // namespace sensor_rt
