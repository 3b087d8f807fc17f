// Surface materials: parameters of reflection models.
#pragma once

#include <Eigen/Dense>
#include <memory>
#include <string>

#include "sensor_rt/scene/bsdf/bsdf.h"

namespace sensor_rt {

/// Direction of grooves, in the body frame: of `axis`, as far as it lies in the surface, or around it.
struct Grooves {
  Eigen::Vector3d axis = Eigen::Vector3d::Zero();  ///< of any length; zero: no grooves
  bool around = false;  ///< circles around the axis through `centre`, as by turning
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();
};

/// Material parameters at the laser wavelength.
struct Material {
  std::string model = "lambert";  ///< name of a BsdfModel
  /// Reflectance, 0..1: of the diffuse base for Lambert, Oren-Nayar and the rough dielectric; at normal
  /// incidence for the conductor; at every angle for mirror and retro-reflective foil.
  double reflectance = 0.0;
  /// Oren-Nayar: 0..1, standard deviation of the microfacet slope angle over pi/2. Models with a lobe: GGX
  /// alpha, 0.01..1.
  double roughness = 0.0;
  double refractive_index = 1.0;  ///< of the dielectric's coat, 1..3
  /// Grooved conductor: GGX alpha along the grooves, 0.01..1; `roughness` is that across them.
  double roughness_along = 0.0;
  Grooves grooves = {};
  /// Reduced scattering coefficient of the medium below the coat of the rough dielectric, 1/m, whose light
  /// leaves elsewhere than it enters; 0: an opaque base.
  double scattering = 0.0;
};

/// Throws std::invalid_argument, naming `what` and the parameter, when one is out of its range.
void validate_material(const Material& material, const std::string& what);

/// Returns the reflection model of a valid material.
std::unique_ptr<const Bsdf> make_bsdf(const Material& material);

}  // namespace sensor_rt
