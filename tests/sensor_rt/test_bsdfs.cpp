// Reflection models against what holds for any of them: energy, reciprocity, and sampling that agrees with
// its pdf.
#include <gtest/gtest.h>

#include <cmath>
#include <string>
#include <vector>

#include "sensor_rt/geometry/random.h"
#include "sensor_rt/scene/bsdf/ggx.h"
#include "sensor_rt/scene/bsdf/model_list.h"
#include "sensor_rt/scene/material.h"

namespace sensor_rt {
namespace {

using Vector = Eigen::Vector3d;

const Vector kNormal = Vector(0.3, -0.2, 0.9).normalized();

/// Three uniform numbers.
std::array<double, 3> uniforms(std::uint32_t index, std::uint32_t purpose) {
  const auto bits = philox4x32({index, 0, 0, 0}, {purpose, 1});
  return {double(uniform01(bits[0])), double(uniform01(bits[1])), double(uniform01(bits[2]))};
}

/// Direction at the angle of this cosine to the normal.
Vector direction(double cosine, double azimuth) {
  const Vector x = kNormal.unitOrthogonal();
  const Vector y = kNormal.cross(x);
  const double sine = std::sqrt(1.0 - cosine * cosine);
  return cosine * kNormal + sine * (std::cos(azimuth) * x + std::sin(azimuth) * y);
}

std::vector<Material> materials() {
  std::vector<Material> all;
  for (const BsdfModel* model : bsdf_models()) {
    for (const double roughness : {0.15, 0.4, 1.0}) {
      for (const double reflectance : {0.3, 1.0}) {
        all.push_back({model->name, reflectance, roughness, 1.5, 0.4 * roughness, {}});
      }
    }
  }
  return all;
}

class EveryBsdf : public testing::TestWithParam<Material> {
 protected:
  std::unique_ptr<const Bsdf> bsdf = make_bsdf(GetParam());
};

std::string test_name(const testing::TestParamInfo<Material>& info) {
  return info.param.model + std::to_string(info.index);
}

TEST_P(EveryBsdf, IsReciprocalAndPositiveAboveTheSurfaceOnly) {
  for (std::uint32_t i = 0; i < 200; ++i) {
    const auto u = uniforms(i, 1);
    const auto v = uniforms(i, 2);
    const Vector a = direction(0.01 + 0.98 * u[0], 6.0 * u[1]);
    const Vector b = direction(0.01 + 0.98 * v[0], 6.0 * v[1]);
    const double there = bsdf->pi_brdf(kNormal, a, b);
    EXPECT_GE(there, 0.0);
    EXPECT_NEAR(bsdf->pi_brdf(kNormal, b, a), there, 1e-9 * (1.0 + there));
    EXPECT_EQ(bsdf->pi_brdf(kNormal, a, -b), 0.0);
    EXPECT_EQ(bsdf->pdf(kNormal, a, -b), 0.0);
  }
}

TEST_P(EveryBsdf, SampledWeightsSumToAlbedoBelowOne) {
  constexpr std::uint32_t kCount = 20'000;
  for (const double cosine : {0.2, 0.6, 0.95}) {
    double sum = 0.0;
    double sum2 = 0.0;
    for (std::uint32_t i = 0; i < kCount; ++i) {
      const auto u = uniforms(i, 3);
      const Vector from = direction(cosine, 2.0 * M_PI * uniforms(i, 6)[0]);
      const BsdfSample sample = bsdf->sample(kNormal, from, u[0], u[1], u[2]);
      sum += sample.weight;
      sum2 += sample.weight * sample.weight;
    }
    const double mean = sum / kCount;
    const double error = std::sqrt(std::max(0.0, sum2 / kCount - mean * mean) / kCount);
    EXPECT_NEAR(mean, bsdf->albedo(cosine), 5.0 * error + 2e-3);
    EXPECT_LE(bsdf->albedo(cosine), 1.0 + 1e-3);
  }
}

TEST_P(EveryBsdf, SampleAgreesWithPdfAndEvaluation) {
  if (bsdf->is_specular()) return;
  const Vector from = direction(0.7, 1.3);
  for (std::uint32_t i = 0; i < 500; ++i) {
    const auto u = uniforms(i, 4);
    const BsdfSample sample = bsdf->sample(kNormal, from, u[0], u[1], u[2]);
    if (!(sample.weight > 0.0)) continue;
    const double cosine = kNormal.dot(sample.towards);
    EXPECT_NEAR(sample.towards.norm(), 1.0, 1e-9);
    EXPECT_NEAR(bsdf->pdf(kNormal, from, sample.towards), sample.pdf, 1e-6 * sample.pdf);
    const double value = bsdf->pi_brdf(kNormal, from, sample.towards) / M_PI;
    EXPECT_NEAR(sample.weight, value * cosine / sample.pdf, 1e-6 * sample.weight);
  }
}

/// The pdf integrates to the share of samples that are not lost below the surface; and the shares of samples
/// in sectors of the hemisphere are the integrals of the pdf over them.
TEST_P(EveryBsdf, PdfIntegratesToShareOfSamplesInEverySector) {
  if (bsdf->is_specular()) return;
  constexpr int kSectors = 4;
  constexpr std::uint32_t kCount = 20'000;
  constexpr int kSteps = 400;
  const Vector from = direction(0.8, 0.0);
  double sampled[2 * kSectors] = {};
  double integral[2 * kSectors] = {};
  const Vector x = kNormal.unitOrthogonal();
  const Vector y = kNormal.cross(x);
  const auto sector = [&](const Vector& d) {
    const double azimuth = std::atan2(d.dot(y), d.dot(x)) / (2.0 * M_PI) + 0.5;
    const int around = std::min(kSectors - 1, static_cast<int>(azimuth * kSectors));
    return around + (d.dot(kNormal) > 0.7 ? kSectors : 0);
  };
  for (std::uint32_t i = 0; i < kCount; ++i) {
    const auto u = uniforms(i, 5);
    const BsdfSample sample = bsdf->sample(kNormal, from, u[0], u[1], u[2]);
    if (sample.pdf > 0.0) sampled[sector(sample.towards)] += 1.0 / kCount;
  }
  for (int i = 0; i < kSteps; ++i) {
    for (int j = 0; j < kSteps; ++j) {
      const Vector d = direction((i + 0.5) / kSteps, 2.0 * M_PI * (j + 0.5) / kSteps);
      integral[sector(d)] += bsdf->pdf(kNormal, from, d) * 2.0 * M_PI / (kSteps * kSteps);
    }
  }
  double whole = 0.0;
  double share = 0.0;
  for (int k = 0; k < 2 * kSectors; ++k) {
    EXPECT_NEAR(sampled[k], integral[k], 0.02) << "sector " << k;
    whole += integral[k];
    share += sampled[k];
  }
  EXPECT_NEAR(whole, share, 5e-3);  // 1, less the samples that fall below the surface
}

INSTANTIATE_TEST_SUITE_P(Models, EveryBsdf, testing::ValuesIn(materials()), test_name);

TEST(Fresnel, GlassReflectsAsInClosedFormAtNormalBrewsterAndGrazingIncidence) {
  const double n = 1.5;
  const double brewster = 1.0 / std::hypot(1.0, n);  // cosine; only light across the plane is reflected
  EXPECT_NEAR(dielectric_fresnel(1.0, n), 0.04, 1e-15);
  EXPECT_NEAR(dielectric_fresnel(brewster, n), 0.5 * std::pow((n * n - 1) / (n * n + 1), 2), 1e-15);
  EXPECT_NEAR(dielectric_fresnel(0.0, n), 1.0, 1e-15);
}

TEST(Fresnel, SchlicksApproximationIsNearTheReflectanceOfGlass) {
  for (int i = 0; i <= 100; ++i) {
    const double cosine = 0.01 * i;
    EXPECT_NEAR(schlick_fresnel(cosine, 0.04), dielectric_fresnel(cosine, 1.5), 0.04) << cosine;
  }
}

TEST(Materials, UnknownModelAndValuesOutOfRangeAreRejectedByName) {
  EXPECT_THROW(validate_material({"velvet", 0.5, 0.5, 1.5}, "part"), std::invalid_argument);
  EXPECT_THROW(validate_material({"rough_conductor", 0.5, 0.0, 1.5}, "part"), std::invalid_argument);
  EXPECT_THROW(validate_material({"lambert", 1.5, 0.0, 1.5}, "part"), std::invalid_argument);
  EXPECT_NO_THROW(validate_material({"oren_nayar", 0.5, 0.0, 1.5}, "part"));
}

}  // namespace
}  // namespace sensor_rt
