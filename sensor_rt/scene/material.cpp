#include "sensor_rt/scene/material.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "sensor_rt/scene/ggx.h"

namespace sensor_rt {
namespace {

constexpr double kTiny = 1e-9;
constexpr int kNodes = 128;  ///< of the albedo table

void require(const std::string& what, const char* name, double value, double least, double most) {
  if (value >= least && value <= most) return;
  throw std::invalid_argument(what + ": " + name + " must lie in " + std::to_string(least) + ".." +
                              std::to_string(most) + ", got " + std::to_string(value));
}

double fujii_scale(double roughness) { return 1.0 / (1.0 + (0.5 - 2.0 / (3.0 * M_PI)) * roughness); }

/// Returns the directional albedo of Fujii's Oren-Nayar model for a white surface, in closed form.
double fujii_albedo(double roughness, double cosine) {
  const double c = std::clamp(cosine, 1e-6, 1.0);
  const double s = std::sqrt(1.0 - c * c);
  const double g = s * (std::acos(c) - s * c) + (2.0 / 3.0) * ((s / c) * (1.0 - s * s * s) - s);
  return fujii_scale(roughness) * (1.0 + roughness * g / M_PI);
}

double look_up(const std::vector<double>& table, double cosine) {
  const double position = std::sqrt(std::clamp(cosine, 0.0, 1.0)) * kNodes;
  const auto before = static_cast<std::size_t>(std::min(position, kNodes - 1.0));
  const double fraction = position - static_cast<double>(before);
  return table[before] + fraction * (table[before + 1] - table[before]);
}

}  // namespace

void validate_material(const Material& material, const std::string& what) {
  require(what, "reflectance", material.reflectance, 0.0, 1.0);
  require(what, "roughness", material.roughness, material.has_microfacets() ? 0.01 : 0.0, 1.0);
  require(what, "refractive_index", material.refractive_index, 1.0, 3.0);
}

Brdf::Brdf(const Material& material) : material_(material) {
  if (material_.has_microfacets()) {
    tabulate();
  } else if (material_.model == MaterialModel::kOrenNayar) {
    const double r = material_.roughness;
    mean_albedo_ = fujii_scale(r) * (1.0 + (2.0 / 3.0 - 28.0 / (15.0 * M_PI)) * r);
    const double rho = material_.reflectance;
    rest_ = 1.0 - mean_albedo_ > kTiny
                ? rho * rho * mean_albedo_ / (1.0 - rho * (1.0 - mean_albedo_)) / (1.0 - mean_albedo_)
                : 0.0;
  }
}

double Brdf::fresnel(double cosine) const {
  return material_.model == MaterialModel::kRoughDielectric
             ? dielectric_fresnel(cosine, material_.refractive_index)
             : schlick_fresnel(cosine, material_.reflectance);
}

void Brdf::tabulate() {
  // The conductor's table is that of a perfect reflector; Fresnel enters as its mean over the bounces.
  const bool coat = material_.model == MaterialModel::kRoughDielectric;
  table_.resize(kNodes + 1);
  for (int i = 0; i <= kNodes; ++i) {
    const double root = std::max(1e-3, static_cast<double>(i) / kNodes);
    const double cosine = root * root;
    const double real = ggx_albedo(cosine, material_.roughness, [&](double c) { return fresnel(c); });
    table_[static_cast<std::size_t>(i)] =
        coat ? real : ggx_albedo(cosine, material_.roughness, [](double) { return 1.0; });
    if (!coat) coloured_.push_back(real);
  }
  constexpr int kSteps = 8 * kNodes;  // cosine = root², mean = 2 * integral of albedo * cosine over cosine
  for (int i = 0; i < kSteps; ++i) {
    const double root = (i + 0.5) / kSteps;
    mean_albedo_ += 4.0 * root * root * root * specular_albedo(root * root) / kSteps;
  }
  const double left = 1.0 - mean_albedo_;
  if (coat) {
    rest_ = material_.reflectance / left;
  } else if (left > kTiny) {
    const double mean_fresnel = material_.reflectance + (1.0 - material_.reflectance) / 21.0;
    rest_ = mean_fresnel * mean_fresnel * mean_albedo_ / (1.0 - mean_fresnel * left) / left;
  }
}

double Brdf::specular_albedo(double cosine) const { return look_up(table_, cosine); }

double Brdf::specular_pi(double cos_a, double cos_b, double cos_half, double facing) const {
  return M_PI * ggx_brdf(cos_a, cos_b, cos_half, material_.roughness) * fresnel(facing);
}

double Brdf::diffuse_pi(double cos_a, double cos_b, double cos_between) const {
  switch (material_.model) {
    case MaterialModel::kLambert:
      return material_.reflectance;
    case MaterialModel::kOrenNayar: {
      const double r = material_.roughness;
      const double s = cos_between - cos_a * cos_b;
      const double shaped = s > 0.0 ? s / std::max(cos_a, cos_b) : s;
      return material_.reflectance * fujii_scale(r) * (1.0 + r * shaped) +
             rest_ * (1.0 - fujii_albedo(r, cos_a)) * (1.0 - fujii_albedo(r, cos_b));
    }
    case MaterialModel::kMirror:
      return 0.0;
    default:
      return rest_ * (1.0 - specular_albedo(cos_a)) * (1.0 - specular_albedo(cos_b));
  }
}

double Brdf::pi_brdf(const Eigen::Vector3d& normal, const Eigen::Vector3d& a,
                     const Eigen::Vector3d& b) const {
  const double cos_a = normal.dot(a);
  const double cos_b = normal.dot(b);
  if (!(cos_a > 0.0) || !(cos_b > 0.0)) return 0.0;
  const double diffuse = diffuse_pi(cos_a, cos_b, a.dot(b));
  if (!material_.has_microfacets()) return diffuse;
  const Eigen::Vector3d half = (a + b).normalized();
  return diffuse + specular_pi(cos_a, cos_b, normal.dot(half), half.dot(a));
}

double Brdf::albedo(double cosine) const {
  const double rho = material_.reflectance;
  switch (material_.model) {
    case MaterialModel::kOrenNayar: {
      const double single = fujii_albedo(material_.roughness, cosine);
      return rho * single + rest_ * (1.0 - single) * (1.0 - mean_albedo_);
    }
    case MaterialModel::kRoughDielectric: {
      const double coat = specular_albedo(cosine);
      return coat + rho * (1.0 - coat);
    }
    case MaterialModel::kRoughConductor: {
      return look_up(coloured_, cosine) + rest_ * (1.0 - specular_albedo(cosine)) * (1.0 - mean_albedo_);
    }
    default:
      return rho;
  }
}

double Brdf::specular_share(double cosine) const {
  if (!material_.has_microfacets()) return 0.0;
  const double single = specular_albedo(cosine);
  const double rest = rest_ * (1.0 - single) * (1.0 - mean_albedo_);
  return std::clamp(single / std::max(single + rest, kTiny), 0.1, 0.99);
}

BrdfSample Brdf::sample(const Eigen::Vector3d& normal, const Eigen::Vector3d& from, double u0, double u1,
                        double u2) const {
  BrdfSample result;
  const double cosine = normal.dot(from);
  if (!(cosine > 0.0)) return result;
  if (material_.is_mirror()) {
    result.towards = 2.0 * cosine * normal - from;
    result.weight = material_.reflectance;
    return result;
  }
  const TangentFrame frame(normal);
  const double share = specular_share(cosine);
  const Eigen::Vector3d local = frame.to_local(from);
  const Eigen::Vector3d out =
      u0 < share ? sample_ggx(local, material_.roughness, u1, u2) : sample_cosine(u1, u2);
  if (!(out.z() > 0.0)) return result;
  double facets = 0.0;
  if (share > 0.0) facets = ggx_pdf(local, out, material_.roughness);
  result.towards = frame.to_world(out);
  result.pdf = share * facets + (1.0 - share) * out.z() / M_PI;
  if (!(result.pdf > 0.0)) return result;
  result.weight = pi_brdf(normal, from, result.towards) * (out.z() / M_PI) / result.pdf;
  return result;
}

}  // namespace sensor_rt
