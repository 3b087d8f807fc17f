// Reflection on rough surfaces made of GGX microfacets.
#pragma once

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

namespace sensor_rt {

/// Axes around a normal, for directions given with z along it.
class TangentFrame {
 public:
  explicit TangentFrame(const Eigen::Vector3d& normal) : z_(normal), x_(normal.unitOrthogonal()) {
    y_ = z_.cross(x_);
  }
  Eigen::Vector3d to_local(const Eigen::Vector3d& v) const { return {v.dot(x_), v.dot(y_), v.dot(z_)}; }
  Eigen::Vector3d to_world(const Eigen::Vector3d& v) const { return v.x() * x_ + v.y() * y_ + v.z() * z_; }

 private:
  Eigen::Vector3d z_;
  Eigen::Vector3d x_;
  Eigen::Vector3d y_;
};

/// Reflectance of a smooth dielectric for unpolarised light, by Fresnel; cosine within the outer medium.
double dielectric_fresnel(double cosine, double refractive_index);

/// Schlick's approximation for conductors.
double schlick_fresnel(double cosine, double at_normal);

/// D G2 / (4 cos cos): reflection on perfectly reflecting facets, with height-correlated masking and
/// shadowing (Heitz 2014). `cos_half`: of the half vector to the normal.
double facet_reflection(double cos_a, double cos_b, double cos_half, double alpha);

/// Direction drawn by the distribution of facets visible from `from`, as reflected there (Dupuy & Benyoub,
/// "Sampling visible GGX normals with spherical caps", 2023). z along the normal; may lie below the surface.
Eigen::Vector3d sample_facet_reflection(const Eigen::Vector3d& from, double alpha, double u1, double u2);

/// Density (1/sr) of sample_facet_reflection.
double facet_reflection_density(const Eigen::Vector3d& from, const Eigen::Vector3d& towards, double alpha);

/// Direction drawn by cosine / pi.
Eigen::Vector3d sample_cosine(double u1, double u2);

/// Share of the visible facets' reflection that leaves without meeting another facet: G2 / G1.
double facet_escape(double cos_from, double cos_towards, double alpha);

/// Directional albedo of single scattering with the given Fresnel(cosine between direction and facet).
template <typename Fresnel>
double facet_albedo(double cosine, double alpha, const Fresnel& fresnel) {
  constexpr int kAcross = 48;
  constexpr int kAround = 48;
  const Eigen::Vector3d from(std::sqrt(std::max(0.0, 1.0 - cosine * cosine)), 0.0, cosine);
  double sum = 0.0;
  for (int i = 0; i < kAround; ++i) {
    for (int j = 0; j < kAcross; ++j) {
      const Eigen::Vector3d out =
          sample_facet_reflection(from, alpha, (i + 0.5) / kAround, (j + 0.5) / kAcross);
      if (!(out.z() > 0.0)) continue;
      const double facing = std::sqrt(std::max(0.0, 0.5 * (1.0 + from.dot(out))));
      sum += fresnel(facing) * facet_escape(cosine, out.z(), alpha);
    }
  }
  return sum / (kAround * kAcross);
}

}  // namespace sensor_rt
