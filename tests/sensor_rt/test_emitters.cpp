// Emitters: quadrature of areas, and the two forms of the laser sheet.
#include <gtest/gtest.h>

#include <cmath>

#include "sensor_rt/render/emitter/sheet_light.h"
#include "sensor_rt/scene/light.h"

namespace sensor_rt {
namespace {

using Vector = Eigen::Vector3d;

LaserSheet make_laser() {
  LaserSheet laser;
  laser.wavelength = 660e-9;
  laser.power = 2e-3;
  laser.fan_half_angle = 0.28;
  laser.source_z = 0.01;
  laser.sheet_sigma = 60e-6;
  laser.waist_z = 0.12;
  laser.divergence = 4e-4;
  return laser;
}

TEST(LaserSheet, NoLightOutsideFanOrBehindSource) {
  const LaserEmitter laser(make_laser());
  EXPECT_GT(laser.at({0.0, 0.1 * std::tan(0.279), 0.1}).irradiance, 0.0);
  EXPECT_EQ(laser.at({0.0, 0.1 * std::tan(0.281), 0.1}).irradiance, 0.0);
  EXPECT_EQ(laser.at({0.0, 0.0, -0.1}).irradiance, 0.0);
}

TEST(SheetLight, PacketsMatchSinglePointsTimesCosine) {
  const LaserEmitter laser(make_laser());
  const Vector source(0.0, 0.0, laser.sheet.source_z);
  const SheetLight light(laser);
  const Vector viewpoint(0.06, 0.001, 0.0);
  const Vector normal = Vector(0.3, 0.2, -0.9).normalized();
  Lanes3 direction;
  Lanes3 origins;
  Lanes3 sources;
  PacketHits hits;
  for (int l = 0; l < kLanes; ++l) {
    const Vector point(2e-5 * (l - 8), 0.004 * (l - 8), 0.11 + 0.001 * l);
    set_lane(direction, l, point - viewpoint);
    set_lane(origins, l, viewpoint);
    set_lane(sources, l, source);
    set_lane(hits.normal, l, normal);
    hits.t[l] = 1.0;
    hits.shape[l] = 0;
  }
  for (const bool general : {false, true}) {
    Lanes3 from_source;
    alignas(64) double irradiance[kLanes];
    alignas(64) int lit[kLanes];
    if (general) {
      light.light(origins, sources, direction, hits, from_source, irradiance, lit);
    } else {
      light.light(viewpoint.data(), direction, hits, from_source, irradiance, lit);
    }
    for (int l = 0; l < kLanes; ++l) {
      const Vector point = viewpoint + lane(direction, l);
      const IncidentLight incident = laser.at(point - source);
      const double expected = normal.dot(incident.towards) * incident.irradiance;
      EXPECT_NEAR(irradiance[l], expected, 1e-9 * (expected + 1e-6)) << "lane " << l;
      EXPECT_EQ(lit[l] != 0, expected > 0.0);
    }
  }
}

TEST(Lights, SamplesCarryAllPowerAndLieOnTheLamp) {
  Rigid3 pose;
  pose.translation = {0.1, 0.2, 0.3};
  for (const LightKind kind : {LightKind::kPoint, LightKind::kRectangle, LightKind::kDisc}) {
    Light light;
    light.kind = kind;
    light.size = {0.2, kind == LightKind::kDisc ? 0.2 : 0.1};
    light.power = 5.0;
    LightSample samples[kLightSamples];
    const int count = light_samples(light, pose, samples);
    double sum = 0.0;
    Vector centre = Vector::Zero();
    for (int k = 0; k < count; ++k) {
      sum += samples[k].power;
      centre += samples[k].power / light.power * samples[k].position;
      EXPECT_LE(std::abs(samples[k].position.x() - 0.1), 0.1);
      EXPECT_LE(std::abs(samples[k].position.y() - 0.2), 0.5 * light.size.y());
      EXPECT_EQ(samples[k].position.z(), 0.3);
    }
    EXPECT_NEAR(sum, light.power, 1e-9);
    EXPECT_NEAR((centre - pose.translation).norm(), 0.0, 1e-12);
    const LightSample random = random_light_sample(light, pose, 0.99, 0.99);
    EXPECT_EQ(random.power, light.power);
    EXPECT_LE((random.position - pose.translation).norm(), 0.5 * light.size.norm());
  }
}

}  // namespace
}  // namespace sensor_rt
