#include "sensor_rt/scene/bsdf/microfacet_bsdf.h"

#include <algorithm>

#include "sensor_rt/scene/bsdf/ggx.h"

namespace sensor_rt {

CosineTable::CosineTable(const std::function<double(double)>& function) {
  for (int i = 0; i <= kNodes; ++i) {
    const double root = std::max(1e-3, static_cast<double>(i) / kNodes);
    nodes_.push_back(function(root * root));
  }
}

double CosineTable::at(double cosine) const {
  const double position = std::sqrt(std::clamp(cosine, 0.0, 1.0)) * kNodes;
  const auto before = static_cast<std::size_t>(std::min(position, kNodes - 1.0));
  const double fraction = position - static_cast<double>(before);
  return nodes_[before] + fraction * (nodes_[before + 1] - nodes_[before]);
}

double CosineTable::mean() const {
  constexpr int kSteps = 8 * kNodes;  // cosine = root², mean = 2 * integral of the function * cosine
  double sum = 0.0;
  for (int i = 0; i < kSteps; ++i) {
    const double root = (i + 0.5) / kSteps;
    sum += 4.0 * root * root * root * at(root * root) / kSteps;
  }
  return sum;
}

double lobe_share(double single, double rest) {
  constexpr double kTiny = 1e-9;
  return std::clamp(single / std::max(single + rest, kTiny), 0.1, 0.99);
}

double conductor_rest(double reflectance, double mean_single) {
  constexpr double kTiny = 1e-9;
  const double lost = 1.0 - mean_single;
  if (!(lost > kTiny)) return 0.0;
  const double mean_fresnel = reflectance + (1.0 - reflectance) / 21.0;  // over the bounces
  return mean_fresnel * mean_fresnel * mean_single / (1.0 - mean_fresnel * lost) / lost;
}

double MicrofacetBsdf::pi_brdf(const SurfaceFrame& surface, const Eigen::Vector3d& a,
                               const Eigen::Vector3d& b) const {
  const Eigen::Vector3d& normal = surface.normal;
  const double cos_a = normal.dot(a);
  const double cos_b = normal.dot(b);
  if (!(cos_a > 0.0) || !(cos_b > 0.0)) return 0.0;
  const Eigen::Vector3d half = (a + b).normalized();
  return pi_rest(cos_a, cos_b) +
         M_PI * ggx_brdf(cos_a, cos_b, normal.dot(half), alpha_) * fresnel(half.dot(a));
}

double MicrofacetBsdf::specular_share(double cosine) const {
  const double single = single_.at(cosine);
  return lobe_share(single, rest_ * (1.0 - single) * (1.0 - mean_single_));
}

BsdfSample MicrofacetBsdf::sample(const SurfaceFrame& surface, const Eigen::Vector3d& from, double u0,
                                  double u1, double u2) const {
  const Eigen::Vector3d& normal = surface.normal;
  BsdfSample result;
  const double cosine = normal.dot(from);
  if (!(cosine > 0.0)) return result;
  const TangentFrame frame(normal);
  const double share = specular_share(cosine);
  const Eigen::Vector3d local = frame.to_local(from);
  const Eigen::Vector3d out = u0 < share ? sample_ggx(local, alpha_, alpha_, u1, u2) : sample_cosine(u1, u2);
  if (!(out.z() > 0.0)) return result;
  result.towards = frame.to_world(out);
  result.pdf = pdf(surface, from, result.towards);
  if (!(result.pdf > 0.0)) return result;
  result.weight = pi_brdf(surface, from, result.towards) * (out.z() / M_PI) / result.pdf;
  return result;
}

double MicrofacetBsdf::pdf(const SurfaceFrame& surface, const Eigen::Vector3d& from,
                           const Eigen::Vector3d& towards) const {
  const Eigen::Vector3d& normal = surface.normal;
  const double cosine = normal.dot(from);
  const double out = normal.dot(towards);
  if (!(cosine > 0.0) || !(out > 0.0)) return 0.0;
  const TangentFrame frame(normal);
  const double share = specular_share(cosine);
  return share * ggx_pdf(frame.to_local(from), frame.to_local(towards), alpha_) + (1.0 - share) * out / M_PI;
}

}  // namespace sensor_rt
