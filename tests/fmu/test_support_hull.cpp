// The reduced hull is a closed convex hull of original vertices with the same base.
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <set>

#include "fmu/model/world/support_hull.h"

namespace {

using Eigen::Vector3d;
using robotcell::Hull;
using robotcell::support_hull;

/// A sphere of radius 25 mm on a foot of radius 3 mm, as dense rings of vertices.
std::vector<Vector3d> ball_on_foot() {
  std::vector<Vector3d> vertices;
  for (int k = 0; k < 200; ++k) {
    const double angle = 2 * M_PI * k / 200;
    const Vector3d around(std::cos(angle), std::sin(angle), 0);
    vertices.push_back(0.003 * around);
    for (int ring = 0; ring < 40; ++ring) {
      const double polar = M_PI * (ring + 0.5) / 40;
      vertices.push_back(0.025 * std::sin(polar) * around + Vector3d(0, 0, 0.027 - 0.025 * std::cos(polar)));
    }
  }
  return vertices;
}

double volume(const Hull& hull) {
  double six_times = 0;
  for (const auto& face : hull.faces) {
    const auto at = [&](std::size_t k) { return hull.vertices[static_cast<std::size_t>(face[k])]; };
    six_times += at(0).dot(at(1).cross(at(2)));
  }
  return six_times / 6;
}

void expect_closed_and_convex(const Hull& hull) {
  std::set<std::pair<int, int>> edges;
  std::set<int> used;
  for (const auto& face : hull.faces) {
    for (std::size_t k = 0; k < 3; ++k) {
      EXPECT_TRUE(edges.insert({face[k], face[(k + 1) % 3]}).second) << "an edge twice in one direction";
      used.insert(face[k]);
    }
    const auto at = [&](std::size_t k) { return hull.vertices[static_cast<std::size_t>(face[k])]; };
    const Vector3d normal = (at(1) - at(0)).cross(at(2) - at(0)).normalized();
    for (const Vector3d& vertex : hull.vertices) EXPECT_LT(normal.dot(vertex - at(0)), 1e-6);
  }
  for (const auto& edge : edges) EXPECT_EQ(edges.count({edge.second, edge.first}), 1u);
  EXPECT_EQ(used.size() + hull.faces.size(), edges.size() / 2 + 2);  // Euler characteristic
}

TEST(SupportHull, IsSmallClosedConvexAndSimilarInVolume) {
  const auto vertices = ball_on_foot();
  const Hull hull = support_hull(vertices, Vector3d::UnitZ());
  expect_closed_and_convex(hull);
  EXPECT_LE(hull.faces.size(), 230u);
  EXPECT_GT(volume(hull), 0.9 * 4 / 3 * M_PI * std::pow(0.025, 3));
  for (const Vector3d& vertex : hull.vertices) {
    EXPECT_NE(std::find(vertices.begin(), vertices.end(), vertex), vertices.end());
  }
}

TEST(SupportHull, KeepsWholeBase) {
  const Hull hull = support_hull(ball_on_foot(), Vector3d::UnitZ());
  int corners = 0;
  for (const Vector3d& vertex : hull.vertices) corners += vertex.z() < 1e-9 ? 1 : 0;
  EXPECT_GE(corners, 8);
  // In every direction in the plane a vertex is nearly as far out as the rim of the foot.
  for (int k = 0; k < 36; ++k) {
    const Vector3d direction(std::cos(k * M_PI / 18), std::sin(k * M_PI / 18), 0);
    double reach = 0;
    for (const Vector3d& vertex : hull.vertices) {
      if (vertex.z() < 1e-9) reach = std::max(reach, vertex.dot(direction));
    }
    EXPECT_GT(reach, 0.003 * 0.97);
  }
}

TEST(SupportHull, HandlesManyCoplanarVertices) {
  std::vector<Vector3d> grid;
  for (int i = 0; i <= 10; ++i) {
    for (int j = 0; j <= 10; ++j) {
      for (int k = 0; k <= 10; ++k) grid.emplace_back(i * 0.01, j * 0.005, k * 0.002);
    }
  }
  const Hull hull = support_hull(grid, Vector3d::UnitZ());
  expect_closed_and_convex(hull);
  EXPECT_NEAR(volume(hull), 0.1 * 0.05 * 0.02, 1e-9);
}

TEST(SupportHull, RejectsVerticesWithoutVolume) {
  std::vector<Vector3d> flat;
  for (int i = 0; i < 20; ++i) flat.emplace_back(0.01 * i, 0.001 * i * i, 0);
  EXPECT_THROW(support_hull(flat, Vector3d::UnitZ()), std::invalid_argument);
  EXPECT_THROW(support_hull({}, Vector3d::UnitZ()), std::invalid_argument);
}

}  // namespace
