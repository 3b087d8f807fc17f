// What a surface does with light: parameters, and the reflection prepared from them.
#pragma once

#include <Eigen/Dense>
#include <string>
#include <vector>

namespace sensor_rt {

enum class MaterialModel { kLambert, kOrenNayar, kRoughDielectric, kRoughConductor, kMirror };

/// A surface at the laser's wavelength.
struct Material {
  MaterialModel model = MaterialModel::kLambert;
  /// Share of light sent back, 0..1: of the diffuse base for Lambert, Oren-Nayar and the dielectric's base;
  /// at normal incidence for the conductor; at every angle for the mirror.
  double reflectance = 0.0;
  /// Oren-Nayar: 0..1, standard deviation of the facets' slope angle over pi/2. Dielectric and conductor: GGX
  /// alpha, 0.01..1.
  double roughness = 0.0;
  double refractive_index = 1.0;  ///< of the dielectric's coat, 1..3

  bool is_mirror() const { return model == MaterialModel::kMirror; }
  bool is_lambert() const { return model == MaterialModel::kLambert; }
};

/// Throws std::invalid_argument, naming `what` and the parameter, when one is out of its range.
void validate_material(const Material& material, const std::string& what);

/// A direction of reflection chosen at random.
struct ReflectedSample {
  Eigen::Vector3d towards = Eigen::Vector3d::Zero();
  double weight = 0.0;   ///< brdf * cosine / density: factor on the carried light; 0: absorbed
  double density = 0.0;  ///< per steradian; 0 for the mirror's single direction
};

/// Bidirectional reflection of a material. All directions are unit vectors that point away from the surface,
/// `normal` on the side on which the light arrives and leaves. Reciprocal, and never sends back more than it
/// receives: what single scattering on facets loses is given back as in Kulla & Conty ("Revisiting physically
/// based shading at Imageworks", 2017), the diffuse base under a coat is coupled as in Kelemen &
/// Szirmay-Kalos (2001), and Oren-Nayar is the energy-preserving form of Portsmouth, Kutz & Hill (2025).
class Reflection {
 public:
  /// `material` must be valid.
  explicit Reflection(const Material& material);

  const Material& material() const { return material_; }

  /// pi times the brdf (1/sr): the reflectance of the Lambertian surface that would look as bright. 0 for
  /// directions below the surface and for the mirror.
  double diffuse_equivalent(const Eigen::Vector3d& normal, const Eigen::Vector3d& a,
                            const Eigen::Vector3d& b) const;

  /// Share of the light arriving at this cosine that is sent back; as well, brightness under even light from
  /// all sides seen at this cosine.
  double albedo(double cosine) const;

  /// Direction of reflection of light that arrived from `from`, by three uniform numbers.
  ReflectedSample sample(const Eigen::Vector3d& normal, const Eigen::Vector3d& from, double u0, double u1,
                         double u2) const;

 private:
  double specular_pi(double cos_a, double cos_b, double cos_half, double facing) const;
  double specular_albedo(double cosine) const;
  double fresnel(double cosine) const;
  double diffuse_pi(double cos_a, double cos_b, double cos_between) const;
  double specular_share(double cosine) const;
  void tabulate();

  Material material_;
  std::vector<double> table_;     ///< albedo of single scattering on facets over sqrt(cosine), see tabulate()
  std::vector<double> coloured_;  ///< conductor: the same with Fresnel
  double mean_albedo_ = 0.0;      ///< cosine-weighted mean of the table, or of Oren-Nayar's single scattering
  double rest_ = 0.0;             ///< scale of what single scattering leaves over
};

}  // namespace sensor_rt
