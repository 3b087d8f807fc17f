// The laser sheet: a fan from a point source through a narrow opening, Gaussian across, in the sensor's YZ
// plane.
#pragma once

namespace sensor_rt {

/// Laser sheet of the profile sensor. All lengths in metres, angles in radians.
struct LaserSheet {
  double wavelength = 0.0;
  double power = 0.0;           ///< W, spread evenly over the fan angle
  double fan_half_angle = 0.0;  ///< from sensor Z, in the YZ plane
  double source_z = 0.0;        ///< point source at (0, 0, source_z)
  double sheet_sigma = 0.0;     ///< standard deviation of the irradiance across the sheet at the waist
  double waist_z = 0.0;         ///< sensor Z of the waist
  double divergence = 0.0;      ///< far-field growth of sigma per metre from the waist

  /// Standard deviation across the sheet at sensor coordinate z.
  double sigma_at(double z) const;

  /// Irradiance (W/m²) on a surface element that faces the light, at (x, y, z) in the sensor frame.
  double irradiance_at(double x, double y, double z) const;
};

}  // namespace sensor_rt
