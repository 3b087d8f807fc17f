// The laser sheet: a fan of light through a narrow opening, Gaussian across.
#pragma once

#include <array>
#include <vector>

#include "sensor_rt/geometry/rigid3.h"

namespace sensor_rt {

/// Laser sheet of the profile sensor. All lengths in metres, angles in radians.
///
/// Nominally the light leaves the point (0, 0, source_z) within the plane X = 0 of the sensor frame. The
/// sheet frame is where it truly does: the plane x = 0 of that frame holds the middle of the sheet, up to its
/// straightness.
struct LaserSheet {
  static constexpr int kStraightness = 6;

  double wavelength = 0.0;
  double power = 0.0;           ///< W, all of it within the fan angle
  double fan_half_angle = 0.0;  ///< from z, in the yz plane
  double source_z = 0.0;        ///< middle of the source at (0, 0, source_z)
  double sheet_sigma = 0.0;     ///< standard deviation of the irradiance across the sheet at the waist
  double waist_z = 0.0;         ///< z of the waist
  double divergence = 0.0;      ///< far-field growth of sigma per metre from the waist
  double opening = 0.0;         ///< length of the source along y; every point of it sends out the same fan
  /// Out-of-plane slope x / (z - source_z) of the sheet's middle, as a polynomial in tan(angle) /
  /// tan(fan_half_angle): a plane target shows the line in this shape.
  std::array<double, kStraightness> straightness{};
  /// Power per angle, linear between these angles, of any scale; empty: even.
  std::vector<double> profile_angle;
  std::vector<double> profile_power;
  Rigid3 sensor_from_sheet;

  bool is_straight() const { return straightness == std::array<double, kStraightness>{}; }
  /// The middle of the sheet is the plane X = 0 of the sensor.
  bool is_nominal() const { return is_straight() && sensor_from_sheet == Rigid3{}; }
  bool is_even() const { return profile_angle.empty(); }

  /// Standard deviation across the sheet at z.
  double sigma_at(double z) const;

  /// Out-of-plane slope where tan(angle) / tan(fan_half_angle) = `place`, -1..1.
  double bend_at(double place) const {
    double sum = 0.0;
    for (int k = kStraightness; k-- > 0;) sum = sum * place + straightness[static_cast<std::size_t>(k)];
    return sum;
  }

  /// No part of the sheet bends further out of its plane than this slope.
  double largest_bend() const;

  /// Share of the power per radian of fan, relative to an even fan.
  double relative_power(double angle) const;

  /// Scales profile_power so that the profile holds the whole power. Throws std::invalid_argument when it has
  /// no light within the fan.
  void normalise_profile();

  /// Irradiance (W/m²) on a surface element that faces the light of one point of the source, at (x, y, z)
  /// from there but for z, which counts from the origin of the sheet frame.
  double irradiance_at(double x, double y, double z) const;
};

}  // namespace sensor_rt
