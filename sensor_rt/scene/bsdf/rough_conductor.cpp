// Rough metal.
#include "sensor_rt/scene/bsdf/ggx.h"
#include "sensor_rt/scene/bsdf/microfacet_bsdf.h"
#include "sensor_rt/scene/bsdf/models.h"

namespace sensor_rt {
namespace {

class RoughConductor : public MicrofacetBsdf {
 public:
  explicit RoughConductor(const Material& material)
      : MicrofacetBsdf(material.roughness), reflectance_(material.reflectance) {
    // The table is that of a perfect reflector; Fresnel enters the rest as its mean over the bounces.
    set_single(CosineTable(
        [this](double cosine) { return ggx_albedo(cosine, alpha_, [](double) { return 1.0; }); }));
    coloured_ = CosineTable([this](double cosine) {
      return ggx_albedo(cosine, alpha_, [this](double facing) { return RoughConductor::fresnel(facing); });
    });
    constexpr double kTiny = 1e-9;
    const double lost = 1.0 - mean_single_;
    if (lost > kTiny) {
      const double mean_fresnel = reflectance_ + (1.0 - reflectance_) / 21.0;
      rest_ = mean_fresnel * mean_fresnel * mean_single_ / (1.0 - mean_fresnel * lost) / lost;
    }
  }

  double albedo(double cosine) const override {
    return coloured_.at(cosine) + rest_ * (1.0 - single_.at(cosine)) * (1.0 - mean_single_);
  }

 private:
  double fresnel(double cosine) const override { return schlick_fresnel(cosine, reflectance_); }

  double reflectance_;
  CosineTable coloured_;  ///< albedo of single scattering including Fresnel
};

}  // namespace

extern const BsdfModel bsdf_rough_conductor{"rough_conductor", 0.01, make_bsdf_of<RoughConductor>};

}  // namespace sensor_rt
