// Lamps: external sources of light.
#pragma once

#include <Eigen/Dense>
#include <optional>

#include "sensor_rt/geometry/band.h"
#include "sensor_rt/geometry/rigid3.h"

namespace sensor_rt {

enum class LightKind { kPoint, kRectangle, kDisc };

/// A lamp. Points shine evenly to all sides; areas lie in z = 0 of their own frame and shine towards +z like
/// a Lambertian surface. Lamps cast no shadows and are not seen themselves, not even in mirrors.
struct Light {
  LightKind kind = LightKind::kPoint;
  int body = 0;
  Rigid3 body_from_light;
  Eigen::Vector2d size = Eigen::Vector2d::Zero();  ///< edges of a rectangle; diameter, twice, of a disc; m
  double power = 0.0;                              ///< W, over the whole spectrum
  /// Share of the power that passes the band-pass filter, against the laser's share; or the spectrum, from
  /// which that share follows.
  std::optional<double> in_band;
  Band spectrum;
};

/// What a lamp's watts are worth through a filter, against the laser's.
double in_band_share(const Light& light, const Band& filter, double laser_wavelength);

/// A small piece of a lamp.
struct LightPiece {
  Eigen::Vector3d position = Eigen::Vector3d::Zero();
  Eigen::Vector3d normal = Eigen::Vector3d::Zero();  ///< zero: shines to all sides
  double power = 0.0;                                ///< W

  /// Radiant intensity (W/sr) in a unit direction away from the lamp.
  double intensity(const Eigen::Vector3d& direction) const;
};

/// Pieces that sum up smooth light over an area well; points have one. `count` fits kLightPieces.
constexpr int kLightPieces = 16;
int light_pieces(const Light& light, const Rigid3& reference_from_light, LightPiece* pieces);

/// A piece chosen evenly at random, with the power of the whole lamp.
LightPiece random_piece(const Light& light, const Rigid3& reference_from_light, double u, double v);

}  // namespace sensor_rt
