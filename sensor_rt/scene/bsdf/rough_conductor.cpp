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
    rest_ = conductor_rest(reflectance_, mean_single_);
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
