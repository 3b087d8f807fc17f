#include "sensor_rt/scene/bsdf/bsdf.h"

#include "sensor_rt/scene/bsdf/ggx.h"

namespace sensor_rt {

BsdfSample Bsdf::sample(const SurfaceFrame& surface, const Eigen::Vector3d& from, double, double u1,
                        double u2) const {
  const Eigen::Vector3d& normal = surface.normal;
  BsdfSample result;
  if (!(normal.dot(from) > 0.0)) return result;
  const Eigen::Vector3d out = sample_cosine(u1, u2);
  if (!(out.z() > 0.0)) return result;
  result.towards = TangentFrame(normal).to_world(out);
  result.pdf = pdf(surface, from, result.towards);
  result.weight = pi_brdf(surface, from, result.towards);
  return result;
}

double Bsdf::pdf(const SurfaceFrame& surface, const Eigen::Vector3d& from,
                 const Eigen::Vector3d& towards) const {
  const Eigen::Vector3d& normal = surface.normal;
  const double cosine = normal.dot(towards);
  return normal.dot(from) > 0.0 && cosine > 0.0 ? cosine / M_PI : 0.0;
}

}  // namespace sensor_rt
