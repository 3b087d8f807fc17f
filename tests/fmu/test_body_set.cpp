// Ray casts, box overlap, collisions and distances of bodies against closed forms.
#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "fmu/proximity/body_set.h"
#include "fmu/proximity/pair_monitor.h"
#include "tests/fmu/box_mesh.h"

namespace robotcell::proximity {
namespace {

using Eigen::Isometry3d;
using Eigen::Vector3d;

Isometry3d at(double x, double y, double z, double rotation = 0) {
  return Eigen::Translation3d(x, y, z) * Eigen::AngleAxisd(rotation, Vector3d(1, 2, 3).normalized());
}

TEST(BodySet, RayHitsNearestSelectedFace) {
  BodySet bodies({box(0.2, 0.2, 0.2), box(0.4, 0.4, 0.1)});
  bodies.set_pose(0, at(0, 0, 1));
  bodies.set_pose(1, at(0, 0, 2));
  const Vector3d up = Vector3d::UnitZ();
  const auto both = bodies.cast_ray({0.03, 0.02, 0}, up, 0, 10, {true, true});
  ASSERT_TRUE(both);
  EXPECT_EQ(both->body, 0u);
  EXPECT_NEAR(both->distance, 0.9, 1e-15);
  EXPECT_NEAR(bodies.cast_ray({0.03, 0.02, 0}, up, 0, 10, {false, true})->distance, 1.95, 1e-15);
  EXPECT_NEAR(bodies.cast_ray({0.03, 0.02, 0}, up, 0.95, 10, {true, true})->distance, 1.1,
              1e-15);  // from inside
  EXPECT_FALSE(bodies.cast_ray({0.3, 0, 0}, up, 0, 10, {true, true}));
  EXPECT_FALSE(bodies.cast_ray({0, 0, 0}, up, 0, 0.5, {true, true}));
}

TEST(BodySet, RayDistanceToRotatedPlaneMatchesClosedForm) {
  BodySet bodies({box(2, 2, 0.1)});
  const Isometry3d pose = at(0.1, -0.2, 1.5, 0.6);
  bodies.set_pose(0, pose);
  std::mt19937 random(1);
  std::uniform_real_distribution<double> uniform(-0.2, 0.2);
  for (int i = 0; i < 100; ++i) {
    const Vector3d direction = Vector3d(uniform(random), uniform(random), 1).normalized();
    // The near face is at -0.05 along the body's z axis, or at +0.05 where z points towards the ray.
    const Vector3d normal = pose.linear().col(2);
    const double side = normal.dot(direction) > 0 ? -0.05 : 0.05;
    const double expected = (normal.dot(pose.translation()) + side) / normal.dot(direction);
    const auto hit = bodies.cast_ray(Vector3d::Zero(), direction, 0, 10, {true});
    ASSERT_TRUE(hit);
    EXPECT_NEAR(hit->distance, expected, 1e-13);
  }
}

TEST(BodySet, BodyIntersectsBoxFromEverySideAndSize) {
  for (const double size : {0.01, 0.1, 3.0}) {
    BodySet bodies({box(size, size, size)});
    const Vector3d volume(0.2, 0.1, 0.05);
    for (int axis = 0; axis < 3; ++axis) {
      for (const double sign : {-1.0, 1.0}) {
        const double limit = (size + volume[axis]) / 2;
        Vector3d translation = Vector3d::Zero();
        translation[axis] = sign * (limit - 1e-6);
        bodies.set_pose(0, at(translation.x(), translation.y(), translation.z()));
        EXPECT_TRUE(bodies.intersects_box(0, Isometry3d::Identity(), volume));
        translation[axis] = sign * (limit + 1e-6);
        bodies.set_pose(0, at(translation.x(), translation.y(), translation.z()));
        EXPECT_FALSE(bodies.intersects_box(0, Isometry3d::Identity(), volume));
      }
    }
    bodies.set_pose(0, Isometry3d::Identity());  // one inside the other, in either order
    EXPECT_TRUE(bodies.intersects_box(0, Isometry3d::Identity(), volume));
  }
}

TEST(BodySet, CavityOfABodyIsOutside) {
  // Four walls around a shaft, whose middle is inside the convex hull but outside the body.
  TriangleMesh walls;
  for (const auto& [x, y, dx, dy] : {std::array{0.1, 0.0, 0.02, 0.22}, std::array{-0.1, 0.0, 0.02, 0.22},
                                     std::array{0.0, 0.1, 0.18, 0.02}, std::array{0.0, -0.1, 0.18, 0.02}}) {
    const TriangleMesh wall = box(dx, dy, 0.2);
    const int first = static_cast<int>(walls.vertices.size());
    for (const Vector3d& vertex : wall.vertices) walls.vertices.push_back(vertex + Vector3d(x, y, 0));
    for (const auto& face : wall.faces) {
      walls.faces.push_back({face[0] + first, face[1] + first, face[2] + first});
    }
  }
  BodySet bodies({walls});
  EXPECT_FALSE(bodies.intersects_box(0, Isometry3d::Identity(), {0.05, 0.05, 0.05}));
  EXPECT_TRUE(bodies.intersects_box(0, Isometry3d::Identity(), {0.19, 0.05, 0.05}));
}

TEST(BodySet, OnlyAnEqualMeshIsTakenFromAnotherSet) {
  const Vector3d up = Vector3d::UnitZ();
  const TriangleMesh cube = box(0.2, 0.2, 0.2);
  TriangleMesh open = cube;
  open.faces.erase(open.faces.begin(), open.faces.begin() + 2);  // the bottom
  const BodySet known({cube});
  const BodySet bodies({cube, box(0.2, 0.2, 0.1), open}, &known);  // equal, other vertices, other faces
  const auto distance = [&](std::vector<bool> body) {
    return bodies.cast_ray({0.03, 0.02, -1}, up, 0, 10, body)->distance;
  };
  EXPECT_NEAR(distance({true, false, false}), 0.9, 1e-15);
  EXPECT_NEAR(distance({false, true, false}), 0.95, 1e-15);
  EXPECT_NEAR(distance({false, false, true}), 1.1, 1e-15);
}

TEST(PairMonitor, BoxDistanceIsExactBelowBound) {
  BodySet bodies({box(0.1, 0.1, 0.1), box(0.1, 0.1, 0.1), box(0.1, 0.1, 0.1)});
  PairMonitor watch({{0, 1}, {0, 2}, {1, 2}});
  bodies.set_pose(1, at(0.13, 0, 0));
  bodies.set_pose(2, at(0, 0.12, 0));
  for (const std::size_t pair : {0u, 1u, 2u}) {
    const Nearest last{pair, {3, 5}, 0};
    const auto nearest = watch.nearest(bodies, 0.05, last);
    ASSERT_TRUE(nearest);
    EXPECT_EQ(nearest->pair, 1u);
    EXPECT_NEAR(nearest->distance, 0.02, 1e-12);
    EXPECT_FALSE(watch.nearest(bodies, 0.0199, last));
  }
}

/// A monitor with cached bounds gives the same results as a new one.
TEST(PairMonitor, CachedBoundsDoNotChangeResult) {
  BodySet bodies({box(0.1, 0.1, 0.1), box(0.2, 0.05, 0.1), box(0.05, 0.1, 0.3), box(0.3, 0.3, 0.01)});
  const std::vector<PairMonitor::Pair> pairs{{0, 1}, {0, 2}, {1, 2}, {0, 3}, {1, 3}};
  PairMonitor all_along(pairs);
  std::optional<Nearest> last;
  std::size_t changes = 0;
  for (int k = 0; k < 2000; ++k) {
    const double t = 0.004 * k;
    bodies.set_pose(1, at(0.25 + 0.1 * std::sin(t), 0.05 * std::cos(3 * t), 0) *
                           Eigen::AngleAxisd(t, Vector3d(1, 2, 3).normalized()));
    bodies.set_pose(2, at(0.1 * std::sin(2 * t), 0.25 + 0.1 * std::cos(t), 0) *
                           Eigen::AngleAxisd(2 * t, Vector3d::UnitY()));
    bodies.set_pose(3, at(0, 0, -0.2 - 0.1 * std::cos(0.7 * t)));
    const auto found = all_along.nearest(bodies, 0.1, last);
    const auto fresh = PairMonitor(pairs).nearest(bodies, 0.1, last);
    ASSERT_EQ(found.has_value(), fresh.has_value()) << k;
    if (found) {
      ASSERT_EQ(found->distance, fresh->distance) << k;
      ASSERT_EQ(found->pair, fresh->pair) << k;
      ASSERT_EQ(found->faces, fresh->faces) << k;
      changes += last && last->pair != found->pair ? 1 : 0;
    }
    last = found;
  }
  EXPECT_GT(changes, 3u);
}

/// Pieces of several meshes as one mesh.
TriangleMesh joined(const std::vector<std::pair<TriangleMesh, Vector3d>>& pieces) {
  TriangleMesh all;
  for (const auto& [piece, place] : pieces) {
    const int first = static_cast<int>(all.vertices.size());
    for (const Vector3d& vertex : piece.vertices) all.vertices.push_back(vertex + place);
    for (const auto& face : piece.faces) {
      all.faces.push_back({face[0] + first, face[1] + first, face[2] + first});
    }
  }
  return all;
}

TEST(PairMonitor, EnclosedBodyCollidesAtAnyDistanceFromTheSurface) {
  const TriangleMesh small = box(0.02, 0.02, 0.02), large = box(1, 1, 1);
  TriangleMesh open = large;
  open.faces.resize(10);
  const TriangleMesh hollow = joined({{large, Vector3d::Zero()}, {box(0.9, 0.9, 0.9), Vector3d::Zero()}});
  const TriangleMesh pieces = joined({{small, Vector3d::Zero()}, {small, Vector3d(2, 0, 0)}});
  const std::array<TriangleMesh, 4> outer{large, open, hollow, large}, inner{small, small, small, pieces};
  const std::array<bool, 4> encloses{true, false, false, true};
  for (std::size_t i = 0; i < 4; ++i) {
    for (const bool swapped : {false, true}) {
      BodySet bodies(swapped ? std::vector{inner[i], outer[i]} : std::vector{outer[i], inner[i]});
      PairMonitor watch({{0, 1}});
      for (const double x : {0.0, 0.001, 0.2, 0.3, 0.1}) {  // with what earlier searches established
        bodies.set_pose(swapped ? 0 : 1, at(x, 0.01, 0));
        const auto found = watch.collisions(bodies);
        ASSERT_EQ(found.size(), encloses[i] ? 1u : 0u) << i << " at " << x;
        watch.nearest(bodies, 1, std::nullopt);
        if (found.empty()) continue;
        EXPECT_NEAR(found[0].depth, 0.5 - std::max(x - 0.01, 0.0), 0.0201);
      }
      bodies.set_pose(swapped ? 0 : 1, at(0, 3, 0));
      EXPECT_TRUE(watch.collisions(bodies).empty());
    }
  }
}

/// Poses of a body on its way, at any fraction.
struct Step {
  Isometry3d from, to;

  Isometry3d at(double fraction) const {
    const Eigen::AngleAxisd turn(to.linear() * from.linear().transpose());
    Isometry3d pose;
    pose.linear() = Eigen::AngleAxisd(fraction * turn.angle(), turn.axis()) * from.linear();
    pose.translation() = (1 - fraction) * from.translation() + fraction * to.translation();
    return pose;
  }
};

TEST(PairMonitor, BodiesThatPassEachOtherCollide) {
  const double thickness = 0.0005;
  BodySet bodies({box(0.1, 0.1, thickness), box(0.1, 0.1, thickness), box(0.1, 0.1, thickness)});
  const std::vector<PairMonitor::Pair> pairs{{0, 1}, {0, 2}};
  PairMonitor watch(pairs);
  for (const double gap : {-0.002, -0.0001, 0.0001, 0.002}) {  // how far the plates pass beside each other
    const std::vector<Isometry3d> before{at(0, 0, 0), at(0.1 + gap, 0, -0.008), at(0, 0.5, 0)};
    for (std::size_t i = 0; i < 3; ++i) bodies.set_pose(i, before[i]);
    watch.begin(bodies);
    EXPECT_TRUE(watch.collisions(bodies).empty());
    bodies.set_pose(1, at(0.1 + gap, 0, 0.0083));
    EXPECT_TRUE(watch.collisions(bodies).empty());
    const auto found = watch.follow(bodies, {false, false});
    ASSERT_EQ(found.size(), gap < 0 ? 1u : 0u) << gap;
    bodies.set_pose(1, at(0.1 + gap, 0, -0.008));  // and back
    EXPECT_TRUE(watch.follow(bodies, {true, false}).empty());
    if (found.empty()) continue;
    EXPECT_EQ(found[0].pair, 0u);
    EXPECT_GT(found[0].depth, 0);
    EXPECT_LE(found[0].depth, thickness);
    EXPECT_LT(std::abs(found[0].point.z()), 2 * thickness);
  }
}

/// Against poses at many instants of random motions, in which the bodies turn, too.
TEST(PairMonitor, CollisionsOnTheWayAreThoseOfManyPoses) {
  std::mt19937 random(3);
  std::uniform_real_distribution<double> uniform(-1, 1);
  const auto vector = [&] { return Vector3d(uniform(random), uniform(random), uniform(random)); };
  BodySet bodies({box(0.3, 0.2, 0.004), box(0.002, 0.03, 0.004)});
  PairMonitor watch({{0, 1}});
  int passed = 0, apart = 0;
  for (int k = 0; k < 200; ++k) {
    const Vector3d place = vector().cwiseProduct(Vector3d(0.16, 0.11, 0.03));
    const Isometry3d from =
        Eigen::Translation3d(place) * Eigen::AngleAxisd(3 * uniform(random), vector().normalized());
    Step step{from, Eigen::Translation3d(0.06 * vector()) * from};
    step.to.linear() = Eigen::AngleAxisd(0.5 * uniform(random), vector().normalized()) * from.linear();
    bodies.set_pose(1, step.from);
    if (!watch.collisions(bodies).empty()) continue;
    watch.begin(bodies);
    double deepest = 0;
    for (int i = 1; i <= 200; ++i) {
      bodies.set_pose(1, step.at(i / 200.0));
      for (const Collision& collision : watch.collisions(bodies))
        deepest = std::max(deepest, collision.depth);
    }
    const bool free_again = watch.collisions(bodies).empty();
    const auto found = watch.follow(bodies, {false});
    EXPECT_TRUE(deepest <= PairMonitor::kFinest || found.size() == 1) << k << ": " << deepest;
    EXPECT_TRUE(deepest > 0 || found.empty() || found[0].depth < 5e-4) << k;  // between two of the poses
    passed += free_again && !found.empty() ? 1 : 0;
    apart += found.empty() ? 1 : 0;
  }
  EXPECT_GT(passed, 10);
  EXPECT_GT(apart, 50);
}

TEST(PairMonitor, PenetrationDepthOfBoxInPlate) {
  BodySet bodies({box(1, 1, 0.1), box(0.06, 0.05, 0.04), box(0.1, 0.1, 0.1)});
  PairMonitor watch({{0, 1}, {0, 2}});
  bodies.set_pose(2, at(0, 0, 3));
  for (const double depth : {1e-5, 0.002, 0.01}) {
    bodies.set_pose(1, at(0.013, 0.021, 0.05 + 0.02 - depth));
    const auto found = watch.collisions(bodies);
    ASSERT_EQ(found.size(), 1u);
    EXPECT_EQ(found[0].pair, 0u);
    EXPECT_NEAR(found[0].depth, depth, 1e-9);
    EXPECT_LT(std::abs(found[0].point.x() - 0.013), 0.0301);
    EXPECT_LT(std::abs(found[0].point.y() - 0.021), 0.0251);
    EXPECT_NEAR(found[0].point.z(), 0.05, depth + 1e-9);
    EXPECT_EQ(watch.nearest(bodies, 0.05, std::nullopt)->distance, 0);
  }
  bodies.set_pose(1, at(0.013, 0.021, 0.05 + 0.02 + 1e-6));
  EXPECT_TRUE(watch.collisions(bodies).empty());
}

}  // namespace
}  // namespace robotcell::proximity
