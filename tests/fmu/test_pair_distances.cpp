// Distances of pairs against closed forms, full searches, and PairMonitor; batches, blocks and threads.
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <memory>
#include <random>

#include "fmu/proximity/bounding_tree.h"
#include "fmu/proximity/collision_body.h"
#include "fmu/proximity/face_distance.h"
#include "fmu/proximity/motion_bound.h"
#include "fmu/proximity/pair_distances.h"
#include "fmu/proximity/pair_monitor.h"
#include "tests/fmu/box_mesh.h"

namespace robotcell::proximity {
namespace {

using Eigen::Isometry3d;
using Eigen::Vector3d;

/// Bumpy ball: no two faces are parallel.
TriangleMesh bumpy(int rings, double radius, double phase) {
  TriangleMesh mesh;
  const int around = 2 * rings;
  for (int i = 0; i <= rings; ++i) {
    for (int k = 0; k < around; ++k) {
      const double polar = M_PI * i / rings, turn = 2 * M_PI * k / around;
      const double r = radius * (1 + 0.1 * std::sin(5 * polar + phase) * std::cos(4 * turn + phase));
      mesh.vertices.emplace_back(r * std::sin(polar) * std::cos(turn), r * std::sin(polar) * std::sin(turn),
                                 r * std::cos(polar));
    }
  }
  for (int i = 0; i < rings; ++i) {
    for (int k = 0; k < around; ++k) {
      const int a = i * around + k, b = i * around + (k + 1) % around;
      mesh.faces.push_back({a, a + around, b});
      mesh.faces.push_back({b, a + around, b + around});
    }
  }
  return mesh;
}

Isometry3d at(const Vector3d& position, double turn = 0) {
  return Eigen::Translation3d(position) * Eigen::AngleAxisd(turn, Vector3d(1, 2, 3).normalized());
}

void append(std::vector<double>& poses, const Isometry3d& pose) {
  for (int row = 0; row < 4; ++row) {
    for (int column = 0; column < 4; ++column) poses.push_back(pose(row, column));
  }
}

/// Three bodies on closed paths that bring them near each other and into each other.
std::vector<double> path(std::size_t count, double step) {
  std::vector<double> poses;
  for (std::size_t i = 0; i < count; ++i) {
    const double t = step * static_cast<double>(i);
    append(poses, at({0, 0, 0}, 0.7 * t));
    append(poses, at({0.24 + 0.07 * std::sin(t), 0.05 * std::cos(3 * t), 0}, t));
    append(poses, at({0.05 * std::sin(2 * t), 0.28 + 0.1 * std::cos(t), 0.02}, -2 * t));
  }
  return poses;
}

PairDistances three_bodies() {
  return {{bumpy(20, 0.1, 0.3), bumpy(24, 0.11, 1.1), bumpy(16, 0.09, 2.0)}, {{0, 1}, {0, 2}, {1, 2}}};
}

TEST(MotionBound, ContainsThePointsOfABall) {
  std::mt19937 random(3);
  std::uniform_real_distribution<double> uniform(-1, 1);
  for (int i = 0; i < 500; ++i) {
    const Vector3d centre = 0.3 * Vector3d(uniform(random), uniform(random), uniform(random));
    const Isometry3d before = at({uniform(random), uniform(random), 0}, 3 * uniform(random));
    const Isometry3d now =
        before * at(0.01 * Vector3d(uniform(random), 0, uniform(random)), 0.1 * uniform(random));
    const Vector3d point =
        centre + 0.2 * Vector3d(uniform(random), uniform(random), uniform(random)).normalized();
    const double bound = motion_bound(centre, 0.2, before, now);
    EXPECT_LE((now * point - before * point).norm(), bound);
    EXPECT_LT(bound, (now * centre - before * centre).norm() + 0.2 * 0.1 + 2e-9);
  }
  EXPECT_EQ(motion_bound(Vector3d::Ones(), 1, at({1, 2, 3}, 1), at({1, 2, 3}, 1)), 0);
}

TEST(FaceDistance, FacesOfSmallTrianglesCount) {
  const double size = 1e-5;
  const Corners floor{{0, 0, 0}, {size, 0, 0}, {0, size, 0}};
  const Corners needle{
      {size / 5, size / 5, size}, {size / 4, size / 5, 3 * size}, {size / 5, size / 4, 3 * size}};
  const auto distance = [&](double scale) {
    return face_distance(floor, needle, Eigen::Matrix3d::Identity(), Vector3d::Zero(), scale).distance;
  };
  EXPECT_NEAR(distance(kFine), size, 1e-18);
  EXPECT_GT(distance(1), 1.01 * size);  // why there is a scale
}

TEST(BoundingTree, EveryNodeContainsItsFaces) {
  const Shape shape(bumpy(12, 0.1, 0.3));
  const BoundingTree tree(shape);
  std::size_t leaves = 0;
  const auto contained = [&](int node, std::size_t face) {
    for (const int vertex : shape.mesh.faces[face]) {
      const Vector3d point = shape.mesh.vertices[static_cast<std::size_t>(vertex)] - tree.sphere(node).centre;
      if (point.norm() > tree.sphere(node).radius + 1e-15) return false;
      const Vector3d along = (tree.box(node).axes.transpose() * point).cwiseAbs() - tree.box(node).half;
      if (along.maxCoeff() > 1e-15) return false;
    }
    return true;
  };
  // From each node down to its leaves.
  for (int node = 0; node < 2 * static_cast<int>(shape.mesh.faces.size()) - 1; ++node) {
    std::vector<int> below{node};
    while (!below.empty()) {
      const int next = below.back();
      below.pop_back();
      if (tree.is_leaf(next)) {
        ASSERT_TRUE(contained(node, tree.face(next)));
        leaves += node == 0 ? 1 : 0;
      } else {
        below.insert(below.end(), {tree.first_child(next), tree.first_child(next) + 1});
      }
    }
  }
  EXPECT_EQ(leaves, shape.mesh.faces.size());
}

TEST(BoundingTree, FacesWithoutAreaHaveFiniteBounds) {
  TriangleMesh mesh = box(0.1, 0.1, 0.1);
  mesh.faces.push_back({0, 0, 0});
  mesh.faces.push_back({0, 1, 0});
  const PairDistances pair({mesh, box(0.1, 0.1, 0.1)}, {{0, 1}});
  std::vector<double> poses;
  append(poses, at({0, 0, 0}));
  append(poses, at({0.3, 0.01, 0.02}));
  double distance = -1;
  const double bound = 1;
  pair.distances({poses.data(), 1}, &bound, 1, &distance);
  EXPECT_NEAR(distance, 0.2, 1e-12);
}

TEST(PairDistances, BoxesHaveTheClosedForm) {
  const PairDistances pair({box(0.2, 0.2, 0.2), box(0.1, 0.3, 0.1)}, {{1, 0}});
  std::vector<double> poses;
  const std::vector<double> gaps{0.3, 0.0499, 0.0501, 1e-7, -0.01, 0.02};
  for (const double gap : gaps) {
    append(poses, at({1, 2, 3}));
    append(poses, at({1.15 + gap, 2.01, 3.02}));
  }
  std::vector<double> distances(gaps.size());
  std::vector<double> points(6 * gaps.size());
  const double bound = 0.05;
  const std::vector<double> bounds(gaps.size(), bound);
  pair.distances({poses.data(), gaps.size()}, bounds.data(), 1, distances.data(), points.data());
  for (std::size_t i = 0; i < gaps.size(); ++i) {
    EXPECT_NEAR(distances[i], std::min(std::max(gaps[i], 0.0), bound), 1e-12) << i;
    const bool found = gaps[i] > 0 && gaps[i] < bound;
    EXPECT_EQ(std::isnan(points[6 * i]), !found) << i;
    if (!found) continue;
    EXPECT_NEAR(points[6 * i], 1.1 + gaps[i], 1e-12);  // of body 1, which the pair names first
    EXPECT_NEAR(points[6 * i + 3], 1.1, 1e-12);
  }
}

TEST(PairDistances, AgreeWithTheWatchOfTheCell) {
  const std::vector<TriangleMesh> meshes{bumpy(20, 0.1, 0.3), bumpy(24, 0.11, 1.1), bumpy(16, 0.09, 2.0)};
  const std::vector<PairDistances::Pair> pairs{{0, 1}, {0, 2}, {1, 2}};
  const PairDistances batch(meshes, pairs);
  constexpr std::size_t kCount = 300;
  const std::vector<double> poses = path(kCount, 0.02);
  const std::vector<double> bounds(3 * kCount, 0.03);
  std::vector<double> distances(3 * kCount);
  batch.distances({poses.data(), kCount}, bounds.data(), 1, distances.data());
  BodySet bodies(meshes);
  std::size_t near = 0, hit = 0;
  for (std::size_t i = 0; i < kCount; ++i) {
    for (std::size_t k = 0; k < 3; ++k) {
      Isometry3d pose;
      pose.matrix() =
          Eigen::Map<const Eigen::Matrix<double, 4, 4, Eigen::RowMajor>>(&poses[16 * (3 * i + k)]);
      bodies.set_pose(k, pose);
    }
    for (std::size_t k = 0; k < 3; ++k) {
      const auto found = PairMonitor({pairs[k]}).nearest(bodies, 0.03, std::nullopt);
      ASSERT_NEAR(distances[3 * i + k], found ? found->distance : 0.03, 1e-12) << i << " " << k;
      near += found ? 1 : 0;
      hit += found && found->distance == 0 ? 1 : 0;
    }
  }
  EXPECT_GT(near, 100u);
  EXPECT_GT(hit, 10u);
  EXPECT_GT(near - hit, 50u);
}

/// Bounds that differ from pair to pair and from pose to pose.
std::vector<double> three_bounds(std::size_t poses) {
  std::vector<double> bounds;
  for (std::size_t i = 0; i < poses; ++i) {
    for (const double bound : {0.02, 0.05, std::numeric_limits<double>::infinity()}) {
      bounds.push_back(bound * static_cast<double>(1 + i % 3));
    }
  }
  return bounds;
}

TEST(PairDistances, ThreadsDoNotChangeAByte) {
  const PairDistances bodies = three_bodies();
  constexpr std::size_t kCount = 700;  // several blocks, the last one not full
  const std::vector<double> poses = path(kCount, 0.03);
  const std::vector<double> bounds = three_bounds(kCount);
  const auto query = [&](unsigned threads) {
    std::vector<double> result(3 * kCount + 18 * kCount);
    bodies.distances({poses.data(), kCount}, bounds.data(), threads, result.data(),
                     result.data() + 3 * kCount);
    std::unique_ptr<bool[]> hit(new bool[3 * kCount]);
    bodies.collisions({poses.data(), kCount}, threads, hit.get());
    for (std::size_t i = 0; i < 3 * kCount; ++i) {
      EXPECT_EQ(hit[i], result[i] == 0);
      result.push_back(hit[i] ? 1 : 0);
    }
    for (double& value : result) value = std::isnan(value) ? -1 : value;
    return result;
  };
  const std::vector<double> expected = query(1);
  for (const unsigned threads : {0u, 2u, 5u}) EXPECT_EQ(query(threads), expected) << threads;
}

TEST(PairDistances, EarlierPosesDoNotChangeTheDistance) {
  const PairDistances bodies = three_bodies();
  constexpr std::size_t kCount = 500;
  const std::vector<double> bounds = three_bounds(kCount);
  for (const double step : {1e-4, 0.01, 0.3}) {
    const std::vector<double> poses = path(kCount, step);
    std::vector<double> distances(3 * kCount), single(3);
    bodies.distances({poses.data(), kCount}, bounds.data(), 1, distances.data());
    for (std::size_t i = 0; i < kCount; ++i) {
      bodies.distances({&poses[48 * i], 1}, &bounds[3 * i], 1, single.data());
      for (std::size_t k = 0; k < 3; ++k) ASSERT_NEAR(distances[3 * i + k], single[k], 1e-12);
    }
  }
}

TEST(PairDistances, OtherPairsOfTheSameBodies) {
  const PairDistances all = three_bodies();
  const PairDistances one(all, {{2, 1}});
  const std::vector<double> poses = path(20, 0.1);
  const std::vector<double> bounds(60, 1);
  std::vector<double> of_all(60), of_one(20);
  all.distances({poses.data(), 20}, bounds.data(), 1, of_all.data());
  one.distances({poses.data(), 20}, bounds.data(), 1, of_one.data());
  for (std::size_t i = 0; i < 20; ++i) EXPECT_NEAR(of_one[i], of_all[3 * i + 2], 1e-12);
  EXPECT_THROW(PairDistances(all, {{0, 3}}), std::invalid_argument);
  EXPECT_THROW(PairDistances(all, {{1, 1}}), std::invalid_argument);
  EXPECT_THROW(PairDistances({TriangleMesh{}}, {}), std::invalid_argument);
}

}  // namespace
}  // namespace robotcell::proximity
