// Geometry and cameras: transforms, functions without libm, random numbers, derivatives, blur, triangulation
// and packets of projections.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "sensor_rt/geometry/fast_math.h"
#include "sensor_rt/geometry/random.h"
#include "sensor_rt/geometry/rigid3.h"
#include "sensor_rt/imaging/triangulate.h"
#include "sensor_rt/optics/projector.h"

namespace sensor_rt {
namespace {

using Vector = Eigen::Vector3d;

Rigid3 make_pose(const Vector& turn, const Vector& shift) {
  return {Eigen::AngleAxisd(turn.norm(), turn.normalized()).toRotationMatrix(), shift};
}

TEST(FastMath, ErrorsAreBelowTheStatedOnes) {
  for (float x = -87.0f; x <= 0.0f; x += 0.0173f) {
    const double expected = std::exp(static_cast<double>(x));
    EXPECT_NEAR(exp_negative(x), expected, 3e-7 * expected) << x;
  }
  EXPECT_EQ(exp_negative(-1e30f), exp_negative(-87.0f));
  for (float x = -6.0f; x <= 6.0f; x += 0.0113f) {
    const float exponential = exp_negative(-0.5f * x * x);
    const double wide = x;
    EXPECT_NEAR(normal_cdf(x, exponential), std::erfc(-wide / std::sqrt(2.0)) / 2, 2.5e-7) << x;
    EXPECT_NEAR(normal_pdf(exponential), std::exp(-wide * wide / 2) / std::sqrt(2 * M_PI), 1e-7) << x;
  }
}

TEST(Rigid3, InverseAndProductsAreConsistent) {
  const Rigid3 a = make_pose({0.3, -0.2, 0.9}, {1.0, 2.0, 3.0});
  const Rigid3 b = make_pose({-1.0, 0.4, 0.1}, {-0.5, 0.1, 0.2});
  const Vector point(0.3, 0.4, 0.5);
  EXPECT_NEAR(((a * b) * point - a * (b * point)).norm(), 0.0, 1e-14);
  EXPECT_NEAR((a.inverse() * (a * point) - point).norm(), 0.0, 1e-14);
}

TEST(Rigid3, InterpolationTurnsAtConstantRate) {
  const Rigid3 from = make_pose({0.1, 0.2, 0.3}, {0.0, 0.0, 1.0});
  const Rigid3 to = from * make_pose({0.0, 0.0, 0.8}, {0.2, 0.0, 0.0});
  const Rigid3 quarter = interpolate(from, to, 0.25);
  const Eigen::AngleAxisd turn(Eigen::Matrix3d(from.rotation.transpose() * quarter.rotation));
  EXPECT_NEAR(turn.angle(), 0.2, 1e-12);
  EXPECT_NEAR((quarter.translation - (0.75 * from.translation + 0.25 * to.translation)).norm(), 0.0, 1e-15);
  EXPECT_TRUE(interpolate(from, from, 0.7) == from);
}

/// Test vectors of Random123 for Philox4x32-10.
TEST(Philox, MatchesPublishedTestVectors) {
  const std::array<std::uint32_t, 4> zeros = {0x6627e8d5u, 0xe169c58du, 0xbc57ac4cu, 0x9b00dbd8u};
  EXPECT_EQ(philox4x32({0, 0, 0, 0}, {0, 0}), zeros);
  const std::array<std::uint32_t, 4> ones = {0x408f276du, 0x41c83b0eu, 0xa20bc7c6u, 0x6d5451fdu};
  EXPECT_EQ(philox4x32({~0u, ~0u, ~0u, ~0u}, {~0u, ~0u}), ones);
}

Camera make_camera(bool distorted, bool tilted) {
  Camera camera;
  camera.width_px = 1280;
  camera.height_px = 1024;
  camera.focal_px = 3100.0;
  camera.cx_px = 639.5;
  camera.cy_px = 511.5;
  camera.f_number = 11.0;
  camera.pixel_pitch = 5e-6;
  if (distorted) camera.distortion = {-0.12, 0.05, 0.002, -0.001, 0.03};
  if (tilted) camera.tilt_sensor(0.1, -0.05);
  camera.sensor_from_camera = make_pose({0.1, 0.5, 0.2}, {0.06, 0.0, 0.01});
  return camera;
}

class Cameras : public testing::TestWithParam<std::pair<bool, bool>> {
 protected:
  Camera camera = make_camera(GetParam().first, GetParam().second);
};

TEST_P(Cameras, JacobianIsDerivativeOfRay) {
  constexpr double kStep = 1e-2;
  const Eigen::Vector2d pixel(300.0, 800.0);
  const Eigen::Matrix2d slope = camera.ray_jacobian(camera.ray(pixel));
  for (int k = 0; k < 2; ++k) {
    const Eigen::Vector2d step = kStep * Eigen::Vector2d::Unit(k);
    const Vector change = (camera.ray(pixel + step) - camera.ray(pixel - step)) / (2.0 * kStep);
    EXPECT_NEAR((slope.col(k) - change.head<2>()).norm(), 0.0, 1e-6 * slope.norm());
  }
}

TEST_P(Cameras, PointsOfTheSheetMoveWithThePixelAsTheJacobianStates) {
  constexpr double kStep = 1e-2;
  camera.tilt = 0.5;
  camera.sensor_from_camera = sensor_from_camera(1, 0.06, 0.01, camera.tilt);
  const Eigen::Vector2d pixel(300.0, 800.0);
  const SheetSurface sheet;
  for (const bool is_aligned : {true, false}) {
    camera.is_aligned = is_aligned;
    const Vector at = triangulate_exact(camera, sheet, pixel);
    const Eigen::Matrix<double, 3, 2> slope = triangulation_jacobian(camera, sheet, pixel, at);
    for (int k = 0; k < 2; ++k) {
      const Eigen::Vector2d step = kStep * Eigen::Vector2d::Unit(k);
      const Vector change =
          triangulate_exact(camera, sheet, pixel + step) - triangulate_exact(camera, sheet, pixel - step);
      EXPECT_NEAR((slope.col(k) - change / (2.0 * kStep)).norm(), 0.0, 1e-6 * slope.norm());
    }
    Lanes3 points;
    Lanes3 per_row;
    const std::vector<double> column(kLanes, pixel.x());
    const std::vector<double> row(kLanes, pixel.y());
    Triangulator(camera, TriangulationForm::kExact, sheet).locate(column.data(), row.data(), points, per_row);
    EXPECT_NEAR((lane(points, 3) - at).norm(), 0.0, 1e-12);
    EXPECT_NEAR((lane(per_row, 3) - slope.col(1)).norm(), 0.0, 1e-9 * slope.norm());
  }
}

TEST_P(Cameras, TiltAreaIsThatOfAPixelOnThePlaneAcrossTheAxis) {
  camera.distortion = {};
  for (const Eigen::Vector2d& pixel :
       {Eigen::Vector2d(639.5, 511.5), Eigen::Vector2d(10.0, 20.0), Eigen::Vector2d(1200.0, 900.0)}) {
    const double area = camera.ray_jacobian(camera.ray(pixel)).determinant();
    EXPECT_NEAR(camera.tilt_area(pixel), area * camera.focal_px * camera.focal_px, 1e-12);
  }
}

TEST_P(Cameras, BlurRadiusBoundsTheImagesThroughTheRimOfTheLens) {
  camera.focus = 0.2;
  for (const double depth : {0.15, 0.19, 0.21, 0.4}) {
    for (const Vector& direction : {Vector(0.0, 0.0, 1.0), Vector(0.15, 0.1, 1.0), Vector(-0.1, 0.12, 1.0)}) {
      const Vector point = depth * direction;
      double farthest = 0.0;
      for (int k = 0; k < 16; ++k) {
        const double angle = M_PI * k / 8;
        const Eigen::Vector2d rim =
            camera.aperture_radius() * Eigen::Vector2d(std::cos(angle), std::sin(angle));
        farthest = std::max(farthest, (camera.project_through(rim, point) - camera.project(point)).norm());
      }
      EXPECT_LE(farthest, camera.blur_radius_px(point));
      EXPECT_GE(farthest, 0.6 * camera.blur_radius_px(point));
    }
  }
}

TEST_P(Cameras, ProjectorMatchesCamera) {
  const Projector projector(camera);
  Lanes3 points;
  for (int l = 0; l < kLanes; ++l) {
    set_lane(points, l,
             camera.sensor_from_camera * Vector(0.002 * (l - 8), 0.0013 * (8 - l), 0.1 + 0.002 * l));
  }
  set_lane(points, 0, camera.sensor_from_camera * Vector(0.0, 0.0, -0.1));
  alignas(64) double column[kLanes];
  alignas(64) double row[kLanes];
  projector.project(points, column, row);
  EXPECT_EQ(column[0], kNotVisible);
  for (int l = 1; l < kLanes; ++l) {
    const Eigen::Vector2d pixel = camera.project(camera.sensor_from_camera.inverse() * lane(points, l));
    EXPECT_NEAR(column[l], pixel.x(), 1e-9);
    EXPECT_NEAR(row[l], pixel.y(), 1e-9);
  }
}

INSTANTIATE_TEST_SUITE_P(Lenses, Cameras,
                         testing::Values(std::pair(false, false), std::pair(true, false),
                                         std::pair(false, true), std::pair(true, true)));

}  // namespace
}  // namespace sensor_rt
