// Penetration depth of points in convex bodies against closed forms.
#include "fmu/model/world/solid.h"

#include <gtest/gtest.h>

#include <dart/dynamics/BoxShape.hpp>
#include <dart/dynamics/CylinderShape.hpp>
#include <dart/dynamics/SphereShape.hpp>
#include <random>

#include "fmu/model/world/hull_shape.h"

namespace {

using namespace robotcell;
using Eigen::Vector3d;

const Vector3d kHalf(0.02, 0.03, 0.01);

Hull box_hull() {
  Hull hull;
  for (const double z : {-1.0, 1.0}) {
    for (const auto& [x, y] : {std::pair(-1, -1), {1, -1}, {1, 1}, {-1, 1}}) {
      hull.vertices.push_back(kHalf.cwiseProduct(Vector3d(x, y, z)));
    }
  }
  const std::array<std::array<int, 4>, 6> quads{
      {{3, 2, 1, 0}, {4, 5, 6, 7}, {0, 1, 5, 4}, {1, 2, 6, 5}, {2, 3, 7, 6}, {3, 0, 4, 7}}};
  for (const auto& q : quads) {
    hull.faces.push_back({q[0], q[1], q[2]});
    hull.faces.push_back({q[0], q[2], q[3]});
  }
  return hull;
}

TEST(Solid, BoxAndItsMeshMatchNearestFace) {
  const Solid box{dart::dynamics::BoxShape(2 * kHalf)};
  const Solid mesh(*make_mesh_shape(box_hull()).shape);
  std::mt19937 random(1);
  std::uniform_real_distribution<double> spread(-1.3, 1.3);
  for (int i = 0; i < 1000; ++i) {
    const Vector3d point = kHalf.cwiseProduct(Vector3d(spread(random), spread(random), spread(random)));
    int axis = 0;
    const double expected = (kHalf - point.cwiseAbs()).minCoeff(&axis);
    for (const Solid* solid : {&box, &mesh}) {
      const std::optional<Depth> found = solid->depth(point);
      ASSERT_EQ(found.has_value(), expected >= 0);
      if (!found) continue;
      EXPECT_NEAR(found->depth, expected, 1e-9);  // mesh vertices are in single precision
      EXPECT_NEAR(found->normal[axis], point[axis] < 0 ? -1 : 1, 1e-9);
    }
  }
}

TEST(Solid, CylinderHasLateralAndEndFaces) {
  const Solid cylinder{dart::dynamics::CylinderShape(0.1, 0.04)};
  const std::optional<Depth> under_the_top = cylinder.depth({0.03, -0.04, 0.019});
  ASSERT_TRUE(under_the_top);
  EXPECT_NEAR(under_the_top->depth, 0.001, 1e-15);
  EXPECT_EQ(under_the_top->normal, Vector3d::UnitZ());
  const std::optional<Depth> at_the_rim = cylinder.depth({0.06, -0.078, 0.0});
  ASSERT_TRUE(at_the_rim);
  EXPECT_NEAR(at_the_rim->depth, 0.1 - std::hypot(0.06, 0.078), 1e-15);
  EXPECT_LT((at_the_rim->normal - Vector3d(0.06, -0.078, 0).normalized()).norm(), 1e-12);
  EXPECT_FALSE(cylinder.depth({0.08, 0.08, 0.0}));
  EXPECT_FALSE(cylinder.depth({0.0, 0.0, 0.021}));
  EXPECT_TRUE(cylinder.depth({0.0, 0.0, 0.02}));
}

TEST(Solid, OtherShapesAreRejected) {
  EXPECT_THROW(Solid{dart::dynamics::SphereShape(1)}, std::invalid_argument);
}

}  // namespace
