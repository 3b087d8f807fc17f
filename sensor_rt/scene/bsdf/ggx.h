// GGX microfacet model of rough surfaces.
#pragma once

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

namespace sensor_rt {

/// Orthonormal frame whose z axis is the surface normal.
class TangentFrame {
 public:
  explicit TangentFrame(const Eigen::Vector3d& normal) : TangentFrame(normal, normal.unitOrthogonal()) {}
  /// `x`: unit, perpendicular to the normal.
  TangentFrame(const Eigen::Vector3d& normal, const Eigen::Vector3d& x)
      : z_(normal), x_(x), y_(normal.cross(x)) {}
  Eigen::Vector3d to_local(const Eigen::Vector3d& v) const { return {v.dot(x_), v.dot(y_), v.dot(z_)}; }
  Eigen::Vector3d to_world(const Eigen::Vector3d& v) const { return v.x() * x_ + v.y() * y_ + v.z() * z_; }

 private:
  Eigen::Vector3d z_;
  Eigen::Vector3d x_;
  Eigen::Vector3d y_;
};

/// Returns the Fresnel reflectance of a smooth dielectric for unpolarised light; `cosine` of the incidence
/// angle in the outer medium.
double dielectric_fresnel(double cosine, double refractive_index);

/// Returns Schlick's approximation of the Fresnel reflectance of a conductor.
double schlick_fresnel(double cosine, double at_normal);

/// Returns the GGX BRDF D G2 / (4 cos cos) of perfectly reflecting microfacets, with height-correlated
/// masking and shadowing (Heitz 2014). `cos_half`: cosine between half vector and normal.
double ggx_brdf(double cos_a, double cos_b, double cos_half, double alpha);

/// Returns a direction sampled by reflecting `from` on the distribution of visible normals (Dupuy & Benyoub,
/// "Sampling visible GGX normals with spherical caps", 2023). z along the normal; the direction may lie below
/// the surface.
/// `alpha_x`, `alpha_y`: roughness along x and y.
Eigen::Vector3d sample_ggx(const Eigen::Vector3d& from, double alpha_x, double alpha_y, double u1, double u2);

/// Returns the pdf (1/sr) of sample_ggx.
double ggx_pdf(const Eigen::Vector3d& from, const Eigen::Vector3d& towards, double alpha);

/// Returns a direction with the pdf cosine / pi.
Eigen::Vector3d sample_cosine(double u1, double u2);

/// Returns G2 / G1: the fraction of the light reflected by visible microfacets that is not shadowed by
/// others.
double ggx_g2_over_g1(double cos_from, double cos_towards, double alpha);

/// Returns the directional albedo of single scattering for a given Fresnel(cosine between direction and
/// microfacet normal), G2 / G1 by reflected direction, and roughness along x and y.
template <typename G2OverG1, typename Fresnel>
double ggx_albedo(const Eigen::Vector3d& from, double alpha_x, double alpha_y, const G2OverG1& g2_over_g1,
                  const Fresnel& fresnel) {
  constexpr int kAcross = 48;
  constexpr int kAround = 48;
  constexpr int kShift = 19;  // of a lattice: the edge of the light lies between other points at each azimuth
  double sum = 0.0;
  for (int i = 0; i < kAround; ++i) {
    for (int j = 0; j < kAcross; ++j) {
      // Few facets turn light below the horizon, but of a smooth surface they are most of what is lost: the
      // points become denser towards them.
      const double rest = 1.0 - (j + (i * kShift % kAround + 0.5) / kAround) / kAcross;
      const double rest2 = rest * rest;
      const Eigen::Vector3d out =
          sample_ggx(from, alpha_x, alpha_y, (i + 0.5) / kAround, 1.0 - rest2 * rest2);
      if (!(out.z() > 0.0)) continue;
      const double facing = std::sqrt(std::max(0.0, 0.5 * (1.0 + from.dot(out))));
      sum += 4.0 * rest2 * rest * fresnel(facing) * g2_over_g1(out);
    }
  }
  return sum / (kAround * kAcross);
}

/// Returns that of equal roughness in all directions.
template <typename Fresnel>
double ggx_albedo(double cosine, double alpha, const Fresnel& fresnel) {
  const Eigen::Vector3d from(std::sqrt(std::max(0.0, 1.0 - cosine * cosine)), 0.0, cosine);
  const auto unshadowed = [&](const Eigen::Vector3d& out) { return ggx_g2_over_g1(cosine, out.z(), alpha); };
  return ggx_albedo(from, alpha, alpha, unshadowed, fresnel);
}

}  // namespace sensor_rt
