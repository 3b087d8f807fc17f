// Grid of directions that is invariant under rotations about z by the azimuth step.
#pragma once

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

namespace sensor_rt {

/// Cells of constant size in latitude and longitude, centred on multiples of the cell size, including both
/// poles. Cells are numbered in tiles of 4 x 4, so that the 16 directions of a tile are neighbours; a tile
/// may extend beyond the last row.
class DirectionGrid {
 public:
  static constexpr int kTileSide = 4;
  static constexpr int kTileCells = kTileSide * kTileSide;
  static constexpr int kColumnsPerAzimuth = 6;  ///< 2.5° for azimuths 15° apart

  /// `azimuths`: number of azimuth steps in a full circle, a multiple of 2.
  explicit DirectionGrid(int azimuths)
      : columns_(kColumnsPerAzimuth * azimuths), rows_(columns_ / 2 + 1), step_(2.0 * kPi / columns_) {}

  int rows() const { return rows_; }
  int columns() const { return columns_; }
  int tiles() const { return (rows_ + kTileSide - 1) / kTileSide * (columns_ / kTileSide); }
  double step() const { return step_; }

  int row_of(const Eigen::Vector3d& unit) const {
    const double latitude = std::asin(std::clamp(unit.z(), -1.0, 1.0));
    return static_cast<int>(std::lround((latitude + 0.5 * kPi) / step_));
  }
  int column_of(const Eigen::Vector3d& unit) const {
    return wrapped(static_cast<int>(std::lround(std::atan2(unit.y(), unit.x()) / step_)));
  }
  /// Returns the column in 0 … columns() - 1 for a column that is at most one turn out of range.
  int wrapped(int column) const {
    return column < 0 ? column + columns_ : column >= columns_ ? column - columns_ : column;
  }

  int cell(int row, int column) const {
    const int tile = row / kTileSide * (columns_ / kTileSide) + column / kTileSide;
    return tile * kTileCells + row % kTileSide * kTileSide + column % kTileSide;
  }
  int row_of_cell(int cell) const {
    return cell / kTileCells / (columns_ / kTileSide) * kTileSide + cell % kTileCells / kTileSide;
  }
  int column_of_cell(int cell) const {
    return cell / kTileCells % (columns_ / kTileSide) * kTileSide + cell % kTileSide;
  }
  /// Returns the centre direction of a cell; zero for cells beyond the last row.
  Eigen::Vector3d direction(int cell) const {
    const int row = row_of_cell(cell);
    if (row >= rows_) return Eigen::Vector3d::Zero();
    const double latitude = row * step_ - 0.5 * kPi;
    const double longitude = column_of_cell(cell) * step_;
    return {std::cos(latitude) * std::cos(longitude), std::cos(latitude) * std::sin(longitude),
            std::sin(latitude)};
  }

 private:
  static constexpr double kPi = 3.14159265358979323846;

  int columns_;
  int rows_;
  double step_;
};

}  // namespace sensor_rt
