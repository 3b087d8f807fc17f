// Ideal diffuse reflection.
#include "sensor_rt/scene/bsdf/models.h"

namespace sensor_rt {
namespace {

class Lambert : public Bsdf {
 public:
  explicit Lambert(const Material& material) : reflectance_(material.reflectance) {}

  double pi_brdf(const SurfaceFrame& surface, const Eigen::Vector3d& a,
                 const Eigen::Vector3d& b) const override {
    const Eigen::Vector3d& normal = surface.normal;
    return normal.dot(a) > 0.0 && normal.dot(b) > 0.0 ? reflectance_ : 0.0;
  }
  double albedo(double) const override { return reflectance_; }
  bool is_lambert() const override { return true; }

 private:
  double reflectance_;
};

}  // namespace

extern const BsdfModel bsdf_lambert{"lambert", 0.0, make_bsdf_of<Lambert>};

}  // namespace sensor_rt
