// Ray queries: views with known origins against queries of any rays, and surfaces that do not occlude
// themselves.
#include <gtest/gtest.h>

#include <random>

#include "sensor_rt/optics/laser_emitter.h"
#include "sensor_rt/optics/region.h"
#include "sensor_rt/tracing/ray_view.h"
#include "sensor_rt/tracing/surface_point.h"

namespace sensor_rt {
namespace {

using Vector = Eigen::Vector3d;

alignas(64) constexpr int kAll[kLanes] = {-1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1};

LaserSheet query_laser() {
  LaserSheet laser;
  laser.power = 1e-3;
  laser.fan_half_angle = 0.3;
  laser.source_z = 0.01;
  laser.sheet_sigma = 60e-6;
  return laser;
}

/// Bodies in and beside the laser fan, and their poses.
struct World {
  Scene scene;
  std::vector<Rigid3> poses;

  World() {
    const double vertices[] = {-0.03, -0.04, 0.0, 0.03, -0.04, 0.004, 0.0, 0.05, 0.01, 0.0, 0.0, -0.02};
    const std::uint32_t faces[] = {0, 1, 2, 0, 1, 3, 1, 2, 3, 2, 0, 3};
    const Material white;
    scene.add_mesh("tetrahedron", {vertices, 4, faces, 4}, white);
    scene.add_sphere("ball", Vector(0.0, 0.01, 0.0), 0.006, white);
    scene.add_box("box", Rigid3{}, Vector(0.01, 0.01, 0.01), white);
    scene.add_cylinder("post", Rigid3{}, 0.004, 0.03, white);
    scene.add_cone("cone", Rigid3{}, 0.006, 0.002, 0.01, white);
    scene.add_ring("ring", Rigid3{}, 0.004, 0.008, 0.006, white);
    scene.add_sphere("beside", Vector::Zero(), 0.02, white);
    const Vector places[] = {{0.0, 0.0, 0.14},     {0.0, 0.0, 0.1},    {0.0, -0.012, 0.09},
                             {0.001, 0.025, 0.12}, {0.0, -0.02, 0.11}, {0.0, 0.014, 0.08},
                             {0.3, 0.0, 0.1}};
    for (const Vector& place : places) {
      Rigid3 pose;
      pose.rotation =
          Eigen::AngleAxisd(3.0 * place.z(), Vector(1.0, 2.0, 3.0).normalized()).toRotationMatrix();
      pose.translation = place;
      poses.push_back(pose);
    }
  }
};

/// Sixteen random rays of the fan, within `slope` of its centre.
template <typename Random>
Lanes3 fan_rays(const LaserEmitter& laser, double slope, Random& random) {
  std::uniform_real_distribution<double> uniform(-1.0, 1.0);
  Lanes3 direction;
  for (int l = 0; l < kLanes; ++l) {
    const double angle = laser.sheet.fan_half_angle * uniform(random);
    set_lane(direction, l, laser.direction(std::sin(angle), std::cos(angle), slope * uniform(random)));
  }
  return direction;
}

TEST(RayView, AnswersLikeSceneQuery) {
  const World world;
  PoseTrack track;
  track.set_still(world.scene, world.poses.data());
  const SceneQuery query(world.scene, track);
  const LaserEmitter laser(query_laser());
  const Vector source(0.0, 0.0, laser.sheet.source_z);
  constexpr double kSlope = 0.05;
  const std::vector<std::size_t> instants(kLanes, 0);
  RayView view;
  view.set(query, {source}, instants,
           laser_region(laser.sheet, kSlope / std::cos(laser.sheet.fan_half_angle)));
  EXPECT_EQ(view.shapes().size(), world.scene.shapes().size() - 1);  // the ball beside the fan is culled
  Lanes3 origin;
  for (int l = 0; l < kLanes; ++l) set_lane(origin, l, source);
  std::mt19937 random(1);
  int met = 0;
  int blocked = 0;
  for (int packet = 0; packet < 200; ++packet) {
    const Lanes3 direction = fan_rays(laser, kSlope, random);
    PacketHits expected;
    PacketHits found;
    query.intersect(instants.data(), origin, direction, kAll, expected);
    view.intersect(0, direction, kAll, found);
    Lanes3 segment;
    alignas(64) int expected_free[kLanes];
    alignas(64) int found_free[kLanes];
    for (int l = 0; l < kLanes; ++l) {
      EXPECT_EQ(found.shape[l], expected.shape[l]);
      EXPECT_DOUBLE_EQ(found.t[l], expected.t[l]);
      met += expected.shape[l] >= 0 ? 1 : 0;
      set_lane(segment, l, 0.12 * lane(direction, l));
      expected_free[l] = found_free[l] = -1;
    }
    query.occlude(instants.data(), origin, segment, expected_free);
    view.occlude(0, segment, found_free);
    for (int l = 0; l < kLanes; ++l) {
      EXPECT_EQ(found_free[l], expected_free[l]);
      blocked += expected_free[l] == 0 ? 1 : 0;
    }
  }
  EXPECT_GT(met, 1000);
  EXPECT_GT(blocked, 500);
}

/// Normals against the gradients of the surfaces' implicit forms, from all sides and from inside.
TEST(SceneQuery, NormalsOfFrustaPointOutwards) {
  struct Case {
    double bottom, top, bore;
  };
  for (const Case& of :
       {Case{0.02, 0.02, 0.0}, Case{0.02, 0.005, 0.0}, Case{0.0, 0.02, 0.0}, Case{0.02, 0.02, 0.01}}) {
    constexpr double kHeight = 0.03;
    Scene scene;
    if (of.bore > 0.0) {
      scene.add_ring("body", Rigid3{}, of.bore, of.top, kHeight, Material());
    } else {
      scene.add_cone("body", Rigid3{}, of.bottom, of.top, kHeight, Material());
    }
    const Rigid3 pose;
    PoseTrack track;
    track.set_still(scene, &pose);
    const SceneQuery query(scene, track);
    const std::size_t instants[kLanes] = {};
    const double slope = (of.top - of.bottom) / kHeight;
    std::mt19937 random(3);
    std::uniform_real_distribution<double> uniform(-0.04, 0.04);
    int on_end = 0;
    int on_flank = 0;
    int on_bore = 0;
    for (int packet = 0; packet < 200; ++packet) {
      Lanes3 origin;
      Lanes3 direction;
      for (int l = 0; l < kLanes; ++l) {
        set_lane(origin, l, Vector(uniform(random), uniform(random), uniform(random)));
        set_lane(direction, l,
                 0.5 * Vector(uniform(random), uniform(random), uniform(random)) - lane(origin, l));
      }
      PacketHits hits;
      query.intersect(instants, origin, direction, kAll, hits);
      for (int l = 0; l < kLanes; ++l) {
        if (hits.shape[l] < 0) continue;
        const Vector at = lane(origin, l) + hits.t[l] * lane(direction, l);
        const double radius = std::hypot(at.x(), at.y());
        const double flank = 0.5 * (of.bottom + of.top) + slope * at.z();
        Vector expected(at.x() / radius, at.y() / radius, -slope);
        if (std::abs(std::abs(at.z()) - 0.5 * kHeight) < 1e-12) {
          expected = Vector(0.0, 0.0, std::copysign(1.0, at.z()));
          ++on_end;
        } else if (std::abs(radius - flank) < 1e-12) {
          ++on_flank;
        } else {
          ASSERT_NEAR(radius, of.bore, 1e-12);
          expected = -expected;
          ++on_bore;
        }
        EXPECT_NEAR((lane(hits.normal, l) - expected.normalized()).norm(), 0.0, 1e-12);
      }
    }
    EXPECT_GT(on_end, 100);
    EXPECT_GT(on_flank, 100);
    EXPECT_EQ(on_bore > 100, of.bore > 0.0);
  }
}

/// Distances and sizes from millimetres to a hundred metres.
TEST(SceneQuery, SurfacesDoNotOccludeThemselves) {
  for (const double size : {1e-3, 0.1, 1.0, 100.0}) {
    Scene scene;
    const double vertices[] = {-4 * size,  -4 * size, 0.0,      4 * size,  -4 * size,
                               0.1 * size, 0.0,       4 * size, 0.2 * size};
    const std::uint32_t faces[] = {0, 1, 2};
    scene.add_mesh("face", {vertices, 3, faces, 1}, Material());
    Rigid3 pose;
    pose.translation = Vector(0.0, 0.0, 2.0 * size);
    PoseTrack track;
    track.set_still(scene, &pose);
    const SceneQuery query(scene, track);
    const std::size_t instants[kLanes] = {};
    std::mt19937 random(2);
    std::uniform_real_distribution<double> uniform(-0.3, 0.3);
    Lanes3 origin;
    Lanes3 direction;
    for (int l = 0; l < kLanes; ++l) {
      set_lane(origin, l, Vector::Zero());
      set_lane(direction, l, Vector(uniform(random), uniform(random), 1.0));
    }
    PacketHits hits;
    query.intersect(instants, origin, direction, kAll, hits);
    Lanes3 segment;
    Lanes3 above;
    Lanes3 away;
    alignas(64) int unoccluded[kLanes];
    for (int l = 0; l < kLanes; ++l) {
      ASSERT_EQ(hits.shape[l], 0);
      const SurfacePoint at(query, 0, origin, direction, hits, l);
      set_lane(segment, l, at.position);
      set_lane(above, l, at.above());
      set_lane(away, l, at.back + 0.99 * (at.normal.cross(at.back).cross(at.normal)));
      unoccluded[l] = -1;
    }
    query.occlude(instants, origin, segment, unoccluded);
    PacketHits again;
    query.intersect(instants, above, away, kAll, again);
    for (int l = 0; l < kLanes; ++l) {
      EXPECT_EQ(unoccluded[l], -1) << size;
      EXPECT_EQ(again.shape[l], -1) << size;
    }
  }
}

}  // namespace
}  // namespace sensor_rt
