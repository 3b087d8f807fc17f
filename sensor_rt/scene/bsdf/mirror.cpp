// Ideal mirror.
#include "sensor_rt/scene/bsdf/models.h"

namespace sensor_rt {
namespace {

class Mirror : public Bsdf {
 public:
  explicit Mirror(const Material& material) : reflectance_(material.reflectance) {}

  double pi_brdf(const SurfaceFrame&, const Eigen::Vector3d&, const Eigen::Vector3d&) const override {
    return 0.0;
  }
  double albedo(double) const override { return reflectance_; }
  BsdfSample sample(const SurfaceFrame& surface, const Eigen::Vector3d& from, double, double,
                    double) const override {
    const Eigen::Vector3d& normal = surface.normal;
    BsdfSample result;
    const double cosine = normal.dot(from);
    if (!(cosine > 0.0)) return result;
    result.towards = 2.0 * cosine * normal - from;
    result.weight = reflectance_;
    return result;
  }
  double pdf(const SurfaceFrame&, const Eigen::Vector3d&, const Eigen::Vector3d&) const override {
    return 0.0;
  }
  bool is_specular() const override { return true; }

 private:
  double reflectance_;
};

}  // namespace

extern const BsdfModel bsdf_mirror{"mirror", 0.0, make_bsdf_of<Mirror>};

}  // namespace sensor_rt
