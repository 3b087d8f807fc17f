// Exponential and normal distribution without libm: vectorisable, and bit-identical on every machine.
#pragma once

#include <cstdint>
#include <cstring>

namespace sensor_rt {

/// Returns e^x for -87 < x <= 0 with a relative error below 3e-7; smaller x are clamped to -87.
inline float exp_negative(float x) {
  const float clamped = x < -87.0f ? -87.0f : x;
  const auto octave = static_cast<std::int32_t>(clamped * 1.44269504f - 0.5f);
  const auto n = static_cast<float>(octave);
  const float r = (clamped - n * 0.693359375f) + n * 2.12194440e-4f;
  const float series =
      1.0f + r * (1.0f + r * (0.5f + r * (1.66666667e-1f +
                                          r * (4.16666667e-2f + r * (8.3333333e-3f + r * 1.3888889e-3f)))));
  const std::int32_t pattern = (octave + 127) * (1 << 23);
  float scale = 0.0f;
  std::memcpy(&scale, &pattern, sizeof scale);
  return series * scale;
}

/// Probability density and cumulative distribution function of the standard normal distribution, given its
/// exponential e^(-x²/2). The absolute error of the CDF is below 2.5e-7: that of Abramowitz & Stegun 7.1.26,
/// and rounding.
inline float normal_pdf(float exponential) { return 0.398942280f * exponential; }

inline float normal_cdf(float x, float exponential) {
  const float z = (x < 0.0f ? -x : x) * 0.707106781f;
  const float t = 1.0f / (1.0f + 0.3275911f * z);
  const float tail =
      0.5f * t *
      (0.254829592f + t * (-0.284496736f + t * (1.421413741f + t * (-1.453152027f + t * 1.061405429f)))) *
      exponential;
  return x < 0.0f ? tail : 1.0f - tail;
}

}  // namespace sensor_rt
