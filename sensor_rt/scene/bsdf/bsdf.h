// Interface of surface reflection models.
#pragma once

#include <Eigen/Dense>
#include <limits>

namespace sensor_rt {

/// Unit normal of a surface at a point, on the side of the incident and reflected light, and the direction of
/// grooves.
struct SurfaceFrame {
  Eigen::Vector3d normal;
  Eigen::Vector3d along = Eigen::Vector3d::Zero();  ///< unit, in the surface; zero: none

  SurfaceFrame(const Eigen::Vector3d& given) : normal(given) {}  // NOLINT: most surfaces have no grooves
  SurfaceFrame(const Eigen::Vector3d& given, const Eigen::Vector3d& grooves)
      : normal(given), along(grooves) {}
};

/// A sampled direction of reflection.
struct BsdfSample {
  Eigen::Vector3d towards = Eigen::Vector3d::Zero();
  double weight = 0.0;  ///< BSDF * cosine / pdf: throughput factor; 0: absorbed
  double pdf = 0.0;     ///< 1/sr; 0 for a specular surface, whose distribution is a delta function
};

class Subsurface;

/// Reflection by a surface. All directions are unit vectors that point away from the surface. Every
/// model is reciprocal and conserves energy.
class Bsdf {
 public:
  virtual ~Bsdf() = default;

  /// Returns pi times the BSDF (1/sr): the reflectance of a Lambertian surface of equal radiance. 0 for
  /// directions below the surface and for a specular surface.
  virtual double pi_brdf(const SurfaceFrame& surface, const Eigen::Vector3d& a,
                         const Eigen::Vector3d& b) const = 0;

  /// Returns the directional albedo: the fraction of light reflected at this cosine of incidence, which is
  /// also the relative radiance under uniform illumination at this viewing cosine.
  virtual double albedo(double cosine) const = 0;

  /// Samples a direction of reflection for light from `from`, using three uniform numbers. By default with
  /// the pdf cosine / pi.
  virtual BsdfSample sample(const SurfaceFrame& surface, const Eigen::Vector3d& from, double u0, double u1,
                            double u2) const;

  /// Returns the pdf (1/sr) with which `sample` chooses `towards`.
  virtual double pdf(const SurfaceFrame& surface, const Eigen::Vector3d& from,
                     const Eigen::Vector3d& towards) const;

  /// Returns the smallest roughness of the lobe that GGX distributes about the half vector between light and
  /// lobe_view; infinity without such a lobe.
  virtual double lobe_width() const { return std::numeric_limits<double>::infinity(); }
  virtual Eigen::Vector3d lobe_view(const SurfaceFrame& /*surface*/, const Eigen::Vector3d& view) const {
    return view;
  }

  /// Returns the part of pi_brdf that leaves the surface elsewhere than it enters. All other methods treat it
  /// as if it left there.
  virtual double pi_subsurface(const SurfaceFrame& /*surface*/, const Eigen::Vector3d& /*a*/,
                               const Eigen::Vector3d& /*b*/) const {
    return 0.0;
  }

  /// Returns the medium below a translucent surface; null: opaque.
  virtual const Subsurface* subsurface() const { return nullptr; }

  /// Returns true for a mirror, whose BSDF is a delta function.
  virtual bool is_specular() const { return false; }

  /// Returns true when the light is reflected equally into all directions.
  virtual bool is_lambert() const { return false; }
};

}  // namespace sensor_rt
