// Rough coat of a dielectric on a diffuse base, or rough surface of a translucent medium.
#include "sensor_rt/scene/bsdf/ggx.h"
#include "sensor_rt/scene/bsdf/microfacet_bsdf.h"
#include "sensor_rt/scene/bsdf/models.h"
#include "sensor_rt/scene/bsdf/subsurface.h"

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
    if (material.scattering > 0.0) {
      subsurface_ = Subsurface::shared(reflectance_, material.scattering, refractive_index_, alpha_, single_);
    }
  }

  double albedo(double cosine) const override {
    const double coat = single_.at(cosine);
    return coat + reflectance_ * (1.0 - coat);
  }

  double pi_subsurface(const SurfaceFrame& surface, const Eigen::Vector3d& a,
                       const Eigen::Vector3d& b) const override {
    return subsurface_ ? pi_rest(surface.normal.dot(a), surface.normal.dot(b)) : 0.0;
  }

  const Subsurface* subsurface() const override { return subsurface_.get(); }

 private:
  double fresnel(double cosine) const override { return dielectric_fresnel(cosine, refractive_index_); }

  double reflectance_;
  double refractive_index_;
  std::shared_ptr<const Subsurface> subsurface_;
};

}  // namespace

extern const BsdfModel bsdf_rough_dielectric{"rough_dielectric", 0.01, make_bsdf_of<RoughDielectric>};

}  // namespace sensor_rt
