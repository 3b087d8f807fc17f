#include "sensor_rt/scene/mesh_shape.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <vector>

namespace sensor_rt {
namespace {

std::atomic<std::uint64_t> builds{0};

constexpr double kShellMargin = 1.1;    // of the depth of triangles below a convex surface
constexpr double kLongestShift = 4.0;   // of this depth, at sharp edges
constexpr double kSameDirection = 0.7;  // cosine between normals of faces that continue each other
constexpr double kIndependent = 1e-3;   // share of the largest eigenvalue

/// Returns how far the triangle of a curved face lies below its convex surface, m; 0 for a concave one.
double depth_below(const MeshView& mesh, std::size_t face, const CurvedFace& curved,
                   const Eigen::Vector3d& outward) {
  const Eigen::Vector3d a = mesh.corner(face, 0);
  const Eigen::Vector3d b = mesh.corner(face, 1);
  const Eigen::Vector3d c = mesh.corner(face, 2);
  double depth = 0.0;
  for (const Eigen::Vector3d& point : {Eigen::Vector3d((a + b) / 2), Eigen::Vector3d((b + c) / 2),
                                       Eigen::Vector3d((c + a) / 2), Eigen::Vector3d((a + b + c) / 3)}) {
    Eigen::Vector3d gradient;
    const double distance = curved.distance(point, gradient);
    depth = std::max(depth, gradient.dot(outward) < 0.0 ? distance : -distance);
  }
  return depth;
}

/// Returns the vertices, (count, 3) row-major, of triangles that enclose the exact surfaces of convex faces:
/// a ray that meets such a surface meets them before, also where it grazes the contour. Vertices move out of
/// curved faces, but along the flat ones.
std::vector<double> enclosing_vertices(const MeshView& mesh, const ExactFaces& exact) {
  struct Corner {
    double depth = 0.0;
    std::vector<Eigen::Vector3d> curved;  // normals of the exact surfaces
    std::vector<Eigen::Vector3d> flat;    // normals of other triangles
  };
  std::vector<Corner> corners(mesh.vertex_count);
  for (std::size_t face = 0; face < mesh.face_count; ++face) {
    const FacePlane plane = face_plane(mesh, face, Eigen::Vector3d::Zero());
    const Eigen::Vector3d outward(plane.normal[0], plane.normal[1], plane.normal[2]);
    const std::int32_t number = exact.curved_of_face[face];
    const CurvedFace* curved = number < 0 ? nullptr : &exact.curved[static_cast<std::size_t>(number)];
    const double depth = curved ? depth_below(mesh, face, *curved, outward) : 0.0;
    for (int k = 0; k < 3; ++k) {
      Corner& corner = corners[mesh.faces[3 * face + static_cast<std::size_t>(k)]];
      corner.depth = std::max(corner.depth, depth);
      Eigen::Vector3d normal = outward;
      if (curved) {
        curved->distance(mesh.corner(face, k), normal);
        if (normal.dot(outward) < 0.0) normal = -normal;
      }
      (curved ? corner.curved : corner.flat).push_back(normal);
    }
  }
  std::vector<double> moved(mesh.vertices, mesh.vertices + 3 * mesh.vertex_count);
  for (std::size_t v = 0; v < mesh.vertex_count; ++v) {
    const Corner& corner = corners[v];
    if (!(corner.depth > 0.0)) continue;
    Eigen::Matrix3d squares = Eigen::Matrix3d::Zero();
    Eigen::Vector3d sum = Eigen::Vector3d::Zero();
    for (const Eigen::Vector3d& normal : corner.curved) {
      squares += normal * normal.transpose();
      sum += normal;
    }
    for (const Eigen::Vector3d& normal : corner.flat) {
      const bool continues =
          std::any_of(corner.curved.begin(), corner.curved.end(),
                      [&](const Eigen::Vector3d& other) { return normal.dot(other) > kSameDirection; });
      if (!continues) squares += normal * normal.transpose();
    }
    // Least squares, of least length where the normals do not span the space.
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(squares);
    Eigen::Vector3d shift = Eigen::Vector3d::Zero();
    for (int k = 0; k < 3; ++k) {
      const double value = solver.eigenvalues()[k];
      const Eigen::Vector3d along = solver.eigenvectors().col(k);
      if (value > kIndependent * solver.eigenvalues()[2]) shift += along.dot(sum) / value * along;
    }
    if (shift.norm() > kLongestShift) shift *= kLongestShift / shift.norm();
    for (int k = 0; k < 3; ++k) {
      moved[3 * v + static_cast<std::size_t>(k)] += kShellMargin * corner.depth * shift[k];
    }
  }
  return moved;
}

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
  std::vector<double> enclosing;
  MeshView searched = mesh;
  if (!exact.curved_of_face.empty()) {
    enclosing = enclosing_vertices(mesh, exact);
    searched.vertices = enclosing.data();
  }
  for (std::size_t i = 0; i < mesh.vertex_count; ++i) {
    shape.half_size = shape.half_size.cwiseMax((searched.vertex(i) - centre).cwiseAbs());
  }
  shape.curved = exact.curved;
  shape.curved_of_face = exact.curved_of_face;
  for (CurvedFace& face : shape.curved) {
    face.face_from_shape.translation += face.face_from_shape.rotation * centre;
  }
  shape.embree = build_triangle_scene(searched, centre);
  return shape;
}

}  // namespace sensor_rt
