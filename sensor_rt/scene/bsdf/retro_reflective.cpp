// Retro-reflective foil: glass beads or prisms return light towards its source.
#include "sensor_rt/scene/bsdf/models.h"

namespace sensor_rt {
namespace {

/// The lobe of rough metal that reflects all light, with one direction mirrored at the normal: the "back
/// vector" of Belcour, Pacanowski, Delahaie, Laville-Geay & Eupherte ("BRDF measurements and analysis of
/// retroreflective materials", 2014). Mirroring keeps reciprocity and albedo.
class RetroReflective : public Bsdf {
 public:
  explicit RetroReflective(const Material& material)
      : reflectance_(material.reflectance),
        lobe_(make_bsdf({"rough_conductor", 1.0, material.roughness, material.refractive_index})) {}

  double pi_brdf(const SurfaceFrame& surface, const Eigen::Vector3d& a,
                 const Eigen::Vector3d& b) const override {
    return reflectance_ * lobe_->pi_brdf(surface, a, mirrored(surface.normal, b));
  }
  double albedo(double cosine) const override { return reflectance_ * lobe_->albedo(cosine); }
  BsdfSample sample(const SurfaceFrame& surface, const Eigen::Vector3d& from, double u0, double u1,
                    double u2) const override {
    BsdfSample result = lobe_->sample(surface, from, u0, u1, u2);
    result.towards = mirrored(surface.normal, result.towards);
    result.weight *= reflectance_;
    return result;
  }
  double pdf(const SurfaceFrame& surface, const Eigen::Vector3d& from,
             const Eigen::Vector3d& towards) const override {
    return lobe_->pdf(surface, from, mirrored(surface.normal, towards));
  }
  double lobe_width() const override { return lobe_->lobe_width(); }
  Eigen::Vector3d lobe_view(const SurfaceFrame& surface, const Eigen::Vector3d& view) const override {
    return mirrored(surface.normal, view);
  }
  bool is_specular() const override { return lobe_->is_specular(); }

 private:
  static Eigen::Vector3d mirrored(const Eigen::Vector3d& normal, const Eigen::Vector3d& direction) {
    return 2.0 * normal.dot(direction) * normal - direction;
  }

  double reflectance_;
  std::unique_ptr<const Bsdf> lobe_;
};

}  // namespace

extern const BsdfModel bsdf_retro_reflective{"retro_reflective", 0.01, make_bsdf_of<RetroReflective>};

}  // namespace sensor_rt
