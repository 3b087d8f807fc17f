// Vibration: power and band of the random part.
#include <gtest/gtest.h>

#include <cmath>
#include <complex>
#include <stdexcept>
#include <vector>

#include "fmu/model/vibration.h"

namespace {

using robotcell::Vibration;
using robotcell::VibrationParameters;

VibrationParameters random_only() {
  VibrationParameters parameters;
  parameters.random_rms = 2e-5;
  parameters.random_low = 20;
  parameters.random_width = 100;
  return parameters;
}

TEST(Vibration, RandomPartHasRmsAlongEveryAxis) {
  const Vibration vibration(random_only(), "base", 7);
  Eigen::Vector3d square = Eigen::Vector3d::Zero();
  constexpr int kSamples = 200'000;
  for (int i = 0; i < kSamples; ++i) square += vibration.at(i * 997).position.cwiseAbs2();
  const Eigen::Vector3d rms = (square / kSamples).cwiseSqrt();
  // Neighbouring sines beat; the mean over 200 s removes most of it.
  for (int axis = 0; axis < 3; ++axis) EXPECT_NEAR(rms[axis], 2e-5, 0.01 * 2e-5);
}

TEST(Vibration, RandomPartIsWithinBand) {
  const Vibration vibration(random_only(), "table", 7);
  constexpr int kSamples = 20'000;  // 1 ms apart, with a low-leakage window
  std::vector<double> windowed(kSamples);
  for (int i = 0; i < kSamples; ++i) {
    windowed[i] = (1 - std::cos(2 * M_PI * i / kSamples)) * vibration.at(i * 1000).position.x();
  }
  const auto power = [&windowed](double frequency) {
    std::complex<double> sum = 0;
    for (int i = 0; i < kSamples; ++i) sum += windowed[i] * std::polar(1.0, -2 * M_PI * frequency * i * 1e-3);
    return std::norm(sum / static_cast<double>(kSamples));
  };
  double inside = 0, outside = 0;
  for (double f = 20; f < 120; f += 0.05) inside = std::max(inside, power(f));
  for (const double f : {5.0, 15.0, 130.0, 200.0, 400.0}) outside = std::max(outside, power(f));
  EXPECT_LT(outside, 1e-8 * inside);
}

TEST(Vibration, VelocityIsDerivativeOfPosition) {
  const Vibration vibration(random_only(), "flange", 3);
  for (std::int64_t t = 1000; t < 100'000; t += 1700) {
    const Eigen::Vector3d slope = (vibration.at(t + 1).position - vibration.at(t - 1).position) / 2e-6;
    EXPECT_LT((vibration.at(t).velocity - slope).norm(), 1e-6 * 2e-5 * 2 * M_PI * 120 + 1e-12);
  }
}

TEST(Vibration, DependsOnKeyAndIsRepeatable) {
  const Vibration a(random_only(), "base", 1), b(random_only(), "base", 2), c(random_only(), "base", 1);
  EXPECT_NE(a.at(1000).position, b.at(1000).position);
  EXPECT_EQ(a.at(1000).position, c.at(1000).position);
}

TEST(Vibration, RejectsBandWithoutWidthAndIsInactiveByDefault) {
  VibrationParameters parameters = random_only();
  parameters.random_width = 0;
  EXPECT_THROW(Vibration(parameters, "base", 1), std::invalid_argument);
  EXPECT_FALSE(Vibration({}, "base", 1).active());
}

}  // namespace
