// Surface materials: parameters and BRDFs.
#pragma once

#include <Eigen/Dense>
#include <string>
#include <vector>

namespace sensor_rt {

enum class MaterialModel { kLambert, kOrenNayar, kRoughDielectric, kRoughConductor, kMirror };

/// Material parameters at the laser wavelength.
struct Material {
  MaterialModel model = MaterialModel::kLambert;
  /// Reflectance, 0..1: of the diffuse base for Lambert, Oren-Nayar and the rough dielectric; at normal
  /// incidence for the conductor; at every angle for the mirror.
  double reflectance = 0.0;
  /// Oren-Nayar: 0..1, standard deviation of the microfacet slope angle over pi/2. Dielectric and conductor:
  /// GGX alpha, 0.01..1.
  double roughness = 0.0;
  double refractive_index = 1.0;  ///< of the dielectric's coat, 1..3

  bool is_mirror() const { return model == MaterialModel::kMirror; }
  bool is_lambert() const { return model == MaterialModel::kLambert; }
  bool has_microfacets() const {
    return model == MaterialModel::kRoughDielectric || model == MaterialModel::kRoughConductor;
  }
};

/// Throws std::invalid_argument, naming `what` and the parameter, when one is out of its range.
void validate_material(const Material& material, const std::string& what);

/// A sampled direction of reflection.
struct BrdfSample {
  Eigen::Vector3d towards = Eigen::Vector3d::Zero();
  double weight = 0.0;  ///< BRDF * cosine / pdf: throughput factor; 0: absorbed
  double pdf = 0.0;     ///< 1/sr; 0 for the mirror, whose distribution is a delta function
};

/// BRDF of a material. All directions are unit vectors that point away from the surface, `normal` on the side
/// of the incident and reflected light. Reciprocal and energy-conserving: the energy lost by single
/// scattering on microfacets is compensated as in Kulla & Conty ("Revisiting physically based shading at
/// Imageworks", 2017), the diffuse base under a coat is coupled as in Kelemen & Szirmay-Kalos (2001), and
/// Oren-Nayar is the energy-preserving form of Portsmouth, Kutz & Hill (2025).
class Brdf {
 public:
  /// `material` must be valid.
  explicit Brdf(const Material& material);

  const Material& material() const { return material_; }

  /// Returns pi times the BRDF (1/sr): the reflectance of a Lambertian surface of equal radiance. 0 for
  /// directions below the surface and for the mirror.
  double pi_brdf(const Eigen::Vector3d& normal, const Eigen::Vector3d& a, const Eigen::Vector3d& b) const;

  /// Returns the directional albedo: the fraction of light reflected at this cosine of incidence, which is
  /// also the relative radiance under uniform illumination at this viewing cosine.
  double albedo(double cosine) const;

  /// Samples a direction of reflection for light from `from`, using three uniform numbers.
  BrdfSample sample(const Eigen::Vector3d& normal, const Eigen::Vector3d& from, double u0, double u1,
                    double u2) const;

 private:
  double specular_pi(double cos_a, double cos_b, double cos_half, double facing) const;
  double specular_albedo(double cosine) const;
  double fresnel(double cosine) const;
  double diffuse_pi(double cos_a, double cos_b, double cos_between) const;
  double specular_share(double cosine) const;
  void tabulate();

  Material material_;
  std::vector<double> table_;  ///< single-scattering albedo of microfacets over sqrt(cosine), see tabulate()
  std::vector<double> coloured_;  ///< conductor: the same including Fresnel
  double mean_albedo_ = 0.0;      ///< cosine-weighted mean of the table, or of Oren-Nayar's single scattering
  double rest_ = 0.0;             ///< scale of the multiple-scattering compensation
};

}  // namespace sensor_rt
