#include "fmu/model/world/support_hull.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <map>
#include <set>
#include <stdexcept>
#include <utility>

namespace robotcell {
namespace {

using Eigen::Vector3d;
using Points = std::vector<Vector3d>;
using Face = std::array<int, 3>;

constexpr int kDirections = 100;
constexpr int kBaseDirections = 16;
constexpr double kBaseThickness =
    1e-6;  // m: vertices within this height above the lowest one belong to the base
constexpr double kGoldenAngle = 2.399963229728653;

std::size_t extreme_point(const Points& points, const std::vector<std::size_t>& among,
                          const Vector3d& direction) {
  return *std::max_element(among.begin(), among.end(), [&](std::size_t a, std::size_t b) {
    return points[a].dot(direction) < points[b].dot(direction);
  });
}

/// Vertices that span the reduced hull, without duplicates, in their original order.
Points spanning_vertices(const Points& vertices, const Vector3d& up) {
  std::vector<std::size_t> all(vertices.size());
  for (std::size_t i = 0; i < all.size(); ++i) all[i] = i;
  std::set<std::size_t> chosen;
  for (int k = 0; k < kDirections; ++k) {
    const double z = 1 - (2 * k + 1.0) / kDirections;
    const double radius = std::sqrt(1 - z * z);
    chosen.insert(extreme_point(
        vertices, all, {radius * std::cos(kGoldenAngle * k), radius * std::sin(kGoldenAngle * k), z}));
  }
  const double lowest = vertices[extreme_point(vertices, all, -up)].dot(up);
  std::vector<std::size_t> base;
  for (const std::size_t i : all) {
    if (vertices[i].dot(up) < lowest + kBaseThickness) base.push_back(i);
  }
  const Vector3d side = up.unitOrthogonal();
  for (int k = 0; k < kBaseDirections; ++k) {
    const Eigen::AngleAxisd rotation(2 * 3.141592653589793 * k / kBaseDirections, up);
    chosen.insert(extreme_point(vertices, base, rotation * side));
  }
  Points points;
  for (const std::size_t i : chosen) points.push_back(vertices[i]);
  return points;
}

/// Deterministic perturbation of the points, so that no four are coplanar.
Points in_general_position(Points points) {
  Vector3d low = points.front(), high = points.front();
  for (const Vector3d& p : points) {
    low = low.cwiseMin(p);
    high = high.cwiseMax(p);
  }
  const double size = 1e-9 * (high - low).norm();
  double phase = 0;
  for (Vector3d& p : points) {
    for (double& coordinate : p.reshaped()) {
      phase = std::fmod(phase + 0.7548776662466927, 1.0);
      coordinate += size * (std::fmod(phase * 7919, 1.0) - 0.5);
    }
  }
  return points;
}

double height_over(const Points& p, const Face& f, const Vector3d& point) {
  const auto at = [&p](int i) -> const Vector3d& { return p[static_cast<std::size_t>(i)]; };
  return (at(f[1]) - at(f[0])).cross(at(f[2]) - at(f[0])).dot(point - at(f[0]));
}

/// Initial tetrahedron of four points that span a volume.
std::vector<Face> first_tetrahedron(const Points& p, std::array<int, 4>& corners) {
  const auto best = [&p](const auto& measure) {
    int found = 0;
    for (int i = 1; i < static_cast<int>(p.size()); ++i) {
      if (measure(p[static_cast<std::size_t>(i)]) > measure(p[static_cast<std::size_t>(found)])) found = i;
    }
    return found;
  };
  const auto at = [&p](int i) -> const Vector3d& { return p[static_cast<std::size_t>(i)]; };
  const int a = 0;
  const int b = best([&](const Vector3d& x) { return (x - at(a)).norm(); });
  const int c = best([&](const Vector3d& x) { return (x - at(a)).cross(at(b) - at(a)).norm(); });
  const int d = best([&](const Vector3d& x) { return std::abs(height_over(p, {a, b, c}, x)); });
  const double extent = (at(b) - at(a)).norm();
  if (std::abs(height_over(p, {a, b, c}, at(d))) < 1e-6 * extent * extent * extent) {
    throw std::invalid_argument("the vertices of the hull span no volume");
  }
  corners = {a, b, c, d};
  std::vector<Face> faces{{a, b, c}, {a, d, b}, {b, d, c}, {c, d, a}};
  if (height_over(p, faces[0], at(d)) > 0) {
    for (Face& face : faces) std::swap(face[1], face[2]);
  }
  return faces;
}

/// Adds a point to a hull: replaces the faces visible from it by faces between it and their outline.
void add_point(const Points& p, int point, std::vector<Face>& faces) {
  const auto seen = [&](const Face& f) { return height_over(p, f, p[static_cast<std::size_t>(point)]) > 0; };
  const auto first_seen =
      std::stable_partition(faces.begin(), faces.end(), [&](const Face& f) { return !seen(f); });
  std::map<std::pair<int, int>, bool> outline;  // boundary edges of the visible faces
  for (auto face = first_seen; face != faces.end(); ++face) {
    for (std::size_t k = 0; k < 3; ++k) {
      const int from = (*face)[k];
      const int to = (*face)[(k + 1) % 3];
      if (outline.erase({to, from}) == 0) outline[{from, to}] = true;
    }
  }
  faces.erase(first_seen, faces.end());
  for (const auto& edge : outline) faces.push_back({edge.first.first, edge.first.second, point});
}

}  // namespace

Hull support_hull(const std::vector<Vector3d>& vertices, const Vector3d& up) {
  if (vertices.size() < 4) {
    throw std::invalid_argument("a hull needs at least 4 vertices, got " + std::to_string(vertices.size()));
  }
  Hull hull;
  hull.vertices = spanning_vertices(vertices, up);
  if (hull.vertices.size() < 4) throw std::invalid_argument("the vertices of the hull span no volume");
  const Points points = in_general_position(hull.vertices);
  std::array<int, 4> corners{};
  hull.faces = first_tetrahedron(points, corners);
  for (int i = 0; i < static_cast<int>(points.size()); ++i) {
    if (std::find(corners.begin(), corners.end(), i) == corners.end()) add_point(points, i, hull.faces);
  }
  return hull;
}

}  // namespace robotcell
