// Rough coat of a dielectric on a diffuse base.
#include "sensor_rt/scene/bsdf/ggx.h"
#include "sensor_rt/scene/bsdf/microfacet_bsdf.h"
#include "sensor_rt/scene/bsdf/models.h"

namespace sensor_rt {
namespace {

class RoughDielectric : public MicrofacetBsdf {
 public:
  explicit RoughDielectric(const Material& material)
      : MicrofacetBsdf(material.roughness),
        reflectance_(material.reflectance),
        refractive_index_(material.refractive_index) {
    set_single(CosineTable([this](double cosine) {
      return ggx_albedo(cosine, alpha_, [this](double facing) { return RoughDielectric::fresnel(facing); });
    }));
    rest_ = reflectance_ / (1.0 - mean_single_);
  }

  double albedo(double cosine) const override {
    const double coat = single_.at(cosine);
    return coat + reflectance_ * (1.0 - coat);
  }

 private:
  double fresnel(double cosine) const override { return dielectric_fresnel(cosine, refractive_index_); }

  double reflectance_;
  double refractive_index_;
};

}  // namespace

extern const BsdfModel bsdf_rough_dielectric{"rough_dielectric", 0.01, make_bsdf_of<RoughDielectric>};

}  // namespace sensor_rt
