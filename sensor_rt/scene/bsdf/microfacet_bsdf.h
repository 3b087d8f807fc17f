// Base of models with a GGX lobe above a diffuse component.
#pragma once

#include <cmath>
#include <functional>
#include <vector>

#include "sensor_rt/scene/bsdf/bsdf.h"

namespace sensor_rt {

/// Function of the cosine of incidence, tabulated over its square root.
class CosineTable {
 public:
  static constexpr int kNodes = 128;

  CosineTable() = default;
  explicit CosineTable(const std::function<double(double)>& function);

  double at(double cosine) const;
  /// Returns the mean weighted by the cosine.
  double mean() const;

 private:
  std::vector<double> nodes_;
};

/// Returns the probability of sampling the lobe: its share of the reflected light, within limits. `single`:
/// its albedo; `rest`: that of all else.
double lobe_share(double single, double rest);

/// Returns the factor of the light that single scattering by a conductor loses, see MicrofacetBsdf.
/// `reflectance`: at normal incidence; `mean_single`: mean albedo of single scattering without Fresnel.
double conductor_rest(double reflectance, double mean_single);

/// Single scattering by GGX microfacets plus a diffuse rest that is coupled to it: rest * (1 - A(a)) (1 -
/// A(b)) with the albedo A of single scattering. The rest is the diffuse base under a coat (Kelemen &
/// Szirmay-Kalos 2001) or the energy lost by single scattering (Kulla & Conty, "Revisiting physically based
/// shading at Imageworks", 2017). Sampling mixes visible normals and cosines.
class MicrofacetBsdf : public Bsdf {
 public:
  double pi_brdf(const SurfaceFrame& surface, const Eigen::Vector3d& a,
                 const Eigen::Vector3d& b) const override;
  BsdfSample sample(const SurfaceFrame& surface, const Eigen::Vector3d& from, double u0, double u1,
                    double u2) const override;
  double pdf(const SurfaceFrame& surface, const Eigen::Vector3d& from,
             const Eigen::Vector3d& towards) const override;
  double lobe_width() const override { return alpha_; }

 protected:
  /// Returns the rest; 0 for directions below the surface.
  double pi_rest(double cos_a, double cos_b) const {
    return cos_a > 0.0 && cos_b > 0.0 ? rest_ * (1.0 - single_.at(cos_a)) * (1.0 - single_.at(cos_b)) : 0.0;
  }

  explicit MicrofacetBsdf(double alpha) : alpha_(alpha) {}

  virtual double fresnel(double cosine) const = 0;
  /// Sets the albedo of single scattering and its mean.
  void set_single(CosineTable single) {
    single_ = std::move(single);
    mean_single_ = single_.mean();
  }

  double alpha_;
  CosineTable single_;
  double mean_single_ = 0.0;
  double rest_ = 0.0;

 private:
  double specular_share(double cosine) const;
};

}  // namespace sensor_rt
