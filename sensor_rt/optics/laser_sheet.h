// The laser sheet: a fan of light from a short line source, with a Gaussian profile across the sheet.
#pragma once

#include <array>
#include <vector>

#include "sensor_rt/geometry/rigid3.h"

namespace sensor_rt {

/// The surface that the centre of the laser sheet sweeps, as an implicit function of points in the sensor
/// frame. By default the plane X = 0.
///
/// In the frame of the sheet, with depth = z - source_z, it is x = depth * bend(y / (depth * tangent)).
class SheetSurface {
 public:
  static constexpr int kStraightness = 6;

  /// Signed offset from the surface along x of the sheet's frame, m, and its gradient in the sensor frame.
  struct Offset {
    double value;
    Eigen::Vector3d gradient;
  };

  SheetSurface() = default;
  /// `tangent`: of the fan's half angle.
  SheetSurface(const Rigid3& sensor_from_sheet, double source_z, double tangent,
               const std::array<double, kStraightness>& straightness);

  bool is_nominal() const { return is_nominal_; }
  Offset offset(const Eigen::Vector3d& point_in_sensor) const;

 private:
  bool is_nominal_ = true;
  Rigid3 sensor_from_sheet_;
  double source_z_ = 0.0;
  double tangent_ = 1.0;
  std::array<double, kStraightness> straightness_{};
};

/// Laser sheet of the profile sensor. All lengths in metres, angles in radians.
///
/// Nominally the light is emitted at (0, 0, source_z) within the plane X = 0 of the sensor frame. The sheet
/// frame is the true pose: its plane x = 0 holds the centre of the sheet, apart from the straightness error.
struct LaserSheet {
  static constexpr int kStraightness = SheetSurface::kStraightness;

  double wavelength = 0.0;
  double power = 0.0;           ///< W, total within the fan angle
  double fan_half_angle = 0.0;  ///< from z, in the yz plane
  double source_z = 0.0;        ///< centre of the source at (0, 0, source_z)
  double sheet_sigma = 0.0;     ///< standard deviation of the irradiance across the sheet at the waist
  double waist_z = 0.0;         ///< z of the waist
  double divergence = 0.0;      ///< far-field growth of sigma per metre from the waist
  double source_length = 0.0;   ///< length of the line source along y; every point of it emits the same fan
  /// Out-of-plane slope x / (z - source_z) of the sheet's centre, as a polynomial in tan(angle) /
  /// tan(fan_half_angle): the shape of the line on a plane target.
  std::array<double, kStraightness> straightness{};
  /// Power per angle in arbitrary units, piecewise linear between these angles; empty: uniform.
  std::vector<double> profile_angle;
  std::vector<double> profile_power;
  Rigid3 sensor_from_sheet;

  bool is_straight() const { return straightness == std::array<double, kStraightness>{}; }
  /// True when the centre of the sheet is the plane X = 0 of the sensor.
  bool is_nominal() const { return is_straight() && sensor_from_sheet == Rigid3{}; }
  /// Returns the centre of the sheet.
  SheetSurface surface() const;
  bool is_even() const { return profile_angle.empty(); }

  /// Returns the standard deviation of the irradiance across the sheet at z.
  double sigma_at(double z) const;

  /// Returns the out-of-plane slope at tan(angle) / tan(fan_half_angle) = `position`, -1..1.
  [[gnu::always_inline]] double bend_at(double position) const {
    double sum = 0.0;
    for (int k = kStraightness; k-- > 0;) sum = sum * position + straightness[static_cast<std::size_t>(k)];
    return sum;
  }

  /// Returns an upper bound of the out-of-plane slope of the sheet's centre.
  double max_bend() const;

  /// Returns the power per radian of fan, relative to a uniform fan.
  double relative_power(double angle) const;

  /// Normalises profile_power to the total power. Throws std::invalid_argument when the profile is zero
  /// within the fan.
  void normalise_profile();
};

}  // namespace sensor_rt
