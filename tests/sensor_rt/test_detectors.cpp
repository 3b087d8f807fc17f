// Image sensor: quantisation, photon transfer, saturation.
#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "sensor_rt/detector/detector.h"
#include "sensor_rt/detector/electrons.h"
#include "sensor_rt/geometry/random.h"

namespace sensor_rt {
namespace {

constexpr int kEdge = 256;
constexpr std::size_t kPixels = kEdge * kEdge;

DetectorParameters make_parameters() {
  DetectorParameters p;
  p.exposure = 5e-4;
  p.quantum_efficiency = 0.5;
  p.full_well_e = 11'000.0;
  p.read_noise_e = 5.0;
  p.dark_current_e_per_s = 20.0;
  p.gain_dn_per_e = 0.3;
  p.bit_depth = 12;
  p.black_level_dn = 16.0;
  return p;
}

std::vector<std::uint16_t> expose(const DetectorParameters& parameters, bool noise, float electrons) {
  const Detector detector(parameters, noise, 7);
  const std::vector<float> light(kPixels, electrons);
  std::vector<std::uint16_t> image(kPixels);
  detector.expose({3, 0, parameters.exposure}, ImageView<const float>{light.data(), kEdge, kEdge, kEdge},
                  ImageView<std::uint16_t>{image.data(), kEdge, kEdge, kEdge});
  return image;
}

TEST(Detector, QuantisesElectronsWithoutNoise) {
  const DetectorParameters p = make_parameters();
  for (const float electrons : {0.0f, 10.0f, 1234.0f, 9000.0f}) {
    const double charge = static_cast<double>(electrons) + p.dark_current_e_per_s * p.exposure;
    EXPECT_EQ(expose(p, false, electrons)[5], std::floor(p.black_level_dn + p.gain_dn_per_e * charge + 0.5));
  }
  EXPECT_EQ(expose(p, false, 1e7f)[5], std::floor(p.black_level_dn + p.gain_dn_per_e * p.full_well_e + 0.5));
}

/// EMVA 1288: variance = gain² (mean + dark + read²) + 1/12.
TEST(Detector, VarianceFollowsPhotonTransfer) {
  const DetectorParameters p = make_parameters();
  for (const float electrons : {0.0f, 5.0f, 100.0f, 5000.0f}) {
    double sum = 0.0;
    double sum2 = 0.0;
    for (const std::uint16_t value : expose(p, true, electrons)) {
      sum += value;
      sum2 += static_cast<double>(value) * value;
    }
    const double mean = sum / kPixels;
    const double variance = sum2 / kPixels - mean * mean;
    const double charge = static_cast<double>(electrons) + p.dark_current_e_per_s * p.exposure;
    const double expected =
        p.gain_dn_per_e * p.gain_dn_per_e * (charge + p.read_noise_e * p.read_noise_e) + 1.0 / 12.0;
    EXPECT_NEAR(mean, p.black_level_dn + p.gain_dn_per_e * charge, 5.0 * std::sqrt(expected / kPixels));
    EXPECT_NEAR(variance, expected, 5.0 * expected * std::sqrt(2.0 / kPixels));
  }
}

TEST(Poisson, MeanAndVarianceEqualTheParameter) {
  for (const double mean : {0.3, 4.0, 15.9, 16.1, 300.0}) {
    constexpr std::uint32_t kCount = 100'000;
    double sum = 0.0;
    double sum2 = 0.0;
    for (std::uint32_t i = 0; i < kCount; ++i) {
      const double value = poisson(mean, philox4x32({i, 0, 0, 0}, {11, 12})[0]);
      EXPECT_EQ(value, std::floor(value));
      sum += value;
      sum2 += value * value;
    }
    const double found = sum / kCount;
    EXPECT_NEAR(found, mean, 5.0 * std::sqrt(mean / kCount));
    EXPECT_NEAR(sum2 / kCount - found * found, mean, 5.0 * std::sqrt((2.0 * mean * mean + mean) / kCount));
  }
}

TEST(Detector, ParametersOutOfRangeAreRejected) {
  DetectorParameters p = make_parameters();
  p.bit_depth = 7;
  EXPECT_THROW(Detector(p, true, 1), std::invalid_argument);
  p = make_parameters();
  p.full_well_e = 0.0;
  EXPECT_THROW(Detector(p, true, 1), std::invalid_argument);
}

}  // namespace
}  // namespace sensor_rt
