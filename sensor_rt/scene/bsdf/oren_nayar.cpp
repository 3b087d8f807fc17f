// Rough diffuse reflection: Oren-Nayar in the energy-preserving form of Portsmouth, Kutz & Hill (2025), on
// Fujii's simplification.
#include <algorithm>
#include <cmath>

#include "sensor_rt/scene/bsdf/models.h"

namespace sensor_rt {
namespace {

class OrenNayar : public Bsdf {
 public:
  explicit OrenNayar(const Material& material)
      : reflectance_(material.reflectance),
        roughness_(material.roughness),
        scale_(1.0 / (1.0 + (0.5 - 2.0 / (3.0 * M_PI)) * roughness_)),
        mean_single_(scale_ * (1.0 + (2.0 / 3.0 - 28.0 / (15.0 * M_PI)) * roughness_)) {
    constexpr double kTiny = 1e-9;
    const double lost = 1.0 - mean_single_;
    if (lost > kTiny) {
      rest_ = reflectance_ * reflectance_ * mean_single_ / (1.0 - reflectance_ * lost) / lost;
    }
  }

  double pi_brdf(const SurfaceFrame& surface, const Eigen::Vector3d& a,
                 const Eigen::Vector3d& b) const override {
    const Eigen::Vector3d& normal = surface.normal;
    const double cos_a = normal.dot(a);
    const double cos_b = normal.dot(b);
    if (!(cos_a > 0.0) || !(cos_b > 0.0)) return 0.0;
    const double s = a.dot(b) - cos_a * cos_b;
    const double shaped = s > 0.0 ? s / std::max(cos_a, cos_b) : s;
    return reflectance_ * scale_ * (1.0 + roughness_ * shaped) +
           rest_ * (1.0 - single(cos_a)) * (1.0 - single(cos_b));
  }

  double albedo(double cosine) const override {
    const double once = single(cosine);
    return reflectance_ * once + rest_ * (1.0 - once) * (1.0 - mean_single_);
  }

 private:
  /// Returns the albedo of single scattering on a white surface, in closed form.
  double single(double cosine) const {
    const double c = std::clamp(cosine, 1e-6, 1.0);
    const double s = std::sqrt(1.0 - c * c);
    const double g = s * (std::acos(c) - s * c) + (2.0 / 3.0) * ((s / c) * (1.0 - s * s * s) - s);
    return scale_ * (1.0 + roughness_ * g / M_PI);
  }

  double reflectance_;
  double roughness_;
  double scale_;
  double mean_single_;
  double rest_ = 0.0;
};

}  // namespace

extern const BsdfModel bsdf_oren_nayar{"oren_nayar", 0.0, make_bsdf_of<OrenNayar>};

}  // namespace sensor_rt
