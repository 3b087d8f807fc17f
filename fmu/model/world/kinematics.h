// The tree of a cell: nominal geometry plus deviations.
#pragma once

#include <array>

#include "fmu/kinematics/tree.h"
#include "fmu/model/as_built.h"
#include "fmu/model/bodies.h"
#include "fmu/model/description/cell_description.h"

namespace robotcell {

/// Kinematics of a cell: the tree of its frames, numbered by `FrameNumbers`, and their motions.
class Kinematics {
 public:
  Kinematics(const CellDescription& cell, const AsBuilt& as_built);

  const Tree& tree() const { return tree_; }
  const FrameNumbers& numbers() const { return numbers_; }
  std::size_t joints() const { return numbers_.joints; }
  /// Pose of the sensor on the flange, or the identity where the flange does not carry it.
  Eigen::Isometry3d flange_from_tool() const;

  /// Motions of all frames at positions and rates of the axes, with displacements by vibration.
  std::vector<Motion> motions(const std::array<double, kAxes>& position,
                              const std::array<double, kAxes>& rate,
                              const VibrationDisplacements& vibration = {}) const;
  /// Motion of one frame.
  Motion frame(std::size_t frame, const std::array<double, kAxes>& position,
               const std::array<double, kAxes>& rate, const VibrationDisplacements& vibration = {}) const;

 private:
  std::vector<Deviation> deviations(double table, double table_rate,
                                    const VibrationDisplacements& vibration) const;

  FrameNumbers numbers_;
  TableWobble wobble_;
  Tree tree_;
};

/// A frame displaced by x, y, z (m) and turned by rx, ry, rz (rad, intrinsic XYZ) in itself.
Eigen::Isometry3d displaced(const Eigen::Isometry3d& frame, const std::array<double, 6>& by);

/// Converts a motion to plain numbers.
BodyState body_state(const Motion& motion);

}  // namespace robotcell
