// Emitters: power of lamps and of the laser sheet.
#include <gtest/gtest.h>

#include <cmath>

#include "sensor_rt/optics/laser_emitter.h"
#include "sensor_rt/scene/light.h"
#include "sensor_rt/scene/light_parts.h"

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

TEST(LaserSheet, PowerThroughAPlaneIsThatOfTheFan) {
  const LaserEmitter laser(make_laser());
  constexpr double kDepth = 0.11;
  const double reach = kDepth * std::tan(0.28);
  constexpr int kSteps = 400;
  const double dx = 10.0 * 60e-6 / kSteps;
  const double dy = 2.0 * reach / kSteps;
  double power = 0.0;
  for (int i = 0; i < kSteps; ++i) {
    for (int j = 0; j < kSteps; ++j) {
      const Vector from_source((i + 0.5) * dx - 5.0 * 60e-6, (j + 0.5) * dy - reach, kDepth);
      const IncidentLight light = laser.at(from_source);
      power += light.irradiance * -light.towards.z() * dx * dy;
    }
  }
  EXPECT_NEAR(power, laser.sheet.power, 1e-4 * laser.sheet.power);
}

TEST(Lights, SamplesCarryAllPowerAndLieOnTheLamp) {
  Rigid3 pose;
  pose.translation = {0.1, 0.2, 0.3};
  for (const LightKind kind : {LightKind::kRectangle, LightKind::kDisc}) {
    Light light;
    light.kind = kind;
    light.size = {0.2, kind == LightKind::kDisc ? 0.2 : 0.1};
    light.power = 5.0;
    const LightHeight above{1.0, Eigen::Vector2d::Zero()};
    double sum = 0.0;
    Vector centre = Vector::Zero();
    for (const double side : {-1.0, 1.0}) {  // samples suffice for half a disc
      LightPart half = part_above(light, above);
      (side < 0.0 ? half.max() : half.min()).x() = 0.0;
      LightSample samples[kLightSamples];
      light_samples(light, pose, half, above, samples);
      for (const LightSample& sample : samples) {
        sum += sample.power;
        centre += sample.power / light.power * (sample.position - pose.translation);
        EXPECT_LE(std::abs(sample.position.x() - 0.1), 0.1);
        EXPECT_LE(std::abs(sample.position.y() - 0.2), 0.5 * light.size.y());
        EXPECT_EQ(sample.position.z(), 0.3);
      }
    }
    EXPECT_NEAR(sum, light.power, kind == LightKind::kDisc ? 1e-4 : 1e-9);
    EXPECT_NEAR(centre.norm(), 0.0, 1e-12);
    const LightSample random = random_light_sample(light, pose, 0.99, 0.99);
    EXPECT_EQ(random.power, light.power);
    EXPECT_LE((random.position - pose.translation).norm(), 0.5 * light.size.norm());
  }
}

TEST(Lights, SamplesOfPartsCarryThePowerAboveTheSurface) {
  Light light;
  light.size = {0.2, 0.2};
  light.power = 1.0;
  const double share = (std::acos(-0.3) + 0.3 * std::sqrt(1.0 - 0.09)) / M_PI;  // of a disc beyond -0.3 radii
  for (const auto& [kind, slope, expected] :
       {std::tuple(LightKind::kRectangle, Eigen::Vector2d(1.0, 0.0), 0.65),
        std::tuple(LightKind::kRectangle, Eigen::Vector2d(0.0, -1.0), 0.65),
        std::tuple(LightKind::kRectangle, Eigen::Vector2d(0.5, 0.5), 1.0 - 0.5 * 0.7 * 0.7),
        std::tuple(LightKind::kDisc, Eigen::Vector2d(1.0, 0.0), share),
        std::tuple(LightKind::kDisc, Eigen::Vector2d(0.6, 0.8), share)}) {
    light.kind = kind;
    const LightHeight height{0.03, slope};
    const LightPart all = part_above(light, height);
    constexpr int kParts = 32;
    double sum = 0.0;
    for (int i = 0; i < kParts; ++i) {
      LightPart part = all;
      part.min().x() += all.sizes().x() * i / kParts;
      part.max().x() -= all.sizes().x() * (kParts - 1 - i) / kParts;
      LightSample samples[kLightSamples];
      light_samples(light, Rigid3(), part, height, samples);
      for (const LightSample& sample : samples) {
        sum += sample.power;
        if (sample.power > 0.0) {
          EXPECT_GT(height.at(sample.position.head<2>()), 0.0);
        }
      }
    }
    EXPECT_NEAR(sum, expected, 1e-3);
  }
}

}  // namespace
}  // namespace sensor_rt
