// Width and brightness of the laser stripe on a camera image, from the hit points of the laser rays.
#pragma once

#include "sensor_rt/geometry/lanes.h"
#include "sensor_rt/optics/camera.h"

namespace sensor_rt {

/// Laser light on sixteen hit points.
struct alignas(64) HitLight {
  double irradiance[kLanes];     ///< of the surface at the centre of the sheet, W/m²
  double sigma[kLanes];          ///< standard deviation of the sheet, m
  double normal_travel[kLanes];  ///< displacement of the surface along its normal during the exposure, m
};

/// Stripe parameters on a camera image.
struct alignas(64) StripeLanes {
  double responsivity[kLanes];  ///< electrons per second and W/m² of diffusely reflected irradiance
  double peak_ratio[kLanes];    ///< ratio of the blurred to the unblurred peak height
  double width[kLanes];         ///< standard deviation along the column, px
};

/// Stripe model on the tangent plane of a hit point: the sheet's Gaussian profile, intersected with the plane
/// and projected to the rows of a column, convolved with the column's own width where the stripe is slanted,
/// the point spread function, defocus and motion.
class StripeOptics {
 public:
  /// `camera`: with its pose in the sheet frame.
  StripeOptics(const Camera& camera, double electrons_per_irradiance);

  /// `from_viewpoint`: vectors from the camera to the points; `normal`: surface normals on the visible side;
  /// `column` and `row`: pixel coordinates of the points.
  void measure(const Lanes3& from_viewpoint, const Lanes3& normal, const double* column, const double* row,
               const HitLight& light, StripeLanes& stripes) const;

  struct Constants {
    double right[3], down[3], forward[3];  ///< axes of the camera
    double responsivity;
    double psf2;
    double aperture_px;  ///< aperture radius times focal length in px
    double vergence[3];  ///< constant, per x, per y
  };

 private:
  Camera camera_;
  Constants constants_;
  Lanes3 per_column_;  ///< change of the viewing direction (of unit depth) per column
  Lanes3 per_row_;
  double area_[kLanes];
};

}  // namespace sensor_rt
