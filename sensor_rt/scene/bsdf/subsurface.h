// Light that leaves a translucent surface elsewhere than it enters.
#pragma once

#include <Eigen/Dense>
#include <array>
#include <memory>
#include <vector>

#include "sensor_rt/scene/bsdf/microfacet_bsdf.h"

namespace sensor_rt {

/// Returns the cosine of refraction at a smooth interface; `cosine`: outside, `refractive_index`: inside over
/// outside.
inline double refracted_cosine(double cosine, double refractive_index) {
  return std::sqrt(1.0 - (1.0 - cosine * cosine) / (refractive_index * refractive_index));
}

/// Diffusion of light in a uniform half-space of isotropic scatterers below an interface.
///
/// Light enters at a line on the surface, and leaves with the density f(x) at the distance x from it. With
/// the first and the last point of scattering at the depths z1 and z2, x is the sum of the paths before and
/// after these, z1 tan a + z2 tan b with the angles of refraction, and of a symmetrical displacement between
/// them, which does not depend on the directions. Random walks give the joint distribution of both depths and
/// the displacement; f is approximated by a sum of Gaussians with these moments.
///
/// Anisotropic scattering is described by its reduced coefficient (similarity relation).
class Subsurface {
 public:
  static constexpr int kParts = 10;
  static constexpr double kLeastScattering = 50.0;  ///< 1/m
  static constexpr double kMostScattering = 1e6;
  static constexpr double kMostReflectance = 0.9;  ///< walks are of limited length

  /// A Gaussian of f: its share of the light, and mean (m) and variance (m²) of x.
  struct Part {
    double share, mean, variance;
  };

  /// A direction away from the surface, as seen by the light inside.
  struct Direction {
    Direction(const Subsurface& medium, double cosine_outside, double across_outside)
        : cosine(refracted_cosine(cosine_outside, medium.refractive_index_)),
          tangent(across_outside / medium.refractive_index_ / cosine) {}
    double cosine;   ///< with the normal
    double tangent;  ///< component across the line over that along the normal
  };

  /// Moments of a part, lengths in mean free paths.
  struct Moments {
    double share = 0.0;
    std::array<double, 2> depth{};       ///< means of first and last depth
    std::array<double, 3> covariance{};  ///< of first, of last, of both
    double spread = 0.0;                 ///< variance of the displacement
  };

  /// `reflectance`: share of the light that has entered which leaves again; `scattering`: reduced
  /// coefficient, 1/m; `interface`: reflectance of the interface by the cosine outside.
  Subsurface(double reflectance, double scattering, double refractive_index, const CosineTable& interface);

  /// Returns an instance for equal numbers that is made only once. `interface` must depend on the roughness
  /// and the refractive index alone.
  static std::shared_ptr<const Subsurface> shared(double reflectance, double scattering,
                                                  double refractive_index, double roughness,
                                                  const CosineTable& interface);

  /// Returns a Gaussian of the distribution; the shares of all sum to 1. `from` and `towards`: directions to
  /// source and viewer.
  Part part(int number, const Direction& from, const Direction& towards) const;

  /// Returns a bound of the standard deviation plus the mean of a part, m.
  double reach(int number) const { return reach_[static_cast<std::size_t>(number)]; }

  double mean_free_path() const { return mean_free_path_; }  ///< m
  double albedo() const { return albedo_; }                  ///< of an event of scattering
  double refractive_index() const { return refractive_index_; }
  /// Returns the share that the interface transmits, by the cosine outside.
  double transmission(double cosine) const { return 1.0 - interface_.at(cosine); }
  /// Returns the same for light inside; 0 beyond the critical angle.
  double transmission_from_inside(double cosine) const;

 private:
  static constexpr int kCosines = 5;  ///< nodes between the smallest cosine of refraction and 1

  double smallest_cosine() const { return refracted_cosine(0.0, refractive_index_); }
  void find_albedo(double reflectance);
  void find_moments();

  double refractive_index_;
  CosineTable interface_;
  double albedo_ = 0.0;
  double mean_free_path_ = 0.0;
  std::vector<std::array<Moments, kParts>> moments_;  ///< [cosine from][cosine towards]
  std::array<double, kParts> reach_{};
};

}  // namespace sensor_rt
