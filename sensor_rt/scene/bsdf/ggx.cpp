#include "sensor_rt/scene/bsdf/ggx.h"

namespace sensor_rt {
namespace {

/// Returns sqrt(alpha² + (1 - alpha²) cos²), the root in Smith's masking function for GGX.
double smith_root(double cosine, double alpha2) {
  return std::sqrt(alpha2 + (1.0 - alpha2) * cosine * cosine);
}

double ggx(double cos_half, double alpha2) {
  // The tan² form 1 - cos² + alpha² cos² avoids cancellation for small alpha.
  const double c2 = cos_half * cos_half;
  const double d = (1.0 - c2) + alpha2 * c2;
  return alpha2 / (M_PI * d * d);
}

}  // namespace

double dielectric_fresnel(double cosine, double refractive_index) {
  const double c = std::clamp(cosine, 0.0, 1.0);
  const double inside = std::sqrt(1.0 - (1.0 - c * c) / (refractive_index * refractive_index));
  const double s = (c - refractive_index * inside) / (c + refractive_index * inside);
  const double p = (refractive_index * c - inside) / (refractive_index * c + inside);
  return 0.5 * (s * s + p * p);
}

double schlick_fresnel(double cosine, double at_normal) {
  const double x = 1.0 - std::clamp(cosine, 0.0, 1.0);
  const double x2 = x * x;
  return at_normal + (1.0 - at_normal) * x2 * x2 * x;
}

double ggx_brdf(double cos_a, double cos_b, double cos_half, double alpha) {
  const double alpha2 = alpha * alpha;
  const double masking = cos_a * smith_root(cos_b, alpha2) + cos_b * smith_root(cos_a, alpha2);
  return 0.5 * ggx(cos_half, alpha2) / masking;
}

Eigen::Vector3d sample_ggx(const Eigen::Vector3d& from, double alpha_x, double alpha_y, double u1,
                           double u2) {
  const Eigen::Vector3d stretched =
      Eigen::Vector3d(alpha_x * from.x(), alpha_y * from.y(), from.z()).normalized();
  const double phi = 2.0 * M_PI * u1;
  const double z = (1.0 - u2) * (1.0 + stretched.z()) - stretched.z();
  const double radius = std::sqrt(std::clamp(1.0 - z * z, 0.0, 1.0));
  const Eigen::Vector3d half = stretched + Eigen::Vector3d(radius * std::cos(phi), radius * std::sin(phi), z);
  const Eigen::Vector3d facet =
      Eigen::Vector3d(alpha_x * half.x(), alpha_y * half.y(), half.z()).normalized();
  return 2.0 * from.dot(facet) * facet - from;
}

double ggx_pdf(const Eigen::Vector3d& from, const Eigen::Vector3d& towards, double alpha) {
  const double alpha2 = alpha * alpha;
  const double cos_half = (from + towards).normalized().z();
  // D G1 / (4 cos), with G1 = 2 cos / (cos + root)
  return 0.5 * ggx(cos_half, alpha2) / (from.z() + smith_root(from.z(), alpha2));
}

Eigen::Vector3d sample_cosine(double u1, double u2) {
  const double radius = std::sqrt(u1);
  const double phi = 2.0 * M_PI * u2;
  return {radius * std::cos(phi), radius * std::sin(phi), std::sqrt(std::max(0.0, 1.0 - u1))};
}

double ggx_g2_over_g1(double cos_from, double cos_towards, double alpha) {
  const double alpha2 = alpha * alpha;
  const double root_from = smith_root(cos_from, alpha2);
  return cos_towards * (cos_from + root_from) /
         (cos_from * smith_root(cos_towards, alpha2) + cos_towards * root_from);
}

}  // namespace sensor_rt
